"""The command line: one plain function per verb, with readable errors."""

import _thread
import atexit
import contextlib
import io
import os
import re
import signal
import sys
import threading
from difflib import get_close_matches

from astray import imports
from astray.validation import printable

MISTAKE = 2  # exit code, after the mistake was explained
INTERRUPTED = 130  # as shells say it: 128 and the number of the signal, SIGINT
AGAIN = 0.01  # seconds until an interrupt that Python ignored is repeated
LONGEST = 1200  # characters of a mistake; the longest list of what there is has 800
UNREAD = 141  # likewise SIGPIPE: nobody reads what is written, as in `astray list | head -1`
TERMINATED = 143  # likewise SIGTERM
NAMES: dict[type, str] = {MemoryError: "there is not enough memory"}  # of errors without words


def main() -> None:
    """Run the `astray` command; report a user's mistake in a sentence, without a traceback."""
    code = 0
    try:
        _open_streams()
        if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminate)
        threading.excepthook = _tell_of_thread
        if sys.unraisablehook is sys.__unraisablehook__:
            sys.unraisablehook = _interrupt_again
        try:
            os.getcwd()
        except FileNotFoundError:  # which libraries handle badly
            gone = "the working folder no longer exists; change to one that does"
            raise FileNotFoundError(gone) from None
        # Imported here: libraries read the environment, and may not like what they find.
        try:
            from astray.cli.verbs import run

            run()
        except ModuleNotFoundError as error:
            raise imports.needed_by("the command astray", error) from None
        sys.stdout.flush()
    except BrokenPipeError:
        code = UNREAD
    except imports.Terminated:
        _tell("terminated")
        code = TERMINATED
    except KeyboardInterrupt:
        _tell("interrupted")
        code = INTERRUPTED
    except (ValueError, OSError, RuntimeError, ImportError, OverflowError, MemoryError) as error:
        _tell(str(error) or NAMES.get(type(error), type(error).__name__))
        code = MISTAKE
    atexit.register(imports.LENT.__enter__)  # users' code may print at Python's end, too
    if code:
        _give_up_output()
        sys.exit(code)


def _terminate(*_: object) -> None:
    raise imports.Terminated


def _interrupt_again(what: "sys.UnraisableHookArgs") -> None:
    """Repeat an interrupt or a SIGTERM that Python ignored, as in a weak reference's callback."""
    if not issubclass(what.exc_type, KeyboardInterrupt):
        return sys.__unraisablehook__(what)
    number = signal.SIGTERM if what.exc_type is imports.Terminated else signal.SIGINT
    # Windows has no signal that would also end a wait.
    repeat = getattr(signal, "pthread_kill", lambda _, number: _thread.interrupt_main(number))
    again = threading.Timer(AGAIN, repeat, [threading.main_thread().ident, number])
    again.daemon = True
    with contextlib.suppress(RuntimeError):  # Python ends, and starts no threads
        again.start()


def _open_streams() -> None:
    """Replace closed standard streams, and make the others accept any text.

    A newly opened file takes the lowest free number: without standard output, prints of libraries
    would go into, say, a checkpoint.
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


def _tell(what: str) -> None:
    """Write the first line of `what` to standard error; libraries add pages to it."""
    line = printable(next(iter(what.strip().splitlines()), ""))
    with contextlib.suppress(OSError):
        print(f"astray: {shortened(line)}{guess(line)}", file=sys.stderr)


def guess(line: str) -> str:
    """Return a "did you mean" question with the nearest name in an error's list, or ""."""
    found = re.match(r"unknown [^']*'([^']+)'.*; there are: (.*)", line)
    near = get_close_matches(found[1], re.split(r",? (?:and )?", found[2]), 1) if found else []
    return f"; did you mean {near[0]!r}?" if near else ""


def _tell_of_thread(what: threading.ExceptHookArgs) -> None:
    """Report an OSError of a library's thread, as TensorBoard's, in a line; others as usual."""
    if isinstance(what.exc_value, OSError):
        _tell(str(what.exc_value))
    else:
        threading.__excepthook__(what)


def shortened(line: str) -> str:
    """Cut out the middle of a `line` that is longer than a few lines."""
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


def _give_up_output() -> None:
    """Discard unwritable output, about which the interpreter would complain on exit."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            try:
                stream.flush()
            except OSError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
