"""A reward of one's own takes the game's place in training, and is measured beside it."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from astray.analysis.evaluate import evaluate
from astray.analysis.policies import Random
from astray.analysis.runs import evaluate_policies
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.folders import AGENT, latest
from astray.training.loop import iterate, train
from astray.training.settings import Sampling
from helpers.rooms import CELLS, WORLD, Room

ROOM = Config(WORLD, "end", num_envs=8, num_steps=32, minibatches=4, steps=2 * 256)
MAZE = Config("maze", "corner-small", num_envs=8, num_steps=32, minibatches=4, steps=2 * 256)


def place(seen):
    return seen.reshape(len(seen), 2, CELLS)[:, 0].argmax(1)


def leftward(step):
    return place(step.observations) - place(step.seen)


def the_same(step):
    return step.rewards


def counted(step):
    """Check that a step leads from one state of an episode to the next, also at its end."""
    assert (step.after["time"] == step.before["time"] + 1).all()
    assert (step.after["level"] == step.before["level"]).all()
    assert (step.level == step.before["level"]).all()
    return step.ended


def of_three(step):
    return step.rewards + np.zeros(3)


def unfinished(step):
    return np.where(step.ended, np.nan, 0.0)


def single(step):
    return 1.0


@pytest.mark.parametrize("config", [ROOM, MAZE], ids=["room", "maze"])
def test_the_game_s_own_rewards_teach_the_same_to_the_bit(config, tmp_path):
    weights = []
    for name, reward in (("none", None), ("own", the_same)):
        train(config, tmp_path / name, reward=reward, progress=False)
        weights.append((latest(tmp_path / name) / AGENT).read_bytes())
    assert weights[0] == weights[1]
    told = checkpoint.read_config(tmp_path / "own").reward
    assert told == f"{__name__}:the_same"


@pytest.mark.parametrize("config", [ROOM, MAZE], ids=["room", "maze"])
def test_a_reward_sees_states_and_observations_of_whole_steps(config):
    last = [iteration.metrics for iteration in iterate(config, reward=counted)][-1]
    assert last["training/return"] == 1.0  # one for each end


def of_actions(step):
    return (step.actions == [2, 5]).sum(1)  # the least and the largest


class Offset(Room):
    def __init__(self):
        super().__init__()
        self.action_space = gymnasium.spaces.MultiDiscrete([2, 3], start=[2, 3])


def test_a_reward_is_given_the_actions_of_the_environment_in_training_too():
    world = replace(WORLD, name="offset", variants={"end": Offset, "anywhere": Offset})
    for told in iterate(replace(ROOM, game=world), reward=of_actions):
        assert told.metrics["training/reward_per_step"] == pytest.approx(1 / 2 + 1 / 3, abs=0.2)


@pytest.mark.parametrize("game, variant", [(WORLD, "anywhere"), ("maze", "anywhere-small")])
def test_a_reward_is_told_the_numbers_of_levels_in_evaluation_as_in_training(game, variant):
    rewards = {"numbers": lambda step: step.level}
    table = evaluate(Random(), game, variant, range(70, 60, -1), batch=3, rewards=rewards)
    assert (table["numbers"] == table["level"] * table["length"]).all()


def test_an_agent_learns_what_a_reward_of_ones_own_pays():
    config = Config(WORLD, "end", num_envs=8, num_steps=32, minibatches=4, steps=12 * 256)
    *_, last = iterate(config, reward=leftward)
    assert last.metrics["training/return"] > 3 and last.metrics["training/reached_end"] == 0


@pytest.mark.parametrize("game, variant", [(WORLD, "anywhere"), ("maze", "anywhere-small")])
def test_several_rewards_are_measured_in_the_same_episodes(game, variant):
    rewards = {"again": the_same, "ends": counted_once, "steps": lambda step: step.rewards * 0 + 1}
    table = evaluate(Random(), game, variant, range(20), batch=3, rewards=rewards)
    assert (table["again"] == table["return"]).all() and (table["ends"] == 1).all()
    assert (table["steps"] == table["length"]).all()


def counted_once(step):
    return step.ended


def writing(step):
    """Return 1 a step, and spoil the step that it is given."""
    step.seen[:], step.observations[:], step.ended[:] = 0, 0, True
    rewards = step.rewards
    rewards[:] = 1
    return rewards


class Writes:
    """Goes at random, and spoils the observations that it is given."""

    name, observation, art = Random.name, "symbolic", "own"

    def actions(self, turn):
        turn.observations[:] = 0
        return Random().actions(turn)


@pytest.mark.parametrize("game, variant", [(WORLD, "anywhere"), ("maze", "anywhere-small")])
def test_a_reward_a_measure_or_a_policy_may_write_to_what_it_is_given(game, variant):
    def at_last(states):
        times = states["time"]
        times[:] = -times
        return times

    def bright(step):
        return step.observations.reshape(len(step.level), -1).sum(1)

    def table(of_play, **rewards):
        rewards = rewards | {"again": the_same, "bright": bright}
        measures = {"negative": at_last, "steps": lambda states: states["time"]}
        return evaluate(
            of_play, game, variant, range(20), longest=9, measures=measures, rewards=rewards
        )

    spoilt, whole = table(Writes(), own=writing), table(Random(), own=lambda s: s.rewards * 0 + 1)
    assert spoilt.equals(whole) and (whole["steps"] == whole["length"]).all()


def test_training_goes_on_where_a_reward_writes_to_what_it_is_given():
    told = [[step.metrics for step in iterate(ROOM, reward=one)] for one in (writing, each_step)]
    assert told[0] == told[1]


def each_step(step):
    return np.ones(len(step.rewards))


def masking(step):
    return np.ma.masked_less(step.rewards, 1)


def test_rewards_stand_in_the_episodes_of_a_result():
    result = evaluate_policies([], WORLD, "end", range(9), rewards={"left": leftward})
    mine = result.episodes.filter(policy="walk to end")
    assert (mine["left"] == -(CELLS // 2)).any()


@pytest.mark.parametrize(
    "reward, said",
    [
        (unfinished, "a reward must return 8 finite numbers, .*nan"),
        (single, r"a reward must return 8 finite numbers, .*got 1\.0"),
        (masking, "a reward must return 8 finite numbers, .*masked_array"),
        (lambda step: step.rewards, "must be a function or a class at the top of a module"),
        (of_three, r"the reward .* fails: ValueError\(.*shapes.*\(test_rewards\.py, line \d+"),
    ],
)
def test_a_reward_that_cannot_be_is_refused(reward, said):
    with pytest.raises(ValueError, match=said):
        next(iterate(ROOM, reward=reward))


def test_a_reward_by_a_name_that_is_none_is_refused():
    with pytest.raises(ValueError, match="reward must be module:function; got 'mine'"):
        Config(reward="mine")


@pytest.mark.parametrize("sampler", ["plr", "accel"])
def test_regret_of_the_games_reward_is_not_taken_from_ones_own(sampler):
    with pytest.raises(ValueError, match="'regret' needs the game's own reward; got 'mine:paid'"):
        Config(
            variant="corner-small", sampler=Sampling(sampler, score="regret"), reward="mine:paid"
        )
    assert Config(sampler=Sampling(sampler), reward="mine:paid").reward == "mine:paid"
