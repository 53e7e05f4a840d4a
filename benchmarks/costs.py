"""Core-hours of the trainings of each study, from the speed of a few iterations of each kind.

Iterations are whole ones, of the settings that the study has, on one thread: acting, validation
and learning. A student's are measured with its teacher and by rewards alone; an untrained network
stands for a teacher that is an agent, as it takes as long.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

from astray.agents import policy
from astray.experiments import catalogue
from astray.experiments.spec import Plan, Size, name_of_run
from astray.training.config import SOLVER, Config
from astray.training.fast.acceleration import torch_settings
from astray.training.loop import improve
from astray.training.trainer import Trainer
from benchmarks.train import per_second

SIZES: tuple[Size, ...] = ("smoke", "pixels", "night")
# What agents of one kind may differ in: their speed is that of the first of them.
ALIKE = {"seed": 0, "steps": 0, "variant": "", "validation": None, "knobs": {}, "taught": 1.0}


@dataclass(frozen=True)
class Row:
    """The trainings of one study at one size, those included that other studies share."""

    title: ClassVar[str] = "Core-hours of trainings"
    study: str
    size: Size
    agents: int  # teachers are some of them
    steps: int  # of all agents together
    seconds: float  # of a core, for all agents

    def cells(self) -> dict[str, str]:
        return {
            "experiment": f"`{self.study}`",
            "size": f"`{self.size}`",
            "agents": f"{self.agents}",
            "million steps, all": f"{self.steps / 1e6:,.1f}",
            "core-hours, all": f"{self.seconds / 3600:,.1f}",
            "core-hours, each": f"{self.seconds / 3600 / self.agents:,.2f}",
        }


def measure(
    studies: Sequence[str] = catalogue.NAMES,
    sizes: Sequence[Size] = SIZES,
    seconds: float = 4.0,
    rounds: int = 3,
) -> list[Row]:
    """Measure each kind of agent in `rounds` of about `seconds`; the speed is their median."""
    speeds: dict[str, tuple[float, float]] = {}
    rows = []
    for size in sizes:
        for study in studies:
            plan = catalogue.load(study).sizes.get(size)
            agents = {} if plan is None else trained(plan)
            spent = 0.0
            for one in agents.values():
                if (kind := kind_of(one)) not in speeds:
                    speeds[kind] = speed(one, agents.get(str(one.teacher)), seconds, rounds)
                spent += one.steps * cost(one, *speeds[kind])
            if agents:
                steps = sum(one.steps for one in agents.values())
                rows.append(Row(study, size, len(agents), steps, spent))
    return rows


def trained(plan: Plan) -> dict[str, Config]:
    """Return the settings of a plan's trainings by run, each run once."""
    return {name_of_run(one): one for its in plan.trainings().values() for one in its}


def kind_of(config: Config) -> str:
    """Return the settings that decide the speed of a training; one name stands for all teachers."""
    teacher = config.teacher and (config.teacher if config.teacher == SOLVER else "agent")
    same: dict[str, Any] = {**ALIKE, "teacher": teacher}
    return f"{config.flat() | same}"


def cost(config: Config, taught: float, alone: float) -> float:
    """Return seconds per step, at `taught` steps per second in lessons and `alone` in others."""
    part = config.taught if config.teacher else 0.0
    return part / taught + (1 - part) / alone


def speed(
    config: Config, teacher: Config | None, seconds: float, rounds: int
) -> tuple[float, float]:
    """Return steps per second in lessons, and by rewards alone; equal if there is no teacher.

    teacher  settings of the agent that teaches, if one does
    """
    config = replace(config, device="cpu", threads=1)
    plain = replace(config, teacher=None, taught=1.0, lessons="episodes", lesson_rate=None)
    alone = _speed(plain, None, seconds, rounds)
    if config.teacher is None:
        return alone, alone
    with tempfile.TemporaryDirectory() as folder:
        weights = Path(folder) / "teacher.safetensors"
        if teacher is not None:
            untrained = Trainer(teacher)
            made = policy.weights(untrained.network, untrained.architecture, teacher.game)
            weights.write_bytes(made)
            untrained.close()
        return _speed(config, weights, seconds, rounds), alone


def _speed(config: Config, teacher: Path | None, seconds: float, rounds: int) -> float:
    with torch_settings(1):
        trainer = Trainer(config, teacher=teacher)
        improve(trainer)  # the first one allocates
        turn = seconds / rounds
        done = [per_second(lambda: improve(trainer), turn, "cpu") for _ in range(rounds)]
        trainer.close()
    return config.batch * median(done)
