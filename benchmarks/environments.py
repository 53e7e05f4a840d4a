"""Steps per second of the games, beside EnvPool's re-creation of the originals and a plain copy.

Everything is measured in turns, round after round, so that whatever slows the machine for a
while slows all of it; figures are medians over the rounds, and ratios are of these medians.
Gymnasium's `benchmark_vector_step` does not serve: it draws the actions while the clock runs,
and it resets every environment at once, so that short measurements hold either no reset or all.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any, ClassVar

import numpy as np

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.game import OWN
from benchmarks.tables import NOTHING, count, decimal, thousands

ACTIONS = 64  # prepared steps of actions, used again and again
COPIED = 2**27  # bytes of the plain copy: more than a processor's caches hold
COPY = "memory copy"
IMAGES, SYMBOLS = "images", "symbolic"
ORIGINAL = "original"  # the art of EnvPool's images
BESIDE = "images beside a busy process"
BUSY = "while True: pass"  # what that process does


@dataclass(frozen=True)
class Row:
    """Result of one contender; None where it was not measured or a column does not apply."""

    title: ClassVar[str] = "Environment steps, in turns"
    game: str
    variant: str
    what: str
    batch: int | None = None
    threads: int | None = None
    steps_per_second: float | None = None  # environment steps, median over the rounds
    best: float | None = None  # of the rounds, in steps per second
    gigabytes_per_second: float | None = None  # of observations, or of what is copied
    to_peer: float | None = None  # ratio to EnvPool
    to_own: float | None = None  # ratio to images with our own art
    to_one_thread: float | None = None  # ratio to the same with one thread
    of_copy: float | None = None  # fraction of the bytes per second that a plain copy moves
    note: str = ""

    def cells(self) -> dict[str, str]:
        return {
            "game": f"{self.game} {self.variant}",
            "what": f"{self.what} ({self.note})" if self.note else self.what,
            "batch": count(self.batch),
            "threads": count(self.threads),
            "1,000 steps/s": thousands(self.steps_per_second),
            "best": thousands(self.best),
            "GB/s": decimal(self.gigabytes_per_second),
            "x EnvPool": decimal(self.to_peer, 1),
            "x own art": decimal(self.to_own),
            "x 1 thread": decimal(self.to_one_thread),
            "of a copy": NOTHING if self.of_copy is None else f"{self.of_copy:.0%}",
        }


@dataclass
class Contender:
    """Something that is measured in turns with others."""

    row: Row  # without figures
    once: Callable[[int], object]  # do it for the k-th time
    bytes: int  # that one `once` makes
    close: Callable[[], object] = lambda: None
    speeds: list[float] = field(default_factory=list)  # `once` per second, of each round

    def take_turn(self, seconds: float) -> None:
        """Go on for `seconds`, and before it a quarter of that for what left the caches."""
        self._go_on(seconds / 4)
        self.speeds.append(self._go_on(seconds))

    def _go_on(self, seconds: float) -> float:
        done, began = 0, time.perf_counter()
        while (passed := time.perf_counter() - began) < seconds or not done:
            self.once(done)
            done += 1
        return done / passed

    def result(self) -> Row:
        """The row, with what was measured but no ratios."""
        middle = median(self.speeds)
        row = replace(self.row, gigabytes_per_second=middle * self.bytes / 1e9)
        if row.batch is None:
            return row
        return replace(row, steps_per_second=middle * row.batch, best=max(self.speeds) * row.batch)


def measure(
    names: Sequence[str] = games.OWN, seconds: float = 0.4, rounds: int = 15, seed: int = 0
) -> list[Row]:
    """Measure these games, each turn for `seconds`."""
    rows = []
    for name in names:
        game = games.find(name)
        on = game.benchmark
        if ORIGINAL in game.looks:
            rows += measure_game(name, on.variant, on.envpool, seconds, rounds, seed=seed)
        else:
            rows += measure_world(name, on.variant, seconds, rounds, seed=seed)
    return rows


def measure_world(
    game: str, variant: str, seconds: float = 0.4, rounds: int = 15, *, seed: int = 0
) -> list[Row]:
    """Measure a world without an original, in 256 environments and one thread."""
    contenders = [_ours(game, variant, what, 256, 1, seed) for what in (IMAGES, SYMBOLS)]
    _take_turns(contenders, seconds, rounds)
    return [contender.result() for contender in contenders]


def measure_game(
    game: str,
    variant: str,
    peer: str | None,
    seconds: float = 0.4,
    rounds: int = 15,
    *,
    batches: tuple[int, int] = (256, 1024),
    seed: int = 0,
) -> list[Row]:
    """Measure one game, and the environment `peer` of EnvPool, where there is one like it.

    batches  environments of two sizes of batch; EnvPool has the smaller: of MazeHard-v0 64 are
             5% slower than 256, and 1,024 4% faster
    """
    contenders = [
        _ours(game, variant, IMAGES, batch, threads, seed)
        for batch in batches
        for threads in (1, 2)
    ]
    missing = []
    try:
        contenders += [_ours(game, variant, _images(ORIGINAL), n, 1, seed) for n in batches]
    except FileNotFoundError as error:
        missing.append(Row(game, variant, _images(ORIGINAL), note=str(error)))
    contenders += [_ours(game, variant, SYMBOLS, batch, 1, seed) for batch in batches]
    steps = games.find(game).variant(variant).time_limit
    if peer:
        made = _envpool(Row(game, variant, f"EnvPool {peer}"), peer, batches[0], steps, seed)
        if isinstance(made, Contender):
            contenders.append(made)
        else:
            missing.append(made)
    contenders.append(_copy(game, variant))
    _take_turns(contenders, seconds, rounds)
    beside = [_ours(game, variant, BESIDE, batches[0], threads, seed) for threads in (1, 2)]
    with subprocess.Popen([sys.executable, "-c", BUSY]) as busy:
        try:
            _take_turns(beside, seconds, rounds)
        finally:
            busy.kill()
    *rows, copy = [contender.result() for contender in contenders]
    rows += [contender.result() for contender in beside]
    return _with_ratios([*rows, *missing, copy])


def _images(art: str) -> str:
    return IMAGES if art == OWN else f"{IMAGES}, {art} art"


def _take_turns(contenders: Sequence[Contender], seconds: float, rounds: int) -> None:
    for contender in contenders:
        contender.once(0)  # the first time touches memory that is given only then
    for _ in range(rounds):
        for contender in contenders:
            contender.take_turn(seconds)
    for contender in contenders:
        contender.close()


def _ours(game: str, variant: str, what: str, batch: int, threads: int, seed: int) -> Contender:
    env = GameVectorEnv(
        game,
        variant,
        batch,
        observation="symbolic" if what == SYMBOLS else "image",
        art=ORIGINAL if what == _images(ORIGINAL) else OWN,
        autoreset_mode="SameStep",
        threads=threads,
    )
    rng = np.random.default_rng(seed)
    actions = rng.integers(len(env.game.actions), size=(ACTIONS, batch))
    env.reset(seed=seed)
    # Each environment at another time of its episode: resets are spread, as in a long run.
    states = env.states.copy()
    states["time"] = rng.integers(env.variant.time_limit, size=batch)
    made = env.set_state(states)
    row = Row(game, variant, what, batch, threads)
    return Contender(row, lambda k: env.step(actions[k % ACTIONS]), made.nbytes, env.close)


def _envpool(row: Row, peer: str, n: int, steps: int, seed: int) -> Contender | Row:
    """EnvPool's environment held to one thread, or the row that says why there is none."""
    try:
        envpool: Any = importlib.import_module("envpool")
    except ImportError:
        return replace(row, note="not installed: pip install envpool")
    try:  # One thread steps all of a batch, while the caller waits.
        env = envpool.make_gymnasium(peer, num_envs=n, batch_size=n, num_threads=1, seed=seed)
    except (ImportError, AssertionError):  # without Qt; newer ones list it all the same
        return replace(row, note="not in this EnvPool; it needs Debian's libqt5gui5")
    rng = np.random.default_rng(seed)
    actions = rng.integers(env.action_space.n, size=(ACTIONS, n)).astype(np.int32)
    images, _ = env.reset()
    # Its states cannot be set, so resets are spread by stepping each environment alone.
    ahead = rng.integers(steps, size=n)
    for k in range(ahead.max()):
        behind = np.flatnonzero(ahead > k)
        env.step(actions[k % ACTIONS, behind], behind)
    row = replace(row, batch=n, threads=1)
    return Contender(row, lambda k: env.step(actions[k % ACTIONS]), images.nbytes, env.close)


def _copy(game: str, variant: str) -> Contender:
    source, target = np.ones(COPIED, np.uint8), np.zeros(COPIED, np.uint8)
    row = Row(game, variant, COPY, threads=1)
    return Contender(row, lambda _: np.copyto(target, source), COPIED)


def _with_ratios(rows: list[Row]) -> list[Row]:
    """`rows` of one game, with their ratios to one another."""
    copy = next(row for row in rows if row.what == COPY)
    peer = next((row for row in rows if row.what.startswith("EnvPool")), None)
    alone = {(row.what, row.batch): row.steps_per_second for row in rows if row.threads == 1}
    result = []
    for row in rows:
        if row.what.startswith(IMAGES) and row.steps_per_second:
            single = alone[row.what, row.batch] if row.threads != 1 else None
            row = replace(
                row,
                to_peer=_ratio(row.steps_per_second, peer.steps_per_second if peer else None),
                to_own=_ratio(row.steps_per_second, alone[IMAGES, row.batch])
                if row.what == _images(ORIGINAL)
                else None,
                to_one_thread=_ratio(row.steps_per_second, single),
                of_copy=_ratio(row.gigabytes_per_second, copy.gigabytes_per_second),
            )
        if row.what == BESIDE:
            row = replace(row, to_peer=None, of_copy=None)  # which were measured beside nothing
        result.append(row)
    return result


def _ratio(x: float | None, y: float | None) -> float | None:
    return x / y if x and y else None
