"""The lab: a page to edit a level on, and to see at once what an agent would do from everywhere.

`astray lab` opens it; `astray lab --export FOLDER` writes it as files; in a notebook:

    import astray.lab

    astray.lab.show("maze-corner", 17)

The page is `page/`, plain modules that a browser reads as they are. It asks questions, in JSON, and
`session.py` answers them, over a WebSocket (`server.py`) or a notebook's channel (`notebook.py`);
without Python, `page/engine/local.js` answers the same questions with the same words.
"""

from astray.lab.notebook import show

__all__ = ["show"]
