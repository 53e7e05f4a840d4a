"""Stable-Baselines3 gets all that our environments tell."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from astray import games
from astray.envs.vector import GameVectorEnv


def test_the_adapter_passes_everything_on():
    sb3 = pytest.importorskip("astray.envs.sb3")
    knobs = replace(games.find("maze").variant("corner-small"), time_limit=9, largest=3)
    made = [GameVectorEnv("maze", knobs, 8, autoreset_mode="SameStep") for _ in range(2)]
    env, adapter = made[0], sb3.GameVecEnv(made[1])
    adapter.seed(7)
    assert np.array_equal(env.reset(seed=7)[0], adapter.reset())
    seen = set()
    for actions in np.random.default_rng(0).integers(len(env.game.actions), size=(60, 8)):
        images, reward, terminated, truncated, info = env.step(actions)
        adapted, reward_adapted, done, infos = adapter.step(actions)
        assert np.array_equal(images, adapted) and np.array_equal(reward, reward_adapted)
        assert np.array_equal(done, terminated | truncated)
        for i, told in enumerate(infos):
            assert bool(told) == done[i]
            if told:
                assert np.array_equal(told["terminal_observation"], info["final_obs"][i])
                assert told["TimeLimit.truncated"] == (truncated[i] and not terminated[i])
                seen.add(told["TimeLimit.truncated"])
    assert seen == {False, True}


def test_the_adapter_renders_as_its_environment_does():
    sb3 = pytest.importorskip("astray.envs.sb3")
    how = {"autoreset_mode": "SameStep", "render_mode": "rgb_array"}
    adapter = sb3.GameVecEnv(GameVectorEnv("maze", "corner-small", 2, **how))
    adapter.reset()
    assert np.array_equal(adapter.get_images(), adapter.env.render())
    assert adapter.render().shape == (1024, 512, 3)  # one below the other, for VecVideoRecorder


def test_the_adapter_refuses_other_resets():
    sb3 = pytest.importorskip("astray.envs.sb3")
    with pytest.raises(ValueError, match="needs SAME_STEP"):
        sb3.GameVecEnv(GameVectorEnv("maze", "corner-small", 2))


def test_without_the_library_the_error_says_what_to_install():
    program = "import sys; sys.modules['stable_baselines3'] = None; import astray.envs.sb3"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    error = done.stderr.splitlines()[-1]
    assert 'astray.envs.sb3 needs stable_baselines3: pip install ".[sb3]" in a clone' in error
