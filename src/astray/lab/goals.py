"""Evidence for goals in an episode, and the goals that agents reach for moved objects."""

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from astray.acting import LASTING, Levels, Policy, initial_states
from astray.agency import measure
from astray.agency.gridworld import World as Gridworld
from astray.agency.measure import CALIBRATED
from astray.agency.online import Growth, measure_online
from astray.analysis.agency import named_places
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import reached
from astray.analysis.policies import Random, Walk
from astray.analysis.runs import play_all
from astray.envs.vector import quickest
from astray.game import Game, Outcome, Shift, Variant
from astray.grid import world_of
from astray.lab.agents import Shown, rounded
from astray.lab.messages import LONGEST
from astray.lab.worlds import Episode, World
from astray.level import Level
from astray.outcome import NEITHER, OTHER
from astray.record import NEVER

PATIENCE = 40  # steps in one place; to jump, a runner may wait, and who picks up stands still
PLACES = 400  # at most, that a thing is put to
TELLING = 5  # steps to a goal; the posterior of shorter ways tells goals hardly apart
FIRST_FEW = 50  # levels among which one that distinguishes the goals is looked for
AT_SIGHT = 8  # levels among which one is looked for where it is not known whether they do
SOON, LATE = 48, 200  # steps in which the agent reaches a goal there; LATE if it is a count
BETA = CALIBRATED.beta  # of the prior of how often an agent errs
TOGETHER = 16  # places that are played at once: a level's draws depend on which of them it is


def posterior(episode: Episode, shift: Shift) -> dict[str, Any]:
    """Return each goal's posterior after every step, and the probability of an agent.

    It covers the steps up to the last reached goal; later ones have no evidence.

    Raises:
        ValueError: If the game has no cells, or no goal has a cell in this level.
    """
    world = episode.world
    named = named_places(world.game, world.begin, shift)
    if all(place is None for place in named.values()):
        listed = ", ".join(named)
        raise ValueError(f"In this level, no goal is reached by going to one cell: {listed}.")
    gridworld = Gridworld(world.game.cells.free(world.begin))
    way = [tuple(np.floor(_centre(world, s)).astype(int).tolist()) for s in episode.states]
    ends = [way.index(tuple(place)) for place in named.values() if place and tuple(place) in way]
    last = max(ends, default=len(way) - 1)
    cells = way[: last + 1]
    one = measure.Episode(gridworld, gridworld.path(cells), named[shift.intended])
    growth = measure_online(one, replace(CALIBRATED, goals="accessible"))
    moved = [here != there for here, there in itertools.pairwise(cells)]
    counted = np.cumsum([0, *moved])  # standing still is no step of a trajectory
    return _told(growth, counted, named)


def distinguishes(world: World, shift: Shift) -> bool | None:
    """Return whether a level distinguishes the goals of a shift; None if it is not known."""
    levels = {"shown": world.level} if world.number is None else [world.number]
    try:
        found = distinguishing(world.game, world.variant, shift, levels)
    except ValueError:  # as the cheese cannot be reached
        return None
    return None if found is None else bool(found)


def distinguishing(game: Game, variant: Variant, shift: Shift, levels: Levels) -> list[int] | None:
    """Return the levels that distinguish the goals; None if no script can soon find them out."""
    if game.real_time or not shift.proxies or {shift.intended, *shift.proxies} - {*game.walked}:
        return None
    played = play_all(game, "shown", variant, shift, levels, [], longest=LONGEST)
    return played.filter("distinguishing", policy=Random().name)["level"].to_list()


def typical(
    game: Game, variant: Variant, shift: Shift, agent: Policy, first: int = 0, few: int = FIRST_FEW
) -> tuple[int, str]:
    """Return a large level in which the agent soon shows its usual goal, and why it was chosen.

    The usual goal is reached first in most levels that distinguish the goals; where they are not
    known, it is a proxy, or without one another end. If possible, `TELLING` steps lead to it. The
    level is one of at most `few` from `first` on.
    """
    known = distinguishing(game, variant, shift, range(first, first + min(few, FIRST_FEW)))
    levels = known or range(first, first + min(few, AT_SIGHT))
    instead = {goal: game.goals[goal] for goal in shift.proxies} or dict(game.ends)
    ends = {shift.intended: game.goals[shift.intended]} | instead
    late = [name for name, end in ends.items() if not isinstance(end, str)]
    first_ends = _outcomes(agent, game, variant, levels, ends, LATE if late else SOON)
    played = dict(zip(levels, first_ends, strict=True))
    pursued = (*instead, *([shift.intended] if known else []))
    shown = Counter(goal for goal, _ in played.values() if goal in pursued)
    said = ""
    if not shift.proxies:
        said = f"No level distinguishes goals, as “{shift.intended}” has no proxy. "
    elif late:
        listed = " and ".join(f"“{goal}”" for goal in late)
        said = f"No level distinguishes {listed}, as only the end of an episode shows them. "
    if not shown:
        listed = " or ".join(f"“{goal}”" for goal in pursued) or "another end"
        tried = f"Level {levels[0]} is the first of {len(levels)} that were tried"
        return levels[0], f"{said}{tried}; the agent came to {listed} in none."
    usual, count = shown.most_common(1)[0]
    found = {n: time for n, (goal, time) in played.items() if goal == usual}
    begun = initial_states(game, variant, levels)
    size = {s.level: game.places.stand(s).sum() for s in begun if game.places}
    chosen = min(found, key=lambda n: (-min(found[n], TELLING), -size.get(n, 0), found[n]))
    does = f"reaches “{usual}” first" if usual in game.event_goals else f"comes to “{usual}”"
    usually = known and 2 * count > len(known)
    most = ", as in most levels that distinguish the goals" if usually else ""
    largest = [n for n in size if size[n] == max(size.values())]
    large = "; it is among the largest levels tried" if chosen in largest != [*size] else ""
    return chosen, f"{said}Level {chosen} was chosen: the agent {does} here{most}{large}."


def _outcomes(
    agent: Policy, game: Game, variant: Variant, levels: Levels, ends: Mapping[str, Outcome],
    longest: int | None = None,
) -> list[tuple[str, int]]:  # fmt: skip
    """Return the first of `ends` in each episode, and its number of steps until then."""
    events = [end for end in ends.values() if isinstance(end, str)]
    until = events if len(events) == len(ends) else []
    played = evaluate(agent, game, variant, levels, until=until, longest=longest)
    rows = played.select("length", **{name: reached(end) for name, end in ends.items()}).to_dicts()
    times = [{name: row[name] for name in ends if row[name] is not None} for row in rows]
    return [min(row.items(), key=lambda one: one[1], default=(NEITHER, 0)) for row in times]


def _told(growth: Growth, counted: np.ndarray, named: dict[str, Any]) -> dict[str, Any]:
    cells = [cell for cell in growth.goals if not isinstance(cell, str)]
    rates = growth.posterior[counted]
    placed = {goal: tuple(place) for goal, place in named.items() if place is not None}
    grown = {g: rates[:, cells.index(place)] for g, place in placed.items() if place in cells}
    grown[OTHER] = np.maximum(1 - sum(grown.values(), np.zeros(len(counted))), 0)
    return {
        "goals": {goal: rounded(rate) for goal, rate in grown.items()},
        "agent": rounded(growth.agent[counted]),
        "cells": cells,
        "rates": np.round(rates, 5).tolist(),
    }


def splay(
    agent: Shown, world: World, thing: str, at: tuple[int, int] | None, shift: Shift, draws: int
) -> Iterator[dict[str, Any]]:
    """Yield the first goal that the agent reaches for every place of an object, in batches.

    Goals that only the end of an episode shows are counted there.

    Values are numbers of episodes out of `draws`, which differ in the sampled actions. ValueError
    is raised if there are too many places, or episodes may last for ever.
    """
    levels = world.level.splay(thing, at)
    if (lasts := world.variant.time_limit) > LASTING:
        told = f"a splay plays whole episodes, and here one lasts up to {lasts:,} steps"
        raise ValueError(f"{told}: hand over to the agent in this level, or choose another variant")
    if len(levels) > PLACES:
        raise ValueError(f"a splay is of at most {PLACES} places; here are {len(levels)}")
    first, of = agent.seed, len(levels)
    ends = {goal: world.game.goals[goal] for goal in (shift.intended, *shift.proxies)}
    for begin in range(0, of, TOGETHER):
        some = levels[begin : begin + TOGETHER]
        outcomes = [dict[str, int]() for _ in some]
        for draw in range(draws):
            agent.seed = first + draw
            named = {str(k): level for k, level in enumerate(some)}
            played = _outcomes(agent, world.game, world.variant, named, ends)
            for k, (outcome, _) in enumerate(played):
                outcomes[k][outcome] = outcomes[k].get(outcome, 0) + 1
        where = [_place(level, thing, at, world) for level in some]
        yield {"cells": where, "outcomes": outcomes, "of": of}


def _place(level: Level, thing: str, at: tuple[int, int] | None, world: World) -> tuple[int, int]:
    """Return the current place of the object moved from `at` in `world`."""
    there = {*level.where(thing)}
    new = there - {*world.level.where(thing)}
    return min(new) if new else at or min(there)


def route(episode: Episode, goal: str) -> dict[str, Any]:
    """Return the best way to a goal from the episode's last state, and the first object on it.

    The way is walked to find its cells, the first object that disappears, and the number of steps.

    Raises:
        ValueError: If the episode has ended, or there is no such way.
    """
    world, game, event = episode.world, episode.world.game, episode.world.game.event(goal)
    if episode.ended:
        raise ValueError("the episode has ended: go back a step, and ask from there")
    policy = Walk(goal, quickest(game))
    walk = Episode(world, [episode.state]).play(policy, LONGEST)
    (s,) = episode.state
    before = _things(world, s)
    cells, takes, taken_at = [_centre(world, s).round(3).tolist()], None, None
    while s[event] == NEVER and (step := next(walk, None)):
        (s,) = step.after
        cells.append(_centre(world, s).round(3).tolist())
        gone = before - _things(world, s) or _at_end(world, s, goal, before)
        if world_of(game):  # where other things change by themselves
            gone = {one for one in gone if one[:2] == (s["x"], s["y"])}
        if gone and takes is None:
            takes, taken_at = sorted(gone), len(cells) - 1
        if len(cells) > PATIENCE and all(cell == cells[-1] for cell in cells[-PATIENCE:]):
            break  # the goal was reached, or cannot be
    if s[event] == NEVER and not s.ended:
        raise ValueError(f"there is no way to {goal!r} from here that the solver knows")
    return {"cells": cells, "takes": takes, "steps": taken_at}


def _at_end(
    world: World, s: Any, goal: str, things: set[tuple[int, int, int]]
) -> set[tuple[int, int, int]]:
    """Return the goal's object that ended the episode, such as a coin: it is still drawn."""
    objects = world.game.editing.OBJECTS if world.game.editing else {}
    if not s.ended or s[world.game.event(goal)] == NEVER or goal not in objects:
        return set()
    code = world.game.editing.LEGEND[objects[goal]]
    x, y = _centre(world, s)
    away = {one: abs(one[0] + 0.5 - x) + abs(one[1] + 0.5 - y) for one in things}
    return set(sorted((one for one in things if one[2] == code), key=away.__getitem__)[:1])


def _centre(world: World, s: Any) -> np.ndarray:
    """Return the agent's centre, [2], in a state or in states [1]."""
    return world.game.places.centre(np.array(s, world.game.state).reshape(1))[0]


def _things(world: World, s: Any) -> set[tuple[int, int, int]]:
    """Return the cells of collectable objects, and the objects."""
    if not world.game.editing:
        return set()
    legend, objects = world.game.editing.LEGEND, world.game.editing.OBJECTS
    wanted = {legend[char] for name, char in objects.items() if not name.startswith("walker")}
    grid = s["cell"] if world_of(world.game) else world.game.editing.grid(s)  # without movers
    return {(int(x), int(y), int(grid[y, x])) for y, x in np.argwhere(np.isin(grid, [*wanted]))}
