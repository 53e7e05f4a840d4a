"""Checkpoints: killed, cut short, crowded, forged; nothing is lost, and nothing let in."""

import ast
import importlib
import json
import math
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from torch import nn

from astray.agents import policy
from astray.analysis.runs import evaluate_runs
from astray.experiments.workers import Progress
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.log import METRICS
from astray.training.loop import train
from helpers.checkpoints import forge
from helpers.killed import CONFIG
from helpers.processes import begin
from helpers.trainings import PLAIN, digest, train_to_first_checkpoint

SHORT = replace(CONFIG, steps=4 * 1024)
LONG = replace(CONFIG, num_steps=4, steps=40 * 64)  # with many checkpoints
PACKAGE = Path(policy.__file__).parents[1]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of a few steps; copied before anything is done to it."""
    folder = tmp_path_factory.mktemp("run")
    train(SHORT, folder, progress=False)
    return folder


@pytest.fixture
def run(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "run")


def files(folder):
    """Everything in a folder, but for the lock and what TensorBoard reads."""
    paths = [p for p in folder.rglob("*") if p.is_file() and "tensorboard" not in p.parts]
    return {p.relative_to(folder): p.read_bytes() for p in paths if p.name != ".lock"}


def test_a_run_whose_code_was_edited_meanwhile_is_told(run, caplog):
    train(SHORT, run, progress=False)
    assert not caplog.messages
    path = run / "config.json"
    told = json.loads(path.read_text("utf-8"))
    told["versions"]["sources"] = "0" * 16
    path.write_text(json.dumps(told), "utf-8")
    train(SHORT, run, progress=False)
    assert caplog.messages == [checkpoint.EDITED % run]


def test_a_run_notes_the_code_that_was_loaded_not_a_later_edit(tmp_path, monkeypatch, caplog):
    source, text = tmp_path / "loaded_pay.py", "def pay(step):\n    return step.rewards * {}\n"
    monkeypatch.syspath_prepend(tmp_path)
    source.write_text(text.format(1))
    pay, told = importlib.import_module("loaded_pay"), []
    config = replace(SHORT, reward="loaded_pay:pay")
    for number in (1, 2, 3):
        with checkpoint.claim(run := tmp_path / f"{number}", config):
            told.append(json.loads((run / "config.json").read_text())["versions"]["sources"])
            (run / "metrics.jsonl").write_text('{"steps": 64}\n')  # else none had begun
        source.write_text(text.format(number + 1))
        if number == 2:
            importlib.invalidate_caches()
            importlib.reload(pay)
    assert told[0] == told[1] != told[2]
    with checkpoint.claim(tmp_path / "2", config):
        assert caplog.messages == [checkpoint.EDITED % (tmp_path / "2")]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_run_that_is_killed_at_any_moment_loses_nothing(tmp_path):
    kills = os.environ.get("ASTRAY_KILLS", "3")
    program = "import runpy; runpy.run_module('helpers.killed', run_name='__main__')"
    code, out, err = begin(program, tmp_path, tmp_path, kills).ended()
    assert code == 0, err
    told = json.loads(out)
    assert told["kills"] >= int(kills) and told["runs"] >= 1


def test_a_kill_while_an_old_checkpoint_is_removed_leaves_no_half_of_it(tmp_path, monkeypatch):
    def half(folder, names):
        for agent in folder.glob(f".*/{checkpoint.AGENT}"):
            agent.unlink()
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("astray.files.remove_left", half)
        with pytest.raises(KeyboardInterrupt):
            train(LONG, tmp_path, progress=False)
    # The first to go is the one at 384, which is not the first after a milestone.
    assert checkpoint.steps_saved(tmp_path) == [128, 256, 512, 640]
    train(LONG, tmp_path, progress=False)
    assert not [p for p in (tmp_path / "checkpoints").iterdir() if p.name.startswith(".")]


def test_an_old_checkpoint_that_is_read_meanwhile_is_removed_with_a_later_one(
    tmp_path, monkeypatch
):
    refused, replaces = [], os.replace

    def replace_(source, to):
        if Path(to).name.startswith(".") and source not in refused:  # as Windows does, once each
            refused.append(source)
            raise PermissionError
        replaces(source, to)

    monkeypatch.setattr(os, "replace", replace_)
    train(LONG, tmp_path, progress=False)
    saved = {path.name for path in (tmp_path / "checkpoints").iterdir()}
    assert len(refused) > 1 and {path.name for path in refused[:-1]}.isdisjoint(saved)


def test_a_refused_training_leaves_no_settings_beside_checkpoints_that_have_others(run):
    (run / "config.json").unlink()
    with pytest.raises(ValueError, match="gamma is"):
        train(replace(SHORT, gamma=0.5), run, progress=False)
    train(SHORT, run, progress=False)
    assert json.loads((run / "config.json").read_text())["config"]["gamma"] == SHORT.gamma


@pytest.mark.parametrize("name", [checkpoint.AGENT, checkpoint.TRAINER])
def test_a_checkpoint_that_is_cut_at_any_byte_is_refused(run, name):
    path = checkpoint.latest(run) / name
    whole = path.read_bytes()
    header = 8 + int.from_bytes(whole[:8], "little")
    cuts = {*range(16), *range(0, header + 16, 101), header - 1, header, header + 1}
    cuts |= {*range(0, len(whole), len(whole) // 20), len(whole) - 1}
    claimed = checkpoint.Trainer(SHORT)
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        before = files(run)
        with pytest.raises(ValueError, match=name):
            checkpoint.restore(run, claimed)
        assert files(run) == before
    claimed.close()
    path.write_bytes(whole[:cut])
    before = files(run)
    with pytest.raises(ValueError, match=name):
        train(replace(SHORT), run, progress=False)
    assert files(run) == before


@pytest.mark.parametrize(
    "name, changes, message",
    [
        (checkpoint.AGENT, {"format": 2}, "has format 2; this version reads 1"),
        (checkpoint.AGENT, {"game": "keys"}, "of the game 'keys', not of 'maze'"),
        (checkpoint.AGENT, {"architecture": None}, "its architecture is None"),
        (checkpoint.TRAINER, {"format": 2}, "has format 2; this version reads 1"),
        (checkpoint.TRAINER, {"game": "keys"}, "of the game 'keys', not of 'maze'"),
        (checkpoint.TRAINER, {"config": {}}, "it is of another run"),
        (checkpoint.TRAINER, {"config": {"brand_new": 1}}, "no setting 'brand_new'; a later"),
        (
            checkpoint.TRAINER,
            {"tensors": {"training.states": np.zeros(100, np.uint8)}},
            "cannot be resumed from",
        ),
    ],
)
def test_a_checkpoint_of_something_else_is_refused(run, name, changes, message):
    forge(checkpoint.latest(run) / name, **changes)
    before = files(run)
    with pytest.raises(ValueError, match=message):
        train(SHORT, run, progress=False)
    assert files(run) == before


def test_a_corrupt_state_in_a_checkpoint_never_reaches_compiled_code(run):
    path = checkpoint.latest(run) / checkpoint.TRAINER
    states = load_file(path)["training.states"].copy()
    forge(path, tensors={"training.states": np.full_like(states, 255)})
    with pytest.raises(ValueError, match="is invalid for this variant"):
        train(SHORT, run, progress=False)


@pytest.mark.parametrize(
    "name, change, message",
    [
        ("training.recent", lambda x: x[:, :-1], r"recent must be torch.float64 .*; got"),
        (
            "training.recent",
            lambda x: np.zeros((101, x.shape[1])),
            r"recent must be .*; got .* \[101, ",
        ),
        ("training.recent", lambda x: x[0], "recent must be"),
        ("training.running_return", lambda x: x[:-1], r"must be torch.float64 \[16\]"),
        (
            "training.running_return",
            lambda x: x.astype(np.float32),
            r"running_return must be .*; got torch.flo",
        ),
        ("training.running_return", lambda x: x * np.nan, "has numbers that are not finite"),
        ("training.moments", lambda x: x.astype(int), r"moments must be .*; got torch.int64"),
        ("training.normaliser_returns", lambda x: x[None], "normaliser_returns must be"),
        ("training.generator", lambda x: x[:-1], "generator must be torch.uint8"),
        ("training.states", lambda x: x[: len(x) // 2], "states must be torch.uint8"),
        ("adam.0.exp_avg", lambda x: x.T.copy(), "adam.0.exp_avg must be"),
        ("adam.0.exp_avg", lambda x: x.astype(np.float64), "must be torch.float32"),
        ("adam.0.step", lambda x: np.zeros(2, np.float32), r"adam.0.step must be .*; got .* \[2\]"),
        ("steps", lambda x: x + 1, "steps must be a multiple of"),
        ("steps", lambda x: x * 2, "it is of step"),
        ("steps", lambda x: x * 1.0, r"steps must be .*; got torch.float64"),
        ("brand_new", lambda _: np.zeros(1), "brand_new is not one of its"),
    ],
)
def test_a_trainer_has_the_arrays_of_its_training(run, name, change, message):
    path = checkpoint.latest(run) / checkpoint.TRAINER
    forge(path, tensors={name: change(load_file(path).get(name))})
    before = files(run)
    with pytest.raises(ValueError, match=f"cannot be resumed from: .*{message}"):
        train(SHORT, run, progress=False)
    assert files(run) == before


@pytest.mark.parametrize("names", [["exp_avg_sq"], ["exp_avg", "exp_avg_sq", "step"]])
def test_a_trainer_lacks_nothing(run, names):
    path = checkpoint.latest(run) / checkpoint.TRAINER
    tensors = load_file(path)
    for name in names:
        del tensors[f"adam.3.{name}"]
    with safe_open(path, "np") as file:
        told = file.metadata()
    save_file(tensors, path, told)
    with pytest.raises(ValueError, match=rf"adam\.3\.{names[0]} is missing"):
        train(SHORT, run, progress=False)


class Odd(nn.Module):
    """Has a layer that is not trained, one that is not asked, and one of two names."""

    def __init__(self, its):
        super().__init__()
        self.frozen, self.unused = nn.Linear(math.prod(its.shape), 8), nn.Linear(2, 2)
        self.policy, self.value = nn.Linear(8, its.actions), nn.Linear(8, 1)
        self.frozen.requires_grad_(False)
        self.heads = nn.ModuleList([self.policy, self.value])

    def forward(self, seen):
        features = self.frozen(seen.flatten(1).float())
        return self.policy(features), self.value(features).squeeze(1)


@pytest.mark.filterwarnings("ignore:training runs the network")
def test_a_network_of_frozen_unused_and_shared_layers_resumes(tmp_path, monkeypatch):
    config = PLAIN.changed(network=f"{__name__}:Odd")
    train(config, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(config, tmp_path / "stopped", monkeypatch)
    train(config, tmp_path / "stopped", progress=False)
    assert digest(tmp_path / "stopped") == digest(tmp_path / "whole")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_agent_of_other_than_numbers_is_refused(run, value):
    path = checkpoint.latest(run) / checkpoint.AGENT
    name, weights = next(iter(load_file(path).items()))
    weights.flat[3] = value
    forge(path, tensors={name: weights})
    with pytest.raises(ValueError, match="its weights are not all finite numbers"):
        evaluate_runs([run])


def test_an_agent_whose_logits_overflow_is_not_evaluated(run):
    path = checkpoint.latest(run) / checkpoint.AGENT
    forge(path, tensors={name: np.full_like(x, 1e38) for name, x in load_file(path).items()})
    with pytest.raises(ValueError, match="gives logits that are not finite"):
        evaluate_runs([run], np.arange(3))


def test_one_agent_is_not_counted_as_several(run, tmp_path):
    shutil.copytree(run, tmp_path / "copy")
    for other in (run, checkpoint.latest(run), tmp_path / "copy"):
        with pytest.raises(ValueError, match="are the same agent"):
            evaluate_runs([run, other], np.arange(3))


@pytest.mark.parametrize(
    "line", ["{}", "null", "[1, 2]", '{"steps": "many"}', '{"steps": 1.5}', '{"steps": -1}', "{",
             '{"steps": true}', '{"steps": 1, "training/return": null}', "", "[" * 10**5, "\x00",
             '{"steps": 1, "training/return": [1]}'],
)  # fmt: skip
def test_a_line_of_metrics_that_is_none_is_named(run, line):
    path = run / METRICS
    path.write_text(path.read_text() + f"{line}\n")
    before = files(run)
    for read in (lambda: checkpoint.metrics(run), lambda: train(SHORT, run, progress=False)):
        with pytest.raises(ValueError, match=r"metrics\.jsonl, line \d+: "):
            read()
    assert files(run) == before
    Progress(run, SHORT).look()  # a training's look at another's never ends it


def test_metrics_that_are_no_text_are_refused(run):
    (run / METRICS).write_bytes(b"\xff\xfe\n")
    with pytest.raises(ValueError, match=r"metrics\.jsonl is not text"):
        checkpoint.metrics(run)


@pytest.mark.parametrize(
    "architecture",
    [
        {"width": 10**9},
        {"actions": 3_000_000},
        {"scale": 10**9, "name": "impala", "largest": []},
        {"actions": -1},
        {"actions": True},
        {"shape": [4, 7]},
        {"shape": [4, 10**9, 10**9]},
        {"largest": [0] * 4},
        {"largest": [6, 6, 1, 1]},
        {"name": "squid"},
        {"squid": 1},
        {"width": "64"},
    ],
)
def test_a_forged_architecture_does_no_more_than_fail(run, architecture):
    path = checkpoint.latest(run) / checkpoint.AGENT
    data = path.read_bytes()
    size = 8 + int.from_bytes(data[:8], "little")
    told = json.loads(json.loads(data[8:size])["__metadata__"]["astray"])
    forge(path, architecture=told["architecture"] | architecture)
    resource = pytest.importorskip("resource")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="is not an agent that can be used"):
        policy.load(path, "maze")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", '{"config": []}', '{"config": {"steps": "many"}}', "[" * 10**5,
     '{"config": {"steps": 1e999}}', '{"config": {"gamma": NaN}}', '{"config": {"squid": 1}}',
     '{"config": {"game": "chess"}}', '{"config": {"knobs": {"squid": 1}}}', "\x00", "\ufeff{}",
     '{"config": {"training_variant": {}}}', '{"config": {"levels": 4000000000}}'],
)  # fmt: skip
def test_settings_that_are_none_are_refused(run, text):
    (run / "config.json").write_text(text)
    before = files(run)
    with pytest.raises(ValueError, match=r"config\.json is not the settings of a run"):
        train(SHORT, run, progress=False)
    assert files(run) == before


@pytest.mark.parametrize(
    "change, message",
    [
        ({"gamma": 1.5}, "gamma must be from 0 to 1; got 1.5"),
        ({"learning_rate": -1.0}, "learning_rate must be from 0 to 1e.38; got -1.0"),
        ({"learning_rate": float("nan")}, "learning_rate must be of type float, finite; got nan"),
        ({"device": "tpu"}, "unknown device 'tpu'; there are: cpu, cuda, mps"),
        ({"steps": 1e6}, "steps must be of type int; got 1000000.0"),
        ({"anneal": 1}, "anneal must be of type bool; got 1"),
        ({"first_level": 2**31 - 100}, "some are left for tests"),
    ],
)
def test_bad_settings_are_explained(change, message):
    with pytest.raises(ValueError, match=message):
        SHORT.changed(**change)


FORBIDDEN = {"pickle", "joblib", "dill", "marshal", "shelve", "cloudpickle"}  # modules
# What reads pickles all the same: numba's own compiled code, in a folder of the user's alone.
READS = {"kernel/stored.py"}


def test_nothing_is_pickled():
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE).as_posix()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                module = getattr(node, "module", None) or node.names[0].name
                is_error = [one.name for one in node.names] == ["PickleError"]
                is_safe = module.partition(".")[0] not in FORBIDDEN or name in READS or is_error
                assert is_safe, (name, module)
            if isinstance(node, ast.Call):
                given = {k.arg: k.value for k in node.keywords}
                last = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if last not in ("eval", "exec", "save", "load") and "allow_pickle" not in given:
                    continue
                called = ast.unparse(node.func)
                assert called not in ("eval", "exec", "torch.save"), (name, called)
                safe = {k: ast.unparse(value) for k, value in given.items()}
                assert called != "torch.load" or safe.get("weights_only") == "True", name
                assert safe.get("allow_pickle", "False") == "False", name


def test_settings_survive_the_way_to_json_and_back():
    assert Config.from_json(json.loads(json.dumps(CONFIG.to_json()))) == CONFIG
