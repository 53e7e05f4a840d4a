"""The batch loop, compiled for each game."""

import functools
import re
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba.core.errors import NumbaError, loc_info  # pyrefly: ignore

from astray.envs import loops
from astray.envs.pool import alone
from astray.game import OWN, Game, Looks
from astray.imports import announced
from astray.kernel.jit import kernel, one_at_a_time, renewed, shared, specialise
from astray.record import fresh
from astray.validation import brief, shown

SILENT = 2.0  # seconds of compiling before it is announced
COMPILING = "compiling {}: some 10 to 20 seconds of a free core, once for each version of its code"
# What `loops.run` is given in place of actions and results by commands that have none.
NUMBERS, FLAGS = np.empty(0, np.int64), np.empty(0, bool)
NO_RESULTS = np.empty(0), FLAGS, FLAGS


def compiled_loop(game: Game, art: str = OWN) -> Callable:
    """Return `loops.run` compiled for a game and an art; raise ValueError if that fails."""
    return _compiled(game, name := game.drawn(art).name, loop_of(game, name))


def loop_of(game: Game, art: str = OWN) -> Callable:
    """Return `loops.run` of a game, not compiled yet, named by its code and the values it keeps."""
    functions = functions_of(game, art)
    return _loop_of(game, art, renewed(functions.values()))


def functions_of(game: Game, art: str) -> dict[str, Callable]:
    """Return the functions that a game's loop calls, by their names in it."""
    looks = game.drawn(art)
    functions = {
        "generate": game.levels.generate,
        "step": game.rules.step,
        "background": looks.background,
        "foreground": looks.foreground,
    }
    if game.symbols:
        for name in ("background_planes", "foreground_planes"):
            functions[name] = getattr(game.symbols, name)
    return functions


@functools.cache
def _loop_of(game: Game, art: str, _values: str) -> Callable:
    functions = functions_of(game, art)
    label = game.name if art == OWN else f"{game.name}_{art}"
    functions["background_of"] = specialise(loops.background_of_any, label, shared, **functions)
    functions["begin_one"] = specialise(loops.begin, label, shared, **functions)
    functions["observe_one"] = specialise(loops.observe, label, kernel, **functions)
    names: dict[str, Any] = {"ACTIONS": len(game.actions), "FRESH": fresh(game.rules)}
    return specialise(loops.run, label, **names, **functions)


@functools.cache
def _compiled(game: Game, art: str, run: Callable) -> Callable:
    looks = game.drawn(art)
    try:
        with one_at_a_time(run.__name__), announced(SILENT, COMPILING.format(game.name)):
            _compile(game, looks, run)
    except (MemoryError, OSError):
        raise
    except Exception as error:
        told = _brief(error) if isinstance(error, NumbaError) else shown(error, 300)
        *_, last = traceback.extract_tb(error.__traceback__)
        if not isinstance(error, NumbaError) and "numba" in Path(last.filename).parts:
            told += f" (near {loc_info.get('loc')})"  # of what numba fails to compile
        raise ValueError(f"the code of the game {game.name!r} fails: {told}") from error
    return run


def _brief(error: NumbaError) -> str:
    """Return the first place in numba's long text, and the two lines on what is wrong there."""
    text = re.sub(r"\x1b\[[\d;]*m", "", str(error))
    place = re.search(r'(?m)^File "[^"]*", line \d+', text)
    lines = [one.strip() for one in text.splitlines() if not one.startswith(("Failed in", "File"))]
    told = " ".join([line for line in lines if line][:2])
    called = re.search(r"callee type: .*<function (\w+) at", text)
    if called and place and called.start() < place.start():  # the place is of the call
        return f"{brief(told)} (in {called[1]})"
    return f"{brief(told)} ({place[0]})" if place else brief(told)


def _compile(game: Game, looks: Looks, run: Callable) -> None:
    """Run without environments, which compiles the loop for its argument types."""
    variant = next(iter(game.variants.values()))
    params, states = variant.records(), np.zeros(0, game.state)
    pictures = np.empty((0, 1, 1, 1), np.uint8)
    run(
        states, (looks.pictures(variant, 1), False, pictures), (params, NUMBERS, 0, 1, states),
        (0, NUMBERS, NUMBERS), (pictures, states, pictures), NO_RESULTS, *alone(),
    )  # fmt: skip
