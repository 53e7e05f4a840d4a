"""Pretrained agents: small, whole without their training, and what their cards say is so."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from safetensors.numpy import load_file

from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import label, load_shift, outcomes_of
from astray.analysis.runs import open_run
from astray.experiments import keep
from astray.training import checkpoint, folders
from astray.training.folders import AgentFolder
from astray.training.loop import train
from helpers.killed import CONFIG

SHORT = replace(CONFIG, steps=4 * 1024)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of a few steps."""
    folder = tmp_path_factory.mktemp("run")
    train(SHORT, folder, progress=False)
    return folder


@pytest.fixture(scope="module")
def written(run, tmp_path_factory):
    return keep.keep(run, "mouse", folder=tmp_path_factory.mktemp("kept"), levels=40)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_folder_whose_name_is_no_text_is_told_and_not_left(run, tmp_path):
    with pytest.raises(ValueError, match="must have a name in UTF-8; got"):
        keep.keep(run, "mouse", folder=tmp_path / "\udcff", levels=4)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def mouse(written, monkeypatch):
    """An agent that is kept by the name "mouse"."""
    monkeypatch.setattr(folders, "PRETRAINED", written.parent)
    return written


# The outcome of each level that the cards of some agents tell of, as its number in `outcomes_of`
# the game: so that a part of the levels is enough to see that an agent is the one on its card.
OUTCOMES_OF = json.loads(Path(__file__).with_name("pretrained.json").read_text())
CARDS, REPLAYED = 1000, 16  # levels
LONG = {"coin-end-night", "many-chests-night", "maze-corner-night",
        "coin-end-pixels", "many-chests-pixels"}  # fmt: skip


def told_by_card(name):
    """An agent's settings, the shift of its card, and the agent's row in all levels of the test."""
    card = (folders.find(name) / "README.md").read_text()
    config = open_run(folders.find(name))[1]
    shift = load_shift(config.find_game(), card.split("--shift ")[1].split()[0])
    assert f"in {CARDS:,} levels" in card
    (row,) = (
        line for line in card.splitlines() if line.startswith(f"| `{shift.test}` | the agent |")
    )
    return config, shift, [part.split(" %")[0] for part in row.split(" | ")[2:]]


def as_on_cards(outcomes, config):
    names = outcomes_of(config.find_game())
    return [f"{100 * np.mean([o == name for o in outcomes]):.1f}" for name in names]


@pytest.mark.parametrize("name", OUTCOMES_OF)
def test_the_outcomes_that_are_known_are_the_cards(name):
    config, _, row = told_by_card(name)
    names = outcomes_of(config.find_game())
    outcomes = [names[int(number)] for number in OUTCOMES_OF[name]]
    assert len(outcomes) == CARDS and as_on_cards(outcomes, config) == row


@pytest.mark.parametrize(
    "name",
    [
        # Networks that take four times as long; the same games have an agent that takes less.
        pytest.param(name, marks=pytest.mark.thorough if name in LONG else ())
        for name in folders.pretrained()
    ],
)
def test_every_kept_agent_does_what_its_card_says(name):
    agent, _ = open_run(folders.find(name))
    assert agent.path.stat().st_size <= keep.LARGEST and int(agent.path.parent.name) > 0
    (config, shift, row), known = told_by_card(name), OUTCOMES_OF.get(name)
    levels = config.unseen_levels[: REPLAYED if known else CARDS]
    played = evaluate(agent, config.game, config.variant_for(shift.test), levels)
    outcomes = label(played, config.find_game(), shift)["outcome"].to_list()
    if known:
        names = outcomes_of(config.find_game())
        assert outcomes == [names[int(number)] for number in known[:REPLAYED]]
    else:
        assert as_on_cards(outcomes, config) == row


@pytest.mark.parametrize("name", folders.pretrained())
def test_every_card_names_the_commands_that_train_such_an_agent_today(name):
    config, card = open_run(folders.find(name))[1], (folders.find(name) / "README.md").read_text()
    trained = [f"`astray train {config.game} {config.variant}` with the settings below"]
    named = [f"`{command}`" for command in keep.commands(config)] or trained
    assert f"\nTrained by {', or '.join(named)}.\n" in card


def test_an_agent_is_kept_without_its_training(run, mouse):
    steps = f"{SHORT.steps}"
    assert {str(path.relative_to(mouse)) for path in mouse.rglob("*") if path.is_file()} == {
        "README.md",
        "config.json",
        "curve.csv",
        "curve.png",
        "episode.gif",
        f"checkpoints/{steps}/agent.safetensors",
    }
    assert [path.name for path in mouse.parent.iterdir()] == ["mouse"]
    one, two = (
        load_file(folder / "checkpoints" / steps / checkpoint.AGENT) for folder in (run, mouse)
    )
    assert all(np.array_equal(one[name], two[name]) for name in one) and one.keys() == two.keys()
    curve = pl.read_csv(mouse / "curve.csv")
    assert curve["steps"][-1] == SHORT.steps
    told = checkpoint.metrics(run)[-1]["training/return"]
    assert curve["training/return"][-1] == pytest.approx(told)


def test_a_curve_is_of_returns_where_no_episode_of_the_validation_has_ended(run, tmp_path):
    """It was of rewards per step, which fall where levels grow."""
    mine, lines = tmp_path / "run", checkpoint.metrics(run)
    shutil.copytree(run, mine)
    cut = [{n: x for n, x in line.items() if n != "validation/return"} for line in lines]
    (mine / "metrics.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in cut))
    keep.draw_curve(mine, CONFIG, SHORT.steps, tmp_path)
    assert cut != lines
    assert pl.read_csv(tmp_path / "curve.csv").columns == ["steps", "training/return"]


def test_a_card_says_what_an_evaluation_finds(astray, mouse):
    said = json.loads(astray("evaluate", "mouse", "--levels", "100000:100040", "--json"))
    found = {
        row["outcome"]: row
        for row in said
        if row["policy"] == "mouse" and row["levels_played"] == "all"
    }
    told = " | ".join(
        f"{100 * row['mean']:.1f} % ({100 * row['low']:.1f} to {100 * row['high']:.1f})"
        for row in found.values()
    )
    card = (mouse / "README.md").read_text()
    assert f"| `anywhere-small` | the agent | {told} |" in card
    assert "in 40 levels" in card and "proxy `corner`" in card and "| None |" not in card


def test_a_kept_agent_stands_for_its_run_folder(astray, run, mouse, tmp_path):
    words = ("--levels", "100000:100012", "--json")
    assert astray("agency", "mouse", *words) == astray("agency", run, *words)
    videos = [tmp_path / f"{name}.gif" for name in ("kept", "run")]
    astray("record", "mouse", "--pixels", "64", "--out", videos[0])
    astray("record", run, "--pixels", "64", "--out", videos[1])
    assert videos[0].read_bytes() == videos[1].read_bytes()
    assert json.loads(astray("list", "--json"))["agents"]["mouse"]["variant"] == SHORT.variant
    assert "mouse: maze, trained on corner-small" in astray("list")


@pytest.mark.usefixtures("undrawn")
def test_the_card_of_a_life_without_end_is_about_the_test_alone(tmp_path):
    run = shutil.copytree(folders.find("trees-life"), tmp_path / "run")
    keep.write_card("woodcutter", run, "season", levels=4)
    card = (run / "README.md").read_text()
    assert "| `season` | the agent |" in card and "| `life` |" not in card


@pytest.mark.usefixtures("undrawn")
def test_a_card_tells_of_levels_once_where_all_distinguish_the_goals(tmp_path):
    run = shutil.copytree(folders.find("bridge-middle"), tmp_path / "run")
    keep.write_card("robot", run, "up", levels=4)
    card = (run / "README.md").read_text()
    assert "| `up` | the agent |" in card and "distinguishing" not in card


@pytest.mark.usefixtures("undrawn")
def test_the_card_of_who_is_tested_where_it_was_trained_says_so(tmp_path):
    run = shutil.copytree(folders.find("tomatoes-bucket"), tmp_path / "run")
    keep.write_card("gardener", run, "bucket", levels=4)
    assert "they come apart on `bucket`, where it was trained." in (run / "README.md").read_text()


@pytest.mark.usefixtures("undrawn")
def test_the_card_of_who_was_trained_elsewhere_says_where_the_goals_agree(tmp_path):
    """It said that they agree where the agent was trained, which is in neither of the variants."""
    run = shutil.copytree(folders.find("supervisor-half"), tmp_path / "run")
    keep.write_card("robot", run, "never-absent-before", levels=4)
    assert "they agree on `watched` and come" in (run / "README.md").read_text()


def test_what_rewards_were_divided_by_is_kept(run, mouse):
    divisor = AgentFolder.open(run).deviation()
    assert divisor and divisor == AgentFolder.open(mouse).deviation()


def test_the_curve_ends_where_the_agent_does(run, tmp_path, monkeypatch):
    monkeypatch.setattr(keep, "POINTS", 2)
    first = run / "checkpoints" / f"{checkpoint.steps_saved(run)[0]}"
    early = keep.keep(first, "early", folder=tmp_path, levels=10)
    steps = pl.read_csv(early / "curve.csv")["steps"]
    assert len(steps) <= 2 and steps[-1] == int(first.name) < SHORT.steps


@pytest.mark.parametrize("name, message", [("mouse", "already"), ("The Mouse", "got 'The Mouse'")])
def test_a_name_is_one_and_new(run, mouse, name, message):
    with pytest.raises(ValueError, match=message):
        keep.keep(run, name, folder=mouse.parent)


def test_what_was_kept_is_not_kept_again(mouse, tmp_path):
    with pytest.raises(ValueError, match=r"cannot be kept: it has no metrics\.jsonl"):
        keep.keep(mouse, "again", folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_test_that_the_agent_cannot_see_is_refused_before_the_training_variant_is_played(
    run, tmp_path, monkeypatch
):
    played, evaluate_runs = [], keep.evaluate_runs

    def noted(*words, variant, **more):
        played.append(variant)
        return evaluate_runs(*words, variant=variant, **more)

    monkeypatch.setattr(keep, "evaluate_runs", noted)
    with pytest.raises(ValueError, match="the agent sees observations of shape"):
        keep.keep(run, "mouse", shift="dish-small", folder=tmp_path, levels=4)
    with pytest.raises(ValueError, match="unknown shift '' of maze"):
        keep.keep(run, "mouse", shift="", folder=tmp_path, levels=4)
    assert played == [load_shift("maze", "dish-small").test] and not list(tmp_path.iterdir())


def test_what_is_too_large_is_not_kept(run, tmp_path):
    with pytest.raises(ValueError, match=r"a pretrained one is at most 0\.01 MB"):
        keep.keep(run, "mouse", folder=tmp_path, levels=10, largest=10_000)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("levels", [0, -1, 10**9, 4.0])
def test_levels_of_a_card_are_few_enough_to_be_counted(run, tmp_path, levels):
    """All levels but the last took 17 GB."""
    with pytest.raises(ValueError, match=f"levels must be .*; got {levels}"):
        keep.keep(run, "mouse", folder=tmp_path, levels=levels)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "words, message",
    [
        ("evaluate", "name an agent or a run folder"),
        ("record", "name an agent or a run folder"),
        ("agency squid", "unknown agent 'squid', which is neither"),
    ],
)
def test_mistakes_are_explained(astray, mouse, words, message):
    assert message in astray(*words.split(), fails=True)
