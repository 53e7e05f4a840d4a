"""The verb for distillation, to another network or other observations."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from astray.cli.arguments import Agent
from astray.envs.pool import most_threads
from astray.envs.vector import Observation
from astray.training.config import PRESETS, Tracking
from astray.training.settings import SEEDS, otherwise
from astray.validation import bounded


def distil(
    teacher: Agent,
    observation: Observation = "image",
    network: Annotated[str | None, otherwise("patch for images, mlp for symbols")] = None,
    variant: Annotated[str | None, otherwise("the training variant of the teacher")] = None,
    validation: Annotated[str | None, otherwise("that of the teacher")] = None,
    steps: int = 2_000_000,
    epochs: int = 1,
    art: Annotated[str | None, otherwise("the art of the teacher")] = None,
    seed: int = 0,
    seeds: int = 1,
    threads: int = 1,
    out: Annotated[Path | None, otherwise("runs/<game>-<variant>-of-<teacher>")] = None,
    track: Annotated[Tracking | None, otherwise("none")] = None,
) -> None:
    """Distil an agent into students, which learn its policy and values in episodes of their own.

    Students play only training levels, and ignore rewards. The same command resumes an interrupted
    training.

    Example: astray distil maze-corner --observation image --steps 2000000

    Args:
        observation: Kind of observations that the students get.
        network: Network of the students.
        variant: Variant whose training levels the students play.
        validation: Variant that is played during training without learning from it.
        steps: Total number of environment steps, in whole rollouts.
        epochs: Number of passes over each rollout.
        art: Art that images are drawn with.
        seed: Seed of the first student.
        seeds: Number of students to train, with consecutive seeds.
        threads: Number of threads for environments, and for torch.
        out: Folder for the run folders seed-0, seed-1, ...
        track: Tracker that records the training's metrics.

    Raises:
        ValueError: If a number is out of range, or the teacher sees other art.
    """
    from astray.analysis.runs import open_run
    from astray.training import checkpoint
    from astray.training.track import train_tracked

    bounded("threads", threads, 1, most_threads())
    agent, its = open_run(teacher)
    if agent.observation == "image" and art not in (None, its.art):
        raise ValueError(f"the teacher sees art {its.art!r}; its students must see it; got {art!r}")
    if variant is not None:
        its.played_variant(variant)  # warns of knobs that are not for it
    name = teacher.resolve().name
    images = observation == "image"
    config = replace(
        PRESETS["pixels" if images else "small"],
        game=its.game,
        variant=its.variant if variant is None else variant,
        validation=its.validation if validation is None else validation,
        knobs=its.knobs_for(its.variant if variant is None else variant, {}),
        first_level=its.first_level,
        levels=its.levels,
        observation=observation,
        network=("patch" if images else "mlp") if network is None else network,
        art=its.art if art is None else art,
        gamma=its.gamma,
        steps=steps,
        epochs=epochs,
        seed=seed,
        threads=threads,
        teacher=name,
    )
    bounded("seeds", seeds, 1, SEEDS - seed)
    there = out or Path("runs") / f"{config.game}-{config.variant}-of-{name}"
    runs = {there / f"seed-{k}": replace(config, seed=k) for k in range(seed, seed + seeds)}
    checkpoint.check_all(runs)
    with contextlib.ExitStack() as taught:
        for student in runs:  # before any is trained: a teacher that still trains is soon another
            taught.enter_context(checkpoint.teaching(agent.path, student))
        for student, one in runs.items():
            print(train_tracked(one, student, track))
