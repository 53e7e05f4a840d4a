"""Memory that is there: of the machine, or of the container that a process runs in."""

import os

import pytest

from astray import memory

INSTALLED = "9223372036854771712"  # what version 1 says where there is no limit


@pytest.fixture
def system(tmp_path):
    """Write what a system tells of control groups: the groups, and files by their paths."""

    def write(groups, **files):
        files = {"proc/self/cgroup": groups} | {f"sys/fs/cgroup/{k}": v for k, v in files.items()}
        for name, text in files.items():
            path = tmp_path / name.replace("__", "/").replace("max", "memory.max")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n")
        return tmp_path

    return write


@pytest.mark.skipif(os.name == "nt", reason="the system does not tell")
@pytest.mark.parametrize(
    "groups, files, limit",
    [
        ("0::/", {"max": "1000"}, 1000),
        ("0::/", {"max": "max"}, None),
        ("0::/a/b", {"max": "max", "a__max": "3000", "a__b__max": "max"}, 3000),
        ("0::/a/b", {"a__max": "3000", "a__b__max": "2000"}, 2000),
        ("0::/../not/mounted", {"max": "1000"}, 1000),
        ("", {}, None),
        ("nonsense", {"max": "-5"}, None),
    ],
)
def test_the_limit_of_a_container_is_looked_up(system, groups, files, limit):
    machine = memory.available(system("") / "nothing")
    assert memory.available(system(groups, **files)) == (machine if limit is None else limit)


@pytest.mark.skipif(os.name == "nt", reason="the system does not tell")
def test_the_limit_of_an_older_container_is_looked_up(tmp_path):
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text("8:pids:/x\n7:cpu,memory:/x/y\n0::/\n")
    of_all = tmp_path / "sys/fs/cgroup/memory"
    (of_all / "x").mkdir(parents=True)
    (of_all / "memory.limit_in_bytes").write_text(f"{INSTALLED}\n")
    (of_all / "x/memory.limit_in_bytes").write_text("5000\n")
    assert memory.available(tmp_path) == 5000


@pytest.mark.skipif(os.name == "nt", reason="the system does not tell")
def test_more_memory_than_a_container_has_is_refused(monkeypatch, system):
    monkeypatch.setattr(memory, "ROOT", system("0::/", max="2000000000"))
    memory.check_memory(2_000_000_000, "one thing")
    with pytest.raises(MemoryError, match=r"things need 2\.1 GB of memory; there are 2\.0 GB"):
        memory.check_memory(2_100_000_000, "things")
