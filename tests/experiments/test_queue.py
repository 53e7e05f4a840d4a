"""Several experiments in a row, and how long they will take."""

import importlib
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from astray.experiments import catalogue, outcomes, run, spec, workers
from astray.experiments.spec import Experiment, Plan
from astray.experiments.workers import expected
from astray.report import page as report
from astray.training import checkpoint
from astray.training.loop import train
from helpers.edits import forget
from helpers.trainings import TINY


@pytest.fixture
def done(monkeypatch):
    """The names of what is reproduced; "maze-corner" fails."""
    names = []

    def reproduce(name, size, root, **_):
        names.append(name)
        if name == "maze-corner":
            raise OSError("no space left")
        return root

    monkeypatch.setattr(run, "reproduce", reproduce)
    monkeypatch.setattr(report, "write_index", lambda root: root)
    return names


QUEUE = ["maze-region", "maze-corner", "keys-and-chests"]


def test_where_one_fails_the_next_goes_on_and_the_end_says_which_failed(done, capsys):
    with pytest.raises(RuntimeError, match=r"1 of 3 experiments failed: maze-corner: .*no space"):
        run.reproduce_each(QUEUE, "smoke", Path())
    assert done == QUEUE
    told = capsys.readouterr().err
    assert re.search(r"maze-corner failed, .*: no space left \(test_queue.py, line \d+\)\n", told)


@pytest.mark.parametrize(
    "names, message",
    [
        ([*QUEUE, "maze-cornr"], "unknown experiment 'maze-cornr'"),
        ([*QUEUE, "published-results"], "unknown size 'smoke' of published-results"),
    ],
)
def test_a_queue_with_a_mistake_in_it_does_not_begin(names, message, done):
    with pytest.raises(ValueError, match=message):
        run.reproduce_each(names, "smoke", Path())
    assert not done


def test_an_index_of_the_users_is_not_replaced_which_is_told_before_the_work(done, tmp_path):
    (tmp_path / "index.html").write_text("my own site")
    with pytest.raises(OSError, match=r"index\.html was not written by astray; it would be repl"):
        run.reproduce_each(["keys-and-chests"], "smoke", tmp_path)
    assert not done and (tmp_path / "index.html").read_text() == "my own site"
    (tmp_path / "index.html").write_bytes(report.INDEX_SIGN)
    run.reproduce_each(["keys-and-chests"], "smoke", tmp_path)
    assert done == ["keys-and-chests"]


def test_a_study_whose_code_is_edited_while_it_waits_has_the_tables_of_what_was_loaded(
    tmp_path, monkeypatch
):
    source = tmp_path / "waits_here.py"
    source.write_text(
        "from astray.experiments.studies.maze.maze_corner import EXPERIMENT as OTHER\n"
        "from dataclasses import replace\ndef find(work): 1\n"
        "EXPERIMENT = replace(OTHER, find=find)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    digests = []

    def reproduce(name, size, *_):
        whole = catalogue.find("waits_here:EXPERIMENT")[1]
        digests.append(run.code_of(whole.sizes[size], whole))
        source.write_text(source.read_text() + "\n")

    monkeypatch.setattr(run, "reproduce", reproduce)
    monkeypatch.setattr(report, "write_index", lambda root: root)
    run.reproduce_each(["maze-corner", "waits_here:EXPERIMENT"], "smoke", Path())
    assert None not in digests and len(digests) == 2 and len({*digests}) == 1
    forget(monkeypatch)
    reproduce("waits_here", "smoke")
    assert len({*digests}) == 2


@pytest.mark.parametrize("part", ["measures", "rewards", "find"])
def test_code_counts_as_it_was_when_a_plan_or_study_of_it_was_made(part, tmp_path, monkeypatch):
    source, name = tmp_path / f"of_{part}.py", f"of_{part}"
    source.write_text("def one(_): return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    one = importlib.import_module(name).one
    its = {} if part == "find" else {part: {"one": one}}
    plan = Plan(agents={"mouse": TINY}, levels=1, differences="", **its)
    whole = Experiment("", "", "", {"smoke": plan}, one if part == "find" else outcomes.findings)
    source.write_text("def one(_): return 2  # later\n")
    before = run.code_of(plan, whole)
    forget(monkeypatch)
    assert None is not before != run.code_of(plan, whole)


def test_agents_are_not_trained_by_code_that_was_edited_since_the_command_began(
    tmp_path, monkeypatch
):
    source, pay = tmp_path / "edited_pay.py", "def pay(step):\n    return step.rewards * {}\n"
    source.write_text(pay.format(1))
    monkeypatch.syspath_prepend(tmp_path)
    trained, config = [], replace(TINY, validation=None, reward="edited_pay:pay")
    plan = Plan(
        agents={"first": config, "second": replace(config, variant="anywhere-small")},
        starts={"second": "first"},
        levels=1,
        differences="",
    )

    def train_all(todo, workers, on, track, known):
        forget(monkeypatch)  # as in the process of a training
        for folder, one in todo.items():
            spec.check_unedited(one, known)
            trained.append(train(one, folder, progress=False))
            source.write_text(pay.format(2))

    monkeypatch.setattr(run, "train_all", train_all)
    with pytest.raises(ValueError, match="edited_pay was edited after this command began"):
        run.train_agents(plan, tmp_path, 1, "here")
    assert len(trained) == 1
    monkeypatch.setattr(workers, "ProcessPoolExecutor", lambda count, *_: ThreadPoolExecutor(count))
    with pytest.raises(ValueError, match="edited_pay was edited after this command began"):
        workers.train_all({tmp_path / "run": config}, 1, known={"edited_pay": "another"})


def test_art_that_no_study_has_is_refused_once(done, capsys):
    with pytest.raises(ValueError, match=r"^published agents see the art that they know"):
        run.reproduce_each(["all"], "published", Path(), art="original")
    assert not done and not capsys.readouterr().err


def test_all_are_those_of_the_size(done):
    with pytest.raises(RuntimeError, match="maze-corner"):
        run.reproduce_each(["all"], "night", Path())
    assert done == [n for n in catalogue.NAMES if "night" in catalogue.load(n).sizes]
    assert len(done) > 5


def test_hours_are_of_the_steps_that_are_left(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "usable_processors", lambda: 4)
    config = replace(TINY, steps=1024, checkpoint_every=2)
    train(config, tmp_path / "done", progress=False)
    todo = {tmp_path / "done": config} | {
        tmp_path / f"{k}": replace(config, steps=36_000_000) for k in range(3)
    }
    told = expected(todo, 1000, workers=2)
    # Three of 10 hours each: one after two.
    assert "4 agents, 1 of them trained; 108.0 million steps are left, about 15.0 hours" in told
    assert "about 30.0 hours with 1 at once" in expected(todo, 1000, workers=1)
    assert "about 10.0 hours" in expected(todo, 1000, workers=9)
    monkeypatch.setattr(workers, "usable_processors", lambda: 2)  # which three at once share
    assert "about 15.0 hours with 3 at once" in expected(todo, 1000, workers=3)


def test_hours_say_where_a_processor_is_slower_than_those_measured(tmp_path, monkeypatch):
    for native in True, False:
        monkeypatch.setattr(workers, "get_host_cpu_features", lambda n=native: {"avx512bf16": n})
        told = expected({tmp_path: TINY}, 1000)
        assert ("without, as here, two to five times as long" not in told) == native


def test_a_training_under_way_has_less_to_go(tmp_path):
    config = replace(TINY, steps=10 * 1024)
    (tmp_path / "checkpoints" / "5120").mkdir(parents=True)
    assert checkpoint.steps_saved(tmp_path) == [5120]
    half = expected({tmp_path: config}, 1, workers=1)
    assert f"about {5120 / 3600:.1f} hours" in half
