"""The agency measure against enumeration and closed forms."""

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import betainc, betaln

from astray.agency import devices
from astray.agency.agents import of_every_cell
from astray.agency.generators import Setting, erring, uniform_random, wander
from astray.agency.gridworld import Trajectory, World
from astray.agency.maps import MAPS
from astray.agency.measure import (
    CALIBRATED,
    PAPER,
    TRUE,
    Episode,
    Options,
    decisions,
    measure,
    measure_named,
)
from astray.agency.online import measure_online
from astray.agency.population import rates
from astray.agency.steps import EXACT, log_product, log_table, rule
from helpers.thorough import thorough

SMALL = World.parse("...\n.#.\n...")
OPTIONS = [
    PAPER,
    CALIBRATED,
    replace(PAPER, noise="other actions", goals="accessible"),
    replace(PAPER, at_goal="stay", beta=2.0, noise_atom=0.3),
    replace(PAPER, at_goal="done", first="up"),
    replace(CALIBRATED, at_goal="done", first="left"),
]


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("world", [SMALL, *thorough(World.parse("...\n..#"))])
def test_probabilities_of_all_trajectories_sum_to_one(options, world):
    agent, device, top = 0.0, 0.0, len(world.free) - 1
    for actions in itertools.product(range(4), repeat=4):
        walked = world.walk((0, top), actions)
        if options.legal and len(world.moves(walked)) < len(walked):
            continue
        evidence = measure(Episode(world, walked, (2, top)), options)
        agent, device = agent + np.exp(evidence.log_agent), device + np.exp(evidence.log_device)
    assert (agent, device) == (pytest.approx(1, rel=1e-12), pytest.approx(1, rel=1e-12))


@pytest.mark.parametrize("legal", [False, True])
@pytest.mark.parametrize("actions", [(3, 3, 1, 1), (0, 2, 3, 3, 3, 1), (1, 0, 1, 0, 3)])
def test_the_device_mixture_is_the_sum_over_all_devices(actions, legal):
    options = replace(PAPER, legal=legal)
    episode = Episode(SMALL, SMALL.walk((0, 2), actions), (2, 0))
    walked = SMALL.moves(episode.trajectory) if legal else episode.trajectory
    seen = devices.see(SMALL, walked, SMALL.number((2, 0)))
    names = sorted(set(seen.observation.tolist()))

    def likelihood(eps, table):
        product = 1.0
        for t, action in enumerate(walked.actions):
            possible = SMALL.legal[walked.cells[t]] if legal else np.ones(4, bool)
            says = table[names.index(seen.observation[t])]
            obeyed = float(says == action) if possible[says] else 1 / possible.sum()
            product *= (1 - eps) * obeyed + eps / possible.sum()
        return product

    tables = list(itertools.product(range(4), repeat=len(names)))
    whole = [quad(likelihood, 0, 1, args=(table,), epsabs=1e-13)[0] for table in tables]
    assert np.exp(measure(episode, options).log_device) == pytest.approx(np.mean(whole), rel=1e-9)


@pytest.mark.parametrize("steps", [1, 5, 600, EXACT, EXACT + 2, 5000])
def test_a_straight_corridor_costs_the_logarithm_of_its_length(steps):
    world = World.parse("." * 8)
    # There and back again: the same counts as a corridor of any length.
    table = log_table(rule(steps))
    kinds = np.full((steps, 1), of_every_cell(world, False, "uniform").kinds[0, 3, 7])
    found = rule(steps).integrate(log_product(kinds, table))[0]
    assert found == pytest.approx(np.log(4 / (3 * (steps + 1))), abs=1e-10 + 4.0**-(steps))


@pytest.mark.parametrize("right, wrong", [(3, 4), (20, 0), (0, 9), (1000, 900)])
def test_one_kind_of_choice_is_an_incomplete_beta_function(right, wrong):
    k, A = 1, 4
    kinds = of_every_cell(World.parse("...\n..."), False, "uniform").kinds
    steps = np.array([[kinds[0, 3, 2]]] * right + [[kinds[0, 2, 2]]] * wrong)
    nodes = rule(right + wrong)
    found = nodes.integrate(log_product(steps, log_table(nodes)))[0]
    rate = betainc(wrong + 1, right + 1, 1 - k / A)
    exact = np.log(A / (A - k)) - wrong * np.log(A - k) + np.log(rate)
    assert found == pytest.approx(exact + betaln(wrong + 1, right + 1), abs=1e-9)


@pytest.mark.parametrize("beta", [1.0001, 1.5, 2.0, 7.25, 1000.5])
@pytest.mark.parametrize("right, wrong", [(0, 0), (6, 2), (0, 9), (1000, 900)])
def test_evidence_is_exact_for_every_prior_of_the_agents_errors(right, wrong, beta):
    kinds = of_every_cell(World.parse("...\n..."), False, "uniform").kinds
    steps = np.array([[kinds[0, 3, 2]]] * right + [[kinds[0, 2, 2]]] * wrong, int).reshape(-1, 1)
    nodes = rule(len(steps), beta)
    (found,) = nodes.integrate(log_product(steps, log_table(nodes, "other actions")))
    exact = np.log(beta) + betaln(wrong + 1, right + beta) - wrong * np.log(3)
    assert found == pytest.approx(exact, abs=1e-9)


def test_a_measured_world_keeps_no_distances_between_all_its_cells():
    """Those of hundreds of episodes in worlds of 1,000 cells would take gigabytes."""
    world = World(np.ones((20, 20), bool))
    measure(Episode(world, world.walk((0, 0), [3, 3, 0]), (5, 5)))
    assert len(pickle.dumps(world)) < 400**2


def test_a_device_that_sees_nothing_twice_is_as_good_as_none():
    world = World.parse("....\n....\n....")
    episode = Episode(world, world.walk((0, 2), [3, 3, 1, 1, 3]), (3, 0))
    evidence = measure(episode, replace(PAPER, observations=("pos",)))
    assert evidence.log_device == pytest.approx(-5 * np.log(4), abs=1e-12)


@pytest.mark.parametrize("options", OPTIONS)
def test_the_last_of_the_online_evidence_is_the_whole(options):
    world, rng = MAPS["obstacles, 30 %"](), np.random.default_rng(0)
    begin = world.cell(5)
    episode = Episode(world, wander(world, uniform_random, begin, 60, rng), world.cell(90))
    growth, whole = measure_online(episode, options), measure(episode, options)
    assert growth.log_agent[-1] == pytest.approx(whole.log_agent, abs=1e-10)
    assert growth.log_device[-1] == pytest.approx(whole.log_device, abs=1e-10)
    assert growth.posterior[-1] == pytest.approx(whole.posterior, abs=1e-10)
    assert growth.agent[0] == 0.5


def test_goals_that_may_switch_follow_a_change_of_mind():
    world = World.parse("." * 9)
    episode = Episode(world, world.walk((4, 0), [3] * 4 + [2] * 8), (0, 0))
    fixed, free = (measure_online(episode, switch=rate) for rate in (0.0, 0.1))
    assert free.log_agent[-1] > fixed.log_agent[-1] + 1
    never = measure_online(episode, switch=1e-300)
    assert never.log_agent == pytest.approx(fixed.log_agent, abs=1e-10)


@pytest.mark.parametrize("options", OPTIONS)
def test_an_empty_trajectory_says_nothing(options):
    evidence = measure(Episode(SMALL, SMALL.walk((0, 2), []), (2, 0)), options)
    assert evidence.agent == pytest.approx(0.5, abs=1e-12)


def test_what_is_impossible_stays_impossible():
    world = World.parse("....")
    episode = Episode(world, world.walk((0, 0), [3, 3, 3]), (3, 0))
    evidence = measure(episode, replace(PAPER, at_goal="absorb"))
    assert evidence.log_goals[1] == -np.inf and evidence.posterior[1] == 0.0
    assert np.isfinite(evidence.log_agent)
    growth = measure_online(episode, replace(PAPER, at_goal="absorb"))
    assert growth.log_agent[-1] == pytest.approx(evidence.log_agent)


def test_walls_among_the_goals_cost_their_prior_and_nothing_else():
    episode = Episode(SMALL, SMALL.walk((0, 2), [3, 3]), (2, 2))
    every = measure(episode, replace(PAPER, goals="all cells"))
    free = measure(episode, replace(PAPER, goals="accessible"))
    assert every.log_agent - free.log_agent == pytest.approx(np.log(8 / 9))


ISLANDS = World.parse("..#..")
LEFT = ISLANDS.walk((0, 0), [3])


@pytest.mark.parametrize(
    "wrong, words",
    [
        (lambda: World.parse("..\n.x"), "drawn with # and ."),
        (lambda: World.parse("..\n."), "equally long"),
        (lambda: World.parse(["..", 5]), "a line of a map must be"),
        (lambda: World.parse("##"), "at least one free cell"),
        (lambda: SMALL.walk((1, 1), [0]), "(1, 1) is a wall"),
        (lambda: SMALL.walk((0, 9), [0]), "outside"),
        (lambda: SMALL.walk((0, 0), [4]), "from 0 to 3"),
        (lambda: SMALL.trajectory([((1, 2), 1), ((1, 1), 1)]), "step 1 begins in (1, 1)"),
        (lambda: SMALL.trajectory([]), "without steps"),
        (lambda: SMALL.path([(0, 2), (0, 0)]), "no move leads from (0, 2) to (0, 0)"),
        (lambda: measure(Episode(ISLANDS, LEFT, (2, 0))), "(2, 0) is a wall"),
        (lambda: measure(Episode(ISLANDS, LEFT, (4, 0))), "no way leads to the goal (4, 0)"),
        (lambda: measure(Episode(ISLANDS, LEFT)), "must have a true goal"),
        (lambda: measure(Episode(ISLANDS, LEFT, ())), "must be two integers, x and y; got ()"),  # pyrefly: ignore
        (lambda: measure([]), "no episodes"),
        (lambda: measure_named([Episode(ISLANDS, LEFT)], [{"far": [(4, 0)]}]), "no way leads"),
        (lambda: measure_named([Episode(ISLANDS, LEFT)], [{"far": []}]), "at least one cell"),
        (lambda: measure_named([Episode(ISLANDS, LEFT)], [{}]), "goals must have a name"),
        (lambda: Options(observations=("smell",)), "there are: type"),
        (lambda: Options(noise_atom=2), "from 0 to 1"),
        (lambda: Setting(ISLANDS, (0, 0), (4, 0), 0), "no way leads"),
        (lambda: Setting(SMALL, (0, 2), (2, 2), -1), "seed must be an integer from 0 to"),
        (lambda: Setting(SMALL, (0, 2), (2, 2), 0, horizon=float("nan")),  # pyrefly: ignore
         "horizon must be an integer from 1 to 2147483647; got nan"),
        (lambda: Setting(SMALL, (0, 2), (2, 2), 0, horizon=1.5),  # pyrefly: ignore
         "horizon must be an integer from 1 to 2147483647; got 1.5"),
        (lambda: Setting(SMALL, (0, 2), (2, 2), 0, horizon=0), "from 1 to 2147483647; got 0"),
        (lambda: Setting(SMALL, (0, 2), (2, 2), 0, bumps=2), "bumps must be a bool; got 2"),  # pyrefly: ignore
        (lambda: Setting("..", (0, 2), (2, 2), 0), "world must be a World; got '..'"),  # pyrefly: ignore
        (lambda: Setting(SMALL, (0, 2), (2, 2), 0).episodes("robust", 1.5),  # pyrefly: ignore
         "count must be an integer from 0 to 2147483647; got 1.5"),
        (lambda: Episode(SMALL, by_hand([0, 99], [3])), "cells of a trajectory must be a list of"),
        (lambda: Episode(SMALL, by_hand([-1, 0], [3])), "cells of a trajectory must be a list of"),
        (lambda: Episode(SMALL, by_hand([0.0, 1.0], [3])), "trajectory must be integers"),
        (lambda: Episode(SMALL, by_hand([0, 1], [4])), "actions of a trajectory must be a list of"),
        (lambda: Episode(SMALL, by_hand([0, 1], [3, 3])), "cells must be 3, one more than actions"),
        (lambda: Episode(SMALL, Trajectory([0, 1], [3])), "must be a ndarray; got [0, 1]"),  # pyrefly: ignore
        (lambda: Episode(SMALL, Trajectory(np.array([0, 1], np.uint64), np.array([3]))),
         "from 0 to 7; got array([0, 1], dtype=uint64)"),
        (lambda: Episode(SMALL, Trajectory(np.array([0]), np.array([]))),
         "from 0 to 3; got array([], dtype=float64)"),
        (lambda: Episode(SMALL, by_hand([0, 1, 4], [3, 3])), "step 1 does not lead to the cell"),
        (lambda: Episode(SMALL, [0, 1]), "a trajectory must be a Trajectory"),  # pyrefly: ignore
        (lambda: rule(200_000), "can be measured together; got 200000"),
        (lambda: rates(np.full((2, 3), -np.inf)), "impossible under every"),
        (lambda: erring((2, 2), float("nan")), "eps must be a finite number from 0 to 1; got nan"),
        (lambda: erring((2, 2), 1.5), "eps must be a finite number from 0 to 1; got 1.5"),
        (lambda: wander(SMALL, uniform_random, (0, 0), -1, np.random.default_rng(0)),
         "steps must be an integer from 0 to 2147483647; got -1"),
        (lambda: measure(Episode(ISLANDS, LEFT), "paper"),  # pyrefly: ignore
         "options must be a Options; got 'paper'"),
        (lambda: measure_online(Episode(ISLANDS, LEFT, (0, 0)), switch=True),
         "not '1/(t+1)', must be a finite number from 0 to 1; got True"),
        (lambda: measure(Episode(ISLANDS, LEFT, (0, 0))).likeliest(-1), "count must be an integer"),
        (lambda: Options(beta=1e9), "beta must be a finite number from 1 to 1e+08; got 1000"),
        (lambda: rule(4, 2**70), "beta must be a finite number from 1 to 1e+08; got 1180"),
        (lambda: Options(beta=10**400), "beta must be a finite number from 1 to 1e+08; got 1000"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(wrong, words):
    with pytest.raises(ValueError) as error:
        wrong()
    assert words in str(error.value)


def by_hand(cells, actions):
    return Trajectory(np.array(cells), np.array(actions))


def test_a_true_goal_may_be_an_array():
    """Its truth value was asked for, which an array lacks."""
    cell = (1, 0)
    given = measure(Episode(ISLANDS, LEFT, np.array(cell)))  # pyrefly: ignore
    assert given.agent == measure(Episode(ISLANDS, LEFT, cell)).agent


def test_cells_out_of_reach_are_no_goals():
    evidence = measure(Episode(ISLANDS, LEFT, (1, 0)))
    assert evidence.goals == ((0, 0), (1, 0), TRUE)
    kinds = of_every_cell(ISLANDS, False, "uniform").kinds
    unreachable = log_product(kinds[[0], [3]], log_table(rule(1)))[2:]
    assert (unreachable == -np.inf).all()


def test_steps_that_do_not_move_count_for_the_paper_alone():
    still = Episode(SMALL, SMALL.walk((0, 2), [0, 3, 0, 3]), (2, 2))
    moved = Episode(SMALL, SMALL.walk((0, 2), [3, 3]), (2, 2))
    assert measure(still, CALIBRATED).log_factor == measure(moved, CALIBRATED).log_factor
    assert measure(still, PAPER).log_agent < measure(moved, PAPER).log_agent - 1


def test_only_squares_where_goals_part_are_decisions():
    world = World.parse("..#.\n....\n..#.")  # right of the door the goals lie up and down
    episode = Episode(world, world.walk((0, 1), [3, 3, 3, 0]))
    goals = {"up": [(3, 2)], "down": [(3, 0)]}
    assert decisions(episode, goals, CALIBRATED) == 1
    evidence = measure_named([episode], [goals])
    assert evidence.likeliest()[0][0] == "up"


def test_the_preset_that_is_meant_for_real_policies_is_the_default():
    wall = Episode(SMALL, SMALL.walk((0, 2), [0, 3, 0, 3]), (2, 2))
    assert measure(wall).log_factor == measure(wall, CALIBRATED).log_factor
    assert measure_online(wall).agent[-1] == measure_online(wall, CALIBRATED).agent[-1]
