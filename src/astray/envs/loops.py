"""The batch loop, written once; `compiled.py` binds it to a game.

Threads share a batch: each takes a few environments whenever it has finished its last ones. An
environment depends on its own record alone, not on the thread that steps it.
"""

from typing import Any

import numpy as np

from astray.kernel.barrier import arrive, release, take
from astray.kernel.borrowed import borrowed
from astray.kernel.jit import entry, kernel
from astray.kernel.rng import fraction, mix_two, seed_twister

SHIFT = 0x5817F7  # salt of the hash that decides which levels come from the shifted distribution
NEXT_LEVEL, AS_SET, STEP, NOTHING = -1, -2, -3, -4  # to do, instead of a level's number
NEXT_STEP, SAME_STEP, DISABLED = 0, 1, 2
PIECE = 8  # environments that a thread takes at once: some 5 us of work


def unbound(*_: object) -> Any:
    raise NotImplementedError


# Bound to the number of a game's actions, to a state of `record.fresh`, and to its functions of the
# same names: see `protocols`.
ACTIONS, FRESH = 0, np.empty(0)
generate = step = background = foreground = unbound
# Bound to `begin`, `background_of_any` and `observe`, once these are bound to a game.
begin_one = background_of = observe_one = unbound


# Left as they are where a game has no symbols.
@kernel
def background_planes(s, scene):
    """Write no background."""


@kernel
def foreground_planes(s, scene, planes):
    """Write no planes."""


def begin(s, params, level):
    """Begin an episode in level number `level`."""
    s.level = level
    s.shifted = fraction(level, SHIFT) < params[0].shift_probability
    p = params[1] if s.shifted else params[0]
    s.time, s.time_limit, s.ended = 0, p.time_limit, False
    seed_twister(s, level)
    generate(s, p)


def background_of_any(s, art, symbolic, scene):
    """Write the background of the level that `s` is in."""
    if symbolic:
        background_planes(s, scene)
    else:
        background(s, art, scene)


def observe(s, art, symbolic, scene, observation):
    """Write the observation of `s`."""
    if symbolic:
        foreground_planes(s, scene, observation)
    else:
        foreground(s, art, scene, observation)


@kernel
def next_level(s, i, n, levels, first, count):
    """Return the number of the next level of environment `i` of `n`.

    Args:
        levels: List to walk cyclically: environment i takes every n-th from the i-th on. If it is
            empty, a hash of seed and turn picks from [first, first + count).
    """
    turn = s.turn
    s.turn = turn + 1
    if levels.size:
        return levels[(i + turn * n) % levels.size]
    return first + np.int64(mix_two(s.seed, turn) % np.uint64(count))


@kernel
def replace(states, i, other):
    """Replace state `i` by another, after which the same levels come next."""
    seed, turn = states[i].seed, states[i].turn
    states[i] = other
    states[i].seed, states[i].turn = seed, turn


def run(states, looks, source, orders, seen, results, barrier, thread, generation):
    """Run an order in every environment and observe it; return False if an action is invalid.

    There is a single loop, since each further one would compile the whole game again.

    Args:
        looks: Tuple of the art, whether observations are symbolic, and the backgrounds.
        source: Tuple of the variant's parameters, the arguments `levels`, `first` and `count` of
            `next_level`, and states [N] that replace the next levels, one per environment, or none.
        orders: Tuple of the autoreset mode, the commands [N] int64, and the actions [N]. A command
            is the number of the level to begin, or one of these. NEXT_LEVEL begins the next
            level, AS_SET redraws the background, STEP steps and restarts ended episodes according
            to the mode, NOTHING does nothing.
        seen: Tuple of observations, and of final states and observations, [N, ...], written in mode
            SAME_STEP if an episode ended.
        results: Tuple of reward, terminated and truncated [N], written by STEP.
        barrier, thread, generation: See `kernel.barrier`.
    """
    states, looks, source, orders, seen, results = borrowed(
        (states, looks, source, orders, seen, results)
    )
    (art, symbolic, scenes), (mode, what, actions) = looks, orders
    params, levels, first, count, begins = source
    observations, final_states, final_observations = seen
    reward, terminated, truncated = results
    n = states.shape[0]
    for action in actions:
        if not 0 <= action < ACTIONS:
            return False  # all threads do
    release(barrier, thread, generation)
    low = take(barrier, PIECE)
    while low < n:
        for i in range(low, min(low + PIECE, n)):
            s, level = states[i], what[i]
            if level == STEP:
                reward[i], terminated[i], truncated[i] = 0.0, False, False
                if s.ended and mode == NEXT_STEP:
                    level = NEXT_LEVEL
                else:
                    s.time += 1
                    reward[i], ended = step(s, actions[i])
                    terminated[i] = (ended | False) != 0  # reals fail: a reward in its place
                    truncated[i] = s.time >= s.time_limit and not terminated[i]
                    s.ended = terminated[i] or truncated[i]
                    if s.ended and mode == SAME_STEP:
                        final_states[i] = s
                        observe_one(s, art, symbolic, scenes[i], final_observations[i])
                        level = NEXT_LEVEL
            if level == NEXT_LEVEL and begins.shape[0] > 0:
                replace(states, i, begins[i])
                level = AS_SET
            if level == NEXT_LEVEL:
                level = next_level(s, i, n, levels, first, count)
            if level >= 0:
                replace(states, i, FRESH[0])
                begin_one(s, params, level)
            if level >= 0 or level == AS_SET:
                background_of(s, art, symbolic, scenes[i])
            observe_one(s, art, symbolic, scenes[i], observations[i])
        low = take(barrier, PIECE)
    arrive(barrier, thread, generation)
    return True


@entry
def fill(columns, words, places, which):
    """Assign columns[k, i] = words[i, places[k]] for all i in `which`."""
    for i in range(which.size):
        if which[i]:
            for k in range(places.size):
                columns[k, i] = words[i, places[k]]
