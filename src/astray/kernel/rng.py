"""Random numbers: the original's Mersenne Twister inside a state, and hashes of numbers.

Games draw from MT19937 seeded with the level's number, in the original's order, so that level k is
level k of the original program. Choices that the original did not have (the next level, its
distribution) use hashes instead, which never shift the original's draws.
"""

from typing import Any

import numpy as np

from astray.kernel.jit import entry, kernel, shared

WORDS, MIDDLE = 624, 397  # of MT19937
RNG_FIELDS = [("mt", np.uint32, (WORDS,)), ("mt_next", np.int64)]

# Every constant is a uint64: a bare literal would turn compiled arithmetic signed.
U1, U7, U11, U15, U18 = (np.uint64(n) for n in (1, 7, 11, 15, 18))
U27, U30, U31, U32 = (np.uint64(n) for n in (27, 30, 31, 32))
LOW_32 = np.uint64(0xFFFFFFFF)
SEED_FACTOR = np.uint64(1812433253)
TWIST = np.uint64(0x9908B0DF)
HIGH_BIT, LOW_31 = np.uint64(0x80000000), np.uint64(0x7FFFFFFF)
TEMPER_B, TEMPER_C = np.uint64(0x9D2C5680), np.uint64(0xEFC60000)
GAMMA = np.uint64(0x9E3779B97F4A7C15)
MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
MIX_2 = np.uint64(0x94D049BB133111EB)
MIX_1_LOW, MIX_1_HIGH = MIX_1 & LOW_32, MIX_1 >> U32
MIX_2_LOW, MIX_2_HIGH = MIX_2 & LOW_32, MIX_2 >> U32
TO_UNIT = 2.0**-53


@kernel
def seed_twister(s, number):
    """Seed the twister of `s` with the 32-bit `number`."""
    mt, word = s.mt, np.uint64(number) & LOW_32
    mt[0] = word
    for i in range(1, WORDS):
        word = (SEED_FACTOR * (word ^ (word >> U30)) + np.uint64(i)) & LOW_32
        mt[i] = word
    s.mt_next = 0


@kernel
def draw_u32(s):
    """Draw the next 32 random bits of `s`, as uint64."""
    # One word is renewed per draw; the usual renewal of all 624 at once gives the same numbers.
    mt, i = s.mt, s.mt_next
    after = i + 1 if i + 1 < WORDS else 0
    far = i + MIDDLE if i + MIDDLE < WORDS else i + MIDDLE - WORDS
    y = (np.uint64(mt[i]) & HIGH_BIT) | (np.uint64(mt[after]) & LOW_31)
    word = np.uint64(mt[far]) ^ (y >> U1)
    if y & U1:
        word = word ^ TWIST
    mt[i] = word
    s.mt_next = after
    word = word ^ (word >> U11)
    word = word ^ ((word << U7) & TEMPER_B)
    word = word ^ ((word << U15) & TEMPER_C)
    return word ^ (word >> U18)


@kernel
def below(s, n):
    """Draw a uniform integer in [0, n) as the original does: one word modulo n."""
    return np.int64(draw_u32(s) % np.uint64(n))


@kernel
def unit(s):
    """Draw a uniform real in [0, 1] as the original does: one word / 2^32 as float32."""
    return np.float64(np.float32(np.float64(draw_u32(s)) / 4294967296.0))


# For code that draws so often that inlining them would double its compile time.
@shared
def pick(s, n):
    """Call `below`, without inlining it."""
    return below(s, n)


@shared
def real(s):
    """Call `unit`, without inlining it."""
    return unit(s)


@shared
def choose(s, cells, count, n):
    """Draw `n` of the first `count` cells without replacement, in the original's way.

    If there are fewer, all are returned in their order without a draw. `cells` is reordered.
    """
    chosen = np.empty(min(n, count), np.int64)
    for k in range(chosen.size):
        which = k if n > count else below(s, count - k)
        chosen[k] = cells[which]
        if n <= count:
            for j in range(which, count - k - 1):
                cells[j] = cells[j + 1]
    return chosen


def wind(s: Any, given: Any) -> tuple[int, int]:
    """Set the twister of `s` to a level's look `given`, a seed and a number of draws; return both.

    None means seed 0 without draws; -1 and 0 are then returned.

    Raises:
        ValueError: If `given` is neither.
    """
    seed, draws = -1, 0
    if given is not None:
        whole = isinstance(given, list | tuple) and all(type(n) is int for n in given)
        if not whole or len(given) != 2 or not (0 <= given[0] < 2**31 and 0 <= given[1] < WORDS):
            raise ValueError(
                f"a level's twister must be [a number from 0 to {2**31 - 1}, draws from 0 to "
                f"{WORDS - 1}], or null; got {given!r}"
            )
        seed, draws = given
    seed_twister(s, max(seed, 0))
    for _ in range(draws):
        draw_u32(s)
    return seed, draws


@kernel
def multiply(a, low, high):
    """Return the low 64 bits of `a` times the constant high * 2^32 + low.

    Interpreted numpy warns about wrapped products of uint64; nothing wraps here.
    """
    a_low, a_high = a & LOW_32, a >> U32
    product = a_low * low
    cross = ((a_low * high) & LOW_32) + ((a_high * low) & LOW_32) + (product >> U32)
    return ((cross & LOW_32) << U32) | (product & LOW_32)


@kernel
def mix(number):
    """Hash `number` to a uint64 (SplitMix64's finaliser)."""
    z = np.uint64(number) ^ GAMMA  # zero would stay zero
    z = multiply(z ^ (z >> U30), MIX_1_LOW, MIX_1_HIGH)
    z = multiply(z ^ (z >> U27), MIX_2_LOW, MIX_2_HIGH)
    return z ^ (z >> U31)


@kernel
def mix_two(number, salt):
    """Hash `number` and `salt` to a uint64."""
    return mix(mix(number) ^ np.uint64(salt))


@kernel
def fraction(number, salt):
    """Hash `number` and `salt` to a real in [0, 1)."""
    return np.float64(mix_two(number, salt) >> U11) * TO_UNIT


@entry
def fill_fractions(first, salt, out):
    """Fill `out` [N] float64 with the `fraction` of the numbers from `first` on."""
    for i in range(out.shape[0]):
        out[i] = fraction(first + i, salt)


@entry
def fill_noise(seed, levels, times, out):
    """Fill `out` [N, A] float32 with uniform reals: functions of seed, level and step alone.

    Raises:
        IndexError: If the arguments have different lengths.
    """
    if not len(levels) == len(times) == len(out):
        raise IndexError("levels, times and noise are of other numbers of environments")
    for i in range(out.shape[0]):
        episode = mix_two(seed, levels[i])
        for k in range(out.shape[1]):
            out[i, k] = fraction(episode, times[i] * out.shape[1] + k)
