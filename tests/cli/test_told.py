"""What the command tells, and how: in a line or a few, without control characters."""

import json
import os
import subprocess
import sys
import threading

import numpy as np
import polars as pl
import pytest

from astray import cli
from astray.analysis.outcomes import OUTCOMES, rates
from astray.cli import LONGEST, shortened
from astray.cli.agents import show_amounts, show_rates
from astray.training.config import Config
from astray.validation import printable
from helpers.thorough import thorough


def test_a_measure_that_is_no_number_is_told_with_its_level_under_its_mean(capsys):
    played = {"policy": ["mouse"] * 3, "variant": ["end"] * 3, "level": [4, 5, 6]}
    table = pl.DataFrame(played | {"rate": [0.5, np.nan, 1], "walked": [1, 2, 3]})
    show_amounts(table, ["rate", "walked"])
    said = " ".join(capsys.readouterr().out.split())
    assert "rate is nan in level 5, so its mean is not finite" in said and "walked is" not in said


def test_agents_in_long_paths_have_rows_that_tell_them_apart(capsys):
    names = [f"runs/maze-red-line-yellow-gem-small/seed-{seed}" for seed in (10, 11)]
    told = {"policy": names, "variant": ["end"] * 2, "level": [4, 4], "outcome": OUTCOMES[:2]}
    show_rates(rates(pl.DataFrame(told)).with_columns(levels_played=pl.lit("distinguishing")))
    lines = capsys.readouterr().out.splitlines()
    shown = "".join(line.split("│")[1].strip() for line in lines if line.count("│") > 2)
    assert shown == "".join(names)


def test_control_characters_are_shown_and_not_obeyed():
    assert printable("a\x1b[2J\n\udcffé") == "a\\x1b[2J\\n\\udcffé"


TERMINATED = """
import os, signal, sys, time
from pathlib import Path
from astray import cli
from astray.cli import verbs
from astray.files import folder_aside
def run():
    with folder_aside(Path(sys.argv[1]) / "new" / "mouse") as aside:
        (aside / "half").touch()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(30)
verbs.run = run
cli.main()
"""


@pytest.mark.skipif(os.name == "nt", reason="there SIGTERM ends a process at once")
def test_who_is_asked_to_end_clears_away_what_is_half_written(tmp_path):
    command = [sys.executable, "-c", TERMINATED, tmp_path]
    told = subprocess.run(command, capture_output=True, text=True)
    assert (told.returncode, told.stderr) == (cli.TERMINATED, "astray: terminated\n")
    assert not list(tmp_path.iterdir())


IGNORED = """
import os, signal, sys, time, weakref
from astray import cli
from astray.cli import verbs
class Thing:
    pass
def run():
    signal.signal(signal.SIGINT, signal.default_int_handler)
    thing = Thing()
    seen = weakref.ref(thing, lambda _: os.kill(os.getpid(), getattr(signal, sys.argv[1])))
    del thing
    time.sleep(30)
    print("slept")
verbs.run = run
cli.main()
"""


@pytest.mark.skipif(os.name == "nt", reason="there SIGTERM ends a process at once")
@pytest.mark.parametrize(
    "name, code, said",
    [("SIGTERM", cli.TERMINATED, "terminated"), ("SIGINT", cli.INTERRUPTED, "interrupted")],
)
def test_a_signal_that_python_ignores_in_a_callback_ends_the_command(name, code, said):
    command = [sys.executable, "-c", IGNORED, name]
    told = subprocess.run(command, capture_output=True, text=True, timeout=25)  # it would wait 30
    assert (told.returncode, told.stdout, told.stderr) == (code, "", f"astray: {said}\n")


def test_a_mistake_is_told_in_a_few_lines():
    told = shortened("x" * 10**6)
    assert len(told) < LONGEST + 10 and " ... " in told
    assert shortened("y" * LONGEST) == "y" * LONGEST


@pytest.mark.skipif(os.name == "nt", reason="streams are closed otherwise")
@pytest.mark.parametrize("words, code", [("--help", 0), *thorough(("nope", 2))])
def test_help_that_nobody_can_read_is_no_mistake(words, code):
    command = f"{sys.executable} -m astray {words} >&-"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.returncode == code and "Traceback" not in done.stderr


def test_a_full_disk_is_told_in_a_line_by_threads_too(monkeypatch, capsys):
    monkeypatch.setattr(threading, "excepthook", cli._tell_of_thread)
    thread = threading.Thread(target=lambda: os.stat("/nowhere/at/all"))
    thread.start()
    thread.join()
    told = capsys.readouterr().err
    assert told.startswith("astray: [Errno 2]") and told.count("\n") == 1


@pytest.mark.parametrize("name, content", [("[red]x", None), ("broken", "{}")])
def test_the_list_has_the_others_where_one_agent_is_none(
    tmp_path, name, content, astray, monkeypatch
):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "config.json").write_text(content or json.dumps(Config().to_json()))
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    listed = astray("list")
    assert folder.name in listed and "maze-corner: maze" in listed


@pytest.mark.parametrize(
    "name, value",
    [
        ("NUM_THREADS", "0"),
        *thorough(("COLOR_SCHEME", "pink"), ("NUM_THREADS", "-1"), ("NUM_THREADS", "x")),
    ],
)
def test_a_variable_that_numba_does_not_take_is_left_out(name, value):
    code = f"import os, astray; print(os.environ.get('NUMBA_{name}'))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=os.environ | {f"NUMBA_{name}": value},
    )
    assert done.stdout == "None\n" and f"NUMBA_{name} is '{value}', which numba" in done.stderr
