"""Record the mouse of the first page, in training and in a test: python docs/demo.py.

Its training had no level of this number.
"""

from pathlib import Path

import astray
from astray.analysis import video

LEVEL, LONGEST, PIXELS, FPS = 100_055, 16, 288, 4
MAZES = {"corner-small": "in training", "anywhere-small": "in a test"}


def main() -> None:
    """Write the GIF beside the page."""
    mouse = astray.load_agent("maze-corner")
    how = {"pixels": PIXELS, "longest": LONGEST}
    mazes = [video.play(mouse, "maze", maze, LEVEL, **how).frames for maze in MAZES]
    frames = video.beside(*mazes, captions=[*MAZES.values()])
    held = [*range(len(frames)), *[len(frames) - 1] * (2 * FPS)]  # two seconds at the end
    video.write_gif(frames[held], Path(__file__).parent / "maze-corner.gif", FPS)


if __name__ == "__main__":
    main()
