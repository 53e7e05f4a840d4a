"""Scores of uncertainty, compared with slow implementations."""

import numpy as np
import pytest
from scipy.spatial.distance import mahalanobis
from scipy.special import logsumexp, softmax
from scipy.stats import entropy

from astray import games
from astray.acting import Answer, beginnings, steps
from astray.analysis.outcomes import load_shift
from astray.analysis.policies import Walk
from astray.analysis.runs import load_agent
from astray.envs.vector import GameVectorEnv
from astray.level import Level
from astray.mitigation.uncertainty import (
    OF_LOGITS,
    Disagreement,
    GoalPosterior,
    distances,
    features,
    goal_splay,
    likeliest_rates,
)

MAZE = games.find("maze")
SHIFT = load_shift(MAZE, "corner-small")
CORNER, ANYWHERE = (
    MAZE.variant(name).with_knobs({"time_limit": 40}) for name in ("corner-small", "anywhere-small")
)
LEVELS = range(200_000, 200_040)


@pytest.fixture(scope="module")
def mouse():
    return load_agent("maze-corner")


def test_scores_of_logits_are_those_of_their_definitions():
    logits = np.random.default_rng(0).normal(size=(7, 15)) * 3
    p = softmax(logits, -1)
    first, second = np.sort(p, -1)[:, ::-1][:, :2].T
    naive = {
        "max probability": 1 - first,
        "margin": 1 - (first - second),
        "entropy": entropy(p, axis=-1),
        "energy": -logsumexp(logits, axis=-1),
        "max logit": -logits.max(-1),
    }
    assert naive.keys() == OF_LOGITS.keys()
    for name, expected in naive.items():
        assert OF_LOGITS[name](logits) == pytest.approx(expected), name


def test_every_score_is_higher_for_a_policy_that_knows_nothing(mouse):
    sure, unsure = np.zeros((1, 15)), np.zeros((1, 15))
    sure[0, 3] = 20
    for name, score in OF_LOGITS.items():
        assert score(unsure)[0] > score(sure)[0], name


def test_agents_that_are_the_same_do_not_disagree_and_others_do(mouse):
    env = GameVectorEnv("maze", "anywhere-small", 8, observation="symbolic")
    seen, _ = env.reset(seed=0)
    assert Disagreement([mouse, mouse])(env, seen) == pytest.approx(0)
    p = softmax(mouse.outputs(seen)[0].double().numpy(), -1)

    class Other:
        def outputs(self, observations):
            import torch

            return torch.zeros((len(observations), 15)), None

    even = np.full_like(p, 1 / 15)
    naive = entropy((p + even) / 2, axis=1) - (entropy(p, axis=1) + entropy(even, axis=1)) / 2
    assert Disagreement([mouse, Other()])(env, seen) == pytest.approx(naive)
    with pytest.raises(ValueError, match="two agents at least; got 1"):
        Disagreement([mouse])


def test_distances_are_those_of_scipy_from_the_training_frames(mouse):
    fitted, plain = distances(mouse, CORNER, LEVELS)
    frames = np.concatenate([s.observations for s in steps(mouse, "maze", CORNER, LEVELS)])
    seen = features(mouse, frames)
    covariance = np.cov(seen.T)
    inverse = np.linalg.inv(
        covariance + 1e-3 * np.diag(covariance).mean() * np.eye(len(covariance))
    )
    env = GameVectorEnv("maze", ANYWHERE, 5, observation="symbolic")
    shown, _ = env.reset(seed=0)
    naive = [mahalanobis(x, seen.mean(0), inverse) for x in features(mouse, shown)]
    assert fitted(env, shown) == pytest.approx(naive, rel=1e-4)
    away = np.linalg.norm(features(mouse, shown) - seen.mean(0), axis=1)
    assert plain(env, shown) == pytest.approx(away)


def test_a_mouse_of_the_corner_is_astray_where_one_of_the_cheese_is_not(mouse):
    env = GameVectorEnv("maze", ANYWHERE, 12, observation="symbolic")
    seen, _ = env.reset(seed=0, options={"level": np.arange(200_000, 200_012)})
    of_corner = GoalPosterior(mouse, SHIFT, "misgeneralization")
    of_cheese = GoalPosterior(Walk("cheese"), SHIFT, "misgeneralization")
    one, two = of_corner(env, seen), of_cheese(env, seen)
    assert np.median(one) > 0.8 and np.median(one) > np.median(two) + 0.2
    assert of_corner.imagined == 12
    assert (of_corner(env, seen) == one).all() and of_corner.imagined == 12  # known by now


@pytest.mark.parametrize("kind", ["entropy", "misgeneralization"])
def test_what_a_level_is_foretold_is_the_same_whatever_is_played_beside_it(mouse, kind):
    env = GameVectorEnv("maze", ANYWHERE, 3, observation="symbolic")
    seen, _ = env.reset(seed=0, options={"level": np.array([200_000, 200_001, 200_002])})
    three = GoalPosterior(mouse, SHIFT, kind, cells=4)(env, seen)
    alone = GameVectorEnv("maze", ANYWHERE, 1, observation="symbolic")
    shown, _ = alone.reset(seed=0, options={"level": 200_002})
    assert three[2] == GoalPosterior(mouse, SHIFT, kind, cells=4)(alone, shown)[0]


DRAWN = """\
#######
#######
##.G@##
##.#.##
##.#.##
#######
#######
"""


def test_levels_of_one_number_with_other_walls_are_foretold_each(mouse):
    env, score = (
        GameVectorEnv("maze", ANYWHERE, 1, observation="symbolic"),
        GoalPosterior(mouse, SHIFT, "misgeneralization"),
    )
    for imagined, drawing in enumerate((DRAWN, DRAWN.replace(".#.", "..."), DRAWN), 1):
        level = Level.from_text(MAZE, ANYWHERE, drawing)
        _, begin = beginnings({"one": level}, MAZE.state)
        seen, _ = env.reset(seed=0, options={"state": begin})
        assert 0 < score(env, seen)[0] < 1
        assert score.imagined == min(imagined, 2)


def test_levels_of_one_number_that_begin_elsewhere_or_end_sooner_are_foretold_each(mouse):
    below = DRAWN.replace("G@", "G.").replace(".#.##\n#######\n", ".#@##\n#######\n", 1)
    score = GoalPosterior(mouse, SHIFT, "misgeneralization")
    for drawing, limit in ((DRAWN, 50), (below, 50), (DRAWN, 50), (DRAWN, 1)):
        variant = ANYWHERE.with_knobs({"time_limit": limit})
        env = GameVectorEnv("maze", variant, 1, observation="symbolic")
        _, begin = beginnings({"one": Level.from_text(MAZE, variant, drawing)}, MAZE.state)
        seen, _ = env.reset(seed=0, options={"state": begin})
        alone = GoalPosterior(mouse, SHIFT, "misgeneralization")(env, seen)
        assert score(env, seen) == alone == score(env, env.step(np.zeros(1, int))[0])


def test_nobody_goes_astray_where_there_is_no_corner(mouse):
    cornerless = Level.from_text(MAZE, ANYWHERE, DRAWN.replace("#######", ".######", 1))
    env = GameVectorEnv("maze", ANYWHERE, 1, observation="symbolic")
    _, begin = beginnings({"one": cornerless}, MAZE.state)
    seen, _ = env.reset(seed=0, options={"state": begin})
    assert GoalPosterior(mouse, SHIFT, "misgeneralization")(env, seen) == 0


def test_features_are_the_same_whatever_stands_beside_them(mouse):
    frames = np.concatenate([s.observations for s in steps(mouse, "maze", CORNER, LEVELS)])
    together = features(mouse, frames[:50])
    alone = np.concatenate([features(mouse, frames[k : k + 1]) for k in range(50)])
    assert (together == alone).all()


def test_the_likeliest_rates_are_those_of_a_search():
    evidence = np.random.default_rng(0).normal(size=(20, 2)) * 2
    rates = np.linspace(1e-6, 1 - 1e-6, 10_001)
    total = logsumexp(evidence[..., None] + np.log([rates, 1 - rates]), axis=1).sum(0)
    assert likeliest_rates(evidence)[0] == pytest.approx(rates[np.argmax(total)], abs=2e-3)


class Torn(Walk):
    """Walks to the cheese in levels of odd numbers, to the corner in the others."""

    def __init__(self):
        super().__init__("cheese")
        self.corner = Walk("corner")

    def actions(self, turn):
        to_cheese, to_corner = (w(turn).actions for w in (super().actions, self.corner.actions))
        return Answer(np.where(turn.env.states["level"] % 2, to_cheese, to_corner))


def test_the_entropy_under_a_splay_is_low_for_who_knows_what_it_wants():
    variant = MAZE.variant("anywhere-easy").with_knobs({"time_limit": 40})
    env = GameVectorEnv("maze", variant, 2, observation="symbolic")
    seen, _ = env.reset(seed=0, options={"level": np.array([200_000, 200_001])})
    shift = load_shift(MAZE, "corner-easy")
    decided, torn = GoalPosterior(Walk("corner"), shift), GoalPosterior(Torn(), shift)
    assert decided(env, seen).mean() < torn(env, seen).mean() - 0.2
    assert 2 * 6 <= decided.imagined <= 2 * 12


def test_a_cheese_is_splayed_from_its_dish_which_stays():
    env = GameVectorEnv("maze", "dish-small", 1, observation="symbolic")
    env.reset(seed=0, options={"level": 3})
    level = Level.of(MAZE, env.variant, env.states[0])
    (at,) = level.where("goal on other")
    family = goal_splay(level)
    assert all(one.where("other") == [at] for one in family)
    assert len({one.where("goal")[0] for one in family}) == len(family) > 5
