"""Settings of trainings that take a moment, such a one stopped, and what it came to."""

from dataclasses import replace

import pytest
from safetensors.numpy import load_file

from astray.training import checkpoint
from astray.training.config import PRESETS
from astray.training.loop import train

TINY = replace(
    PRESETS["small"],
    variant="corner-small",
    knobs={"world": 5, "largest": 5, "time_limit": 20},
    validation="anywhere-small",
    num_envs=16,
    num_steps=16,
    minibatches=4,
    steps=1024,
    validation_every=1,
    checkpoint_every=2,
    width=16,
)
OFF = {"fused_cpu": False, "bfloat16": False, "channels_last": False, "compile": False,
       "cudagraphs": False, "groups": 1}  # fmt: skip
PLAIN = TINY.changed(validation=None, **OFF)
PICTURES = PRESETS["paper"].changed(
    game="coinrun",
    variant="coin-end",
    num_envs=4,
    num_steps=8,
    minibatches=2,
    steps=10**6,
    normalise_advantage=False,
    **OFF,
)


def digest(folder):
    """All that a training leaves to go on from, by name."""
    last = checkpoint.latest(folder)
    weights, rest = load_file(last / "agent.safetensors"), load_file(last / "trainer.safetensors")
    return {name: array.tobytes() for name, array in (weights | rest).items()}


def train_to_first_checkpoint(config, folder, monkeypatch):
    """Train until the first checkpoint is written, as if somebody pressed Ctrl-C then."""
    saved = checkpoint.save

    def stop(folder, trainer):
        saved(folder, trainer)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(checkpoint, "save", stop)
        train(config, folder, progress=False)
