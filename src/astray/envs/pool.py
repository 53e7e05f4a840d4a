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

from astray.kernel.atomic import LINE, load, store

ALONE = (np.zeros((1, LINE), np.int64), 0, 0)  # turns, thread and turn of a caller without threads


class Pool:
    """Persistent threads; the caller does the first share itself.

    Waking a thread that sleeps takes 20 to 60 us, stepping 256 environments not much more. So a
    thread that has done its share looks out for the next turn for a while, and the caller for
    the others' end: in compiled code, where nobody waits for the interpreter's lock.
    """

    def __init__(self, threads: int):
        self.threads = threads
        self._start()

    def _start(self) -> None:
        self._process, self._turn = os.getpid(), 0
        self._turns = np.zeros((self.threads, LINE), np.int64)
        self._workers = [_Worker(self._turns, k) for k in range(1, self.threads)]
        self.close = weakref.finalize(self, _stop, self._workers)

    def run(self, function: Callable, arguments: tuple, n: int) -> None:
        """Call `function` on shares of range(n), all at once.

        It gets `arguments`, the first of its share and the one after the last, and

        turns   [threads, LINE] int64, to be written and read by `kernel.atomic`: the turn that
                the caller, thread 0, has begun, and the last that each other has done
        thread  which one this is
        turn    that this call is
        """
        if not self.close.alive:
            raise RuntimeError("the environments are closed")
        if self._process != os.getpid():  # threads do not survive a fork
            self.close.detach()
            self._start()
        self._turn += 1
        edges = [n * k // self.threads for k in range(self.threads + 1)]
        for worker, low, high in zip(self._workers, edges[1:-1], edges[2:], strict=True):
            worker.give(function, (*arguments, low, high, self._turns, worker.number, self._turn))
        try:
            function(*arguments, edges[0], edges[1], self._turns, 0, self._turn)
        finally:
            for worker in self._workers:
                while load(self._turns, worker.number) != self._turn:
                    time.sleep(0)
        errors = [worker.error for worker in self._workers if worker.error]
        if errors:
            raise errors[0]


class _Worker:
    """A thread that does what it is given, and sleeps when that was long ago."""

    def __init__(self, turns: np.ndarray, number: int):
        self.turns, self.number = turns, number
        self.job: tuple[Callable, tuple[Any, ...]] | None = None
        self.error: BaseException | None = None
        self.asleep, self.stopped = False, False
        self.calls: queue.SimpleQueue[None] = queue.SimpleQueue()  # that wake it
        threading.Thread(target=self._live, daemon=True, name=f"astray-{number}").start()

    def give(self, function: Callable, arguments: tuple[Any, ...]) -> None:
        """Have it call `function`; the last of `arguments` is the turn."""
        self.error, self.job = None, (function, arguments)
        if self.asleep:
            self.calls.put(None)

    def stop(self) -> None:
        self.stopped = True
        self.calls.put(None)

    def _live(self) -> None:
        while not self.stopped:
            self.asleep = True
            if self.job is None:  # looked at after it said so, or it could sleep through a job
                self.calls.get()
            self.asleep = False
            while self.job is not None:
                self._work(*self.job)

    def _work(self, function: Callable, arguments: tuple[Any, ...]) -> None:
        self.job, turn = None, arguments[-1]
        try:
            function(*arguments)
        except BaseException as error:
            self.error = error
        store(self.turns, self.number, turn)


def _stop(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.stop()
