"""What a release is made of agrees with itself; the wheel is built and tried by `make wheel`."""

import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

import astray
from astray import games, imports
from helpers.processes import begin
from helpers.thorough import thorough

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]
# Trackio wants an older Pillow than the one that the digests of pictures were made with.
APART = {"trackio"}


def read(name):
    path = ROOT / name
    if not path.exists():
        pytest.skip(f"{name} is not beside the tests")
    return path.read_text(encoding="utf-8")


def yaml(name):
    return pytest.importorskip("yaml").safe_load(read(name))


def package(requirement):
    return re.split(r"[\[<>=~!; ]", requirement)[0]


def test_one_version_is_told_everywhere():
    version = PROJECT["project"]["version"]
    assert version == astray.__version__
    assert yaml("CITATION.cff")["version"] == version
    assert re.search(r"^## (\S+),", read("CHANGELOG.md"), re.MULTILINE)[1] == version


def test_a_citation_has_what_the_format_demands():
    citation = yaml("CITATION.cff")
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert all({"title", "authors", "type"} <= one.keys() for one in citation["references"])


def test_wheels_are_tried_on_every_python_that_is_promised():
    wheel = yaml(".github/workflows/test.yml")["jobs"]["wheel"]
    promised = [
        c.rpartition(" ")[2]
        for c in PROJECT["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", c)
    ]
    assert wheel["strategy"]["matrix"]["python"] == promised
    assert len(wheel["strategy"]["matrix"]["system"]) == 3


def test_what_is_installed_takes_the_first_python_that_is_promised():
    """Debian 12 has Python 3.11.2; a library of `constraints.txt` demanded 3.11.5."""
    first = f"{PROJECT['project']['requires-python'].removeprefix('>=')}.0"
    needs = {its.name: its.metadata.get("Requires-Python") for its in metadata.distributions()}
    assert {
        name: python
        for name, python in needs.items()
        if python and not SpecifierSet(python).contains(first)
    } == {}


def test_publishing_needs_the_tests_and_no_token():
    text = read(".github/workflows/release.yml")
    jobs = yaml(".github/workflows/release.yml")["jobs"]
    assert {"test", "thorough", "version"} <= set(jobs["publish"]["needs"])
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    assert "secrets." not in text and "password" not in text


def test_what_is_tested_seldom_is_tested_every_week_and_before_a_release():
    thorough = ".github/workflows/thorough.yml"
    assert yaml(".github/workflows/release.yml")["jobs"]["thorough"]["uses"] == f"./{thorough}"
    (step,) = (one["run"] for one in yaml(thorough)["jobs"]["thorough"]["steps"] if "run" in one)
    assert step == "make thorough"
    assert yaml(thorough)[True].keys() >= {"schedule", "workflow_call"}  # YAML reads `on` as true


def test_what_extras_bring_is_tested():
    extras = {
        package(one)
        for each in PROJECT["project"]["optional-dependencies"].values()
        for one in each
    }
    tested = [*PROJECT["dependency-groups"]["dev"], *EXTRAS["train"]]
    assert extras - {package(one) for one in tested} == APART | {"astray"}


def test_the_oldest_libraries_are_tried():
    told = subprocess.run(
        [sys.executable, ROOT / "packaging/lowest.py"], capture_output=True, text=True, check=True
    )
    lowest = dict(line.split("==") for line in told.stdout.split())
    needed = {
        *PROJECT["project"]["dependencies"],
        *(one for each in EXTRAS.values() for one in each),
    }
    assert lowest.keys() == {package(one) for one in needed} - {"astray"}
    steps = yaml(".github/workflows/test.yml")["jobs"]["lowest"]["steps"]
    assert any("packaging/lowest.py" in step.get("run", "") for step in steps)


def test_all_is_every_extra():
    assert {name for name in EXTRAS if name not in ("all", "train")} == set(
        re.search(r"\[(.*)\]", *EXTRAS["all"])[1].split(",")
    )


BARE = """
import sys

class Missing:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {names}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing)
for name in [name for name in sys.modules if name.partition(".")[0] in {names}]:
    del sys.modules[name]
"""
STEP = """
import gymnasium, numpy, astray
from astray import games
for game in games.OWN:
    for variant in games.find(game).variants:
        gymnasium.spec(f"astray/{game}-{variant}-v0")
    env = gymnasium.make_vec(f"astray/{game}-{variant}-v0", num_envs=2)
    env.reset(seed=0)
    print(env.step(numpy.zeros(2, int))[0].shape)
"""


def without_extras(program, folder, *names):
    """Run a program where no library of an extra can be imported, or none of these names."""
    names = {*names} or {package(one) for each in EXTRAS.values() for one in each} - {"astray"}
    program = BARE.format(names=names) + program
    return begin(program, folder).ended()


def test_environments_need_no_library_of_an_extra(tmp_path):
    code, out, err = without_extras(STEP, tmp_path)
    assert code == 0, err
    assert out.splitlines() == ["(2, 64, 64, 3)"] * len(games.OWN)


NEEDS_MORE = """
import astray
for name in ("Config", "evaluate", "reproduce", "train"):
    try:
        getattr(astray, name)
    except ImportError as error:
        print(error)
"""


def test_what_needs_more_than_environments_says_which_extra(tmp_path):
    _, said, _ = without_extras(NEEDS_MORE, tmp_path)
    names = ("Config", "evaluate", "reproduce", "train")
    for name, line in zip(names, said.splitlines(), strict=True):
        needs = rf'astray.{name} needs \w+: pip install ".\[train\]" in a clone of astray'
        assert re.fullmatch(needs, line)


def test_the_command_says_which_extra_it_needs(tmp_path):
    _, _, err = without_extras("from astray import cli; cli.main()", tmp_path)
    assert err.splitlines() == [
        'astray: the command astray needs tyro: pip install ".[train]" in a clone of astray'
    ]


@pytest.mark.parametrize(
    "library, words",
    [
        ("polars", "evaluate maze-corner"),
        *thorough(
            ("torch", "evaluate maze-corner"),
            ("torch", "train maze corner-small"),
            ("av", "record maze-corner"),
            ("matplotlib", "compare maze-corner random"),
        ),
    ],
)
def test_a_verb_says_which_extra_a_single_missing_library_is_of(library, words, tmp_path):
    folder = tmp_path / "empty"
    folder.mkdir()
    program = f"sys.argv[1:] = {words.split()}\nfrom astray import cli; cli.main()"
    _, _, err = without_extras(program, folder, library)
    assert err.splitlines() == [
        f'astray: the command astray needs {library}: pip install ".[train]" in a clone of astray'
    ]
    assert not list(folder.iterdir())


@pytest.mark.parametrize("name", ["of_a_user", "torch_geometric", "astray.of_mine", "ray"])
def test_a_library_that_the_extra_does_not_install_is_told_as_it_is(name):
    error = ModuleNotFoundError(f"No module named {name!r}", name=name)
    assert imports.needed_by("the command astray", error) is error


def test_the_version_is_told(astray):
    assert astray("--version").strip() == PROJECT["project"]["version"]


@pytest.mark.skipif(not os.environ.get("ASTRAY_RELEASE"), reason="minutes; set ASTRAY_RELEASE=1")
def test_the_wheel_is_built_checked_and_works_alone():
    subprocess.run(["make", "wheel"], cwd=ROOT, check=True)


NAMES_INDEX = re.compile(r"""pip\\?["', ]+install(?:\\?["', ]+-\S+)*\\?["', ]+astray\b""")


@pytest.mark.parametrize("folder", ["README.md", "docs", "examples", "src", "Makefile"])
def test_nothing_installs_a_name_from_an_index_where_astray_is_not(folder):
    """Whoever takes the name would be run by all who follow such a line."""
    kinds = {".md", ".py", ".ipynb", ".js", ".html", ".json", ""}
    files = [path for path in (ROOT / folder, *(ROOT / folder).rglob("*")) if path.is_file()]
    texts = {path: path.read_text(encoding="utf-8") for path in files if path.suffix in kinds}
    assert texts
    assert not {str(path) for path, text in texts.items() if NAMES_INDEX.search(text)}
