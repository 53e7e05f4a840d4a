"""A policy plays: the one loop that all episodes come from, in training and after it.

for step in steps(policy, "maze", "anywhere", range(1000)):
    lengths[step.level[step.ended]] = step.after["time"][step.ended]
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from astray import games, world
from astray.bounds import MOST, bounded, of_kind, shown
from astray.envs.vector import GameVectorEnv, Observation
from astray.envs.worlds import WorldVectorEnv
from astray.game import Game, Variant
from astray.level import Level
from astray.record import level_numbers
from astray.world import World, WorldVariant

Levels = Sequence[int] | np.ndarray | range | Mapping[str, Level]
CHUNK = 1000  # levels begun at once
LASTING = 1_000_000  # steps of an episode that may as well never end
POLICY = ("name", "observation", "art", "actions")  # that each has


class Turn(NamedTuple):
    """Episodes [n] that wait for their next actions.

    env           the environments that they are played in
    observations  [n, ...], what these show
    begins        [n] bool, the episodes of which this is the first step
    memory        what the policy returned in its last answer, a row per episode; None at first
    kept          [n] the rows of the last turn that these were, where episodes were moved
    """

    env: Any
    observations: Any
    begins: np.ndarray
    memory: Any = None
    kept: np.ndarray | None = None

    @classmethod
    def of(cls, env: GameVectorEnv, observations: np.ndarray) -> Turn:
        """The turn of `env`'s episodes in the states that they are in, of which it shows this."""
        return cls(env, observations, env.states["time"] == 0)


class Answer(NamedTuple):
    """The actions [n] of a turn.

    memory  what is to come back with the next turn: arrays or tensors of a row per episode, alone
            or in tuples, lists and dictionaries; it is the policy's to forget where one begins
    extra   what else is to be noted of the steps, arrays [n] by name
    """

    actions: np.ndarray
    memory: Any = None
    extra: Mapping[str, np.ndarray] = {}


class Policy(Protocol):
    """Answers with an action for every episode, from what is shown or from the state."""

    @property
    def name(self) -> str: ...

    @property
    def observation(self) -> Observation: ...

    @property
    def art(self) -> str: ...  # that images are drawn with, for it and for videos of it

    def actions(self, turn: Turn) -> Answer: ...


class Actor(Protocol):
    """Chooses actions for groups of environments; it may do so for one while another steps."""

    def send(self, t: int, group: int, turn: Turn) -> None:
        """Begin to choose the actions of step `t`."""

    def receive(self, group: int) -> Answer:
        """Return the actions that were last sent for."""
        ...


Taken = TypeVar("Taken", covariant=True)


class Stage(Protocol[Taken]):
    """Groups of environments, and the rule by which episodes begin in them."""

    @property
    def groups(self) -> Sequence[Any]: ...

    def begin(self, group: int) -> Turn | None:
        """Begin the episodes that are to begin now; None ends the play."""
        ...

    def step(self, t: int, group: int, answer: Answer) -> Taken:
        """Take step `t`, and return what it led to."""
        ...


def play(actor: Actor, stage: Stage[Taken], steps: int | None = None) -> Iterator[Taken]:
    """Play `steps` steps of every group, or until the stage ends it; yield after each of them.

    The actor also sees what the last step led to.
    """
    for group in range(len(stage.groups)):
        if (turn := stage.begin(group)) is None:
            return
        actor.send(0, group, turn)
    for t in itertools.count() if steps is None else range(steps):
        for group in range(len(stage.groups)):
            yield stage.step(t, group, actor.receive(group))
            if (turn := stage.begin(group)) is None:
                return
            actor.send(t + 1, group, turn)


class Asking:
    """Asks a policy, and keeps its memory beside the episodes that it is of."""

    def __init__(self, policy: Policy):
        self.policy, self._memory = policy, None

    def send(self, t: int, group: int, turn: Turn) -> None:
        memory = self._memory if turn.kept is None else rows(self._memory, turn.kept)
        self._turn = turn._replace(memory=memory)

    def receive(self, group: int) -> Answer:
        answer = self.policy.actions(self._turn)  # not before: nobody may ask for the last turn's
        see_rows(answer.memory, len(self._turn.begins))
        self._memory = answer.memory
        return answer


def rows(memory: Any, kept: np.ndarray) -> Any:
    """The rows `kept` of a policy's memory."""
    if isinstance(memory, Mapping):
        return {name: rows(part, kept) for name, part in memory.items()}
    if isinstance(memory, tuple | list):
        parts = [rows(part, kept) for part in memory]
        return type(memory)(*parts) if hasattr(memory, "_fields") else type(memory)(parts)
    return None if memory is None else memory[kept]


def see_rows(memory: Any, n: int) -> None:
    """ValueError where a policy's memory of `n` episodes is not of a row for each."""
    if isinstance(memory, Mapping | tuple | list):
        for part in memory.values() if isinstance(memory, Mapping) else memory:
            see_rows(part, n)
    elif memory is not None and tuple(getattr(memory, "shape", ()))[:1] != (n,):
        raise ValueError(
            f"a policy's memory must be arrays or tensors of {n} rows, one per episode; got "
            f"{getattr(memory, 'shape', shown(memory))}"
        )


@dataclass(frozen=True, eq=False)
class Step:
    """One step of each of the episodes under way, [n].

    level   which of the levels, by its place in the order that they were given in
    before  the states that the step began in; `observations` of them are what the policy saw
    after   those that it led to, which are valid till the next step, and `seen` of them
    extra   what the policy noted of the step, arrays [n] by name

    An episode's first step comes once its level is begun, its last one with `ended`.
    """

    level: np.ndarray
    before: np.ndarray
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    after: np.ndarray
    seen: np.ndarray
    terminated: np.ndarray
    ended: np.ndarray  # terminated, or the time was up, or what was played until happened
    extra: Mapping[str, np.ndarray]

    def of(self, which: np.ndarray) -> Step:
        """The same of some of the episodes, `which` [n] bool."""
        return Step(**rows(vars(self), which))


def _taken(turn: Turn, answer: Answer, level: np.ndarray) -> Step:
    """Step the environments of a turn."""
    before = turn.env.get_state()
    seen, rewards, terminated, truncated, _ = turn.env.step(answer.actions)
    return Step(
        level,
        before,
        turn.observations,
        answer.actions,
        rewards,
        turn.env.states,
        seen,
        terminated,
        terminated | truncated,
        answer.extra,
    )


class Onward:
    """Episodes that go on from where environments are, until the first of them has ended."""

    groups = (slice(None),)

    def __init__(self, env: GameVectorEnv, observations: np.ndarray):
        """observations  what `env` shows now"""
        self._turn = Turn.of(env, observations)

    def begin(self, group: int) -> Turn | None:
        return None if self._turn.env.states["ended"].any() else self._turn

    def step(self, t: int, group: int, answer: Answer) -> Step:
        step = _taken(self._turn, answer, np.arange(len(answer.actions)))
        self._turn = Turn(self._turn.env, step.seen, np.zeros(len(step.ended), bool))
        return step


class LevelByLevel:
    """Each of some levels is played once; as many at a time as there are environments, or fewer."""

    groups = (slice(None),)

    def __init__(
        self,
        env: GameVectorEnv | WorldVectorEnv,
        levels: Levels,
        until: Sequence[str] = (),
        longest: int | None = None,
    ):
        """Begin the first of `levels`; see `steps` for the rest."""
        unknown = [event for event in until if event not in env.game.events]
        if unknown:
            there = ", ".join(env.game.events)
            raise ValueError(f"unknown event {unknown[0]!r} of {env.game.name}; there are: {there}")
        self._option, self._levels = beginnings(levels, env.game.state)
        self._until, self._longest, n = until, longest, env.num_envs
        self._playing = np.arange(n)  # which of the levels each environment plays
        self._following, self._live, self._ended = n, np.ones(n, bool), np.zeros(n, bool)
        observations, _ = env.reset(seed=0, options={self._option: self._levels[:n]})
        self._turn = Turn(env, observations, self._live.copy())

    def begin(self, group: int) -> Turn | None:
        """Begin the next levels where others ended; None once all have."""
        env, ended, live, playing = self._turn.env, self._ended, self._live, self._playing
        if not ended.any():
            return self._turn
        for i in np.flatnonzero(ended & live):
            live[i] = self._following < len(self._levels)  # else it plays its level again, unseen
            playing[i] = self._following if live[i] else playing[i]
            self._following += live[i]
        if not live.any():
            return None
        begin = self._levels[playing]
        observations, _ = env.reset(options={self._option: begin, "reset_mask": ended})
        self._turn = Turn(env, observations, ended)
        movable = isinstance(env, GameVectorEnv)
        if movable and 2 * live.sum() <= len(
            live
        ):  # fewer go on, as who sees images takes time for each
            states, kept = env.get_state()[live], np.flatnonzero(live)
            env.close()
            env = _environments(env.game, env.variant, len(kept), env.observation, env.art)
            self._playing, self._live = playing[kept], live[kept]
            self._turn = Turn(env, env.set_state(states), ended[kept], kept=kept)
        return self._turn

    def step(self, t: int, group: int, answer: Answer) -> Step:
        step = _taken(self._turn, answer, self._playing.copy())
        for event in self._until:
            step.ended[:] |= step.after[event] >= 0
        if self._longest is not None:
            step.ended[:] |= step.after["time"] >= self._longest
        elif (step.after["time"] > LASTING).any():
            raise ValueError(lasting(f"a level has not ended after {LASTING:,} steps"))
        self._ended = step.ended
        self._turn = Turn(self._turn.env, step.seen, np.zeros(len(step.ended), bool))
        return step if self._live.all() else step.of(self._live)

    def close(self) -> None:
        self._turn.env.close()


def steps(
    policy: Policy,
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    levels: Levels,
    *,
    batch: int = 256,
    until: Sequence[str] = (),
    longest: int | None = None,
) -> Iterator[Step]:
    """Play each of `levels` once, `batch` at a time, and yield after every step of all of them.

    levels   numbers, or levels that were drawn, by name; those are numbered from 0 on
    until    events of the game: with the first of them an episode is left, as if it ended there
    longest  steps after which an episode is left, as if it ended there; None: never

    What happens in a level depends neither on `batch` nor on the other levels.

    Raises ValueError where episodes may last for ever, and `longest` is not given.
    """
    see_policy(policy)
    of_kind("levels", levels, Sized)
    if not len(levels):
        raise ValueError("no levels to play")
    bounded("batch", batch, 1, MOST)
    see_ending(game, variant, longest)
    n = min(batch, len(levels))
    env = _environments(game, variant, n, policy.observation, policy.art, longest)
    stage = LevelByLevel(env, levels, until, longest)
    yield from play(Asking(policy), stage)
    stage.close()


def see_ending(
    game: str | Game | World, variant: str | Variant | WorldVariant, longest: int | None
) -> None:
    """Raise ValueError where episodes of a variant may last for ever, and none is left before."""
    if longest is not None:
        bounded("longest", longest, 1, MOST)
        return
    given: Any = variant
    limit = world.find(game).variant(given).time_limit
    if limit > LASTING:
        raise ValueError(lasting(f"episodes of this variant last up to {limit:,} steps"))


def lasting(what: str) -> str:
    return (
        f"{what}: say `longest`, the steps after which an episode is left (--longest), or lower "
        "the variant's time_limit (--set time_limit=N)"
    )


def see_policy(policy: Any) -> None:
    """ValueError where `policy` is none, as a function of observations is not."""
    missing = [name for name in POLICY if not hasattr(policy, name)]
    if missing or isinstance(policy, type):
        raise ValueError(
            f"a policy must have {', '.join(POLICY)}: load_agent(...) gives one, and "
            f"Function(...) makes one of a function; got {shown(policy)}"
        )


def initial_states(game: str | Game, variant: str | Variant, levels: Levels) -> np.recarray:
    """The states that `levels` begin in, [N]."""
    of_kind("levels", levels, Sized)
    if not len(levels):
        raise ValueError("no levels to begin")
    shown = "symbolic" if games.find(game).symbols else "image"  # symbols take less time
    env = GameVectorEnv(game, variant, min(CHUNK, len(levels)), observation=shown)
    option, begin = beginnings(levels, env.game.state)
    found = []
    for first in range(0, len(begin), env.num_envs):
        some = np.arange(first, first + env.num_envs) % len(begin)
        env.reset(seed=0, options={option: begin[some]})
        found.append(env.get_state()[: len(begin) - first])
    env.close()
    return np.concatenate(found).view(np.recarray)


def beginnings(levels: Levels, dtype: np.dtype) -> tuple[str, np.ndarray]:
    """The option of a reset that begins each of `levels`, and its values."""
    if not isinstance(levels, Mapping):
        return "level", level_numbers(levels)
    for level in levels.values():
        of_kind("a level by name", level, Level)
        if level.game.state != dtype:
            raise ValueError(f"levels must be of one game; one is of {level.game.name}")
    states = np.array([level.state(solvable=False) for level in levels.values()], dtype)
    states["level"] = np.arange(len(states))
    return "state", states


def _environments(
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    n: int,
    observation: Any,
    art: str,
    longest: int | None = None,
) -> Any:
    if isinstance(game, World):
        return WorldVectorEnv(game, game.variant(variant), n, longest)
    assert not isinstance(variant, WorldVariant)
    return GameVectorEnv(
        game, variant, n, observation=observation, art=art, autoreset_mode="Disabled"
    )
