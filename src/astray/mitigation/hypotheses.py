"""Two hypotheses about the reward that agree in training and are made to differ in the test.

The method follows DivDis (Lee, Yao, Finn 2022) and concept extrapolation (Armstrong et al. 2023),
without reproducing either. Heads on shared features learn the labels of training frames while
their mutual information on unlabelled test frames is minimised. A few labelled test frames then
select a head.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from astray.training.trainer import Adam
from astray.validation import MOST, bounded, one_of

HIDDEN = 64
BATCH = 128  # frames of either kind in a step
RATE = 3e-3  # of Adam
TINY = 1e-9


@dataclass(frozen=True, eq=False)
class Frames:
    """Observations of states, and the hypotheses that hold in them.

    Attributes:
        seen: [N, ...] float32.
        labels: Name -> [N] bool, for the intended hypothesis and its proxies.
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
    """Return the mean mutual information of pairs of K heads over a batch, [B, K] -> [] nats."""
    both, found = torch.stack([probabilities, 1 - probabilities]), []  # [2, B, K]
    for one, other in itertools.combinations(both.unbind(2), 2):
        joint = torch.einsum("ab,cb->ac", one, other) / len(probabilities)
        alone = joint.sum(1, keepdim=True) * joint.sum(0, keepdim=True)
        found.append((joint * ((joint + TINY) / (alone + TINY)).log()).sum())
    return torch.stack(found).mean()


def train_heads(
    labelled: Frames,
    label: str,
    unlabelled: np.ndarray,
    *,
    diversity: float,
    steps: int = 600,
    seed: int = 0,
) -> Heads:
    """Train two heads to predict `label` on labelled frames and to differ on unlabelled ones.

    Args:
        unlabelled: [M, ...] float32.
        diversity: Weight of the mutual information; 0 gives an ordinary ensemble.

    Raises:
        ValueError: If no labelled frame has the label, or `steps` is out of range.
    """
    bounded("steps", steps, 1, MOST)
    one_of("label", label, labelled.labels)
    if not labelled.labels[label].any():
        raise ValueError(f"some of {len(labelled.seen)} frames must have the label {label!r}")
    random = np.random.default_rng(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        heads = Heads(int(np.prod(labelled.seen.shape[1:])), 2)
    optimizer = Adam(heads.parameters(), lr=RATE)
    seen, truth = torch.from_numpy(labelled.seen), torch.from_numpy(labelled.labels[label]).float()
    others, rate = torch.from_numpy(unlabelled), float(labelled.labels[label].mean())
    for _ in range(steps):
        known = torch.from_numpy(random.integers(len(seen), size=BATCH))
        new = torch.from_numpy(random.integers(len(others), size=BATCH))
        answers, elsewhere = heads(seen[known]), heads(others[new])
        wanted = truth[known, None].expand_as(answers)
        loss = nn.functional.binary_cross_entropy(answers, wanted)
        # A head that always says no tells nothing of the other: each is to say yes as often.
        rare = (elsewhere.mean(0) - rate).square().sum() / rate**2
        loss = loss + diversity * (mutual_information(elsewhere) / rate + 0.1 * rare)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return heads


@torch.no_grad()
def agreement(heads: Heads, frames: Frames, names: list[str]) -> np.ndarray:
    """Return the fraction of frames where each head agrees with each hypothesis, [K, H].

    Only frames in which the hypotheses differ count.
    """
    truths = np.stack([frames.labels[name] for name in names])
    distinguishing = (truths != truths[0]).any(0)
    answers = heads(torch.from_numpy(frames.seen[distinguishing])).numpy() > 0.5
    return (answers.T[:, None] == truths[None, :, distinguishing]).mean(2)


@torch.no_grad()
def chosen_rightly(
    heads: Heads, frames: Frames, label: str, counts: list[int], draws: int = 2000, seed: int = 0
) -> list[float]:
    """Return how often each number of labelled frames selects the better head.

    Ties are broken at random.

    Args:
        counts: Numbers of frames, drawn from those where the heads differ. Without such frames the
            result is 0.5.
    """
    random = np.random.default_rng(seed)
    answers = heads(torch.from_numpy(frames.seen)).numpy() > 0.5
    right = answers == frames.labels[label][:, None]
    better = int(right.mean(0).argmax())
    differ = np.flatnonzero(answers[:, 0] != answers[:, 1])
    if not len(differ):
        return [0.5] * len(counts)
    rates = []
    for count in counts:
        drawn = right[random.choice(differ, (draws, count))].sum(1)  # [draws, K]
        lead = drawn[:, better] - drawn[:, 1 - better]
        rates.append(float(np.mean((lead > 0) + 0.5 * (lead == 0))))
    return rates
