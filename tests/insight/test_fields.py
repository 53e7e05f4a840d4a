"""Fields of levels, beside what the environment and the policy say one state at a time."""

from dataclasses import replace

import numpy as np
import pytest

from astray import games, load_agent
from astray.acting import initial_states
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.runs import open_run
from astray.envs.pictures import picture
from astray.games.maze import solve
from astray.insight import field_figures
from astray.insight.actions import outcomes
from astray.insight.activations import layers
from astray.insight.fields import cell_of, difference, fields, places_of, splay
from astray.insight.interventions import steer
from astray.level import Level
from astray.training import folders
from helpers.looked_into import ROOM
from helpers.thorough import thorough

MAZE = games.find("maze")
SMALL = MAZE.variant("anywhere-small")


@pytest.fixture(scope="module")
def mouse():
    return load_agent(folders.find("maze-corner"))


@pytest.fixture(scope="module")
def level():
    return Level.from_text(MAZE, SMALL, ROOM)


@pytest.fixture(scope="module")
def field(mouse, level):
    return fields(mouse, SMALL, {"room": level})[0]


def test_a_level_is_splayed_as_levels_are(level):
    states, expected = splay(level), [one.state() for one in level.splay("agent")]
    assert len(states) == len(expected) == 31
    assert all(a == b for a, b in zip(states, expected, strict=True))


def test_policy_and_value_are_the_agents_in_each_state(mouse, level, field):
    for k, one in enumerate(level.splay("agent")):
        state = np.array([one.state()], MAZE.state)
        policy, value = policy_and_value(mouse, observe(mouse, SMALL, state))
        assert (policy[0] == field.policy[k]).all() and value[0] == field.value[k]
        assert tuple(field.cells[k]) == one.agent


def test_arrows_are_the_mean_of_where_actions_lead(level, field):
    moves = {"left-down": (-1, 0), "left": (-1, 0), "left-up": (-1, 0), "down": (0, -1),
             "up": (0, 1), "right-down": (1, 0), "right": (1, 0), "right-up": (1, 0)}  # fmt: skip
    for k, (x, y) in enumerate(field.cells.tolist()):
        mean = np.zeros(2)
        for action, chance in zip(MAZE.actions, field.policy[k], strict=True):
            dx, dy = moves.get(action, (0, 0))
            inside = 0 <= x + dx < 7 and 0 <= y + dy < 7
            if inside and level.cells[y + dy, x + dx] != MAZE.editing.LEGEND["#"]:
                mean += np.array([dx, dy]) * chance
        assert field.arrows[k] == pytest.approx(mean)


def test_a_step_towards_a_place_is_one_that_the_solver_has_nearer(level, field):
    away = np.pad(solve.steps_to(level.state(), "cheese"), 1, constant_values=99)
    groups = {(-1, 0): (0, 1, 2), (1, 0): (6, 7, 8), (0, 1): (5,), (0, -1): (3,)}
    for k, (x, y) in enumerate(field.cells.tolist()):
        chance = sum(
            field.policy[k, list(actions)].sum()
            for (dx, dy), actions in groups.items()
            if away[y + dy + 1, x + dx + 1] == away[y + 1, x + 1] - 1
        )
        assert field.towards((6, 6))[k] == pytest.approx(chance), (x, y)


def test_where_no_way_leads_to_a_place_no_step_is_one_towards_it(level):
    (around,), _ = places_of([level])
    towards = around.advancing((50, 50))  # outside of the level
    assert len(towards) == 31 and not towards.any()


def test_the_probability_of_a_path_is_the_geometric_mean_of_its_steps(level, field):
    policy = {tuple(c): p for c, p in zip(field.cells.tolist(), field.policy, strict=True)}
    right, up = list(range(6, 9)), [5]
    steps = [policy[x, 0][right].sum() for x in range(5)] + [policy[5, y][up].sum() for y in (0, 1)]
    found = field.path_probability()
    assert found[5, 2] == pytest.approx(np.prod(steps) ** (1 / 7))
    assert found[0, 0] == 1 and (6, 6) in found, "the cheese's cell too, which ends the level"
    assert field.path_probability((5, 2))[5, 2] == 1


def test_fields_of_numbers_are_those_of_drawn_levels(mouse):
    numbers = [200_001, 200_007]
    states = initial_states("maze", SMALL, numbers)
    drawn = {str(s.level): Level.of(MAZE, SMALL, s) for s in states}
    for one, other in zip(fields(mouse, SMALL, numbers), fields(mouse, SMALL, drawn), strict=True):
        assert (one.policy == other.policy).all() and (one.cells == other.cells).all()
        assert one.level.agent == other.level.agent


def test_a_difference_is_of_the_places_of_both(mouse, level, field):
    moved = fields(mouse, SMALL, {"moved": level.moved("goal", (0, 6))})[0]
    change = difference(field, moved)
    assert len(change.cells) == 30, "neither the old place of the cheese nor the new"
    for cell, value in zip(change.cells.tolist(), change.value, strict=True):
        a = field.value[field.cells.tolist().index(cell)]
        assert value == moved.value[moved.cells.tolist().index(cell)] - a
    assert (change.policy >= 0).all() and (change.policy <= 1).all() and change.policy.max() > 0.01
    same = difference(field, field)
    assert not same.value.any() and not same.policy.any() and not same.arrows.any()


def test_actions_that_do_the_same_are_no_difference(field):
    policy = field.policy.copy()
    policy[:, [0, 1, 2]] = field.policy[:, [1, 2, 0]]  # names of one move, to the left
    assert abs(policy - field.policy).max() > 1e-4
    other = replace(field, policy=policy)
    assert difference(field, other).policy == pytest.approx(0)
    policy[:, [0, 6]] = policy[:, [6, 0]]  # to the left for to the right
    assert difference(field, other).policy.max() > 0.01


def test_fields_feel_what_is_changed_in_the_agent(mouse, level, field):
    vector = np.random.default_rng(0).normal(size=layers(mouse)["features.relu1"])
    with steer(mouse, {"features.relu1": vector}, 2.0):
        steered = fields(mouse, SMALL, {"room": level})[0]
    assert difference(field, steered).policy.mean() > 0.01
    again = fields(mouse, SMALL, {"room": level})[0]
    assert (again.policy == field.policy).all()


def test_a_table_has_a_row_for_each_place(field):
    table = field.table()
    assert table.columns[:6] == ["x", "y", "dx", "dy", "value", "path"]
    assert table.select(MAZE.actions).sum_horizontal().to_numpy() == pytest.approx(1)
    assert len(table) == 31


def test_outcomes_are_those_of_the_rules(level):
    states = splay(level)[:1]
    after = outcomes("maze", SMALL, states)[0]
    assert after[MAZE.actions.index("right")].tolist() == [1.5, 0.5]
    assert after[MAZE.actions.index("down")].tolist() == [0.5, 0.5]


def test_goals_have_cells(level):
    assert cell_of(level, "cheese") == (6, 6)
    assert cell_of(level, "corner") == (6, 6)
    assert cell_of(level.removed("goal"), "cheese") is None
    with pytest.raises(ValueError, match="unknown goal 'coin'"):
        cell_of(level, "coin")


def test_pictures_show_as_many_arrows_as_places(mouse, level, field, tmp_path):
    moved = fields(mouse, SMALL, {"moved": level.moved("goal", (0, 6))})[0]
    figure = field_figures.draw({"one": field, "change": difference(field, moved)})
    quivers = [c for axes in figure.axes for c in axes.collections if hasattr(c, "U")]
    assert [len(q.U) for q in quivers] == [31, 30]
    field_figures.save(figure, tmp_path, "fields")
    assert (tmp_path / "fields.png").stat().st_size > 20_000
    assert (tmp_path / "fields.svg").read_text().startswith("<?xml")
    paths = field_figures.draw_paths({"paths": field})
    assert len(paths.axes) == 2


@pytest.mark.parametrize(
    "game", [*thorough("keys"), "coinrun"]
)  # most of it is compiling these games
def test_other_games_have_fields_too(game, tmp_path):
    name = {"keys": "many-chests", "coinrun": "coin-end"}[game]
    agent, config = open_run(folders.find(name))
    found = fields(agent, config.training_variant(), [3])[0]
    assert len(found.cells) > 10 and np.isfinite(found.value).all()
    assert (abs(found.arrows) <= 1.5).all() and abs(found.arrows).max() > 0.05
    figure = field_figures.draw({game: found})
    field_figures.save(figure, tmp_path, game)
    objects = found.level.game.editing.OBJECTS
    things = [cell for name in objects for cell in found.level.where(name)]
    shown = field_figures.heat_map(found.level, {found.level.agent: 1.0})  # of one cell
    assert things and {*shown.letters} == {*things} and shown.window is not None
    left, right, low, high = shown.window
    assert all(left <= x < right and low <= y < high for x, y in things)


def test_the_agent_is_drawn_above_colours_and_is_nowhere_else(level):
    x, y = level.agent
    other = next(cell for cell in level.splay("agent") if cell.agent != level.agent)
    shown = field_figures.heat_map(level, {level.agent: 1.0, other.agent: 0.0})
    rows, columns = np.nonzero(shown.front[..., 3])
    size = field_figures.PIXELS / np.array(level.cells.shape[::-1])
    left, bottom = size * (x, y)
    assert len(rows) > 0.2 * size.prod()  # a mouse fills a good part of its cell
    assert abs(columns - left - size[0] / 2).max() <= size[0] / 2 + 1
    assert abs(field_figures.PIXELS - rows - bottom - size[1] / 2).max() <= size[1] / 2 + 1
    seen = picture(MAZE, SMALL, np.array([level.state()]), field_figures.PIXELS)[0]
    assert (shown.front[rows, columns, :3] == seen[rows, columns]).all()
    veiled = 255 * field_figures.VEIL + (1 - field_figures.VEIL) * seen[rows, columns]
    floor = shown.image[rows, columns] != np.uint8(veiled)
    assert floor.any(-1).mean() > 0.95  # the floor below it has its own colours


def test_panels_of_flat_levels_lie_one_upon_the_other_and_show_the_same_cells():
    agent, config = open_run(folders.find("coin-end"))
    level = fields(agent, config.training_variant(), [3])[0].level
    near, far = ({(x, 2): 1.0} for x in (2, level.cells.shape[1] - 3))
    row = [field_figures.heat_map(level, cells) for cells in (near, far)]
    assert row[0].window != row[1].window
    drawn = field_figures.side_by_side(row)
    one, two = drawn.axes
    assert one.get_xlim() == two.get_xlim() == (row[0].window[0], row[1].window[1])
    assert one.get_subplotspec().colspan == two.get_subplotspec().colspan
    assert drawn.get_figwidth() > drawn.get_figheight() / 2
    sides = field_figures.side_by_side([replace(one, window=(0, 9, 0, 9)) for one in row]).axes
    assert sides[0].get_subplotspec().rowspan == sides[1].get_subplotspec().rowspan


def test_a_change_of_nothing_has_a_scale_that_says_so():
    agent, config = open_run(folders.find("maze-corner"))
    (one,) = fields(agent, config.training_variant(), [3])
    drawn = field_figures.draw({"change": difference(one, one)})
    assert (-0.01, 0.01) in [one.get_clim() for one in drawn.axes[0].images]
