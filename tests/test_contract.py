"""What every game owes its callers. A new game is tested here without being named."""

import os
import subprocess
import sys
from itertools import product

import gymnasium
import numba
import numpy as np
import pytest
from conftest import ALL, FEW
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from astray import games
from astray.envs.compiled import compiled
from astray.envs.single import GameEnv
from astray.envs.vector import GameVectorEnv

MODES = list(AutoresetMode)


def short(game, variant):
    """The variant with episodes of 30 steps, so that some end."""
    from dataclasses import replace

    return replace(games.load(game).variants[variant], time_limit=30)


@pytest.mark.parametrize("observation", ["image", "symbolic"])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("game, variant", FEW)
def test_a_batch_is_its_environments_one_by_one(game, variant, mode, observation):
    options = {"variant": short(game, variant), "observation": observation}
    batch = GameVectorEnv(game, num_envs=3, autoreset_mode=mode, **options)
    single = SyncVectorEnv([lambda: GameEnv(game, **options)] * 3, autoreset_mode=mode)
    assert data_equivalence(batch.reset(seed=5), single.reset(seed=5))
    batch.action_space.seed(1)
    ended = 0
    for _ in range(70):
        actions = batch.action_space.sample()
        ours, theirs = batch.step(actions), single.step(actions)
        assert data_equivalence(ours, theirs)
        done = ours[2] | ours[3]
        ended += done.sum()
        if mode is AutoresetMode.DISABLED and done.any():
            ours = batch.reset(options={"reset_mask": done})
            theirs = single.reset(options={"reset_mask": done.copy()})
            assert data_equivalence(ours, theirs)
    assert ended > 0


@pytest.mark.parametrize("game, variant", FEW)
def test_gymnasium_accepts_it(game, variant):
    env = gymnasium.make(f"astray/{game}-{variant}-v0", render_mode="rgb_array")
    check_env(env.unwrapped)


@pytest.mark.parametrize("game, variant", ALL)
def test_registered_ids_make_vectors(game, variant):
    env = gymnasium.make_vec(f"astray/{game}-{variant}-v0", num_envs=2, observation="symbolic")
    assert isinstance(env, GameVectorEnv)
    assert env.reset(seed=0)[0] in env.observation_space


@pytest.mark.parametrize("game, variant", ALL)
def test_same_seed_same_game(game, variant):
    runs = []
    for threads in (1, 2):
        env = GameVectorEnv(game, variant, 5, threads=threads, autoreset_mode="SameStep")
        env.reset(seed=3)
        env.action_space.seed(3)
        for _ in range(50):
            last = env.step(env.action_space.sample())[0]
        runs.append(env.states.tobytes() + last.tobytes())
        env.close()
    assert runs[0] == runs[1]


@pytest.mark.parametrize("game, variant", ALL)
def test_a_level_is_a_function_of_its_number_alone(game, variant):
    env = GameVectorEnv(game, variant, 3, autoreset_mode="Disabled")
    first, _ = env.reset(seed=1, options={"level": [7, 8, 9]})
    while not env.states["ended"].any() and env.states["time"][0] < 20:
        env.step(np.array([7, 5, 1]))
    again, info = env.reset(options={"level": [9, 8, 7]})
    assert np.array_equal(first, again[::-1])
    assert info["level"].tolist() == [9, 8, 7]


@pytest.mark.parametrize("game, variant", ALL)
def test_episodes_end_at_the_time_limit(game, variant):
    env = GameVectorEnv(game, short(game, variant), 1, autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": 5})
    stay = np.array([env.game.actions.index("stay")])
    ends = [env.step(stay)[2:4] for _ in range(30)]
    assert [bool(truncated[0]) for _, truncated in ends] == [False] * 29 + [True]
    assert not any(terminated[0] for terminated, _ in ends)


@pytest.mark.parametrize("game, variant", ALL)
def test_guides_get_what_the_solver_promises(game, variant):
    env = GameVectorEnv(game, variant, 1, observation="symbolic", autoreset_mode="Disabled")
    made = env.game
    rewarded = {shift.intended for shift in made.shifts.values()}
    for level, (goal, event) in product(range(5), made.goals.items()):
        env.reset(seed=0, options={"level": level})
        s = env.states[0]
        worth, soon = (made.optimal_return(s, goal, gamma) for gamma in (1.0, 0.9))
        guide, total, discounted = made.guide(s, goal), 0.0, 0.0
        while worth and s[event] < 0 and not s.ended:
            _, reward, *_ = env.step(np.array([guide(s)]))
            total += reward[0]
            discounted += reward[0] * 0.9 ** (int(s.time) - 1)
        if worth:  # or another goal was on the way and ended the level
            assert s.ended or guide(s) == made.actions.index("stay")
        if worth and goal in rewarded:
            assert total == pytest.approx(worth)
            assert discounted <= soon + 1e-9


def test_levels_of_a_list_are_each_walked_once():
    env = GameVectorEnv("maze", "corner", 2, levels=[4, 5, 6, 7], autoreset_mode="Disabled")
    seen = [env.reset(seed=0)[1]["level"].tolist()]
    seen.append(env.reset()[1]["level"].tolist())
    assert seen == [[4, 5], [6, 7]]


def test_levels_of_a_range_stay_in_it_and_fill_it():
    env = GameVectorEnv("maze", "corner-small", 50, levels=range(100, 120), observation="symbolic")
    seen = {n for _ in range(20) for n in env.reset()[1]["level"].tolist()}
    assert seen == set(range(100, 120))


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("game", games.NAMES)
def test_the_loop_is_compiled_once(game):
    for variant in games.load(game).variants:
        for observation in ("image", "symbolic"):
            env = GameVectorEnv(game, variant, 2, observation=observation)
            env.reset(seed=0)
            env.step(np.array([0, 0]))
            env.picture(100)
    assert len(compiled(game).signatures) == 1, compiled(game).signatures


PLAYED = """
import hashlib
import numpy as np
from astray import games
from astray.envs.vector import GameVectorEnv

digest, name = hashlib.sha256(), {game!r}
for observation in ("image", "symbolic"):
    options = {{"observation": observation, "autoreset_mode": "SameStep"}}
    env = GameVectorEnv(name, games.load(name).benchmark, 2, **options)
    digest.update(env.reset(seed=0)[0].tobytes())
    states = env.get_state()
    states["time"] = states["time_limit"] - [20, 30]
    env.set_state(states)
    for action in np.random.default_rng(0).integers(9, size=(40, 2)):
        seen, reward, *_ = env.step(action)
        digest.update(seen.tobytes() + reward.tobytes() + env.states.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.parametrize("game", games.NAMES)
def test_compiled_and_interpreted_agree(game):
    told = set()
    for disable in "01":
        environment = os.environ | {"NUMBA_DISABLE_JIT": disable}
        command = [sys.executable, "-c", PLAYED.format(game=game)]
        told.add(subprocess.check_output(command, env=environment, text=True))
    assert len(told) == 1


def test_a_masked_reset_leaves_the_others_and_the_options_alone():
    env = RecordEpisodeStatistics(GameVectorEnv("maze", "anywhere", 2, autoreset_mode="Disabled"))
    env.reset(seed=0)
    inner = env.unwrapped
    before = inner.states[1].copy()
    options = {"reset_mask": np.array([True, False])}
    inner.reset(options=options)
    assert options["reset_mask"].tolist() == [True, False]
    assert inner.states[1].tobytes() == before.tobytes()
    assert inner.states[0].turn == 2


def test_states_that_are_set_play_on_as_they_were():
    one = GameVectorEnv("maze", "anywhere", 3, autoreset_mode="SameStep")
    one.reset(seed=1)
    actions = np.random.default_rng(0).integers(15, size=(60, 3))
    for action in actions[:30]:
        seen = one.step(action)[0]
    two = GameVectorEnv("maze", "anywhere", 3, autoreset_mode="SameStep")
    assert np.array_equal(two.set_state(one.states.copy()), seen)
    for action in actions[30:]:
        assert data_equivalence(one.step(action), two.step(action))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"variant": "cornr"}, "unknown variant 'cornr' of maze; there are: corner"),
        ({"game": "mase"}, "unknown game 'mase'; there are: .*maze"),
        ({"num_envs": 0}, "num_envs must be an integer from 1 to .*; got 0"),
        ({"threads": 5000}, "threads must be an integer from 1 to .*; got 5000"),
        ({"levels": []}, "at least one"),
        ({"levels": [-1]}, "from 0 to"),
        ({"levels": range(5, 5)}, "at least one"),
        ({"observation": "text"}, "unknown observation 'text'"),
    ],
)
def test_bad_arguments_are_explained(options, message):
    with pytest.raises(ValueError, match=message):
        GameVectorEnv(**({"game": "maze", "variant": "corner"} | options))


def test_bad_steps_are_explained():
    env = GameVectorEnv("maze", "corner", 2, autoreset_mode="Disabled")
    with pytest.raises(RuntimeError, match="must be reset"):
        env.step(np.array([0, 0]))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions are integers"):
        env.step(np.array([0.5, 1]))
    with pytest.raises(ValueError, match="level is -2"):
        env.reset(options={"level": -2})
    with pytest.raises(ValueError, match="levels are integers"):
        env.reset(options={"level": 2.5})


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("wrong", [[1] * 29 + [15], [-1] + [1] * 29, [1] * 29, [1] * 31])
def test_a_wrong_action_changes_nothing(wrong, threads):
    env = GameVectorEnv("maze", "corner", 30, threads=threads)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ValueError, match="actions are 30 integers from 0 to 14"):
        env.step(np.array(wrong))
    assert (env.get_state() == before).all()
    env.step(np.full(30, 14))
    env.close()


def test_a_masked_reset_seeds_only_what_it_resets():
    env = GameVectorEnv("maze", "anywhere", 2, autoreset_mode="Disabled")
    with pytest.raises(ValueError, match="first reset is of all"):
        env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    env.reset(seed=0)
    env.reset(seed=7, options={"reset_mask": np.array([True, False])})
    assert env.states["seed"].tolist() == [7, 1]
    with pytest.raises(ValueError, match="2 booleans"):
        env.reset(options={"reset_mask": [0, 1]})


@pytest.mark.parametrize("mode", MODES)
def test_a_state_can_be_set_after_an_end(mode):
    env = GameVectorEnv("maze", short("maze", "anywhere"), 1, autoreset_mode=mode)
    env.reset(seed=0, options={"level": 5})
    kept = env.states.copy()
    for _ in range(30):
        env.step(np.array([4]))
    env.set_state(kept)
    env.step(np.array([4]))
    assert (env.states["level"], env.states["time"]) == (5, 1)


def test_closed_environments_say_so():
    env = GameVectorEnv("maze", "anywhere", 2, threads=2)
    env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.array([0, 0]))
