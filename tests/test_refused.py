"""What would end the process or never end is refused at once, with what was given."""

import functools
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from astray import cli, games
from astray.agents.policy import Architecture
from astray.analysis.runs import open_run
from astray.analysis.video import play
from astray.cli import settings, verbs
from astray.envs.pictures import picture
from astray.envs.pool import Pool, check_startable
from astray.envs.states import load_states
from astray.envs.vector import GameVectorEnv
from astray.files import check_writable, read
from astray.kernel.grid import distances
from astray.kernel.rng import fill_noise
from astray.level import Level
from astray.level_files import read_levels
from astray.training import checkpoint, folders
from astray.training.config import PRESETS
from astray.training.fast import fused, sparse
from astray.training.loop import train
from astray.training.ppo import Samples
from astray.validation import bounded
from helpers.cases import SHAPES
from helpers.flat import kinds, options

TINY = replace(
    PRESETS["small"],
    variant="corner-small",
    num_envs=8,
    num_steps=4,
    minibatches=1,
    width=4,
    steps=32,
    validation_every=1,
)
SMALL = games.find("maze").variants["corner-small"]
HUGE = 10**60
SECONDS = 60  # after which a test hangs


@pytest.fixture(autouse=True)
def _ends():
    """A test of this file that hangs fails instead."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it hangs"))
    signal.alarm(SECONDS)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("one, other", [("corner-small", "corner"), ("corner", "anywhere-small")])
@pytest.mark.parametrize("fused_cpu", [True, False])
def test_a_validation_of_another_size_is_refused_with_both(one, other, fused_cpu, tmp_path):
    config = TINY.changed(variant=one, validation=other, fused_cpu=fused_cpu)
    with pytest.raises(ValueError, match=rf"{other}' of \(4, .*{one}' of \(4, "):
        train(config, tmp_path)


def test_a_validation_of_another_size_is_played_where_images_are_as_large(tmp_path):
    config = replace(
        TINY, variant="corner-small", validation="corner", observation="image", network="impala"
    )
    assert train(config, tmp_path).name == "32"


@pytest.mark.parametrize(
    "planes",
    [
        torch.zeros((2, 4, 25, 25), dtype=torch.uint8),
        torch.zeros((2, 3, 7, 7), dtype=torch.uint8),
        torch.zeros((2, 4, 7, 7)),
        torch.zeros((4, 7, 7), dtype=torch.uint8),
        torch.zeros((2, 0, 7, 7), dtype=torch.uint8),
    ],
)
def test_compiled_networks_refuse_planes_that_they_were_not_built_for(planes):
    network = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=4).build()
    with pytest.raises(ValueError, match=r"planes must be \[B, 4, H, W\] uint8"):
        sparse.outputs(network, planes)


@pytest.mark.parametrize("action, count, error", [
    (15, 8, IndexError), (-1, 8, IndexError), (10**12, 8, IndexError), (0, 9, ValueError),
])  # fmt: skip
def test_the_compiled_loss_refuses_samples_of_other_outputs(action, count, error):
    column = torch.zeros(count)
    samples = Samples(column, torch.full((count,), action), column, column, column, column)
    with pytest.raises(error):
        fused.loss(torch.zeros((8, 16)), samples, (0.2, 0.5, 0.01))


@pytest.mark.parametrize("x, y", [(3, 0), (0, 3), (-1, 0), (10**12, 0), (0, -(10**12))])
def test_compiled_functions_refuse_cells_outside_of_their_grid(x, y):
    with pytest.raises(IndexError):
        distances(np.ones((3, 3), bool), x, y)


def test_compiled_noise_is_of_as_many_environments_as_there_are_levels():
    with pytest.raises(IndexError):
        fill_noise(0, np.zeros(2, np.int64), np.zeros(2, np.int64), np.zeros((99, 4), np.float32))


@pytest.mark.parametrize("game, variant", SHAPES)
def test_live_states_can_be_set_to_nothing_by_hand(game, variant):
    env = GameVectorEnv(game, variant, 2)
    env.reset(seed=0)
    before = env.get_state()
    for name in env.states.dtype.names:
        for value in (0, 10**12, -1):
            with pytest.raises(ValueError, match="read-only"):
                env.states[name] = value
            with pytest.raises(ValueError, match="read-only"):
                setattr(env.states[0], name, value)
    assert env.get_state().tobytes() == before.tobytes()
    env.step(np.zeros(2, int))
    assert env.states.tobytes() != before.tobytes()  # live all the same
    states = env.get_state()
    states["x"] = 10**12
    with pytest.raises(ValueError, match="state 0 is invalid for this variant"):
        env.set_state(states)
    env.close()


@pytest.mark.parametrize("game", games.OWN)
def test_states_of_bytes_are_checked_though_nobody_can_write_to_them(game):
    found = games.find(game)
    variant = next(iter(found.variants.values()))
    env = GameVectorEnv(found, variant, 1)
    env.reset(seed=0)
    live, states = env.states[0], env.get_state()
    found.solver.reachable(live)
    Level.of(found, variant, live)
    states["mt_next"] = 10**9
    (forged,) = np.frombuffer(states.tobytes(), found.state)
    assert not forged.flags.writeable
    for use in (found.solver.reachable, functools.partial(Level.of, found, variant)):
        with pytest.raises(ValueError, match="mt_next cannot be"):
            use(forged)


def test_what_steps_write_to_is_theirs_to_write():
    env = GameVectorEnv("maze", SMALL, 2)
    env.reset(seed=0)
    fixed = np.zeros((2, 64, 64, 3), np.uint8)
    fixed.setflags(write=False)
    for out in (fixed, np.zeros((2, 64, 64, 6), np.uint8)[..., ::2], np.zeros((1, 64, 64, 3))):
        with pytest.raises(ValueError, match="out must be"):
            env.step(np.zeros(2, int), out)


@pytest.mark.parametrize("game", games.OWN)
def test_a_variant_or_states_of_another_game_are_refused(game):
    other = games.find(next(name for name in games.OWN if name != game))
    variant = next(iter(other.variants.values()))
    own = next(iter(games.find(game).variants.values()))
    with pytest.raises(ValueError, match=f"not one of {game}"):
        GameVectorEnv(game, variant)
    for states in (np.zeros(1, other.state), np.zeros(3), np.zeros((1, 1), games.find(game).state)):
        with pytest.raises(ValueError, match=r"states must be \[N\] records of"):
            picture(game, own, states, 64)


@pytest.mark.parametrize("game", games.OWN)
def test_knobs_are_numbers_that_compiled_code_can_hold(game):
    variant = next(iter(games.find(game).variants.values()))
    for wrong in (HUGE, 2.5, "5", None, True, -HUGE):
        with pytest.raises(ValueError, match="time_limit must be an integer from"):
            replace(variant, time_limit=wrong)
    for wrong in (float("nan"), True, 1.5):
        with pytest.raises(ValueError, match="shift_probability must be a finite number"):
            replace(variant, shift_probability=wrong)
    with pytest.raises(ValueError, match="shift_probability must be of type float; got True"):
        variant.with_knobs({"shift_probability": True})


def test_an_agent_of_another_size_is_told_so_wherever_it_plays():
    agent, config = open_run(folders.find("maze-corner"))
    with pytest.raises(ValueError, match=r"of shape \(4, 7, 7\), not \(4, 25, 25\)"):
        play(agent, config.game, "corner", 0)


@pytest.mark.parametrize("pixels", [0, -1, HUGE, 2.5])
def test_pictures_have_as_many_pixels_as_fit_in_memory(pixels):
    env = GameVectorEnv("maze", SMALL)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="pixels must be an integer from 1 to 4096"):
        env.picture(pixels)


def test_threads_that_cannot_be_started_are_an_error_and_none_is_left(monkeypatch):
    threading = pytest.importorskip("threading")
    start, count, before = threading.Thread.start, iter(range(5)), set(threading.enumerate())

    def refused(thread):
        if next(count, None) is None:
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refused)
    with pytest.raises(RuntimeError, match="9 threads are asked for, but 6 can be started"):
        Pool(9)
    with pytest.raises(RuntimeError, match="9 threads are needed"):
        check_startable(9)
    monkeypatch.undo()
    for thread in set(threading.enumerate()) - before:
        thread.join(5)
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize("name, value", [
    ("threads", 5000), ("threads", HUGE), ("steps", HUGE), ("num_envs", HUGE),
    ("num_steps", HUGE), ("epochs", HUGE), ("width", HUGE), ("minibatches", HUGE),
    ("seed", HUGE), ("levels", HUGE),
    ("first_level", HUGE), ("groups", HUGE), ("checkpoint_every", HUGE),
])  # fmt: skip
def test_settings_without_measure_are_refused(name, value, tmp_path):
    with pytest.raises(ValueError, match=name):
        train(TINY.changed(**{name: value}), tmp_path)


def test_a_number_that_python_does_not_write_out_is_refused_all_the_same():
    with pytest.raises(ValueError, match=r"steps must be .*; got a number of 66439 bits"):
        replace(TINY, steps=10**20_000)


WORDS = {  # of each verb, so that nothing but the number is wrong
    "train": ["maze", "corner-small"], "evaluate": ["maze-corner"],
    "record": ["maze-corner"], "reproduce": ["maze-corner"],
    "explain": ["maze-corner"], "export": ["maze-corner"],
    "lab": ["maze-corner", "--no-browser"],
    "sweep": ["maze", "corner-small", "--set", "gamma=0.9,0.99"],
    "distil": ["maze-corner"], "audit": ["maze-corner"], "agency": ["maze-corner"],
    "compare": ["maze-corner", "random"],
    "play": ["maze", "corner-small"], "replay": ["maze", "corner-small", "--actions", __file__],
}  # fmt: skip
CHECKED = {*kinds(), *settings.NAMES.values()}  # with all other settings of a training
NUMBERS = [
    (verb, name)
    for verb in verbs.VERBS
    for name, kind, _ in options(verb)
    if kind in (int, int | None) and not (verb in ("train", "sweep") and name in CHECKED)
]


@pytest.mark.parametrize("value", [-1, HUGE])
@pytest.mark.parametrize("verb, name", NUMBERS)
def test_every_number_of_every_verb_has_bounds(verb, name, value, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = [verb, *WORDS[verb], f"--{name}", str(value)]
    monkeypatch.setattr(sys, "argv", ["astray", *words])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == cli.MISTAKE
    told = f"{name.removeprefix('num_')} must be (an integer )?from"
    assert re.search(told, capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_numbers_of_every_kind_are_bounded():
    for wrong in (0, 11, 2.0, "5", True, None):
        with pytest.raises(ValueError, match=r"k must be an integer from 1 to 10; got"):
            bounded("k", wrong, 1, 10)
    with pytest.raises(ValueError, match="got a number of 66439 bits"):
        bounded("k", 10**20_000, 1, 10)
    bounded("k", np.int64(5), 1, 10)


READERS = {
    "levels": lambda path: read_levels(path, games.find("maze"), SMALL),
    "states": lambda path: load_states(path, "maze"),
    "settings": lambda path: checkpoint.read_config(linked(path, "config.json")),
    "metrics": lambda path: checkpoint.metrics(linked(path, "metrics.jsonl")),
    "agent": lambda path: open_run(run_with(path)),
    "any": read,
}


def linked(path: Path, name: str) -> Path:
    """A folder in which the file is called so."""
    folder = path.parent / "run"
    folder.mkdir()
    (folder / name).symlink_to(path)
    return folder


def run_with(path: Path) -> Path:
    """A run whose agent is `path`."""
    folder = path.parent / "run"
    (folder / "checkpoints" / "32").mkdir(parents=True)
    (folder / "config.json").write_bytes((folders.find("maze-corner") / "config.json").read_bytes())
    (folder / "checkpoints" / "32" / checkpoint.AGENT).symlink_to(path)
    return folder


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
@pytest.mark.parametrize("what", READERS)
@pytest.mark.parametrize("kind", ["a pipe that nobody writes", "a device without end"])
def test_what_is_no_file_is_read_by_nobody(what, kind, tmp_path):
    path = tmp_path / "one"
    if kind == "a pipe that nobody writes":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises((OSError, ValueError), match="must be a file; it is a folder, a pipe or"):
        READERS[what](path)


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    with open(tmp_path / "level.txt", "wb") as file:
        file.truncate(2**40)  # takes no room
    for reader in (READERS["levels"], READERS["any"]):
        with pytest.raises(ValueError, match=r"must be of at most .* bytes; it has 1,099,511,"):
            reader(tmp_path / "level.txt")


def astray(*words, **options):
    """The command, in a process of its own."""
    words = [sys.executable, "-m", "astray", *words]
    return subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, **options)


def test_actions_without_end_are_refused():
    if not os.path.exists("/dev/zero"):
        pytest.skip("there is no such device")
    with open("/dev/zero") as zeros:
        done = astray(
            "replay", "maze", "corner-small", "--actions", "-", "--level", "0", stdin=zeros
        )
    assert done.returncode == cli.MISTAKE and "standard input must be at most" in done.stderr


def test_many_listed_levels_are_numbers_and_no_name_of_a_file(monkeypatch, capsys, tmp_path):
    listed = ",".join(str(10**6 + k) for k in range(100))
    words = ["evaluate", "maze-corner", "--levels", listed, "--json"]
    monkeypatch.setattr(sys, "argv", ["astray", *words])
    cli.main()
    assert '"levels": 100' in capsys.readouterr().out


@pytest.mark.parametrize("words", [
    ("evaluate", "maze-corner"), ("record", "maze-corner"),
    ("agency", "maze-corner"),
])  # fmt: skip
def test_where_results_go_is_tried_before_anything_is_played(words, monkeypatch, capsys, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(GameVectorEnv, "reset", lambda *_, **__: pytest.fail("it was played"))
    out = tmp_path / "file" / "told.mp4"
    monkeypatch.setattr(sys, "argv", ["astray", *words, "--out", str(out)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == cli.MISTAKE and str(tmp_path / "file") in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "in the way"


def test_trying_where_results_go_leaves_what_is_there(tmp_path):
    (tmp_path / "told").write_text("old")
    check_writable(tmp_path / "told")
    check_writable(tmp_path / "new" / "told")
    assert (tmp_path / "told").read_text() == "old"
    assert [p.name for p in tmp_path.rglob("*")] == ["told"]
    with pytest.raises(IsADirectoryError, match="must be a file to write; it is a folder"):
        check_writable(tmp_path)
