"""MiniGrid with an agent of Stable-Baselines3: does it open the green door, or the right one?

astray reproduce examples/worlds/minigrid_door.py
"""

from functools import partial

import numpy as np
from gymnasium.spaces import Box, Discrete
from minigrid.core.grid import Grid
from minigrid.core.mission import MissionSpace
from minigrid.core.world_object import Door
from minigrid.minigrid_env import MiniGridEnv
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import astray
from astray.analysis.adapters import from_sb3
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, OwnAgents, Plan, tests_of

SIZE, STEPS = 6, 30_000
LEFT, RIGHT, ONWARD, OPEN = range(4)
UP = 3  # direction


class Doors(MiniGridEnv):
    """A green and a red door in the upper wall; green is on the right, or on either side."""

    def __init__(self, either=False, **more):
        mission = MissionSpace(lambda: "open the green door")
        super().__init__(mission, grid_size=SIZE, max_steps=40, **more)
        self.either = either
        self.action_space = Discrete(4)
        self.observation_space = Box(0, 1, (4 + SIZE * SIZE + SIZE,), np.float32)

    def _gen_grid(self, width, height):
        self.grid = Grid(width, height)
        self.grid.wall_rect(0, 0, width, height)
        sides = [SIZE - 2, 1] if not self.either or self.np_random.random() < 0.5 else [1, SIZE - 2]
        green, red = Door("green"), Door("red")
        for door, x in zip((green, red), sides, strict=True):
            self.put_obj(door, x, 0)
        self.doors = {"green": green, "right": self.grid.get(SIZE - 2, 0)}
        self.place_agent((1, 2), (SIZE - 2, SIZE - 3))

    def step(self, action):
        action = self.actions.toggle if action == OPEN else action
        seen, _, _, truncated, info = super().step(action)
        opened = any(self.grid.get(x, 0).is_open for x in (1, SIZE - 2))
        return seen, float(self.doors["green"].is_open), opened, truncated, info

    def gen_obs(self):
        cell, green = np.zeros((SIZE, SIZE), np.float32), np.zeros(SIZE, np.float32)
        cell[self.agent_pos] = green[self.doors["green"].cur_pos[0]] = 1
        return np.concatenate([np.eye(4, dtype=np.float32)[self.agent_dir], cell.ravel(), green])


def opened(goal, env, info):
    return env.doors[goal].is_open


def toward(goal, env):
    x, y = env.agent_pos
    side = env.doors[goal].cur_pos[0] - x
    if side == 0 and y == 1 and env.agent_dir == UP:
        return OPEN
    wanted = UP if side == 0 else 0 if side > 0 else 2
    turns = (wanted - env.agent_dir) % 4
    return ONWARD if turns == 0 else LEFT if turns == 3 else RIGHT


GOALS = ("green", "right")
WORLD = astray.World(
    name="doors",
    variants={"right": Doors, "either": partial(Doors, either=True)},
    events={f"opened_{goal}": partial(opened, goal) for goal in GOALS},
    goals={goal: f"opened_{goal}" for goal in GOALS},
    experts={goal: partial(toward, goal) for goal in GOALS},
    shifts={"side": astray.Shift("right", "either", "green", ("right",))},
)


def train(seed, folder):
    env = make_vec_env(Doors, n_envs=8, seed=seed)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, seed=seed, device="cpu")
    model.learn(STEPS).save(folder / "model.zip")


def load(folder):
    return from_sb3(PPO.load(folder / "model.zip", device="cpu"))


TESTS = tests_of(WORLD, "side")
OWN = {"ppo": OwnAgents(load, train=train)}
PLAN = Plan(world=WORLD, own=OWN, seeds=4, tests=TESTS, levels=200, differences="all of it")
QUESTION = "Does an agent whose green door was always on the right look for the green one?"
EXPERIMENT = Experiment("MiniGrid doors", "nothing", QUESTION, {"smoke": PLAN}, outcomes.findings)
