"""A small training, killed again and again: `python -m helpers.killed FOLDER KILLS`

The same run is killed at random moments and resumed until it is done, then another, until there
were KILLS kills. After each kill the run is looked at; a run that is done is compared with one
that was never stopped. Prints what was seen, as JSON; any loss is an AssertionError.
"""

import json
import os
import random
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

from safetensors.numpy import load_file

from astray import files
from astray.agents import policy
from astray.training import checkpoint
from astray.training.config import PRESETS
from astray.training.loop import train

# A checkpoint every other iteration, and many; so small that most of the time goes to files.
CONFIG = replace(
    PRESETS["small"],
    variant="corner-small",
    knobs={"world": 5, "largest": 5, "time_limit": 20},
    validation="anywhere-small",
    num_envs=16,
    num_steps=64,
    minibatches=4,
    steps=60 * 1024,
    validation_every=3,
    checkpoint_every=2,
    width=32,
)


def left(path: Path) -> None:
    """Leave beside `path` what a process leaves that is killed while it writes to `path`."""
    (aside := files.aside_of(path)).mkdir(parents=True)
    for name in (files.LOCK, "half"):
        (aside / name).touch()


# The run that is killed; `CONFIG` is for tests that need to be in the middle of one.
SHORT = replace(CONFIG, num_steps=32, steps=8 * 512)


def contents(folder: Path) -> dict[str, bytes]:
    """All that a training leaves that is to be the same: weights, trainer, metrics."""
    last = checkpoint.latest(folder)
    tensors = load_file(last / checkpoint.AGENT) | load_file(last / checkpoint.TRAINER)
    found = {name: array.tobytes() for name, array in tensors.items()}
    return found | {"metrics": (folder / "metrics.jsonl").read_bytes()}


def look(folder: Path, before: int) -> int:
    """See that a run that was killed lost nothing but what came after its last checkpoint."""
    saved = checkpoint.steps_saved(folder)
    last = saved[-1] if saved else 0
    assert last >= before, f"the run fell back from {before} steps to {last}"
    for steps in saved:
        policy.load(folder / "checkpoints" / f"{steps}" / checkpoint.AGENT, SHORT.game)
    path = folder / "metrics.jsonl"
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    whole = [json.loads(line) for line in lines if line.endswith("\n")]
    done = whole[-1]["steps"] if whole else 0
    assert done - last <= SHORT.checkpoint_every * SHORT.batch, f"{done - last} steps are lost"
    return last


def stray(folder: Path) -> list[Path]:
    """Files that a finished run should not hold."""
    return [p for p in folder.rglob(".*") if p.name != ".lock"]


def main(folder: Path, kills: int) -> dict[str, float]:
    began = time.perf_counter()
    train(SHORT, folder / "whole", progress=False)
    duration = time.perf_counter() - began
    whole, rng, told = contents(folder / "whole"), random.Random(0), {"kills": 0, "runs": 0}
    run = last = 0
    while True:
        there = folder / f"run-{run}"
        child = os.fork()
        if not child:
            try:
                train(SHORT, there, progress=False)
                os._exit(0)
            except BaseException as error:
                print(repr(error), file=sys.stderr, flush=True)
                os._exit(1)
        if told["kills"] < kills:
            time.sleep(rng.uniform(0, duration / 3))
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status):
            told["kills"] += 1
            last = look(there, last) if there.exists() else 0
            continue
        assert os.WEXITSTATUS(status) == 0, "a run could not be resumed"
        assert contents(there) == whole, "the resumed run is not the one that was not stopped"
        assert not stray(there), stray(there)
        told["runs"] += 1
        run, last = run + 1, 0
        if told["kills"] >= kills:
            return told | {"seconds": time.perf_counter() - began}


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), int(sys.argv[2]))))
