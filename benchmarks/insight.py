"""Fields per second: policy and value of an agent at every place of many levels.

The pretrained mouse sees symbols, in mazes of 3 to 7 cells. The network of the paper sees images,
in mazes of 3 to 15 cells; it is untrained, which takes equally long. Everything counts from the
numbers of the levels on: levels, observations, the network, where each action leads.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import ClassVar

import torch

from astray.agents.policy import Architecture, weights
from astray.analysis.runs import load_agent
from astray.analysis.trained import Agent
from astray.insight.fields import each_field
from astray.training import folders
from benchmarks.tables import decimal


@dataclass(frozen=True)
class Row:
    """One agent."""

    title: ClassVar[str] = "Fields: policy and value at every place"
    agent: str
    variant: str
    levels: int
    places: int
    seconds: float  # median over the rounds
    threads: int  # of the network

    def cells(self) -> dict[str, str]:
        return {
            "agent": self.agent,
            "levels": f"{self.levels:,} of {self.variant}",
            "places": f"{self.places:,}",
            "threads": f"{self.threads}",
            "seconds": decimal(self.seconds),
            "places/s": f"{self.places / self.seconds:,.0f}",
        }


def measure(levels: tuple[int, int] = (1000, 100), rounds: int = 3) -> list[Row]:
    """Measure the fields of so many levels of the pretrained mouse, and of the paper's network."""
    with tempfile.TemporaryDirectory() as folder:
        agents = {
            "maze-corner, symbols": (load_agent(folders.find("maze-corner")), "anywhere-small"),
            "the paper's network, images": (_paper(Path(folder)), "anywhere-easy"),
        }
        return [
            _row(name, agent, variant, count, rounds)
            for (name, (agent, variant)), count in zip(agents.items(), levels, strict=True)
        ]


def _row(name: str, agent: Agent, variant: str, count: int, rounds: int) -> Row:
    places, seconds = 0, []
    list(each_field(agent, variant, range(1)))  # what is compiled once
    for _ in range(rounds):
        began = time.perf_counter()
        places = sum(len(field.cells) for field in each_field(agent, variant, range(count)))
        seconds.append(time.perf_counter() - began)
    return Row(name, variant, count, places, median(seconds), torch.get_num_threads())


def _paper(folder: Path) -> Agent:
    architecture = Architecture("impala", (64, 64, 3), (), 15)
    path = folder / "agent.safetensors"
    path.write_bytes(weights(architecture.build(), architecture, "maze"))
    return Agent(path, "maze")
