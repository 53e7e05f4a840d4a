"""Trainings on a Ray cluster of two nodes on this machine: `python -m helpers.on_ray FOLDER`

In mid-training the process of one is killed, then the node of another; all three are compared with
trainings that were not. Prints what was seen, as JSON.
"""

import json
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from astray.experiments.workers import train_all
from astray.training import checkpoint
from astray.training.loop import train
from helpers.killed import CONFIG, contents

LONG = replace(CONFIG, steps=100 * 1024, checkpoint_every=5)
SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",  # else 15, and everything else goes first
    "RAY_health_check_period_ms": "1000",  # of nodes; else 3,000,
    "RAY_health_check_failure_threshold": "3",  # and 5
}


def trainer(run: Path) -> int | None:
    """The process that holds the run folder."""
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if link.readlink() == run / ".lock":
                return int(link.parts[2])
        except OSError:  # it is gone, or is not ours to look at
            continue
    return None


def kill(run: Path, node: bool) -> dict[str, int]:
    """Kill what trains `run` some iterations after a checkpoint: the process, or its whole node."""
    saved, done, process = 0, 0, None
    while not saved or process is None or done < saved + 2 * LONG.batch:
        time.sleep(0.005)
        steps = checkpoint.steps_saved(run)
        if steps and steps[-1] != saved:
            saved, process = steps[-1], trainer(run)
        if saved:
            done = len((run / "metrics.jsonl").read_text().splitlines()) * LONG.batch
    target = process
    if node:  # its processes end when they see that it did
        target = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(target, signal.SIGKILL)
    assert done < LONG.steps, "it was killed too late"
    return {"saved": saved, "done": done}


def main(folder: Path) -> dict:
    os.environ |= SETTINGS
    from ray.cluster_utils import Cluster

    began, runs = time.perf_counter(), {folder / f"{s}": replace(LONG, seed=s) for s in range(2)}
    head = {"num_cpus": 0, "include_dashboard": False, "object_store_memory": 10**8}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    for _ in range(2):
        cluster.add_node(num_cpus=1, object_store_memory=10**8)
    os.environ["RAY_ADDRESS"] = cluster.address
    with ThreadPoolExecutor(1) as pool:
        driver = pool.submit(train_all, runs, on="ray")
        first, second = runs
        told = {"process": kill(first, node=False), "node": kill(second, node=True)}
        driver.result()
    cluster.shutdown()
    for run, config in runs.items():
        train(config, folder / "whole" / run.name, progress=False)
        assert contents(run) == contents(folder / "whole" / run.name), f"{run.name} is another"
        assert checkpoint.finished(run, config)
    return told | {"seconds": time.perf_counter() - began}


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
