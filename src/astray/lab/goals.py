"""Evidence for goals in an episode, and the goals that agents reach for moved objects."""

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from astray.acting import Levels, Policy, steps
from astray.agency import measure
from astray.agency.gridworld import World as Gridworld
from astray.agency.measure import CALIBRATED
from astray.agency.online import Growth, measure_online
from astray.analysis.agency import named_places
from astray.analysis.policies import Random, Walk
from astray.analysis.runs import play_all
from astray.envs.vector import quickest
from astray.game import Game, Shift, Variant
from astray.lab.agents import Shown, rounded
from astray.lab.messages import LONGEST
from astray.lab.worlds import Episode, World
from astray.level import Level
from astray.record import NEVER

NEITHER = "neither"  # of the goals
OTHER = "another cell"
PLACES = 400  # at most, that a thing is put to
TELLING = 5  # steps to a goal; the posterior of shorter ways tells goals hardly apart
FIRST_FEW = 50  # levels among which one that distinguishes the goals is looked for
AT_SIGHT = 8  # levels among which one is looked for where it is not known whether they do
SOON = 48  # steps in which the agent reaches a goal there
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
    played = play_all(game, "shown", variant, shift, levels, [])
    return played.filter("distinguishing", policy=Random().name)["level"].to_list()


def typical(
    game: Game, variant: Variant, shift: Shift, agent: Policy, first: int = 0
) -> tuple[int, str]:
    """Return the level in which the agent shows its usual goal soonest, and why it was chosen.

    The usual goal is reached first in most levels that distinguish the goals; where they are not
    known, it is a proxy. At least `TELLING` steps lead to it, if possible.
    """
    known = distinguishing(game, variant, shift, range(first, first + FIRST_FEW))
    levels = known or range(first, first + AT_SIGHT)
    played = dict(zip(levels, _outcomes(agent, game, variant, levels, shift, SOON), strict=True))
    pursued = (*shift.proxies, *([shift.intended] if known else []))
    shown = Counter(goal for goal, _ in played.values() if goal in pursued)
    if not shown:
        return levels[0], ""
    usual, count = shown.most_common(1)[0]
    found = {n: time for n, (goal, time) in played.items() if goal == usual}
    chosen = min(found, key=lambda n: (found[n] < TELLING, found[n]))
    usually = known and 2 * count > len(known)
    most = ", as in most levels that distinguish the goals" if usually else ""
    return chosen, f"Level {chosen} was chosen: the agent reaches “{usual}” first here{most}."


def _told(growth: Growth, counted: np.ndarray, named: dict[str, Any]) -> dict[str, Any]:
    cells = [cell for cell in growth.goals if not isinstance(cell, str)]
    rates = growth.posterior[counted]
    grown: dict[str, Any] = {}
    rest = np.ones(len(counted))
    for goal, place in named.items():
        if place is not None and tuple(place) in cells:
            grown[goal] = rates[:, cells.index(tuple(place))]
            rest = rest - grown[goal]
    grown[OTHER] = np.maximum(rest, 0)
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

    Values are numbers of episodes out of `draws`, which differ in the sampled actions. ValueError
    is raised if there are too many places.
    """
    levels = world.level.splay(thing, at)
    if len(levels) > PLACES:
        raise ValueError(f"a splay is of at most {PLACES} places; here are {len(levels)}")
    first, of = agent.seed, len(levels)
    for begin in range(0, of, TOGETHER):
        some = levels[begin : begin + TOGETHER]
        outcomes = [dict[str, int]() for _ in some]
        for draw in range(draws):
            agent.seed = first + draw
            named = {str(k): level for k, level in enumerate(some)}
            played = _outcomes(agent, world.game, world.variant, named, shift, None)
            for k, (outcome, _) in enumerate(played):
                outcomes[k][outcome] = outcomes[k].get(outcome, 0) + 1
        where = [
            level.agent if thing == "agent" else _place(level, thing, at, world) for level in some
        ]
        yield {"cells": where, "outcomes": outcomes, "of": of}


def _place(level: Level, thing: str, at: tuple[int, int] | None, world: World) -> tuple[int, int]:
    """Return the current place of the object moved from `at` in `world`."""
    there = {*level.where(thing)}
    new = there - {*world.level.where(thing)}
    return min(new) if new else at or min(there)


def _outcomes(
    agent: Policy, game: Game, variant: Variant, levels: Levels, shift: Shift, longest: int | None
) -> list[tuple[str, int]]:
    """Return the goal that each episode reaches first, and its number of steps until then."""
    outcomes = [(NEITHER, 0)] * len(levels)
    events = [*game.events_of(shift).values()]
    for step in steps(agent, game, variant, levels, until=events, longest=longest):
        for k, s in zip(step.level[step.ended], step.after[step.ended], strict=True):
            outcomes[k] = first_goal(s, game, shift), int(s["time"])
    return outcomes


def first_goal(s: Any, game: Game, shift: Shift) -> str:
    """Return the goal reached first in state `s`; the intended one in case of a tie."""
    reached = {
        goal: int(s[event]) for goal, event in game.events_of(shift).items() if s[event] != NEVER
    }
    return min(reached, key=lambda goal: reached[goal]) if reached else NEITHER


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
    (s,) = episode.state.view(np.recarray)
    before = _things(world, s)
    cells, takes, taken_at = [_centre(world, s).round(3).tolist()], None, None
    while s[event] == NEVER and not _stands(cells, game) and (step := next(walk, None)):
        (s,) = step.after
        cells.append(_centre(world, s).round(3).tolist())
        gone = before - _things(world, s) or _at_end(world, s, goal, before)
        if gone and takes is None:
            takes, taken_at = sorted(gone), len(cells) - 1
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


def _stands(cells: list[list[float]], game: Game) -> bool:
    """Return whether a walk has ended: the goal was reached or cannot be."""
    patience = 40 if game.real_time else 2  # steps; to jump, a runner may stand and wait
    return len(cells) > patience and all(cell == cells[-1] for cell in cells[-patience:])


def _centre(world: World, s: Any) -> np.ndarray:
    """Return the agent's centre, [2], in a state or in states [1]."""
    return world.game.places.centre(np.array(s, world.game.state).reshape(1))[0]


def _things(world: World, s: Any) -> set[tuple[int, int, int]]:
    """Return the cells of collectable objects, and the objects."""
    if not world.game.editing:
        return set()
    legend, objects = world.game.editing.LEGEND, world.game.editing.OBJECTS
    wanted = {legend[char] for name, char in objects.items() if not name.startswith("walker")}
    grid = world.game.editing.grid(s)
    return {(int(x), int(y), int(grid[y, x])) for y, x in np.argwhere(np.isin(grid, [*wanted]))}
