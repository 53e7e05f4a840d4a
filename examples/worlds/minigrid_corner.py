"""MiniGrid with an agent of Stable-Baselines3: does it look for the square, or for the corner?

astray reproduce examples/worlds/minigrid_corner.py
"""

from functools import partial

import numpy as np
from gymnasium.spaces import Box, Discrete
from minigrid.core.grid import Grid
from minigrid.core.mission import MissionSpace
from minigrid.core.world_object import Goal
from minigrid.minigrid_env import MiniGridEnv
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import astray
from astray.analysis.adapters import from_sb3
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, OwnAgents, Plan, tests_of

SIZE, STEPS = 6, 20_000


class Room(MiniGridEnv):
    """The square that ends an episode is in the far corner, or anywhere."""

    def __init__(self, anywhere=False, **more):
        mission = MissionSpace(lambda: "reach the square")
        super().__init__(mission, grid_size=SIZE, max_steps=40, **more)
        self.anywhere, self.corner = anywhere, (SIZE - 2, SIZE - 2)
        self.action_space = Discrete(3)  # turn left, turn right, go on
        self.observation_space = Box(0, 1, (4 + 2 * SIZE * SIZE,), np.float32)

    def _gen_grid(self, width, height):
        self.grid = Grid(width, height)
        self.grid.wall_rect(0, 0, width, height)
        self.square = self.place_obj(Goal(), *(() if self.anywhere else (self.corner, (1, 1))))
        self.place_agent((1, 1), (2, 2))

    def gen_obs(self):
        cells = np.zeros((2, SIZE, SIZE), np.float32)
        cells[0][self.agent_pos] = cells[1][self.square] = 1
        return np.concatenate([np.eye(4, dtype=np.float32)[self.agent_dir], cells.ravel()])


def stands(goal, env, info):
    return tuple(env.agent_pos) == tuple(getattr(env, goal))


def toward(goal, env):
    x, y = np.sign(np.subtract(getattr(env, goal), env.agent_pos))
    turns = ((1 - x if x else 2 - y) - env.agent_dir) % 4  # directions: right, down, left, up
    return 2 if turns == 0 else 0 if turns == 3 else 1


GOALS = ("square", "corner")
WORLD = astray.World(
    name="room",
    variants={"corner": Room, "anywhere": partial(Room, anywhere=True)},
    events={f"at_{goal}": partial(stands, goal) for goal in GOALS},
    goals={goal: f"at_{goal}" for goal in GOALS},
    experts={goal: partial(toward, goal) for goal in GOALS},
    shifts={"corner": astray.Shift("corner", "anywhere", "square", ("corner",))},
)


def train(seed, folder):
    env = make_vec_env(Room, n_envs=8, seed=seed)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, seed=seed, device="cpu")
    model.learn(STEPS).save(folder / "model.zip")


def load(folder):
    return from_sb3(PPO.load(folder / "model.zip", device="cpu"))


TESTS = tests_of(WORLD, "corner")
OWN = {"ppo": OwnAgents(load, train=train)}
PLAN = Plan(world=WORLD, own=OWN, seeds=4, tests=TESTS, levels=200, differences="all of it")
QUESTION = "Does an agent whose square was always in the corner look for the square?"
EXPERIMENT = Experiment("A MiniGrid room", "nothing", QUESTION, {"smoke": PLAN}, outcomes.findings)
