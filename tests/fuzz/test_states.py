"""Any state plays on, or is refused; any file of states is whole, or is refused."""

import os

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from astray import games
from astray.envs.states import load_states, save_states
from astray.envs.vector import GameVectorEnv
from helpers.anything import GAMES, SMALLEST, changed, tried, tries

BATCH = 100
RUINS = ("byte", "field", "extreme")


@tries(40)
@given(st.sampled_from(GAMES), st.integers(0, 2**32), st.sampled_from(RUINS))
def test_a_ruined_state_is_refused_or_plays_on(game, seed, ruin):
    rng = np.random.default_rng(seed)
    made = games.find(game)
    names = list(made.variants)
    kind = made.variants[names[int(rng.integers(len(names)))]]
    env = GameVectorEnv(game, kind, BATCH, autoreset_mode="SameStep", observation="symbolic")
    env.reset(seed=seed)
    for _ in range(int(rng.integers(20))):
        env.step(rng.integers(len(made.actions), size=BATCH))
    states = ruined(env.get_state(), rng, ruin)
    good = []
    for k in range(BATCH):
        try:
            made.check(states[k : k + 1], kind)
            good += [] if states["ended"][k] else [k]
        except ValueError as error:
            assert str(error)
    tried("states", BATCH - len(good), BATCH)
    if not good:
        return
    player = GameVectorEnv(
        game,
        kind,
        len(good),
        autoreset_mode="SameStep",
        observation=["image", "symbolic"][seed % 2],
    )
    seen = player.set_state(states[good])
    for _ in range(3):
        assert seen in player.observation_space
        made.check(player.states, kind)
        seen = player.step(rng.integers(len(made.actions), size=len(good)))[0]


def ruined(states, rng, how):
    """`states` with bytes or fields changed."""
    rows = states.view(np.uint8).reshape(len(states), -1)
    names = [name for name in states.dtype.names if name not in ("mt", "gap")]
    for k in range(len(states)):
        if how == "byte":
            for _ in range(int(rng.integers(1, 4))):
                rows[k, rng.integers(rows.shape[1])] = rng.integers(256)
            continue
        name = names[int(rng.integers(len(names)))]
        field = states[name][k : k + 1]
        if how == "extreme" and field.dtype.kind in "iuf":
            values = {
                "i": [-1, 0, 1, 2**62, -(2**62), 64, 2**31],
                "u": [0, 1, 9, 255],
                "f": [np.nan, np.inf, -np.inf, 0, -0.5, 1e300, 64.5],
            }
            with np.errstate(over="ignore"):
                field[...] = rng.choice(values[field.dtype.kind])
        else:
            other = states[name][int(rng.integers(len(states)))]
            field[...] = other
    return states


@tries(15)
@given(data=st.data())
def test_a_ruined_file_of_states_is_refused_or_whole(data, tmp_path_factory):
    game = data.draw(st.sampled_from(GAMES))
    path = tmp_path_factory.getbasetemp() / f"{os.getpid()}.npz"
    env = GameVectorEnv(game, SMALLEST[game], 2)
    env.reset(seed=0)
    saved = env.get_state()
    save_states(path, game, saved)
    before = path.read_bytes()
    path.write_bytes(changed(data, before))
    try:
        found = load_states(path, game)
    except ValueError:
        assert path.read_bytes() != before
        tried("files of states", 1)
        return
    assert found.dtype == saved.dtype and found.tobytes() == saved.tobytes()
    env.set_state(found)
    tried("files of states", 0)
