"""The command line: one plain function per verb, and one place where what goes wrong is told."""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import sys
import threading
from difflib import get_close_matches

from astray import imports
from astray.words import printable

MISTAKE = 2  # exit code, after the mistake was explained
INTERRUPTED = 130  # as shells say it: 128 and the number of the signal, SIGINT
LONGEST = 1200  # characters of a mistake; the longest list of what there is has 800
UNREAD = 141  # likewise SIGPIPE: nobody reads what is written, as in `astray list | head -1`
TERMINATED = 143  # likewise SIGTERM


class Terminated(KeyboardInterrupt):
    """The process was asked to end, as by a cluster: what is half written is cleared away."""


def main() -> None:
    """Entry point of the `astray` command; a mistake is told in a sentence, not by a traceback."""
    code = 0
    try:
        _open_streams()
        if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminate)
        threading.excepthook = _tell_of_thread
        _check_folder()
        # Imported here: libraries read the environment, and may not like what they find.
        try:
            from astray.cli.verbs import run
        except ModuleNotFoundError as error:
            raise imports.needed_by("the command astray", error) from None
        run()
        if sys.stdout:
            sys.stdout.flush()
    except BrokenPipeError:
        code = UNREAD
    except Terminated:
        _tell("terminated")
        code = TERMINATED
    except KeyboardInterrupt:
        _tell("interrupted")
        code = INTERRUPTED
    except MemoryError as error:
        _tell(str(error) or "there is not enough memory")
        code = MISTAKE
    except (ValueError, OSError, RuntimeError, ImportError, OverflowError) as error:
        _tell(str(error) or type(error).__name__)
        code = MISTAKE
    if code:
        _give_up_output()
        sys.exit(code)


def _terminate(*_: object) -> None:
    raise Terminated


def _open_streams() -> None:
    """Open nothing in place of standard streams that are closed, and write any text to the others.

    A file that is opened takes the lowest free number: with standard output closed, what libraries
    print there would be written into, say, a checkpoint.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    # What is closed is None to Python, which not all libraries reckon with.
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # paths may be of bytes that are no text
            stream.reconfigure(errors="backslashreplace")


def _check_folder() -> None:
    """See that there is a working folder, without which libraries fail in ways of their own."""
    try:
        os.getcwd()
    except FileNotFoundError:
        raise FileNotFoundError(
            "the working folder is not there any more; change to one that is"
        ) from None


def _tell(what: str) -> None:
    """Write the first line of `what` to standard error; libraries add pages to it."""
    line = printable(next(iter(what.strip().splitlines()), ""))
    if sys.stderr:
        with contextlib.suppress(OSError):
            print(f"astray: {shortened(line)}{guess(line)}", file=sys.stderr)


def guess(line: str) -> str:
    """Return the question whether another name was meant, which a mistake's list of names has."""
    found = re.match(r"unknown [^']*'([^']+)'.*; there are: (.*)", line)
    near = get_close_matches(found[1], re.split(r",? (?:and )?", found[2]), 1) if found else []
    return f"; did you mean {near[0]!r}?" if near else ""


def _tell_of_thread(what: threading.ExceptHookArgs) -> None:
    """Tell in a line what a library's thread could not write; all else is a mistake of a program.

    TensorBoard's writes its events.
    """
    if isinstance(what.exc_value, OSError):
        _tell(str(what.exc_value))
    else:
        threading.__excepthook__(what)


def shortened(line: str) -> str:
    """`line`, of which the middle may be left out where it is longer than a few lines."""
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


def _give_up_output() -> None:
    """Let go of what cannot be written, of which the interpreter would complain at its end."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            try:
                stream.flush()
            except OSError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
