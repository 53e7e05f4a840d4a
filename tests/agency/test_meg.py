"""Maximum entropy goal-directedness, against closed forms and the sum that defines it."""

import numpy as np
import pytest
from scipy.special import softmax

from astray.agency.gridworld import World
from astray.agency.meg import Process, goal_directedness

CHOICE = Process(np.array([[1, 2], [1, 1], [2, 2]]), np.array([[1, 1], [0, 0], [0, 0]], bool), 0)


def of_world(text, start, discount=0.9):
    world = World.parse(text)
    return world, Process(world.after, np.ones_like(world.legal), world.number(start), discount)


def erring(world, goal, eps):
    """Shortest ways to a goal, all actions alike with probability eps."""
    away = world.distance[:, goal]
    best = away[world.after] == away[:, None] - 1
    best[goal] = True
    return (1 - eps) * best / best.sum(1, keepdims=True) + eps / best.shape[1]


@pytest.mark.parametrize("p", [0.5, 0.6, 0.9, 0.999])
def test_one_decision_is_the_log_of_two_minus_the_entropy(p):
    policy = np.array([[p, 1 - p], [0.5, 0.5], [0.5, 0.5]])
    entropy = -p * np.log(p) - (1 - p) * np.log(1 - p)
    measured = goal_directedness(CHOICE, policy, 1)
    assert measured.nats == pytest.approx(np.log(2) - entropy, abs=1e-6)
    assert measured.most == pytest.approx(np.log(2), abs=1e-6)
    assert goal_directedness(CHOICE, policy, 2).nats == 0  # it avoids the other


def test_it_is_the_discounted_sum_of_log_ratios_for_the_best_rationality():
    world, process = of_world("....\n.#..\n....", (0, 0))
    goal, discount = world.number((3, 2)), process.discount
    rng = np.random.default_rng(0)
    policy = 0.7 * erring(world, goal, 0.2) + 0.3 * rng.dirichlet(np.ones(4), len(world))
    ending = process.ending_in(goal)
    moves = np.zeros((len(world),) * 2)
    np.add.at(
        moves, (np.arange(len(world))[:, None], world.after), np.where(ending.possible, policy, 0)
    )
    visits = np.linalg.solve(
        np.eye(len(world)) - discount * moves.T, np.eye(len(world))[process.start]
    )

    def sum_of(beta):
        value = np.zeros(len(world))
        for _ in range(100):
            gain = beta * (world.after == goal) + discount * value[world.after]
            value = np.log(np.exp(gain).mean(1))
            value[goal] = 0
        ratio = np.log(softmax(gain, axis=1)) - np.log(1 / 4)
        per_state = (policy * ratio).sum(1)
        return sum(visits[s] * per_state[s] for s in range(len(world)) if s != goal)

    slow = max(sum_of(beta) for beta in np.geomspace(0.1, 100, 150))
    assert goal_directedness(process, policy, goal).nats == pytest.approx(slow, abs=1e-3)


def test_the_more_a_policy_errs_the_less_it_is_directed():
    cliff = "\n".join(["." * 10] * 4)
    world, process = of_world(cliff, (0, 0))
    goal = world.number((9, 0))
    found = [
        goal_directedness(process, erring(world, goal, eps), goal) for eps in (0, 0.1, 0.3, 0.7, 1)
    ]
    assert np.all(np.diff([one.nats for one in found]) < 0)
    assert found[0].fraction == pytest.approx(1, abs=1e-3) and found[-1].nats < 1e-6
    assert np.isinf(found[0].beta) and np.isfinite(found[2].beta)


def test_a_goal_with_no_way_is_pursued_by_none():
    world, process = of_world("..#.", (0, 0))
    measured = goal_directedness(process, np.full((3, 4), 0.25), world.number((3, 0)))
    assert measured.nats == measured.most == 0 and np.isnan(measured.fraction)


@pytest.mark.parametrize(
    "policy, goal, words",
    [
        (np.ones((3, 2)), 1, "must be probabilities that sum to 1"),
        (np.array([[1.5, -0.5], [0.5, 0.5], [0.5, 0.5]]), 1, "must be probabilities"),
        (np.ones((2, 2)) / 2, 1, r"policy must be \(3, 2\)"),
        (np.ones((3, 2)) / 2, 3, "goal must be an integer from 0 to 2; got 3"),
        (np.ones((3, 2)) / 2, 0.5, "goal must be an integer from 0 to 2; got 0.5"),
    ],
)
def test_what_is_no_policy_is_refused(policy, goal, words):
    with pytest.raises(ValueError, match=words):
        goal_directedness(CHOICE, policy, goal)


@pytest.mark.parametrize("discount", [0.9999, 1 - 1e-6])
def test_a_discount_near_one_takes_no_longer(discount):
    world, process = of_world("....\n.#..\n....", (0, 0), discount)
    goal = world.number((3, 2))
    patient = of_world("....\n.#..\n....", (0, 0), 0.999)[1]
    policy = erring(world, goal, 0.3)
    found = [goal_directedness(one, policy, goal).nats for one in (patient, process)]
    assert found[1] == pytest.approx(found[0], rel=1e-2)


def test_an_optimal_policy_has_all_nats_where_the_goal_is_far_and_later_steps_hardly_count():
    world, process = of_world("." * 30, (0, 0), discount=0.5)
    goal = world.number((29, 0))
    sure = erring(world, goal, 0)
    best = goal_directedness(process, sure, goal)
    bits = np.log(4) * (1 - 0.5**29) / (1 - 0.5)  # each step takes one of four actions
    assert best.nats == pytest.approx(bits, rel=1e-6) and np.isinf(best.beta)
    rare = goal_directedness(process, erring(world, goal, 0.3), goal)
    assert 0 < rare.nats < 0.1 * best.nats and np.isfinite(rare.beta)


def test_what_is_no_process_is_refused():
    with pytest.raises(ValueError, match="after must be states from 0 to 0"):
        Process(np.array([[1]]), np.array([[True]]), 0)
    for discount in (0, 1, 1 - 1e-13):
        with pytest.raises(ValueError, match="discount must be above 0 and below 1; got"):
            Process(np.array([[0]]), np.array([[True]]), 0, discount=discount)
    with pytest.raises(ValueError, match="process must be a Process; got 3"):
        goal_directedness(3, np.ones((1, 1)), 0)  # pyrefly: ignore
    for possible in ([[2, 1]] * 2, [[np.nan, 1]] * 2, [[0.5, 1]] * 2):  # weights, or no end of work
        with pytest.raises(ValueError, match="possible must be booleans; got"):
            Process(np.array([[0, 1]] * 2), np.array(possible), 0)
    for start in (0.5, True, "0", None):
        with pytest.raises(ValueError, match="start must be an integer from 0 to 1; got"):
            Process(np.array([[0, 1]] * 2), np.ones((2, 2), bool), start)  # pyrefly: ignore


def test_the_last_state_may_be_one_to_which_no_action_leads():
    process = Process(CHOICE.after[[1, 2, 0]] - 1, CHOICE.possible[[1, 2, 0]], 2)
    policy = np.array([[0.5, 0.5], [0.5, 0.5], [0.9, 0.1]])
    there = goal_directedness(CHOICE, policy[[2, 0, 1]], 1)
    assert goal_directedness(process, policy, 0).nats == pytest.approx(there.nats)


def test_where_an_impossible_action_would_lead_does_not_matter():
    after = np.stack([np.minimum(np.arange(20) + 1, 19), np.arange(20)], 1)  # on, or stay
    possible, policy = np.ones((20, 2), bool), np.tile([0.9, 0.1], (20, 1))
    possible[0, 1], policy[0] = False, (1, 0)
    elsewhere = goal_directedness(Process(after, possible, 0), policy, 19)
    after[0, 1] = 19
    assert goal_directedness(Process(after, possible, 0), policy, 19) == elsewhere
    assert 0 < elsewhere.fraction < 1
