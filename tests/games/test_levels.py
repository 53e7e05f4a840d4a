"""Levels as data, of every game: written, read back, edited, refused."""

import json

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.level import AGENT, Level
from astray.level_files import read_levels
from astray.record import NEVER
from helpers.cases import FEW, FIRST_OF_ALL


def begun(game, variant, numbers):
    """An environment that has just begun the levels of these numbers."""
    env = GameVectorEnv(game, variant, len(numbers), autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": numbers})
    return env


def one(game, variant, number=3):
    env = begun(game, variant, [number])
    return Level.of(env.game, env.variant, env.states[0])


@pytest.fixture(scope="module")
def first_levels():
    """A level of each game."""
    return [one(game, next(iter(games.find(game).variants))) for game in games.OWN]


@pytest.mark.parametrize("game, variant", FEW)
def test_a_level_from_json_plays_on_as_the_one_it_was_written_from(game, variant):
    theirs = begun(game, variant, list(range(3)))
    data = [Level.of(theirs.game, theirs.variant, s).to_json() for s in theirs.states]
    levels = [Level.from_json(theirs.game, theirs.variant, json.loads(json.dumps(d))) for d in data]
    ours = begun(game, variant, [100] * 3)
    states = np.array([level.state(solvable=False) for level in levels], theirs.game.state)
    ours.reset(options={"state": states})
    assert np.array_equal(ours.picture(64), theirs.picture(64))
    actions = np.random.default_rng(0).integers(len(theirs.game.actions), size=(60, 3))
    for action in actions:
        one, two = ours.step(action), theirs.step(action)
        assert data_equivalence(one[:4], two[:4])
        ours.reset(options={"level": 5, "reset_mask": one[2] | one[3]})
        theirs.reset(options={"level": 5, "reset_mask": one[2] | one[3]})


@pytest.mark.parametrize("game, variant", FEW)
def test_drawings_are_read_back(game, variant):
    env = begun(game, variant, list(range(4)))
    for s in env.states:
        level = Level.of(env.game, env.variant, s)
        again = Level.from_text(env.game, env.variant, str(level))
        assert np.array_equal(again.cells, level.cells) and again.agent == level.agent
        told, theirs = level.to_json(), again.to_json()
        assert {n for n in told if told[n] != theirs[n]} <= {"looks"}


@pytest.mark.parametrize(
    "game, variant, beneath",
    [
        ("maze", "dish-apart-small", "o"),
        ("keys", "many-chests-small", "C"),
        ("coinrun", "coin-twice", "c"),
        ("coinrun", "coin-end-permeable", "%"),
    ],
)
def test_an_agent_that_stands_on_something_amid_an_episode_does_so_in_its_level(
    game, variant, beneath
):
    env = GameVectorEnv(game, variant, 64, observation="symbolic", autoreset_mode="SameStep")
    env.reset(seed=0)
    random, legend, found = np.random.default_rng(0), env.game.editing.LEGEND, 0
    for _ in range(60):
        env.step(random.choice([0, 1, 2, 3, 5, 6, 7, 8, 8, 8, 7], env.num_envs))
        for s in env.states:
            x, y = (int(v) for v in env.game.editing.centre(s))
            if env.game.editing.grid(s)[y, x] != legend[beneath] or found > 20:
                continue
            level = Level.of(env.game, env.variant, s)
            again = Level.from_text(env.game, env.variant, str(level))
            assert np.array_equal(again.cells, level.cells) and again.agent == level.agent == (x, y)
            assert str(level).endswith(f"@ on {beneath}")
            told = Level.from_json(env.game, env.variant, json.loads(json.dumps(level.to_json())))
            assert told.to_json() == level.to_json()
            assert level.cells[y, x] == env.game.editing.grid(level.state())[y, x]
            found += 1
    assert found > 5


def test_a_level_of_a_dead_runner_is_refused():
    env = begun("coinrun", "coin-end", [0])
    s = env.states[0]
    state = env.get_state()
    state["cell"][0, int(s.y), int(s.x)] = env.game.editing.LEGEND["~"]
    with pytest.raises(ValueError, match=r"cell \(1, 1\) holds '~'"):
        Level.of(env.game, env.variant, state[0])


def test_no_agent_begins_on_what_it_was_to_get():
    level = one("maze", "anywhere-small")
    (goal,) = level.where("goal")
    with pytest.raises(ValueError, match="holds 'G'"):
        Level(level.game, level.variant, level.cells, goal, {}).state()
    with pytest.raises(ValueError, match=r"the agent is on 'x'; there are: # \. G o O"):
        Level.from_text(level.game, level.variant, f"{level}\n@ on x")


@pytest.mark.parametrize("game, variant", FIRST_OF_ALL)
def test_a_level_that_is_given_as_data_has_no_number(game, variant):
    level = one(game, variant)
    env = GameVectorEnv(game, variant, 2)
    _, info = env.reset(seed=0, options={"level": level})
    assert info["level"].tolist() == [NEVER, NEVER] and level.state()["level"] == NEVER


@pytest.mark.parametrize("game, variant", FIRST_OF_ALL)
def test_objects_are_moved_removed_and_added(game, variant):
    level = one(game, variant)
    for name in level.game.editing.OBJECTS:
        for cell in level.where(name)[:3]:
            gone = level.removed(name, cell)
            assert cell not in gone.where(name)
            assert sorted(gone.added(name, cell).where(name)) == sorted(level.where(name))
            there = next(c for c in free(level) if c != cell)
            moved = level.moved(name, there, at=cell)
            assert there in moved.where(name) and cell not in moved.where(name)
            assert np.array_equal(level.cells, one(game, variant).cells)  # the old one is as it was
            with pytest.raises(ValueError, match="holds"):
                level.added(name, cell)
        with pytest.raises(ValueError, match=f"which {name}"):
            level.removed(name, (0, 0) if (0, 0) not in level.where(name) else (1, 0))
    with pytest.raises(ValueError, match="unknown object 'squid'; there are: agent"):
        level.where("squid")
    for edit in (level.removed, lambda name: level.added(name, (1, 1))):
        with pytest.raises(ValueError, match="unknown object 'agent'; there are: "):
            edit("agent")
    with pytest.raises(ValueError, match="outside"):
        level.moved("agent", (-1, 3))


SMALL = """.........
.........
@.......o
=========
"""


def free(level):
    """Empty cells that the agent can reach."""
    return [other.agent for other in level.splay("agent") if other.agent != level.agent]


@pytest.mark.parametrize("game, variant", FIRST_OF_ALL)
def test_a_level_is_splayed_over_all_places_of_an_object(game, variant):
    level = one(game, variant)
    agents = level.splay("agent")
    assert level.agent in [other.agent for other in agents]
    assert len({other.agent for other in agents}) == len(agents) > 3
    for name in level.game.editing.OBJECTS:
        where = level.where(name)
        if not where:
            continue
        family = level.splay(name, where[0])
        places = [set(other.where(name)) - set(where[1:]) for other in family]
        assert all(len(place) == 1 for place in places)
        assert set(where[:1]) in places and len(family) == len(set(map(tuple, places)))
        assert all(np.count_nonzero(other.cells != level.cells) <= 2 for other in family)
        for other in family[:5]:  # each can be played, and the object reached
            (x, y) = next(iter(set(other.where(name)) - set(where[1:])))
            assert level.game.solver.reachable(other.state(solvable=False))[y, x]


def test_the_agent_is_where_it_is():
    level = Level.from_text(games.find("coinrun"), games.find("coinrun").variant("coin-end"), SMALL)
    assert level.where("agent") == [(0, 1)] and level.where("coin") == [(8, 1)]


def test_a_small_drawing_of_coinrun_is_splayed():
    coinrun = games.find("coinrun")
    level = Level.from_text(coinrun, coinrun.variant("coin-end"), SMALL)
    assert {other.agent for other in level.splay("agent")} >= {(0, 1), (1, 1), (7, 1)}


@pytest.mark.parametrize("game", games.OWN)
def test_files_and_folders_of_levels_are_read(game, tmp_path):
    variant = next(iter(games.find(game).variants))
    level = one(game, variant)
    made, kind = level.game, level.variant
    (tmp_path / "b.txt").write_text(f"; a comment\n{level}\n\n; another\n\n{level}\n")
    (tmp_path / "a.json").write_text(json.dumps(level.to_json(), indent=2))
    (tmp_path / "c.jsonl").write_text(f"{json.dumps(level.to_json())}\n" * 2)
    found = read_levels(str(tmp_path), made, kind)
    assert list(found) == ["a.json", "b.txt:1", "b.txt:2", "c.jsonl:1", "c.jsonl:2"]
    assert all(np.array_equal(other.cells, level.cells) for other in found.values())
    (tmp_path / "d.txt").write_text(str(level).replace(AGENT, "?"))
    with pytest.raises(ValueError, match=r"d\.txt: unknown '\?' at cell"):
        read_levels(tmp_path, made, kind)
    with pytest.raises(FileNotFoundError, match="there is no level at"):
        read_levels(tmp_path / "nothing.txt", made, kind)
    (tmp_path / "d.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"d\.txt"):
        read_levels(tmp_path, made, kind)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="there are no levels in"):
        read_levels(tmp_path / "empty", made, kind)
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"deep\.json"):
        read_levels(tmp_path / "deep.json", made, kind)


def test_a_file_of_many_values_is_not_copied_for_each(tmp_path, monkeypatch):
    maze, path, seen = games.find("maze"), tmp_path / "many.jsonl", set()
    decode = json.JSONDecoder.raw_decode
    monkeypatch.setattr(
        json.JSONDecoder,
        "raw_decode",
        lambda self, s, *at: (seen.add(len(s)), decode(self, s, *at))[1],
    )
    path.write_text("1 " * 50)
    with pytest.raises(ValueError, match="a level must be an object"):
        read_levels(path, maze, maze.variant("corner"))
    assert seen == {99}


@pytest.mark.parametrize(
    "change, message",
    [
        ({"game": "chess"}, "the level is one of 'chess'"),
        ({"grid": []}, "equally long lists of codes"),
        ({"grid": [[0, 0], [0]]}, "equally long lists of codes"),
        ({"grid": [[[]]]}, r"unknown code \[\] at cell \(0, 0\)"),
        ({"grid": [[0, 250]]}, r"unknown code 250 at cell \(1, 0\)"),
        ({"agent": [1, "2"]}, "the agent must be at two numbers"),
        ({"agent": [500.5, 1.5]}, "outside of the level"),
        ({"agent": [10**30, 1.5]}, "the agent must be at two numbers"),
        ({"agent": [float("nan"), 1.5]}, "the agent must be at two numbers"),
        ({"looks": 3}, "looks must be a Mapping"),
        ({"looks": {"hat": 3}}, "unknown field 'hat'"),
        ({"goal_of_life": 42}, "unknown field 'goal_of_life'"),
    ],
)
def test_bad_data_is_explained(change, message, first_levels):
    for level in first_levels:
        with pytest.raises(ValueError, match=message):
            Level.from_json(level.game, level.variant, level.to_json() | change)


def test_a_level_that_is_far_too_large_is_refused_before_its_cells_are_read():
    maze, side = games.find("maze"), 1025
    for read, given in (
        (Level.from_text, ("?" * side + "\n") * side),  # a row with a mistake, which would be told
        (Level.from_json, {"grid": [["?"] * side] * side, "agent": [0.5, 0.5]}),
    ):
        with pytest.raises(ValueError, match=r"an integer from \d to 1048576; got 105\d"):
            read(maze, maze.variant("anywhere"), given)


@pytest.mark.parametrize("look", [[[1, 1, {}]], {"a": [[]]}, [[10**400]], [[0.5, 0.5]] * 9_999])
def test_a_look_of_any_other_kind_is_told_in_one_error(look, first_levels):
    for level in first_levels:
        data = level.to_json()
        for name in data["looks"]:
            told = data | {"looks": data["looks"] | {name: look}}
            with pytest.raises(ValueError, match=r"these cannot be|but in this level") as error:
                Level.from_json(level.game, level.variant, told)
            assert len(str(error.value)) < 500


def test_what_is_told_of_a_level_must_be_true_of_it(first_levels):
    for level in first_levels:
        x, y = level.to_json()["agent"]
        with pytest.raises(ValueError, match="agent is"):
            data = level.to_json() | {"agent": [x + 0.3, y]}
            Level.from_json(level.game, level.variant, data)


def test_objects_that_cannot_be_reached_are_named_with_their_cell():
    made = games.find("maze")
    kind = made.variant("red-line-yellow-gem-small")
    drawing = "#######\n#.#...#\n#.###.#\n#....@#\n#.#####\n#G#.o.#\n#######"
    level = Level.from_text(made, kind, drawing)
    with pytest.raises(ValueError, match=r"other at cell \(4, 1\) cannot be reached from \(5, 3\)"):
        level.state()
    assert level.state(solvable=False).goal_x == 1
    assert level.removed("other").state().goal_x == 1
    wall = Level(made, kind, level.cells, (0, 0), {})
    with pytest.raises(ValueError, match=r"cell \(0, 0\) holds '#'"):
        wall.state()


@pytest.mark.parametrize(
    "game, variant, goal",
    [
        ("coinrun", "coin-end-calm", "coin"),
        ("coinrun", "coin-end-continue", "coin"),
        ("heist", "small", "gem"),
        ("keys", "many-chests-small", "chests"),
        ("lavaland", "dry", "cheese"),
        ("maze", "corner-small", "cheese"),
        ("maze", "anywhere-small", "corner"),
    ],
)
def test_a_goal_that_was_reached_or_a_level_that_ended_is_worth_nothing_more(game, variant, goal):
    env = begun(game, variant, [5])
    solver = env.game.solver
    over = env.states[0].copy()
    over.ended = True
    assert solver.optimal_return(env.states[0], goal) > 0 == solver.optimal_return(over, goal)
    expert, event = solver.expert(env.states[0], goal), env.game.event(goal)
    while env.states[0][event] == NEVER:
        env.step(np.array([expert(env.states[0])]))
    assert solver.optimal_return(env.states[0], goal) == 0
