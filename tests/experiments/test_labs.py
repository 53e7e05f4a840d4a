"""Labs beside reports, to which their videos lead."""

import json
from dataclasses import replace

import pytest

from astray.experiments import labs
from astray.lab.export import COMPUTED
from astray.report import page as report
from astray.report.findings import Findings, Heading, Scene, Video
from astray.training import checkpoint, folders

SCENE = Scene(folders.find("maze-corner"), "anywhere-small", 200_007)
LAB = "lab/index.html"


def test_a_scene_leads_to_a_lab_that_has_its_agent(tmp_path):
    links = labs.write([SCENE], tmp_path)
    assert links[SCENE].startswith(f"{LAB}#game=maze&variant=anywhere-small&agent=")
    assert (tmp_path / LAB).is_file()
    index = json.loads((tmp_path / "lab" / "data" / "index.json").read_text())
    (agent,) = index["agents"]
    assert f"&agent={agent}&drawn=" in links[SCENE]
    learned = next(folders.find("maze-corner").glob("checkpoints/*/agent.safetensors")).read_bytes()
    (weights,) = (tmp_path / "lab" / "data" / "agents").iterdir()
    assert weights.read_bytes() == learned
    assert labs.write([SCENE], tmp_path) == links  # again, as where a report is written anew


def test_what_is_no_lab_is_left_alone(tmp_path):
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "mine.txt").write_text("mine")
    assert labs.write([SCENE], tmp_path) == {}
    assert [path.name for path in (tmp_path / "lab").iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    "name", ["notes.txt", ".git/config", "data/mine.json", "index.html", labs.WRITTEN]
)
def test_a_lab_in_which_something_is_the_users_stays(tmp_path, name):
    labs.write([SCENE], tmp_path)
    mine = tmp_path / "lab" / name
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    assert labs.write([SCENE], tmp_path) == {}
    assert mine.read_text() == "mine"


def test_an_agent_that_a_page_cannot_compute_has_no_lab(tmp_path, monkeypatch):
    monkeypatch.setattr(labs, "is_computed", lambda agent: False)
    assert labs.write([SCENE], tmp_path) == labs.write([], tmp_path) == {}
    assert not (tmp_path / "lab").exists()


@pytest.mark.parametrize("links", [{}, {SCENE: f"{LAB}#game=maze"}])
def test_a_report_has_the_command_and_the_link(links, tmp_path):
    video = tmp_path / "video.mp4"
    video.write_bytes(b"")
    heading = Heading(
        name="a", size="smoke", title="", reproduces="", question="", differences="", command=""
    )
    findings = Findings(answer="", claims=[], settings={}, videos=[Video("A walk.", video, SCENE)])
    page = report.write(heading, findings, tmp_path, links=links).read_text()
    assert report.code(SCENE.command) in page and SCENE.command.endswith("--level 200007")
    assert (f'<a href="{LAB}#game=maze">' in page) == bool(links)


def test_the_command_quotes_the_folder():
    assert replace(SCENE, run="a b").command.startswith('astray lab "a b" --variant')
    mouse = replace(SCENE, run=folders.find("maze-corner"))
    assert mouse.command.startswith("astray lab maze-corner --variant")


def test_the_mouse_is_computed_by_the_page():
    assert checkpoint.read_config(SCENE.run).network == COMPUTED
