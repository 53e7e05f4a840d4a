"""Studies of published agents, as far as they go without their files."""

import hashlib
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray.analysis.adapters import Function
from astray.analysis.critic import visit
from astray.analysis.estimates import mean_of
from astray.analysis.evaluate import evaluate
from astray.analysis.runs import open_run
from astray.experiments import catalogue, run
from astray.experiments.levels import levels_of
from astray.experiments.studies.coinrun import _agents, critic_value, moved_coin, published_results
from astray.experiments.studies.maze import cheese_mouse
from astray.published import catalogue as published
from astray.published.results import read_results
from astray.report import page as report
from astray.report.claims import Claim
from astray.report.findings import Findings, Heading
from astray.training import folders
from astray.training.config import PRESETS
from helpers.miniature import miniature, train_here

HEADER = "seed,steps,rand_coin,coin_collected,inv_coin_collected,died,timed_out\n"
BLIND = Function(lambda seen: np.full(len(seen), 8), "right and jump", "symbolic")


def work_on(levels):
    plan = replace(moved_coin.EXPERIMENT.sizes["published"], levels=levels)
    return SimpleNamespace(plan=plan, runs={})


def test_an_agent_that_is_not_here_is_told_with_what_brings_it(tmp_path, monkeypatch):
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    for study in ("moved-coin", "critic-value", "permeable-wall", "attribution"):
        with pytest.raises(ValueError, match="astray agents fetch openai-coinrun, and the pictur"):
            run.reproduce(study, "published", tmp_path / "reports")
    with pytest.raises(ValueError, match="not here; to bring it: astray agents fetch paper-coinr"):
        run.reproduce("published-results", "published", tmp_path / "reports")


def test_published_agents_play_the_numbering_that_they_were_trained_in():
    plan = moved_coin.EXPERIMENT.sizes["published"]
    found = {name: test.variant_for(plan.config) for name, test in moved_coin.TESTS.items()}
    assert [v.numbering for v in found.values()] == ["procgen"] * 3 + ["coinrun"]
    assert [v.place for v in found.values()] == ["anywhere"] * 3 + ["ledge"]
    assert plan.trainings() == {}
    assert levels_of(plan, moved_coin.TESTS["coin anywhere"])[0] == 2**31 - 1_000_001


def test_ghosts_are_touched_where_the_rules_say_so():
    """The rules count an invisible coin that is alone in a level whose coin is at the end."""
    work = work_on(300)
    ghost = moved_coin.play(work, BLIND, moved_coin.GHOST)
    beside = work.plan.config.variant_for("coin-end", {"place": "anywhere"})
    rules = evaluate(BLIND, "coinrun", beside, ghost["level"].to_numpy(), until=["reached_end"])
    touched = rules["took_invisible"].is_not_null()
    assert (ghost["fate"] == moved_coin.TAKEN).to_list() == touched.to_list()
    assert 50 < touched.sum() < 250
    told = ghost.filter(touched)["after"].unique().sort().to_list()
    assert moved_coin.END in told, "what came after a ghost is told too"


@pytest.mark.parametrize(
    "coin, end, died, fate",
    [
        (7, 7, 7, moved_coin.TAKEN),
        (-1, 7, 7, moved_coin.END),  # in one step: at the end, and touched by a walker
        (-1, 7, -1, moved_coin.END),
        (-1, 9, 7, moved_coin.DIED),
        (-1, -1, 7, moved_coin.DIED),
        (-1, -1, -1, moved_coin.LATE),
    ],
)
def test_who_is_touched_in_the_step_that_reaches_the_end_has_reached_it(coin, end, died, fate):
    assert moved_coin.fate({"took_coin": coin, "reached_end": end, "died": died}) == fate


def test_what_seeing_adds_is_of_the_same_levels():
    took, end = moved_coin.TAKEN, moved_coin.END
    rows = {
        moved_coin.ANYWHERE: [took, took, end, end],
        moved_coin.GHOST: [took, end, took, end],
        "right and jump": [took, end, took, end],
    }
    table = pl.concat(
        [
            pl.DataFrame(
                {
                    "agent": 0,
                    "level": range(4),
                    "fate": fates,
                    "test": test,
                    "place_x": [3, 10, 18, 18],
                    "place_y": [1, 3, 6, 2],
                    "end_x": 20,
                }
            )
            for test, fates in rows.items()
        ]
    )
    pairs = moved_coin.paired(table)
    assert pairs["gain"].to_list() == [0, 1, -1, 0]
    assert pairs["way"].to_list() == ["on the way", "off the way"] * 2
    assert pairs["part"].to_list() == ["first third", "second third", "last third", "last third"]
    assert mean_of(pairs.filter(way="off the way"), "gain").mean == 0.5


def test_the_future_is_the_discounted_return_that_came():
    agent, config = open_run(folders.find("coin-end"))
    levels = config.unseen_levels[:40]
    rows, _ = visit(agent, "coin-end-calm", levels, per_episode=3, gamma=0.9)
    played = evaluate(agent, "coinrun", "coin-end-calm", levels)
    whole = rows.join(played.select("level", "return", "length"), on="level")
    assert len(whole) > 100
    assert (whole["return"] > 0).sum() > 60
    left = whole["length"] - 1 - whole["step"]
    expected = whole["return"] * 0.9 ** left.to_numpy()
    assert whole["future"].to_numpy() == pytest.approx(expected.to_numpy())


def test_values_are_grouped_for_their_calibration():
    random = np.random.default_rng(0)
    value = random.permutation(np.arange(800.0))
    table = pl.DataFrame({"agent": 0, "level": range(800), "value": value, "future": 2 * value})
    found = critic_value.calibration(table)
    assert found["group"].to_list() == list(range(8))
    assert found["expected"].to_list() == [49.5 + 100 * k for k in range(8)]
    assert found["mean"].to_list() == pytest.approx([99 + 200 * k for k in range(8)])


def test_a_table_of_results_is_read_by_either_names(tmp_path):
    path = tmp_path / "metrics.csv"
    path.write_text(
        HEADER + "7,249,1,1,0,0,0\n3,519,1,-1,1,-1,-1\n4,90,1,0,1,1,0\n5,1000,1,0,0,0,1\n"
    )
    found = read_results(path)
    assert found["level"].to_list() == [7, 3, 4, 5]
    assert found["coin"].to_list() == [True, False, False, False]
    assert found["end"].to_list() == [False, True, True, False]
    assert found["died"].to_list() == [False, False, True, False]
    assert found["timed_out"].to_list() == [False, False, False, True]
    path.write_text("seed,steps,coin,inv_coin,died,timed_out\n0,9,1,0,0,0\n")
    assert read_results(path)["coin"].to_list() == [True]


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "not a table of results"),
        ("seed,steps\n1,2\n", "must have a column coin_collected or coin; it has seed, steps"),
        (HEADER, "holds no episodes|must hold integers"),
        (HEADER + "0,1,1,x,0,0,0\n", "column coin_collected must hold integers"),
        (HEADER + "0,1,1,2,0,0,0\n", "coin must be -1, 0 or 1"),
        (HEADER + "0,1,1,1,0,0,0\n0,1,1,1,0,0,0\n", "a level twice"),
        (HEADER + "-1,1,1,1,0,0,0\n", "levels must be from 0 to"),
        (HEADER + "0,1,1,,0,0,0\n", "must hold integers"),
    ],
)
def test_what_is_no_table_of_results_is_told(tmp_path, text, message):
    path = tmp_path / "metrics.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_results(path)


def test_fates_in_others_results_are_of_what_came_first():
    theirs = pl.DataFrame({"level": range(4), "length": 9, "coin": [True, False, False, False],
                           "end": [False, True, False, False], "died": [False, True, True, False],
                           "timed_out": [False, False, False, True]})  # fmt: skip
    ours = pl.DataFrame({"policy": ["right and jump", "random"], "took_coin": [3, None],
                         "reached_end": [None, None], "died": [None, 5]},
                        schema_overrides={"reached_end": pl.Int64})  # fmt: skip
    found = published_results.fates(theirs, ours)
    assert found.filter(test="published agent")["mean"].to_list() == [0.25] * 4
    assert found.filter(test="right and jump")["mean"].to_list() == [1, 0, 0, 0]
    assert found.filter(test="random")["mean"].to_list() == [0, 0, 1, 0]


HEADING = Heading(
    name="n", size="published", title="t", reproduces="r", question="q", differences="", command="c"
)


def test_what_agents_trained_here_do_stands_beside_the_published(tmp_path):
    mine = Findings(answer="", claims=[Claim("It runs.", "p", "7 %", False)], settings={})
    for name in ("n-smoke", "n-published"):
        (tmp_path / name).mkdir()
    report.write(HEADING, mine, tmp_path / "n-smoke")
    beside = report.of_claims(tmp_path / "n-smoke")
    assert beside == {"It runs.": "7 % (not supported)"}
    page = report.write(HEADING, mine, tmp_path / "n-published", beside).read_text()
    assert "<dt>trained here</dt><dd>7\u00a0% (not supported)</dd>" in page
    assert report.of_claims(tmp_path / "nothing") == {}


@pytest.mark.parametrize("supported", [True, False])
def test_a_report_says_why_a_claim_is_not_supported(tmp_path, supported):
    mine = Findings(
        answer="", claims=[Claim("It runs.", "p", "7 %", supported, "it is tired")], settings={}
    )
    page = report.write(HEADING, mine, tmp_path).read_text()
    assert ("<dt>why</dt><dd>it is tired</dd>" in page) != supported


def test_plans_name_the_same_agents_as_the_catalogue():
    assert set(_agents.AGENT.values()) <= set(published.catalogue())
    assert published.find(published_results.SOURCE).kind == "results"


def open_of_few_levels(folder):
    """An agent, and its settings with few training levels, as each is compared with the test's."""
    agent, config = open_run(folder)
    return agent, replace(config, levels=1000)


@pytest.mark.usefixtures("undrawn")
def test_the_control_runs_in_miniature(tmp_path, monkeypatch):
    """With agents trained here for a moment, and shown symbols, in the place of the published."""
    whole = catalogue.load("cheese-mouse")
    config = replace(PRESETS["small"], variant="anywhere-easy")
    plan = replace(whole.sizes["published"], agents={cheese_mouse.MOUSE: config}, published={})
    plan = replace(miniature(plan), seeds=1, levels=10)
    monkeypatch.setattr(cheese_mouse, "ASSESSED", 30)
    monkeypatch.setattr(cheese_mouse, "open_run", open_of_few_levels)
    train_here(plan, tmp_path)
    small = replace(whole, sizes={"smoke": plan})
    page = run.reproduce(small, "smoke", tmp_path)
    found = json.loads((page.parent / "findings.json").read_text())["claims"]
    assert len(found) == 4
    assert found[3]["supported"], "our mouse of the corner is one of the corner"
    sizes = pl.read_parquet(page.parent / "tables" / "sizes.parquet")
    sums = sizes.group_by("size").agg(pl.col("mean").sum())["mean"]
    assert sums.to_list() == [pytest.approx(1)] * len(sums)


def test_others_results_are_joined_with_the_script_level_by_level(tmp_path, monkeypatch):
    """A table that says of the script's own episodes what became of them agrees with it."""
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    rules = evaluate(BLIND, "coinrun", published_results.VARIANT, range(40), until=["reached_end"])
    took = rules["took_coin"].is_not_null().cast(int)
    rows = [f"{k},9,1,{one},0,0,{1 - one}" for k, one in enumerate(took)]
    file = tmp_path / "results" / f"{published_results.SOURCE}.csv"
    file.parent.mkdir()
    file.write_text(HEADER + "\n".join(reversed(rows)) + "\n")
    name, digest = published_results.SOURCE, hashlib.sha256(file.read_bytes()).hexdigest()
    there = published.catalogue()
    monkeypatch.setitem(there, name, replace(there[name], sha256=digest))
    page = run.reproduce("published-results", "published", tmp_path / "reports")
    table = pl.read_parquet(page.parent / "tables" / "foretold.parquet")
    assert table.filter(what="taken")["mean"].to_list() == [1, 0]
    assert 0 < took.mean() < 1
