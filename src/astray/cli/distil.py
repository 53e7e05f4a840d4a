"""The verb for distillation: a student of another network, or of other observations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tyro.conf import Positional

from astray.analysis import kept
from astray.bounds import MOST, bounded
from astray.envs.pool import most_threads
from astray.envs.vector import Observation
from astray.training.config import PRESETS, Tracking
from astray.training.settings import MOST_STEPS, SEEDS


def distil(
    teacher: Positional[Path],
    observation: Observation = "image",
    network: str | None = None,
    variant: str | None = None,
    validation: str | None = None,
    steps: int = 2_000_000,
    epochs: int = 1,
    art: str | None = None,
    seed: int = 0,
    seeds: int = 1,
    threads: int = 1,
    folder: Path | None = None,
    track: Tracking | None = None,
) -> None:
    """Train students that do what an agent would do in the episodes that they themselves play.

    They learn its probabilities of all actions and its values, in training levels alone; rewards
    teach them nothing. What is interrupted goes on with the same command.

    Args:
        teacher: a run folder, or the name of a kept or imported agent
        observation: what the students see
        network: of the students; by default patch for images, mlp for symbols
        variant: whose training levels they play; by default what the teacher was trained on
        validation: a variant played during training, never learned from; by default the teacher's
        steps: of all environments
        epochs: passes over what was played
        art: that images are drawn with; by default the teacher's
        seed: of the first student
        seeds: students to train, with this seed, the next, ...
        threads: that step environments and that torch uses
        folder: of the runs; by default runs/<game>-<variant>-of-<teacher>
        track: tell wandb or trackio, too, of the training
    """
    from astray.analysis.runs import open_run
    from astray.training.teacher import teaching
    from astray.training.track import train_tracked

    bounded("seed", seed, 0, SEEDS - 1)
    bounded("seeds", seeds, 1, SEEDS - seed)
    bounded("steps", steps, 1, MOST_STEPS)
    bounded("epochs", epochs, 1, MOST)
    bounded("threads", threads, 1, most_threads())
    run = kept.run_of(teacher)
    agent, its = open_run(run)
    if agent.observation == "image" and art not in (None, its.art):
        raise ValueError(f"the teacher sees art {its.art!r}; its students must see it; got {art!r}")
    name = str(teacher) if run != teacher else run.resolve().name
    images = observation == "image"
    config = replace(
        PRESETS["pixels" if images else "small"],
        game=its.game,
        variant=its.variant if variant is None else variant,
        validation=its.validation if validation is None else validation,
        knobs=its.knobs_for(variant or its.variant, {}),
        first_level=its.first_level,
        levels=its.levels,
        observation=observation,
        network=network or ("patch" if images else "mlp"),
        art=art or its.art,
        gamma=its.gamma,
        steps=steps,
        epochs=epochs,
        seed=seed,
        threads=threads,
        teacher=name,
    )
    there = folder or Path("runs") / f"{config.game}-{config.variant}-of-{name}"
    for number in range(seed, seed + seeds):
        student = there / f"seed-{number}"
        with teaching(agent.path, student):
            print(train_tracked(replace(config, seed=number), student, track))
