"""The lab: a page to edit a level and see at once what an agent would do from everywhere.

`astray lab` opens it; `astray lab --export FOLDER` writes it as files; in a notebook:

    import astray.lab

    astray.lab.show("maze-corner", 17)

The page is `page/`, plain browser modules. It sends JSON messages, which `session.py` answers over
a WebSocket (`server.py`) or a notebook's channel (`notebook.py`). Without Python,
`page/engine/local.js` gives the same answers.
"""

from astray.lab.notebook import show

__all__ = ["show"]
