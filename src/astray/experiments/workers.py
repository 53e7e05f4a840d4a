"""Parallel training of many agents, in local processes or on a Ray cluster."""

import contextlib
import functools
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from gymnasium.vector.utils import CloudpickleWrapper
from llvmlite.binding import get_host_cpu_features
from rich.console import Console
from rich.live import Live
from rich.table import Table

from astray import world
from astray.envs.pool import usable_processors
from astray.experiments.cluster import Submit, on_ray
from astray.experiments.spec import Place, check_unedited
from astray.files import UNGUARDED
from astray.training import checkpoint
from astray.training.config import Config, Tracking
from astray.training.log import METRICS, measured
from astray.training.track import train_tracked
from astray.validation import counted
from astray.world import World

SECONDS, QUIET = 0.5, 60.0  # from one look at the runs to the next; from line to line
SLOWER = "two to five times as long"  # measured for the agents of size night
TAIL = 4096  # bytes of metrics.jsonl in which its last line is


def train_all(
    todo: Mapping[Path, Config],
    workers: int | None = None,
    on: Place = "here",
    track: Tracking | None = None,
    known: Mapping[str, str] | None = None,
) -> None:
    """Train every agent whose run folder is not complete.

    Args:
        workers: Number of agents to train in parallel; None for one per processor.
        track: Tracker that records the trainings' metrics.
        known: Digests of the user's modules, as for `spec.check_unedited`.

    Raises:
        ValueError: If a training fails.
    """
    missing = {run: config for run, config in todo.items() if not checkpoint.finished(run, config)}
    if not missing:
        return
    count = min(workers or usable_processors(), len(missing))
    with on_ray() if on == "ray" else in_processes(count) as submit:
        told = known or {}
        watch({run: submit(config, run, track, told) for run, config in missing.items()}, missing)


def expected(todo: Mapping[Path, Config], speed: int, workers: int | None = None) -> str:
    """Describe the expected duration of trainings, given their progress.

    Args:
        speed: Steps per second of one training on a core.
    """
    done = {run: max(checkpoint.steps_saved(run), default=0) for run in todo}
    left = [max(config.steps - done[run], 0) for run, config in todo.items()]
    at_once = min(workers or usable_processors(), len(left))
    # Not less than the longest takes, and all of them share the processors.
    seconds = max(max(left), sum(left) / min(at_once, usable_processors())) / speed
    trained = sum(steps == 0 for steps in left)
    native = get_host_cpu_features().get("avx512bf16")
    slower = "" if native else f" with bfloat16 products (without, as here, {SLOWER})"
    return (
        f"{counted(len(left), 'agent')}, {trained} of them trained; {sum(left) / 1e6:,.1f} million "
        f"steps are left, about {seconds / 3600:.1f} hours with {at_once} at once, at {speed:,} "
        f"steps a second and core{slower}; stopped, the same command goes on"
    )


@contextlib.contextmanager
def in_processes(count: int) -> Iterator[Submit]:
    """Run trainings in a pool of `count` processes; raise RuntimeError if one of these dies."""
    # Spawned, not forked: torch's and the environments' threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    # They end once it closes. An event would wait for an answer, also of those that were killed.
    there, here = context.Pipe(duplex=False)
    with there, here, ProcessPoolExecutor(count, context, _begin, (there,)) as pool:
        try:
            yield functools.partial(_submit, pool)
        except BrokenProcessPool as error:
            told = "the process of a training was killed, perhaps for want of memory, or died"
            raise RuntimeError(told + UNGUARDED) from error
        except Exception as error:  # of one training; those that have begun go on to their end
            print(f"a training failed, and others go on: {error}", file=sys.stderr, flush=True)
            try:
                pool.shutdown(cancel_futures=True)
            finally:  # also after an interrupt
                here.close()
            raise
        except BaseException:  # an interrupt: all end now, and go on from their checkpoints later
            here.close()
            pool.shutdown(cancel_futures=True)
            raise


def _submit(
    pool: ProcessPoolExecutor,
    config: Config,
    run: Path,
    track: Tracking | None,
    known: Mapping[str, str],
) -> Future[None]:
    """Submit a training to `pool`, which may start processes for it."""
    of = None
    if isinstance(game := config.find_game(), World):  # which the process does not know by name
        of = CloudpickleWrapper(game)  # pyrefly: ignore
    if os.name == "nt":
        return pool.submit(_train, config, run, track, known, of)
    # They inherit that an interrupt waits, which each would otherwise report while it begins.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        return pool.submit(_train, config, run, track, known, of)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(there: Connection) -> None:
    """Leave interrupts to the parent, and end with it or on its request."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_at, args=(there,), daemon=True).start()


def _train(
    config: Config, run: Path, track: Tracking | None, known: Mapping[str, str], of: Any
) -> None:
    if of is not None:
        world.register(of.fn)
    check_unedited(config, known)
    # Another experiment may want the same agent: it is trained once, for both.
    train_tracked(config, run, track, progress=False, wait=True)


def _end_at(there: Connection) -> None:
    """End this process when the parent closes the pipe or is killed.

    Otherwise it would keep its run folder locked.
    """
    with contextlib.suppress(EOFError, OSError):
        there.recv()
    os._exit(1)


def watch(running: Mapping[Path, Future], configs: Mapping[Path, Config]) -> None:
    """Show progress until all trainings have ended, as a table or as lines."""
    console, said = Console(stderr=True), time.monotonic()
    trainings = [Progress(run, configs[run]) for run in running]
    with Live(console=console, transient=True, auto_refresh=False) as live:
        while not all(future.done() for future in running.values()):
            time.sleep(SECONDS)
            for future in running.values():
                if future.done():
                    future.result()  # raises what it raised, before the others end
            for training in trainings:
                training.look()
            if console.is_terminal:
                live.update(_table(trainings), refresh=True)
            elif time.monotonic() - said > QUIET:
                said = time.monotonic()
                done = sum(training.steps for training in trainings)
                whole = sum(training.whole for training in trainings)
                ended = sum(future.done() for future in running.values())
                print(
                    f"{done:,} of {whole:,} steps, {ended} of {len(running)} agents trained",
                    file=sys.stderr,
                    flush=True,
                )
    for future in running.values():
        future.result()


@dataclass
class Progress:
    """Progress of a training, read from its metrics.jsonl."""

    run: Path
    config: Config
    began: tuple[float, int] | None = None  # when its first step was seen, and how many there were
    steps: int = 0
    recent: float = 0.0  # mean return

    @property
    def whole(self) -> int:
        """Total number of steps."""
        return self.config.iterations * self.config.batch

    @property
    def speed(self) -> float | None:
        """Steps per second since the first look."""
        if self.began is None or self.steps == self.began[1]:
            return None
        return (self.steps - self.began[1]) / (time.monotonic() - self.began[0])

    def look(self) -> None:
        """Read the last complete line."""
        try:
            with open(self.run / METRICS, "rb") as file:
                file.seek(max(0, os.fstat(file.fileno()).st_size - TAIL))
                *lines, _ = file.read().split(b"\n")
            last = measured(lines[-1])
        except (FileNotFoundError, IndexError, ValueError):  # the training says what is wrong
            return
        self.steps, self.recent = last["steps"], last.get("training/return", 0.0)
        self.began = self.began or (time.monotonic(), self.steps)


def _table(trainings: Sequence[Progress]) -> Table:
    """Return a table of running trainings, with counts of the others."""
    table = Table("agent", "trained", "steps/s", "return", "left")
    for one in trainings:
        speed = one.speed
        if 0 < one.steps < one.whole:
            left = "" if not speed else f"{(one.whole - one.steps) / speed / 60:.0f} min"
            table.add_row(
                f"{one.config.game} {one.config.variant}, seed {one.config.seed}",
                f"{one.steps / one.whole:.0%} of {one.whole / 1e6:.1f} M steps",
                f"{speed:,.0f}" if speed else "",
                f"{one.recent:z.2f}",
                left,
            )
    waiting = sum(one.steps == 0 for one in trainings)
    ended = sum(one.steps == one.whole for one in trainings)
    table.caption = f"{ended} agents are trained, {waiting} wait"
    return table
