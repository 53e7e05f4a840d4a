"""Two hypotheses of what is rewarded that agree in training and are made to differ in the test.

In the spirit of DivDis (Lee, Yao, Finn 2022) and of concept extrapolation (Armstrong et al. 2023),
not a reproduction of either: heads on shared features learn the labels of training frames, and the
less they tell of each other on unlabelled frames of the test, the better. A few labelled test
frames then say which head is meant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from astray.bounds import MOST, bounded

HIDDEN = 64
BATCH = 128  # frames of either kind in a step
RATE = 3e-3  # of Adam
TINY = 1e-9

Place = Callable[[np.ndarray], np.ndarray]  # states [N] -> [N] bool: the agent is there


@dataclass(frozen=True, eq=False)
class Frames:
    """What is seen of states, and which hypotheses hold in them.

    seen    [N, ...] float32
    labels  by name, [N] bool: the intended one and its proxies
    """

    seen: np.ndarray
    labels: dict[str, np.ndarray]


class Heads(nn.Module):
    """A network with several answers to one question: [B, ...] -> probabilities [B, K]."""

    def __init__(self, size: int, heads: int):
        super().__init__()
        self.body = nn.Sequential(
            nn.Flatten(), nn.Linear(size, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU()
        )
        self.answers = nn.Linear(HIDDEN, heads)

    def forward(self, seen: Tensor) -> Tensor:
        return self.answers(self.body(seen)).sigmoid()


def mutual_information(probabilities: Tensor) -> Tensor:
    """What each two heads' answers tell of each other, nats: [B, K] -> their mean over pairs.

    Of answers drawn from the heads' probabilities, over the batch.
    """
    heads, total = probabilities.shape[1], probabilities.new_zeros(())
    both = torch.stack([probabilities, 1 - probabilities])  # [2, B, K]
    for i in range(heads):
        for j in range(i + 1, heads):
            joint = torch.einsum("ab,cb->ac", both[:, :, i], both[:, :, j]) / len(probabilities)
            alone = joint.sum(1, keepdim=True) * joint.sum(0, keepdim=True)
            total = total + (joint * ((joint + TINY) / (alone + TINY)).log()).sum()
    return total / (heads * (heads - 1) / 2)


def train_heads(
    labelled: Frames,
    label: str,
    unlabelled: np.ndarray,
    *,
    diversity: float,
    steps: int = 600,
    seed: int = 0,
) -> Heads:
    """Two heads that learn `label` of the labelled frames, and to differ on the unlabelled.

    unlabelled  [M, ...] float32
    diversity   the weight of their mutual information; 0: an ensemble like any other
    """
    bounded("steps", steps, 1, MOST)
    random = np.random.default_rng(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        heads = Heads(int(np.prod(labelled.seen.shape[1:])), 2)
    optimizer = torch.optim.Adam(heads.parameters(), lr=RATE)
    seen, truth = torch.from_numpy(labelled.seen), torch.from_numpy(labelled.labels[label]).float()
    others, share = torch.from_numpy(unlabelled), float(labelled.labels[label].mean())
    for _ in range(steps):
        known = torch.from_numpy(random.integers(len(seen), size=BATCH))
        new = torch.from_numpy(random.integers(len(others), size=BATCH))
        answers, elsewhere = heads(seen[known]), heads(others[new])
        wanted = truth[known, None].expand_as(answers)
        loss = nn.functional.binary_cross_entropy(answers, wanted)
        # A head that always says no tells nothing of the other: each is to say yes as often.
        rare = (elsewhere.mean(0) - share).square().sum() / share**2
        loss = loss + diversity * (mutual_information(elsewhere) / share + 0.1 * rare)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return heads


@torch.no_grad()
def agreement(heads: Heads, frames: Frames, names: list[str]) -> np.ndarray:
    """The share of frames in which each head says what each hypothesis does, [K, H].

    Of the frames in which hypotheses differ: in the others nothing can be told.
    """
    truths = np.stack([frames.labels[name] for name in names])
    distinguishing = (truths != truths[0]).any(0)
    answers = heads(torch.from_numpy(frames.seen[distinguishing])).numpy() > 0.5
    return (answers.T[:, None] == truths[None, :, distinguishing]).mean(2)


@torch.no_grad()
def chosen_rightly(
    heads: Heads, frames: Frames, label: str, counts: list[int], draws: int = 2000, seed: int = 0
) -> list[float]:
    """How often so many labelled frames choose the head that is better on all; ties by chance.

    counts  numbers of frames drawn from those in which the heads' answers differ, where a label
            tells most; with none of these nothing can be chosen: 0.5
    """
    random = np.random.default_rng(seed)
    answers = heads(torch.from_numpy(frames.seen)).numpy() > 0.5
    right = answers == frames.labels[label][:, None]
    better = int(right.mean(0).argmax())
    differ = np.flatnonzero(answers[:, 0] != answers[:, 1])
    if not len(differ):
        return [0.5] * len(counts)
    shares = []
    for count in counts:
        drawn = right[random.choice(differ, (draws, count))].sum(1)  # [draws, K]
        lead = drawn[:, better] - drawn[:, 1 - better]
        shares.append(float(np.mean((lead > 0) + 0.5 * (lead == 0))))
    return shares
