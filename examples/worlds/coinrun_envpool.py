"""CoinRun of EnvPool, with agents of CleanRL: do they still reach the coin where levels are hard?

Put checkpoints of CleanRL's ppo_procgen.py into the folder agents of the working folder, then

astray reproduce examples/worlds/coinrun_envpool.py
"""

from functools import partial
from pathlib import Path

import envpool
import gymnasium
import numpy as np

import astray
from astray.analysis.cleanrl import from_cleanrl
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, OwnAgents, Plan, tests_of
from astray.game import Truncated

FILES = sorted(Path("agents").glob("*.cleanrl_model"))


class Procgen(gymnasium.Env):
    """A game of EnvPool, a level at a time, chosen by Procgen's own number of it."""

    observation_space = gymnasium.spaces.Box(0, 255, (64, 64, 3), np.uint8)
    action_space = gymnasium.spaces.Discrete(15)
    render_mode = "rgb_array"

    def __init__(self, task, **options):
        self.task, self.options = task, options | {"channel_first": False, "num_levels": 1}

    def reset(self, *, seed=None, options=None):
        # A pool keeps its seed and its levels for ever; a new one takes 0.03 s.
        own = self.options | {"start_level": seed or 0}
        self.pool = envpool.make(self.task, env_type="gymnasium", num_envs=1, **own)
        (self.seen,), _ = self.pool.reset()
        return self.seen, {"complete": False}

    def step(self, action):
        told = self.pool.step(np.array([action], np.int32))
        (self.seen,), (reward,), (terminated,), (truncated,), info = told
        complete = bool(terminated and info["prev_level_complete"][0])
        info = {"complete": complete, "died": bool(terminated and not complete)}
        return self.seen, float(reward), bool(terminated), bool(truncated), info

    def render(self):
        return self.seen


WORLD = astray.World(
    name="coinrun of envpool",
    variants={hard: partial(Procgen, f"Coinrun{hard.title()}-v0") for hard in ("easy", "hard")},
    events={"complete": "complete", "died": "died"},
    goals={"coin": "complete"},
    ends={"death": "died", "time ran out": Truncated()},
    shifts={"hard": astray.Shift("easy", "hard", intended="coin", proxies=())},
)

EXPERIMENT = Experiment(
    title="CoinRun of EnvPool, easy and hard",
    reproduces="nothing",
    question="Do agents that were trained on easy levels reach the coin where levels are hard?",
    sizes={
        "smoke": Plan(
            world=WORLD,
            own={"ppo": OwnAgents(partial(from_cleanrl, space=Procgen.observation_space), FILES)},
            seeds=max(1, len(FILES)),
            tests=tests_of(WORLD, "hard"),
            levels=200,
            differences="all of it",
        )
    },
    find=outcomes.findings,
)
