"""What every game owes its callers. A new game is tested here without being named."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from astray import games, testing
from astray.envs.single import GameEnv
from astray.envs.vector import GameVectorEnv
from helpers.cases import FIRST_OF_ALL, SHAPES

MODES = list(AutoresetMode)
OF_SHAPES = (
    testing.check_indices,
    testing.check_batches,
    testing.check_gymnasium,
    testing.check_compiled_once,
)  # slow


@pytest.mark.parametrize("game, variant", FIRST_OF_ALL)
def test_a_game_is_what_it_is_taken_for(game, variant):
    for check in testing.CHECKS:
        if check not in OF_SHAPES or (game, variant) in SHAPES:
            check(games.find(game), games.find(game).variant(variant))


@pytest.mark.parametrize("game", games.OWN)
def test_its_parts_lead_to_what_there_is(game):
    testing.check_parts(games.find(game))


@pytest.mark.parametrize("game", games.OWN)
def test_registered_ids_make_environments(game):
    for name, variant in games.find(game).variants.items():
        one = gymnasium.make(f"astray/{game}-{name}-v0").unwrapped
        assert isinstance(one, GameEnv) and one.vector.variant == variant
        env = gymnasium.make_vec(f"astray/{game}-{name}-v0", num_envs=2, observation="symbolic")
        assert isinstance(env, GameVectorEnv) and env.variant == variant
        assert env.reset(seed=0)[0] in env.observation_space


@pytest.mark.parametrize("name", ["astray/maze-corner-v0", "astray/lavaland-lava-v0"])
def test_what_is_rendered_passes_gymnasiums_checker_too(name):
    check_env(gymnasium.make(name, render_mode="rgb_array").unwrapped)


def test_levels_of_a_list_are_each_walked_once():
    env = GameVectorEnv("maze", "corner", 2, levels=[4, 5, 6, 7], autoreset_mode="Disabled")
    seen = [env.reset(seed=0)[1]["level"].tolist()]
    seen.append(env.reset()[1]["level"].tolist())
    assert seen == [[4, 5], [6, 7]]


def test_levels_of_a_range_stay_in_it_and_fill_it():
    env = GameVectorEnv("maze", "corner-small", 50, levels=range(100, 120), observation="symbolic")
    seen = {n for _ in range(20) for n in env.reset()[1]["level"].tolist()}
    assert seen == set(range(100, 120))


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
        ({"levels": range(0, 9, 2)}, r"has step 1; walk list\(range\(0, 9, 2\)\) instead"),
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
    with pytest.raises(ValueError, match="actions must be"):
        env.step(np.array([0.5, 1]))
    with pytest.raises(ValueError, match=r"levels must be numbers from 0 to .*; got -2"):
        env.reset(options={"level": -2})
    with pytest.raises(ValueError, match="levels must be integers"):
        env.reset(options={"level": 2.5})


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("wrong", [[1] * 29 + [15], [-1] + [1] * 29, [1] * 29, [1] * 31])
def test_a_wrong_action_changes_nothing(wrong, threads):
    env = GameVectorEnv("maze", "corner", 30, threads=threads)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ValueError, match="actions must be 30 integers from 0 to 14"):
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
    variant = replace(games.find("maze").variants["anywhere"], time_limit=30)
    env = GameVectorEnv("maze", variant, 1, autoreset_mode=mode)
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


def test_a_knob_that_was_given_as_an_integer_can_be_a_fraction_again():
    variant = replace(games.find("keys").variant("many-chests"), key_penalty=1)
    assert variant.with_knobs({"key_penalty": 0.3}).key_penalty == 0.3
    assert variant.with_knobs({"key_penalty": "0.5"}).key_penalty == 0.5
