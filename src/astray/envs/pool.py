"""A few threads that share the work on a batch."""

from __future__ import annotations

import os
import queue
import threading
import time
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.kernel.laps import MOST_LOOKS, load, new_laps, store

ALONE = (new_laps(1, 0), 0, 0)  # laps, thread and lap of a caller without threads
PAUSE = 2e-5  # seconds between looks of one who waited long


class Pool:
    """Persistent threads; the caller does the first share itself.

    Waking a thread that sleeps takes 20 to 60 us, stepping 256 environments not much more. So a
    thread that has done its share looks out for the next lap for a while, and the caller for
    the others' end: in compiled code, where nobody waits for the interpreter's lock.
    """

    def __init__(self, threads: int):
        self.threads = threads
        self._start()

    def _start(self) -> None:
        looks = MOST_LOOKS if self.threads <= usable_processors() else 0
        self._process, self._lap, self._laps = os.getpid(), 0, new_laps(self.threads, looks)
        self._workers = [_Worker(self._laps, k) for k in range(1, self.threads)]
        self.close = weakref.finalize(self, _stop, self._workers)

    def run(self, function: Callable, arguments: tuple, n: int) -> None:
        """Call `function` on shares of range(n), all at once.

        Its arguments are `arguments`, the first of its share and the one after the last, and
        laps, thread and lap for `begin_lap` and `end_lap`, which it may call before all else
        and after all else; without them all takes longer. A thread may keep `arguments` for
        some 100 us more.
        """
        if not self.close.alive:
            raise RuntimeError("the environments are closed")
        if self._process != os.getpid():  # threads do not survive a fork
            self.close.detach()
            self._start()
        self._join()  # where an interrupt left them at work
        self._lap += 1
        edges = [n * k // self.threads for k in range(self.threads + 1)]
        for worker, low, high in zip(self._workers, edges[1:-1], edges[2:], strict=True):
            worker.give(function, (*arguments, low, high, self._laps, worker.number, self._lap))
        try:
            function(*arguments, edges[0], edges[1], self._laps, 0, self._lap)
        finally:
            self._join()
        for worker in self._workers:
            worker.throw()

    def _join(self) -> None:
        for worker in self._workers:
            while load(self._laps, worker.number) < worker.given:
                time.sleep(PAUSE)


class _Worker:
    """A thread that does what it is given, and sleeps when that was long ago."""

    def __init__(self, laps: np.ndarray, number: int):
        self.laps, self.number = laps, number
        self.given = 0  # the lap of the last job
        self.job: tuple[Callable, tuple[Any, ...]] | None = None
        self.error: BaseException | None = None
        self.asleep, self.stopped = False, False
        self.wakes: queue.SimpleQueue[None] = queue.SimpleQueue()
        threading.Thread(target=self._live, daemon=True, name=f"astray-{number}").start()

    def give(self, function: Callable, arguments: tuple[Any, ...]) -> None:
        """Have it call `function`; the last of `arguments` is the lap."""
        self.error = None  # of a lap that was interrupted, and told nobody
        self.job, self.given = (function, arguments), arguments[-1]
        if self.asleep:
            self.wakes.put(None)

    def throw(self) -> None:
        """Raise what its last job raised."""
        error, self.error = self.error, None  # it leads to the environment, which would live on
        try:
            if error is not None:
                raise error
        finally:
            del error

    def stop(self) -> None:
        self.stopped = True
        self.wakes.put(None)

    def _live(self) -> None:
        while self.job is not None or not self.stopped:
            self.asleep = True
            if self.job is None:  # looked at after it said so, or it could sleep through a job
                self.wakes.get()
            self.asleep = False
            while self.job is not None:
                self._work(*self.job)

    def _work(self, function: Callable, arguments: tuple[Any, ...]) -> None:
        self.job, lap = None, arguments[-1]
        try:
            function(*arguments)
        except BaseException as error:
            self.error = error
        store(self.laps, self.number, lap)  # once more where `end_lap` did


def _stop(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.stop()


def usable_processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
