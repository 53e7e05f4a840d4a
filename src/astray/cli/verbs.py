"""The table of verbs, and the parsing of the command line."""

from __future__ import annotations

import argparse
import contextlib
import functools
import inspect
import io
import logging
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.metadata import version
from typing import Any

import tyro
from tyro.conf import DisallowNone, OmitArgPrefixes, PositionalMetavarFromFieldName

# Where each is, beside this file: imported when it is asked for, as torch alone takes two seconds.
VERBS = {
    "list": "experiments:list_",
    "play": "levels:play",
    "lab": "lab:lab",
    "train": "agents:train",
    "distil": "distil:distil",
    "evaluate": "agents:evaluate",
    "audit": "audit:audit",
    "compare": "compare:compare",
    "reproduce": "experiments:reproduce",
    "sweep": "sweep:sweep",
    "keep": "agents:keep",
    "push": "hub:push",
    "pull": "hub:pull",
    "record": "agents:record",
    "export": "dataset:export",
    "level": "levels:level",
    "replay": "levels:replay",
    "overlap": "levels:overlap",
    "agency": "agents:agency",
    "explain": "insight:explain",
    "art": "art:art",
    "cache": "cache:cache",
    "import": "published:import_",
    "agents": "published:agents",
    "bench": "experiments:bench",
}


# Settings have no prefixes, positional arguments have names, and nobody types None.
MARKERS = (OmitArgPrefixes, PositionalMetavarFromFieldName, DisallowNone)
OF_AGENTS = ("evaluate", "record", "agency", "export", "lab")
SWITCHES = tuple(f"--{name}" for name in ("fused-cpu", "bfloat16", "channels-last", "compile",
                                          "cudagraphs"))  # fmt: skip
RENAMED = {  # options of older versions, in the verbs that had them
    "--share": ("--fraction", ("train", "sweep")),
    "--levels": ("--num-levels", ("train", "sweep", "lab", "audit")),
    "--test-levels": ("--num-test-levels", ("sweep",)),
    "--actions": ("--mode", ("import",)),
}


def run() -> None:
    """Run the verb on the command line; raise ValueError if there is none of that name."""
    given = in_todays_words(sys.argv[1:])
    warnings.showwarning = functools.partial(_warn, warnings.showwarning)
    if given == ["--version"]:
        print(version("astray"))
    elif given and given[0] in VERBS:
        verb = _parsed(find(given[0]), given)
        with _progress():
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
            return tyro.cli(call, prog=f"astray {given[0]}", args=given[1:], config=MARKERS)
    except SystemExit:
        line = re.sub(r"[│\s]+", " ", re.sub(r"\x1b\[[\d;]*m", "", refused.getvalue()))
        choice = r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of \((.*)\)\."
        if found := re.search(choice, line):
            name, option, there = found.groups()
            raise ValueError(
                f"unknown choice {name!r} for {option}; there are: {there.replace(chr(39), '')}"
            ) from None
        sys.stderr.write(refused.getvalue())
        raise


@contextlib.contextmanager
def _progress() -> Iterator[None]:
    """Write on standard error how many levels have been played, every few seconds."""
    log, handler = logging.getLogger("astray.acting"), logging.StreamHandler()
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)


def _warn(show: Callable[..., None], message: Any, category: type, *where: Any) -> None:
    """Print astray's warnings as a sentence, and those of libraries unchanged through `show`."""
    if category.__module__.startswith("astray."):
        print(f"astray: {message}", file=sys.stderr)
    else:
        show(message, category, *where)


def in_todays_words(given: list[str]) -> list[str]:
    """Translate words of older versions into today's, with a note.

    `--agent NAME` is now NAME, options have new names, switches followed by True or False are now
    flags, and nothing is set to None.
    """
    first, *words = [part for word in given for part in _parted(word)] or [""]
    names, rest, notes = [], [], []
    while words:
        word, after = words.pop(0), words[0] if words else ""
        if word == "--agent" and after and first in OF_AGENTS:
            names.append(words.pop(0))
            notes.append("--agent NAME is now NAME alone")
        elif first in RENAMED.get(word.partition("=")[0], ("", ()))[1]:
            name, *value = word.split("=", 1)
            rest.append("=".join([RENAMED[name][0], *value]))
            notes.append(f"{name} is now {RENAMED[name][0]}")
        elif word.startswith("--") and after == "None":
            words.pop(0)
            notes.append(f"{word} None is now said by leaving it out")
        elif word in SWITCHES and after in ("True", "False"):
            rest.append(word if words.pop(0) == "True" else f"--no-{word[2:]}")
            notes.append(f"{word} {after} is now {rest[-1]}")
        else:
            rest.append(word)
    for note in dict.fromkeys(notes):
        print(f"astray: {note}; a later version will not read it", file=sys.stderr)
    return [first, *names, *rest] if notes else given


def _parted(word: str) -> list[str]:
    """Split an older option from its value."""
    name, is_joined, value = word.partition("=")
    old = name == "--agent" or (name in SWITCHES and value in ("True", "False", "None"))
    return [name, value] if is_joined and old else [word]


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
