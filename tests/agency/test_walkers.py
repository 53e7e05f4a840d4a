"""Trajectories are of their type, and what is assessed of many of them."""

import numpy as np
import pytest

from astray.agency.generators import (
    TYPES,
    Setting,
    erring,
    legal_random,
    persistent,
    uniform_random,
    wall_follower,
    wander,
)
from astray.agency.maps import MAPS
from astray.agency.measure import CALIBRATED, PAPER, Episode, measure
from astray.agency.population import pooled, rates


@pytest.mark.parametrize("name", MAPS)
def test_trajectories_are_of_their_type(name):
    world = MAPS[name]()
    rng = np.random.default_rng(1)
    start, goal = (world.cell(n) for n in rng.choice(len(world), 2, replace=False))
    setting = Setting(world, start, goal, seed=3)
    for kind in TYPES:
        for episode in setting.episodes(kind, 20):
            walked, end = episode.trajectory, world.cell(episode.trajectory.cells[-1])
            shortest = world.distance[walked.cells[0], walked.cells[-1]]
            assert len(walked) > 0
            if kind == "capability failure":
                met = np.isin(walked.cells, [*setting.memory, world.number(goal)])
                assert len(walked) <= 50 and episode.true == goal
                assert len(walked) == 50 or (end == goal and met.any())
                follows = [setting.memory.get(int(cell)) for cell in walked.cells[:-1]]
                assert all(f in (None, a) for f, a in zip(follows, walked.actions, strict=True))
            else:
                assert len(walked) == shortest
                assert end == (episode.true if kind == "robust" else goal)
                assert (episode.true == goal) == (kind == "in-distribution") or kind == "robust"


CALLED = {  # rate called agents by the paper's measure and the calibrated one: bounds of both
    "uniform": (uniform_random, (0.2, 0.8), (0.0, 0.2)),
    "legal": (legal_random, (0.8, 1.0), (0.0, 0.2)),
    "persistent": (persistent, (0.5, 1.0), (0.0, 0.05)),
    "wall follower": (wall_follower, (0.5, 1.0), (0.0, 0.05)),
    "agent": (erring((3, 16), 0.2), (0.8, 1.0), (0.8, 1.0)),
}


@pytest.mark.parametrize("name", CALLED)
def test_the_calibrated_measure_is_not_fooled_by_policies_without_a_goal(name):
    (walker, *bounds), world = CALLED[name], MAPS["four rooms"]()
    rng, goal, episodes = np.random.default_rng(0), (3, 16), []
    for begin in rng.choice(np.arange(60, len(world)), 30):
        walked = wander(world, walker, world.cell(begin), 50, rng)
        there = np.flatnonzero(walked.cells == world.number(goal))
        if name == "agent" and len(there):
            walked = world.walk(world.cell(begin), walked.actions[: there[0]])
        episodes.append(Episode(world, walked, goal))
    for options, (low, high) in zip((PAPER, CALIBRATED), bounds, strict=True):
        rate = np.mean([measure(episode, options).log_factor > 0 for episode in episodes])
        assert low <= rate <= high


def test_rates_of_certain_episodes_are_those_of_a_dirichlet():
    certain = np.log([[1.0, 1e-12, 1e-12]] * 7 + [[1e-12, 1.0, 1e-12]] * 2)
    means = [rate.mean for rate in rates(certain)]
    assert means == pytest.approx([8 / 12, 3 / 12, 1 / 12], abs=0.01)
    assert pooled(certain)[0] > 0.999


def test_one_episode_leaves_its_rates_open():
    chance = np.array([0.7, 0.2, 0.1])  # Dirichlet(2, 1, 1) with 0.7, ...
    found = rates(np.log(chance)[None])
    assert [rate.mean for rate in found] == pytest.approx((1 + chance) / 4, abs=0.01)
    assert found[0].low < 0.1 and found[0].high > 0.8
