"""What cannot be done is refused before the work, not after hours of it."""

import json
import shutil
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace

import numpy as np
import pytest

from astray import games
from astray.analysis import agency, runs
from astray.analysis.adapters import Function
from astray.analysis.outcomes import load_shift
from astray.analysis.policies import Random
from astray.analysis.runs import evaluate_policies, load_agent
from astray.analysis.trained import Agent
from astray.envs.vector import GameVectorEnv
from astray.experiments import run, spec, workers
from astray.experiments.levels import play
from astray.experiments.spec import Experiment, Plan
from astray.experiments.sweep.run import run_sweep
from astray.experiments.sweep.settings import Sweep
from astray.game import Shift
from astray.lab import export as exporting
from astray.lab import serving
from astray.lab.serving import make_lab
from astray.training import folders
from astray.training.config import Config
from helpers.processes import environment
from helpers.rooms import WORLD, Room
from helpers.trainings import TINY

MAZE = games.find("maze")


@pytest.fixture(autouse=True)
def _untrained(monkeypatch):
    def train_all(todo, *_):
        if todo:
            pytest.fail("it trains")

    monkeypatch.setattr(run, "train_all", train_all)


def of_three(step):
    return step.rewards + np.zeros(3)


def find(work):
    raise AssertionError("it looks for findings")


def experiment(plan, **more):
    return Experiment("Early", "nothing", "Is it refused?", {"smoke": plan}, find, **more)


def plan(**more):
    agents = {"mouse": replace(TINY, knobs={"world": 5, "largest": 3}, levels=3000)}
    tests = {"in training": spec.Test("corner-small", "corner-small")}
    return Plan(**{"agents": agents, "tests": tests, "levels": 50, "differences": "", **more})


@pytest.mark.parametrize(
    "words, said",
    [
        (("evaluate", "maze-corner", "--variant", "corner"), "of shape (4, 7, 7), not (4, 25, 25)"),
        (("audit", "maze-corner", "--shift", "corner"), "of shape (4, 7, 7), not (4, 25, 25)"),
        (("explain", "maze-corner", "--shift", "corner"), "of shape (4, 7, 7), not (4, 25, 25)"),
        (("compare", "maze-corner", "random", "--shift", "corner"), "of shape (4, 7, 7), not"),
        (("compare", "maze-corner", "walk:nothing"), "unknown goal 'nothing'; there are: cheese"),
        (("evaluate", "maze-corner", "--rewards", "os:getcwd"), "getcwd> fails: TypeError("),
    ],
)
def test_what_cannot_be_played_is_refused_before_a_script_plays(
    astray, words, said, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Random, "actions", lambda *_: pytest.fail("a script played"))
    assert said in astray(*words, fails=True)


def test_a_script_without_a_goal_is_refused_before_the_agents_beside_it_play(
    astray, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Agent, "actions", lambda *_: pytest.fail("an agent played"))
    told = astray("compare", "maze-corner", "walk:chese", fails=True)
    assert "unknown goal 'chese'; there are: cheese" in told


def test_the_agents_of_a_plan_are_tried_in_all_its_tests_before_one_is_played(monkeypatch):
    monkeypatch.setattr(Random, "actions", lambda *_: pytest.fail("a script played"))
    files = [folders.find("maze-corner")]
    own = {"mouse": spec.OwnAgents(load_agent, files=files)}
    tests = {name: spec.Test(name, name) for name in ("corner-small", "corner")}
    with pytest.raises(ValueError, match=r"of shape \(4, 7, 7\), not \(4, 25, 25\)"):
        play(plan(agents={}, own=own, world=MAZE, tests=tests), {"mouse": files})


def test_too_few_unseen_levels_are_told_before_training_and_what_to_do(tmp_path):
    said = r"only 0 are not in them; 50 are needed; lower `levels` of the training, 3,000"
    with pytest.raises(ValueError, match=said):
        run.reproduce(experiment(plan()), "smoke", tmp_path)


@pytest.mark.parametrize(
    "knobs, said",
    [
        (
            {"world": 9},
            r"mouse learns from planes \(\d, 5, 5\); the test 'in training' has \(\d, 9, 9\)",
        ),
        ({"time_limit": 2_000_000}, r"last up to 2,000,000 steps"),
    ],
)
def test_a_test_that_agents_could_not_play_is_told_before_training(tmp_path, knobs, said):
    tests = {"in training": spec.Test("corner-small", "corner-small", knobs)}
    agents = {"mouse": replace(TINY, levels=3)}
    with pytest.raises(ValueError, match=said):
        run.reproduce(experiment(plan(agents=agents, tests=tests, levels=2)), "smoke", tmp_path)


@pytest.mark.parametrize(
    "more, said",
    [
        ({"measures": {"far": lambda states: states["far"]}}, "no field of name far"),
        ({"measures": {"far": lambda states: 1}}, "'far' must return 1 values of one type; got 1"),
        ({"rewards": {"far": lambda step: "far"}}, "a reward must return 1 finite numbers"),
    ],
)
def test_a_measure_or_reward_that_fails_is_told_before_training(tmp_path, more, said):
    agents = {"mouse": replace(TINY, levels=3)}
    with pytest.raises(ValueError, match=said):
        run.reproduce(experiment(plan(agents=agents, levels=2, **more)), "smoke", tmp_path)


def test_knobs_that_a_world_refuses_in_a_test_are_told_before_training(tmp_path):
    variants = {"end": Room, "anywhere": lambda **knobs: Room("anywhere", **knobs)}
    loose = replace(WORLD, name="loose", variants=variants)
    agents = {"mlp": Config(loose, "end", steps=32, num_envs=2, num_steps=16, minibatches=1)}
    tests = spec.tests_of(loose, "end") | {"far": spec.Test("anywhere", "end", {"far": 3})}
    with pytest.raises(ValueError, match="the factory of loose anywhere, far=3 fails"):
        run.reproduce(experiment(plan(agents=agents, tests=tests)), "smoke", tmp_path)


def test_a_sweep_whose_test_a_world_refuses_is_told_before_training(tmp_path, monkeypatch):
    variants = {"end": lambda wide=1: Room(), "anywhere": lambda wide=1: Room() if wide == 1 else 5}
    base = Config(replace(WORLD, name="narrow", variants=variants), "end", steps=64, num_envs=4)
    base = replace(base, num_steps=16, minibatches=1)
    with pytest.raises(ValueError, match="that the factory of narrow anywhere, wide=2 returns"):
        run_sweep(Sweep(base, {"variant.wide": [1, 2]}, levels=2), tmp_path)


def test_findings_that_are_none_are_told(tmp_path):
    with pytest.raises(ValueError, match="find must be a function; got None"):
        replace(experiment(plan()), find=None)
    given = replace(experiment(plan(agents={}, tests={}, world=WORLD, own={
        "right": spec.OwnAgents(load_agent, files=[__file__])})), find=lambda work: 3)  # fmt: skip
    with pytest.raises(ValueError, match="what `find` of an experiment returns must be a Findings"):
        run.reproduce(given, "smoke", tmp_path)


@pytest.mark.parametrize(
    "setting, said",
    [
        ({"network": "no_such:Net"}, r"second cannot be trained: 'no_such:Net' cannot be imported"),
        ({"loss": "no_such:loss"}, r"second cannot be trained: 'no_such:loss' cannot be imported"),
        ({"reward": f"{__name__}:of_three"}, r"second cannot be trained: the reward .* fails"),
        ({"loss": f"{__name__}:of_three"}, r"second cannot be trained: the loss .* fails: Type"),
        ({"device": "mps"}, r"second cannot be trained: there is no device 'mps'"),
        ({"network": "impala"}, r"second cannot be trained: network 'impala' does not see symb"),
        (
            {"network": "mlp+gru", "num_envs": 2},
            r"second cannot be trained: 2 environments \(whole ones for a network with memory\)",
        ),
        ({"teacher": "nobody"}, r"second is a student of nobody: name it in `teachers`"),
        ({"start": "nobody"}, r"second cannot be trained: unknown agent 'nobody'"),
    ],
)
def test_a_training_that_could_not_begin_is_told_before_those_before_it(tmp_path, setting, said):
    agents = {"first": replace(TINY, levels=3), "second": replace(TINY, levels=3, **setting)}
    with pytest.raises(ValueError, match=said):
        run.reproduce(experiment(plan(agents=agents, levels=2)), "smoke", tmp_path)


def test_a_sweep_over_a_network_that_sees_nothing_of_the_kind_is_refused_before_it_trains(
    astray, tmp_path
):
    words = ("maze", "corner-small", "--set", "network=mlp,impala", "--out", tmp_path / "swept")
    said = "impala cannot be trained: network 'impala' does not see symbolic planes"
    assert said in astray("sweep", *words, fails=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ("reproduce", "maze-corner", "--size", "paper"),
        ("audit", "maze-corner", "--set", "time_limit=2000000"),
    ],
)
def test_a_refused_report_leaves_no_folder(astray, tmp_path, monkeypatch, words):
    if words[0] == "reproduce":  # where the levels of its tests are looked for first, for seconds
        monkeypatch.setattr(run, "check_tests", lambda _: None)
    assert astray(*words, "--out", tmp_path / "new" / "reports", fails=True)
    assert not list(tmp_path.iterdir())


def test_a_ruined_report_that_results_stand_beside_is_told_before_the_work(tmp_path):
    (tmp_path / "early-smoke").mkdir()
    (tmp_path / "early-smoke" / "findings.json").write_text('{"claims": null}')
    published = {"published": plan(agents={"mouse": TINY})}
    study = replace(experiment(plan()), sizes=published)
    with pytest.raises(ValueError, match=r"early-smoke/findings\.json must be the findings of a"):
        run.reproduce(study, "published", tmp_path)


def test_no_worker_is_told_before_training(tmp_path):
    with pytest.raises(ValueError, match=r"workers must be an integer from 1 to \d+; got 0"):
        run.reproduce(experiment(plan()), "smoke", tmp_path, workers=0)


def test_a_device_that_is_not_there_is_told_before_levels_are_looked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "check_tests", lambda _: pytest.fail("it looks for levels"))
    with pytest.raises(ValueError, match="mouse cannot be trained: there is no device 'mps'"):
        run.reproduce(experiment(plan()), "smoke", tmp_path, device="mps")


def test_a_game_without_cells_is_told_before_it_compiles(monkeypatch):
    monkeypatch.setattr(agency, "initial_states", lambda *_: pytest.fail("it compiles"))
    with pytest.raises(ValueError, match="has no cells"):
        variant = games.find("coinrun").variants["coin-end"]
        agency.assess_policy(Random(), "coinrun", variant, "coin-end", [3])


def test_a_level_file_that_is_none_is_told_before_an_explanation_plays(
    astray, tmp_path, monkeypatch
):
    monkeypatch.setattr(runs, "rehearse", lambda *_: pytest.fail("it plays"))
    (tmp_path / "level.json").write_text("{")
    words = ("explain", "maze-corner", "--level-file", tmp_path / "level.json")
    assert "level.json: Expecting property" in astray(*words, fails=True)


def test_a_package_that_findings_need_is_missed_before_training(tmp_path):
    with pytest.raises(ImportError, match=r"Early. needs no_such: pip install .\.\[insight\]"):
        run.reproduce(experiment(plan(), needs={"no_such": "insight"}), "smoke", tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_disk_without_room_for_the_agents_is_told_before_training(tmp_path, full_disk):
    """A run's settings would fit; its first checkpoint would not."""
    full_disk(500_000)
    with pytest.raises(OSError, match=r"config\.json"):
        run.reproduce(
            experiment(plan(agents={"mouse": replace(TINY, levels=3)}, levels=2)), "smoke", tmp_path
        )
    assert not list(tmp_path.iterdir())


def test_a_measure_with_the_name_of_a_column_is_refused_by_the_plan():
    with pytest.raises(ValueError, match="measures have the names of other columns: length"):
        plan(measures={"length": lambda states: states["time"]})


@pytest.mark.parametrize(
    "shift, said",
    [
        (Shift("corner-small", "no-such", "cheese", ("corner",)), "unknown variant 'no-such'"),
        (Shift("corner-small", "anywhere-small", "cheese", ("no-such",)), "unknown goal 'no-such'"),
    ],
)
def test_a_shift_to_what_the_game_lacks_is_refused(shift, said):
    with pytest.raises(ValueError, match=said.replace(" 'no", " of a shift 'no")):
        replace(MAZE, shifts={"wrong": shift})
    with pytest.raises(ValueError, match=rf"{said} of maze, named by the shift "):
        load_shift(MAZE, shift)
    with pytest.raises(ValueError, match=said):
        Sweep(TINY, {"width": [4]}, shift=shift)


def test_a_lab_that_cannot_be_exported_is_refused_before_anything_is_computed(
    tmp_path, monkeypatch
):
    def initial_states(*_):
        pytest.fail("it computes levels")

    monkeypatch.setattr(exporting, "initial_states", initial_states)
    monkeypatch.setattr(games, "_registered", {"mine": replace(MAZE, name="mine")})
    with pytest.raises(
        ValueError, match=r"mine must be a world of `astray\.grid`.*without --export"
    ):
        exporting.export(make_lab(None, {"game": "mine"}), tmp_path / "site")
    with pytest.raises(ValueError, match="'coin-end-pixels' sees images of coinrun: there is no"):
        exporting.export(make_lab("coin-end-pixels", {}), tmp_path / "site")
    with pytest.raises(ValueError, match="unknown variant 'far' of heist"):
        exporting.export(make_lab(None, {}), tmp_path / "site", games={"heist": "far"})


def test_a_broken_agent_keeps_no_other_from_an_exported_page(tmp_path, monkeypatch):
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    whole = exporting.check_exportable(make_lab("maze-corner", {"level": 0}), None, {})
    ruined = shutil.copytree(folders.find("maze-corner"), tmp_path / "ruined")
    (weights,) = ruined.glob("checkpoints/*/agent.safetensors")
    weights.write_bytes(b"x")
    found = exporting.check_exportable(make_lab("maze-corner", {"level": 0}), None, {})
    assert found == whole and "ruined" not in found and "coin-end" in found
    with pytest.raises(ValueError, match="is not an agent that can be used"):
        exporting.check_exportable(make_lab("maze-corner", {"level": 0}), ["ruined"], {})


def test_a_lab_that_cannot_be_exported_is_refused_before_a_level_is_looked_for(
    astray, tmp_path, monkeypatch
):
    monkeypatch.setattr(serving, "typical", lambda *_, **__: pytest.fail("it looks"))
    (tmp_path / "mine").write_text("of the user's")
    said = f"{tmp_path} must be new, or an empty folder; there is something in it"
    assert said in astray("lab", "maze-corner", "--export", tmp_path, fails=True)
    words = ("lab", "coin-end-pixels", "--export", tmp_path / "site")
    assert "'coin-end-pixels' sees images of coinrun: there is no" in astray(*words, fails=True)


def test_a_lab_of_few_exported_levels_begins_with_one_that_tells_something(
    astray, tmp_path, monkeypatch
):
    """Level 17 was chosen, which is not exported, and level 0 was shown without a reason."""
    begun = []
    monkeypatch.setattr(exporting, "export", lambda lab, *_: begun.append(lab.start))
    astray("lab", "maze-corner", "--export", tmp_path / "site", "--num-levels", "9")
    (start,) = begun
    assert start["level"] < 9 and f"Level {start['level']} was chosen: the agent" in start["why"]


@pytest.mark.parametrize("words", [("audit", "maze-corner"), ("reproduce", "maze-corner")])
def test_a_file_in_the_place_of_a_folder_is_told_as_one(astray, tmp_path, words):
    (tmp_path / "file").write_text("in the way")
    for folder in (tmp_path / "file", tmp_path / "file" / "reports"):
        told = astray(*words, "--out", folder, fails=True)
        assert f"{tmp_path / 'file'} must be a folder; it is a file" in told


def test_a_game_without_an_agent_is_exported_with_the_variant_that_is_named(tmp_path):
    lab = make_lab("maze-corner", {})
    exporting.export(lab, tmp_path / "site", 1, ["maze-corner"], {"heist": "near-small"})
    there = json.loads((tmp_path / "site" / "data" / "index.json").read_text())["games"]
    assert [*there["heist"]["variants"]] == ["hard", "near", "near-small"]


@pytest.mark.parametrize(
    "words, said",
    [
        (("--layers", "features.nope"), "unknown layer 'features.nope'; there are: "),
        (("--out", "file"), "file must be a folder; it is a file"),
        (("--out", "mine"), "mine/without-goal.png was not written by astray, which would have"),
    ],
)
def test_an_explanation_that_cannot_be_is_refused_before_a_level_is_looked_for(
    astray, tmp_path, monkeypatch, words, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "without-goal.png").write_text("of the user's")
    monkeypatch.setattr(GameVectorEnv, "reset", lambda *_, **__: pytest.fail("it was played"))
    assert said in astray("explain", "maze-corner", *words, fails=True)


def test_a_policy_of_the_name_of_a_script_is_refused_before_a_step_is_tried(monkeypatch):
    monkeypatch.setattr(GameVectorEnv, "reset", lambda *_, **__: pytest.fail("it was played"))
    own = Function(lambda seen: np.zeros(len(seen), int), "random")
    with pytest.raises(ValueError, match="policies must have names of their own; got walk to"):
        evaluate_policies([own], "maze", "corner-small")


@pytest.mark.parametrize(
    "verb, option, first",
    [
        ("explain", "--out", "page/explain.html"),
        ("export", "--out", "page"),
        ("lab", "--export", "page/index.html"),
        ("audit", "--out", "page/audit-maze-corner-corner-small-smoke/plan.json"),
    ],
)
def test_a_folder_without_room_is_refused_before_a_level_is_looked_for(
    astray, tmp_path, monkeypatch, full_disk, verb, option, first
):
    monkeypatch.setattr(GameVectorEnv, "reset", lambda *_, **__: pytest.fail("it was played"))
    full_disk(100_000)
    said = astray(verb, "maze-corner", option, tmp_path / "page", fails=True)
    assert said.endswith(f"large; nothing was written: '{tmp_path / first}'\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("game, variant", [("boat", "race"), ("monsters", "short")])
def test_a_solver_that_has_no_event_to_walk_to_is_refused_with_the_reason(astray, game, variant):
    words = ("train", game, variant, "--teacher", "solver")
    said = f"there are: none in {game}, whose goals no event shows"
    assert said in astray(*words, fails=True)


HELD = """
import multiprocessing
from pathlib import Path
from astray.files import hold

with hold(Path("out"), "works in"):
    child = multiprocessing.get_context("spawn").Process(target=print)
    child.start()
    child.join()
"""


def test_a_script_that_its_processes_import_does_not_wait_for_itself(tmp_path):
    """It held a folder and waited for a process, which waited for the folder, for ever."""
    (tmp_path / "held.py").write_text(HELD)
    done = subprocess.run(
        [sys.executable, "held.py"],
        cwd=tmp_path,
        env=environment(),
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    assert "out is held by the process that began this one, as of a script" in done.stderr


def test_a_training_whose_process_dies_is_told():
    told = "for want of memory, or died, as of a script without `if __name__ == '__main__':`"
    with pytest.raises(RuntimeError, match=told), workers.in_processes(1):
        raise BrokenProcessPool
