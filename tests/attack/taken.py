"""Class 5: what is not what it should be, and must not be taken for it."""

from __future__ import annotations

import functools
import json
import typing
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from attack.core import Attempt, Place, Wrong
from helpers.flat import kinds

# Of each type of a setting: values of others, which Python would take for it or convert.
OTHERS: dict[type, tuple[Any, ...]] = {
    int: (True, "3", 2.0),
    float: (True, "0.5", float("nan")),
    bool: (1, "True"),
    str: (7, b"maze"),
}


def attempts() -> Iterator[Attempt]:
    for name, act in {**_settings(), **_knobs(), **_environments(), **_levels()}.items():
        yield Attempt(5, name, act)
    for name, (act, wants) in {**_commands(), **_others()}.items():
        yield Attempt(5, name, act, wants)


def _kind_of(hint: Any) -> type:
    parts = [part for part in typing.get_args(hint) if part is not type(None)]
    if typing.get_origin(hint) is typing.Literal:
        return str
    found = parts[0] if parts and typing.get_origin(hint) is not dict else hint
    return found if found in OTHERS else dict


def _settings() -> dict[str, Callable[[Place], Any]]:
    """Every setting of a training, of another type than it has."""
    from astray.training.config import PRESETS

    def act(name: str, value: Any, _: Place) -> Any:
        return PRESETS["small"].changed(**{name: value})

    found = {}
    for setting, hint in kinds().items():
        for value in OTHERS.get(_kind_of(hint), ([], "maze")):
            name = f"settings: {setting} is {value!r}"
            found[name] = functools.partial(act, setting, value)
    return found


def _knobs() -> dict[str, Callable[[Place], Any]]:
    """Every knob of each game's variants, of another type, set in code and by its name."""
    from astray import games
    from astray.variant import knobs

    def act(variant: Any, name: str, value: Any, _: Place) -> Any:
        return variant.with_knobs({name: value})

    found = {}
    for game in games.OWN:
        variant = next(iter(games.find(game).variants.values()))
        for name, kind in knobs(type(variant)).items():
            for value in OTHERS[_kind_of(kind)][:2]:
                if isinstance(value, str) and kind is not str and not typing.get_args(kind):
                    continue  # text is read as the knob's type
                title = f"knobs: {game} {name} is {value!r}"
                found[title] = functools.partial(act, variant, name, value)
        found[f"knobs: {game} has a word more"] = functools.partial(act, variant, "worlds", 5)
    return found


def _env(**options: Any) -> Any:
    from astray.envs.vector import GameVectorEnv

    given: dict[str, Any] = {"game": "maze", "variant": "corner-small", "num_envs": 2}
    return GameVectorEnv(**given | {"observation": "symbolic"} | options)


def _environments() -> dict[str, Callable[[Place], Any]]:
    def made(options: dict[str, Any], _: Place) -> Any:
        return _env(**options)

    def reset(options: dict[str, Any], _: Place) -> Any:
        env = _env()
        env.reset(seed=0)
        return env.reset(options=options)

    def seeded(seed: Any, _: Place) -> Any:
        return _env().reset(seed=seed)

    wrong = {
        "num_envs": (True, 2.0, "2", 0, None, [2]), "observation": ("Image", "symbols", None, 0),
        "art": ("", "Own", None, 1), "threads": (True, 0, 1.0, "1"),
        "autoreset_mode": ("nextstep", "", 0, []), "render_mode": ("human", "", 1),
        "levels": ([True], [0.5], ["1"], [[1]], [-1], [2**31], [], "12", range(0), range(-1, 5),
                   None, {1, 2}, 5, range(0, 10, -1), [np.nan]),
        "game": ("Maze", b"maze", 1, None), "variant": ("corner_small", 3, None, {}),
    }  # fmt: skip
    found: dict[str, Callable[[Place], Any]] = {
        f"environment: {name} is {value!r}": functools.partial(made, {name: value})
        for name, values in wrong.items()
        for value in values
    }
    for options in (
        {"Level": 3},
        {"levels": 3},
        {"level": True},
        {"level": 1.0},
        {"level": "1"},
        {"level": [1, 2, 3]},
        {"level": -1},
        {"reset_mask": [1, 0]},
        {"reset_mask": True},
        {"reset_mask": [True]},
        {"state": 3},
        {"state": None, "seed": 1},
        {1: 2},
        {"level": [True, False]},
        {"level": [None, 1]},
        {"level": np.array([1.0, 2.0])},
    ):
        found[f"reset: {options!r}"] = functools.partial(reset, options)
    for seed in (True, 1.5, "1", -1, 2**64, float("nan"), [1]):
        found[f"reset: seed {seed!r}"] = functools.partial(seeded, seed)
    return found


def _levels() -> dict[str, Callable[[Place], Any]]:
    """Levels as JSON in which something is told that is not so."""
    changes: dict[str, Callable[[dict[str, Any]], Any]] = {
        "a field more": lambda d: d | {"colour": 1},
        "another agent's centre in words": lambda d: d | {"agent": ["1", "2"]},
        "an agent of truths": lambda d: d | {"agent": [True, True]},
        "an agent at NaN": lambda d: d | {"agent": [float("nan"), 1]},
        "codes that are reals": lambda d: d | {"grid": [[float(c) for c in r] for r in d["grid"]]},
        "codes that are truths": lambda d: d | {"grid": [[bool(c) for c in r] for r in d["grid"]]},
        "codes that are words": lambda d: d | {"grid": [[str(c) for c in r] for r in d["grid"]]},
        "looks that are a list": lambda d: d | {"looks": [1]},
        "a look that is none": lambda d: d | {"looks": {**d["looks"], "sky": 3}},
        "another game": lambda d: d | {"game": "keys" if d["game"] != "keys" else "maze"},
        "a game that is none": lambda d: d | {"game": None},
        "no agent": lambda d: {k: v for k, v in d.items() if k != "agent"},
        "a list in its place": lambda d: [d, 1],
        "an agent in a corner": lambda d: d | {"agent": [0, 0]},
    }

    def act(game: str, change: Callable[[dict[str, Any]], Any], place: Place) -> Any:
        from astray import games
        from astray.level_files import read_levels
        from attack.material import SMALLEST

        path = place.copy(f"{game}.json")
        path.write_text(json.dumps(change(json.loads(path.read_text()))))
        found = games.find(game)
        return read_levels(path, found, found.variant(SMALLEST[game]))

    from attack.material import SMALLEST

    return {
        f"level of {game}: {name}": functools.partial(act, game, change)
        for game in SMALLEST
        for name, change in changes.items()
    }


def _commands() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Commands whose words are nearly right."""

    def said(words: tuple[str, ...], place: Place) -> Any:
        place.copy("run")
        place.copy("run", "again")
        place.copy("maze.txt", "levels/a.txt")
        place.copy("maze.txt", "levels/a.txt:1")
        place.mine("levels/twice.txt", (place.made / "maze.txt").read_text() * 1)
        return place.astray(*words)

    level = ("--levels", "0:2")
    return {
        f"command: {' '.join(words)}": (functools.partial(said, words), "refusal")
        for words in (
            ("evaluate", "run", "run", *level), ("evaluate", "run", "./run", *level),
            ("evaluate", "run", "run/checkpoints/1024", *level),
            ("evaluate", "maze-corner", "maze-corner", *level),
            ("evaluate", "run", "again", *level), ("evaluate", "run", "--level", "0:2"),
            ("evaluate", "run", "--levels", "0;2"), ("evaluate", "run", "--mode", "Greedy", *level),
            ("evaluate", "run", "--art", "OWN", *level),
            ("evaluate", "run", "--shift", "Corner", *level),
            ("evaluate", "run", "--set", "time-limit=5", *level),
            ("evaluate", "run", "--set", "time_limit", *level),
            ("evaluate", "run", "--set", "time_limit=5.0", *level),
            ("evaluate", "run", "--set", "time_limit=true", *level),
            ("evaluate", "run", "--set", "time_limit=NaN", *level),
            ("evaluate", "run", "--game", "keys", *level),
            ("evaluate", "run", "--observation", "symbolic", "--policy", "x:y", *level),
            ("level", "maze", "corner", "--levels", "0:"), ("level", "maze", "corner", "--json=1"),
            ("level", "maze", "corner", "--levels", "5:2"),
            ("level", "maze", "corner", "--levels", "1.0"),
            ("level", "maze", "Corner"), ("level", "maze", "corner", "extra"),
            ("train", "maze", "corner-small", "--preset", "Small"),
            ("train", "maze", "corner-small", "--gama", "0.9"),
            ("train", "maze", "corner-small", "--steps", "1e3"),
            ("train", "maze", "corner-small", "--seeds", "1.0"),
            ("sweep", "maze", "corner-small", "--set", "width=8,8"),
            ("sweep", "maze", "corner-small", "--set", "width=8", "--set", "width=16"),
            ("sweep", "maze", "corner-small", "--set", "gamma=0.9,0.90"),
            ("sweep", "maze", "corner-small", "--set", "lr=1e-4", "--set", "learning_rate=1e-3"),
            ("sweep", "maze", "corner-small", "--set", "seed=1,2"),
            ("sweep", "maze", "corner-small", "--set", "anneal=1,0"),
            ("sweep", "maze", "corner-small", "--set", "widthh=8"),
            ("sweep", "maze", "corner-small", "--set", "width="),
            ("export", "run", "--policy", "random", "--game", "maze", "--variant", "corner"),
            ("export", "run", "--form", "Parquet", *level),
            ("record", "run", "--level", "1.0"), ("record", "run", "--out", "video.MP4"),
            ("agency", "run", "--measure", "Paper"), ("agency", "run", "--levels", "0-5"),
            ("agency", "run", "--agent", "maze-corner"), ("lab", "run", "--agent", "maze-corner"),
            ("cache", "prune"), ("agents", "Fetch"), ("agents", "check"),
            ("art", "List"), ("art", "list", "pictures"), ("reproduce", "maze_corner"),
            ("reproduce", "maze-corner", "--size", "Smoke"), ("bench", "start", "--device", "CPU"),
            ("explain", "run", "--layers", ","), ("explain", "run", "--level", "0.0"),
            ("explain", "run", "--level", "0", "--level-file", "levels/a.txt"),
            ("replay", "maze", "corner-small", "--actions", "levels/a.txt", "--level", "0"),
            ("overlap", "maze", "corner-small", "anywhere-small", "--test-levels", ""),
        )
    }  # fmt: skip


def _others() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Copies that share nothing, files twice, marks before files, NaN among weights."""

    def copies(how: str, _: Place) -> None:
        import copy
        import pickle

        env = _env()
        env.reset(seed=0)
        other = {
            "copy": copy.copy,
            "deepcopy": copy.deepcopy,
            "pickle": lambda x: pickle.loads(pickle.dumps(x)),
        }[how](env)
        before = env.get_state().tobytes()
        for _again in range(5):
            other.step(np.zeros(2, int))
        if env.get_state().tobytes() != before:
            raise Wrong("a copy's steps were its original's")

    def fresh(_: Place) -> None:
        env = _env()
        seen, _ = env.reset(seed=0)
        kept = seen.copy()
        env.step(np.zeros(2, int))
        if seen.tobytes() != kept.tobytes():
            raise Wrong("an observation changed afterwards")

    def marked(ending: str, place: Place) -> Any:
        from astray import games
        from astray.level_files import read_levels

        path = place.copy(f"maze.{ending}")
        plain = read_levels(path, games.find("maze"), games.find("maze").variant("corner-small"))
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
        found = read_levels(path, games.find("maze"), games.find("maze").variant("corner-small"))
        if str(next(iter(found.values()))) != str(next(iter(plain.values()))):
            raise Wrong("a mark before a level changed it")

    def twice(place: Place) -> Any:
        place.mine(
            "levels/a",
            (place.made / "maze.txt").read_text()
            + "\n" * 2
            + (place.made / "maze.txt").read_text(),
        )
        place.copy("maze.txt", "levels/a:1")
        place.copy("run")
        return place.astray("evaluate", "run", "--levels", "levels", "--variant", "corner-small")

    def weights(value: float, name: str, place: Place) -> Any:
        from safetensors.numpy import load_file

        from attack.files import rewritten

        path = next(place.copy("run").glob("checkpoints/1024/agent.safetensors"))
        tensors = load_file(path)
        first = next(key for key in tensors if key.endswith(name))
        tensors[first].flat[0] = value
        path.write_bytes(rewritten(path.read_bytes(), tensors))
        return place.astray("evaluate", "run", "--levels", "0:2")

    def seeds(place: Place) -> Any:
        place.copy("run")
        return place.astray("evaluate", "run", "--levels", "7,7,7,7", "--json")

    return {
        **{f"a {how} of an environment": (functools.partial(copies, how), "success")
           for how in ("copy", "deepcopy", "pickle")},
        "an observation that was returned": (fresh, "success"),
        **{f"a byte order mark before a .{e}": (functools.partial(marked, e), "success")
           for e in ("txt", "json")},
        "two levels by one name": (twice, "refusal"),
        **{f"{value} among the {name}s": (functools.partial(weights, value, name), "refusal")
           for value in (float("nan"), float("inf"), float("-inf")) for name in ("weight", "bias")},
        "a level listed four times": (seeds, "any"),
    }  # fmt: skip
