"""Adapters: functions, models of other libraries, and running trainings as policies."""

import contextlib
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete, Space

from astray.acting import Answer, Turn, checked_actions
from astray.agents import policy as trained
from astray.analysis.trained import AT_ONCE, Network, answered, check_scale
from astray.envs.restarting import Restarting
from astray.envs.vector import Observation
from astray.game import OWN
from astray.imports import guarded
from astray.training.trainer import Trainer
from astray.validation import brief, check_words, of_kind, one_of, shown

LEARNED_FROM = "from_sb3 takes observation='image' or 'symbolic', as a model learned of a game; got"
STACKED = "It stacks no frames, as VecFrameStack does; a Function(..., remembers=True) can."


class Model(Protocol):
    """The method of a Stable-Baselines3 model that returns actions [N] and states [L, N, ...]."""

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]: ...


@dataclass
class Function:
    """Policy from a function of observations [N, ...] uint8 that returns actions [N].

    Examples:
        >>> right = astray.Function(lambda images: np.full(len(images), 7), name="right")
        >>> astray.evaluate(right, "maze", "corner", range(10)).height
        10

    Attributes:
        observation: "image" for [N, 64, 64, 3], "symbolic" for planes [N, C, H, W].
        art: Art of the images.
        remembers: Whether it also takes its memory and the flags of beginning episodes, and returns
            its memory with the actions.
        network: The network that it asks, if there is one that analyses can look into.

    Raises:
        ValueError: If a field is of another type, or it does not return an action per observation.
    """

    choose: Callable[..., Any]
    name: str = "function"
    observation: Observation = "image"
    art: str = OWN
    remembers: bool = False
    network: Network | None = None

    def __post_init__(self) -> None:
        of_kind("choose", self.choose, Callable)
        check_words(self)

    def actions(self, turn: Turn) -> Answer:
        """Return an action per observation; raise ValueError if the function does not."""
        told = (turn.memory, turn.begins) if self.remembers else ()
        with guarded(self.name, ValueError, ImportError):  # which say what is wrong
            answer = self.choose(turn.observations, *told)
        answer = answer if self.remembers else (answer, None)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise ValueError(f"{self.name} must return actions and its memory; got {shown(answer)}")
        return Answer(checked_actions(self.name, answer[0], turn), answer[1])


def from_sb3(
    model: Model,
    *,
    name: str = "sb3",
    greedy: bool = False,
    observation: Observation = "image",
    art: str = OWN,
) -> Function:
    """Make a policy of a Stable-Baselines3 model; torch's random state samples its actions.

    A recurrent model, as in sb3-contrib, begins every episode with empty memory. An actor and
    critic without memory, as of PPO and A2C, has a `network`, into which the lab and insight look.
    Both depend on the wrappers of its environment: give `load` the `env`, VecNormalize included.

    Args:
        greedy: Take its most likely action instead.

    Raises:
        ValueError: When it is shown observations of a kind or shape that it does not know, or at
            once if it masks actions, or explores as DQN does and is not `greedy`.
    """
    if hasattr(model, "exploration_rate") and not greedy:
        told = f"{type(model).__name__} explores at random for a whole batch at once, without seed"
        raise ValueError(f"{told}; give greedy=True")
    if "action_masks" in inspect.signature(model.predict).parameters:  # as MaskablePPO
        told = f"{type(model).__name__} would take actions that its masks forbid"
        raise ValueError(f"an environment tells no masks here, so that {told}")
    scaler: Any = getattr(model, "get_vec_normalize_env", lambda: None)()

    def choose(seen: Any, memory: Any, begins: np.ndarray) -> tuple[np.ndarray, Any]:
        seen = scaler.normalize_obs(seen) if scaler else seen
        check_scale(name, getattr(model, "observation_space", None), seen)
        # Its memory is [layers, N, ...]; rows of episodes are [N, layers, ...].
        state = None if memory is None else tuple(np.swapaxes(part, 0, 1) for part in memory)
        try:
            actions, state = model.predict(seen, state, begins, deterministic=greedy)
        except ValueError as error:
            raise ValueError(f"{brief(error)} {LEARNED_FROM} {observation!r}. {STACKED}") from error
        return actions, state and tuple(np.swapaxes(part, 0, 1) for part in state)

    network = None if scaler and scaler.norm_obs else _network_of(model, observation)
    if network:
        told = {"name": name, "observation": observation, "art": art}
        network = replace(network, mode="greedy" if greedy else "sampled", **told)
    return Function(choose, name, observation, art, remembers=True, network=network)


def _network_of(model: Any, observation: Observation) -> Network | None:
    """Return the actor and critic of a Stable-Baselines3 model without memory, or None."""
    policies = sys.modules.get("stable_baselines3.common.policies")  # whose models come from there
    net: Any = getattr(model, "policy", None)
    space, actions = (getattr(model, f"{of}_space", None) for of in ("observation", "action"))
    known = policies is not None and isinstance(net, policies.ActorCriticPolicy)
    if not known or hasattr(net, "lstm_actor"):
        return None
    if not isinstance(space, Box) or not isinstance(actions, Discrete):
        return None
    vectors, env = sys.modules["stable_baselines3.common.vec_env"], getattr(model, "env", None)
    turned = observation == "image" and space.shape == (3, 64, 64)  # as of a game here
    if env is not None:
        turned = vectors.is_vecenv_wrapped(env, vectors.VecTransposeImage)
    if turned:  # its wrappers put the colours of images first
        space = Box(0, 255, (*space.shape[1:], space.shape[0]), space.dtype.type)

    def ask(net: Any, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        seen = seen.permute(0, 3, 1, 2) if turned else seen
        return net.get_distribution(seen).distribution.logits, net.predict_values(seen)

    return Network(net, space, ask=ask)


def from_torchrl(
    actor: Callable[[Any], Any],
    *,
    name: str = "torchrl",
    greedy: bool = False,
    one_hot: bool = False,
    observation: Observation = "image",
    art: str = OWN,
) -> Function:
    """Make a policy of a TorchRL actor that reads "observation", "is_init" and writes "action".

    The entries that it writes under "next", as recurrent modules do, are its memory. It is asked in
    evaluation mode, and is then as it was.

    Args:
        greedy: Take the most likely action instead of drawing one.
        one_hot: Whether its actions are one-hot, [N, A].
    """

    def choose(seen: np.ndarray, memory: Any, begins: np.ndarray) -> tuple[np.ndarray, Any]:
        from tensordict import TensorDict
        from tensordict.nn import InteractionType, set_interaction_type

        told: Any = {"observation": seen, "is_init": begins[:, None], **(memory or {})}
        drawn = InteractionType.DETERMINISTIC if greedy else InteractionType.RANDOM
        is_module = isinstance(actor, torch.nn.Module)
        mode = trained.evaluating(actor) if is_module else contextlib.nullcontext()
        theirs: Any = sys.modules.get("torchrl.modules")  # else rows may be taken for steps
        by_step = theirs.set_recurrent_mode(False) if theirs else contextlib.nullcontext()
        with torch.no_grad(), set_interaction_type(drawn), mode, by_step:
            said = actor(TensorDict(told, [len(begins)]))
        action = said["action"].argmax(-1) if one_hot else said["action"]
        return action.numpy(force=True), dict(said.get("next", {}).items()) or None

    return Function(choose, name, observation, art, remembers=True)


@dataclass
class Learner:
    """The network of a running training as a policy; see `from_trainer`."""

    network: torch.nn.Module
    name: Literal["sampled", "greedy"]
    observation: Observation
    art: str
    seed: int
    device: str
    trained: Space | None  # of observations in the training, in a `World`

    def outputs(self, observations: np.ndarray) -> tuple[torch.Tensor, ...]:
        """Return logits [N, A] and values [N] for observations [N, ...]."""
        shown = torch.from_numpy(observations).to(self.device)
        return trained.outputs(self.network, shown, AT_ONCE[self.observation])

    def actions(self, turn: Turn) -> Answer:
        return answered(self, turn)


def from_trainer(trainer: Trainer, mode: Literal["sampled", "greedy"] = "sampled") -> Learner:
    """Make a policy of a running training, which acts as its next checkpoint would.

    Args:
        mode: "sampled" samples actions from the policy, "greedy" takes the most likely.
    """
    one_of("mode", mode, Literal["sampled", "greedy"])
    its, env = trainer.config, trainer.player.envs[0]
    trained = env.trained if isinstance(env, Restarting) else None
    return Learner(trainer.network, mode, its.observation, its.art, its.seed, its.device, trained)
