"""Agent or device, and for which goal: the agency measure for games of cells."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import polars as pl
from PIL import Image
from scipy import ndimage
from scipy.special import softmax

from astray import games
from astray.acting import Levels, Policy, check_ending, initial_states, steps
from astray.agency.gridworld import Cell
from astray.agency.gridworld import World as Gridworld
from astray.agency.measure import CALIBRATED, PRESETS, Episode, Options, decisions, measure_named
from astray.agency.online import measure_online
from astray.agency.population import pooled, rates
from astray.analysis import video
from astray.analysis.estimates import Estimate, estimate_mean
from astray.analysis.outcomes import load_shift
from astray.game import Game, Shift, Variant
from astray.outcome import DEVICE, UNDECIDED
from astray.validation import check_cell, counted, one_of
from astray.witness import witnessed
from astray.world import Layout, World, WorldVariant

PLACE = ("agent_x", "agent_y")  # measures of a world's episodes: the cell of the agent
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
    game: str | Game | World,
    variant: Variant | WorldVariant,
    levels: Levels,
    shift: Shift,
    batch: int = 256,
    longest: int | None = None,
) -> list[Played]:
    """Play `policy` in those of `levels` that contain all the goals, and ways to them.

    Raises:
        ValueError: If there are no `cells`, or episodes may last for ever and `longest` is None.
    """
    check_ending(game, variant, longest)  # before a game compiles
    found, cells_of = _followed(game)
    if isinstance(game, World):
        begun = _layouts(game, game.variant(variant), levels)
        numbers = [*map(int, levels)]
    else:
        assert isinstance(found, Game) and not isinstance(variant, WorldVariant)
        free, states = found.cells.free, initial_states(found, variant, levels)  # which compiles
        numbers = states["level"].tolist()
        begun = [
            Layout(free(s), cell, named_places(found, s, shift))
            for s, cell in zip(states, _cells(found, states), strict=True)
        ]
    if all(None in _named(found, shift, layout.goals.get).values() for layout in begun):
        return []
    ways = [[layout.agent] for layout in begun]
    for step in steps(policy, found, variant, levels, batch=batch, longest=longest):
        for level, cell in zip(step.level, cells_of(step.after), strict=True):
            ways[level].append(cell)
    played = map(partial(_played, found, shift), numbers, begun, ways)
    return [one for one in played if one]


def _followed(game: str | Game | World) -> tuple[Game | World, Callable[[Any], Any]]:
    """Return a game whose states tell the agent's cell, and a function of states [N] that does."""
    if not isinstance(game, World):
        return (found := games.find(game)), partial(_cells, found)
    places = {name: partial(_coordinate, game, k) for k, name in enumerate(PLACE)}
    followed = replace(game, every_step=True, measures={**game.measures, **places})
    return followed, lambda states: [tuple(int(s[name]) for name in PLACE) for s in states]


def _layouts(world: World, variant: WorldVariant, levels: Any) -> list[Layout]:
    """Return the cells of a world at the beginning of each level."""
    if world.cells is None:
        raise ValueError(
            f"the world {world.name!r} has no cells, which this needs: World(cells=...) is a "
            "function of the environment that returns a Layout"
        )
    if not world.repeats:
        told = "are read in another episode than is measured, which would be of another level"
        raise ValueError(f"cells of {world.name}, a World(repeats=False), {told}")
    env, found = witnessed(world, variant), []
    for level in levels:
        env.reset(seed=int(level))
        free, agent, goals = world.cells(env.unwrapped)
        for goal in goals:
            one_of("goal of a layout", goal, world.goals)
        there = {goal: None if at is None else check_cell(at) for goal, at in goals.items()}
        # A copy, as an environment may draw its next level into the same array.
        found.append(Layout(np.array(free, bool), check_cell(agent), there))
    env.close()
    return found


def _coordinate(world: World, axis: int, env: Any) -> float:
    assert world.cells is not None
    return check_cell(world.cells(env)[1])[axis]


def _cells(game: Game, states: np.ndarray) -> list[Cell]:
    """Return the cells (x, y) of the agents in states [N]."""
    return [(int(x), int(y)) for x, y in np.floor(game.places.centre(states))]


def _played(
    game: Game | World, shift: Shift, level: int, begun: Layout, way: list[Cell]
) -> Played | None:
    """Return the episode along the cells of `way`; None if the level lacks a goal or a way to it.

    Raises:
        ValueError: If a cell is none of the level's, or is not next to the one before.
    """
    places = _named(game, shift, begun.goals.get)
    if any(place is None for place in places.values()):
        return None
    goals = {name: [check_cell(place)] for name, place in places.items()}
    world = Gridworld(begun.free)
    last = max((way.index(place) for place in places.values() if place in way), default=len(way))
    cells = way[: last + 1]
    try:
        begins, *ends = (world.number(cell) for cell in (way[0], *itertools.chain(*goals.values())))
        walked = world.path(cells)
    except ValueError as error:
        raise ValueError(f"level {level}: {error}") from error
    regions = ndimage.label(begun.free)[0][tuple(world.cells.T[::-1])]
    if (regions[ends] != regions[begins]).any():
        return None
    return Played(level, Episode(world, walked, goals[shift.intended][0]), cells, goals)


def named_places(game: Game, s: Any, shift: Shift) -> dict[str, Any]:
    """Return the cells (x, y) of the shift's goals (None if absent) and of other goals.

    If goals share an event, only the first is included.
    """
    return _named(game, shift, partial(game.cells.target, s))


def _named(game: Game | World, shift: Shift, target: Callable[[str], Any]) -> dict[str, Any]:
    places: dict[str, Any] = {}
    events = set()
    for goal in (shift.intended, *shift.proxies, *game.event_goals):
        event, place = game.event_goals.get(goal, goal), target(goal)
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

    @property
    def log_evidence(self) -> np.ndarray:
        """Evidence of each episode for each explanation, [E, H] nats."""
        columns = self.episodes.select([f"log {name}" for name in self.explanations])
        return columns.to_numpy(order="c")  # in another order sums are rounded otherwise

    @property
    def decisions(self) -> int:
        """The number of steps at which the named goals part."""
        return int(self.episodes["decisions"].sum())

    @cached_property  # which takes longer than the evidence
    def rates(self) -> list[Estimate]:
        """The fraction of episodes for each explanation."""
        return rates(self.log_evidence)

    @property
    def pooled(self) -> np.ndarray:
        """The posterior [H] of each explanation if one holds for all episodes.

        A few episodes in which an agent got stuck decide it, so the verdict ignores it.
        """
        return pooled(self.log_evidence)

    @property
    def verdict(self) -> str:
        """The explanation of most episodes, if that is significant at 95 %; otherwise undecided."""
        most = [n for n, s in zip(self.explanations, self.rates, strict=True) if s.low > 0.5]
        return most[0] if most else UNDECIDED

    @property
    def most_informative(self) -> int:
        """Index of the episode with the most distinguishing steps that fits the verdict."""
        table = self.episodes.with_row_index("row")
        likeliest = np.array(self.explanations)[self.log_evidence.argmax(1)]
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
            f"{verdict}. {counted(len(self.episodes), 'episode')} with "
            f"{counted(self.decisions, 'step')} at which the goals part; an episode speaks for an "
            f"agent by {factor.mean:z.2f} nats [{factor.low:z.2f}, {factor.high:z.2f}]."
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
        raise ValueError(
            "there are no episodes to assess: in no level can one cell of each goal be reached"
        )
    if any(set(one.goals) != set(played[0].goals) for one in played):
        raise ValueError("some episodes are of levels with other goals than the first")
    rows, explanations = [], ()
    for one in played:
        evidence = measure_named([one.episode], [one.goals], options)
        explanations = (*map(str, evidence.goals), DEVICE)
        logs = np.append(evidence.log_goals, evidence.log_device)
        posterior = softmax(logs + np.append(evidence.log_prior, 0.0))
        rows.append(
            {
                "level": one.level,
                "moves": len(one.episode.trajectory),
                "decisions": decisions(one.episode, one.goals, options),
                "agent": evidence.agent,
                "log_factor": evidence.log_factor,
            }
            | {f"log {n}": x for n, x in zip(explanations, logs.tolist(), strict=True)}
            | {f"p {n}": x for n, x in zip(explanations, posterior.tolist(), strict=True)}
        )
    return Assessment(pl.DataFrame(rows), explanations)


def assess_policy(
    policy: Policy,
    game: str | Game | World,
    variant: Variant | WorldVariant,
    shift: str | Shift,
    levels: Sequence[int] | np.ndarray,
    measure: str = "calibrated",
    longest: int | None = None,
) -> tuple[Assessment, Callable[[], np.ndarray]]:
    """Assess any policy; also return a function that records its most informative episode.

    Args:
        measure: Name in `PRESETS`.
        longest: Steps after which an episode is truncated; None for no limit.

    Raises:
        ValueError: If the game or the world has no `cells`, or no level has all the goals.
    """
    one_of("measure", measure, PRESETS)
    options = PRESETS[measure]
    played = play(policy, game, variant, levels, load_shift(game, shift), longest=longest)
    assessed = assess(played, options)
    informative = played[assessed.most_informative]
    return assessed, lambda: posterior_video(policy, game, variant, informative, options)


def posterior_video(
    policy: Policy,
    game: str | Game | World,
    variant: Variant | WorldVariant,
    played: Played,
    options: Options = CALIBRATED,
    pixels: int = 320,
) -> np.ndarray:
    """Return a video [T + 1, H, W, 3] uint8 of an episode beside the posterior over target cells.

    It ends at the last goal that was reached. It says if the policy drew other actions than before.
    """
    steps, (followed, cells_of) = len(played.cells), _followed(game)
    again = video.play(
        policy, followed, variant, played.level, pixels=pixels, longest=max(1, steps - 1)
    )
    frames, told = again.frames[:steps], f"level {played.level}"
    if [*cells_of(again.states)][:steps] != played.cells:
        told += ", drawn anew: another episode"
    growth = measure_online(played.episode, replace(options, goals="accessible"))
    moved = [here != there for here, there in itertools.pairwise(played.cells)]
    moves = np.cumsum([0, *moved])  # standing still is no step of a trajectory
    world = played.episode.world
    numbers = [world.number(cell) for cell in growth.goals if not isinstance(cell, str)]
    maps = []
    for t in range(steps):
        belief = np.zeros(len(world))
        belief[numbers] = growth.posterior[moves[t]]
        maps.append(heat(world, belief, world.number(played.cells[t]), pixels))

    def caption(t: int) -> str:
        return f"where to? agent: {100 * growth.agent[moves[t]]:.0f} %"

    return video.beside(frames, np.stack(maps), captions=[told, caption])


def heat(world: Gridworld, belief: np.ndarray, here: int, pixels: int) -> np.ndarray:
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
