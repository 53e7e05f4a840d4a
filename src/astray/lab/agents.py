"""Agents' policies, values and facts as plain data for a page."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from astray import games
from astray.analysis.critic import ask, visit
from astray.analysis.policies import Walk
from astray.analysis.runs import open_run, shift_of
from astray.analysis.trained import Agent, Network, Opaque, check_network
from astray.game import Game, Variant
from astray.insight.actions import effects
from astray.insight.activations import layers
from astray.insight.episode import GAMMA, LAMBDA
from astray.lab import steering
from astray.lab.messages import Message
from astray.lab.worlds import Episode, World, as_json
from astray.training import folders
from astray.training.config import Config
from astray.training.folders import AgentFolder
from astray.validation import one_of

AT_ONCE = 64  # places whose arrows are computed together, and sent
FIRST_VISITED, VISITED, EACH = 900_000, 150, 4  # levels whose states probes are fitted in
Shown = Agent | Network | Opaque
FAR = 16  # cells from the agent, of places in worlds that are larger than what is seen at once
LARGE = 32  # cells a side of such a world


@dataclass(eq=False)
class Agents:
    """The agents available to a page: pretrained, imported, and those of the start.

    Attributes:
        paths: Name -> run folder.
        given: Name -> policy without a run folder.
        tested: Variant that given policies are tested on; None for that of a game's first shift.
    """

    paths: Mapping[str, Path]
    given: Mapping[str, Network | Opaque] = field(default_factory=dict)
    tested: str | None = None
    _opened: dict[str, tuple[Agent, Config, float | None]] = field(default_factory=dict)
    _visited: dict[tuple[str, str, int], np.ndarray] = field(default_factory=dict)
    _last: tuple[Any, Shown] | None = None

    @classmethod
    def of(cls, runs: Mapping[str, Path], **more: Any) -> Agents:
        """Return the agents at `runs`, the given ones, and all pretrained and imported ones."""
        named = {name: folders.find(name) for name in folders.names()}
        return cls(named | dict(runs), **more)

    @property
    def names(self) -> list[str]:
        return [*dict.fromkeys([*self.given, *self.paths])]

    def open(self, name: str) -> tuple[Agent, Config]:
        """Return a named agent and its training's settings; raise ValueError if there is none."""
        if name in self.given:
            raise ValueError(f"the policy {name!r} has no run folder, with settings of a training")
        one_of("agent", name, self.names)
        if name not in self._opened:
            self.hold(name, *open_run(self.paths[name]))
        return self._opened[name][:2]

    def hold(self, name: str, agent: Agent, config: Config) -> None:
        """Show an agent as it is, with the unit of its values, which its training removes later."""
        self._opened[name] = agent, config, AgentFolder.of(agent.path).deviation()

    def player(self, name: str) -> Shown:
        """Return a named agent or policy; raise ValueError if there is none."""
        return self.given[name] if name in self.given else self.open(name)[0]

    def of_message(self, message: Message, world: World) -> Shown:
        """Return the agent that a message asks for, with its changes, for the world's game.

        Raises:
            ValueError: If there is none, or its layers cannot be changed so.
        """
        agent = self.player(message.agent)
        game = world.game
        if agent.game != game.name:
            raise ValueError(f"the agent {message.agent!r} plays {agent.game}, not {game.name}")
        agent = copy.copy(self._steered(agent, message, world) if message.steering else agent)
        agent.mode, agent.seed = message.mode, agent.seed + message.seed
        if isinstance(agent, Opaque) and isinstance(agent.policy, Walk):
            agent.policy = replace(agent.policy, _experts={})  # all drawn levels have one number
        return agent

    def _steered(self, agent: Shown, message: Message, world: World) -> Shown:
        """Return a copy of the agent with changed layers; the last one is cached."""
        agent = check_network(agent)
        key = (message.agent, repr(message.steering), world.key)
        if self._last is None or self._last[0] != key:
            other = copy.copy(agent)
            other.network = copy.deepcopy(agent.network)
            change = steering.change(other, world, message.steering)
            change.__enter__()  # for as long as any answer asks the copy, of any page
            other.network.change = change  # pyrefly: ignore
            self._last = key, other
        return self._last[1]

    def visited(self, name: str, world: World) -> np.ndarray:
        """Return states [N] of the agent's own episodes in the world's variant, for probes."""
        agent = check_network(self.player(name))
        numbers = range(FIRST_VISITED, FIRST_VISITED + VISITED + 1)
        spared = next((one for one in numbers if one == world.number), numbers[-1])
        key = (name, repr(world.variant), spared)
        if key not in self._visited:
            levels = [number for number in numbers if number != spared]
            self._visited[key] = visit(agent, world.variant, levels, per_episode=EACH)[1]
        return self._visited[key]

    def about(self, name: str) -> dict[str, Any]:
        """Return the page's description of an agent."""
        if name in self.given:
            return _about(self.given[name], self.tested)
        agent, config = self.open(name)
        game = config.find_game()
        try:
            shift = shift_of(config)
        except ValueError:
            shift = next(iter(game.shifts), "")
        test = game.shifts[shift].test if shift else config.variant
        own = dict(_own_variants(config, game))
        knobs = {name: variant.unlike(game.variants[name]) for name, variant in own.items()}
        return _told(agent, game, config.variant, test, shift) | {
            "variants": [name for name, variant in own.items() if sees(agent, game, variant)],
            "network": config.network, "steps": config.steps,
            "knobs": {name: changed for name, changed in knobs.items() if changed},
            "gamma": config.gamma, "lam": config.lam,
            "reward_deviation": self._opened[name][2],
            "caveat": f"{agent.caveat} {config.caveat}".strip(),
        }  # fmt: skip


def _about(policy: Network | Opaque, tested: str | None) -> dict[str, Any]:
    """Return the page's description of a policy that was not trained by astray."""
    game = games.find(str(policy.game))
    there = [(name, shift) for name, shift in game.shifts.items() if shift.test == tested]
    name, shift = next(iter(there or game.shifts.items()), ("", None))
    train, test = (shift.train, shift.test) if shift else [next(iter(game.variants))] * 2
    return _told(policy, game, train, test, name)


def _told(policy: Shown, game: Game, train: str, test: str, shift: str) -> dict[str, Any]:
    """Return the page's description of a policy, without a training's settings."""
    return {
        "game": game.name, "variant": train, "test": test, "shift": shift,
        "variants": [n for n, variant in game.variants.items() if sees(policy, game, variant)],
        "observation": policy.observation, "art": policy.art, "network": None,
        "knobs": {}, "steps": None, "gamma": GAMMA, "lam": LAMBDA, "seed": policy.seed,
        "reward_deviation": None,
        "caveat": policy.caveat,
        "layers": {} if isinstance(policy, Opaque) else {n: [*s] for n, s in layers(policy).items()}
    }  # fmt: skip


def _own_variants(config: Config, game: Game) -> Iterator[tuple[str, Variant]]:
    """Return all variants of the agent's game by name, with its knobs where possible."""
    for name, plain in game.variants.items():
        try:
            yield name, config.variant_for(name)
        except ValueError:
            yield name, plain


def sees(agent: Shown, game: Game, variant: Variant) -> bool:
    """Return whether observations of `variant` fit the agent's network."""
    if agent.observation == "image" or not game.symbols:
        return agent.observation == "image"
    return isinstance(agent, Opaque) or game.symbols.planes(variant).shape == agent.space.shape


def places(game: Game, s: Any) -> np.ndarray:
    """Return the possible cells [K, 2] of the agent, nearest to it first."""
    free = game.places.stand(s)
    (here,) = np.floor(game.places.centre(np.array([s], game.state))).astype(int)
    found = np.argwhere(free)[:, ::-1]
    if max(free.shape) > LARGE:
        found = found[(abs(found - here) <= FAR).all(1)]
    return found[np.argsort(abs(found - here).sum(1), kind="stable")]


def arrows(agent: Shown, episode: Episode, with_effects: bool = False) -> Iterator[dict[str, Any]]:
    """Yield policy [A] and value at all places in batches, nearest to the agent first.

    An agent that may have a memory remembers the episode in its present place, the first. With
    effects, `same` marks for each place the equivalent actions, as in `fields.effects`.
    """
    world, (s,) = episode.world, episode.state
    cells = places(world.game, s)
    for first in range(0, len(cells), AT_ONCE):
        some = cells[first : first + AT_ONCE]
        states = world.game.places.put(np.repeat(np.array([s], world.game.state), len(some)), some)
        policy, value = ask(agent, world.variant, states)
        if agent.caveat and not first:
            along = ask(agent, world.variant, np.concatenate(episode.states), episode=True)
            policy[0], value[0] = along[0][-1], along[1][-1]
        told = {"cells": some.tolist(), "policy": rounded(policy), "value": rounded(value)}
        if with_effects and not s.ended:  # else no action does anything
            told["same"] = effects(world.game, world.variant, states).tolist()
        yield told | {"of": len(cells)}


def rounded(numbers: np.ndarray) -> Any:
    """Round `numbers` [...] to eight decimal places."""
    return as_json(np.round(np.asarray(numbers, float), 8))
