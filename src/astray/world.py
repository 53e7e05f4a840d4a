"""Worlds: any Gymnasium environments, with the events and goals to look for in them."""

from __future__ import annotations

import contextlib
import inspect
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from operator import itemgetter
from typing import Any, ClassVar, NamedTuple, cast

import gymnasium
import numpy as np

from astray import games, imports
from astray.game import OWN, Game, Missing, Outcome, Shift, check_goals, check_names
from astray.record import record_dtype
from astray.validation import brief, finite, of_kind, of_numbers, one_of, plain, read_value, shown

Env = gymnasium.Env
Happened = str | Callable[[Any, Mapping[str, Any]], Any]
FAILURES = (Exception, SystemExit)  # of a world's code
GROUP = "astray.worlds"  # of entry points
SEEN = "observation"  # field of states that holds what an environment showed in them
NOT_OURS = {f.name for f in fields(Game)}  # names of a game, some of which a world has


class Failed(ValueError):
    """Error that the code of a world, such as an environment, caused."""


class Silent(RuntimeError):
    """Error that an environment does not answer, or its process died."""


@dataclass(frozen=True, eq=False)
class WorldVariant:
    """A factory of environments and the keyword arguments that it is called with."""

    world: str
    name: str
    factory: Callable[..., Env]
    texts: Collection[str]  # knobs that are text, as the defaults of one of the factories say
    knobs: Mapping[str, Any] = field(default_factory=dict)
    time_limit: ClassVar[int] = 0  # steps; unknown for an outside environment

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what Python itself asks for, also before there are knobs
            raise AttributeError(name)
        if name in self.knobs:
            return self.knobs[name]
        raise AttributeError(f"{self.world} {self.name} has no {name!r}")

    def with_knobs(self, changes: Mapping[str, Any]) -> WorldVariant:
        """Return the variant with arguments added.

        Text of a number, of true, false or None is that value, unless the knob is one of `texts`.

        Raises:
            ValueError: If its factory lacks one.
        """
        of_kind("knobs", changes, Mapping)
        knobs = {**self.knobs, **changes}
        try:
            inspect.signature(self.factory).bind_partial(**knobs)
        except TypeError as error:
            raise ValueError(f"the factory of {self} takes no such knob: {error}") from error
        except ValueError:  # of compiled code, which does not say what it takes
            pass
        knobs = {n: v if n in self.texts else _as_said(v) for n, v in knobs.items()}
        return replace(self, knobs=knobs)

    def alike(self, changes: Mapping[str, Any], other: WorldVariant) -> dict[str, Any]:
        """Return those `changes` whose knobs are set in neither variant, or equally in both."""
        mine, its = self.knobs, other.knobs
        return {n: v for n, v in changes.items() if mine.get(n) == its.get(n)}

    def to_json(self) -> dict[str, Any]:
        """Return the name and the knobs, in the form that settings files use."""
        return {"name": self.name, "knobs": dict(self.knobs)}

    def make(self) -> Env:
        """Return a new environment.

        Raises:
            ValueError: If the factory fails, or returns no `gymnasium.Env` with its spaces.
        """
        try:
            made = self.factory(**self.knobs)
        except FAILURES as error:
            told = shown(error) if isinstance(error, SystemExit) else brief(error)
            raise Failed(f"the factory of {self} fails: {told}") from error
        of_kind(f"the environment that the factory of {self} returns", made, Env)
        for name in ("observation_space", "action_space"):
            of_kind(f"the {name} of {self}", getattr(made, name, None), gymnasium.Space)
        if made.action_space.shape is None:
            raise ValueError(
                f"actions of {self} must be numbers or arrays: Discrete, Box, MultiDiscrete or "
                f"MultiBinary; got {shown(made.action_space)}"
            )
        return made

    def rendered(self) -> WorldVariant:
        """Return the variant whose environments render images.

        Raises:
            ValueError: If the factory neither sets render_mode="rgb_array" nor takes it.
        """
        env = self.make()
        mode = env.render_mode
        env.close()
        if mode == "rgb_array":
            return self
        try:
            shows = self.with_knobs({"render_mode": "rgb_array"})
            shows.make().close()
        except ValueError as error:
            told = f"a video of {self} needs a factory that takes or sets render_mode='rgb_array'"
            raise Failed(f"{told}: {brief(error)}") from error
        return shows

    def __str__(self) -> str:
        told = "".join(f", {name}={value}" for name, value in self.knobs.items())
        return f"{self.world} {self.name}{told}"


def _texts(factory: Callable[..., Env]) -> set[str]:
    """Return the arguments whose defaults are text; of compiled code, which says none, no names."""
    with contextlib.suppress(TypeError, ValueError):
        its = inspect.signature(factory).parameters.items()
        return {name for name, one in its if isinstance(one.default, str)}
    return set()


def _as_said(value: Any) -> Any:
    """Return the number, truth value or None that text or NumPy says, or else the value."""
    if isinstance(value, str):
        return None if value == "None" else read_value(value)
    return plain(value)


class Layout(NamedTuple):
    """The cells of a world whose agent moves from cell to cell, at one time.

    Attributes:
        free: [H, W] bool, indexed [y, x], y upward: the cells that the agent can stand in.
        agent: Its cell (x, y).
        goals: Cell (x, y) of each goal, or None if it is absent.
    """

    free: np.ndarray
    agent: tuple[int, int]
    goals: Mapping[str, tuple[int, int] | None]


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """Gymnasium environments in which goals may be pursued. A `Game` is the compiled counterpart.

    The number of a level is the seed of the reset that begins it. All environments of a world have
    the same spaces.

    Examples:
        >>> import gymnasium
        >>> from astray.analysis.policies import Random
        >>> lake = astray.World(
        ...     name="lake",
        ...     variants={"map": lambda **knobs: gymnasium.make("FrozenLake-v1", **knobs)},
        ...     events={"gift": lambda env, info: env.s == 15},
        ...     goals={"gift": "gift"},
        ...     shifts={},
        ... )
        >>> astray.evaluate(Random(), lake, "map", range(5))["gift"].null_count() <= 5
        True

    Attributes:
        variants: Name -> function that makes an environment; knobs are its keyword arguments.
        events: Name -> key of info, or function (unwrapped environment, info) -> whether the event
            happens in this step.
        goals: Name -> event, or an outcome known at an episode's end, as for a game.
        ends: Outcomes that are neither goals nor proxies, as for a game.
        experts: Goal -> function of the unwrapped environment that returns the next action towards
            it, for base rates.
        measures: Name -> function of the unwrapped environment that returns a number.
        cells: Function of the unwrapped environment that returns a `Layout`; the agency measure
            needs it.
        workers: Whether each environment has its own process.
        patience: Seconds to wait for an environment that does not answer.
        repeats: Whether an episode is determined by its level and the actions, which is checked.
            Otherwise policies meet other levels of one number, and none distinguishes goals.
        level_key: Key of info in which a reset reports the number of its level, for environments
            that choose their levels themselves, such as EnvPool's. They are played as streams:
            factories take `stream`, the number of an environment, and nothing is compared level by
            level.
        every_step: Whether measures are computed in every step, not only at events and at the end.
            For rewards of your own, visits and data sets they are.

    Raises:
        ValueError: If goals, shifts or experts name something that the world lacks.
    """

    name: str
    variants: Mapping[str, Callable[..., Env]]
    events: Mapping[str, Happened]
    goals: Mapping[str, Outcome]
    shifts: Mapping[str, Shift]
    ends: Mapping[str, Outcome] = field(default_factory=dict)
    experts: Mapping[str, Callable[[Any], Any]] = field(default_factory=dict)
    measures: Mapping[str, Callable[[Any], float]] = field(default_factory=dict)
    cells: Callable[[Any], Layout] | None = None
    about: str = ""
    workers: bool = False
    patience: float = 60.0
    repeats: bool = True
    every_step: bool = False
    level_key: str | None = None
    reported: set[str] = field(default_factory=set, init=False, repr=False)  # keys of info so far

    def __post_init__(self) -> None:
        check_names(self, "events", "experts")
        finite("patience", self.patience, 0.001)
        if self.level_key is not None and self.repeats:
            raise ValueError(
                f"levels that environments of {self.name} choose cannot be played again; say "
                "World(repeats=False)"
            )
        for name, happened in self.events.items():
            of_kind(f"the event {name!r}, a key of info or a function,", happened, str | Callable)
        for goal in self.experts:
            one_of("goal of an expert", goal, self.goals)
        check_goals(self)
        np.zeros(0, self.state)  # raises what a record of an episode cannot be

    def __getattr__(self, name: str) -> Any:
        if name in NOT_OURS:
            return Missing(self.name, name)
        raise AttributeError(f"a World has no {name!r}")

    @property
    def state(self) -> np.dtype:
        """The dtype that records an episode: its level, number of steps, events and measures."""
        told = [(name, np.int64) for name in ("level", "time", *self.events)]
        counted = [(name, np.float64) for name in self.measures]
        return record_dtype([("shifted", np.bool_), ("ended", np.bool_), *told, *counted])

    def shown(self, states: np.ndarray, observations: np.ndarray) -> np.ndarray:
        """Return records [N] of states [N] and their observations [N, ...].

        Raises:
            ValueError: If the observations are not an array, as those of a Dict space.
        """
        of_numbers("what a world shows to be kept", observations)
        seen = (SEEN, observations.dtype, observations.shape[1:])
        both = np.zeros(len(states), np.dtype([*states.dtype.descr, seen]))
        for name in states.dtype.names or ():
            both[name] = states[name]
        both[SEEN] = observations
        return both

    def check(self, states: np.ndarray, variant: Any) -> None:
        """Raise ValueError if states [N] were not made by `shown`."""
        if SEEN not in (states.dtype.names or ()):
            raise ValueError(
                f"states of {self.name} must be those that `critic.visit` returns, with what was "
                f"shown in them; got {shown(states.dtype)}"
            )

    def drawn(self, art: str, variant: Any = None) -> None:
        """Raise ValueError for any art except the world's own."""
        one_of("art", art, (OWN,), of=self.name)

    event_goals: ClassVar[Any] = Game.event_goals

    @cached_property
    def in_every_step(self) -> World:
        """The world with measures in every step, as rewards and data sets read; one `reported`."""
        made = replace(self, every_step=True)
        object.__setattr__(made, "reported", self.reported)
        return made

    @property
    def walked(self) -> tuple[str, ...]:
        """The goals for which there are experts."""
        return tuple(self.experts)

    @property
    def of_states(self) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
        """The measures, as functions of the records [N] of episodes."""
        return {name: itemgetter(name) for name in self.measures}

    def variant(self, name: Any) -> WorldVariant:
        """Return the variant of that name; a `WorldVariant` of this world is returned unchanged.

        Raises:
            ValueError: If there is none.
        """
        if isinstance(name, WorldVariant):
            return name
        one_of(f"variant of {self.name}", name, self.variants)
        # A factory that passes its arguments on, as a lambda does, does not say which are text.
        texts = set().union(*map(_texts, self.variants.values()))
        return WorldVariant(self.name, name, self.variants[name], texts)


_registered: dict[str, World] = {}


def register(world: World) -> None:
    """Register a world in this process, so that settings and files know its name.

    An installed package can offer its worlds to all processes by entry points of `GROUP`: name =
    "module:WORLD". A second registration replaces the first.

    Raises:
        ValueError: If the name is invalid, or a game's.
    """
    of_kind("a world", world, World)
    if not re.fullmatch(r"[\w.-]+", world.name) or world.name in games.names():
        raise ValueError(
            f"a world's name must be of letters, digits, _, - and ., and no game's; got "
            f"{world.name!r}"
        )
    _registered[world.name] = world


def find(game: str | Game | World) -> Game:
    """Return a world unchanged, or find a registered world, or a game as `games.find` does.

    A world is typed as a game here: it has the same names, and those that it lacks raise errors.

    Raises:
        ValueError: If there is none, or a package offers something else than a world of that name.
    """
    if isinstance(game, str) and game not in games.OWN:
        if game in _registered:
            return cast("Game", _registered[game])
        if values := [one.value for one in imports.offered(GROUP) if one.name == game]:
            of_kind(values[0], found := imports.only(game, values, GROUP), World)
            if found.name != game:  # settings keep the World's own name
                told = f"{values[0]} must be a World called {game!r}; got {shown(found.name)}"
                raise ValueError(told)
            return cast("Game", found)
    return cast("Game", game) if isinstance(game, World) else games.find(game)
