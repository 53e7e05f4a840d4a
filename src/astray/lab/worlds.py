"""Levels and episodes as a page shows them."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from astray import games, grid
from astray.acting import Asking, Onward, Policy, Step, Turn, initial_states, play
from astray.analysis.replay import Script
from astray.envs.beginnings import without_autoreset
from astray.envs.vector import quickest
from astray.game import Game, Variant
from astray.lab.messages import Message
from astray.level import Level
from astray.record import COMMON, LEVELS
from astray.validation import bounded

PAGE = Path(__file__).parent / "page"
LONGEST_ARRAY = 64  # items of a state's field that a page is told
OF_INTEREST = ("time", "ended")  # of the fields that all states have


@dataclass(frozen=True, eq=False)
class World:
    """A level and its initial state.

    Attributes:
        problem: Problem of a level that can be played nevertheless.
    """

    game: Game
    variant: Variant
    level: Level
    begin: Any
    number: int | None = None
    problem: str | None = None
    key: str = ""  # of the same level always the same

    def told(self) -> dict[str, Any]:
        """Return the level as plain data."""
        described = self.game.editing.describe(self.begin)
        return {
            "level": {"game": self.game.name} | described, "number": self.number,
            "text": str(self.level), "problem": self.problem,
            "state": snapshot(self.game, self.begin),
        }  # fmt: skip


def read_world(message: Message) -> World:
    """Return the level of a message.

    Raises:
        ValueError: If no episode can begin in it; the message is that of `Level`.
    """
    game = games.find(message.game)
    variant = game.variant(message.variant).with_knobs(message.knobs)
    key = json.dumps([message.game, message.variant, dict(message.knobs), message.level])
    if isinstance(message.level, int):
        number = message.level
        bounded("level", number, LEVELS.start, LEVELS.stop - 1)
        s = initial_states(game, variant, [number])[0]
        level = Level.of(game, variant, s)
        return World(game, variant, level, s, number, _problem(level), key)
    if isinstance(message.level, Mapping):
        level = Level.from_json(game, variant, _centred(game, variant, message.level))
    else:
        level = Level.from_text(game, variant, message.level)
    s = level.state(solvable=False)
    return World(game, variant, level, s, None, _problem(level), key)


def _centred(game: Game, variant: Variant, data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Move the agent in a level's data to the right point of its cell, since a page moves cells.

    Invalid data stay unchanged, for `Level` to report.
    """
    try:
        cells, looks = np.array(data["grid"], np.uint8), data.get("looks", {})
        x, y = (int(np.floor(number)) for number in data["agent"])
        Level(game, variant, cells, (x, y), looks)  # which checks what compiled code relies on
        s = game.editing.build(cells, (x, y), looks, variant)
        return {**data, "agent": game.editing.centre(s)}
    except (ValueError, TypeError, KeyError, IndexError, OverflowError, AttributeError):
        return data


def _problem(level: Level) -> str | None:
    if not level.game.solver:
        return None
    try:
        level.state()
    except ValueError as error:
        return str(error)
    return None


@functools.cache
def shown_fields(game: Game) -> tuple[str, ...]:
    """Return the fields of a state that a page draws from: numbers, and short arrays."""
    return tuple(
        name
        for name in game.state.names or ()
        if (name not in COMMON or name in OF_INTEREST)
        and name != "gap"
        and game.state[name].base.kind in "biuf"
        and game.state[name].shape in ((), *((n,) for n in range(LONGEST_ARRAY + 1)))
    )


def is_drawn(game: Game) -> bool:
    """Return whether the page has a module that draws the game; otherwise it draws cells."""
    return game.name in games.OWN and (PAGE / "games" / f"{game.name}.js").is_file()


def is_played(game: Game) -> bool:
    """Return whether the page can play the game without Python."""
    is_ours = game.name in games.OWN and (PAGE / "rules" / f"{game.name}.js").is_file()
    return is_ours or grid.world_of(game) is not None


def as_json(numbers: np.ndarray) -> Any:
    """Return `numbers` [...] as lists, None for NaN and infinity, which JSON lacks."""
    kept: Any = numbers.astype(object)
    kept[~np.isfinite(numbers)] = None
    return kept.tolist()


def snapshot(game: Game, s: Any) -> dict[str, Any]:
    """Return a state as plain data: the agent's place and everything that moves."""
    fields = {name: as_json(np.asarray(s[name])) for name in shown_fields(game)}
    if is_drawn(game):
        return fields
    fields |= {"agent": game.editing.centre(s), "grid": game.editing.grid(s).tolist()}
    return fields | ({"picture": game.sprites.agent(s)} if game.sprites else {})


@dataclass(eq=False)
class Episode:
    """The states of an episode so far, and its actions."""

    world: World
    states: list[np.ndarray]  # [1] each
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminated: bool = False
    ended: bool = False

    @classmethod
    def of(cls, world: World) -> Episode:
        return cls(world, [np.array([world.begin], world.game.state)])

    @property
    def state(self) -> np.ndarray:
        """The last state, [1]."""
        return self.states[-1]

    def play(self, policy: Policy, steps: int) -> Iterator[Step]:
        """Continue with a policy's actions for at most `steps` steps, and record each."""
        world, asking = self.world, Asking(policy)
        shown = policy.observation or quickest(world.game)
        env = without_autoreset(world.game, world.variant, 1, shown, policy.art)
        # One with memory may remember nothing in the first of them, and something later.
        for before in self.states[:-1] if getattr(policy, "caveat", "") else ():
            asking.send(0, 0, Turn.of(env, env.set_state(before)))
            asking.receive(0)
        onward = Onward(env, env.set_state(self.state))
        for step in play(asking, onward, steps):
            self.states.append(step.after.copy())
            self.actions.append(int(step.actions[0]))
            self.rewards.append(float(step.rewards[0]))
            self.terminated, self.ended = bool(step.terminated[0]), bool(step.ended[0])
            yield step
        env.close()

    def cut(self, steps: int) -> None:
        """Drop everything after the first `steps` steps."""
        if steps < len(self.actions):
            del self.states[steps + 1 :], self.actions[steps:], self.rewards[steps:]
            self.terminated = self.ended = False


def play_on(episode: Episode | None, world: World, actions: Sequence[int]) -> Episode:
    """Return the episode that `actions` make; replay only where `episode` differs.

    Raises:
        ValueError: If the episode ends before the last action.
    """
    if episode is None or episode.world.key != world.key:
        episode = Episode.of(world)
    same = 0
    for one, two in zip(episode.actions, actions, strict=False):
        if one != two:
            break
        same += 1
    episode.cut(same)
    for action in actions[same:]:
        bounded("an action", action, 0, len(world.game.actions) - 1)
    if left := len(actions) - same:
        script = Script(actions, observation=quickest(world.game))
        taken = sum(1 for _ in episode.play(script, left))
        if taken < left:
            raise ValueError(f"the episode has ended after {same + taken} steps")
    return episode
