"""Edits of states: one thing changes, and everything else stays."""

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import GAME, edits, measures
from astray.games.coinrun.rules import COIN, CRATE, SAW, TOP, WALL
from astray.games.coinrun.variants import VARIANTS
from astray.level import Level
from astray.record import NEVER

ANYWHERE = VARIANTS["coin-anywhere"]
EDITS = [*edits.PARTS.values(), edits.with_coin_in_view]


@pytest.fixture(scope="module")
def states():
    """After 25 steps to the right, in 100 levels."""
    env = GameVectorEnv("coinrun", ANYWHERE, 100, observation="symbolic")
    env.reset(seed=0, options={"level": np.arange(100)})
    for k in range(25):
        env.step(np.full(100, 8 if k % 5 == 0 else 7))
    return env.get_state()


@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: edit.__name__)
def test_an_edit_makes_other_states_that_can_be(states, edit):
    before = states.tobytes()
    edited = edit(states)
    assert states.tobytes() == before
    assert edited.dtype == states.dtype and edited.shape == states.shape
    assert (edited != states).mean() > 0.1
    GAME.check(edited, ANYWHERE)


@pytest.mark.parametrize(
    "edit, fields",
    [
        (edits.without_coin, {"cell", "coin_x", "coin_y"}),
        (edits.with_coin_in_view, {"cell", "coin_x", "coin_y"}),
        (edits.without_walkers, {"walkers"}),
        (edits.without_saws, {"thing"}),
        (edits.without_crates, {"thing"}),
        (edits.without_end_wall, {"cell"}),
        (edits.with_other_runner, {"runner_look"}),
        (edits.with_other_background, {"background"}),
    ],
)
def test_an_edit_changes_its_fields_alone(states, edit, fields):
    edited = edit(states)
    names = [name for name in states.dtype.names if not np.array_equal(states[name], edited[name])]
    assert set(names) == fields


def test_what_is_taken_away_is_gone(states):
    coinless = edits.without_coin(states)
    assert (states["cell"] == COIN).any((1, 2)).mean() > 0.9
    assert not (coinless["cell"] == COIN).any() and (coinless["coin_x"] == NEVER).all()
    assert not (edits.without_saws(states)["thing"] == SAW).any()
    assert not (edits.without_crates(states)["thing"] == CRATE).any()


def test_a_coin_in_view_lies_where_the_runner_could_stand(states):
    edited = edits.with_coin_in_view(states)
    added = (edited["cell"] == COIN) & (states["cell"] != COIN)
    assert set(added.sum((1, 2))) <= {0, 1} and added.sum() > 80
    for k, y, x in np.argwhere(added):
        s = states[k]
        assert s.cell[y - 1, x] in (WALL, TOP) or s.thing[y - 1, x] == CRATE
        assert abs(x + 0.5 - s.x) <= 6 and abs(y + 0.5 - s.y) <= 6
        assert abs(x + 0.5 - s.x) >= 1 or abs(y + 0.5 - s.y) >= 1.0787  # it does not touch it
        assert edited["coin_x"][k] == max(x, s.coin_x)
    assert measures.coin_in_view(edited[added.any((1, 2))]).all()


def test_where_a_coin_is_added_depends_on_seed_level_and_step_alone(states):
    edited = edits.with_coin_in_view(states)
    assert edits.with_coin_in_view(states[::-1].copy())[::-1].tobytes() == edited.tobytes()
    assert (edits.with_coin_in_view(states, seed=1) != edited).mean() > 0.5


@pytest.mark.parametrize("wall", ["####", "%%%."])
def test_without_its_end_wall_a_level_goes_on_as_sky(wall):
    drawing = f"""
        #.....{wall}
        #.....{wall}
        #@..o.{wall}
        ======{wall}
    """
    level = Level.from_text(GAME, VARIANTS["coin-end-permeable"], drawing)
    state = np.array([level.state()], GAME.state)
    cells = edits.without_end_wall(state)["cell"][0]
    assert not cells[1:4, 6:9].any() and np.array_equal(cells[0], state["cell"][0, 0])
    assert np.array_equal(cells[:, :6], state["cell"][0, :, :6])
    kept = cells[1:, 10:] == state["cell"][0, 1:, 10:]
    assert kept.all() if "%" in wall else not cells[1:, 10:].any()
