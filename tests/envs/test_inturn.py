"""Environments in turn do as Gymnasium's own vector environment does, and can be left out."""

from copy import deepcopy
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from astray.envs.inturn import InTurn
from astray.envs.watch import Watch

N = 3
SPACES = [
    spaces.Box(0, 255, (2, 3), np.uint8),
    spaces.Box(0, 1, (), np.float32),
    spaces.Discrete(5),
    spaces.Dict({"a": spaces.Box(-1, 1, (2,)), "b": spaces.Discrete(3)}),
]


class Anything(gymnasium.Env):
    """Observations of a space, drawn from the seed and the actions."""

    def __init__(self, space, actions=2):
        self.observation_space, self.action_space = deepcopy(space), spaces.Discrete(actions)

    def reset(self, *, seed=None, options=None):
        self.observation_space.seed(seed)
        self.closed = False
        return self.observation_space.sample(), {"key": seed}

    def step(self, action):
        info = {"key": 2} if action else {"other": 1}
        return self.observation_space.sample(), 0.5, bool(action), False, info

    def close(self):
        self.closed = True


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_steps_are_those_of_gymnasium(space):
    makers = [partial(Anything, space)] * N
    ours, theirs = InTurn(makers, "key", Watch(60.0, "one")), SyncVectorEnv(
        makers, autoreset_mode=AutoresetMode.DISABLED
    )  # fmt: skip
    masks = np.ones(N, bool), np.array([False, True, False])
    for mask in masks:
        taken = [
            env.reset(seed=[4, 5, 6], options={"reset_mask": mask.copy()}) for env in (ours, theirs)
        ]
        assert data_equivalence(*taken)
        taken = [env.step(np.array([0, 1, 0])) for env in (ours, theirs)]
        assert data_equivalence(taken[0][:4], taken[1][:4])
        assert taken[0][4]["key"].tolist() == [0, 2, 0] and "other" not in taken[0][4]


def test_the_environments_that_go_on_are_the_same():
    env = InTurn([partial(Anything, SPACES[0])] * N, "key", Watch(60.0, "one"))
    seen, _ = env.reset(seed=[4, 5, 6], options={"reset_mask": np.ones(N, bool)})
    first, *_ = env._envs
    env.keep(np.array([1, 2]))
    again, _ = env.reset(seed=[0, 0], options={"reset_mask": np.zeros(2, bool)})
    assert first.closed and (again == seen[1:]).all()
    assert env.step(np.zeros(2, int))[0].shape == (2, 2, 3)


def test_environments_of_a_variant_have_one_space():
    makers = [partial(Anything, SPACES[0], actions) for actions in (2, 3)]
    with pytest.raises(ValueError, match="of a variant must have equal spaces"):
        InTurn(makers, "key", Watch(60.0, "one"))


@pytest.mark.parametrize("shared", [np.zeros(2), {"a": np.zeros(2), "b": 1}], ids=type)
def test_environments_may_show_what_they_see_in_one_array(shared):
    class Shares(Anything):
        def reset(self, *, seed=None, options=None):
            array = shared["a"] if isinstance(shared, dict) else shared
            array[:] = self.number = seed or 0
            return shared, {}

        def step(self, action):
            return self.reset(seed=self.number + 10)[0], 0.0, False, False, {}

    space = spaces.Box(-99, 99, (2,), np.float64)
    space = (
        spaces.Dict({"a": space, "b": spaces.Discrete(3)}) if isinstance(shared, dict) else space
    )
    env = InTurn([partial(Shares, space)] * N, "key", Watch(60.0, "one"))
    every, last = np.ones(N, bool), np.arange(N) == N - 1
    steps = [env.reset(seed=[4, 5, 6], options={"reset_mask": every}), env.step(np.zeros(N, int))]
    steps.append(env.reset(seed=[4, 5, 6], options={"reset_mask": last}))
    seen = [
        (step[0]["a"] if isinstance(shared, dict) else step[0])[:, 0].tolist() for step in steps
    ]
    assert seen == [[4, 5, 6], [14, 15, 16], [14, 15, 6]]
