"""The table of verbs, and the parsing of the command line."""

import argparse
import contextlib
import functools
import inspect
import io
import logging
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import version
from typing import Any

import tyro
from tyro.conf import DisallowNone, OmitArgPrefixes, PositionalMetavarFromFieldName

from astray import games
from astray.training.settings import SHORT

# Where each is, beside this file: imported when it is asked for, as torch alone takes two seconds.
VERBS = {
    "list": "experiments:list_", "play": "levels:play", "lab": "lab:lab", "train": "agents:train",
    "distil": "distil:distil", "evaluate": "agents:evaluate", "audit": "pages:audit",
    "compare": "pages:compare", "reproduce": "experiments:reproduce", "sweep": "sweep:sweep",
    "keep": "agents:keep", "push": "hub:push", "pull": "hub:pull", "record": "agents:record",
    "export": "dataset:export", "level": "levels:level", "replay": "levels:replay",
    "overlap": "levels:overlap", "agency": "agents:agency", "explain": "pages:explain",
    "art": "art:art", "cache": "cache:cache", "import": "published:import_",
    "agents": "published:agents", "bench": "experiments:bench",
}  # fmt: skip
# Earlier names of options, which scripts may have.
EARLIER = {"--folder": "--out", "--numbers": "--levels", "--others": "--num-levels"}
# Settings have no prefixes, positional arguments have names, and nobody types None.
MARKERS = (OmitArgPrefixes, PositionalMetavarFromFieldName, DisallowNone)


def run() -> None:
    """Run the verb on the command line; raise ValueError if there is none of that name."""
    given = [re.sub("^--[a-z]+", lambda found: EARLIER.get(found[0], found[0]), word)
             for word in sys.argv[1:]]  # fmt: skip
    names = re.findall(r"(?m)^(?:--set=)?([a-zA-Z]\w*)=", "\n".join(given))  # that --set sets
    words = [*given, *{f"--{SHORT.get(name, name)}" for name in names}]
    options = [word.partition("=")[0].replace("_", "-") for word in words if word[:2] == "--"]
    warnings.showwarning = functools.partial(_warn, warnings.showwarning)
    if given == ["--version"]:
        print(version("astray"))
    elif given and (found := re.search(r"(?m)^(?:(--[\w-]+)(?:=|\n)|)$", "\n".join(given))):
        raise ValueError(f"{found[1] or 'each word'} needs a value; got ''")  # a path: this folder
    elif twice := {one for one in options if options.count(one) > 1} - {"--set"}:
        raise ValueError(f"{min(twice)} is given more than once")  # the last would win
    elif given and given[0] in VERBS:
        function = find(given[0])
        verb = _parsed(function, given)
        has, study = "longest" in inspect.signature(function).parameters, given[0] == "reproduce"
        with _told("--longest" if has else "`longest`" * study):  # a study's own says it
            verb()
    elif given and not given[0].startswith("-"):
        raise ValueError(f"unknown verb {given[0]!r}; there are: {', '.join(VERBS)}")
    else:  # help is asked for
        tyro.extras.subcommand_cli_from_dict(
            {name: find(name) for name in VERBS},
            prog="astray",
            description="Find out which goal a trained agent really pursues.",
            config=MARKERS,
        )


def _parsed(verb: Callable[..., Any], given: list[str]) -> Callable[[], Any]:
    """Return the call of a verb with its options; raise ValueError for an unknown choice."""

    @functools.wraps(verb)
    def call(*values: Any, **options: Any) -> Callable[[], Any]:
        return functools.partial(verb, *values, **options)

    call.__doc__ = getattr(verb, "func", verb).__doc__
    refused = io.StringIO()
    try:
        with contextlib.redirect_stderr(refused):
            return tyro.cli(
                call, prog=f"astray {given[0]}", args=given[1:], config=MARKERS,
                description=_in_lines(call.__doc__ or ""),
            )  # fmt: skip
    except SystemExit:
        if line := _mistake(call, given, _in_a_line(refused.getvalue())):
            raise ValueError(line) from None
        sys.stderr.write(refused.getvalue())
        raise


def _in_lines(docstring: str) -> str:
    """Return the paragraphs before the sections, in lines that fit: tyro joins unindented lines."""
    about = re.split(r"\n\n\w+:\n", inspect.cleandoc(docstring))[0]
    width = shutil.get_terminal_size().columns
    wrap = functools.partial(textwrap.fill, width=width, subsequent_indent="  ")
    return "\n\n".join(map(wrap, about.split("\n\n")))


def _in_a_line(text: str) -> str:
    """Return what tyro writes in a line, without boxes and colours."""
    bare = re.sub(r"\x1b\[[\d;]*m", "", text)
    return re.sub(r"\s+", " ", re.sub(r"(?m)[│─]|-{3,}|^\||\|$", " ", bare))


def _mistake(call: Callable[..., Any], given: list[str], refused: str) -> str:
    """Return the mistake in a command line that was refused, or "" if there is no shorter way."""
    choice = r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of \((.*)\)\."
    if found := re.search(choice, refused):
        name, option, there = found.groups()
        there = re.sub("'None', |, 'None'|'", "", there)  # nobody types None
        return f"unknown choice {name!r} for {option}; there are: {there}"
    verb, shown = given[0], io.StringIO()
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(shown):
        tyro.cli(call, prog=f"astray {verb}", args=["--help"], config=MARKERS)
    usage = _in_a_line(shown.getvalue().partition("\n\n")[0])
    options = list(dict.fromkeys(re.findall(r" --([a-z][\w-]*)", _in_a_line(shown.getvalue()))))
    for word in (word[2:].partition("=")[0] for word in given[1:] if word.startswith("--")):
        if word.replace("_", "-") not in options:
            short = SHORT.get(word, "").replace("_", "-")
            near = [short] if short in options else get_close_matches(word, options, 1)
            there = f"did you mean '--{near[0]}'?" if near else f"it has --{', --'.join(options)}"
            return f"unknown option '--{word}' of {verb}; {there}"
    if found := re.search(r"Unrecognized options: (For full helptext|[^ ,]+)", refused):
        return f"unknown word {found[1].removeprefix('For full helptext')!r}; {usage}"
    if found := re.search(r"Error parsing (\S+): no type matching (\S+) .*?\[(.*?)\]", refused):
        return f"{found[1]} must be {found[2]}; got {found[3]}"
    if found := re.search(r"Error parsing (\S+): (.*?) (?:Argument|For full) helptext", refused):
        is_whole = found[1].startswith("settings.")  # a sentence that names the option
        return found[2] if is_whole else f"{found[1]} cannot be read: {found[2]}"
    if found := re.search(r"Missing value for argument '(--.*?)'", refused):
        return f"{found[1]} needs a value"
    there = re.sub(r"(?s).*Example: (.*?)(\n.*)?", r"as in \1", call.__doc__ or "")
    needed = re.findall(r"(?: \S+:|\(required\)) (--\S+|[A-Z]+) ", refused)
    if " GAME " in usage and "".join(needed[:1]).isupper() and given[1:] and given[1][:1] != "-":
        there = f"there are: {', '.join(games.find(given[1]).variants)}"
    return f"{verb} needs {', '.join(needed)}; {there}" if needed else ""


@contextlib.contextmanager
def _told(longest: str) -> Iterator[None]:
    """Write on standard error how many levels have been played, every few seconds.

    In errors, too, `longest` is called so, or left out for ""; a count of levels is --num-levels.
    """

    def named(text: str) -> str:
        text = re.sub("^levels(?= must be (an integer )?from)", "--num-levels", text)
        if longest:
            return text.replace("`longest`", longest)
        return re.sub("(:|, or)( say)? `longest`.*", "", text)

    log, handler = logging.getLogger("astray.acting"), logging.StreamHandler()
    handler.format = lambda record: named(record.getMessage())
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    except ValueError as error:
        raise ValueError(named(str(error))) from error
    finally:
        log.removeHandler(handler)


def _warn(show: Callable[..., None], message: Any, category: type, *where: Any) -> None:
    """Print astray's warnings as a sentence, and those of libraries unchanged through `show`."""
    if category.__module__.startswith("astray."):
        print(f"astray: {message}", file=sys.stderr)
    else:
        show(message, category, *where)


def find(name: str) -> Callable[..., Any]:
    """Return the function of a verb; `train` and `sweep` get the preset's defaults."""
    module, _, function = VERBS[name].partition(":")
    verb = getattr(import_module(f"astray.cli.{module}"), function)
    # An option's sentence is one line, as tyro would keep the docstring's breaks.
    verb.__doc__ = re.sub(r"\n {8,}(?=\S)", " ", inspect.getdoc(verb) or "")
    if name not in ("train", "sweep"):
        return verb
    from astray.cli.settings import grouped
    from astray.training.config import PRESETS

    # The preset gives the other settings their defaults, so it is read before them.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    first.add_argument("--preset", nargs="?")
    preset = first.parse_known_args()[0].preset
    # tyro refuses an unknown one
    return functools.partial(verb, settings=grouped(PRESETS.get(preset, PRESETS["small"])))
