"""Trainings that torchrun starts: `torchrun --nproc-per-node 2 -m helpers.parallel FOLDER ...`."""

import sys
import weakref
from pathlib import Path

import torch
from torch import distributed

from astray.training.config import PRESETS
from astray.training.loop import iterate

# One minibatch an epoch, so that the samples of two processes are those of one.
CONFIG = PRESETS["small"].changed(
    variant="corner-small",
    validation="anywhere-small",
    num_envs=32,
    knobs={"world": 5, "largest": 5, "time_limit": 12},
    num_steps=16,
    minibatches=1,
    width=16,
    steps=4 * 512,
    validation_every=1,
    checkpoint_every=2,
    bfloat16=False,
    learning_rate=1e-3,
)

if __name__ == "__main__":
    torch.set_num_threads(1)
    for folder in map(Path, sys.argv[1:]):
        for _ in iterate(CONFIG, folder):
            group = weakref.ref(distributed.group.WORLD)
        # A group that outlives the training has threads that may abort the process when it ends.
        assert group() is None, "the group of processes is still there"
