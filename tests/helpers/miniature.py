"""Experiments in miniature."""

from dataclasses import replace
from pathlib import Path

from astray.experiments import run
from astray.experiments.spec import Plan
from astray.training.config import Config
from astray.training.loop import train
from astray.training.settings import SCORING


def miniature(plan: Plan, time_limit: int = 25) -> Plan:
    """The plan with two agents of each name, trained for 512 steps in few short levels."""
    agents = {
        name: config.changed(
            levels=100,
            steps=512,
            num_envs=16,
            num_steps=8,
            minibatches=4,
            width=16,
            checkpoint_every=1,
            knobs={**config.knobs, "time_limit": time_limit},
            **buffer_of(config),
        )
        for name, config in plan.agents.items()
    }
    return replace(plan, agents=agents, seeds=2, levels=20)


def buffer_of(config: Config) -> dict[str, int]:
    """A small buffer for a sampler that has one; kinds that differ in it stay apart."""
    if config.sampler.kind not in SCORING:
        return {}
    return {"buffer": min(96, config.sampler.buffer // 64)}


def train_here(plan: Plan, root: Path) -> None:
    """Train the plan's agents where `reproduce` finds them, without the start of processes."""
    trainings = plan.trainings()
    runs = {
        name: [run.run_folder(root, config) for config in configs]
        for name, configs in trainings.items()
    }
    for names in plan.phases():
        run.give_weights(plan, runs, names)
        for name in names:
            for config, folder in zip(trainings[name], runs[name], strict=True):
                train(config, folder, progress=False)
