"""Studies of one's own, and the tables that are kept of a plan; nothing is trained."""

import json
import os
import shutil
from dataclasses import replace

import polars as pl
import pytest

from astray.experiments import catalogue, run, spec
from astray.training import folders


@pytest.mark.parametrize("text", ["[" * 1000, "\0", "9" * 10_000, "a b", "#" * 2**21])
def test_what_is_no_python_is_no_experiment(tmp_path, text):
    (tmp_path / "study.py").write_text(text)
    with pytest.raises(ValueError, match=r"study.py must be (a file of Python|of at most)"):
        catalogue.find(str(tmp_path / "study.py"))


def test_studies_of_one_module_have_reports_of_their_own(tmp_path, monkeypatch):
    """The second one's report replaced the first one's."""
    source = "from astray.experiments.catalogue import load\n"
    (tmp_path / "mine_all.py").write_text(source + "EXPERIMENT = EARLY_ONE = load('maze-corner')\n")
    monkeypatch.syspath_prepend(tmp_path)
    names = [catalogue.find(f"mine_all:{name}")[0] for name in ("EXPERIMENT", "EARLY_ONE")]
    assert names == ["mine-all", "mine-all-early-one"]


def test_studies_whose_names_differ_in_case_alone_are_refused(tmp_path, monkeypatch):
    source = "from dataclasses import replace\nfrom astray.experiments.catalogue import load\n"
    source += "Late, late = load('maze-corner'), replace(load('maze-corner'))\n"
    (tmp_path / "mine_alike.py").write_text(f"{source}LATE = replace(late, name='third')\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("Late", "late"):
        with pytest.raises(ValueError, match=r"of mine_alike would share the report 'mine-alike-"):
            catalogue.find(f"mine_alike:{name}")
    assert catalogue.find("mine_alike:LATE")[0] == "third"


def test_two_files_of_one_name_are_not_reproduced_into_one_report(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "reproduce", lambda *_, **__: pytest.fail("reproduced"))
    paths = [tmp_path / name / "mine_twice.py" for name in ("here", "there")]
    for path in paths:
        path.parent.mkdir()
        path.write_text(
            "from astray.experiments.catalogue import load\nEXPERIMENT = load('maze-corner')"
        )
    with pytest.raises(ValueError, match="two of these would share the report 'mine-twice'"):
        run.reproduce_each([str(path) for path in paths], "smoke", tmp_path / "reports")


@pytest.mark.parametrize("first", ["here/mine_twice.py", "maze-corner"])
def test_another_study_of_that_name_does_not_replace_the_report_of_the_first(
    first, tmp_path, monkeypatch
):
    source = "from astray.experiments.catalogue import load\nEXPERIMENT = load('maze-corner')"
    name = first.rpartition("/")[2].removesuffix(".py")
    paths = [tmp_path / where / f"{name}.py" for where in ("here", "there")]
    for path in paths:
        path.parent.mkdir()
        path.write_text(source)
    monkeypatch.setattr(run, "train_agents", lambda *_: pytest.fail("trained"))
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / f"{name.replace('_', '-')}-smoke"
    noted(replace(catalogue.load("maze-corner").sizes["smoke"], seeds=1), folder, first)
    with pytest.raises(
        ValueError, match=r"has the report of .*, which .*there.*would share; renam"
    ):
        run.reproduce(str(paths[1]), "smoke", tmp_path)
    run.check_study(folder, catalogue.origin(first, folder))
    paths[0].unlink()  # as of a study that was moved
    folder = tmp_path / "mine-twice-smoke"
    run.check_study(folder, catalogue.origin(f"{paths[1]}", folder))


def test_a_report_tells_no_path_of_its_authors(tmp_path):
    """It is given away, and two authors' reports of one study are equal."""
    (tmp_path / "study.py").touch()
    noted(
        replace(catalogue.load("maze-corner").sizes["smoke"], seeds=1),
        tmp_path / "report",
        f"{tmp_path}/study.py",
    )
    assert f"{tmp_path}" not in (tmp_path / "report" / run.PLAN).read_text()


@pytest.mark.parametrize("text", ['{"study": [1]}', '{"study": 1e308}', "[" * 100_000])
def test_a_ruined_plan_is_of_no_other_study(text, tmp_path):
    (tmp_path / run.PLAN).write_text(text)
    run.check_study(tmp_path, "maze-corner")


def noted(plan, folder, first=None):
    folder.mkdir(exist_ok=True)
    text, digest = run.inputs(plan, {}, catalogue.load("maze-corner"))
    run.note(text, digest, folder, first and catalogue.origin(first, folder))
    return digest


def test_tables_of_other_plans_are_deleted_and_nothing_of_the_users(tmp_path):
    first, second = (
        replace(one, seeds=1) for one in [*catalogue.load("maze-corner").sizes.values()][:2]
    )
    computed = tmp_path / "computed"
    computed.mkdir()
    digest = noted(first, tmp_path)
    ours = computed / f"episodes-{digest}.parquet"
    mine = [
        computed / name
        for name in (
            "mine.parquet",
            f"a-{digest}.txt",
            f"b-{digest}.parquet",
            f"c-{digest}.parquet",
        )
    ]
    for path in (ours, *mine[:2]):
        path.write_text("table")
    mine[2].mkdir()
    mine[3].symlink_to(mine[0])
    assert noted(first, tmp_path) == digest and ours.exists()
    assert noted(second, tmp_path) != digest and not ours.exists()
    assert all(map(os.path.lexists, mine))


def test_tables_are_not_looked_for_where_a_link_leads(tmp_path):
    (tmp_path / "computed").symlink_to(tmp_path.parent)
    plan = next(iter(catalogue.load("maze-corner").sizes.values()))
    for look in (noted, lambda *_: spec.cached(tmp_path, "episodes", pl.DataFrame)):
        with pytest.raises(OSError, match="computed must be a folder of its own; it is a link"):
            look(plan, tmp_path)


def test_what_fails_in_a_study_of_ones_own_is_told_with_its_line(tmp_path):
    (tmp_path / "study.py").write_text("import json\n\njson.loads('{')\n")
    with pytest.raises(ValueError, match=r"study\.py, line 3: JSONDecodeError: Expecting"):
        catalogue.find(str(tmp_path / "study.py"))


def test_art_that_is_none_is_told_before_anything_is_done(tmp_path):
    with pytest.raises(ValueError, match="unknown art 'red' of maze; there are: own, original"):
        run.reproduce("maze-corner", "smoke", tmp_path, art="red")
    with pytest.raises(ValueError, match="published agents see the art that they know; got 'own2'"):
        run.reproduce("moved-coin", "published", tmp_path, art="own2")
    assert not list(tmp_path.iterdir())


def test_tables_are_computed_anew_where_a_study_of_ones_own_was_edited(tmp_path):
    path = tmp_path / "mine.py"
    text = (
        "from dataclasses import replace\n"
        "from astray.experiments.studies.maze.maze_corner import EXPERIMENT as OTHER\n"
    )
    digests = set()
    for number in range(2):
        path.write_text(
            f"{text}def find(work):\n    return {number}\n\n"
            "EXPERIMENT = replace(OTHER, find=find)\n"
        )
        whole = catalogue.find(str(path))[1]
        digests.add(run.code_of(whole.sizes["smoke"], whole))
    assert len(digests) == 2 and None not in digests


def test_other_settings_of_a_published_agent_compute_its_tables_anew(tmp_path):
    mouse = tmp_path / "mouse"
    shutil.copytree(folders.find("maze-corner"), mouse)
    config = folders.read_config(mouse)
    given = {"published": {"mouse": "maze-corner"}, "differences": ""}
    plan = spec.plan_of("mouse", config, "maze", "corner-small", **given)
    before = run.inputs(plan, {"mouse": [mouse]})[1]
    settings = json.loads((mouse / "config.json").read_text())
    settings["config"]["seed"] += 1
    (mouse / "config.json").write_text(json.dumps(settings))
    assert run.inputs(plan, {"mouse": [mouse]})[1] != before
