"""The lab in a notebook: the page as a widget, and the answers that it gets there."""

import json

import numpy as np
import pytest

import astray.lab
from astray import games
from astray.lab import session
from astray.lab.notebook import LOADER, modules
from astray.lab.session import Session
from astray.level import Level
from helpers.browsed import ROOM, usual_lab, wait

# Cells that show one widget, whose kernel tells its answers to all; `passed` has the keys that the
# notebook hears.
CELLS = """async ([loader, modules, count]) => {
  const heard = new Set();
  const model = {
    get: (name) => ({ modules })[name],
    on: (_, hear) => heard.add(hear),
    off: (_, hear) => heard.delete(hear),
    send: async (text) => {
      for (const answer of await kernel(text)) heard.forEach((hear) => hear(answer));
    },
  };
  const address = URL.createObjectURL(new Blob([loader], { type: "text/javascript" }));
  const { default: widget } = await import(address);
  const cells = Array.from({ length: count }, () => document.createElement("div"));
  document.body.replaceChildren(...cells);
  globalThis.passed = [];
  document.addEventListener("keydown", ({ key }) => passed.push(key));
  globalThis.clears = [];
  for (const el of cells) clears.push(await widget.render({ model, el }));
  globalThis.listening = () => heard.size;
  globalThis.labs = cells.map((el) => el.lab);
  globalThis.lab = labs[0];
}"""


@pytest.fixture(scope="module")
def notebook(chrome, static):
    """A page with three cells: one test clears the last, the others use the first two."""
    its = Session(usual_lab())
    page = chrome.new_context().new_page()
    page.expose_function("kernel", lambda text: list(its.answers(text)))
    page.goto(f"{static}data/index.json")  # any page without scripts of its own
    page.evaluate(CELLS, [LOADER.read_text(), modules(), 3])
    wait(page, "labs.every((lab) => lab.ready && lab.fields.size > 0)")
    yield page
    page.context.close()


def test_the_widget_of_a_notebook_is_the_same_page(notebook):
    assert notebook.evaluate("(level) => lab.open(level)", ROOM)
    wait(notebook, "lab.fields.size > 0")
    assert notebook.evaluate("lab.text") == ROOM
    notebook.evaluate("lab.part('taken').open = true")
    assert notebook.is_visible("[data-lab=json]") and not notebook.is_visible("[data-lab=link]")


def test_keys_in_a_cell_play_and_never_reach_the_notebook(notebook):
    assert notebook.evaluate("passed.length = 0, lab.open(17)")
    notebook.click("[data-lab=once]")
    wait(notebook, "lab.now === 1")
    notebook.keyboard.press("d")
    wait(notebook, "lab.now === 2")
    for key in ("x", "b", "Control+s"):
        notebook.keyboard.press(key)
    assert notebook.evaluate("passed") == ["Control", "s"]


def test_cells_of_one_widget_do_not_take_each_other_s_answers(notebook):
    both = "[lab.open(3), labs[1].open(5)]"
    assert notebook.evaluate(f"Promise.all({both})") == [True, True]
    assert notebook.evaluate("[lab.number, labs[1].number]") == [3, 5]


def test_a_cell_that_is_cleared_listens_no_longer(notebook):
    notebook.evaluate("clears[2](), labs.forEach((lab) => lab.editor.pressed.add('a'))")
    assert notebook.evaluate("listening()") == 2 and notebook.evaluate("labs[1].open(5)")
    notebook.evaluate("dispatchEvent(new Event('blur'))")
    assert notebook.evaluate("labs.map((lab) => lab.editor.pressed.size)") == [0, 0, 1]


@pytest.mark.parametrize("level", [ROOM, np.int64(17)])
def test_the_notebook_s_widget_answers_its_page(level):
    pytest.importorskip("anywidget", reason="anywidget is not installed")
    widget = astray.lab.show("maze-corner", level)
    sent = []
    widget.send = lambda answer: sent.append(json.loads(json.dumps(answer)))
    widget._handle_custom_msg('{"id": 4, "kind": "hello"}', [])
    assert sent[-1]["id"] == 4 and sent[-1]["start"]["level"] == level
    assert {"app.js", "index.html", "rules/maze.js"} <= widget.modules.keys()


def test_a_mistake_of_the_lab_is_told_in_the_cell_that_waits_for_an_answer(monkeypatch):
    def fails(*_):
        raise KeyError("nobody reckoned with this")

    monkeypatch.setattr(session, "ANSWERS", {"level": fails})
    (answer,) = Session(usual_lab()).answers('{"id": 7, "kind": "level"}')
    assert answer["id"] == 7 and "the lab itself failed: KeyError" in answer["error"]


def test_a_notebook_shows_what_it_is_asked_for_or_nothing():
    maze = games.find("maze")
    level = Level.from_text(maze, maze.variant("anywhere-small"), ROOM)
    for wrong in ({"game": "coinrun"}, {"variant": "corner-small"}):
        with pytest.raises(ValueError, match=r"got game=.* and a level of maze: anywhere, in 7"):
            astray.lab.show("maze-corner", level, **wrong)
    for level, said in ((-1, "from 0 to"), (3.0, "int or str"), ("..G\n.#.\n@..", "3 x 3 cells")):
        with pytest.raises(ValueError, match=said):
            astray.lab.show("maze-corner", level)
    with pytest.raises(TypeError, match="difficulty"):
        astray.lab.show("maze-corner", 3, difficulty="corner-small")
