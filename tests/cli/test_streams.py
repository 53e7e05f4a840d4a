"""The command where its streams, its folder or its environment are not as usual: one sentence."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from helpers.processes import environment
from helpers.thorough import thorough

LEVEL = ("level", "maze", "corner-small", "--levels")
# Without coverage, which only tests have, and which numba imports: it needs a working folder.
RUN = "import sys; sys.modules['coverage'] = None; from astray.cli import main; main()"
BROKEN = pytest.mark.skipif(
    sys.version_info[:3] == (3, 13, 0),
    reason="Python 3.13.0 imports no NumPy in a folder that is gone",
)
POSIX = pytest.mark.skipif(os.name == "nt", reason="needs a POSIX shell")


def begin(*words, shell='exec "$@"', **options):
    """Start the command in a shell, with more of the environment in `env`."""
    env = environment(**options.pop("env", {}))
    command = [sys.executable, "-c", RUN, *words]
    if os.name != "nt":
        command = ["sh", "-c", shell, "sh", *command]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, env=env, text=True, **pipes | options)


def ended(process):
    """Its exit code, and what it wrote to standard output and to standard error."""
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def test_a_variable_that_a_library_does_not_like_is_told_in_a_line():
    code, out, err = ended(begin("reproduce", "maze-corner", env={"MPLBACKEND": "nothing"}))
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert err.startswith("astray: ") and "'nothing' is not a valid value for backend" in err


def test_a_variable_that_numba_cannot_read_is_told_without_a_traceback():
    code, out, err = ended(begin(*LEVEL, "7", env={"NUMBA_OPT": "x"}))
    assert code == 0 and "corner-small level 7" in out
    assert "'NUMBA_OPT'" in err and "Traceback" not in err


@POSIX
@pytest.mark.parametrize("words", [(*LEVEL, "0:2000"), *thorough((("list",),))])
def test_who_is_read_no_further_stops_quietly(words):
    process = begin(*words, shell='"$@"; exit $?')
    process.stdout.close()
    process.stdout = open(os.devnull)  # noqa: SIM115
    code, _, err = ended(process)
    process.stdout.close()
    assert (code, err) == (141, "")


@POSIX
@pytest.mark.parametrize(
    "words, shell, code, said",
    [
        ((*LEVEL, "7"), 'exec "$@" >&- 2>&- <&-', 0, ""),
        *thorough(
            ((*LEVEL, "7"), 'exec "$@" >&-', 0, ""),
            (("level", "mase", "corner"), 'exec "$@" >&- 2>&-', 2, ""),
        ),
        (("replay", "maze", "corner", "--level", "1", "--actions", "-"), 'exec "$@" <&-', 2,
         "astray: standard input is closed; there is nothing to read\n"),
        pytest.param(
            (*LEVEL, "7"), 'mkdir gone; cd gone; rmdir "$PWD"; exec "$@"', 2,
            "astray: the working folder no longer exists; change to one that does\n", marks=BROKEN),
    ],
)  # fmt: skip
def test_a_stream_or_a_folder_that_is_gone_is_told_in_a_line(words, shell, code, said, tmp_path):
    assert ended(begin(*words, shell=shell, cwd=tmp_path)) == (code, "", said)


@POSIX
@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="needs a full device")
def test_output_that_has_no_room_is_told_in_a_line():
    code, _, err = ended(begin(*LEVEL, "7", shell='exec "$@" >/dev/full'))
    assert code == 2 and err == "astray: [Errno 28] No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="needs a full device")
@pytest.mark.thorough
@pytest.mark.parametrize("number, expected", [("7", 2), ("x", 2)])
def test_with_no_room_for_words_either_the_code_says_it(number, expected):
    code, _, _ = ended(begin(*LEVEL, number, shell='exec "$@" >/dev/full 2>/dev/full'))
    assert code == expected


@POSIX
def test_paths_that_are_no_text_are_printed(tmp_path):
    folder = os.fsencode(tmp_path) + b"/\xff"
    code, out, err = ended(begin("art", "list", env={"ASTRAY_ART": os.fsdecode(folder)}))
    assert (code, err) == (0, "") and "\\udcff" in out


@POSIX
@pytest.mark.thorough  # `test_a_signal_that_python_ignores_in_a_callback_ends_the_command`
def test_an_interrupted_command_says_so_in_a_line(tmp_path):
    words = ("train", "maze", "corner-small", "--out", str(tmp_path), "--num-levels", "100")
    small = ("--num-envs", "16", "--num-steps", "16", "--minibatches", "2", "--width", "16")
    process = begin(*words, *small, cwd=tmp_path)
    while not (tmp_path / "seed-0" / "metrics.jsonl").exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    code, _, err = ended(process)
    assert code == 130 and err.endswith("astray: interrupted\n") and "Traceback" not in err
