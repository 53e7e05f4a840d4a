"""What critics say along episodes, and of states that are made otherwise."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from astray import games
from astray.acting import Answer, initial_states
from astray.agents.policy import Architecture, weights
from astray.analysis import critic
from astray.analysis.evaluate import evaluate
from astray.analysis.trained import Agent, Opaque
from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import edits, measures
from astray.level import Level
from astray.record import NEVER

GAME = games.find("coinrun")
SHORT = replace(GAME.variants["coin-anywhere"], time_limit=40)
LEVELS = range(300, 312)
STAGE = {"stage": measures.stage}
ROOM = """
    #..........####
    #..........####
    #....<.....####
    #@.o..x....####
    ===========####
"""
ARCHITECTURES = {
    "symbolic": Architecture("mlp", (7, 13, 13), (1,) * 7, 15, width=16),
    "image": Architecture("impala", (64, 64, 3), (), 15),
}


def make_agent(kind, folder):
    torch.manual_seed(0)
    architecture = ARCHITECTURES[kind]
    path = folder / f"{kind}.safetensors"
    path.write_bytes(weights(architecture.build(), architecture, "coinrun"))
    return Agent(path, "coinrun")


@pytest.fixture(scope="module")
def agent(tmp_path_factory):
    return make_agent("symbolic", tmp_path_factory.mktemp("agent"))


@pytest.fixture(params=ARCHITECTURES)
def either(request, tmp_path):
    """An agent that sees symbols, and one that sees images."""
    return make_agent(request.param, tmp_path)


@pytest.fixture(scope="module")
def visited(agent):
    return critic.visit(agent, SHORT, LEVELS, measures=STAGE)


def room(*levels):
    """The states that begin in levels."""
    return np.array([level.state(solvable=False) for level in levels], GAME.state)


def begin(agent, level):
    """What the agent sees of a level when an episode begins in it."""
    env = GameVectorEnv("coinrun", SHORT, observation=agent.observation)
    return env.reset(seed=0, options={"level": level})[0]


def test_rows_retell_the_episodes_step_by_step(agent, visited):
    """Played again, one by one, by the actions in the rows."""
    rows, states = visited
    env = GameVectorEnv("coinrun", SHORT, observation="symbolic", autoreset_mode="Disabled")
    ended = True
    for row, s in zip(rows.to_dicts(), states, strict=True):
        if ended:
            shown, _ = env.reset(seed=0, options={"level": row["level"]})
        assert (s.x, s.y, s.time) == (env.states[0].x, env.states[0].y, row["step"])
        with torch.no_grad():
            value = agent.network(torch.from_numpy(shown))[1].item()
        assert row["value"] == pytest.approx(value, abs=1e-5)
        assert row["stage"] == measures.stage(env.states)[0]
        shown, reward, terminated, truncated, _ = env.step(np.array([row["action"]]))
        ended = terminated[0] or truncated[0]
        assert row["reward"] == reward[0]
    assert ended


def test_episodes_are_those_that_evaluation_plays(agent, visited):
    told = visited[0].group_by("level", maintain_order=True).len()
    episodes = evaluate(agent, "coinrun", SHORT, LEVELS)
    assert told["level"].to_list() == list(LEVELS)
    assert told["len"].to_list() == episodes["length"].to_list()


@pytest.mark.parametrize("per_episode", [None, 3])
def test_rows_and_states_are_the_same_in_any_batch_and_order(agent, per_episode):
    tables = [
        critic.visit(agent, SHORT, levels, per_episode=per_episode, batch=batch)
        for levels, batch in ((LEVELS, 1), (LEVELS, 5), (LEVELS, 256), (LEVELS[::-1], 5))
    ]
    (rows, states), *others, (backwards, _) = tables
    for other, other_states in others:
        assert other.equals(rows) and other_states.tobytes() == states.tobytes()
    assert backwards.sort("level", "step").equals(rows)
    assert backwards["level"].is_sorted(descending=True)


def test_so_many_steps_are_drawn_from_all_of_an_episode(agent, visited):
    lengths = dict(visited[0].group_by("level").len().iter_rows())
    seen = []
    for seed in range(12):
        rows, _ = critic.visit(agent, SHORT, LEVELS, per_episode=3, seed=seed)
        drawn = dict(rows.group_by("level").len().iter_rows())
        assert drawn == {level: min(3, length) for level, length in lengths.items()}
        assert rows.join(visited[0], on=rows.columns).height == rows.height
        long = rows.filter(rows["level"].replace_strict(lengths) == 40)
        seen += long["step"].to_list()
    assert len(seen) > 200 and np.histogram(seen, 4, (0, 40))[0].min() > 0.15 * len(seen)


def test_levels_that_were_drawn_are_visited(agent):
    level = Level.from_text(GAME, SHORT, ROOM)
    rows, states = critic.visit(agent, SHORT, {"room": level, "empty": level.removed("coin")})
    assert rows["level"].unique().to_list() == [0, 1]
    assert states["x"][0] == 1.5 and (states["end_x"] == 10).all()


def test_a_state_without_its_coin_is_a_level_built_without_it(either):
    level = Level.from_text(GAME, SHORT, ROOM)
    bare = level.removed("coin")
    pairs = critic.counterfactual(either, SHORT, room(level), edits.without_coin, measures=STAGE)
    (row,) = pairs.to_dicts()
    logits, value = either.outputs(np.concatenate([begin(either, level), begin(either, bare)]))
    assert (row["value"], row["value_edited"]) == tuple(value.tolist()) and row["seen"]
    assert row["change"] == pytest.approx(float(value[1] - value[0])) and row["change"] != 0
    p, q = logits.double().softmax(-1).numpy()
    assert np.array_equal([row["policy"], row["policy_edited"]], [p, q])
    likelier = p > q  # the event that tells the two best
    assert row["policy_change"] == pytest.approx(p[likelier].sum() - q[likelier].sum())
    assert (row["level"], row["step"], row["stage"]) == (NEVER, 0, 0)


@pytest.mark.parametrize(
    "edit, name", [(edits.without_saws, "saw"), (edits.without_walkers, "walker to the left")]
)
def test_what_an_edit_removes_an_agent_sees_no_more(either, edit, name):
    level = Level.from_text(GAME, SHORT, ROOM)
    shown = critic.observe(either, SHORT, edit(room(level)))
    assert np.array_equal(shown, begin(either, level.removed(name)))


def test_what_is_out_of_view_changes_nothing(either):
    far = Level.from_text(GAME, SHORT, "#@.........o......\n==================")
    level = [far, far.moved("coin", (5, 1))]
    pairs = critic.counterfactual(either, SHORT, room(*level), edits.without_coin)
    assert pairs["seen"].to_list() == [False, True]
    assert pairs["change"][0] == pairs["policy_change"][0] == 0 != pairs["change"][1]
    sees = critic.sees(either, SHORT, edits.without_coin)
    assert sees(room(*level)).tolist() == [False, True]


def test_a_coin_is_seen_where_geometry_says_so(tmp_path, agent, visited):
    states = visited[1]
    seen = critic.sees(make_agent("image", tmp_path), SHORT, edits.without_coin)(states)
    assert (seen == measures.coin_in_view(states)).mean() > 0.97 and 0.1 < seen.mean() < 0.9


def test_an_observation_does_not_depend_on_those_beside_it(either, visited):
    states = visited[1][:70]
    shown = critic.observe(either, SHORT, states)
    assert np.array_equal(shown, critic.observe(either, SHORT, states, batch=9))
    assert np.array_equal(shown[66:67], critic.observe(either, SHORT, states[66:67]))


@pytest.mark.parametrize(
    "levels, arguments, message",
    [
        ([], {}, "levels are numbers, at least one; none"),
        ([1], {"per_episode": 0}, "per_episode must be an integer from 1 to"),
        ([1], {"batch": 0}, "batch must be an integer from 1 to"),
        ([1], {"measures": {"value": measures.stage}}, "the names of other columns: value"),
    ],
)
def test_bad_arguments_are_explained(agent, levels, arguments, message):
    with pytest.raises(ValueError, match=message):
        critic.visit(agent, SHORT, levels, **arguments)


def test_edits_that_are_none_are_refused(agent, visited):
    with pytest.raises(ValueError, match="as many states as it is given, 5"):
        critic.counterfactual(agent, SHORT, visited[1][:5], lambda states: states[1:])
    with pytest.raises(ValueError, match="no states are given"):
        critic.counterfactual(agent, SHORT, visited[1][:0], edits.without_coin)


class Counts:
    """Counts the steps of its episode by itself."""

    name, observation, art = "counts", "symbolic", "own"

    def actions(self, turn):
        self.count = np.where(turn.begins, 0, getattr(self, "count", 0) + 1)
        return Answer(self.count)


def test_a_policy_that_counts_by_itself_is_told_once_that_an_episode_begins():
    states = np.repeat(initial_states("maze", "corner-small", [0]), 4)
    states["time"] = range(4)
    for _ in range(2):
        policy, _ = critic.ask(Opaque(Counts(), "maze"), "corner-small", states, episode=True)
        assert policy.argmax(1).tolist() == [0, 1, 2, 3]
