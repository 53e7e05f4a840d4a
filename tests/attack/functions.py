"""Class 4: objects of other kinds, given to functions of every package."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from attack.core import Attempt, Place

NONE, NAN = None, float("nan")
# What is given in the place of an argument, by what it should be.
WRONG: dict[str, dict[str, Any]] = {
    "agent": {"None": NONE, "a path": "run", "a class": object, "a function": len},
    "variant": {"None": NONE, "a number": 3, "a word": "Corner", "a list": []},
    "states": {"None": NONE, "a number": 3, "reals": np.zeros(3), "no states": np.zeros(0),
               "words": ["a"]},
    "layer": {"None": NONE, "a number": 3, "a word": "nothing", "a list": [[]]},
    "levels": {"None": NONE, "reals": [0.5], "words": ["a"], "none": [], "a level below 0": [-1],
               "a function": len},
    "observations": {"None": NONE, "reals": np.zeros((2, 3)), "no rows": np.zeros((0, 4, 5, 5)),
                     "a word": "images", "another shape": np.zeros((2, 9, 9, 9), np.uint8)},
    "game": {"None": NONE, "a number": 1, "a word": "Maze", "a class": int},
    "shift": {"None": NONE, "a number": 1, "a word": "Corner", "a list": []},
    "folder": {"None": NONE, "a number": 1, "bytes": b"there", "a list": []},
    "path": {"None": NONE, "a number": 1, "a list": [], "nothing there": Path("nothing-there")},
    "logits": {"None": NONE, "a number": 1, "words": ["a"], "NaN": np.full((2, 3), NAN),
               "none": np.zeros((0, 0)), "lists of any length": [[1], [1, 2]]},
    "table": {"None": NONE, "a number": 1, "a dict": {}, "no columns": "empty"},
    "number": {"None": NONE, "a word": "a", "NaN": NAN, "a truth": True, "below 0": -1,
               "infinite": float("inf"), "a list": [1]},
    "world": {"None": NONE, "a word": "#.#", "a number": 1, "an array": np.ones((3, 3))},
    "function": {"None": NONE, "a number": 1, "a word": "len", "of nothing": lambda: 1,
                 "of None": lambda *_: None, "that raises": lambda *_: 1 / 0},
    "text": {"None": NONE, "a number": 1, "bytes": b"x", "a list": []},
}  # fmt: skip
Given = dict[str, Any]


def attempts() -> Iterator[Attempt]:
    for name, (kinds, call) in CALLS.items():
        for argument, kind in kinds.items():
            for title, value in WRONG[kind].items():
                act = functools.partial(_call, call, argument, value)
                also = (ZeroDivisionError,) if title == "that raises" else ()
                yield Attempt(4, f"{name}: {argument} is {title}", act, "any", 40, also=also)


def _call(call: Callable[..., Any], argument: str, value: Any, place: Place) -> Any:
    if isinstance(value, str) and value == "empty":
        import polars

        value = polars.DataFrame()
    return call(place, **{argument: value})


def _fixed(place: Place) -> Given:
    """What is right: an agent of a small maze, its variant, states, levels."""
    from astray.analysis.critic import observe
    from astray.analysis.runs import open_run
    from astray.envs.vector import GameVectorEnv

    agent, config = open_run(place.made / "run")
    env = GameVectorEnv("maze", config.training_variant(), 2, observation="symbolic")
    env.reset(seed=0)
    states = env.get_state()
    return {
        "agent": agent, "variant": config.training_variant(), "states": states, "levels": [0, 1],
        "layer": "features.relu1", "game": "maze", "config": config, "env": env,
        "observations": observe(agent, config.training_variant(), states),
    }  # fmt: skip


def _of(module: str, name: str, *order: str, **more: Any) -> Callable[..., Any]:
    """A call of a function with arguments of `_fixed` in that order, one of them another."""

    def call(place: Place, **changed: Any) -> Any:
        from importlib import import_module

        fixed = _fixed(place) | changed
        function = getattr(import_module(f"astray.{module}"), name)
        named = more | {key: value for key, value in changed.items() if key not in order}
        found = function(*(fixed[one] for one in order), **named)
        return list(found) if isinstance(found, Iterator) else found

    return call


def _kinds(*names: str, **others: str) -> dict[str, str]:
    return {name: name for name in names} | others


def _plain(module: str, name: str, **more: Any) -> Callable[..., Any]:
    """A call of a function with nothing but these arguments, some of them others."""

    def call(place: Place, **given: Any) -> Any:
        from importlib import import_module

        function = import_module(f"astray.{module}")
        for part in name.split("."):
            function = getattr(function, part)
        found = function(**(more | given))
        return list(found) if isinstance(found, Iterator) else found

    return call


def _level(method: str) -> Callable[..., Any]:
    """A level's method, given an object's name and a cell."""

    def call(place: Place, name: Any = "goal", cell: Any = None) -> Any:
        from astray.level import Level

        env = _fixed(place)["env"]
        level = Level.of(env.game, env.variant, env.states[0])
        arguments = {"moved": (name, cell if cell is not None else (1, 1)), "removed": (name, cell),
                     "added": (name, cell if cell is not None else (1, 1)), "splay": (name, cell),
                     "where": (name,)}[method]  # fmt: skip
        return getattr(level, method)(*arguments)

    return call


def _asked(place: Place, **changed: Any) -> Any:
    """A message of a page of the lab, some of its fields changed."""
    import json

    from astray.lab.serving import make_lab
    from astray.lab.session import Session

    name = str(place.made / "run")
    lab = make_lab(place.made / "run", {"game": None, "variant": None, "level": None})
    message = {"id": 1, "kind": "play", "game": "maze", "variant": "corner-small", "agent": name,
               "steps": 2} | changed  # fmt: skip
    try:
        text = json.dumps(message, default=str)
    except (TypeError, ValueError):
        text = repr(message)
    answers = list(Session(lab).answers(text))
    if answers[-1].get("error"):
        raise ValueError(answers[-1]["error"])
    return answers


CALLS: dict[str, tuple[dict[str, str], Callable[..., Any]]] = {
    "layers": (_kinds("agent"), _of("insight.activations", "layers", "agent")),
    "activations": (_kinds("agent", "observations", names="layer"),
                    _of("insight.activations", "activations", "agent", "observations",
                        names=["features.relu1"])),
    "capture": (_kinds("agent", "variant", "states", layers="layer"),
                _of("insight.activations", "capture", "agent", "variant", "states",
                    layers=["features.relu1"])),
    "gradients": (_kinds("agent", "observations"),
                  _of("insight.attribution", "gradients", "agent", "observations")),
    "occlusion": (_kinds("agent", "observations", window="number", colour="number"),
                  _of("insight.attribution", "occlusion", "agent", "observations", window=4,
                      colour=0)),
    "integrated": (_kinds("observations", steps="number", baseline="observations"),
                   _of("insight.attribution", "integrated_gradients", "agent", "observations",
                       steps=4, baseline=None)),
    "ablate": (_kinds("agent", "layer", channels="levels"),
               _of("insight.interventions", "ablate", "agent", "layer", channels=[0])),
    "patch": (_kinds("agent", "layer", value="number", cell="levels"),
              _of("insight.interventions", "patch", "agent", "layer", channels=[0], value=1.0)),
    "steer": (_kinds("agent", vectors="table", coefficient="number"),
              _of("insight.interventions", "steer", "agent", vectors={}, coefficient=1.0)),
    "pair vectors": (_kinds("agent", "variant", "layer", "states"),
                     _of("insight.vectors", "pair_vectors", "agent", "variant", "layer", "states",
                         "states")),
    "features of levels": (_kinds("game", "variant", "levels"),
                           _of("insight.behaviour", "level_features", "game", "variant", "levels")),
    "an episode": (_kinds("agent", "variant", level="levels", gamma="number", lam="number"),
                   _of("insight.episode", "along", "agent", "variant", level=0, gamma=0.9,
                       lam=0.9)),
    "a field": (_kinds("agent", "variant", "levels"),
                _of("insight.fields", "fields", "agent", "variant", "levels")),
    "evaluate": (_kinds("game", "variant", "levels", policy="agent", batch="number"),
                 lambda place, **given: _of("analysis.evaluate", "evaluate", "policy", "game",
                                            "variant", "levels", batch=2)(
                     place, **{"policy": _fixed(place)["agent"]} | given)),
    "trajectories": (_kinds("agent", "game", "variant", "levels", batch="number"),
                     _of("analysis.dataset", "trajectories", "agent", "game", "variant", "levels",
                         batch=2)),
    "visits": (_kinds("agent", "variant", "levels", per_episode="number", gamma="number"),
               _of("analysis.critic", "visit", "agent", "variant", "levels", per_episode=2,
                   gamma=0.9)),
    "counterfactuals": (_kinds("agent", "variant", "states", edit="function"),
                        _of("analysis.critic", "counterfactual", "agent", "variant", "states",
                            edit=lambda states: states)),
    "beginnings": (_kinds("game", "variant", "levels"),
                   _of("acting", "initial_states", "game", "variant", "levels")),
    "a video": (_kinds("agent", "game", "variant", level="levels", pixels="number"),
               _of("analysis.video", "play", "agent", "game", "variant", level=0, pixels=32)),
    **{f"uncertainty: {name}": ({"logits": "logits"}, _plain("mitigation.uncertainty", name))
       for name in ("max_probability", "margin", "entropy", "energy", "max_logit")},
    **{f"level.{name}": ({"name": "text", "cell": "levels"}, _level(name))
       for name in ("moved", "removed", "added", "splay")},
    "the lab": (_kinds("game", "variant", "agent", level="states", actions="levels",
                       steps="number", seed="number", steering="table", knobs="table"), _asked),
    "a map": (_kinds(text="world"), _plain("agency.gridworld", "World.parse")),
    "a mean": (_kinds(values="logits", weights="logits"),
                  _plain("analysis.estimates", "estimate_mean", values=np.ones((2, 3)))),
    "rates": (_kinds(episodes="table"), _plain("analysis.outcomes", "rates")),
    "a shift": (_kinds("game", "shift"),
                _plain("analysis.outcomes", "load_shift", game="maze", shift="corner")),
    "a run": (_kinds(run="path"), _plain("analysis.runs", "open_run")),
    "a data set": (_kinds("folder"), _plain("analysis.dataset", "read_trajectories")),
    "results": (_kinds("path"), _plain("published.results", "read_results")),
    "states of a file": (_kinds("path", "game"),
                         _plain("envs.states", "load_states", path=Path("none"), game="maze")),
}  # fmt: skip
