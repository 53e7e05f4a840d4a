"""Pictures of states, to look at."""

import math

import numpy as np

from astray import games
from astray.envs.compiled import NO_RESULTS, NUMBERS, compiled_loop
from astray.envs.loops import AS_SET, DISABLED
from astray.envs.pool import alone
from astray.game import OWN, Game, Variant
from astray.memory import check_memory
from astray.validation import bounded

PICTURES = (1, 4096)  # pixels a side of a picture, at least and at most


def picture(
    game: str | Game, variant: Variant, states: np.ndarray, pixels: int, art: str = OWN
) -> np.ndarray:
    """Return images of `states` [N] at any scale, [N, pixels, pixels, 3] uint8.

    Raises:
        ValueError: If a state or the number of pixels is invalid.
    """
    game = games.find(game)
    variant = game.variant(variant)
    bounded("pixels", pixels, *PICTURES)
    game.check(states, variant, art)
    looks, loop = game.drawn(art), compiled_loop(game, art)
    size = len(states) * 3 * pixels**2 + math.prod(looks.scene_shape(variant, pixels))
    check_memory(size, f"{len(states):,} pictures of {pixels} x {pixels} pixels")
    scene = np.empty((1, *looks.scene_shape(variant, pixels)), np.uint8)
    images = np.empty((len(states), pixels, pixels, 3), np.uint8)
    params, as_set = variant.records(), np.full(1, AS_SET)
    shown = looks.pictures(variant, pixels), False, scene
    for k in range(len(states)):
        one = states[k : k + 1].copy().view(np.ndarray)  # may be written to
        source, seen = (params, NUMBERS, 0, 1, one[:0]), (images[k : k + 1], one, images)
        loop(one, shown, source, (DISABLED, as_set, NUMBERS), seen, NO_RESULTS, *alone())
    return images
