"""Trackers of others, offline and for real where they are installed."""

import json
import sqlite3
import struct
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import astray
from astray.experiments import track as behaviour
from astray.training import checkpoint, track
from astray.training.loop import train
from helpers.processes import begin, environment
from helpers.trainings import TINY, digest

CONFIG = replace(TINY, knobs={})


def test_an_agent_whose_test_may_never_end_is_not_played_for_a_tracker(tmp_path, monkeypatch):
    config = replace(TINY, knobs={**TINY.knobs, "time_limit": 2_000_000})
    agent = SimpleNamespace(path=tmp_path / "1024" / checkpoint.AGENT)
    monkeypatch.setattr(behaviour, "open_run", lambda run: (agent, config))
    monkeypatch.setattr(behaviour, "evaluate_runs", lambda *_, **__: pytest.fail("it plays"))
    assert behaviour.track_outcomes(tmp_path, "trackio") is None


class Kept:
    """A tracker's run that keeps what it is told, in the place of an installed tracker's."""

    def __init__(self, fails=False):
        self.told, self.ended, self.fails = [], 0, fails

    def log(self, values, step=None):
        if self.fails:
            raise ConnectionError("nobody answers")
        self.told.append((step, values))

    def finish(self):
        self.ended += 1


@pytest.fixture
def told(monkeypatch):
    """What Trackio is told, were it installed."""
    run = Kept()
    monkeypatch.setitem(sys.modules, "trackio", ModuleType("trackio"))
    monkeypatch.setattr(track, "_begin_trackio", lambda name, folder, settings: (run, None))
    return run


def test_a_tracker_is_told_what_metrics_jsonl_has(told, tmp_path):
    track.train_tracked(CONFIG, tmp_path, "trackio", progress=False)
    lines = checkpoint.metrics(tmp_path)
    assert [step for step, _ in told.told] == [line["steps"] for line in lines]
    for (step, values), line in zip(told.told, lines, strict=True):
        assert {"steps": step} | {k: v for k, v in values.items() if k in line} == line
        assert values.keys() - line.keys() == {"speed/steps_per_second", "speed/playing"}
    assert told.ended == 1


def test_a_tracked_run_learns_what_one_without_learns(told, tmp_path):
    track.train_tracked(CONFIG, tmp_path / "tracked", "trackio", progress=False)
    train(CONFIG, tmp_path / "plain", progress=False)
    assert digest(tmp_path / "tracked") == digest(tmp_path / "plain")


def test_of_several_processes_one_tells(told, tmp_path, monkeypatch):
    monkeypatch.setattr(track, "parallel", SimpleNamespace(first=lambda: False))
    track.train_tracked(CONFIG, tmp_path, "trackio", progress=False)
    assert not told.told and not told.ended and checkpoint.finished(tmp_path, CONFIG)


def test_a_tracker_that_fails_is_told_once_and_harms_nothing(told, tmp_path):
    told.fails = True
    with pytest.warns(UserWarning, match="trackio did not take something: nobody") as warned:
        track.train_tracked(CONFIG, tmp_path, "trackio", progress=False)
    assert len(warned) == 1
    assert checkpoint.finished(tmp_path, CONFIG)


def test_a_run_that_goes_on_is_the_same_run_to_its_tracker(tmp_path):
    one = track._id(tmp_path, "wandb")
    assert track._id(tmp_path, "wandb") == one != track._id(tmp_path, "trackio")
    assert json.loads((tmp_path / "track.json").read_text()).keys() == {"wandb", "trackio"}
    (tmp_path / "track.json").write_text('{"wandb": 3}')
    with pytest.raises(ValueError, match="is not as astray writes it: it must map names to texts"):
        track._id(tmp_path, "wandb")


@pytest.mark.parametrize("by", ["wandb", "trackio"])
def test_a_tracker_that_is_missing_is_told(by, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, by, None)
    with pytest.raises(ImportError, match=rf'{by} is not installed: pip install ".\[track\]"'):
        track.Tracker(by, "name", tmp_path, {})


@pytest.mark.parametrize("study", ["maze-corner", None])
def test_a_tracker_that_is_missing_is_told_before_the_work(study, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trackio", None)
    with pytest.raises(ImportError, match="trackio is not installed"):
        if study:
            astray.reproduce(study, "smoke", tmp_path, track="trackio")
        else:
            track.train_tracked(CONFIG, tmp_path, "trackio", progress=False)
    assert not [*tmp_path.iterdir()]


def test_a_login_that_fails_is_told_before_a_run_folder_is_made(tmp_path, monkeypatch):
    def login():
        raise ConnectionError("no key")

    wandb = ModuleType("wandb")
    monkeypatch.setattr(wandb, "login", login, raising=False)
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    monkeypatch.setenv("WANDB_MODE", "online")
    with pytest.raises(RuntimeError, match="wandb cannot track this run: no key"):
        track.train_tracked(CONFIG, tmp_path / "run", "wandb", progress=False)
    assert not [*tmp_path.iterdir()]
    monkeypatch.setenv("WANDB_MODE", "offline")  # where nobody needs a login
    track.check_installed("wandb")


def test_an_unknown_tracker_is_told(tmp_path):
    with pytest.raises(ValueError, match="unknown tracker 'mlflow'; there are: wandb, trackio"):
        track.Tracker("mlflow", "name", tmp_path, {})
    iterations = (pytest.fail("it trains") for _ in range(1))
    with pytest.raises(ValueError, match="unknown tracker 'mlflow'"):
        next(track.tracked(iterations, "mlflow", CONFIG, tmp_path))  # pyrefly: ignore


COMMAND = [
    "train", "maze", "corner-small", "--validation", "anywhere-small", "--steps", "8192",
    "--num-envs", "32", "--num-steps", "32", "--minibatches", "4", "--width", "16",
]  # fmt: skip


def trained_with(by, folder, **variables):
    """Runs `astray train --track` in a process of its own; its run folder."""
    program = "from astray.cli import main; main()"
    words = [*COMMAND, "--out", "runs", "--track", by]
    code, _, said = begin(program, folder, *words, env=environment(**variables)).ended()
    assert code == 0, said
    return folder / "runs" / "seed-0", said


class Wandb(Kept, ModuleType):
    """A library in the place of wandb, and its only run."""

    Settings = staticmethod(lambda **settings: settings)

    def __init__(self):
        Kept.__init__(self)
        self.begun, self.metrics = [], []

    def init(self, **how):
        self.begun.append(how)
        return self

    def define_metric(self, name, step_metric):
        self.metrics.append((name, step_metric))

    def Video(self, path, format):
        return Path(path).stat().st_size > 0, format

    def Table(self, columns, data):
        return columns, data


@pytest.mark.usefixtures("undrawn")
def test_wandb_is_told_settings_metrics_outcomes_and_a_video(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", wandb := Wandb())
    monkeypatch.setenv("WANDB_MODE", "offline")
    track.train_tracked(CONFIG, tmp_path, "wandb", progress=False)
    behaviour.track_outcomes(tmp_path, "wandb", levels=4)
    assert {one["id"] for one in wandb.begun} == {track._id(tmp_path, "wandb")}
    assert all(one["config"] == CONFIG.to_json() for one in wandb.begun)
    assert wandb.metrics == 2 * [("*", "steps")] and wandb.ended == len(wandb.begun) == 2
    rows = [row for _, row in wandb.told]
    told = [row["training/return"] for row in rows if "training/return" in row]
    assert told == [line["training/return"] for line in checkpoint.metrics(tmp_path)]
    (video,) = [row["video"] for row in rows if "video" in row]
    ((columns, table),) = [row["outcomes"] for row in rows if "outcomes" in row]
    assert video == (True, "gif") and len(columns) == len(table[0])
    assert "outcome/goal misgeneralization" in rows[-1] and all("steps" in row for row in rows)


@pytest.mark.thorough  # the test before
@pytest.mark.skipif(not find_spec("wandb"), reason="wandb is not installed")
def test_wandb_offline_has_settings_metrics_outcomes_and_a_video(tmp_path):
    run, said = trained_with("wandb", tmp_path, WANDB_MODE="offline", WANDB_DIR=str(tmp_path))
    assert "did not take" not in said
    logs = sorted(run.glob("wandb/offline-run-*/run-*.wandb"))
    assert len(logs) == 2 and len({log.name for log in logs}) == 1  # parts of one run
    rows = [row for log in logs for row in history(log)]
    returns = [row["training/return"] for row in rows if "training/return" in row]
    assert returns == [
        line["training/return"] for line in checkpoint.metrics(run) if "training/return" in line
    ]
    names = {name for row in rows for name in row}
    assert {"outcome/goal misgeneralization", "steps"} <= names
    assert {"video", "outcomes"} <= {name.partition("/")[0] for name in names}
    assert len(list(run.glob("wandb/offline-run-*/files/media/videos/*.gif"))) == 1
    assert len(list(run.glob("wandb/offline-run-*/files/media/table/*.json"))) == 1


def history(path):
    """What a log of wandb's says: the values of each step, by name."""
    from wandb.proto import wandb_internal_pb2

    for data in records(path.read_bytes()):
        record = wandb_internal_pb2.Record()
        record.ParseFromString(data)
        if record.HasField("history"):
            yield {
                item.key or "/".join(item.nested_key): json.loads(item.value_json)
                for item in record.history.item
            }


def records(data, block=32_768, head=7):
    """The records of a file in LevelDB's format: pieces of 32 KB, each with its own head."""
    at, whole = head, b""
    while at + head <= len(data):
        if block - at % block < head:
            at += block - at % block
            continue
        _, length, kind = struct.unpack_from("<IHB", data, at)
        whole += data[at + head : at + head + length]
        at += head + length
        if kind in (1, 4):  # whole, or the last of several pieces
            yield whole
            whole = b""


@pytest.mark.skipif(not find_spec("trackio"), reason="trackio is not installed")
def test_trackio_has_metrics_outcomes_and_a_video(tmp_path):
    kept = tmp_path / "trackio"
    run, said = trained_with("trackio", tmp_path, TRACKIO_DIR=str(kept))
    assert "did not take" not in said
    with sqlite3.connect(next(kept.glob("astray*.db"))) as base:
        rows = [json.loads(text) for (text,) in base.execute("select metrics from metrics")]
    names = {name for row in rows for name in row}
    assert {"training/return", "speed/steps_per_second", "outcomes", "video"} <= names
    returns = [row["training/return"] for row in rows if "training/return" in row]
    assert returns == [
        line["training/return"] for line in checkpoint.metrics(run) if "training/return" in line
    ]
    assert list(Path(kept / "media").rglob("*.gif"))
