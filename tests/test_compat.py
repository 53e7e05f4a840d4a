"""Procgen's faces: what scripts that were written for it see.

CleanRL's own script runs where ASTRAY_CLEANRL is the path of its ppo_procgen.py, with gym 0.23.1.
"""

import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium import spaces

from astray import games
from astray.compat import EXPLORATION, ProcgenEnv, ProcgenGym3Env
from astray.envs.vector import GameVectorEnv
from helpers.drawn import environment
from helpers.processes import begin

SCRIPT = Path(__file__).parents[1] / "examples" / "procgen" / "ppo_procgen.py"
CLEANRL = os.environ.get("ASTRAY_CLEANRL", "")
THEIRS, OURS = "from procgen import ProcgenEnv", "from astray.compat import ProcgenEnv"
WORDS = ["--env-id", "maze", "--num-envs", "4", "--num-steps", "32", "--num-minibatches", "2",
         "--total-timesteps", "256"]  # fmt: skip


def face(n=4, name="maze", **options):
    options = {"distribution_mode": "easy", "art": "own", "rand_seed": 3} | options
    return ProcgenEnv(num_envs=n, env_name=name, **options)


def played(env, steps=120, seed=0):
    """Everything that random play returns, but images."""
    random = np.random.default_rng(seed)
    return [env.step(random.integers(0, 15, env.num_envs))[1:] for _ in range(steps)]


def test_what_is_returned_has_procgens_shapes_and_types():
    env = face()
    seen = env.reset()
    assert seen.keys() == {"rgb"} and seen["rgb"].shape == (4, 64, 64, 3)
    assert env.observation_space["rgb"].contains(seen["rgb"][0]) and env.action_space.n == 15
    seen, reward, done, infos = env.step(np.full(4, 7))
    assert (reward.dtype, done.dtype, len(infos)) == (np.float32, bool, 4)
    assert infos[0].keys() == {"prev_level_seed", "prev_level_complete", "level_seed"}


@pytest.mark.parametrize("name", ["pottery/corner", "boat/race"])
def test_a_game_with_goals_that_are_counts_has_levels_that_are_complete_or_not(name):
    env = ProcgenEnv(2, name, art="own", rand_seed=1)
    actions = [env.action_space.n - 1, -1]
    for _ in range(3):
        _, _, done, infos = env.step(np.array(actions))
        assert [info["prev_level_complete"] for info in infos] == [0, 0] and done[1]


def test_levels_come_in_the_order_of_a_mersenne_twister():
    # A generator of generators, each drawing a word modulo how many levels there are.
    first = np.random.RandomState(3)
    words = [np.random.RandomState(first.randint(2**32, dtype=np.uint32)) for _ in range(4)]
    wanted = [100 + int(r.randint(2**32, dtype=np.uint32)) % 7 for r in words]
    env = face(num_levels=7, start_level=100)
    assert [info["level_seed"] for info in env.gym3.get_info()] == wanted
    env.step(np.full(4, -1))
    told = env.gym3.get_info()
    assert [info["prev_level_seed"] for info in told] == wanted
    assert [info["level_seed"] for info in told] == [
        100 + int(r.randint(2**32, dtype=np.uint32)) % 7 for r in words
    ]


def test_an_episode_is_that_of_its_level():
    env = face(1, num_levels=1, start_level=77)
    plain = GameVectorEnv("maze", "anywhere-easy", 1, autoreset_mode="Disabled")
    images, _ = plain.reset(seed=0, options={"level": 77})
    assert np.array_equal(env.reset()["rgb"], images)
    done = False
    for action in np.random.default_rng(0).integers(0, 9, 600):
        images, reward, terminated, truncated, _ = plain.step(np.array([action]))
        seen, given, first, infos = env.step(np.array([action]))
        assert given[0] == reward[0] and first[0] == (terminated[0] or truncated[0])
        if first[0]:
            assert infos[0]["prev_level_complete"] == terminated[0]
            images, _ = plain.reset(options={"level": 77})
            done = True
        assert np.array_equal(seen["rgb"], images)
    assert done


def test_the_same_seed_repeats_everything_whatever_the_threads():
    one, two, other = (
        played(face(rand_seed=seed, num_threads=threads))
        for seed, threads in ((5, 0), (5, 2), (6, 1))
    )
    assert str(one) == str(two) != str(other)


def test_sequential_levels_go_on_after_one_that_was_completed():
    # Level 4 of maze, easy, is completed by an expert; then comes 4 + 997, and nothing was done.
    env = face(1, num_levels=1, start_level=4, use_sequential_levels=True)
    expert = env.gym3.env.game.solver.expert(env.gym3.env.states[0], "cheese")
    for _ in range(200):
        _, _, done, infos = env.step(np.array([expert(env.gym3.env.states[0])]))
        assert not done[0]
        if infos[0]["prev_level_complete"]:
            break
    assert infos[0]["prev_level_seed"] == 4 and infos[0]["level_seed"] == 4 + 997


def test_gym3s_face_shows_the_same():
    gym3 = ProcgenGym3Env(num=2, env_name="maze/corner-small", art="own", rand_seed=1)
    reward, seen, first = gym3.observe()
    assert first.all() and not reward.any() and seen["rgb"].shape == (2, 64, 64, 3)
    gym3.act(np.array([4, -1]))
    assert gym3.observe()[2].tolist() == [False, True]
    gym3.close()


def test_who_leaves_an_episode_does_nothing_in_it(monkeypatch):
    game = games.find("maze")
    stay = game.actions.index("stay")
    names = [f"other{k}" if k == stay else name for k, name in enumerate(game.actions)]
    monkeypatch.setattr(type(game), "actions", (*names[:-1], "stay"))
    gym3 = ProcgenGym3Env(num=1, env_name="maze/corner-small", art="own", rand_seed=1)
    taken, step = [], gym3.env.step
    monkeypatch.setattr(gym3.env, "step", lambda actions: taken.append(actions) or step(actions))
    gym3.act(np.array([-1]))
    assert taken[0].tolist() == [len(names) - 1]
    monkeypatch.setattr(type(game), "actions", tuple(names))
    with pytest.raises(ValueError, match="must have an action to stay"):
        ProcgenGym3Env(num=1, env_name="maze/corner-small", art="own")


def test_exploration_is_one_level():
    env = face(2, "coinrun", distribution_mode="exploration")
    assert {info["level_seed"] for info in env.gym3.get_info()} == {EXPLORATION["coinrun"]}


@pytest.mark.parametrize(
    "change, message",
    [
        ({"env_name": "starpilot"}, "starpilot easy of Procgen is not here; there are: coinrun"),
        ({"env_name": "coinrun", "distribution_mode": "memory"}, "coinrun memory of Procgen is"),
        ({"distribution_mode": "extreme"}, "unknown distribution_mode 'extreme'; there are: easy"),
        ({"restrict_themes": True}, "restrict_themes must be False"),
        ({"use_sequential_levels": "False"}, "use_sequential_levels must be a bool; got 'False'"),
        ({"center_agent": False}, "center_agent must be True"),
        ({"colour": 3}, "unknown option 'colour'; there are: distribution_mode"),
        ({"num_levels": -1}, "num_levels must be an integer from 0"),
        ({"rand_seed": 2**40}, "rand_seed must be an integer from 0"),
        ({"env_name": "maze/nowhere", "distribution_mode": "hard"}, "unknown variant 'nowhere'"),
        ({"env_name": "maze/corner"}, "is one difficulty"),
        ({"distribution_mode": "exploration", "num_levels": 3}, "give neither num_levels nor"),
    ],
)
def test_what_cannot_be_is_told(change, message):
    options = {"num_envs": 1, "env_name": "maze", "distribution_mode": "easy", "art": "own"}
    with pytest.raises(ValueError, match=re.escape(message)):
        ProcgenEnv(**options | change)


@pytest.mark.parametrize(
    "options, said",
    [
        ({"num_threads": "4"}, "num_threads must be an integer"),
        ({"num_threads": None}, "num_threads must be an integer"),
        (
            {"start_level": 2**31 - 10, "num_levels": 50},
            "num_levels must be an integer from 0 to 9",
        ),
        ({"name": None}, "env_name must be a str"),
    ],
)
def test_what_cannot_be_is_told_and_not_wrapped_around(options, said):
    with pytest.raises(ValueError, match=said):
        face(**options)


@pytest.mark.parametrize("actions", [[0.5] * 4, [float("nan")] * 4, None, [10**60] * 4, {0: 1}])
def test_actions_are_integers(actions):
    with pytest.raises(ValueError, match="actions must be"):
        face().step(actions)


def test_images_are_the_originals_where_its_pictures_are():
    plain = environment(GameVectorEnv("maze", "anywhere-easy").variant)  # skips where they are not
    images, _ = plain.reset(seed=0, options={"level": 9})
    shown = ProcgenEnv(1, "maze", distribution_mode="easy", num_levels=1, start_level=9).reset()
    assert np.array_equal(shown["rgb"], images)


def ran(text, folder):
    """What a script prints that trains for two iterations."""
    code, out, err = begin(text, folder, *WORDS).ended()
    assert code == 0, err
    return out


@pytest.mark.skipif(not SCRIPT.exists(), reason="the examples are not beside the tests")
def test_a_script_for_procgen_runs_with_one_changed_line(tmp_path):
    text = SCRIPT.read_text()
    lines = [line for line in text.splitlines() if "import" in line and "rocgen" in line]
    assert [line for line in lines if line.startswith("from")] == [f"{OURS}  # was: {THEIRS}"]
    # Our own pictures, as the original's may not be here; else it is run as it stands.
    drawn = text.replace("rand_seed=args.seed,", 'rand_seed=args.seed, art="own",')
    assert ran(drawn, tmp_path).splitlines()[-1].startswith("256 steps, return")


@pytest.mark.skipif(not CLEANRL, reason="set ASTRAY_CLEANRL to CleanRL's ppo_procgen.py")
@pytest.mark.skipif(not find_spec("gym"), reason="gym is not installed")
def test_cleanrls_script_runs_with_one_changed_line(tmp_path):
    environment(GameVectorEnv("maze", "anywhere-easy").variant)  # skips without the pictures
    text = Path(CLEANRL).read_text()
    assert text.count(THEIRS) == 1
    assert ran(text.replace(THEIRS, OURS), tmp_path).count("SPS:") == 2
    assert list(tmp_path.glob("runs/maze__*/events*"))


def test_spaces_are_old_gyms_where_a_script_has_imported_that(monkeypatch):
    names = ("Box", "Dict", "Discrete")
    old = SimpleNamespace(**{name: type(name, (getattr(spaces, name),), {}) for name in names})
    monkeypatch.delitem(sys.modules, "gym.spaces", raising=False)
    assert type(face().action_space) is spaces.Discrete
    monkeypatch.setitem(sys.modules, "gym.spaces", old)
    env = face()
    assert type(env.action_space) is old.Discrete and env.action_space.n == 15
    assert type(env.observation_space) is old.Dict
    assert type(env.observation_space["rgb"]) is old.Box
    assert env.observation_space["rgb"].contains(env.reset()["rgb"][0])
