"""The lab in a notebook: the page as a widget, and the answers that it gets there."""

import pytest

from astray.lab.notebook import LOADER, modules
from astray.lab.serving import make_lab
from astray.lab.session import Session
from helpers.browsed import ROOM, wait


def test_the_widget_of_a_notebook_is_the_same_page(chrome, static):
    session, lab = None, make_lab("maze-corner", {})
    session = Session(lab)
    context = chrome.new_context()
    page = context.new_page()
    page.expose_function("kernel", lambda text: list(session.answers(text)))
    page.goto(f"{static}data/index.json")  # any page without scripts of its own
    page.evaluate(
        """async ([loader, modules]) => {
          const heard = [];
          const model = {
            get: (name) => ({ modules })[name],
            on: (_, hear) => heard.push(hear),
            send: async (text) => {
              for (const answer of await kernel(text)) heard.forEach((hear) => hear(answer));
            },
          };
          const address = URL.createObjectURL(new Blob([loader], { type: "text/javascript" }));
          const { default: widget } = await import(address);
          const el = document.createElement("div");
          document.body.replaceChildren(el);
          await widget.render({ model, el });
          globalThis.lab = el.lab;
        }""",
        [LOADER.read_text(), modules()],
    )
    wait(page, "lab.ready && lab.fields.size > 0")
    assert page.evaluate("(level) => lab.open(level)", ROOM)
    wait(page, "lab.fields.size > 0")
    assert page.evaluate("lab.text") == ROOM
    context.close()


def test_the_notebook_s_widget_answers_its_page():
    pytest.importorskip("anywidget", reason="anywidget is not installed")
    import astray.lab

    widget = astray.lab.show("maze-corner", ROOM)
    sent = []
    widget.send = lambda answer: sent.append(answer)
    widget._handle_custom_msg('{"id": 4, "kind": "hello"}', [])
    assert sent[-1]["id"] == 4 and sent[-1]["start"]["level"] == ROOM
    assert {"app.js", "index.html", "rules/maze.js"} <= widget.modules.keys()
