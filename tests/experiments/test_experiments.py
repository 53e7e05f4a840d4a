"""Every experiment plans, and runs whole in miniature, stopped and repeated."""

import importlib
import importlib.util
import json
import multiprocessing
import os
import re
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray import games, provenance
from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.analysis.runs import open_run
from astray.experiments import catalogue, labs, outcomes, run, videos, workers
from astray.experiments.outcomes import rate
from astray.experiments.spec import Plan, plan_of
from astray.experiments.studies.coinrun import attribution
from astray.experiments.studies.mitigation import asking_for_help, reward_ensembles
from astray.game import Looks
from astray.kernel.jit import kernel
from astray.report import page as report
from astray.report.claims import Claim, above
from astray.training import checkpoint
from astray.training.config import Config
from helpers import registered
from helpers.edits import edit, forget
from helpers.miniature import miniature, train_here
from helpers.processes import begin
from helpers.thorough import thorough
from helpers.trainings import TINY

PATIENCE = 300  # seconds that a process is waited for; machines may be busy
ALL = [(name, size) for name in catalogue.NAMES for size in catalogue.load(name).sizes]


@pytest.mark.parametrize("name, size", ALL)
def test_every_experiment_plans(name, size, tmp_path):
    plan = catalogue.load(name).sizes[size]
    trainings = [config for configs in plan.trainings().values() for config in configs]
    alone = [its for its in plan.teachers.values() if not isinstance(its, str)]  # that only teach
    assert len(trainings) == plan.seeds * (len(plan.agents) - len(plan.published) + len(alone))
    assert len({run.run_folder(tmp_path, config) for config in trainings}) == len(trainings)
    assert not (size == "paper" and plan.differences)


SMALLEST = {name: next(iter(catalogue.load(name).sizes)) for name in catalogue.NAMES}
TRAINED = [
    (name, size)
    for name, size in SMALLEST.items()
    if size in ("smoke", "pixels")
    and not catalogue.load(name).sizes[size].published
    # All of the field's worlds are alike: `test_field_studies` has their claims.
    and (".field." not in catalogue.MODULES[name] or name == "lava-bridge")
]
# A network of patches, and one that is distilled from the symbols of another.
TRAINED.append(("inherited-goals", "pixels"))
# Their agents, tests or claims are of the kinds of another study, and what each of them alone
# computes has tests on made-up tables.
LIKE_ANOTHER = {
    ("asking-for-help", "smoke"): "`test_oversight` plays and compares its curves",
    ("attribution", "smoke"): "critic-value",
    ("coin-diversity", "smoke"): "maze-corner",
    ("colour-or-shape", "smoke"): "maze-corner",
    ("early-or-late", "smoke"): "minimax-regret",
    ("inherited-goals", "smoke"): "its other size",
    ("keys-and-chests", "smoke"): "maze-corner; `test_hoarding` computes its numbers",
    ("maze-memory", "smoke"): "maze-corner; `test_recurrent` trains such networks",
    ("maze-region", "smoke"): "maze-corner",
    ("minimax-regret", "smoke"): "maze-corner, but for the levels of its training",
    ("minimax-regret-dish", "smoke"): "minimax-regret, but for the levels",
    ("moved-coin", "smoke"): "critic-value",
    ("permeable-wall", "smoke"): "critic-value",
    ("pixel-networks", "pixels"): "inherited-goals",
    ("pooled-places", "pixels"): "inherited-goals",
    ("reward-ensembles", "smoke"): "maze-corner; `test_hypotheses` trains such heads",
    ("training-curves", "smoke"): "maze-corner",
}
# Those in full, with figures and two agents of each name: the simplest, and those with the mark.
FULL = {("maze-corner", "smoke"), *LIKE_ANOTHER}
TRAINED = [
    pytest.param(*one, marks=pytest.mark.thorough if one in LIKE_ANOTHER else ()) for one in TRAINED
]


def of_report(found):
    """The claims of a report's findings."""
    told = ({key: one[key] for key in one if key != "beside"} for one in found["claims"])
    return [Claim(**claim) for claim in told]


def in_miniature(name, plan, several, monkeypatch):
    """The plan in miniature, and a study's own numbers, on which its time depends, smaller."""
    # Who learned nothing needs long to come to an end, which this one compares beginnings with.
    plan = miniature(plan, 400 if name == "critic-value" else 25)
    if name == "asking-for-help":  # which plays its levels with every score and threshold
        monkeypatch.setattr(asking_for_help, "PERCENTILES", (90.0,))
        monkeypatch.setattr(asking_for_help, "open_run", open_for_short)
        return replace(plan, levels=2)
    monkeypatch.setattr(reward_ensembles, "ENSEMBLES", 2)
    monkeypatch.setattr(attribution, "NETWORKS", 2)
    if name in ("agency", "attribution"):  # which look at every step of their episodes
        plan = replace(plan, levels=4 if name == "agency" else 8)
    return replace(plan, seeds=1) if len(plan.agents) > 2 or not several else plan


def open_for_short(folder):
    """A pretrained agent, and its settings with few levels and episodes of a few steps."""
    agent, config = open_run(folder)
    return agent, replace(config, levels=1000, knobs={**config.knobs, "time_limit": 40})


@pytest.mark.parametrize("name, size", TRAINED)
def test_every_experiment_runs_in_miniature(name, size, tmp_path, monkeypatch, request):
    if not (full := (name, size) in FULL) and name != "agency":  # whose figures no other has
        request.getfixturevalue("undrawn")
    whole = catalogue.load(name)
    plan = in_miniature(name, whole.sizes[size], full, monkeypatch)
    small = replace(whole, sizes={size: plan})
    monkeypatch.setattr(catalogue, "load", lambda _: small)
    monkeypatch.setattr(videos, "RECORDED", 2)
    train_here(plan, tmp_path)
    page = run.reproduce(name, size, tmp_path)
    folder = tmp_path / f"{name}-{size}"
    assert page == folder / "report.html"
    found = json.loads((folder / "findings.json").read_text())
    assert found["claims"] and all(claim["ours"] for claim in found["claims"])
    assert not registered.unstated(name, of_report(found))
    figures = {path.name for path in (folder / "figures").iterdir()}
    names = {Path(figure).stem for figure in figures}
    assert figures == {f"{n}.{kind}" for n in names for kind in ("png", "svg", "parquet")} != set()
    if plan.tests:
        rates = pl.read_parquet(folder / "tables" / "outcomes.parquet").filter(policy="sampled")
        assert rates["agents"].unique().to_list() == [plan.seeds]
        sums = rates.group_by("agent", "test").agg(pl.col("mean").sum())
        assert len(sums) == len(plan.agents) * len(plan.tests)
        assert sums["mean"].to_list() == [pytest.approx(1)] * len(sums)

    agents = (tmp_path / "agents").rglob("*.safetensors")
    kept = [*agents, *folder.rglob("computed/*.parquet")]
    written = {path: path.stat().st_mtime_ns for path in kept}
    if not written:
        assert name == "agency", "which trains nothing, and plays in worlds of its own"
        return
    page.unlink()
    write_nothing(monkeypatch, lambda *_: page.touch() or page)  # again, it takes long
    run.reproduce(name, size, tmp_path)  # nothing is trained or played again
    assert page.exists()
    assert written == {path: path.stat().st_mtime_ns for path in kept}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A folder with the agents of maze-corner in miniature."""
    root = tmp_path_factory.mktemp("reports")
    train_here(miniature(catalogue.load("maze-corner").sizes["smoke"]), root)
    return root


@pytest.fixture
def reports(trained, tmp_path):
    return shutil.copytree(trained, tmp_path / "reports")


@pytest.fixture
def unwritten(monkeypatch):
    """No page, lab or video is written, which takes as long as all before it."""
    write_nothing(monkeypatch)


def write_nothing(monkeypatch, page=lambda *_: None):
    monkeypatch.setattr(report, "write", page)
    monkeypatch.setattr(labs, "write", lambda *_: {})
    monkeypatch.setattr(outcomes, "write_pair", lambda *_, **__: "")


@pytest.mark.usefixtures("undrawn")
def test_videos_are_of_outcomes_that_came_about(reports, monkeypatch):
    whole = catalogue.load("maze-corner")
    plan = replace(miniature(whole.sizes["smoke"]), levels=30)
    monkeypatch.setattr(catalogue, "load", lambda _: replace(whole, sizes={"smoke": plan}))
    page = run.reproduce("maze-corner", "smoke", reports)
    told = re.findall(
        r"([A-Z][a-z ]+), as in [^:]*: level\s+(\d+) as in training", page.read_text()
    )
    played = pl.read_parquet(*page.parent.glob("computed/episodes-*.parquet"))
    mine = played.filter(policy="sampled", seed=0, variant="anywhere-small")
    videos = {path.stem for path in reports.rglob("videos/*.mp4")}
    assert videos == {outcome.lower().replace(" ", "-") for outcome, _ in told} != set()
    for outcome, level in told:
        assert mine.filter(level=int(level))["outcome"].to_list() == [outcome.lower()]


@pytest.mark.usefixtures("unwritten")
def test_another_plan_computes_anew_and_shares_the_agents(reports, monkeypatch):
    whole = catalogue.load("maze-corner")
    plan = replace(miniature(whole.sizes["smoke"]), seeds=1)
    agents = set()
    for levels in (10, 12):
        small = replace(whole, sizes={"smoke": replace(plan, levels=levels)})
        monkeypatch.setattr(catalogue, "load", lambda _, small=small: small)
        run.reproduce("maze-corner", "smoke", reports)
        played = pl.read_parquet(*reports.glob("maze-corner-smoke/computed/episodes-*.parquet"))
        assert played.filter(policy="sampled", test="in training").height == levels
        agents.add(tuple(path.stat().st_mtime_ns for path in reports.rglob("agent.safetensors")))
    assert len(agents) == 1


@pytest.mark.usefixtures("unwritten")
def test_other_agents_and_other_code_compute_anew(reports, monkeypatch):
    whole = catalogue.load("maze-corner")
    plan = replace(miniature(whole.sizes["smoke"]), levels=5)
    small = replace(whole, sizes={"smoke": plan})
    monkeypatch.setattr(catalogue, "load", lambda _: small)

    def computed():
        run.reproduce("maze-corner", "smoke", reports)
        (episodes,) = reports.glob("maze-corner-smoke/computed/episodes-*.parquet")
        return episodes.stat().st_mtime_ns

    first = computed()
    assert computed() == first
    (one, two) = sorted((reports / "agents").glob("*/seed-*"))
    agents = [checkpoint.latest(folder) / checkpoint.AGENT for folder in (one, two)]
    other = agents[1].read_bytes()
    shutil.copy(*agents)
    with pytest.raises(ValueError, match=r"two of .*seed-0, .*seed-1 are one agent; remove"):
        computed()
    agents[0].write_bytes(other)
    second = computed()
    assert second > first
    edit(monkeypatch, "astray.analysis.evaluate")
    assert computed() > second


def test_an_edit_of_a_game_of_ones_own_is_another_plan(tmp_path, monkeypatch):
    source = tmp_path / "my_rules.py"
    source.write_text("def step(s, action):\n    return 0.0, False\n")
    monkeypatch.syspath_prepend(tmp_path)
    rules = importlib.import_module("my_rules")
    maze = games.find("maze")
    game = replace(maze, rules=SimpleNamespace(**vars(maze.rules) | {"step": rules.step}))
    monkeypatch.setattr(Config, "find_game", lambda _: game)
    plan = Plan(agents={"mouse": TINY}, levels=1, differences="")
    before = run.code_of(plan)
    assert before == run.code_of(plan)
    source.write_text("def step(s, action):\n    return 1.0, False\n")
    assert run.code_of(plan) == before  # it runs as it was
    forget(monkeypatch)
    assert run.code_of(plan) != before
    monkeypatch.delitem(rules.step.__globals__, "__file__")
    monkeypatch.delitem(rules.step.__globals__, "__spec__")
    assert run.code_of(plan) is None  # and tables are always computed anew
    assert run.inputs(plan, {}) != run.inputs(plan, {})


def digest_of_tables(name):
    whole = catalogue.load(name)
    return run.inputs(next(iter(whole.sizes.values())), {}, whole)[1]


@pytest.mark.parametrize(
    "module, changed",
    {
        "astray.training.config": True,  # which variant is played, and which levels: `knobs_for`
        "astray.experiments.studies.maze.maze_corner": True,
        "astray.analysis.evaluate": True,
        "astray.games.maze.solve": True,  # the experts, which are imported by name
        "astray.games.maze.variants": True,
        "astray.agents.mlp": True,
        "astray.games.coinrun.rules": False,
        "astray.experiments.studies.maze.cheese_mouse": False,  # as a caption there
        "astray.experiments.workers": False,
        "astray.experiments.labs": False,
        "astray.training.loop": False,  # agents count by their digests
        "astray.lab.server": False,
        "astray.play": False,
    }.items(),
)
def test_tables_are_computed_anew_after_an_edit_of_code_that_plays_or_measures(
    module, changed, monkeypatch
):
    assert importlib.util.find_spec(module)
    before = digest_of_tables("maze-corner")
    edit(monkeypatch, module)
    assert (digest_of_tables("maze-corner") != before) == changed


@pytest.mark.parametrize(
    "name", ["maze-corner", *thorough(*(one for one in catalogue.NAMES if one != "maze-corner"))]
)
def test_a_caption_changes_the_tables_of_its_own_study_alone(name, monkeypatch):
    before = digest_of_tables(name)
    itself = catalogue.MODULES[name]
    imported = provenance.sources(catalogue.load(name).find, sys.modules[itself])
    others = {module for module in catalogue.MODULES.values() if module not in imported}
    assert len(others) > len(catalogue.NAMES) / 2 and itself not in others
    with monkeypatch.context() as context:
        edit(context, *others)
        assert digest_of_tables(name) == before
    edit(monkeypatch, itself)
    assert digest_of_tables(name) != before


@pytest.mark.parametrize("observation", ["image", "symbolic"])
def test_tables_are_computed_anew_where_agents_see_other_pictures(observation, monkeypatch):
    sees = {"observation": "image", "network": "nature"} if observation == "image" else {}
    config = TINY.changed(**sees)
    plan = plan_of("mouse", config, "maze", "corner-small", differences="")
    before = run.inputs(plan, {})[1]
    assert run.inputs(plan, {})[1] == before
    monkeypatch.setattr(Looks, "pictures", lambda *_: (np.zeros(3),))
    assert (run.inputs(plan, {})[1] != before) == (observation == "image")


def test_tables_are_computed_anew_where_a_kernel_keeps_another_value(monkeypatch):
    """As one that a game's module reads from a file, which no source shows."""
    plan = plan_of("mouse", TINY, "maze", "corner-small", differences="")
    maze, digests = games.find("maze"), []
    for value in (1.0, 1.0, 2.0):

        @kernel
        def step(s, action, value=value):
            return value, False

        game = replace(maze, rules=SimpleNamespace(**vars(maze.rules) | {"step": step}))
        monkeypatch.setattr(Config, "find_game", lambda _, game=game: game)
        digests.append(run.inputs(plan, {})[1])
    assert digests[0] == digests[1] != digests[2]


def test_tables_are_computed_anew_where_a_test_has_another_variant(monkeypatch):
    before = digest_of_tables("maze-corner")
    monkeypatch.setattr(Config, "knobs_for", lambda *_: {"time_limit": 7})
    assert digest_of_tables("maze-corner") != before


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_process_of_trainings_ends_once_nobody_holds_the_other_end_of_its_pipe():
    context = multiprocessing.get_context("fork")
    there, here = context.Pipe(duplex=False)

    def work():
        here.close()
        workers._begin(there)
        time.sleep(PATIENCE)

    process = context.Process(target=work, daemon=True)
    process.start()
    here.close()
    process.join(PATIENCE / 3)
    assert process.exitcode == 1


@pytest.mark.thorough  # the test before this one
@pytest.mark.skipif(not hasattr(os, "kill") or os.name == "nt", reason="needs signals")
def test_trainings_end_with_the_experiment_that_began_them(tmp_path):
    words = ("reproduce", "maze-corner", "--workers", "1", "--out")
    process = begin(ASTRAY, tmp_path, *words, tmp_path).process
    config = catalogue.load("maze-corner").sizes["smoke"].config
    folder = run.run_folder(tmp_path, config)
    try:
        wait_for((folder / "metrics.jsonl").exists, PATIENCE)
    finally:  # else it would go on training for minutes
        process.kill()
        process.join()

    def free():
        try:
            with checkpoint.claim(folder, config):
                return True
        except RuntimeError:
            return False

    wait_for(free, PATIENCE)


ASTRAY = """
import os, sys
if __name__ == "__main__":  # which a training's process does not do again
    from astray.cli import main
    from astray.experiments import run
    run.check_tests = lambda _: None  # which takes seconds in mazes
    os.setsid()  # so that a signal may be sent to all of its processes
    main()
"""
REPRODUCE = """
import os, pathlib, sys, time
from dataclasses import replace
from helpers.miniature import miniature
from astray.experiments import catalogue, run, videos
videos.RECORDED = 2
whole = catalogue.load("maze-corner")
small = replace(whole, sizes={"smoke": miniature(whole.sizes["smoke"])})
catalogue.load = lambda _: small
pathlib.Path(f"begun-{os.getpid()}").touch()
while len(list(pathlib.Path().glob("begun-*"))) < 2:  # else one may end before the other begins
    time.sleep(0.01)
run.reproduce("maze-corner", "smoke", pathlib.Path(sys.argv[1]), workers=1)
"""
TRAIN = """
import pathlib, sys
from astray.training.loop import train
from helpers.trainings import TINY
train(TINY, pathlib.Path(sys.argv[1]), progress=False, wait=True)
"""


@pytest.mark.thorough  # `test_a_training_that_another_process_does_is_waited_for`
def test_two_that_reproduce_the_same_at_once_both_come_to_its_end(reports, tmp_path):
    both = [begin(REPRODUCE, tmp_path, reports) for _ in range(2)]
    codes, _, said = zip(*(one.ended() for one in both), strict=True)
    assert codes == (0, 0), said
    assert sum("another process works on" in text for text in said) == 1
    assert (reports / "maze-corner-smoke" / "report.html").exists()


def test_a_training_that_another_process_does_is_waited_for(tmp_path):
    run_folder = tmp_path / "run"
    with checkpoint.claim(run_folder, TINY):
        second = begin(TRAIN, tmp_path, run_folder)
        wait_for(
            lambda: second.err.exists() and "is training in" in second.err.read_text(), PATIENCE
        )
        assert second.process.is_alive() and not checkpoint.steps_saved(run_folder)
    assert second.ended()[0] == 0
    assert checkpoint.finished(run_folder, TINY)


LINES = "agents/*/seed-*/metrics.jsonl"


@pytest.mark.skipif(os.name == "nt", reason="needs signals")
@pytest.mark.parametrize(
    "workers, first, sent, code, told",
    [
        # `test_streams` interrupts a training.
        *thorough(
            (2, "agents", signal.SIGINT, 130, "interrupted"),
            (2, LINES, signal.SIGINT, 130, "interrupted"),
            (2, LINES, signal.SIGTERM, 143, "terminated"),
        ),
        # As timeout, systemd and Slurm do: it ends the trainings before they are told to end.
        (1, LINES, signal.SIGTERM, 143, "terminated"),
    ],
)
def test_an_interrupt_ends_all_trainings_in_a_line(workers, first, sent, code, told, tmp_path):
    words = ("reproduce", "boat-race", "--workers", workers, "--out", tmp_path)
    begun = begin(ASTRAY, tmp_path, *words)
    try:
        wait_for(lambda: list(tmp_path.glob(first)), PATIENCE)
        os.killpg(begun.process.pid, sent)  # as a terminal does: to all of them
        begun.process.join(PATIENCE)
    finally:
        begun.process.kill()
    ended, _, said = begun.ended()
    assert ended == code
    assert said.splitlines()[-1] == f"astray: {told}" and "Traceback" not in said


def wait_for(true, seconds):
    until = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < until
        time.sleep(0.1)


@pytest.mark.parametrize(
    "misgeneralized, failed, supported", [(50, 10, True), (32, 30, False), (10, 50, False)]
)
def test_a_claim_is_supported_only_where_its_whole_interval_does(misgeneralized, failed, supported):
    outcomes = [MISGENERALIZED] * misgeneralized + [FAILED] * failed
    outcomes += [INTENDED] * (100 - len(outcomes))
    episodes = pl.DataFrame(
        {"policy": "sampled", "test": "test", "seed": 0, "level": range(100), "outcome": outcomes}
    )
    less = rate(episodes, "test", MISGENERALIZED, minus=FAILED)
    told = above("it misgeneralizes", "often", "share", less, 0.0)
    assert told.supported == supported
    assert f"{misgeneralized - failed}.0" in told.ours


def test_a_rate_of_all_episodes_has_an_interval_that_ends_at_all():
    episodes = pl.DataFrame(
        {"policy": "sampled", "test": "test", "seed": 0, "level": range(100), "outcome": INTENDED}
    )
    found = rate(episodes, "test", INTENDED)
    assert 0.95 < found.low < found.mean == found.high == 1
