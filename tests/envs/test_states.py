"""States of every game: kept, restored, cloned; what is none never reaches compiled code."""

import copy
import pickle
import zipfile
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from astray import games, memory
from astray.envs import beginnings
from astray.envs import states as states_in_files
from astray.envs.states import load_states, save_states
from astray.envs.vector import GameVectorEnv
from astray.insight.activations import load_activations
from helpers.cases import FEW, FIRST, FIRST_OF_ALL, SHAPES
from helpers.thorough import thorough

MODES = list(AutoresetMode)
WAYS = list(product(MODES, ["image", "symbolic"]))
# Every way in a game with rules of its own and in a grid world, and one for each other in turn.
RESTORED = [
    (*shape, *way)
    for k, shape in enumerate(FIRST)
    for way in (WAYS if shape[0] in ("coinrun", "lavaland") else [WAYS[k % len(WAYS)]])
]
OTHERS = [shape for shape in SHAPES if shape not in FIRST]
RESTORED += thorough(*((*shape, *WAYS[k % len(WAYS)]) for k, shape in enumerate(OTHERS)))


def played(game, variant, mode="SameStep", steps=20, n=4, **options):
    """An environment some steps on, with episodes so short that some have ended."""
    mode = AutoresetMode(mode)
    kind = replace(games.find(game).variants[variant], time_limit=15)
    env = GameVectorEnv(game, kind, n, autoreset_mode=mode, **options)
    env.reset(seed=2)  # in every game, time alone ends some of these episodes
    rng = np.random.default_rng(0)
    for _ in range(steps):
        ended = env.states.ended.copy()
        if mode is AutoresetMode.DISABLED and ended.any():
            env.reset(options={"reset_mask": ended})
        env.step(rng.integers(len(env.game.actions), size=n))
    return env


@pytest.mark.parametrize("game, variant, mode, observation", RESTORED)
def test_a_restored_state_plays_on_byte_for_byte(game, variant, mode, observation, tmp_path):
    # Every episode that time alone ends has just ended: so it must have, once restored.
    steps = 31 if mode is AutoresetMode.NEXT_STEP else 30
    one = played(game, variant, mode, steps, observation=observation)
    assert one.states.ended.any() == (mode is not AutoresetMode.SAME_STEP)
    save_states(tmp_path / "states.npz", game, one.get_state())
    states = load_states(tmp_path / "states.npz", game)
    assert states.tobytes() == one.get_state().tobytes()
    two = GameVectorEnv(game, one.variant, 4, autoreset_mode=mode, observation=observation)
    seen = two.set_state(states)
    assert seen in two.observation_space
    if mode is AutoresetMode.DISABLED:
        for env in (one, two):
            with pytest.raises(RuntimeError, match="an episode has ended"):
                env.step(np.zeros(4, int))
            env.reset()
    for actions in np.random.default_rng(1).integers(len(one.game.actions), size=(14, 4)):
        assert data_equivalence(one.step(actions), two.step(actions))
        if mode is AutoresetMode.DISABLED:
            for env in (one, two):
                env.reset(options={"reset_mask": env.states.ended.copy()})
    assert one.states.tobytes() == two.states.tobytes()


def test_a_batch_s_space_takes_time_only_where_it_is_looked_at():
    env = pickle.loads(pickle.dumps(played("maze", "corner")))
    assert "observation_space" not in vars(env)
    assert env.observation_space == batch_space(env.single_observation_space, 4)
    assert copy.deepcopy(env).observation_space == env.observation_space


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copied_environment_goes_on_alone(copied, mode, threads):
    one = played("maze", "anywhere", mode, threads=threads)
    states, two = one.get_state(), copied(one)
    plays = np.random.default_rng(1).integers(15, size=(40, 4))  # in which episodes end
    ours = [one.step(actions) for actions in plays]
    assert two.get_state().tobytes() == states.tobytes()
    one.close()
    theirs = [two.step(actions) for actions in plays]
    assert all(data_equivalence(a, b) for a, b in zip(ours, theirs, strict=True))
    two.close()


@pytest.mark.parametrize("game, variant", FIRST_OF_ALL)
def test_one_state_is_cloned_into_many_environments(game, variant):
    env = played(game, variant)
    many = GameVectorEnv(game, env.variant, 32, autoreset_mode="SameStep")
    seen = many.set_state(env.get_state()[2])
    assert all(s.tobytes() == env.states[2].tobytes() for s in many.states)
    assert (seen == seen[0]).all()


def test_a_reset_to_a_state_leaves_the_levels_to_come_alone():
    one, two = (GameVectorEnv("maze", "anywhere", 3, autoreset_mode="Disabled") for _ in range(2))
    other = GameVectorEnv("maze", "anywhere", 3, autoreset_mode="Disabled")
    other.reset(seed=99, options={"level": 12345})
    for env in (one, two):
        env.reset(seed=1)
    mask = np.array([True, False, True])
    two.reset(options={"state": other.get_state(), "reset_mask": mask})
    assert two.states["level"][mask].tolist() == [12345] * 2
    assert two.states[1].tobytes() == one.states[1].tobytes()
    assert np.array_equal(one.reset()[1]["level"], two.reset()[1]["level"])


@pytest.mark.parametrize("game, variant", FEW)
def test_what_is_no_state_is_refused(game, variant, tmp_path):
    env = played(game, variant)
    states, path = env.get_state(), tmp_path / "states.npz"
    with pytest.raises(ValueError, match=r"must be \[N\] records of .* of shape \(2, 4\)"):
        save_states(path, game, np.stack([states, states]))
    for wrong in (states[:2], states.view(np.uint8), np.zeros(4), None, "states"):
        with pytest.raises(ValueError, match="or one; got"):
            env.set_state(wrong)
    for field, value in (
        ("time", -1),
        ("time", 16),
        ("time_limit", 0),
        ("turn", -1),
        ("level", -2),
        ("level", 2**31 - 1),
        ("mt_next", 624),
    ):
        bad = states.copy()
        bad[field][1] = value
        with pytest.raises(ValueError, match="state 1 is invalid for this variant"):
            env.set_state(bad)
    for event in env.game.events:
        bad = states.copy()
        bad[event][3] = bad["time"][3] + 1
        with pytest.raises(
            ValueError, match=f"state 3 is invalid for this variant: its {event} cannot be"
        ):
            env.set_state(bad)
    ended = states.copy()
    ended["ended"][0] = True
    with pytest.raises(ValueError, match="the episode of state 0 has ended"):
        env.set_state(ended)
    assert env.get_state().tobytes() == states.tobytes()  # refused before anything was touched
    with pytest.raises(ValueError, match=r"states must be \[N\] records of"):
        save_states(path, game, np.zeros(3))


@pytest.mark.parametrize("game", games.OWN)
def test_a_bad_file_of_states_is_explained(game, tmp_path):
    env = played(game, next(iter(games.find(game).variants)))
    path, good = tmp_path / "bad.npz", tmp_path / "good.npz"
    save_states(good, game, env.get_state())
    with pytest.raises(FileNotFoundError, match="there are no states at"):
        load_states(path, game)
    plain = env.get_state().view(np.dtype(env.game.state.descr))
    for kept, message in (
        ({"game": "chess", "format": 1, "states": plain}, "states of chess, not of"),
        ({"game": game, "format": 2, "states": plain}, "has format 2; this version reads 1"),
        ({"game": game, "format": 1, "states": np.zeros(3)}, "with other fields"),
        ({"game": game, "format": 1, "states": plain[None]}, "with other fields"),
        ({"game": game, "format": 1}, "holds no states"),
        ({"game": game, "format": 1, "states": np.array([{}], object)}, "holds no states"),
    ):
        np.savez(path, **kept)
        with pytest.raises(ValueError, match=message):
            load_states(path, game)
    np.savez(path, game=game, format=1)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("states.npy", b"no array")
    with pytest.raises(ValueError, match="with other fields"):
        load_states(path, game)
    whole = good.read_bytes()
    for size in (*range(0, len(whole), 97), len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match="holds no states"):
            load_states(path, game)


def test_states_for_which_there_is_no_memory_say_why(tmp_path, monkeypatch):
    def short(path):
        raise MemoryError  # as Python's own has no message

    monkeypatch.setattr(states_in_files, "read", short)
    with pytest.raises(ValueError, match=r"holds no states: it cannot be read .too little memory."):
        load_states(tmp_path / "states.npz", "maze")


@pytest.mark.parametrize("error", [MemoryError(), ValueError("I/O operation on closed file.")])
def test_states_that_do_not_fit_into_memory_leave_the_file_as_it_was(error, tmp_path, monkeypatch):
    def short(*_, **__):
        raise error  # as NumPy does

    states = beginnings.initial_states("maze", "corner-small", [1])
    save_states(path := tmp_path / "states.npz", "maze", states)
    before = path.read_bytes()
    monkeypatch.setattr(np, "savez_compressed", short)
    with pytest.raises(MemoryError, match="too little memory to write 1 state"):
        save_states(path, "maze", states)
    assert path.read_bytes() == before


def test_a_header_that_promises_too_much_takes_no_memory(tmp_path):
    path = tmp_path / "bad.npz"
    header = "{'descr': '|u1', 'fortran_order': False, 'shape': (1099511627776,), }"
    header = header.ljust(118 - 1) + "\n"
    array = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    with zipfile.ZipFile(path, "w") as file:
        for name in ("game.npy", "format.npy", "states.npy"):
            file.writestr(name, array)
    with pytest.raises(ValueError, match="holds no states"):
        load_states(path, "maze")


def test_what_would_unpack_to_more_than_the_memory_is_refused_before(tmp_path, monkeypatch):
    path = tmp_path / "states.npz"
    np.savez_compressed(path, states=np.zeros(2**24, np.uint8))
    assert path.stat().st_size < 2**15
    monkeypatch.setattr(memory, "available", lambda: 2**23)
    with pytest.raises(ValueError, match=r"the arrays of .* need 0.0 GB of memory; there are"):
        load_states(path, "maze")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
@pytest.mark.parametrize("load", [lambda path: load_states(path, "maze"), load_activations])
def test_arrays_that_unpack_whatever_is_read_of_them_are_refused(load, method, tmp_path):
    with zipfile.ZipFile(path := tmp_path / "a.npz", "w", method) as file:
        file.writestr("x" * 60_000, bytes(2**20))
    with pytest.raises(ValueError, match=rf"x... is compressed by method {method}; files") as told:
        load(path)
    assert len(str(told.value)) < 500


@pytest.mark.parametrize("game, variant", FEW)
def test_every_state_that_is_played_passes_the_check(game, variant):
    for mode in MODES:
        env = played(game, variant, mode, n=32, steps=40, observation="symbolic")
        env.game.check(env.get_state(), env.variant)


def test_states_are_shown_otherwise_as_they_are_at_the_time():
    env, first = played("coinrun", "coin-anywhere"), played("coinrun", "coin-anywhere", steps=5)
    other = GameVectorEnv("coinrun", "coin-anywhere", 4, observation="symbolic")
    symbols, images = env.shown_as("symbolic", "own"), env.shown_as("image", "own")
    for states in (env.get_state(), first.get_state()):
        seen = env.set_state(states)
        assert np.array_equal(images(), seen)
        assert np.array_equal(symbols(), other.set_state(states))


def test_an_environment_that_repeats_begins_in_its_own_state_again_and_again():
    env = GameVectorEnv(
        "maze", "anywhere-small", 6, observation="symbolic", autoreset_mode="SameStep", threads=2
    )
    seen, _ = env.reset(seed=0)
    begun = env.get_state()
    env.repeat(begun)
    ended, random = 0, np.random.default_rng(0)
    for _ in range(150):
        now, _, terminated, truncated, info = env.step(random.integers(9, size=6))
        for i in np.flatnonzero(terminated | truncated):
            ended += 1
            assert env.states[i].tobytes() == begun[i].tobytes()
            assert np.array_equal(now[i], seen[i]) and info["level"][i] == begun["level"][i]
    assert ended > 6
    env.repeat(None)
    env.step(np.zeros(6, int))
    levels = {int(env.reset(options={"reset_mask": np.ones(6, bool)})[1]["level"][0])}
    assert levels != {int(begun["level"][0])}
    with pytest.raises(ValueError, match="must be 6, one for each environment; got \\(2,\\)"):
        env.repeat(begun[:2])
