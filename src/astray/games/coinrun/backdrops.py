"""Computed backgrounds of CoinRun: 49 landscapes, 7 kinds in 7 lights, and 13 skies.

They need no mathematical library: heights are smooth steps between hash values, so every machine
computes the same bytes.
"""

from collections.abc import Callable

import numpy as np

WIDE, HIGH = 64, 32  # cells; to the sides they repeat, above there is more of the same sky
KINDS, LIGHTS, SKIES = 7, 7, 13
COUNT = KINDS * LIGHTS + SKIES
# Of each light: the sky above and at the horizon, and what is near; far things are hazier.
PALETTES = np.array(
    [
        [(126, 190, 238), (214, 238, 250), (110, 164, 106)],  # noon
        [(150, 200, 225), (250, 240, 214), (152, 160, 92)],  # morning
        [(238, 168, 140), (252, 222, 176), (150, 104, 112)],  # sunset
        [(120, 120, 180), (232, 194, 214), (126, 104, 160)],  # dusk
        [(34, 42, 78), (84, 98, 142), (40, 50, 84)],  # night
        [(176, 192, 200), (226, 232, 234), (132, 148, 150)],  # mist
        [(116, 206, 200), (226, 248, 226), (94, 156, 150)],  # lagoon
    ]
)


def render(scale: float) -> np.ndarray:
    """Return all backgrounds at `scale` pixels per cell, [COUNT, height, width, 3] uint8."""
    height, width = max(1, round(HIGH * scale)), max(1, round(WIDE * scale))
    # Each pixel is the mean of four, or edges would be jagged.
    pictures = np.empty((COUNT, height, width, 3), np.uint8)
    for k in range(COUNT):
        fine = _render(k, 2 * height, 2 * width).astype(np.uint16)
        rows = fine[0::2] + fine[1::2]
        pictures[k] = (rows[:, 0::2] + rows[:, 1::2]) >> 2
    return pictures


def _render(k: int, height: int, width: int) -> np.ndarray:
    up = (np.arange(height)[::-1] + 0.5) * HIGH / height  # cells above the world's floor
    across = (np.arange(width) + 0.5) * WIDE / width
    if k >= KINDS * LIGHTS:
        return _space(k - KINDS * LIGHTS, up, across)
    kind, light = k // LIGHTS, k % LIGHTS
    top, horizon, near = PALETTES[light]
    layers = LANDSCAPES[kind](across, 1000 * k)
    haze = np.linspace(0.35, 1, len(layers))[:, None]
    fraction = np.clip(up / HIGH, 0, 1)[:, None]
    sky = (horizon + (top - horizon) * fraction).astype(np.uint8)
    cloud = (sky.astype(np.uint16) * 2 + 255) // 3
    colours = np.concatenate([sky, cloud, horizon + (near - horizon) * haze]).astype(np.uint8)
    which = np.arange(height)[:, None] + height * _clouds(across, up, k)  # of the colours
    for layer, heights in enumerate(layers):
        np.copyto(which, 2 * height + layer, where=up[:, None] < heights)
    return colours.take(which, 0)


def _hash(seed: int, count: int) -> np.ndarray:
    """Return `count` hash values in [0, 1)."""
    z = np.arange(count, dtype=np.uint64) + np.uint64(seed * 7919 + 1)
    z = (z ^ (z >> np.uint64(15))) * np.uint64(0x2C1B3C6D) & np.uint64(0xFFFFFFFF)
    z = (z ^ (z >> np.uint64(12))) * np.uint64(0x297A2D39) & np.uint64(0xFFFFFFFF)
    z = z ^ (z >> np.uint64(15))
    return z.astype(np.float64) / 2**32


def _waves(across: np.ndarray, seed: int, count: int, sharp: bool = False) -> np.ndarray:
    """Return smooth periodic heights from 0 to 1 with `count` knots over the width."""
    knots = _hash(seed, count)
    at = across * count / WIDE
    k = at.astype(int)
    t = at - k
    if not sharp:
        t = t * t * (3 - 2 * t)
    return knots[k % count] * (1 - t) + knots[(k + 1) % count] * t


def _teeth(across: np.ndarray, seed: int, count: int) -> np.ndarray:
    """Return adjacent triangles of different heights, from 0 to 1."""
    at = across * count / WIDE
    k = at.astype(int)
    return (0.4 + 0.6 * _hash(seed, count)[k % count]) * (1 - abs(2 * (at - k) - 1))


def _blocks(across: np.ndarray, seed: int, count: int) -> np.ndarray:
    """Return adjacent boxes of different heights, from 0 to 1."""
    return _hash(seed, count)[(across * count / WIDE).astype(int) % count]


def _mountains(x: np.ndarray, seed: int) -> list[np.ndarray]:
    far, mid = _waves(x, seed, 12, sharp=True), _waves(x, seed + 1, 8, sharp=True)
    return [far * 15 + 9, mid * 12 + 4, _waves(x, seed + 2, 6) * 5 + 2]


def _forest(x: np.ndarray, seed: int) -> list[np.ndarray]:
    rows = ((24, 8, 8), (16, 8, 4), (10, 7, 1))
    return [
        _teeth(x, seed + k, n) * high + base + 2 * _waves(x, seed + 9, 5)
        for k, (n, high, base) in enumerate(rows)
    ]


def _mesas(x: np.ndarray, seed: int) -> list[np.ndarray]:
    flat = np.clip(_waves(x, seed, 8) * 4 - 1.2, 0, 1)
    near = np.clip(_waves(x, seed + 1, 6) * 4 - 1.5, 0, 1)
    return [flat * 9 + 8, near * 8 + 4, _waves(x, seed + 2, 9) * 2 + 2]


def _islands(x: np.ndarray, seed: int) -> list[np.ndarray]:
    return [
        np.clip(_waves(x, seed, 7) * 16 - 4, 0, 9) + 7,
        np.full_like(x, 7.0),
        np.clip(_waves(x, seed + 1, 9) * 12 - 5, 0, 9) + 1,
    ]


def _in_rows(shape: Callable, *rows: tuple[int, float, float]) -> Callable:
    """Return a landscape of rows: how many there are of a shape, their height, and their base."""
    return lambda x, seed: [
        shape(x, seed + k, n) * high + base for k, (n, high, base) in enumerate(rows)
    ]


LANDSCAPES: tuple[Callable[[np.ndarray, int], list[np.ndarray]], ...] = (
    _in_rows(_waves, (4, 9, 10), (6, 9, 6), (8, 9, 2)), _mountains, _forest,
    _in_rows(_waves, (3, 6, 9), (4, 6, 5), (5, 6, 2), (6, 6, 0)),
    _in_rows(_blocks, (26, 14, 7), (18, 10, 4), (12, 5, 1)), _mesas, _islands,
)  # fmt: skip  # the first are hills, the fourth are dunes, the fifth is a town


def _clouds(across: np.ndarray, up: np.ndarray, k: int) -> np.ndarray:
    """Return a mask [height, width] of clouds: a few rows of flattened discs."""
    clouds = np.zeros((len(up), len(across)), bool)
    where, size = _hash(k + 500, 18).reshape(6, 3), _hash(k + 900, 6)
    for (x, y, _), big in zip(where, size, strict=True):
        for shift in (-1.2, 0, 1.3):
            away = np.abs(across - x * WIDE - shift * (1 + big))
            away = np.minimum(away, WIDE - away) / (1.6 + big)
            high = np.abs(up - 17 - 13 * y) / (0.6 + 0.4 * big)
            rows, columns = np.ix_(high < 1, away < 1)  # the disc lies within these
            clouds[rows, columns] |= away[columns] ** 2 + high[rows] ** 2 < 1
    return clouds


def _space(k: int, up: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return a starry sky with a planet and a hue of its own."""
    tint = np.array([30, 26, 56]) + (60 * _hash(k + 77, 3)).astype(int)
    fraction = np.clip(up / HIGH, 0, 1)[:, None]
    row = (tint * (1.25 - 0.7 * fraction)).astype(np.uint8)
    picture = np.repeat(row[:, None], len(across), 1)
    nebula = _waves(across, k + 40, 5) * 14 + 4
    glow = np.abs(up[:, None] - nebula) < 2 + 2 * _waves(across, k + 41, 7)
    picture[glow] = np.minimum(picture[glow].astype(int) + 16, 255)
    x, y, size = _hash(k + 11, 3) * (40, 10, 3) + (12, 7, 2.5)
    away = (across - x)[None] ** 2 + (up - y)[:, None] ** 2
    picture[away < size * size] = tint + 70
    shade = (across - x - size * 0.4)[None] ** 2 + (up - y - size * 0.3)[:, None] ** 2
    picture[(away < size * size) & (shade < size * size)] = tint + 95
    for a, b, c in _hash(k + 600, 360).reshape(120, 3):
        column, line = int(a * len(across)), int(b * len(up))
        picture[line : line + 2, column : column + 2] = 120 + int(110 * c)
    return picture
