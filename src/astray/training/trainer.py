"""The state of a training, which a checkpoint must hold."""

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor, nn

from astray import imports
from astray.agents.names import is_own
from astray.agents.policy import Architecture, hollow
from astray.agents.recurrent import Recurrent
from astray.memory import check_memory
from astray.training import parallel, ppo
from astray.training.config import SOLVER, Config
from astray.training.fast import acceleration
from astray.training.fast.actor import Ahead
from astray.training.fast.graphs import Captured
from astray.training.levels import Growing, MakeSampler, Mixed, Sampler
from astray.training.player import RECENT, Player
from astray.training.replay import Replay
from astray.training.rollout import Actor, Rollout, act
from astray.training.teacher import Solver, Teacher
from astray.training.teacher import loss as distilled
from astray.validation import MOST, bounded, brief, of_kind
from astray.world import World

PER_WEIGHT = 16  # bytes: float32 weight, gradient, and Adam's two moments
PER_SAMPLE = 28  # bytes beside the observation: an int64 and five float32
MOMENTS = ("exp_avg", "exp_avg_sq")  # Adam's, for each weight
METHODS = [name for name in vars(Sampler) if not name.startswith("_")]


class Adam(torch.optim.Adam):
    """`torch.optim.Adam` without the import of torch's compiler, which takes a second.

    Its methods import the compiler to tell it to skip them. No training here compiles a step of the
    optimizer.
    """

    add_param_group = inspect.unwrap(torch.optim.Adam.add_param_group)
    state_dict = inspect.unwrap(torch.optim.Adam.state_dict)
    load_state_dict = inspect.unwrap(torch.optim.Adam.load_state_dict)
    zero_grad = inspect.unwrap(torch.optim.Adam.zero_grad)
    step = torch.no_grad()(inspect.unwrap(torch.optim.Adam.step))


class Trainer:
    """The network, its optimizer, and the players of the training and validation variants.

    Args:
        teacher: Weights of the agent that `config` names as teacher.
    """

    def __init__(self, config: Config, teacher: Path | None = None):
        self.config, custom = config, config.custom()
        self.steps = 0  # environment steps done
        variant, groups = config.training_variant(), acceleration.groups(config)
        chooses, reward = _sampler(config, custom.get("sampler")), custom.get("reward")
        self.player = Player(config, variant, config.training_levels, 1, groups, chooses, reward)
        self.validation: Player | None = None
        if config.validation:
            other, unseen = config.variant_for(config.validation), config.unseen_levels
            self.validation = Player(config, other, unseen, 2, groups, reward=reward)
            shapes = [player.space.shape for player in (self.validation, self.player)]
            if shapes[0] != shapes[1]:
                raise ValueError(
                    f"validation must be a variant whose observations have the shape of the "
                    f"training's; got {config.validation!r} of {shapes[0]}, and "
                    f"{config.variant!r} of {shapes[1]}"
                )
        game, space = self.player.game, self.player.space
        largest = ()
        if config.observation == "symbolic" and not isinstance(game, World):
            largest = tuple(int(k) for k in game.symbols.planes(variant).max((1, 2)))
        self.architecture = Architecture(
            config.network, space.shape, largest, self.player.actions, config.scale, config.width
        )
        self.build = custom.get("network", Architecture.build)
        self.network = self._made()
        self.weights = list(self.network.parameters())
        self.memory = self.network.memory if isinstance(self.network, Recurrent) else 0
        _check_divided(config, self.memory)
        usual = ppo.loss if config.teacher is None else distilled
        loss = custom.get("loss", usual)
        self.fast = acceleration.accelerate(self.network, loss, config, self.architecture)
        self.actor = self._acts(self.player, config.num_steps)
        self.validator = self._acts(self.validation, 1) if self.validation else None
        self.teacher: Teacher | Solver | None = None
        if config.teacher == SOLVER:
            self.teacher = Solver(config, self.actor, self.actor.rollout)
        elif config.teacher is not None:
            if teacher is None:
                raise ValueError(f"a student of {config.teacher} must have a run folder")
            self.teacher = Teacher(teacher, config, self.actor, self.actor.rollout)
        self._captured: dict[bool, Captured] = {}  # whether of lessons -> learning
        graphs, rate = self.fast.using.cudagraphs, config.learning_rate
        self.optimizer = Adam(
            self.weights,
            torch.tensor(rate, device=config.device) if graphs else rate,  # graphs read it
            eps=1e-5,
            fused=True,
            capturable=graphs,
        )

    def _acts(self, player: Player, slots: int) -> Actor | Ahead:
        rollout = Rollout(player, slots, self.memory)
        if self.config.device == "cuda" and not self.memory:
            return Ahead(self.fast.network, rollout, self.fast.using.cudagraphs)
        return Actor(self.fast.network, rollout)

    def _made(self) -> nn.Module:
        """Make the network; raise ValueError if it cannot play, or as `_check_memory` does."""
        config, is_ours = self.config, is_own(self.config.network)
        shown = self.player.images  # of a World they may be other arrays
        is_image = shown.ndim == 4 and shown.dtype == torch.uint8
        if is_image:  # also of Atari's 210 x 160 pixels; small worlds may have three rows
            first, *others = shown.shape[1:]
            is_image = not (first < others[0] == others[1] or (first <= 4 and min(others) > 32))
        if config.observation == "image" and is_ours and not is_image:
            raise ValueError(
                f"network {config.network!r} sees images [H, W, C] uint8; got {shown.dtype} of "
                f"shape {tuple(shown.shape[1:])}: observation 'symbolic' makes vectors for the "
                "network 'mlp'"
            )
        self._check_memory()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            network = self.build(self.architecture).to(config.device).eval()
            if not is_ours:
                name, seen = f"the network {config.network}", shown.to(config.device)
                with torch.no_grad(), imports.guarded(name, ValueError, ImportError):
                    said, none = network(seen), seen.new_zeros(len(seen), self.player.actions)
                    act(lambda _: said, none.float(), seen)
                    is_finite = said[0].isfinite().all()
                if not is_finite:
                    raise ValueError(f"{name} must return finite logits: -1e9 for a masked action")
        return network

    def _check_memory(self) -> None:
        """Raise MemoryError if a rollout and the network need more memory than the CPU has."""
        config, shown = self.config, math.prod(self.architecture.shape)
        name, passed = f"the network {config.network}", (ValueError, ImportError, RuntimeError)
        try:
            with imports.guarded(name, *passed, OverflowError):
                made = hollow(self.architecture, self.build)
                of_kind(f"what {config.network} makes", made, nn.Module)
                if isinstance(made, Recurrent):
                    bounded(f"memory of {config.network}", getattr(made, "memory", None), 1, MOST)
                if any(map(nn.parameter.is_lazy, made.parameters())):
                    told = "layers of known sizes, which its Architecture has; got lazy ones"
                    raise ValueError(f"{name} must be made of {told}")
                count = sum(x.numel() for x in made.parameters())
                if config.scale != 1:
                    plain = hollow(replace(self.architecture, scale=1), self.build).parameters()
                    if count == sum(x.numel() for x in plain):
                        told = f"has no scale; got {config.scale}"
                        raise ValueError(f"network {config.network} {told}")
        except (RuntimeError, OverflowError) as error:
            if "overflow" not in f"{error}".lower():
                of = f"{name} cannot be made for observations of {self.architecture.shape}"
                raise ValueError(f"{of}: {brief(error)}") from error
            of = f"a network of width {config.width} and scale {config.scale}"
            raise MemoryError(f"{of} has too many weights for any memory") from error
        samples = (config.num_steps + 1) * len(self.player.images)
        if config.device == "cpu":
            each = shown * self.player.images.itemsize + PER_SAMPLE
            told = f"{count:,} weights and rollouts of {samples:,} samples"
            check_memory(PER_WEIGHT * count + samples * each, told)

    def repeat(
        self, function: Callable[[Tensor], dict[str, Tensor]], indices: Tensor
    ) -> dict[str, Tensor]:
        """Return `function(indices)`, [B]; CUDA graphs replay that of the first call."""
        if not self.fast.using.cudagraphs:
            return function(indices)
        if self.is_taught not in self._captured:
            self._captured[self.is_taught] = Captured(function, indices, state=self.learned)
        return self._captured[self.is_taught](indices)

    def learned(self) -> list[Tensor]:
        """Return the tensors that the optimizer changes: weights, and moments once they exist."""
        moments = [x for state in self.optimizer.state.values() for x in state.values()]
        return [*self.weights, *moments]

    @property
    def is_taught(self) -> bool:
        """Whether the teacher is asked about the next rollout; otherwise rewards teach."""
        return self.teacher is not None and self.steps < self.config.taught * self.config.steps

    @property
    def iteration(self) -> int:
        return self.steps // self.config.batch

    @property
    def validated(self) -> int:
        """Number of steps that each environment of the validation has played."""
        return -(-self.iteration // self.config.validation_every) * self.config.num_steps

    def players(self) -> dict[str, Player]:
        both = {"training": self.player, "validation": self.validation}
        return {name: player for name, player in both.items() if player is not None}

    def tensors(self) -> dict[str, Tensor]:
        """Return all state except the weights that a resumed training needs."""
        result = {"steps": torch.tensor([self.steps])}
        for name, player in self.players().items():
            result |= {f"{name}.{key}": value for key, value in player.tensors().items()}
        for name, one in self._remembers().items():
            states = parallel.joined(one.state.numpy(force=True))
            result[f"{name}.memory"] = torch.from_numpy(states)
        for k, moments in self.optimizer.state_dict()["state"].items():
            result |= {f"adam.{k}.{key}": value.cpu() for key, value in moments.items()}
        return result

    def _remembers(self) -> dict[str, Rollout | Teacher]:
        """Return all that holds states of networks with memory, which a checkpoint must hold."""
        actors = {"training": self.actor, "validation": self.validator}
        found: dict[str, Rollout | Teacher] = {
            name: actor.rollout for name, actor in actors.items() if actor and self.memory
        }
        if isinstance(self.teacher, Teacher) and self.teacher.state.shape[1]:
            found["teacher"] = self.teacher
        return found

    def _check(self, tensors: dict[str, Tensor]) -> None:
        """Check names, dtypes and shapes of `tensors` against this training's own.

        The optimizer's moments, which the first step creates, and the number of recent episodes
        may differ.
        """
        wanted, its = self.tensors(), self.config
        all_learn = is_own(its.network) and its.loss is its.teacher is None
        for k, weight in enumerate(self.weights):  # others may be frozen, or not asked
            if all_learn or _below(tensors, f"adam.{k}."):
                wanted |= {f"adam.{k}.{name}": weight.cpu() for name in MOMENTS}
                wanted[f"adam.{k}.step"] = torch.zeros(())
        if odd := sorted(wanted.keys() ^ tensors.keys()):
            raise ValueError(f"{odd[0]} is {'missing' if odd[0] in wanted else 'not one of its'}")
        for name, like in wanted.items():
            given, shape = tensors[name], list(like.shape)
            if name.endswith(".recent"):
                shape[0] = min(len(given) if given.ndim else 0, RECENT)
            if name.endswith(".actions"):  # of a World's episodes, which are of any length
                shape[0] = len(given) if given.ndim else 0
            if given.dtype != like.dtype or list(given.shape) != shape:
                raise ValueError(
                    f"{name} must be {like.dtype} {shape}; got {given.dtype} {list(given.shape)}"
                )
            if given.is_floating_point() and not given.isfinite().all():
                raise ValueError(f"{name} has numbers that are not finite")
        steps = int(tensors["steps"])
        if steps < 0 or steps % self.config.batch:
            raise ValueError(f"steps must be a multiple of {self.config.batch}; got {steps}")

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from the result of `tensors`; raise ValueError if it is of other settings."""
        self._check(tensors)
        self.steps = int(tensors["steps"])
        for name, player in self.players().items():
            player.restore(_below(tensors, f"{name}."))
        for name, one in self._remembers().items():
            one.state = tensors[f"{name}.memory"][self.player.here].to(self.config.device)
        moments = {k: _below(tensors, f"adam.{k}.") for k in range(len(self.weights))}
        known = {"state": {k: its for k, its in moments.items() if its}}
        self.optimizer.load_state_dict(self.optimizer.state_dict() | known)
        for weight, state in self.optimizer.state.items():
            for name in MOMENTS:  # laid out as the weights are
                state[name] = torch.empty_like(weight).copy_(state[name])

    def close(self) -> None:
        """Release the CUDA graphs; a communicator between processes cannot end before that."""
        for captured in self._captured.values():
            captured.graph.reset()
        for player in self.players().values():
            for env in player.envs:
                env.close()


def _sampler(config: Config, make: MakeSampler | None) -> Sampler | None:
    """Return the sampler of training levels; None if the environments draw them."""
    if (kind := config.sampler.kind) == "uniform":
        return None
    if make is None:
        return {"mixed": Mixed, "growing": Growing}.get(kind, Replay)(config)
    guard = functools.partial(imports.guarded, f"the sampler {kind}", ValueError, ImportError)
    with guard():
        of_kind(f"what {kind} makes", found := make(config), Sampler)
    asked: Any = SimpleNamespace(**{name: guard()(getattr(found, name)) for name in METHODS})
    return asked


def _check_divided(config: Config, memory: int) -> None:
    """Raise ValueError unless minibatches divide what each of the processes plays."""
    whole = config.num_envs, "environments (whole ones for a network with memory)"
    count, what = whole if memory else (config.batch, "samples")
    if count // parallel.size() % config.minibatches:
        raise ValueError(
            f"{count} {what} of {parallel.size()} processes are not divided by "
            f"{config.minibatches} minibatches"
        )


def _below(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
