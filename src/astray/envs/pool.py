"""A few threads that share the work on a batch."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from typing import Any


class Pool:
    """Persistent threads; the caller does the first share itself.

    Handing over by locks takes 20 us, a ThreadPoolExecutor 80 to 230. Threads do not survive
    a fork, so a child makes its own.
    """

    def __init__(self, threads: int):
        self.threads = threads
        self._start()

    def _start(self) -> None:
        self._process = os.getpid()
        self._jobs: list[Any] = [None] * (self.threads - 1)
        self._go = [threading.Lock() for _ in self._jobs]
        self._done = [threading.Lock() for _ in self._jobs]
        for lock in (*self._go, *self._done):
            lock.acquire()
        for k in range(len(self._jobs)):
            work = (self._jobs, k, self._go[k], self._done[k])
            threading.Thread(target=_serve, args=work, daemon=True, name=f"astray-{k}").start()
        self.close = weakref.finalize(self, _stop, self._jobs, self._go)

    def run(self, function: Callable, arguments: tuple, n: int) -> None:
        """Call function(*arguments, low, high) on shares of range(n), all at once."""
        if not self.close.alive:
            raise RuntimeError("the environments are closed")
        if self._process != os.getpid():
            self.close.detach()
            self._start()
        edges = [n * k // self.threads for k in range(self.threads + 1)]
        for k in range(len(self._jobs)):
            self._jobs[k] = (function, (*arguments, edges[k + 1], edges[k + 2]))
            self._go[k].release()
        try:
            function(*arguments, edges[0], edges[1])
        finally:
            for lock in self._done:
                lock.acquire()
        errors = [job for job in self._jobs if isinstance(job, BaseException)]
        if errors:
            raise errors[0]


def _serve(jobs: list, k: int, go: threading.Lock, done: threading.Lock) -> None:
    """A thread's life: wait for a job, do it, say so; end when there is none."""
    while True:
        go.acquire()
        job = jobs[k]
        if job is None:
            return
        function, arguments = job
        try:
            function(*arguments)
            jobs[k] = None
        except BaseException as error:
            jobs[k] = error
        del job, function, arguments  # or the batch would live as long as the thread
        done.release()


def _stop(jobs: list, go: list) -> None:
    for k, lock in enumerate(go):
        jobs[k] = None
        lock.release()
