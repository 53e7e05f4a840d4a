"""Retargeting: lead an agent elsewhere by setting activations, compared with moving the object.

    follow = following(agent, "anywhere-easy", range(20), "block2.residual1")
    clamp = Clamp("block2.residual1", tuple(follow["channel"][:8]), tuple(follow["there"][:8]))
    rows = retarget(agent, "anywhere-easy", range(100, 200), clamp)

Mini et al. (2023, arXiv 2310.08043) found eleven channels of their mouse by eye. Here channels are
found in any network with places, by their correlation with the object's place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from astray import games
from astray.acting import Levels
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.trained import Agent
from astray.game import Variant
from astray.insight.activations import activations, check_layers
from astray.insight.fields import Places, drawn, places_of, states_at
from astray.insight.interventions import patch, place
from astray.level import Cell, Level
from astray.validation import MOST, bounded, of_kind, shown

AS_IS, CLAMPED, ALONE, MOVED = "as it is", "clamped", "clamped, no object", "object moved"
WAYS = (AS_IS, CLAMPED, ALONE, MOVED)


@dataclass(frozen=True)
class Clamp:
    """Values to set in some channels at one place of a layer."""

    layer: str
    channels: tuple[int, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("channels", "values"):
            of_kind(name, getattr(self, name), Sequence)
        if len(self.channels) != len(self.values) or not self.channels:
            raise ValueError(
                f"a clamp must have a value for each channel, at least one; got "
                f"{len(self.channels)} channels and {len(self.values)} values"
            )


def following(
    agent: Agent,
    variant: str | Variant,
    levels: Levels,
    layer: str,
    name: str = "goal",
    *,
    places: int = 16,
    seed: int = 0,
) -> pl.DataFrame:
    """Rank channels by how much their activation follows an object.

    The object is moved about each level while the agent stays. At every cell of the layer a
    channel's activation is compared with its mean over the object's places, so fixed walls do not
    count.

    Columns: channel; correlation, over places, levels and cells of the layer, between that
    difference and whether the object is in the middle of that cell; there and elsewhere, the mean
    activation at the object and at other cells.

    Args:
        name: Object; Maze's cheese is its "goal".
        places: Places of the object in each level, drawn with `seed`.

    Raises:
        ValueError: If the layer has no places, or the agent sees only part of the world.
    """
    bounded("places", places, 2, MOST)
    shape = check_layers(agent, [layer])[layer]
    game = games.find(agent.game)
    variant = game.variant(variant)
    place(agent, variant, (0, 0), shape)  # which says why there is none
    sums = np.zeros((4, shape[0]))  # of xx, yy, xy, and of what is given at the object
    elsewhere, count, seen = np.zeros(shape[0]), 0, 0
    for k, level in enumerate(drawn(game, variant, levels)):
        everywhere = level.splay(name) if level.where(name) else []
        chosen = np.random.default_rng([seed, k]).permutation(len(everywhere))[:places]
        if len(chosen) < 2:
            continue
        family = [everywhere[number] for number in sorted(chosen)]
        states = np.array([one.state(solvable=False) for one in family], game.state)
        given = activations(agent, observe(agent, variant, states), [layer])[layer]
        given = given.astype(np.float64)
        is_at = np.zeros((len(family), *shape[1:]))
        for row, one in enumerate(family):
            is_at[(row, *place(agent, variant, one.where(name)[0], shape))] = 1
        x, y = given - given.mean(0), np.broadcast_to((is_at - is_at.mean(0))[:, None], given.shape)
        axes, products = (0, 2, 3), (x * x, y * y, x * y, given * is_at[:, None])
        found = [product.sum(axes) for product in products]
        sums += found
        elsewhere += given.sum(axes) - found[-1]
        count, seen = count + is_at.size, seen + len(family)
    if not seen:
        raise ValueError(f"no level has a {name} that can be elsewhere")
    xx, yy, xy, there = sums  # the sums of x and of y are 0
    correlation = xy / np.sqrt(np.maximum(xx * yy, np.finfo(float).tiny))
    return pl.DataFrame(
        {
            "channel": np.arange(shape[0]),
            "correlation": correlation,
            "there": there / seen,
            "elsewhere": elsewhere / (count - seen),
        }
    ).sort(pl.col("correlation").abs(), descending=True)


def retarget(
    agent: Agent,
    variant: str | Variant,
    levels: Levels,
    clamp: Clamp,
    name: str = "goal",
    *,
    targets: int = 12,
    how: Sequence[str] = WAYS,
    seed: int = 0,
) -> pl.DataFrame:
    """Measure an agent's preference for ways to target cells, with and without a clamp.

    A row per level, target and method has level (index in `levels`), x and y of the target, steps
    of the way, how (of WAYS: nothing; the clamp at the target, with the object in place; the clamp
    in a level without the object; the object moved to the target) and path, the geometric mean of
    the step probabilities of the shortest way from the beginning. Targets behind the object are
    left out.

    Args:
        targets: Cells of each level, drawn with `seed` from the object's possible places.
        how: Methods to try; each costs time.

    Raises:
        ValueError: If an argument is invalid.
    """
    bounded("targets", targets, 1, MOST)
    unknown = [one for one in how if one not in WAYS]
    if unknown or not how:
        raise ValueError(f"how must be some of {', '.join(WAYS)}; got {shown(how)}")
    of_kind("clamp", clamp, Clamp)
    shape = check_layers(agent, [clamp.layer])[clamp.layer]
    game = games.find(agent.game)
    variant = game.variant(variant)
    rows = []
    for k, level in enumerate(drawn(game, variant, levels)):
        (around,), _ = places_of([level])
        at = level.where(name)
        cells = [one.where(name)[0] for one in level.splay(name)] if at else []
        ways = {cell: around.way(cell) for cell in cells}
        open_ = [cell for cell, way in ways.items() if len(way) > 1 and at[0] not in way]
        random = np.random.default_rng([seed, k])
        for number in sorted(random.permutation(len(open_))[:targets]):
            cell = open_[number]
            told = {"level": k, "x": cell[0], "y": cell[1], "steps": len(ways[cell]) - 1}
            for one, path in _paths(agent, around, ways[cell], clamp, shape, name, how):
                rows.append(told | {"how": one, "path": path})
    if not rows:
        raise ValueError(f"no level has a {name} and a cell to send the agent to")
    return pl.DataFrame(rows)


def _paths(
    agent: Agent,
    around: Places,
    way: list[Cell],
    clamp: Clamp,
    shape: tuple[int, ...],
    name: str,
    how: Sequence[str],
) -> Iterator[tuple[str, float]]:
    """Return the preference for a way under each of some WAYS."""
    level = around.level
    gone = level.removed(name)
    sees = {AS_IS: level, CLAMPED: level, ALONE: gone, MOVED: gone.added(name, way[-1])}
    at = place(agent, level.variant, way[-1], shape)
    for one in how:
        if one in (CLAMPED, ALONE):
            with patch(agent, clamp.layer, clamp.channels, np.array(clamp.values), at):
                yield one, path_along(agent, sees[one], way, around)
        else:
            yield one, path_along(agent, sees[one], way, around)


def path_along(agent: Agent, level: Level, way: list[Cell], around: Places) -> float:
    """Return the geometric mean of the step probabilities along the cells of a way.

    Args:
        around: Places of the level, or of one with the same walls.
    """
    policy, _ = policy_and_value(agent, observe(agent, level.variant, states_at(level, way[:-1])))
    chances = [*map(around.chance, policy, way[:-1], way[1:])]
    return float(np.exp(np.log(np.maximum(chances, np.finfo(float).tiny)).mean()))
