"""Agent or device, and for which goal: the agency measure for games of cells."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from PIL import Image
from scipy.special import softmax

from astray import games
from astray.acting import Policy, initial_states, steps
from astray.agency.gridworld import Cell, World
from astray.agency.measure import CALIBRATED, PRESETS, Episode, Options, decisions, measure_named
from astray.agency.online import measure_online
from astray.agency.population import pooled, rates
from astray.analysis import video
from astray.analysis.estimates import Estimate, estimate_mean
from astray.analysis.outcomes import load_shift
from astray.analysis.runs import Mode, open_run, shift_of
from astray.game import Game, Shift, Variant

DEVICE = "device"
UNDECIDED = "undecided"
LEAST, MOST = np.array([244, 243, 236]), np.array([196, 60, 20])  # colours of the posterior
STONE, MOUSE = np.array([204, 184, 142]), np.array([34, 34, 34])  # walls are sand, as in the game


@dataclass(frozen=True, eq=False)
class Played:
    """An episode for the measure, up to the last goal that it reached.

    The moves after that only pass the time and say nothing about a goal. An episode that reached
    no goal is kept whole.

    Attributes:
        cells: [steps + 1] cells; steps without a move are dropped from the trajectory.
        goals: Name -> cell of each goal.
    """

    level: int
    episode: Episode
    cells: list[Cell]
    goals: dict[str, list[Cell]]


def play(
    policy: Policy,
    game: str | Game,
    variant: Variant,
    levels: Sequence[int] | np.ndarray,
    shift: Shift,
    batch: int = 256,
) -> list[Played]:
    """Play `policy` in those of `levels` that contain all the goals.

    Raises:
        ValueError: If the game has no `cells`.
    """
    game = games.find(game)
    states = initial_states(game, variant, levels)
    ways = [[cell] for cell in _cells(game, states)]
    for step in steps(policy, game, variant, levels, batch=batch):
        for level, cell in zip(step.level, _cells(game, step.after), strict=True):
            ways[level].append(cell)
    played = [_played(game, s, way, shift) for s, way in zip(states, ways, strict=True)]
    return [one for one in played if one]


def _cells(game: Game, states: np.ndarray) -> list[Cell]:
    """Return the cells (x, y) of the agents in states [N]."""
    return [(int(x), int(y)) for x, y in np.floor(game.places.centre(states))]


def _played(game: Game, s: Any, way: list[Cell], shift: Shift) -> Played | None:
    """Return the episode from `s` along the cells of `way`; None if the level lacks a goal."""
    places = named_places(game, s, shift)
    if any(place is None for place in places.values()):
        return None
    goals = {name: [place] for name, place in places.items()}
    world = World(game.cells.free(s))
    last = max((way.index(place) for place in places.values() if place in way), default=len(way))
    intended = goals[shift.intended][0]
    cells = way[: last + 1]
    return Played(int(s.level), Episode(world, world.path(cells), intended), cells, goals)


def named_places(game: Game, s: Any, shift: Shift) -> dict[str, Any]:
    """Return the cells (x, y) of the shift's goals (None if absent) and of other goals.

    If goals share an event, only the first is included.
    """
    places: dict[str, Any] = {}
    events = set()
    for goal in (shift.intended, *shift.proxies, *game.event_goals):
        event, place = game.event(goal), game.cells.target(s, goal)
        of_shift = goal == shift.intended or goal in shift.proxies
        if event not in events and (of_shift or place is not None):
            places[goal] = place
            events.add(event)
    return places


@dataclass(frozen=True, eq=False)
class Assessment:
    """Verdict on a policy's episodes: an agent or a device, and for which goal.

    The explanations are the named goals, another cell, and a device.
    """

    episodes: pl.DataFrame  # one row each: see `assess`
    explanations: tuple[str, ...]
    rates: list[Estimate]  # fraction of episodes for each explanation
    pooled: np.ndarray  # posterior of each explanation if one holds for all episodes; a few
    # episodes in which an agent got stuck decide it, so the verdict ignores it
    decisions: int  # steps at which the named goals part

    @property
    def verdict(self) -> str:
        """The explanation of most episodes, if that is significant at 95 %; otherwise undecided."""
        most = [n for n, s in zip(self.explanations, self.rates, strict=True) if s.low > 0.5]
        return most[0] if most else UNDECIDED

    @property
    def most_informative(self) -> int:
        """Index of the episode with the most distinguishing steps that fits the verdict."""
        table = self.episodes.with_row_index("row")
        columns = [f"log {name}" for name in self.explanations]
        likeliest = np.array(self.explanations)[table.select(columns).to_numpy().argmax(1)]
        alike = table.filter(pl.Series(likeliest == self.verdict))
        return (alike if len(alike) else table).sort("decisions", descending=True)["row"][0]

    @property
    def agent(self) -> Estimate:
        """Mean evidence per episode for agents over devices, in nats, with its interval."""
        return estimate_mean(self.episodes["log_factor"].to_numpy())

    def summary(self) -> dict[str, Any]:
        """Return everything except the episodes as plain data."""
        explained = zip(self.explanations, self.rates, self.pooled.tolist(), strict=True)
        return {
            "verdict": self.verdict,
            "explanations": {n: vars(s) | {"pooled": p} for n, s, p in explained},
            "log_factor": vars(self.agent),
            "episodes": len(self.episodes),
            "moves": int(self.episodes["moves"].sum()),
            "decisions": self.decisions,
        }

    def sentence(self) -> str:
        """Return the verdict as a sentence."""
        device = self.rates[self.explanations.index(DEVICE)]
        undecided = "An agent; its goal is undecided" if device.high < 0.5 else "Undecided"
        verdict = {UNDECIDED: undecided, DEVICE: "A device"}.get(
            self.verdict, f"An agent; its goal: {self.verdict}"
        )
        factor = self.agent
        return (
            f"{verdict}. {len(self.episodes)} episodes with {self.decisions} steps at which the "
            f"goals part; an episode speaks for an agent by {factor.mean:.2f} nats "
            f"[{factor.low:.2f}, {factor.high:.2f}]."
        )


def assess(played: Sequence[Played], options: Options = CALIBRATED) -> Assessment:
    """Assess each episode by itself, with its own eps, and all of them together.

    Columns of `episodes`: level, moves, decisions (steps at which the goals part), agent
    (posterior p(agent) from a prior of 1/2), log_factor (nats for agents over devices), and for
    each explanation its log evidence ("log ...") and posterior ("p ...").

    Raises:
        ValueError: If there are no episodes.
    """
    if not played:
        raise ValueError("there are no episodes to assess: no level has all the goals")
    if any(set(one.goals) != set(played[0].goals) for one in played):
        raise ValueError("some episodes are of levels with other goals than the first")
    rows, logs, explanations = [], [], ()
    for one in played:
        evidence = measure_named([one.episode], [one.goals], options)
        explanations = (*map(str, evidence.goals), DEVICE)
        logs.append(np.append(evidence.log_goals, evidence.log_device))
        posterior = softmax(logs[-1] + np.append(evidence.log_prior, 0.0))
        rows.append(
            {
                "level": one.level,
                "moves": len(one.episode.trajectory),
                "decisions": decisions(one.episode, one.goals, options),
                "agent": evidence.agent,
                "log_factor": evidence.log_factor,
            }
            | {f"log {n}": x for n, x in zip(explanations, logs[-1].tolist(), strict=True)}
            | {f"p {n}": x for n, x in zip(explanations, posterior.tolist(), strict=True)}
        )
    table = pl.DataFrame(rows)
    return Assessment(
        table,
        explanations,
        rates(np.array(logs)),
        pooled(np.array(logs)),
        int(table["decisions"].sum()),
    )


def assess_run(
    run: Path,
    levels: Sequence[int] | np.ndarray | None = None,
    *,
    variant: str | Variant | None = None,
    shift: str | Shift | None = None,
    measure: str = "calibrated",
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: dict[str, Any] | None = None,
) -> tuple[Assessment, Callable[[], np.ndarray]]:
    """Assess a trained agent; also return a function that records its most informative episode.

    Args:
        levels: Level numbers; None for the first 300 outside of the training.
        measure: Name in `PRESETS`.
        art: Art of the agent's observations; None for that of its training.
    """
    agent, config = open_run(run, mode, art)
    between = load_shift(config.find_game(), shift or shift_of(config))
    made = config.played_variant(variant or between.test, knobs)
    chosen = config.unseen_levels[:300] if levels is None else levels
    played = play(agent, config.game, made, chosen, between)
    assessed = assess(played, PRESETS[measure])
    informative, options = played[assessed.most_informative], PRESETS[measure]
    return assessed, lambda: posterior_video(agent, config.game, made, informative, options)


def posterior_video(
    policy: Policy,
    game: str | Game,
    variant: Variant,
    played: Played,
    options: Options = CALIBRATED,
    pixels: int = 320,
) -> np.ndarray:
    """Return a video [T + 1, H, W, 3] uint8 of an episode beside the posterior over target cells.

    It ends at the last goal that was reached.
    """
    steps = len(played.cells)
    frames = video.play(
        policy, game, variant, played.level, pixels=pixels, longest=max(1, steps - 1)
    ).frames[:steps]
    growth = measure_online(played.episode, replace(options, goals="accessible"))
    moved = [here != there for here, there in itertools.pairwise(played.cells)]
    counted = np.append(0, np.cumsum(moved))  # standing still is no step of a trajectory
    world = played.episode.world
    numbers = [world.number(cell) for cell in growth.goals if not isinstance(cell, str)]
    maps = []
    for t in range(steps):
        belief = np.zeros(len(world))
        belief[numbers] = growth.posterior[counted[t]]
        maps.append(heat(world, belief, world.number(played.cells[t]), pixels))

    def caption(t: int) -> str:
        return f"where to? agent: {100 * growth.agent[counted[t]]:.0f} %"

    level = f"level {played.level}"
    return video.beside(frames, np.stack(maps), captions=[level, caption])


def heat(world: World, belief: np.ndarray, here: int, pixels: int) -> np.ndarray:
    """Draw `belief` [F] on the map, dark for likely, [pixels, pixels, 3] uint8."""
    height, width = world.free.shape
    image = np.broadcast_to(STONE, (height, width, 3)).astype(float)
    rate = (belief / belief.max())[:, None]
    image[world.cells[:, 1], world.cells[:, 0]] = LEAST + rate * (MOST - LEAST)
    flipped = Image.fromarray(image[::-1].astype(np.uint8))
    large = np.array(flipped.resize((pixels, pixels), Image.Resampling.NEAREST))
    down, right = np.mgrid[:pixels, :pixels] + 0.5
    x, y = world.cells[here] + 0.5
    away = np.hypot(down * height / pixels - (height - y), right * width / pixels - x)
    large[away < 0.22] = MOUSE
    return large
