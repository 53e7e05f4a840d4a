"""PPO on Procgen's environments in one file, in the shape of CleanRL's scripts.

It was written for `from procgen import ProcgenEnv`; the line that imports it is all that changed.

    python ppo_procgen.py --env-id coinrun --total-timesteps 25000000
"""

import argparse
import time

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

from astray.compat import ProcgenEnv  # was: from procgen import ProcgenEnv


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--env-id", default="coinrun")
    parser.add_argument("--distribution-mode", default="easy")
    parser.add_argument("--num-levels", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--total-timesteps", type=int, default=25_000_000)
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--num-steps", type=int, default=256)
    parser.add_argument("--num-minibatches", type=int, default=8)
    parser.add_argument("--update-epochs", type=int, default=3)
    parser.add_argument("--learning-rate", type=float, default=5e-4)
    parser.add_argument("--gamma", type=float, default=0.999)
    parser.add_argument("--gae-lambda", type=float, default=0.95)
    parser.add_argument("--clip-coef", type=float, default=0.2)
    parser.add_argument("--ent-coef", type=float, default=0.01)
    parser.add_argument("--vf-coef", type=float, default=0.5)
    parser.add_argument("--max-grad-norm", type=float, default=0.5)
    return parser.parse_args()


class Agent(nn.Module):
    """Three convolutions, a policy and a critic."""

    def __init__(self, actions: int):
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(3, 16, 8, stride=4),
            nn.ReLU(),
            nn.Conv2d(16, 32, 4, stride=2),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(32 * 4 * 4, 256),
            nn.ReLU(),
        )
        self.policy, self.critic = nn.Linear(256, actions), nn.Linear(256, 1)
        nn.init.orthogonal_(self.policy.weight, 0.01)

    def forward(self, images: torch.Tensor) -> tuple[Categorical, torch.Tensor]:
        hidden = self.features(images.permute(0, 3, 1, 2).float() / 255)
        return Categorical(logits=self.policy(hidden)), self.critic(hidden).squeeze(-1)


def rollout(envs, agent, seen, first, args, buffers, returns, finished):
    """Play `num_steps` steps into the buffers; what is seen after them, and where that is first."""
    for t in range(args.num_steps):
        images = torch.from_numpy(seen["rgb"])
        with torch.no_grad():
            policy, value = agent(images)
            action = policy.sample()
        buffers["image"][t], buffers["first"][t] = images, torch.from_numpy(first)
        buffers["action"][t], buffers["value"][t] = action, value
        buffers["logprob"][t] = policy.log_prob(action)
        seen, reward, first, infos = envs.step(action.numpy())
        buffers["reward"][t] = torch.from_numpy(reward)
        returns += reward
        for i in np.flatnonzero(first):
            finished.append((infos[i]["prev_level_seed"], float(returns[i])))
        returns[first] = 0
    return seen, first


def advantages(buffers, last_value, last_first, args):
    """Generalised advantage estimates, [steps, envs]."""
    result, carry = torch.zeros_like(buffers["reward"]), torch.zeros_like(last_value)
    for t in reversed(range(args.num_steps)):
        end = t == args.num_steps - 1
        following = last_value if end else buffers["value"][t + 1]
        goes_on = 1 - (last_first if end else buffers["first"][t + 1])
        delta = buffers["reward"][t] + args.gamma * following * goes_on - buffers["value"][t]
        carry = delta + args.gamma * args.gae_lambda * goes_on * carry
        result[t] = carry
    return result


def learn(agent, optimizer, flat, args):
    """Several epochs of clipped updates on a rollout."""
    count = len(flat["action"])
    for _ in range(args.update_epochs):
        for part in torch.randperm(count).split(count // args.num_minibatches):
            batch = {name: x[part] for name, x in flat.items()}
            policy, value = agent(batch["image"])
            advantage = batch["advantage"]
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            ratio = (policy.log_prob(batch["action"]) - batch["logprob"]).exp()
            clipped = ratio.clamp(1 - args.clip_coef, 1 + args.clip_coef)
            actor = -torch.min(ratio * advantage, clipped * advantage).mean()
            critic = 0.5 * (value - batch["target"]).square().mean()
            loss = actor + args.vf_coef * critic - args.ent_coef * policy.entropy().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
            optimizer.step()


def main() -> None:
    args = arguments()
    torch.manual_seed(args.seed)
    envs = ProcgenEnv(
        num_envs=args.num_envs,
        env_name=args.env_id,
        num_levels=args.num_levels,
        start_level=0,
        distribution_mode=args.distribution_mode,
        rand_seed=args.seed,
    )
    agent = Agent(envs.action_space.n)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)
    shape = (args.num_steps, args.num_envs)
    buffers = {
        "image": torch.zeros((*shape, *envs.observation_space["rgb"].shape), dtype=torch.uint8),
        "action": torch.zeros(shape, dtype=torch.int64),
        **{name: torch.zeros(shape) for name in ("first", "value", "logprob", "reward")},
    }
    seen, first = envs.reset(), np.ones(args.num_envs, bool)
    returns, finished, began = np.zeros(args.num_envs), [], time.time()
    for update in range(1, args.total_timesteps // (shape[0] * shape[1]) + 1):
        seen, first = rollout(envs, agent, seen, first, args, buffers, returns, finished)
        with torch.no_grad():
            last_value = agent(torch.from_numpy(seen["rgb"]))[1]
        advantage = advantages(buffers, last_value, torch.from_numpy(first).float(), args)
        flat = {name: x.flatten(0, 1) for name, x in buffers.items()}
        flat |= {
            "advantage": advantage.flatten(),
            "target": (advantage + buffers["value"]).flatten(),
        }
        learn(agent, optimizer, flat, args)
        steps = update * shape[0] * shape[1]
        recent = [score for _, score in finished[-100:]]
        mean = np.mean(recent) if recent else float("nan")
        print(
            f"{steps} steps, return {mean:.3f}, {len(finished)} episodes, "
            f"weights {sum(float(x.double().sum()) for x in agent.parameters()):.10f}, "
            f"{steps / (time.time() - began):.0f} steps/s",
            flush=True,
        )
    envs.close()


if __name__ == "__main__":
    main()
