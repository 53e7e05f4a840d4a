"""Take the pictures of the lab on its page, in a browser: python docs/lab_pictures.py.

Each is of a level, and of what was done in it. The browser is that of the tests of the lab.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parent / "tests"))

from astray.lab.serving import make_lab  # noqa: E402
from helpers.browsed import browser, lab_served, opened, wait  # noqa: E402

SIZE = {"width": 1120, "height": 800}
MOUSE = "agent=maze-corner&game=maze&variant=anywhere-small&level=17"
RUNNER = "agent=coin-end&game=coinrun&variant=coin-anywhere&level=3"


def mouse(page: Any) -> None:
    """Let the mouse walk, show the values, and go back to its fourth step."""
    page.locator("[data-lab=heat]").select_option("value")
    walked(page, 4)


def runner(page: Any) -> None:
    """Let the runner play, and show its sixtieth step."""
    walked(page, 60)


def splay(page: Any) -> None:
    """Play an episode for every place of the cheese, and check the caption of the picture."""
    page.locator("[data-lab=splay]").click()
    wait(page, "lab.splay.size && !lab.part('unsplay').hidden")
    wait(page, r"/^(\d+) of \1 places/.test(lab.part('counts').textContent)")
    rows = page.locator("[data-lab=counts] .bar").all_text_contents()
    (found,) = (row.split("corner")[1].split(" (")[0] for row in rows if "corner" in row)
    said = f"the corner first from {found} places"
    if said not in (FOLDER / "lab.md").read_text("utf-8"):
        raise ValueError(f"the caption in docs/lab.md must say: {said}")


def walked(page: Any, step: int) -> None:
    """Hand over to the agent until it is done, and go to a step of the episode."""
    page.locator("[data-lab=speed]").select_option("10")
    page.locator("[data-lab=hand]").click()
    wait(page, "!lab.running")
    page.evaluate(f"lab.go({step})")


PICTURES: dict[str, tuple[str, str, Callable[[Any], None]]] = {
    "lab-maze": (MOUSE, "light", mouse),
    "lab-coinrun": (RUNNER, "dark", runner),
    "lab-splay": (MOUSE, "light", splay),
}


def main() -> None:
    """Write each picture beside the page."""
    with browser() as shown, lab_served(make_lab("maze-corner", {})) as address:
        for name, (link, theme, act) in PICTURES.items():
            where = f"{address}#{link}"
            with opened(shown, where, viewport=SIZE, color_scheme=theme) as (page, _):
                page.locator("[data-lab=skip]").click()
                act(page)
                page.wait_for_timeout(1000)  # arrows come in parts
                page.mouse.move(0, 0)
                page.screenshot(path=FOLDER / f"{name}.png")
                print(f"{name}.png: {SIZE['width']} x {SIZE['height']}")


if __name__ == "__main__":
    main()
