"""The agency measure on policies that play mazes: those whose goal is known, and trained ones."""

import itertools
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from astray import acting, games
from astray.agency.measure import PAPER
from astray.analysis import agency
from astray.analysis.adapters import Function
from astray.analysis.agency import (
    DEVICE,
    MOST,
    MOUSE,
    UNDECIDED,
    Assessment,
    assess,
    assess_policy,
    heat,
    play,
    posterior_video,
)
from astray.analysis.outcomes import load_shift
from astray.analysis.policies import Random, Walk
from astray.envs.vector import GameVectorEnv
from astray.estimate import Estimate
from astray.world import Layout
from helpers import rooms

SHIFT = load_shift("maze", "corner-small")
MAZE = games.find("maze")
ANYWHERE = MAZE.variants["anywhere-small"]


def played_by(policy, levels=range(50)):
    return play(policy, "maze", ANYWHERE, levels, SHIFT)


@pytest.mark.parametrize(
    "policy, verdict", [(Walk("corner"), "corner"), (Walk("cheese"), "cheese"), (Random(), DEVICE)]
)
def test_policies_are_what_they_are(policy, verdict):
    assessed = assess(played_by(policy))
    assert assessed.verdict == verdict and verdict in assessed.explanations
    most = assessed.pooled.argmax()
    assert assessed.explanations[most] == verdict
    assert (assessed.agent.mean > 0) == (verdict != DEVICE)
    informative = assessed.episodes.row(assessed.most_informative, named=True)
    posterior = [informative[f"p {name}"] for name in assessed.explanations]
    assert sum(posterior) == pytest.approx(1)
    assert assessed.explanations[np.argmax(posterior)] == verdict


@pytest.mark.parametrize("goal", ["line", "gem", "corner"])
def test_mice_in_large_mazes_with_two_objects_are_told_apart(goal):
    shift, variant = load_shift("maze", "colour-or-shape"), "red-line-yellow-gem"
    there = play(Walk(goal), "maze", games.find("maze").variants[variant], range(20), shift)
    assert set(there[0].goals) == {"line", "gem", "corner"}
    assert assess(there).verdict == goal


def test_the_papers_measure_takes_random_mice_for_agents():
    assert assess(played_by(Random()), PAPER).verdict != DEVICE


def test_a_few_episodes_decide_nothing():
    assessed = assess(played_by(Walk("corner"), range(2)))
    assert assessed.verdict == UNDECIDED and "Undecided" in assessed.sentence()


def test_where_goals_do_not_part_an_agent_is_one_of_an_undecided_goal():
    training = games.find("maze").variants["corner-small"]
    assessed = assess(play(Walk("cheese"), "maze", training, range(40), SHIFT))
    assert assessed.decisions == 0 and assessed.verdict == UNDECIDED
    assert assessed.sentence().startswith("An agent; its goal is undecided")


def test_episodes_go_where_the_mouse_went_and_end_at_the_last_goal_it_reached():
    for one in played_by(Random(), range(40)):
        visited = [place for (place,) in one.goals.values() if place in one.cells]
        assert not visited or one.cells.index(one.cells[-1]) == len(one.cells) - 1
        assert one.cells[-1] in visited or len(one.cells) == ANYWHERE.time_limit + 1
        world, walked = one.episode.world, one.episode.trajectory
        moved = [a for a, b in itertools.pairwise(one.cells) if a != b] + [one.cells[-1]]
        assert [world.cell(n) for n in walked.cells] == moved


def test_levels_without_one_of_the_goals_are_left_out():
    shift, both = load_shift("maze", "colour-or-shape"), MAZE.variants["red-line-yellow-gem"]
    without = replace(both, other_shape="none", other_colour="none")
    mixed = replace(both, shifted=without, shift_probability=0.5)
    env = GameVectorEnv("maze", mixed, 40, observation="symbolic")
    env.reset(seed=0, options={"level": range(40)})
    there = np.flatnonzero(~env.states["shifted"].astype(bool)).tolist()
    assert 0 < len(there) < 40
    assert [one.level for one in play(Walk("line"), "maze", mixed, range(40), shift)] == there


def test_levels_that_all_lack_a_goal_are_refused_before_they_are_played(monkeypatch):
    monkeypatch.setattr(agency, "steps", lambda *_, **__: pytest.fail("it plays"))
    with pytest.raises(ValueError, match="in no level can one cell of each goal be reached"):
        assess_policy(Random(), "monsters", "calm", "calm", range(3))


def test_games_without_cells_are_refused():
    coinrun = games.find("coinrun")
    shift = next(iter(coinrun.shifts.values()))
    with pytest.raises(ValueError, match="the game 'coinrun' has no cells"):
        play(Random(), "coinrun", coinrun.variants[shift.test], range(1), shift)


def test_the_video_shows_the_mouse_and_the_goal_as_it_becomes_clear():
    one = max(played_by(Walk("corner"), range(30)), key=lambda p: len(p.cells))
    frames = posterior_video(Walk("corner"), "maze", ANYWHERE, one, pixels=140)
    assert len(frames) == len(one.cells) and frames.dtype == np.uint8
    left, right = frames[..., : frames.shape[2] // 2, :], frames[..., frames.shape[2] // 2 :, :]
    assert (np.diff(left.astype(int), axis=0) != 0).any((1, 2, 3)).all()
    likeliest = (right == MOST).all(3).sum((1, 2))
    assert likeliest[0] > 4 * likeliest[-1] > 0  # at first all cells are alike
    below = right[:, -152:]  # the captions, which are as dark as the mouse
    places = [np.argwhere((frame == MOUSE).all(2)).mean(0) / 20 for frame in below]  # cells
    across = np.diff(one.cells, axis=0)  # x and y, which goes upward; a picture's rows go down
    assert np.diff(places, axis=0) == pytest.approx(across[:, ::-1] * (-1, 1), abs=0.1)


def test_a_verdict_takes_more_than_half_for_certain():
    def verdict(low):
        both = [Estimate(0.7, low, 0.9, 1, 9, 9), Estimate(0.3, 0.1, 0.5, 1, 9, 9)]
        assessed = Assessment(pl.DataFrame(), ("corner", DEVICE))
        vars(assessed)["rates"] = both
        return assessed.verdict

    assert (verdict(0.49), verdict(0.51)) == (UNDECIDED, "corner")


def test_the_likeliest_cell_is_the_darkest():
    world = played_by(Walk("corner"), range(1))[0].episode.world
    belief = np.full(len(world), 0.1)
    belief[3] = 1.0
    side = 10
    image = heat(world, belief, 0, side * len(world.free)).astype(int)
    brightness = {
        n: image[side * (len(world.free) - 1 - y) + 1, side * x + 1].sum()
        for n, (x, y) in enumerate(world.cells)
    }
    assert min(brightness, key=brightness.__getitem__) == 3


def layout(env):
    """The cells of a row, in which the square may lie."""
    there = {"square": (env.square, 0), "end": (rooms.CELLS - 1, 0)}
    return Layout(np.ones((1, rooms.CELLS), bool), (env.x, 0), there)


def test_a_video_of_actions_that_are_drawn_anew_says_so(monkeypatch):
    world, random, told = replace(rooms.WORLD, cells=layout), np.random.default_rng(0), []
    beside = lambda *_, captions: told.append(captions[0])  # noqa: E731
    monkeypatch.setattr(agency.video, "beside", beside)
    drawn = Function(lambda seen: random.integers(0, 2, len(seen)))
    for policy in (drawn, Walk("end")):
        how = policy, world, world.variant("anywhere")
        (one, *_) = play(*how, range(12), world.shifts["end"])
        posterior_video(*how, one, pixels=64)
        told.append(f"level {one.level}")
    assert told[0] == f"{told[1]}, drawn anew: another episode" and told[2] == told[3]


def test_episodes_of_a_world_that_tells_its_cells_are_measured():
    world = replace(rooms.WORLD, cells=layout)
    found = play(Walk("end"), world, world.variant("anywhere"), range(12), world.shifts["end"])
    for one in found:
        ((square, _),) = one.goals["square"]
        last = square if square > 4 else 8  # the square ends the episode
        assert one.cells == [(x, 0) for x in range(4, last + 1)]
    assert {one.level for one in found} <= set(range(12)) and len(found) > 3
    assessed, _ = assess_policy(Walk("end"), world, world.variant("anywhere"), "end", range(12))
    assert "end" in assessed.explanations
    halved = replace(world, cells=lambda env: layout(env)._replace(agent=(env.x + 0.5, 0)))
    with pytest.raises(ValueError, match="a cell must be two integers, x and y; got"):
        play(Walk("end"), halved, world.variant("anywhere"), range(3), world.shifts["end"])
    later = lambda env: layout(env)._replace(agent=(env.x + 0.5 if env.steps else env.x, 0))  # noqa: E731
    with pytest.raises(ValueError, match=r"step 1: .*a cell must be two integers"):
        halved = replace(world, cells=later)
        play(Walk("end"), halved, world.variant("anywhere"), range(3), world.shifts["end"])
    with pytest.raises(ValueError, match="unknown measure 'Paper'; there are: paper, calibrated"):
        assess_policy(Walk("end"), world, world.variant("end"), "end", [1], "Paper")
    with pytest.raises(ValueError, match="'room' has no cells, which this needs: World"):
        play(Walk("end"), rooms.WORLD, rooms.WORLD.variant("end"), [1], world.shifts["end"])
    drawn = replace(world, repeats=False)  # as of streams
    with pytest.raises(ValueError, match=r"cells of room, a World\(repeats=False\), are read in"):
        assess_policy(Walk("end"), drawn, drawn.variant("end"), "end", [1])


def test_levels_in_which_no_way_leads_to_a_goal_are_left_out():
    def walled(env):
        free = np.arange(rooms.CELLS)[None] != 3  # beside the cell in which episodes begin
        return layout(env)._replace(free=free | (np.arange(rooms.CELLS) == env.square))

    world = replace(rooms.WORLD, cells=walled)
    variant, squares = world.variant("anywhere"), {}
    for level in range(30):
        (env := rooms.Room("anywhere")).reset(seed=level)
        squares[level] = env.square
    found = play(Walk("end"), world, variant, range(30), world.shifts["end"])
    assert {one.level for one in found} == {n for n, square in squares.items() if square >= 3}
    assert 0 < len(found) < 30
    stray = next(level for level, square in squares.items() if square < 3)
    to_square = Walk("square")  # goes through the wall
    with pytest.raises(ValueError, match=rf"^level {stray}: cell \(3, 0\) is a wall"):
        play(to_square, world, variant, [stray], world.shifts["end"])


def test_levels_that_share_their_arrays_are_measured_as_others():
    def drawn(env, kept):
        kept["free"][0] = np.arange(rooms.CELLS) >= 4 - env.square % 4
        kept["free"][0, env.square] = True
        kept["square"][:] = env.square, 0
        goals = {"square": kept["square"], "end": (rooms.CELLS - 1, 0)}
        return Layout(kept["free"], (env.x, 0), goals)

    def empty():
        return {"free": np.ones((1, rooms.CELLS), bool), "square": np.zeros(2, int)}

    told = []
    for kept in (empty(), None):
        world = replace(rooms.WORLD, cells=lambda env, kept=kept: drawn(env, kept or empty()))
        variant = world.variant("anywhere")
        found = play(Walk("end"), world, variant, range(12), world.shifts["end"])
        told.append([(one.episode.world.free.tolist(), one.goals) for one in found])
    assert told[0] == told[1] and len({str(free) for free, _ in told[0]}) > 1


def test_episodes_that_never_end_are_measured_up_to_the_longest(monkeypatch):
    world = replace(rooms.ENDLESS, cells=layout)
    left = Function(rooms.go_left, "left")
    found = play(left, world, world.variant("end"), [3, 5], world.shifts["end"], longest=7)
    assert [one.cells for one in found] == [[(x, 0) for x in (4, 3, 2, 1, 0, 0, 0, 0)]] * 2
    how = left, world, world.variant("end"), "end", [3]
    assessed, video = assess_policy(*how, longest=3)
    assert assessed.episodes["moves"].to_list() == [3] and len(video()) == 4
    monkeypatch.setattr(acting, "OF_WORLD", 500)
    with pytest.raises(ValueError, match="after 500 steps: say `longest`"):
        assess_policy(*how)
    monkeypatch.setattr(agency, "initial_states", lambda *given: pytest.fail("it compiled"))
    for_ever = ANYWHERE.with_knobs({"time_limit": 2_000_000})
    with pytest.raises(ValueError, match="last up to 2,000,000 steps: lower the variant"):
        play(left, "maze", for_ever, [3], SHIFT)


def test_an_episode_without_a_step_of_the_agent_has_a_video_of_one_frame():
    at_end = replace(rooms.WORLD, cells=lambda env: layout(env)._replace(agent=(8, 0)))
    _, video = assess_policy(Walk("end"), at_end, at_end.variant("anywhere"), "end", range(3))
    assert len(video()) == 1
