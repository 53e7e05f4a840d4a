"""Time until networks see, from labels, the shortest way to the cheese in a maze's picture.

Mazes have 3 to 25 cells a side, drawn in the paper's world of 25. For each picture a network learns
the direction of the first step of the shortest way, which the exact solver knows. Mouse and cheese
are anywhere. The largest mazes shown have 7 cells at first, and 2 more whenever it is mostly right
in the largest. All networks have the same pictures to begin with, the same learning rate and the
same rule of growth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from astray.agents.policy import Architecture, outputs
from astray.envs.vector import IMAGE, GameVectorEnv
from astray.games.maze.solve import routes
from astray.kernel.grid import STAY
from astray.record import trusted
from astray.training import ppo
from astray.training.config import PRESETS
from astray.training.fast.acceleration import accelerate, torch_settings
from benchmarks.tables import NOTHING

NETWORKS = ("cells", "strided-impala", "patch-impala", "patch", "impala")
LEVELS = (24_000, 3_000, 1_000)  # to learn from, unseen, and unseen from corner to corner
UNSEEN = 1_000_000  # the number of the first unseen level
BATCH = 250
RATE, WARM, DECLINE = 2e-3, 100, 0.3  # of learning; updates until it is full; end, when it falls
LARGEST = 3  # sizes of mazes that count as the largest; a third of all pictures are of these alone
ENOUGH = 0.87  # right in those: larger mazes come
MEMORY = 0.03  # weight of the last pictures in how often it was right
SIZES = (7, 15, 25)  # cells, that are reported by themselves
GUESS = "none: always the commonest direction"


@dataclass(frozen=True)
class Row:
    """Results of one network in unseen levels."""

    title: ClassVar[str] = "Directions learned from labelled pictures"
    network: str
    pictures: int  # learned from
    largest: int  # cells a side of the largest mazes among them
    right: float  # fraction of directions in mazes of all sizes, mice anywhere
    by_size: dict[int, float]  # the same by cells a side
    start: float  # fraction where mouse and cheese are in opposite corners

    def cells(self) -> dict[str, str]:
        learned = self.pictures > 0
        return {
            "network": self.network,
            "pictures": f"{self.pictures:,}" if learned else NOTHING,
            "largest shown": f"{self.largest}" if learned else NOTHING,
            "right, 3 to 25 cells": f"{self.right:.0%}",
            **{f"{size} cells": f"{self.by_size[size]:.0%}" for size in SIZES},
            "corner to corner": f"{self.start:.0%}",
        }


class Lessons:
    """Levels of a variant of Maze, and the way to the cheese from all their cells."""

    def __init__(self, variant: str, levels: range, batch: int):
        self.env = GameVectorEnv("maze", variant, batch)
        starts = []
        for first in levels[::batch]:
            self.env.reset(options={"level": np.arange(first, first + batch)})
            starts.append(self.env.get_state())
        self.states = np.concatenate(starts)
        self.ways = np.array([routes(s, "cheese") for s in trusted(self.states)], np.uint8)
        self.sizes = self.states["maze_size"].astype(int)

    def placed(self, which: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the states of levels `which`, each with its mouse in a random cell with a way."""
        states, ways = self.states[which].copy(), self.ways[which]
        draws = random.random(ways.shape) * (ways != STAY)
        y, x = np.divmod(draws.reshape(len(which), -1).argmax(1), ways.shape[2])
        states["x"], states["y"] = x + 0.5, y + 0.5
        states["faces_right"] = random.random(len(which)) < 0.5
        return states

    def shown(self, which: np.ndarray, states: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return the pictures [batch, H, W, 3] of states in levels `which`, and their labels."""
        x, y = states["x"].astype(int), states["y"].astype(int)
        labels = self.ways[which, y, x].astype(np.int64)
        return torch.from_numpy(self.env.set_state(states)), torch.from_numpy(labels)


def measure(
    networks: Sequence[str] = NETWORKS,
    seconds: float = 120.0,
    levels: tuple[int, int, int] = LEVELS,
    batch: int = BATCH,
    seed: int = 0,
) -> list[Row]:
    """Train each network for `seconds` of processor time of one core; what guessing gets is first.

    levels  how many, as `LEVELS`; those to learn from a multiple of `batch`
    """
    many, unseen, corners = levels
    lessons = Lessons("anywhere", range(many), batch)
    tests = Lessons("anywhere", range(UNSEEN, UNSEEN + unseen), unseen)
    starts = Lessons("corner", range(UNSEEN, UNSEEN + corners), corners)
    placed = tests.placed(np.arange(unseen), np.random.default_rng(seed))
    pictures, labels = tests.shown(np.arange(unseen), placed)
    first, ways = starts.shown(np.arange(corners), starts.states)

    def row(name: str, learned: int, largest: int, said: Tensor, at_start: Tensor) -> Row:
        right = (said == labels).numpy()
        by_size = {size: float(right[tests.sizes == size].mean()) for size in SIZES}
        start = float((at_start == ways).float().mean())
        return Row(name, learned, largest, float(right.mean()), by_size, start)

    rows = [row(GUESS, 0, 0, labels.mode().values, ways.mode().values)]
    with torch_settings(1):
        for name in networks:
            torch.manual_seed(seed)
            network, learned, largest = learn(name, lessons, seconds, np.random.default_rng(seed))
            said = [outputs(network, shown, batch)[0].argmax(-1) for shown in (pictures, first)]
            rows.append(row(name, learned, largest, *said))
    return rows


def learn(
    name: str, lessons: Lessons, seconds: float, random: np.random.Generator
) -> tuple[Callable, int, int]:
    """Return a network that learned for so long, pictures seen, and the largest mazes' cells."""
    config = replace(PRESETS["pixels"], variant="anywhere", network=name, threads=1)
    actions = len(lessons.env.game.actions)
    architecture = Architecture(name, (IMAGE, IMAGE, 3), (), actions)
    network = architecture.build()
    fast = accelerate(network, ppo.loss, config, architecture).network
    optimizer = torch.optim.Adam(network.parameters())
    sizes, batch = np.unique(lessons.sizes), lessons.env.num_envs
    levels = {size: np.flatnonzero(lessons.sizes == size) for size in sizes}
    count, good, update, began = LARGEST, 0.0, 0, time.process_time()
    while (done := (time.process_time() - began) / seconds) < 1:
        drawn = random.choice(sizes[:count], batch)
        largest = sizes[:count][-LARGEST:]
        drawn[: batch // 3] = random.choice(largest, batch // 3)
        which = np.array([random.choice(levels[size]) for size in drawn])
        images, labels = lessons.shown(which, lessons.placed(which, random))
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, (update + 1) / WARM) * min(1, (1 - done) / DECLINE)
        logits = fast(images)[0]
        optimizer.zero_grad()
        nn.functional.cross_entropy(logits, labels).backward()
        nn.utils.clip_grad_norm_(network.parameters(), config.gradient_norm)
        optimizer.step()
        update += 1
        right = (logits.argmax(-1) == labels).numpy()[np.isin(drawn, largest)].mean()
        good += MEMORY * (float(right) - good)
        if good > ENOUGH and count < len(sizes):
            count, good = count + 1, ENOUGH - 0.1
    return fast, update * batch, int(sizes[:count][-1])
