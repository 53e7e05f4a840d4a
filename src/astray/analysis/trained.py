"""Trained networks as policies.

An `Agent` comes from a file of astray's, a `Network` is any torch module of yours, and `Opaque` is
any other policy, for analyses that also accept one without a network.
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
import torch
from gymnasium.spaces import Box, Space

from astray.acting import Answer, Asking, Policy, Turn
from astray.agents import policy
from astray.agents.names import is_own
from astray.agents.recurrent import Recurrent
from astray.analysis.policies import Random, Walk, episode_noise
from astray.envs.restarting import action_table, as_seen
from astray.envs.vector import GameVectorEnv, Observation
from astray.envs.worlds import WorldVectorEnv
from astray.game import OWN, Game
from astray.imports import guarded
from astray.training import ppo
from astray.training.environments import shown_in_training
from astray.training.folders import AgentFolder
from astray.validation import check_words, of_kind, one_of, shown
from astray.world import World

# Observations per forward pass: more are not faster for a large network, and padding a batch to a
# multiple of it costs time.
AT_ONCE = {"symbolic": 64, "image": 16}
IMAGE = 64 * 64  # numbers in an observation from which on it is passed on as an image
IMAGES, COLOURS_FIRST = (Box(0, 255, s, np.uint8) for s in ((64, 64, 3), (3, 64, 64)))  # of games
# Multiplications per forward pass below which a second thread costs more than it saves, up to five
# times as much on busy processors.
FEW = 200_000_000
ALONE = "a memory: along an episode it remembers, elsewhere it is asked as at the beginning of one."
BY_ITSELF = f"This agent has {ALONE}"


def chosen(
    logits: torch.Tensor, mode: Literal["sampled", "greedy"], seed: int, env: Any
) -> np.ndarray:
    """Return the actions [N] of a policy with logits [N, A] in the states of `env`."""
    if mode == "greedy":
        return logits.argmax(-1).numpy(force=True)
    uniform = torch.from_numpy(episode_noise(seed, env.states, logits.shape[1]))
    return ppo.sample(logits, uniform.to(logits.device))[0].numpy(force=True)


def check_scale(who: str, space: Any, observations: Any) -> None:
    """Raise ValueError if `space` has reals, and the integers [N, ...] are larger than its bound.

    A network that learned from images of 0 to 1 would also answer to 0 to 255.
    """
    if not isinstance(observations, np.ndarray) or not isinstance(space, Box):
        return
    if observations.dtype.kind not in "iu" or space.dtype.kind != "f":
        return
    if (found := observations.max(initial=0)) > (most := space.high.max()):
        told = f"the environment shows {observations.dtype} up to {found}"
        raise ValueError(f"{who} sees numbers up to {most:g}, as its space says; {told}")


def recalled(
    network: Recurrent, turn: Turn, device: str | torch.device, chunk: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the logits [N, A] of a network with memory in a turn, and its new states."""
    shown, begins = (torch.from_numpy(x).to(device) for x in (turn.observations, turn.begins))
    none = torch.zeros((len(shown), network.memory), device=device)
    state = none if turn.memory is None else torch.where(begins[:, None], none, turn.memory)
    with policy.evaluating(network):
        logits, _, state = policy.outputs(network.recall, shown, chunk, state, begins)
    return logits, state


def in_order(
    network: Recurrent, observations: np.ndarray, device: str | torch.device
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return logits [T, A] and values [T] of a network with memory along one episode."""
    seen = torch.from_numpy(observations).to(device)[:, None]
    begins = torch.arange(len(seen), device=device)[:, None] == 0
    state = torch.zeros((1, network.memory), device=device)
    with torch.no_grad(), policy.evaluating(network):
        logits, values, _ = network.unroll(seen, state, begins)
    return logits[:, 0], values[:, 0]


def answered(agent: Any, turn: Turn) -> Answer:
    """Return the actions of a policy with a network; raise ValueError if logits do not give any."""
    env, space, memory = turn.env, turn.env.single_action_space, None
    actions = action_table(space)
    if isinstance(env, WorldVectorEnv) and not isinstance(agent, Network):  # as in its training
        space_here, seen = env.single_observation_space, turn.observations
        seen = as_seen(space_here, agent.observation, seen, agent.trained)
        turn = turn._replace(observations=seen)
    if isinstance(agent.network, Recurrent) and not getattr(agent, "ask", None):
        logits, memory = recalled(agent.network, turn, agent.device, AT_ONCE[agent.observation])
    else:
        logits, _ = agent.outputs(turn.observations)
    name = f"the agent at {agent.path}" if isinstance(agent, Agent) else agent.name
    if logits.shape[1] != len(actions):
        raise ValueError(f"{name} has {logits.shape[1]} logits for actions of {space}")
    if not logits.isfinite().all():
        raise ValueError(f"{name} gives logits that are not finite")
    mode: Any = getattr(agent, "mode", agent.name)
    return Answer(actions[chosen(logits, mode, agent.seed, env)], memory)


@dataclass
class Agent:
    """A trained network; `mode` "sampled" samples actions, "greedy" takes the most likely."""

    path: Path  # checkpoint's agent.safetensors
    game: str
    mode: Literal["sampled", "greedy"] = "sampled"
    seed: int = 0  # seed of the sampling
    device: str = "cpu"
    art: str = OWN  # art of its observations
    network: torch.nn.Module = field(init=False, repr=False)
    architecture: policy.Architecture = field(init=False)
    threads: int = field(init=False, repr=False)  # threads of `outputs` on a CPU
    _kept: Any = field(init=False, repr=False, compare=False, default=None)  # see `asked_once`

    def __post_init__(self) -> None:
        check_words(self)
        self.network, self.architecture = policy.load(self.path, self.game, self.device)
        self.threads = torch.get_num_threads()
        if self.threads > 1 and is_own(self.architecture.name):  # others may not bear to be tried
            each = policy.products(self.network, self.architecture.shape, self.device)
            if each * AT_ONCE[self.observation] < FEW:
                self.threads = 1

    @property
    def name(self) -> str:
        return self.mode

    @property
    def origin(self) -> tuple[str, int, int | None]:
        """Return its run folder, seed and training steps."""
        its = AgentFolder.of(self.path)
        return str(its.path), self.seed, its.steps

    @property
    def observation(self) -> Observation:
        vectors = len(self.architecture.shape) == 1  # of a World
        return "symbolic" if self.architecture.largest or vectors else "image"

    @property
    def space(self) -> Box:
        """Return the space of one observation."""
        if len(self.architecture.shape) == 1:
            return Box(-np.inf, np.inf, self.architecture.shape, np.float32)
        return Box(0, 255, self.architecture.shape, np.uint8)

    @cached_property
    def trained(self) -> Space | None:
        """Return the space of observations in its training in a `World`, if they were vectors."""
        is_vector = self.observation == "symbolic"
        return shown_in_training(AgentFolder.of(self.path).config()) if is_vector else None

    def asked(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return logits [N, A] and values [N] of one pass, with gradients."""
        return self.network(observations)

    @property
    def caveat(self) -> str:
        """Return a sentence on what its outputs in a single state mean; "" without a memory."""
        return BY_ITSELF if isinstance(self.network, Recurrent) else ""

    def outputs(
        self, observations: np.ndarray, *, episode: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return logits [N, A] and values [N] for `observations` [N, ...].

        Args:
            episode: Whether these are the observations of one episode from its first step on, so
                that a network with memory remembers those before. Otherwise it answers each as if
                it began an episode.

        Raises:
            ValueError: If the observations have another shape, or are reals in place of integers.
        """
        of_kind("observations", observations, np.ndarray)
        if self._kept and not episode and np.array_equal(self._kept[0], observations):
            return self._kept[1]
        shown, known = observations.shape[1:], self.architecture.shape
        if shown != known:
            raise ValueError(f"the agent sees observations of shape {known}, not {shown}")
        if observations.dtype.kind == "f" and len(known) == 3 and is_own(self.architecture.name):
            raise ValueError(f"the agent sees integers from 0 to 255, not {observations.dtype}")
        if episode and isinstance(self.network, Recurrent):
            return in_order(self.network, observations, self.device)
        chunk = AT_ONCE[self.observation]
        shown_here = torch.from_numpy(observations).to(self.device)
        before = torch.get_num_threads()
        torch.set_num_threads(self.threads)
        try:
            logits, values = policy.outputs(self.network, shown_here, chunk)
        finally:
            torch.set_num_threads(before)
        if self._kept is not None:
            self._kept = observations, (logits, values)
        return logits, values

    @contextlib.contextmanager
    def asked_once(self) -> Iterator[None]:
        """Cache the network's outputs for the last observations, in which it must not change."""
        self._kept = ()
        try:
            yield
        finally:
            self._kept = None

    def actions(self, turn: Turn) -> Answer:
        """Return an action per state; raise ValueError for other art or nonfinite logits."""
        env = turn.env
        if self.observation == "image" and env.art != self.art:
            raise ValueError(
                f"the agent is to see art {self.art!r}; these images are drawn with {env.art!r}"
            )
        return answered(self, turn)


@dataclass
class Network:
    """A policy that is any torch module, which insight can also look into.

    Examples:
        >>> body = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(64 * 64 * 3, 15))
        >>> space = gymnasium.spaces.Box(0, 255, (64, 64, 3), np.uint8)
        >>> policy = astray.Network(body, space, ask=lambda network, x: network(x.float()))
        >>> policy.outputs(np.zeros((2, 64, 64, 3), np.uint8))[0].shape
        torch.Size([2, 15])

    Attributes:
        network: Module that returns logits [N, A] for observations [N, ...], or a tuple of logits
            and values [N]. It is asked in evaluation mode, and is then as it was. A `Recurrent`
            one, without `ask`, has a memory, and remembers along an episode.
        space: Space of one observation.
        game: Game or `World` that it plays, for analyses that play it.
        ask: Function (network, observations) -> logits, or logits and values, if a call of the
            network does not return these: lambda agent, x: (agent.actor(x), agent.critic(x)).
        mode: "sampled" draws actions from the policy, "greedy" takes the most likely.
        seed: Seed of the sampling; an action depends on it, the level and the step alone.

    Raises:
        ValueError: If the network returns anything else.
    """

    network: torch.nn.Module
    space: Box
    game: str | Game | World = ""
    ask: Callable[[Any, torch.Tensor], Any] | None = None
    name: str = "network"
    mode: Literal["sampled", "greedy"] = "sampled"
    seed: int = 0
    observation: Observation = "image"
    art: str = OWN
    _is_checked: bool = field(init=False, repr=False, compare=False, default=False)

    def __post_init__(self) -> None:
        of_kind("network", self.network, torch.nn.Module)
        of_kind("space", self.space, Box)
        one_of("mode", self.mode, Literal["sampled", "greedy"])

    @property
    def caveat(self) -> str:
        return BY_ITSELF if isinstance(self.network, Recurrent) and not self.ask else ""

    @property
    def device(self) -> torch.device:
        return next((x.device for x in self.network.parameters()), torch.device("cpu"))

    def asked(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return logits [N, A] and values [N] (NaN if it has none) of one pass, with gradients.

        Raises:
            ValueError: If the network returns anything else.
        """
        told = f"{self.name}, asked about {observations.dtype} {list(observations.shape)},"
        # It may be amid a training, in which dropout is on.
        with guarded(told, ValueError, ImportError), policy.evaluating(self.network) as network:
            given = (self.ask or torch.nn.Module.__call__)(network, observations)
        parts: tuple[Any, ...] = given if isinstance(given, tuple) else (given,)
        n = len(observations)
        sizes = [list(getattr(part, "shape", ())) for part in parts]
        if [len(sizes[0]), *map(math.prod, sizes[1:])] not in ([2], [2, n]) or sizes[0][:1] != [n]:
            raise ValueError(
                f"{self.name} must give logits [{n}, actions], alone or before values [{n}]; got "
                f"{shown(sizes)}"
            )
        value = parts[1].reshape(n) if parts[1:] else parts[0].new_full((n,), torch.nan)
        return parts[0], value

    def outputs(
        self, observations: np.ndarray, *, episode: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return logits [N, A] and values [N], which do not depend on the batch.

        Args:
            episode: As an agent's.

        Raises:
            ValueError: If observations have another shape, or the network returns anything else,
                or logits that depend on the batch.
        """
        of_kind("observations", observations, np.ndarray)
        check_scale(self.name, self.space, observations)
        if observations.shape[1:] != self.space.shape:
            told = f"{self.space.shape}, not {observations.shape[1:]}"
            raise ValueError(f"{self.name} sees observations of shape {told}")
        if episode and self.caveat:
            return in_order(self.network, observations, self.device)  # pyrefly: ignore
        here = torch.from_numpy(observations).to(self.device)
        seen = "image" if math.prod(self.space.shape) >= IMAGE else "symbolic"
        logits, values = policy.outputs(self.asked, here, AT_ONCE[seen])
        if len(here) and not self._is_checked:
            policy.check_independent(self.asked, here[0], logits[0], AT_ONCE[seen], self.name)
            self._is_checked = True
        return logits, values

    def actions(self, turn: Turn) -> Answer:
        """Return an action per observation; raise ValueError if the logits do not give one."""
        if self.caveat and not self._is_checked:
            self.outputs(turn.observations[:1])
        return answered(self, turn)


@dataclass
class _Asks:
    policy: Policy

    @property
    def observation(self) -> Observation:
        return self.policy.observation

    @property
    def art(self) -> str:
        return self.policy.art

    def actions(self, turn: Turn) -> Answer:
        return self.policy.actions(turn)


@dataclass
class Loaded(_Asks):
    """A policy and the file or folder that it is from; one of several agents of one kind."""

    path: Path
    seed: int
    name: str = field(init=False, default="sampled")

    @property
    def origin(self) -> tuple[str, int, int | None]:
        """Return its file or folder, its seed, and its training steps, which are unknown."""
        return str(self.path), self.seed, None


@dataclass
class Opaque(_Asks):
    """A policy without a network, in the game in which analyses ask it for actions.

    Attributes:
        mode, seed: As an agent's; only random actions depend on the seed.
    """

    game: str
    mode: Literal["sampled", "greedy"] = "sampled"
    seed: int = 0
    caveat: ClassVar[str] = f"It may have {ALONE}"

    @property
    def name(self) -> str:
        return self.policy.name

    def actions(self, turn: Turn) -> Answer:
        if isinstance(drawn := self.policy, Random):
            drawn = replace(drawn, seed=drawn.seed + self.seed)
        with guarded(f"the policy {self.name!r}", ValueError, ImportError):
            return drawn.actions(turn)

    def chances(
        self, env: GameVectorEnv, observations: np.ndarray, asking: Asking | None = None
    ) -> np.ndarray:
        """Return its policy [N, A]: 1 for the action that it takes, or uniform if it is random.

        Args:
            env: Environments in the states [N].
            observations: [N, ...], observations of them.
            asking: Actor of this policy that remembers the episodes; None if they begin.
        """
        count = len(env.game.actions)
        if isinstance(self.policy, Random):
            return np.full((len(observations), count), 1 / count)
        asking = asking or Asking(self)
        begins = np.full(len(observations), not hasattr(asking, "turn"))  # of the first alone
        asking.send(0, 0, Turn(env, observations, begins))
        return np.eye(count)[asking.receive(0).actions]


def looked_into(policy: Policy, game: Game) -> Agent | Network | Opaque:
    """Return a policy in the form that analyses take: its network, or `Opaque` without one."""
    if isinstance(policy, Walk):
        one_of("goal", policy.goal, game.walked, of=game.name)
    found = getattr(policy, "network", None) if not isinstance(policy, Agent | Network) else policy
    if isinstance(found, Network):
        if (found.observation, found.space) == ("image", COLOURS_FIRST):  # behind a wrapper
            ask = found.ask or torch.nn.Module.__call__
            turned = {"ask": lambda net, seen: ask(net, seen.permute(0, 3, 1, 2)), "space": IMAGES}
            found = replace(found, **turned)
        return replace(found, game=game.name)
    return found if isinstance(found, Agent) else Opaque(policy, game.name)


def check_network(agent: Any) -> Agent | Network:
    """Return an agent; raise ValueError unless it has a network to look into."""
    if isinstance(agent, Opaque):
        raise ValueError(
            f"the policy {agent.name!r} has no network to look into: no probabilities, values or "
            "layers; astray.Network(module, ...) is a policy with one"
        )
    of_kind("agent", agent, Model)
    return agent


Model = Agent | Network
AnyModel = TypeVar("AnyModel", bound=Agent | Network)
