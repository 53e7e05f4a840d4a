"""Environments of nobody's: a row of cells with a square, which in training lies at its end."""

import itertools
import multiprocessing
import os
import time
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np

from astray.analysis.adapters import Function
from astray.game import Shift, Truncated
from astray.world import World

CELLS, LIMIT = 9, 12
PARTS = "parts", "blurred parts"  # troubles
DRAWN = itertools.count()  # of an environment that draws by anything else than its seed


class Room(gymnasium.Env):
    """The agent begins in the middle; actions are left and right. The square is worth 1."""

    def __init__(self, place="end", vector=False, trouble=None, render_mode=None):
        self.place, self.trouble = place, trouble
        self.observation_space = gymnasium.spaces.Box(0, 1, (2, CELLS), np.float32)
        axes = {False: None, True: [2, 3], 2: [[2, 3], [2, 2]]}[vector]
        self.action_space = (
            gymnasium.spaces.MultiDiscrete(axes) if axes else gymnasium.spaces.Discrete(2)
        )
        self.render_mode = render_mode
        if trouble == "spaceless":
            self.observation_space = None
        if trouble == "two answers":
            self.action_space = gymnasium.spaces.Tuple([self.action_space] * 2)
        if trouble in PARTS:
            self.observation_space = gymnasium.spaces.Dict(room=self.observation_space)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.time, self.steps = CELLS // 2, 0, 0
        self.square = CELLS - 1 if self.place == "end" else int(self.np_random.integers(CELLS))
        if self.trouble == "draws":
            self.square = next(DRAWN) % CELLS
        return self._seen(), {}

    def step(self, action):
        self._make_trouble()
        self.time += 1
        self.x = min(max(self.x + 2 * int(np.ravel(action)[0]) - 1, 0), CELLS - 1)
        self.steps += 1
        there = self.x == self.square
        info = None if self.trouble == "no info" else {"square": there}
        reward = {"nan": np.nan, "text": "much", "vast": 10**400}.get(self.trouble, float(there))
        ended = {"word": "False", "unsaid": None}.get(self.trouble, there)
        return self._seen(), reward, ended, self.time >= LIMIT, info

    def render(self):
        """Cells of two pixels; the agent is red, the square green."""
        if self.trouble == "blind":
            raise NotImplementedError
        picture = np.zeros((1, CELLS, 3), np.uint8)
        picture[0, self.x, 0] = picture[0, self.square, 1] = 255
        return picture.repeat(2, 0).repeat(2, 1)

    def close(self):
        if self.trouble == "stays" and multiprocessing.parent_process():
            time.sleep(1000)
        if self.trouble == "stuck":
            raise OSError("busy")

    def _seen(self):
        seen = np.zeros((2, CELLS), np.float32)
        seen[0, self.x] = seen[1, self.square] = 1
        if self.trouble == "blurs" and self.time == 3:
            seen[1, 4] = np.nan
        if self.trouble == "bright":
            seen[1, 4] = 2 * (self.time == 3)
        if self.trouble in PARTS:
            blurred = self.trouble == "blurred parts" and self.time == 3
            return {"room": seen * np.float32(np.nan if blurred else 1)}
        speaks = self.trouble == "speaks" or (self.trouble == "murmurs" and self.time == 3)
        seen = seen.astype(str) if speaks else seen
        return seen[:, :3] if self.trouble == "shrinks" and self.time == 3 else seen

    def _make_trouble(self):
        if self.time != 2:
            return
        if self.trouble == "exits":
            raise SystemExit(3)
        if self.trouble == "raises":
            raise KeyError("lost")
        if self.trouble == "dies":
            os._exit(1)
        if self.trouble == "hangs":
            time.sleep(1000)
        if self.trouble == "endless":
            self.time -= 1


def toward(env, x):
    return int(env.x < x)


def at_end(env, info):
    return env.x == CELLS - 1


def to_square(env):
    return toward(env, env.square)


def to_end(env):
    return toward(env, CELLS)


def walked(env):
    return env.steps


def go_right(seen):
    """A policy for the command line."""
    return np.ones(len(seen), int)


def go_left(seen):
    """Another one."""
    return np.zeros(len(seen), int)


def each_step(step):
    """A reward for the command line: 1 in every step."""
    return np.ones(len(step.rewards))


class Right:
    """A policy with a name of its own, which the command line calls without arguments."""

    def __new__(cls):
        return Function(go_right, "right")


WORLD = World(
    name="room",
    variants={v: partial(Room, place=v) for v in ("end", "anywhere")},
    events={"reached_square": "square", "reached_end": at_end},
    goals={"square": "reached_square", "end": "reached_end"},
    shifts={"end": Shift("end", "anywhere", "square", ("end",))},
    ends={"time ran out": Truncated()},
    experts={"square": to_square, "end": to_end},
    measures={"walked": walked},
)
ENDLESS = replace(
    WORLD, variants={v: partial(Room, place="end", trouble="endless") for v in WORLD.variants}
)
