"""The lab in a notebook: the same page over the notebook's own channel."""

import functools
from pathlib import Path
from typing import Any

from astray import imports
from astray.acting import Policy
from astray.lab.server import files
from astray.lab.worlds import PAGE
from astray.level import Level

LOADER = PAGE / "widget.js"


def show(
    agent: str | Path | Policy | None = None,
    level: int | str | Level = 0,
    *,
    game: str | None = None,
    variant: str | None = None,
) -> Any:
    """Show the lab as a widget in Jupyter, Colab, VS Code or Marimo.

    Args:
        agent: Name, run folder or policy. None is the first available one, or no agent where a game
            or a `Level` is given.
        level: Number, drawing or `Level`, which has its own game and variant.
        game: Name, which a policy needs.
        variant: Name; None for the agent's test variant.

    Raises:
        ImportError: If anywidget is not installed.
        ValueError: If a setting is invalid, or no such variant has the level.
    """
    from astray.lab.serving import make_lab
    from astray.lab.session import Session

    start: dict[str, Any] = {"game": game, "variant": variant, "level": level}
    if isinstance(level, Level):
        own, named = level.game.name, level.game.variants.items()
        names = [n for n, one in named if one == level.variant and variant in (None, n)]
        if not names or game not in (None, own):
            raise ValueError(
                f"a level's variant must be one of its game's by name, and those given, to be "
                f"shown; got {game=}, {variant=} and a level of {own}: {level.variant.about}"
            )
        start |= {"game": own, "level": level.to_json(), "variant": names[0]}
    lab = make_lab(agent, start)
    session = Session(lab)
    widget = _widget_class()(modules=modules())

    def hear(_: Any, content: Any, buffers: Any) -> None:
        with lab.lock:
            for answer in session.answers(content):
                widget.send(answer)

    widget.on_msg(hear)
    return widget


def modules() -> dict[str, str]:
    """Return the page's modules by path, and its markup, for a loader that cannot fetch files."""
    wanted = (".js", "index.html")
    return {path: data.decode() for path, (data, _) in files().items() if path.endswith(wanted)}


@functools.cache
def _widget_class() -> type:
    with imports.extra("notebook", "the lab in a notebook needs anywidget"):
        import anywidget
        import traitlets

    class Lab(anywidget.AnyWidget):
        """The lab's page in a notebook's cell."""

        _esm = LOADER.read_text("utf-8")
        _css = (PAGE / "lab.css").read_text("utf-8")
        modules = traitlets.Dict().tag(sync=True)

    return Lab
