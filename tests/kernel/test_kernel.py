"""The compiled building blocks against independent ones."""

import gc
import threading
import time
import types
import weakref

import numba
import numpy as np
import pytest
from scipy.sparse.csgraph import shortest_path

from astray.envs.pool import Pace, Pool
from astray.kernel import rng
from astray.kernel.barrier import arrive, release, take
from astray.kernel.borrowed import borrowed
from astray.kernel.canvas import blit, copy_window
from astray.kernel.grid import UNREACHABLE, distances
from astray.kernel.jit import kernel
from astray.record import state_dtype

MASK = 2**64 - 1


@pytest.mark.parametrize("number", [0, 1, 5489, 2**31 - 2, 2**32 - 1])
def test_the_twister_is_numpys(number):
    s = np.zeros(1, state_dtype()).view(np.recarray)[0]
    rng.seed_twister(s, number)
    theirs = np.random.MT19937()
    theirs._legacy_seeding(number)
    assert [int(rng.draw_u32(s)) for _ in range(2000)] == theirs.random_raw(2000).tolist()


def test_draws_are_the_originals_use_of_the_twister():
    one, two = (np.zeros(1, state_dtype()).view(np.recarray)[0] for _ in range(2))
    rng.seed_twister(one, 7)
    rng.seed_twister(two, 7)
    for n in (1, 9, 12, 337):
        assert rng.below(one, n) == int(rng.draw_u32(two)) % n
    assert rng.unit(one) == float(np.float32(int(rng.draw_u32(two)) / 2**32))


def naive_mix(z):
    z ^= 0x9E3779B97F4A7C15
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & MASK
    z = (z ^ z >> 27) * 0x94D049BB133111EB & MASK
    return z ^ z >> 31


def test_the_hash_is_splitmix():
    for number in (0, 1, 17, 2**63, MASK):
        assert int(rng.mix(np.uint64(number))) == naive_mix(number)
        assert int(rng.mix_two(np.uint64(number), 5)) == naive_mix(naive_mix(number) ^ 5)


def test_fractions_are_uniform():
    values = [rng.fraction(k, 3) for k in range(2000)]
    assert min(values) >= 0 and max(values) < 1
    assert np.histogram(values, 10, (0, 1))[0].min() > 150


@pytest.mark.parametrize("top, left", [(0, 0), (-2, 1), (3, -3), (6, 5), (-9, 0), (8, 8)])
def test_a_sprite_is_laid_over_a_picture_to_the_nearest_shade(top, left):
    random = np.random.default_rng(0)
    picture = random.integers(0, 256, (8, 8, 3), np.uint8)
    sprite = random.integers(0, 256, (5, 4, 4), np.uint8)
    sprite[0, :, 3], sprite[1, :, 3] = 0, 255
    padded = np.pad(picture.astype(float), ((9, 9), (9, 9), (0, 0)))
    under, opacity = padded[9 + top : 14 + top, 9 + left : 13 + left], sprite[..., 3:] / 255
    under[:] = sprite[..., :3] * opacity + under * (1 - opacity)
    blit(picture, sprite, top, left)
    assert np.array_equal(picture, np.rint(padded[9:17, 9:17]))


def test_every_shade_over_every_shade_at_every_opacity_is_the_nearest():
    over, under = np.meshgrid(np.arange(256, dtype=np.uint8), np.arange(256, dtype=np.uint8))
    opaque = np.empty((256, 256, 4), np.uint8)
    opaque[..., :3] = over[..., None]
    lay = numba.njit(lambda picture, sprite: blit(picture, sprite, 0, 0))
    for opacity in range(256):
        opaque[..., 3] = opacity
        picture = np.repeat(under[..., None], 3, 2)
        lay(picture, opaque)
        exact = (over * float(opacity) + under * (255.0 - opacity)) / 255
        assert np.abs(picture - exact[..., None]).max() < 0.5


@pytest.mark.parametrize("width", [64, 20])
def test_a_window_is_a_slice(width):
    scene = np.random.default_rng(0).integers(0, 256, (50, 80, 3), np.uint8)
    window = np.empty((30, width, 3), np.uint8)
    numba.njit(lambda to, of: copy_window(to, of, 7, 11))(window, scene)
    assert np.array_equal(window, scene[7:37, 11 : 11 + width])


def test_distances_are_scipys():
    random = np.random.default_rng(0)
    for _ in range(20):
        is_open = random.random((7, 9)) < 0.7
        is_open[3, 4] = True
        graph = np.zeros((63, 63))
        for y, x in np.argwhere(is_open):
            for v, u in ((y + 1, x), (y, x + 1)):
                if v < 7 and u < 9 and is_open[v, u]:
                    graph[y * 9 + x, v * 9 + u] = graph[v * 9 + u, y * 9 + x] = 1
        far = shortest_path(graph, unweighted=True, indices=3 * 9 + 4).reshape(7, 9)
        assert np.array_equal(distances(is_open, 4, 3), np.where(far < 99, far, UNREACHABLE))


@kernel
def doubled(x):
    return x + x


@numba.njit
def fourfold(x):
    return doubled(doubled(x))


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_kernel_is_interpreted_or_part_of_what_calls_it():
    assert doubled("ab") == "abab"  # which is not compiled for it
    assert fourfold(3) == 12
    (part,) = doubled.compiled.overloads.values()
    engine = part.target_context.codegen()._engine
    assert not engine.is_symbol_defined(part.fndesc.mangled_name)
    (whole,) = fourfold.overloads.values()
    assert engine.is_symbol_defined(whole.fndesc.mangled_name)


class Shared(Pace):
    """Every round is shared, however long it takes."""

    shared = property(lambda self: True, lambda self, shared: None)


def test_a_pool_does_every_piece_once_and_raises_what_fails():
    pool, seen, threads = Pool(3, Shared()), [], set()

    def see(barrier, thread, generation):
        while (low := take(barrier, 3)) < 1000:
            seen.extend(range(low, min(low + 3, 1000)))
            threads.add(thread)
            time.sleep(1e-4)
        return thread

    for generation in range(1, 4):
        assert pool.run(see, ()) == 0
        assert sorted(seen) == sorted([*range(1000)] * generation)
    assert threads == {0, 1, 2}
    with pytest.raises(ZeroDivisionError):
        pool.run(lambda barrier, thread, generation: 1 // (thread - 2), ())
    assert pool.run(see, ()) == 0
    pool.close()


def test_a_pool_whose_share_failed_does_not_live_on():
    pool = Pool(2, Shared())
    gone = weakref.ref(pool)
    with pytest.raises(ZeroDivisionError):
        pool.run(lambda barrier, thread, generation: 1 // (thread - 1), ())
    del pool
    gc.collect()
    assert gone() is None


def test_a_pool_that_another_thread_closes_does_not_wait_for_those_that_ended(monkeypatch):
    pool, told = Pool(2, Shared()), []
    (worker,) = pool._workers
    give = worker.give

    def close_and_give(*given):
        pool.close()
        while not worker.ended:
            time.sleep(0.001)
        give(*given)

    def run():
        try:
            pool.run(lambda *_: None, ())
        except RuntimeError as error:
            told.append(str(error))

    monkeypatch.setattr(worker, "give", close_and_give)
    runner = threading.Thread(target=run, daemon=True)
    runner.start()
    runner.join(20)
    assert told == ["the environments were closed while they were stepped"]


def test_a_pool_that_was_interrupted_loses_no_share(monkeypatch):
    pool, seen = Pool(2, Shared()), []

    def interrupt(_):
        raise KeyboardInterrupt

    def slowly(barrier, thread, generation):
        time.sleep(0.2 * thread)
        seen.append((generation, thread))

    with monkeypatch.context() as patch:
        patch.setattr(
            "astray.envs.pool.time", types.SimpleNamespace(sleep=interrupt, perf_counter=float)
        )
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                pool.run(slowly, ())
    assert seen == [(1, 0)]  # the thread is still at the first round; the second was not begun
    pool.run(slowly, ())
    assert sorted(seen) == [(1, 0), (1, 1), (2, 0), (2, 1)]
    pool.close()


@numba.njit(nogil=True)
def add_up(numbers, sums, barrier, thread, generation):
    release(barrier, thread, generation)
    sums[thread] = 0
    i = take(barrier, 1)
    while i < numbers.size:
        sums[thread] += numbers[i]
        i = take(barrier, 1)
    arrive(barrier, thread, generation)


@numba.njit(nogil=True)
def count_pieces(times, barrier, thread, generation):
    i = take(barrier, 1)
    while i < times.size:
        times[i] += 1
        i = take(barrier, 1)


def test_threads_that_take_at_once_take_different_pieces():
    pool, times = (
        Pool(3, Shared()),
        np.zeros(10_000 if numba.config.DISABLE_JIT else 3_000_000, np.int64),
    )
    for generation in range(1, 4):
        pool.run(count_pieces, (times,))
        assert (times == generation).all()
    pool.close()


@pytest.mark.parametrize("processors", [1, 3])
def test_no_round_is_lost_or_done_twice_however_long_threads_wait(processors, monkeypatch):
    monkeypatch.setattr("astray.envs.pool.usable_processors", lambda: processors)
    pool, sums = Pool(3, Shared()), np.zeros(3, np.int64)
    random = np.random.default_rng(0)
    for generation in range(2000):
        numbers = random.integers(0, 100, 50)
        pool.run(add_up, (numbers, sums))
        assert sums.sum() == numbers.sum()
        sums[:] = -1  # a late thread would put its sum here
        if generation % 10 == 0:
            time.sleep(random.choice([0, 5e-5, 1e-4, 3e-4, 2e-3]))  # so that it sleeps, or nearly
        assert (sums == -1).all()
    pool.close()


def pass_rounds(pace, seconds, alone, shared):
    """Go on for `seconds`; the fraction of rounds shared, and how much sooner they were done."""
    rounds, together, spent = 0, 0, 0.0
    while spent < seconds:
        round = shared(rounds) if pace.shared else alone
        rounds, together, spent = rounds + 1, together + pace.shared, spent + round
        pace.note(round)
    return together / rounds, rounds * alone / spent


def test_rounds_are_shared_while_that_is_sooner():
    pace = Pace()
    assert min(pass_rounds(pace, 10, 2e-4, lambda k: 1.2e-4)) > 0.95
    # Beside a busy process one round in ten waits for a slice of the scheduler's.
    fraction, sooner = pass_rounds(pace, 20, 2e-4, lambda k: 4e-3 if k % 10 == 0 else 1.2e-4)
    assert fraction < 0.05 and sooner > 0.95
    assert pass_rounds(pace, 20, 2e-4, lambda k: 1.2e-4)[0] > 0.75
    # A slice lost now and then is no reason.
    assert pass_rounds(pace, 10, 2e-4, lambda k: 4e-3 if k % 1000 == 0 else 1.2e-4)[0] > 0.9


def test_compiled_code_does_not_count_references_to_borrowed_arrays():
    numbers, owned = np.arange(6).reshape(3, 2), numba.njit(lambda x: x[1:])
    lent = numba.njit(lambda x: borrowed(((x,), 7))[0][0][1:])
    for compiled, is_counted in ((owned, True), (lent, False)):
        part = compiled(numbers)
        assert part.tolist() == [[2, 3], [4, 5]] and np.shares_memory(part, numbers)
        assert (part.base is not None) == is_counted
    assert borrowed((numbers, 7)) == (numbers, 7)  # interpreted
