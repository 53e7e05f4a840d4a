"""Sweeps: what is set, what is trained once, and what the outcomes are of."""

import itertools
import json
import re
import shlex
from dataclasses import replace
from functools import wraps

import numpy as np
import polars as pl
import pytest

from astray.analysis.outcomes import MISGENERALIZED
from astray.analysis.runs import open_run, play_all
from astray.experiments import run as experiment_run
from astray.experiments.sweep import report
from astray.experiments.sweep import run as sweeping
from astray.experiments.sweep.report import command
from astray.experiments.sweep.run import run_sweep
from astray.experiments.sweep.settings import Sweep, axes
from astray.game import Shift
from astray.training.config import PRESETS, Config
from astray.training.loop import train
from astray.validation import read_value
from astray.world import register
from helpers.rooms import WORLD, walked
from helpers.thorough import thorough
from helpers.trainings import TINY

BASE = replace(TINY, knobs={"time_limit": 10}, steps=256)
TWO = {"learning_rate": [1e-4, 5e-4], "variant.time_limit": [10, 20]}


@pytest.fixture
def trained(monkeypatch):
    """The runs that a sweep trains, in this process."""
    runs = []

    def train_here(todo, *_):
        for run, config in todo.items():
            if not run.exists():
                runs.append(config)
                train(config, run, progress=False)

    monkeypatch.setattr(experiment_run, "train_all", train_here)
    return runs


def test_texts_are_settings_and_their_values():
    assert axes(["lr=1e-4,5e-4", "variant.region=1,3", "anneal=true,False", "variant=a,b-1"]) == {
        "learning_rate": [1e-4, 5e-4], "variant.region": [1, 3], "anneal": [True, False],
        "variant": ["a", "b-1"],
    }  # fmt: skip
    assert read_value("[" * 10**5) == "[" * 10**5
    read = axes(["map=1,true", "size=1"], {"map"})
    assert read == {"variant.map": ["1", "true"], "variant.size": [1]}


@pytest.mark.parametrize(
    "given, message",
    [
        (["lr"], "a sweep must set NAME=VALUE"),
        (["lr="], "a sweep must set NAME=VALUE"),
        (["lr=1", "learning_rate=2"], "once for each name"),
        (["seed=1,2"], "unknown setting or knob 'seed'; there are: game, variant"),
        (["colour=red"], "unknown setting or knob 'colour'"),
        (["variant.colour=1"], "unknown setting or knob 'colour'; there are"),
        (["variant=nowhere"], "unknown variant 'nowhere'"),
        (["width=8,8"], "width must take each value once"),
        (["teacher=ada"], "a sweep has no teachers; got teacher 'ada'"),
        (["width=wide"], "width must be of type int; got 'wide'"),
        ([], "must set something"),
        (["time_limit=20,1000000001"], "episodes of this variant last up to 1,000,000,001 steps"),
    ],
)
def test_what_cannot_be_swept_is_told_before_anything_is_trained(given, message):
    with pytest.raises(ValueError, match=message):
        Sweep(BASE, axes(given))


@pytest.mark.parametrize("given", [{"width": 8}, {"variant": "apart"}, {3: [1]}, ["width"]])
def test_axes_are_settings_with_several_values(given):
    with pytest.raises(ValueError, match="axes must be a "):
        Sweep(BASE, given)


def test_cells_are_all_combinations():
    cells = Sweep(BASE, TWO).cells()
    assert list(cells) == [(1e-4, 10), (1e-4, 20), (5e-4, 10), (5e-4, 20)]
    assert cells[5e-4, 20].learning_rate == 5e-4 and cells[5e-4, 20].knobs == {"time_limit": 20}


def test_outcomes_are_of_all_agents_and_repeat_what_an_evaluation_says(trained, tmp_path):
    page = run_sweep(Sweep(BASE, TWO, seeds=2, levels=20), tmp_path)
    assert len(trained) == 8 and page == tmp_path / "report.html"
    told = page.read_text()
    assert "by learning_rate and time_limit?" in told and "Reproduces" not in told
    assert re.search(r"least often with learning_rate \S+, time_limit \d+: ", told)
    assert "The extremes of 4 combinations differ by chance too" in told
    outcomes = pl.read_parquet(tmp_path / "outcomes.parquet")
    mine = outcomes.filter(policy="sampled")
    counts = mine.group_by(*TWO, "seed", "test").len()
    assert len(counts) == 16 and set(counts["len"]) == {20}
    one = replace(BASE, learning_rate=5e-4, knobs={"time_limit": 20}, seed=1)
    of_run = mine.filter(pl.col("run") == str(experiment_run.run_folder(tmp_path, one)))
    assert of_run.select(*TWO, "seed").unique().rows() == [(5e-4, 20, 1)]
    again = play_all(
        one.find_game(),
        "anywhere-small",
        one.variant_for("anywhere-small"),
        "corner-small",
        range(one.unseen_levels.start, one.unseen_levels.start + 20),
        [open_run(experiment_run.run_folder(tmp_path, one))[0]],
    ).filter(policy="sampled")
    tested = of_run.filter(test="in the test")
    assert tested["outcome"].to_list() == again["outcome"].to_list()
    rate = pl.read_csv(tmp_path / "rates.csv").filter(
        pl.col("learning_rate") == 5e-4,
        pl.col("variant.time_limit") == 20,
        policy="sampled",
        test="in the test",
        outcome=MISGENERALIZED,
    )
    part = mine.filter(
        pl.col("learning_rate") == 5e-4, pl.col("variant.time_limit") == 20, test="in the test"
    )
    assert rate["mean"][0] == pytest.approx((part["outcome"] == MISGENERALIZED).mean())
    assert rate["agents"][0] == 2
    figures = [path.name for path in (tmp_path / "figures").glob("*.png")]
    assert figures == ["learning-rate-variant-time-limit.png"]


@pytest.mark.usefixtures("undrawn")
def test_none_is_a_value_of_a_sweep_as_others_are(trained, tmp_path, monkeypatch):
    drawn = []
    curves = report.charts.curves
    monkeypatch.setattr(
        report.charts, "curves", lambda *a, **k: drawn.append(a[0]) or curves(*a, **k)
    )
    run_sweep(Sweep(BASE, {"groups": [None, 2]}, levels=3), tmp_path)
    assert len(trained) == 2 and {*drawn[0]["groups"]} == {"None", "2"}


@pytest.mark.usefixtures("undrawn")
def test_numbers_of_numpy_are_values_of_a_sweep(trained, tmp_path):
    run_sweep(Sweep(BASE, {"width": np.array([8, 16])}, *np.array([1, 3])), tmp_path)
    told = json.loads((tmp_path / "findings.json").read_text("utf-8"))["command"]
    assert [config.width for config in trained] == [8, 16] and "--set width=8,16 " in told


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_goes_on_and_takes_more_values(trained, tmp_path, monkeypatch):
    small = {"learning_rate": [1e-4, 5e-4]}
    run_sweep(Sweep(BASE, small, levels=5), tmp_path)
    first = pl.read_parquet(tmp_path / "outcomes.parquet")
    played = []
    noted = wraps(sweeping.play)(lambda *a, play=sweeping.play: played.append(a) or play(*a))
    monkeypatch.setattr(sweeping, "play", noted)
    run_sweep(Sweep(BASE, small, levels=5), tmp_path)
    assert len(trained) == 2 and not played
    assert pl.read_parquet(tmp_path / "outcomes.parquet").equals(first)
    run_sweep(Sweep(BASE, {"learning_rate": [1e-4, 5e-4, 1e-3]}, levels=5), tmp_path)
    assert len(trained) == 3 and len(played) == 1
    assert (tmp_path / "figures" / "learning-rate.png").exists()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    "base, changed",
    [
        (BASE, {"learning_rate": [1e-4, 1e-3]}),
        *thorough(
            (BASE, {"width": [8, 16]}), (replace(BASE, steps=512), {"learning_rate": [1e-4, 5e-4]})
        ),
    ],
)
def test_a_sweep_does_not_replace_the_outcomes_of_another(trained, tmp_path, base, changed):
    run_sweep(Sweep(BASE, {"learning_rate": [1e-4, 5e-4]}, levels=3), tmp_path)
    first = (tmp_path / "outcomes.parquet").read_bytes()
    with pytest.raises(FileExistsError, match=r"a sweep of other agents, .*0005.*; change `out`"):
        run_sweep(Sweep(base, changed, levels=3), tmp_path)
    assert (tmp_path / "outcomes.parquet").read_bytes() == first and len(trained) == 2


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_may_have_the_agents_of_another_among_its_own(trained, tmp_path):
    run_sweep(Sweep(BASE, {"learning_rate": [5e-4]}, levels=3), tmp_path)
    run_sweep(Sweep(BASE, {"learning_rate": [5e-4], "width": [BASE.width]}, 2, 3), tmp_path)
    assert len(trained) == 2


@pytest.mark.parametrize("name", ["report.html", "outcomes.parquet", "tables"])
def test_a_sweep_does_not_write_over_what_was_there(trained, tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(
        OSError, match=f"{name} was not written by astray, which would have sweep.json"
    ):
        run_sweep(Sweep(BASE, {"learning_rate": [1e-4]}, levels=3), tmp_path)
    assert (tmp_path / name).read_text() == "mine" and not trained


def test_three_settings_have_a_figure_for_each_pair():
    swept = Sweep(BASE, TWO | {"gamma": [0.9, 0.8], "clip": [0.3]}, levels=3)
    made = {"policy": "sampled", "seed": 0, "level": 7, "outcome": MISGENERALIZED}
    episodes = pl.DataFrame(
        {**dict(zip(swept.columns(), cell, strict=True)), **made, "test": test}
        for cell, test in itertools.product(swept.cells(), ("in training", "in the test"))
    )
    assert [plot.name for plot in report._plots(swept, episodes)] == [
        "learning-rate-variant-time-limit",
        "learning-rate-gamma",
        "variant-time-limit-gamma",
    ]


def test_a_knob_that_the_test_cannot_have_changes_the_training_alone():
    base = replace(BASE, validation=None)
    swept = Sweep(
        base, axes(["variant.placement=region", "variant.region=1,3", "variant.time_limit=30"])
    )
    for cell, config in swept.cells().items():
        tested = config.variant_for("anywhere-small")
        assert config.training_variant().region == cell[1] and tested.time_limit == 30
        assert tested.with_knobs({"time_limit": 100}) == config.find_game().variant(
            "anywhere-small"
        )


def test_knobs_of_the_test_go_together_in_any_order():
    knobs = ["variant.largest=15", "variant.smallest=9", "variant.world=15"]
    for some in itertools.permutations(knobs):
        (config,) = Sweep(replace(BASE, validation=None), axes(some)).cells().values()
        tested = config.variant_for("anywhere-small")
        assert (tested.world, tested.smallest, tested.largest) == (15, 9, 15)


@pytest.mark.usefixtures("undrawn")
def test_agents_whose_episodes_may_last_for_ever_are_swept_with_a_limit(trained, tmp_path):
    endless = {"variant.time_limit": [2**31 - 1]}
    with pytest.raises(ValueError, match="say `longest`"):
        Sweep(BASE, endless)
    run_sweep(Sweep(BASE, endless, levels=4, longest=7), tmp_path)
    assert pl.read_parquet(tmp_path / "outcomes.parquet")["length"].max() == 7


def test_a_tracker_that_cannot_be_used_is_told_before_anything_is_trained(trained, tmp_path):
    with pytest.raises(ValueError, match="unknown tracker 'wandbb'"):
        run_sweep(Sweep(BASE, TWO, levels=2), tmp_path, track="wandbb")
    assert not trained and not any(tmp_path.iterdir())


def test_axes_that_tables_have_themselves_keep_their_values(trained, tmp_path):
    swept = Sweep(BASE, {"levels": [100, 1000], "variant": ["corner-small"]}, levels=5)
    run_sweep(swept, tmp_path)
    table = pl.read_csv(tmp_path / "rates.csv")
    assert set(table["training_levels"]) == {100, 1000} and set(table["levels"]) == {5}
    figure = pl.read_parquet(tmp_path / "figures" / "training-levels.parquet")
    assert set(figure["training_levels"]) == {100, 1000}


@pytest.mark.usefixtures("undrawn")
def test_an_axis_leaves_a_measure_of_its_name_as_it_is(trained, tmp_path):
    register(world := replace(WORLD, name="room-of-steps", measures={"steps": walked}))
    base = Config(world, "end", steps=16, num_envs=2, num_steps=8, minibatches=1)
    run_sweep(Sweep(base, {"steps": [16, 32]}, levels=5, shift="end"), tmp_path)
    episodes = pl.read_parquet(tmp_path / "outcomes.parquet")
    assert (episodes["steps"] == episodes["length"]).all()
    assert set(episodes["training_steps"]) == {16, 32}


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_of_a_shift_without_proxies_tells_of_the_intended_goal(trained, tmp_path):
    shifts = {"end": Shift("end", "anywhere", "square", ())}
    register(world := replace(WORLD, name="room-of-one-goal", shifts=shifts))
    base = Config(world, "end", steps=16, num_envs=2, num_steps=8, minibatches=1)
    page = run_sweep(Sweep(base, {"learning_rate": [1e-4, 5e-4]}, levels=5), tmp_path)
    told = json.loads((page.parent / "findings.json").read_text("utf-8"))["answer"]
    assert told.startswith("“square” is reached first in the test equally often in each of 2")
    drawn = pl.read_parquet(tmp_path / "figures" / "learning-rate.parquet")
    assert {*drawn["what"]} == {"intended goal, in training", "intended goal, in the test"}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("values", "said"),
    [([1], "first in the test with "), ([1, 2, 3], "test equally often in each of 3 combinations")],
)
def test_a_sweep_whose_agents_are_alike_names_no_extremes(values, said, trained, tmp_path):
    sweep = Sweep(replace(BASE, steps=64), {"validation_every": values}, levels=5)
    run_sweep(sweep, tmp_path)
    told = json.loads((tmp_path / "findings.json").read_text("utf-8"))["answer"]
    assert said in told and "most often" not in told and "extremes" not in told


@pytest.mark.usefixtures("undrawn")
def test_the_verb_sweeps_what_it_is_given(astray, trained, tmp_path):
    words = [
        "sweep", "maze", "corner-small", "--steps", "256", "--num-envs", "16", "--num-steps",
        "16", "--minibatches", "4", "--width", "16", "--set", "lr=1e-4,5e-4", "--set",
        "variant.time_limit=20", "--num-test-levels", "5", "--out", tmp_path / "sweep",
    ]  # fmt: skip
    assert astray(*words).strip() == str(tmp_path / "sweep" / "report.html")
    told = json.loads((tmp_path / "sweep" / "findings.json").read_text("utf-8"))["command"]
    assert shlex.split(told) == ["astray", *map(str, words)]
    assert len(list((tmp_path / "sweep" / "agents").glob("*/seed-0/config.json"))) == 2
    assert {(one.learning_rate, one.width) for one in trained} == {(1e-4, 16), (5e-4, 16)}
    assert "unknown setting or knob 'colour'" in astray(*words, "--set", "colour=1", fails=True)


@pytest.mark.parametrize(
    "sweep",
    [
        Sweep(PRESETS["small"], {"gamma": [0.9, 0.99]}),
        Sweep(replace(BASE, knobs={}), TWO, seeds=3, levels=50, shift="corner-small"),
        Sweep(PRESETS["pixels"].changed(anneal=False, fused_cpu=False), {"width": [8]}),
        Sweep(replace(BASE, variant="corner", knobs={"time_limit": 9}), {"anneal": [True, False]}),
        Sweep(BASE, {"variant.time_limit": [2**31 - 1]}, longest=7),
    ],
    ids=["small", "own", "pixels", "knobs", "endless"],
)
def test_the_command_that_a_report_names_makes_the_sweep(sweep, astray, monkeypatch):
    made = []
    monkeypatch.setattr(sweeping, "run_sweep", lambda given, *_, **__: made.append(given))
    astray(*shlex.split(command(sweep))[1:])
    (again,) = made
    assert list(again.cells().values()) == list(sweep.cells().values())
    assert again == replace(sweep, base=again.base, axes=again.axes)
