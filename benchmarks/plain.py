"""PPO's loop as others write it, with our network and settings: what ours is measured beside.

After CleanRL's `ppo_procgen.py`: eager, float32, everything kept on the device. With `host` it
has the shape of the original's loop (`train-procgen-pytorch`): what is kept lies in numpy arrays,
and every step and every minibatch is copied to the device. Neither writes logs, and rewards are
not normalised; an episode cut by the time limit counts as terminated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical

from astray.training.config import Config


class Loop:
    """One network that learns in `env`, a batch of Gymnasium's or EnvPool's environments."""

    def __init__(self, config: Config, network: nn.Module, env: Any, host: bool):
        network.to(config.device, memory_format=torch.contiguous_format)  # pyrefly: ignore
        self.config, self.network, self.env = config, network, env
        self.keep = "cpu" if host else config.device
        self.optimizer = torch.optim.Adam(network.parameters(), config.learning_rate, eps=1e-5)
        self.seen, self.done = env.reset()[0], np.zeros(config.num_envs)

    def _see(self, images: np.ndarray) -> Tensor:
        """Images [N, H, W, C] as EnvPool has them too, [N, C, H, W]."""
        given = torch.as_tensor(images, device=self.config.device)
        return given.permute(0, 2, 3, 1) if given.shape[-1] != 3 else given

    def iterate(self) -> None:
        """Play a rollout and learn from it."""
        config, device = self.config, self.config.device
        steps, n = config.num_steps, config.num_envs
        first = self._see(self.seen)
        images = torch.zeros((steps, *first.shape), dtype=torch.uint8, device=self.keep)
        action, log_probability, reward, done, value = torch.zeros((5, steps, n), device=self.keep)
        for t in range(steps):
            seen = self._see(self.seen)
            images[t], done[t] = seen, torch.as_tensor(self.done)
            with torch.no_grad():
                logits, value[t] = self.network(seen)
                drawn = Categorical(logits=logits)
                chosen = drawn.sample()
            action[t], log_probability[t] = chosen, drawn.log_prob(chosen)
            self.seen, got, terminated, truncated, *_ = self.env.step(chosen.cpu().numpy())
            self.done = np.logical_or(terminated, truncated)
            reward[t] = torch.as_tensor(got)
        with torch.no_grad():
            after = self.network(self._see(self.seen))[1].to(self.keep)
        advantage, carry = torch.zeros_like(reward), torch.zeros(n, device=self.keep)
        going = 1 - torch.as_tensor(self.done, dtype=torch.float32, device=self.keep)
        for t in reversed(range(steps)):
            error = reward[t] + config.gamma * after * going - value[t]
            carry = error + config.gamma * config.lam * going * carry
            advantage[t], after, going = carry, value[t], 1 - done[t]
        kept = [images, action, log_probability, value, advantage, advantage + value]
        self._learn([x.flatten(0, 1) for x in kept], device)

    def _learn(self, kept: list[Tensor], device: str) -> None:
        config, size = self.config, self.config.batch // self.config.minibatches
        order = np.arange(config.batch)
        for _ in range(config.epochs):
            np.random.default_rng().shuffle(order)
            for start in range(0, config.batch, size):
                chosen = torch.as_tensor(order[start : start + size], device=self.keep)
                images, action, was, old, advantage, target = (x[chosen].to(device) for x in kept)
                logits, value = self.network(images)
                drawn = Categorical(logits=logits)
                log_ratio = drawn.log_prob(action) - was
                ratio = log_ratio.exp()
                _ = (ratio - 1 - log_ratio).mean().item()  # CleanRL's log waits for the device
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                bounded = ratio.clamp(1 - config.clip, 1 + config.clip)
                surrogate = torch.max(-advantage * ratio, -advantage * bounded).mean()
                near = old + (value - old).clamp(-config.clip, config.clip)
                critic = 0.5 * torch.max((value - target) ** 2, (near - target) ** 2).mean()
                loss = surrogate - config.entropy_weight * drawn.entropy().mean()
                self.optimizer.zero_grad()
                (loss + config.value_weight * critic).backward()
                nn.utils.clip_grad_norm_(self.network.parameters(), config.gradient_norm)
                self.optimizer.step()
