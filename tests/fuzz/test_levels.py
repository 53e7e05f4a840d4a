"""Any drawing and any JSON is a level, or is refused with what is wrong."""

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from astray import games
from astray.level import Level
from helpers.anything import ANYTHING, GAMES, SMALLEST, beginning, tried, tries


@st.composite
def drawings(draw):
    """A drawing of a level with some characters changed, rows lost, or any text; and as it was."""
    game = draw(st.sampled_from(GAMES))
    made, kind = games.find(game), SMALLEST[game]
    level = beginning(game, draw(st.integers(0, 50)))
    whole = str(level)
    chars = "".join(made.editing.LEGEND) + "@?; \n"
    rows = str(level).split("\n")
    for _ in range(draw(st.integers(0, 4))):
        y = draw(st.integers(0, len(rows) - 1))
        x = draw(st.integers(0, max(len(rows[y]) - 1, 0)))
        rows[y] = rows[y][:x] + draw(st.sampled_from(chars)) + rows[y][x + 1 :]
    if draw(st.integers(0, 9)) == 0:
        rows.pop(draw(st.integers(0, len(rows) - 1)))
    if draw(st.integers(0, 9)) == 0:
        return made, kind, draw(st.text(chars, max_size=80)), whole
    return made, kind, "\n".join(rows), whole


@tries(75)
@given(drawings(), st.booleans())
def test_a_drawing_is_a_level_or_is_refused(drawn, solvable):
    made, kind, drawing, whole = drawn
    try:
        level = Level.from_text(made, kind, drawing)
        s = level.state(solvable=solvable)
    except ValueError as error:
        assert str(error) and (drawing != whole or solvable)
        tried("drawings", 1)
        return
    states = np.array([s], made.state)
    made.check(states, kind)
    again = Level.of(made, kind, s)
    height, width = level.cells.shape  # CoinRun puts smaller ones into its world
    assert np.array_equal(again.cells[:height, :width], level.cells)
    assert again.agent == level.agent
    if solvable:
        reachable = made.solver.reachable(s)
        assert all(reachable[y, x] for name in made.editing.OBJECTS for x, y in level.where(name))
    tried("drawings", 0)


@tries(75)
@given(st.data())
def test_json_is_a_level_or_is_refused(data):
    game = data.draw(st.sampled_from(GAMES))
    level = beginning(game, data.draw(st.integers(0, 50)))
    told = json.loads(json.dumps(level.to_json()))
    whole = told.copy()
    for _ in range(data.draw(st.integers(0, 3))):
        name = data.draw(st.sampled_from([*told, "more"]))
        value = data.draw(ANYTHING | st.sampled_from(list(told.values())))
        if name == "grid" and data.draw(st.booleans()):
            row = data.draw(st.integers(0, len(level.cells) - 1))
            value = [list(map(int, r)) for r in level.cells]
            value[row][data.draw(st.integers(0, len(value[row]) - 1))] = data.draw(
                st.sampled_from(sorted(level.game.editing.LEGEND.values()))
            )
        if name == "looks" and data.draw(st.booleans()):
            looks = level.to_json()["looks"]  # a grid world may have none
            value = looks | {data.draw(st.sampled_from(list(looks) or ["more"])): value}
        told[name] = value
    if data.draw(st.integers(0, 9)) == 0:
        told = data.draw(ANYTHING)
    try:
        made = Level.from_json(level.game, level.variant, told)
        s = made.state(solvable=False)
    except ValueError:
        assert told != whole
        tried("levels as JSON", 1)
        return
    level.game.check(np.array([s], level.game.state), level.variant)
    for name, value in made.to_json().items():
        if name in told and name not in ("game", "looks"):
            assert value == told[name] or [value] == [told[name]]
    tried("levels as JSON", 0)
