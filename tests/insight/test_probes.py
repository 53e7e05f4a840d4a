"""Probes beside what is known to be there, and known not to be."""

import sys

import numpy as np
import polars as pl
import pytest
from sklearn.metrics import balanced_accuracy_score, r2_score

from astray import games, load_agent
from astray.acting import initial_states
from astray.games.coinrun import edits as coin_edits
from astray.games.coinrun import measures as coin_measures
from astray.games.coinrun.rules import COIN
from astray.games.keys import rules
from astray.games.maze import measures
from astray.insight import probes
from astray.insight.fields import splay
from astray.level import Level
from astray.training import folders
from helpers.looked_into import ROOM
from helpers.thorough import thorough

MAZE, COINRUN = games.find("maze"), games.find("coinrun")
SMALL = MAZE.variant("anywhere-small")


@pytest.fixture(scope="module")
def mouse():
    return load_agent(folders.find("maze-corner"))


@pytest.fixture(scope="module")
def states():
    return initial_states("maze", SMALL, range(200_000, 200_400))


def test_a_linear_truth_is_read_and_noise_is_not():
    random = np.random.default_rng(0)
    x = random.normal(size=(600, 40)).astype(np.float32)
    learn = np.arange(600) % 3 > 0
    assert probes.fit(x, (x[:, 0] > 0).astype(int), learn, 0) > 0.9
    assert 0.35 < probes.fit(x, random.integers(0, 2, 600), learn, 0) < 0.65
    assert probes.fit(x, 3 * x[:, 1] - x[:, 2], learn, 0) > 0.99
    assert probes.fit(x, random.normal(size=600), learn, 0) < 0.1


def test_a_layer_in_which_nothing_varies_tells_what_is_known_without_looking():
    flat, learn = np.ones((90, 5), np.float32), np.arange(90) % 2 > 0
    assert probes.fit(flat, np.arange(90) % 3, learn, 0) == pytest.approx(1 / 3)
    assert probes.fit(flat, np.arange(90.0), learn, 0) == pytest.approx(0, abs=0.01)


def test_no_level_is_in_both_parts_of_a_split():
    levels = np.repeat(np.arange(50), 4)
    learn = probes.split(levels, 3)
    assert not set(levels[learn]) & set(levels[~learn])
    assert len(set(levels[~learn])) == 15
    assert (learn != probes.split(levels, 4)).any()
    with pytest.raises(ValueError, match="at least two levels"):
        probes.split(np.zeros(5, int), 0)


def test_probes_find_the_cheese_in_the_observation_and_not_in_shuffled_labels(mouse, states):
    labels = {
        "cheese right": MAZE.labels["cheese right"],
        "corner direction": MAZE.labels["corner direction"],
    }
    found = probes.probe(mouse, SMALL, states, ["features.relu1"], labels, folds=2)
    assert found.height == 2 * 2
    rows = {(row["label"], row["layer"]): row for row in found.to_dicts()}
    seen = rows["cheese right", probes.SEEN]
    assert seen["score low"] > 0.3 and seen["shuffled"] < 0.15
    assert seen["untrained"] is None and seen["gain high"] is None
    inner = rows["corner direction", "features.relu1"]
    assert inner["score low"] > inner["chance"] + 0.2
    assert inner["selectivity"] == pytest.approx(inner["score"] - inner["shuffled"])
    assert inner["gain"] == pytest.approx(inner["score"] - inner["untrained"])


def test_what_only_the_levels_of_one_fold_have_is_left_out(mouse):
    states = np.repeat(initial_states("maze", SMALL, range(200_000, 200_012)), 24)
    one, side = states["level"] == 200_005, np.arange(len(states)) % 2
    labels = {
        "rare class": lambda s: np.where(one, 2, side),
        "rare label": lambda s: np.where(one, side, -1),
        "rare number": lambda s: np.where(one, side + 0.5, np.nan),
    }
    found = probes.probe(mouse, SMALL, states, ["features.relu1"], labels, folds=3)
    assert {*found["label"]} == {"rare class"} and found["chance"][0] == 1 / 2
    assert found["states"][0] == np.count_nonzero(~one) and found["levels"][0] == 11
    with pytest.raises(ValueError, match="no label of rare has two classes"):
        probes.probe(mouse, SMALL, states, ["features.relu1"], {"rare": lambda s: one}, folds=3)


def test_the_interval_of_a_score_is_over_levels():
    """As scores of levels that are drawn again vary; here the states of a level go together."""
    random = np.random.default_rng(0)
    levels = np.repeat(np.arange(100), 5)
    y = random.integers(0, 2, 500)
    told = np.where(random.random(100)[levels] < 0.8, y, 1 - y)
    values = probes.by_level(y, told, levels)
    assert values.mean() == pytest.approx(balanced_accuracy_score(y, told))
    again = []
    for _ in range(1000):
        some = np.arange(500).reshape(100, 5)[random.integers(100, size=100)].ravel()
        right = y[some] == told[some]
        again.append(np.mean([right[y[some] == k].mean() for k in (0, 1)]))
    assert values.std() / 10 == pytest.approx(np.std(again), rel=0.1)
    numbers = random.normal(size=500) + levels / 30
    guess = numbers + random.normal(0, 0.5, 500)
    values = probes.by_level(numbers, guess, levels)
    assert values.mean() == pytest.approx(r2_score(numbers, guess))


@pytest.mark.parametrize("count, few", [(50, 3), *thorough((50, 15), (200, 5))])
def test_a_score_holds_the_truth_where_a_class_is_in_few_levels(count, few):
    """All told right, or not, in these few: 34 to 90 of 100 held it."""
    random, every, some = np.random.default_rng(count), np.repeat(np.arange(count), 20), []
    levels = np.r_[every, np.repeat(np.arange(few), 10)]
    y = (np.arange(len(levels)) >= len(every)).astype(int)
    for most, least in ((0.99, 0.8), (0.9, 0.9), (1, 0.95)):
        for _ in range(300):
            often = random.beta(0.5 * most, 0.5 * (1 - most) or 1e-9, count)
            seldom = random.beta(0.5 * least, 0.5 * (1 - least), few)
            chance = np.r_[often[every], np.repeat(seldom, 10)]
            found = probes.score(y, np.where(random.random(len(y)) < chance, y, 1 - y), levels)
            some.append(found.low <= (most + least) / 2 <= found.high)
    assert np.mean(some) >= 0.92


@pytest.mark.parametrize("count", [5, 20])
def test_numbers_of_few_levels_that_differ_are_covered_less_often(count):
    """As docs/evaluation.md says."""
    random, levels = np.random.default_rng(count), np.repeat(np.arange(count), 20)
    of_levels = random.normal(0, [[3], [1]], (500, 2, count))
    within = random.normal(0, 1, (2, 500, len(levels)))
    y = of_levels[:, 0, levels] + within[0]
    told = y + of_levels[:, 1, levels] + within[1] / 2
    found = [probes.score(*both, levels) for both in zip(y, told, strict=True)]
    assert 0.84 <= np.mean([one.low <= 1 - 1.25 / 10 <= one.high for one in found]) <= 0.95


def test_what_a_network_gains_is_less_certain_where_a_class_is_in_few_levels(monkeypatch):
    random = np.random.default_rng(1)
    levels = np.repeat(np.arange(60), 20)
    x, fold = random.normal(size=(1200, 1)), levels % 3
    for few, wider in ((60, 1), (3, 2.1)):  # Student's quantiles of 2 and of 59 degrees of freedom
        y = (levels < few) & (random.random(1200) < 0.5)
        told = probes._told(x, [x] * 3, y, levels, fold)
        with monkeypatch.context() as patch:
            patch.setattr(probes, "quantile", lambda freedom: 1.0)
            before = probes._told(x, [x] * 3, y, levels, fold)
        widths = [one["selectivity high"] - one["selectivity low"] for one in (told, before)]
        assert widths[0] / widths[1] == pytest.approx(wider, rel=0.1)


def test_no_interval_of_a_score_exceeds_1():
    random = np.random.default_rng(0)
    levels, y = np.repeat(np.arange(8), 20), random.normal(size=160)
    x = y[:, None] + random.normal(0, 0.1, (160, 1)) * (levels == 3)[:, None]
    told = probes._told(x, [None, None], y, levels, levels % 2)
    assert told["score low"] < told["score"] < told["score high"] == 1 < told["selectivity high"]


def test_every_level_is_told_by_a_probe_that_did_not_see_it():
    fold = probes._folds(levels := np.repeat(np.arange(23), 3), 5)
    assert [len(set(levels[fold == k])) for k in range(5)] in ([5, 5, 5, 4, 4],)
    assert all(len(set(fold[levels == k])) == 1 for k in range(23))
    with pytest.raises(ValueError, match="at least 5 levels; got 2"):
        probes._folds(np.array([1, 1, 2]), 5)


def test_an_untrained_network_is_another_of_the_same_shape(mouse):
    one, other, again = (probes.untrained(mouse, seed) for seed in (0, 1, 0))
    first, second, third = (a.network.features.linear1.weight for a in (one, other, again))
    assert first.shape == mouse.network.features.linear1.weight.shape
    assert (first == third).all() and (first != second).any()
    assert (mouse.network.features.linear1.weight != first).any()


def test_what_has_no_label_does_not_count(mouse, states):
    def sometimes(s):
        return np.where(s["level"] % 2 == 0, s["goal_x"].astype(float), np.nan)

    def classes(s):
        return np.where(s["level"] % 4 == 0, -1, s["level"] % 2)

    found = probes.probe(
        mouse,
        SMALL,
        states,
        ["features.relu2"],
        {"sometimes": sometimes, "classes": classes},
        folds=2,
    )
    told = found.filter(layer="features.relu2")
    assert dict(zip(told["label"], told["states"], strict=True)) == {
        "sometimes": 200,
        "classes": 300,
    }
    with pytest.raises(ValueError, match="no label of never has two classes"):
        probes.probe(mouse, SMALL, states, ["features.relu2"], {"never": lambda s: s["level"] < 0})


def test_a_reading_stands_beside_the_truth(mouse, states):
    given = (mouse, SMALL, states, states[:1], ["features.relu1"])
    table = pl.DataFrame([*probes.readings(*given, MAZE.labels)])
    row = table.filter(label="cheese steps").row(0, named=True)
    assert row["true"] == measures.steps(states[:1], "cheese")[0]
    columns = {"label", "layer", "read", "true", "read as", "true as", "score"}
    assert set(table.columns) == columns
    with pytest.raises(ValueError, match="a label needs two classes of 20 states, or 20 numbers"):
        next(probes.readings(*given, {"never": lambda s: s["level"] < 0}))


def test_no_reading_has_a_score_in_states_where_its_label_is_one_number(mouse, states):
    learn = probes.split(states["level"], 0)
    some = states["level"][learn][:30]
    seldom = {"seldom": lambda s: np.where(np.isin(s["level"], some), 2, 0.3)}
    given = (mouse, SMALL, states, states[:1], ["features.relu1"])
    with pytest.raises(ValueError, match="a label needs two classes of 20 states, or 20 numbers"):
        next(probes.readings(*given, seldom))
    kept = [row["label"] for row in probes.readings(*given, {**MAZE.labels, **seldom})]
    assert kept == list(MAZE.labels)


def test_without_scikit_learn_it_is_told_what_to_install(mouse, states, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn", None)
    with pytest.raises(ImportError, match=r'pip install ".\[insight\]"'):
        probes.probe(mouse, SMALL, states, ["features.relu1"], MAZE.labels)


def test_labels_of_mazes_are_where_things_are():
    level = Level.from_text(MAZE, SMALL, ROOM.replace("#G", "#.").replace(".#...#.", ".#G..#."))
    at = {tuple(np.floor([s["x"], s["y"]]).astype(int)): s for s in splay(level)}
    s = np.array([at[6, 6]])
    assert measures.offset(s, "cheese", 0)[0] == -4 and measures.offset(s, "cheese", 1)[0] == -2
    assert measures.steps(s, "corner")[0] == 0
    assert measures.direction(s, "corner")[0] == measures.NONE
    assert measures.direction(s, "cheese")[0] == 2, "down"
    gone = np.array([level.removed("goal").state(solvable=False)], MAZE.state)
    assert np.isnan(measures.steps(gone, "cheese")[0]) and measures.direction(gone, "cheese") == -1


def test_ways_part_in_the_decision_square():
    level = Level.from_text(MAZE, SMALL, ROOM.replace("#G", "#.").replace(".#.....", ".#....G"))
    s = level.state()
    assert measures.way(s, "cheese")[-1] == (6, 2) and measures.decision(s) is None
    apart = Level.from_text(MAZE, SMALL, ROOM.replace("#G", "#.").replace("@......", "@.....G"))
    s = np.array([apart.state()], MAZE.state)
    assert measures.decision(apart.state()) == (5, 0)
    found = {name: value[0] for name, value in measures.features(s).items()}
    assert found["cheese to decision square, steps"] == 1
    assert found["start to decision square, steps"] == 5
    assert found["cheese to corner, straight"] == 6
    assert found["corner to decision square, straight"] == pytest.approx(np.hypot(1, 6))
    assert found["cheese to 5 x 5 corner, straight"] == 2


def test_labels_of_coinrun_are_what_is_in_view():
    states = initial_states("coinrun", "coin-anywhere", range(200))
    seen = coin_measures.coin_in_view(states)
    right, up = (coin_measures.coin_offset(states, axis) for axis in "xy")
    assert (np.isfinite(right) == seen).all() and (np.isfinite(up) == seen).all()
    k = int(np.flatnonzero(seen)[0])
    s = states[k]
    assert right[k] == pytest.approx(s["coin_x"] + 0.5 - s["x"])
    wall = coin_measures.wall_in_view(states)
    assert (coin_measures.to_wall(states)[wall] < 7).all()
    calm = initial_states("coinrun", "coin-end-calm", range(20))
    states["x"], calm["x"] = 12.5, 12.5
    assert not coin_measures.hazard_ahead(calm).any()
    assert 0 < coin_measures.hazard_ahead(states).mean() < 1
    assert set(COINRUN.labels) >= {"coin in view", "end wall in view"}


def test_a_coin_out_of_view_is_not_where_the_coin_in_view_is():
    states = coin_edits.without_coin(initial_states("coinrun", "coin-end", [0]))
    x, y = states["x"][0], states["y"][0]
    (corner, beside) = (int(x) + 6, int(y) + 6), (int(x) + 8, int(y))  # a window of 13 cells a side
    for column, row in (corner, beside):
        states["cell"][0, row, column] = COIN
    right, up = (coin_measures.coin_offset(states, axis)[0] for axis in "xy")
    assert np.hypot(right, up) > beside[0] + 0.5 - x  # it is the farther one of the two
    assert (right, up) == (corner[0] + 0.5 - x, corner[1] + 0.5 - y)


def test_the_nearest_key_is_told():
    states = initial_states("keys", "many-keys", range(30))
    near = games.find("keys").labels["nearest key"](states)
    right = games.find("keys").labels["nearest key right"](states)
    for s, quarter, dx in zip(states, near, right, strict=True):
        keys = s["what"][: s["objects"]] == rules.KEY
        away = np.stack(
            [s["object_x"][: s["objects"]] - s["x"], s["object_y"][: s["objects"]] - s["y"]]
        )[:, keys]
        best = away[:, np.hypot(*away).argmin()]
        assert dx == pytest.approx(best[0]) and quarter == (best[0] > 0) + 2 * (best[1] > 0)
    assert isinstance(near, np.ndarray) and pl.Series(near).n_unique() > 1


def test_a_reading_of_nothing_has_no_sign():
    assert probes._as_text(lambda s: s, np.dtype(float), -0.04) == "0.0"


@pytest.mark.parametrize("value", [0.3, 2.0])
def test_a_label_of_equal_reals_is_left_out(mouse, states, value):
    same = {"same": lambda s: np.full(len(s), value)}  # the deviation of 0.3 is 1e-16
    with pytest.raises(ValueError, match="no label of same"):
        probes.probe(mouse, "anywhere-small", states, ["features.relu1"], same)
