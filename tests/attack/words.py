"""The words of each verb with which nothing is wrong but what an attempt changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from attack.core import Place
from attack.material import TINY, sweep_words
from helpers.flat import kinds, options

PLAY = ("--levels", "0:2")


def words_of(verb: str, place: Place) -> list[Any]:
    """A command that works, and soon; what it needs is copied to the working folder."""
    for name in ("run", "maze.txt", "actions.txt", "experiment.py", "agent.pth"):
        if not (place.work / name).exists():
            place.copy(name)
    maze, agent = ["maze", "corner-small"], ["maze-corner"]
    return {
        "list": [], "play": [*maze, "--level", "0"],
        "lab": ["maze-corner", "--no-browser", "--export", "page", "--num-levels", "1"],
        "train": [*TINY, "--out", "trained"],
        "distil": ["run", "--observation", "symbolic", "--steps", "16384", "--out", "students"],
        "evaluate": ["run", *PLAY], "reproduce": ["experiment.py", "--workers", "1"],
        "sweep": [*sweep_words(Path("swept"))[1:]],
        "keep": ["run", "--as", "mine", "--out", "to"],
        "push": ["run", "ada/mouse"], "pull": ["ada/mouse"],
        "record": [*agent, "--level", "0", "--pixels", "32"],
        "export": ["run", *PLAY], "level": maze,
        "replay": [*maze, "--level", "0", "--actions", "actions.txt"],
        "overlap": [*maze, "anywhere-small", "--training-levels", "0:9", "--test-levels", "9:12"],
        "agency": ["run", *PLAY], "explain": ["run", "--level", "0", "--num-levels", "2"],
        "art": ["list"], "cache": [], "import": ["agent.pth", "--as", "mine", "--game", "maze",
                                                 "--variant", "anywhere", "--art", "own"],
        "agents": ["list"], "bench": ["start"],
    }[verb]  # fmt: skip


def writes(verb: str) -> str:
    """The option of a verb that says where to write."""
    return "export" if verb == "lab" else "out"


def options_of(verb: str) -> list[tuple[str, str, bool]]:
    """The options of a verb: name on the command line, its type in words, whether positional."""
    apart = kinds() if verb in ("train", "sweep") else ()  # they are tried by themselves
    found = []
    for name, kind, positional in options(verb):
        if name in apart and not positional:
            continue
        told = kind.__name__ if isinstance(kind, type) else str(kind)
        told = {"set": "Knobs", "axes": "Sets"}.get(name, told)
        if verb == "sweep" and name == "set":
            told = "Sets"
        found.append((name.replace("_", "-"), told, positional))
    return found


def with_option(words: list[Any], option: str, value: Any) -> list[Any]:
    """The words with an option changed; it stands once."""
    flag, kept = f"--{option}", list(words)
    if flag in kept:
        at = kept.index(flag)
        after = next(
            (k for k in range(at + 1, len(kept)) if str(kept[k]).startswith("--")), len(kept)
        )
        del kept[at:after]
    return [*kept, f"{flag}={value}"]
