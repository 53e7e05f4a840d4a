"""Thread pool that steps a batch of environments in parallel."""

from __future__ import annotations

import os
import queue
import statistics
import threading
import time
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.kernel.barrier import MOST_LOOKS, TAKEN, load, new_barrier, store

PAUSE = 2e-5  # seconds between looks of one who waited long
LEAST_MOST = 64  # threads that are allowed anywhere, so that settings go from machine to machine
SEEN = 5  # rounds alone of which it is seen how long they take
# Seconds that rounds are then shared, at least and at most; that they are done alone where sharing
# took longer, likewise; and that sharing may cost before it is given up: a few slices of a
# scheduler, as one may be lost to anything.
SHARED, ALONE, HOPELESS = (0.06, 0.5), (0.06, 4.0), 0.015


class Pool:
    """Persistent threads; the caller is the first one.

    Waking a sleeping thread takes 20 to 60 us, hardly less than stepping 256 environments. Idle
    threads therefore spin for a while in compiled code, which holds no interpreter lock, and so
    does the caller until they finish.

    If other processes need the processors, spinning threads lose more than they gain: two did a
    third of the work of one. Then the caller works alone and the threads sleep.
    """

    def __init__(self, threads: int, pace: Pace | None = None):
        self.threads = threads
        self._pace = Pace() if pace is None else pace
        self._start()

    def _start(self) -> None:
        looks = MOST_LOOKS if self.threads <= usable_processors() else 0
        self._process, self._generation = os.getpid(), 0
        self._barrier = new_barrier(self.threads, looks)
        self._workers: list[_Worker] = []
        try:
            for k in range(1, self.threads):
                self._workers.append(_Worker(self._barrier, k))
        except RuntimeError as error:  # the system allows no more
            _stop(self._workers)
            raise RuntimeError(
                f"{self.threads} threads are asked for, but {len(self._workers) + 1} can be started"
            ) from error
        self.close = weakref.finalize(self, _stop, self._workers)

    def run(self, function: Callable, arguments: tuple) -> Any:
        """Call `function` in all threads at once; return the caller's result.

        Its arguments are `arguments`, then barrier, thread and generation of `kernel.barrier`. It
        takes pieces of work with `take` until none is left. It may call `release` first and
        `arrive` last, which saves time. A thread may hold `arguments` for about 100 us longer.

        Raises:
            RuntimeError: If the threads cannot be started.
        """
        if not self.close.alive:
            raise RuntimeError("the environments are closed")
        if self._process != os.getpid():  # threads do not survive a fork
            self.close.detach()
            self._start()
        self._join()  # where an interrupt left them at work
        if not self._workers:
            return function(*arguments, *alone())
        begin = time.perf_counter()
        if self._pace.shared:
            returned = self._share(function, arguments)
        else:
            returned = function(*arguments, *alone())
        self._pace.note(time.perf_counter() - begin)
        return returned

    def _share(self, function: Callable, arguments: tuple) -> Any:
        self._generation += 1
        self._barrier[0, TAKEN] = 0
        for worker in self._workers:
            worker.give(function, (*arguments, self._barrier, worker.number, self._generation))
        try:
            returned = function(*arguments, self._barrier, 0, self._generation)
        finally:
            self._join()
        for worker in self._workers:
            worker.throw()
        return returned

    def _join(self) -> None:
        for worker in self._workers:
            while load(self._barrier, worker.number) < worker.given:
                if worker.ended and load(self._barrier, worker.number) < worker.given:
                    raise RuntimeError("the environments were closed while they were stepped")
                time.sleep(PAUSE)


class Pace:
    """Decision whether to share the work, from recent times with and without sharing."""

    def __init__(self) -> None:
        self.shared = False
        self._times: list[float] = []  # of rounds since it was decided last, in seconds
        self._spent = self._until = 0.0  # seconds since then, and until it is decided anew
        self._alone = 0.0  # seconds of a round
        self._next_shared, self._next_alone = SHARED[0], ALONE[0]

    def note(self, seconds: float) -> None:
        """Record the duration of the last batch step and decide about the next."""
        self._times.append(seconds)
        self._spent += seconds
        lost = self._spent - len(self._times) * self._alone
        if self.shared and lost > HOPELESS:
            self._until = 0.0
        if self._spent < self._until or len(self._times) < SEEN:
            return
        if not self.shared:
            self._alone = statistics.median(self._times[-100:])
            self._until = self._next_shared
        elif lost < 0:
            self._until, self._next_alone = 0.0, ALONE[0]
            self._next_shared = min(2 * self._next_shared, SHARED[1])
        else:
            self._until, self._next_shared = self._next_alone, SHARED[0]
            self._next_alone = min(2 * self._next_alone, ALONE[1])
        self.shared, self._times, self._spent = not self.shared, [], 0.0


class _Worker:
    """Thread that runs jobs, and sleeps if the last one was long ago."""

    def __init__(self, barrier: np.ndarray, number: int):
        self.barrier, self.number = barrier, number
        self.given = 0  # the generation of the last job
        self.job: tuple[Callable, tuple[Any, ...]] | None = None
        self.error: BaseException | None = None
        self.asleep, self.stopped, self.ended = False, False, False
        self.wakes: queue.SimpleQueue[None] = queue.SimpleQueue()
        threading.Thread(target=self._live, daemon=True, name=f"astray-{number}").start()

    def give(self, function: Callable, arguments: tuple[Any, ...]) -> None:
        """Make the thread call `function`; the last of `arguments` is the generation."""
        self.error = None  # of a round that was interrupted, and reported none
        self.job, self.given = (function, arguments), arguments[-1]
        if self.asleep:
            self.wakes.put(None)

    def throw(self) -> None:
        """Raise the exception of its last job, if any."""
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
        self.ended = True

    def _work(self, function: Callable, arguments: tuple[Any, ...]) -> None:
        self.job, generation = None, arguments[-1]
        try:
            function(*arguments)
        except BaseException as error:
            self.error = error
        store(self.barrier, self.number, generation)  # once more where `arrive` did


def _stop(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.stop()


def alone() -> tuple[np.ndarray, int, int]:
    """Return a barrier [1, LINE], a thread number and a generation, for work without a pool."""
    return new_barrier(1, 0), 0, 1


def most_threads() -> int:
    """Return the largest useful number of threads for a batch: one per processor."""
    return max(LEAST_MOST, usable_processors())


def check_startable(count: int) -> None:
    """Raise RuntimeError unless `count` more threads can start; torch would end the process."""
    begun, go_on = [], threading.Event()
    try:
        for _ in range(count):
            thread = threading.Thread(target=go_on.wait, daemon=True)
            thread.start()
            begun.append(thread)
    except RuntimeError as error:
        raise RuntimeError(
            f"{count} threads are needed in all; the system lets {len(begun)} be started"
        ) from error
    finally:
        go_on.set()
        for thread in begun:
            thread.join()


def usable_processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
