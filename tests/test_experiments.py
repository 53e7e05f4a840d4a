"""Every experiment plans, and runs whole in miniature, stopped and repeated."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace

import polars as pl
import pytest

from astray import experiments, games
from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED, OUTCOMES
from astray.experiments import run
from astray.experiments.spec import SIZES, Claim, Study
from astray.experiments.tell import verdict
from astray.training import checkpoint

STUDIES = [name for name in experiments.NAMES if isinstance(experiments.load(name), Study)]
TRAINED = [name for name in experiments.NAMES if name not in STUDIES]
ALL = [(name, size) for name in TRAINED for size in SIZES]


@pytest.mark.parametrize("name, size", ALL)
def test_every_experiment_plans(name, size):
    plan = experiments.load(name).sizes[size]
    game = games.load(plan.config.game)
    shift = game.shifts[plan.shift]
    assert plan.config.variant == shift.train
    assert len({config.seed for config in run.configs(plan)}) == plan.seeds
    assert bool(plan.smaller) == (size != "paper")


def miniature(experiment):
    """Two agents of 2,048 steps, 20 levels."""
    plan = experiment.sizes["smoke"]
    config = replace(
        plan.config, steps=2048, environments=16, rollout=32, minibatches=4, width=16,
        checkpoint_every=1,
    )  # fmt: skip
    return replace(experiment, sizes={"smoke": replace(plan, config=config, seeds=2, levels=20)})


@pytest.mark.parametrize("name", TRAINED)
def test_every_experiment_runs_in_miniature(name, tmp_path, monkeypatch):
    small = miniature(experiments.load(name))
    monkeypatch.setattr(experiments, "load", lambda _: small)
    page = run.reproduce(name, "smoke", tmp_path, workers=2)
    assert page == tmp_path / "report.html"
    for file in ("outcomes.png", "outcomes.svg", "curves.png", "tables/outcomes.csv"):
        assert (tmp_path / file).stat().st_size > 0
    films = {path.stem for path in (tmp_path / "videos").glob("*.mp4")}
    assert films and films <= {outcome.replace(" ", "-") for outcome in OUTCOMES}
    assert len(json.loads((tmp_path / "verdicts.json").read_text())) == len(small.claims)
    shares = pl.read_parquet(tmp_path / "tables" / "outcomes.parquet")
    agents = shares.filter(policy="sampled")
    assert agents["agents"].unique().to_list() == [2]
    assert (
        agents.group_by("variant").agg(pl.col("mean").sum())["mean"].to_list()
        == [pytest.approx(1)] * 2
    )

    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*.safetensors")}
    (tmp_path / "report.html").unlink()
    run.reproduce(name, "smoke", tmp_path)  # nothing is trained again
    assert (tmp_path / "report.html").exists()
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_runs_in_miniature(name, tmp_path, monkeypatch):
    study = replace(experiments.load(name), sizes={"smoke": 8, "paper": 16})
    monkeypatch.setattr(experiments, "load", lambda _: study)
    page = run.reproduce(name, "smoke", tmp_path)
    assert "Smaller than in the paper" not in page.read_text()
    types = pl.read_parquet(tmp_path / "tables" / "types.parquet")
    assert (
        types.filter(type="robust")["trajectories"].to_list()
        == [8] * len(types["map"].unique()) * 2
    )
    assert (types["low"] <= types["log factor"]).all() and types["map"].n_unique() == 5
    assert (tmp_path / "trajectories.svg").exists() and (tmp_path / "factors.png").exists()


@pytest.mark.skipif(not hasattr(os, "kill") or os.name == "nt", reason="needs signals")
def test_trainings_end_with_the_experiment_that_began_them(tmp_path):
    words = [sys.executable, "-m", "astray", "reproduce", "maze-corner", "--folder", str(tmp_path)]
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    folder = tmp_path / "runs" / "seed-0"
    wait_for((folder / "metrics.jsonl").exists, 60)
    process.kill()
    process.wait()
    config = checkpoint.read_config(folder)

    def free():
        try:
            with checkpoint.claim(folder, config):
                return True
        except RuntimeError:
            return False

    wait_for(free, 20)


def wait_for(true, seconds):
    until = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < until
        time.sleep(0.1)


@pytest.mark.parametrize(
    "misgeneralized, failed, held", [(50, 10, True), (32, 30, False), (10, 50, False)]
)
def test_a_claim_holds_only_where_its_whole_interval_does(misgeneralized, failed, held):
    outcomes = [MISGENERALIZED] * misgeneralized + [FAILED] * failed
    outcomes += [INTENDED] * (100 - len(outcomes))
    episodes = pl.DataFrame(
        {"policy": "sampled", "where": "test", "seed": 0, "level": range(100), "outcome": outcomes}
    )
    claim = Claim("it goes astray", "test", MISGENERALIZED, above=0.0, minus=FAILED)
    told = verdict(claim, episodes)
    assert told.held == held
    assert f"{misgeneralized - failed}.0" in told.ours
