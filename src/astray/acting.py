"""The one loop in which a policy plays, in training and afterwards.

```python
for step in steps(policy, "maze", "anywhere", range(1000)):
    lengths[step.level[step.ended]] = step.after["time"][step.ended]
```
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from gymnasium.spaces import Discrete

from astray import world
from astray.envs.beginnings import Levels as Levels
from astray.envs.beginnings import beginnings, without_autoreset
from astray.envs.beginnings import initial_states as initial_states
from astray.envs.pool import usable_processors
from astray.envs.steps import Reward as Reward
from astray.envs.steps import Step as Step
from astray.envs.steps import check_rows, choices, rows
from astray.envs.vector import GameVectorEnv, Observation
from astray.envs.worlds import WorldVectorEnv, check_repeats
from astray.game import Game, Variant
from astray.record import count_levels, level_numbers
from astray.validation import MOST, bounded, of_kind, one_of, shown
from astray.world import World, WorldVariant

EVERY = 5.0  # seconds between reports of the levels played
LASTING = 1_000_000  # steps; longer episodes count as endless
OF_WORLD = 100_000  # likewise of a World, which tells no limit; its steps can take milliseconds
REMEDY = " lower the variant's time_limit (--set time_limit=N), or"  # of games
GOES_ON = "%d of %d levels played; those begun go on after %d steps: `longest` truncates episodes"
SHORT = 10_000  # steps; of a game, longer episodes may seem to be endless
BETWEEN_LOOKS = 64  # steps between looks for endless episodes, as a look takes 10 us
LOG = logging.getLogger(__name__)  # reports progress at level INFO
POLICY = ("name", "observation", "art", "actions")  # required attributes of a policy


class Turn(NamedTuple):
    """Episodes [n] that wait for their next actions.

    Attributes:
        env: Vector environment in which they are played.
        observations: [n, ...], current observations.
        begins: [n] bool, whether this is the episode's first step.
        memory: Memory that the policy returned in its last answer, one row per episode; None at
            first.
        kept: [n] int64, rows of the last turn that these episodes had, if episodes were moved.
    """

    env: Any
    observations: Any
    begins: np.ndarray
    memory: Any = None
    kept: np.ndarray | None = None

    @classmethod
    def of(cls, env: GameVectorEnv, observations: np.ndarray) -> Turn:
        """Return the turn of `env`'s episodes in their current states, given their observations."""
        return cls(env, observations, env.states["time"] == 0)


class Answer(NamedTuple):
    """The actions [n] for a turn.

    Attributes:
        memory: Memory to pass with the next turn: arrays or tensors with one row per episode,
            alone or in tuples, lists and dictionaries. The policy clears it when an episode
            begins.
        extra: Further arrays [n] to record with the step, by name.
    """

    actions: np.ndarray
    memory: Any = None
    extra: Mapping[str, np.ndarray] = {}


class Policy(Protocol):
    """Policy that chooses an action for every episode, from its observation or its state.

    Examples:
        >>> class Right:
        ...     name, observation, art = "right", "symbolic", "own"
        ...
        ...     def actions(self, turn):
        ...         return astray.acting.Answer(np.full(len(turn.observations), 7))
        >>> astray.evaluate(Right(), "maze", "corner-small", range(3)).height
        3
    """

    @property
    def name(self) -> str: ...

    @property
    def observation(self) -> Observation: ...

    @property
    def art(self) -> str: ...  # art of its images and videos

    def actions(self, turn: Turn) -> Answer: ...


class Actor(Protocol):
    """Source of actions for groups of environments; it can compute for one while another steps.

    Examples:
        >>> from astray.analysis.policies import Random
        >>> env = astray.GameVectorEnv("maze", "corner-small", 2)
        >>> actor = astray.acting.Asking(Random())
        >>> stage = astray.acting.LevelByLevel(env, range(3))
        >>> next(astray.acting.play(actor, stage)).level
        array([0, 1])
    """

    def send(self, t: int, group: int, turn: Turn) -> None:
        """Begin to choose the actions of step `t`."""

    def receive(self, group: int) -> Answer:
        """Return the actions that were last requested by `send`."""
        ...


Taken = TypeVar("Taken", covariant=True)


class Stage(Protocol[Taken]):
    """Groups of environments, with a rule for which episodes begin in them.

    Examples:
        >>> env = astray.GameVectorEnv("maze", "corner-small", 2)
        >>> stage = astray.acting.LevelByLevel(env, range(3))
        >>> stage.begin(0).begins
        array([ True,  True])
    """

    @property
    def groups(self) -> Sequence[Any]: ...

    def begin(self, group: int) -> Turn | None:
        """Begin the episodes that are due and return their turn; None ends the play."""
        ...

    def step(self, t: int, group: int, answer: Answer) -> Taken:
        """Take step `t` and return its result."""
        ...


def play(actor: Actor, stage: Stage[Taken], steps: int | None = None) -> Iterator[Taken]:
    """Play `steps` steps of every group, or until the stage ends; yield the result of each.

    The actor also sees the observations after the last step.
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
    """Actor that asks a policy and stores its memory."""

    def __init__(self, policy: Policy):
        self.policy, self.memory = policy, None

    def send(self, t: int, group: int, turn: Turn) -> None:
        memory = self.memory if turn.kept is None else rows(self.memory, turn.kept)
        self.turn = turn._replace(memory=memory)

    def receive(self, group: int) -> Answer:
        answer = asked(self.policy, self.turn)  # not before: nobody may ask for the last turn's
        self.memory = answer.memory
        return answer


def asked(policy: Policy, turn: Turn) -> Answer:
    """Return the checked answer of a policy, which may write to a copy of the observations."""
    answer = policy.actions(turn._replace(observations=copy.deepcopy(turn.observations)))
    of_kind("what a policy returns", answer, Answer)
    check_rows(answer.memory, len(turn.begins))
    return answer._replace(actions=checked_actions(policy.name, answer.actions, turn))


def checked_actions(name: str, chosen: Any, turn: Turn) -> np.ndarray:
    """Return a policy's actions [N]; raise ValueError if they are invalid."""
    space = turn.env.single_action_space
    if not isinstance(space, Discrete):
        return np.asarray(chosen)  # a world checks such actions
    return choices(name, chosen, len(turn.begins), space)


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
    """Stage that continues from the environments' current states until the first episode ends."""

    groups = (slice(None),)

    def __init__(self, env: GameVectorEnv, observations: np.ndarray):
        """Begin with `observations`, which `env` shows now."""
        self._turn = Turn.of(env, observations)

    def begin(self, group: int) -> Turn | None:
        return None if self._turn.env.states["ended"].any() else self._turn

    def step(self, t: int, group: int, answer: Answer) -> Step:
        step = _taken(self._turn, answer, np.arange(len(answer.actions)))
        self._turn = Turn(self._turn.env, step.seen, np.zeros(len(step.ended), bool))
        return step


class LevelByLevel:
    """Stage that plays each of some levels once, at most one per environment at a time."""

    groups = (slice(None),)

    def __init__(
        self,
        env: GameVectorEnv | WorldVectorEnv,
        levels: Levels,
        until: Sequence[str] = (),
        longest: int | None = None,
    ):
        """Begin the first of `levels`; `steps` describes the arguments."""
        of_kind("until", until, tuple | list)
        for event in until:
            one_of("event", event, env.game.events, of=env.game.name)
        self._option, self._levels = beginnings(levels, env.game.state)
        self._until, self._longest, n = until, longest, env.num_envs
        is_world = isinstance(env, WorldVectorEnv)
        self._lasting, self._remedy = (OF_WORLD, "") if is_world else (LASTING, REMEDY)
        self._streams = n if is_world and env.game.level_key is not None else 0
        self._playing = np.arange(n)  # index of each environment's level
        self._following, self._live, self._ended = n, np.ones(n, bool), np.zeros(n, bool)
        observations, _ = env.reset(seed=0, options={self._option: self._levels[:n]})
        self._turn = Turn(env, observations, self._live.copy())

    def begin(self, group: int) -> Turn | None:
        """Begin the next levels where others ended; return None once all have ended."""
        env, ended, live, playing = self._turn.env, self._ended, self._live, self._playing
        if not ended.any():
            return self._turn
        for i in np.flatnonzero(ended & live):
            # Of a stream, each environment plays as many episodes, however long they are.
            following = playing[i] + self._streams if self._streams else self._following
            live[i] = following < len(self._levels)  # else it plays its level again, unseen
            playing[i] = following if live[i] else playing[i]
            self._following += live[i]
        if not live.any():
            return None
        kept = None  # fewer go on, as each takes time
        if isinstance(env, WorldVectorEnv) and not live.all() and env.keep(np.flatnonzero(live)):
            kept, ended = np.flatnonzero(live), ended[live]
            self._move(kept)
        begin = self._levels[self._playing]
        observations, _ = env.reset(options={self._option: begin, "reset_mask": ended})
        self._turn = Turn(env, observations, ended, kept=kept)
        if isinstance(env, GameVectorEnv) and 2 * live.sum() <= len(live):
            states, kept = env.get_state()[live], np.flatnonzero(live)
            env.close()
            env = without_autoreset(env.game, env.variant, len(kept), env.observation, env.art)
            self._turn = Turn(env, env.set_state(states), ended[kept], kept=kept)
            self._move(kept)
        return self._turn

    def _move(self, kept: np.ndarray) -> None:
        """Go on with the episodes `kept` alone."""
        self._playing, self._live = self._playing[kept], self._live[kept]

    def step(self, t: int, group: int, answer: Answer) -> Step:
        """Take a step; raise ValueError if an episode seems to be endless."""
        step = _taken(self._turn, answer, self._playing.copy())
        for event in self._until:
            step.ended[:] |= step.after[event] >= 0
        if self._longest is not None:
            step.ended[:] |= step.after["time"] >= self._longest
        elif t % BETWEEN_LOOKS == 0 and step.after["time"].max() > self._lasting:
            told = f"a level has not ended after {self._lasting:,}"
            raise ValueError(_endless(told, self._remedy))
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
    """Play each of `levels` once, `batch` at a time; yield after every step of all of them.

    An episode does not depend on `batch` or on the other levels. The number of levels played is
    logged every few seconds.

    Args:
        levels: Level numbers, or drawn levels by name, which are numbered from 0.
        until: Events of the game that end an episode.
        longest: Steps after which an episode is truncated; None for no limit.

    Yields:
        The step of all running episodes.

    Raises:
        ValueError: If an argument is invalid, or episodes may last for ever and `longest` is None.
    """
    check_policy(policy)
    count = count_levels(levels)
    bounded("batch", batch, 1, MOST)
    check_ending(game, variant, longest)
    n = min(int(batch), count)
    if isinstance(game, World) and game.repeats:
        few = level_numbers(levels)[[0, count // 2, -1]].tolist()
        check_repeats(game, variant := game.variant(variant), tuple(few), n)
    if isinstance(game, World) and game.workers and game.level_key is None:
        n = min(n, 2 * usable_processors())  # more processes take memory, and no less time
    env = without_autoreset(game, variant, n, policy.observation, policy.art, longest)
    silent = longest is None and not 0 < env.variant.time_limit <= SHORT  # a World's is 0
    yield from telling(policy, LevelByLevel(env, levels, until, longest), count, silent)


def telling(policy: Policy, stage: LevelByLevel, count: int, silent: bool) -> Iterator[Step]:
    """Play `count` levels, log how many were, and if `silent`, once that some go on; close all."""
    played, told = 0, time.monotonic()
    with contextlib.closing(stage):
        for step in play(Asking(policy), stage):
            played, ended = played + step.ended.sum(), step.ended.any()
            if (ended or silent) and time.monotonic() - told > EVERY:
                told = time.monotonic()
                if ended:
                    LOG.info("%d of %d levels played", played, count)
                else:  # once, also where nobody asked for progress
                    silent, lasted = False, step.after["time"].max()
                    LOG.warning(GOES_ON, played, count, lasted)
            yield step


def check_ending(game: str | Game | World, variant: Any, longest: int | None) -> None:
    """Raise ValueError if episodes of a variant may last for ever and `longest` is None."""
    if longest is not None:
        bounded("longest", longest, 1, MOST)
        return
    limit = world.find(game).variant(variant).time_limit
    if limit > LASTING:
        raise ValueError(_endless(f"episodes of this variant last up to {limit:,}", REMEDY))


def _endless(what: str, remedy: str) -> str:
    return f"{what} steps:{remedy} say `longest`, after which an episode is left"


def check_policy(policy: Any) -> None:
    """Raise ValueError unless `policy` is a policy with a name; a function is not."""
    if isinstance(policy, type) or not all(hasattr(policy, name) for name in POLICY):
        raise ValueError(
            f"a policy must have {', '.join(POLICY)}: load_agent(...) gives one; Function(...), "
            f"Network(...), from_sb3(...) and from_torchrl(...) make one; got {shown(policy)}"
        )
    of_kind("a policy's name", policy.name, str)
