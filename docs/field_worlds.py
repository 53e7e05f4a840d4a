"""Draw the pictures of docs/field-worlds.md: python docs/field_worlds.py."""

from pathlib import Path

import numpy as np
from PIL import Image

from astray.envs.vector import GameVectorEnv

FOLDER = Path(__file__).parent / "field-worlds"
SIDE, GAP = 224, 8  # pixels
MAGENTA = (255, 0, 255)  # a colour that no picture has
PAIRS = {  # a training and a test variant of each world
    "pottery": ("corner", "anywhere"),
    "monsters": ("short", "calm"),
    "follow": ("expert", "anti-expert"),
    "trees": ("life", "season"),
    "lavaland": ("dry", "lava"),
    "bridge": ("middle", "up"),
    "supervisor": ("watched", "absent"),
    "box": ("bare", "boxes"),
    "tomatoes": ("bare", "bucket"),
    "boat": ("race", "backwards"),
}
LEVEL, STEPS = 3, 12  # of a level, played by chance so long that something is to be seen


def picture(game: str, variant: str) -> np.ndarray:
    """Return a level of a variant, [SIDE, SIDE, 3] uint8."""
    env = GameVectorEnv(game, variant, 1, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": LEVEL})
    if game in ("follow", "trees", "tomatoes"):
        for action in np.random.default_rng(LEVEL).integers(len(env.game.actions), size=STEPS):
            env.step(np.array([action]))
    return env.picture(SIDE)[0]


def main() -> None:
    """Write one picture a world."""
    FOLDER.mkdir(exist_ok=True)
    for game, pair in PAIRS.items():
        one, two = (picture(game, variant) for variant in pair)
        between = np.full((SIDE, GAP, 3), MAGENTA, np.uint8)
        sheet = Image.fromarray(np.concatenate([one, between, two], 1)).quantize(64)
        gap = sheet.getpixel((SIDE, 0))  # transparent, for light and dark pages
        sheet.save(FOLDER / f"{game}.png", optimize=True, transparency=gap)


if __name__ == "__main__":
    main()
