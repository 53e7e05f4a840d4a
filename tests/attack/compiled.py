"""Class 2: what else reaches compiled code: actions, arrays, sizes, levels, planes, samplers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from attack.core import Attempt, Place, Wrong
from attack.material import SMALLEST

HUGE = 10**60


def attempts() -> Iterator[Attempt]:
    for game in SMALLEST:
        for name, actions in _actions().items():
            act = functools.partial(_step, game, actions)
            yield Attempt(2, f"actions of {game}: {name}", act)
        for name, out in _outs().items():
            yield Attempt(2, f"out of {game}: {name}", functools.partial(_step_into, game, out))
        for name, cells in _cells().items():
            act = functools.partial(_cells_of, game, cells)
            yield Attempt(2, f"cells of {game}: {name}", act, "any")
        for other in SMALLEST:
            if other != game:
                for name, act in _of_others(game, other).items():
                    yield Attempt(2, f"{name} of {other} in {game}", act)
    for name, (act, wants) in {**_functions(), **_trainings(), **_threads()}.items():
        also = (IndexError, OverflowError, NumbaError)  # a kernel's own, whom no user calls
        yield Attempt(2, name, act, wants, seconds=60, also=also)


def _env(game: str, **options: Any) -> Any:
    from astray.envs.vector import GameVectorEnv

    env = GameVectorEnv(game, SMALLEST[game], 2, **{"observation": "symbolic"} | options)
    env.reset(seed=0)
    return env


def _actions() -> dict[str, Any]:
    return {
        "one too many": np.zeros(3, int), "one too few": np.zeros(1, int),
        "none": np.zeros(0, int), "a number": 3, "in a column": np.zeros((2, 1), int),
        "reals": np.zeros(2), "truths": np.zeros(2, bool), "words": np.array(["a", "b"]),
        "objects": np.array([None, 1]), "complex": np.zeros(2, complex), "nothing": None,
        "too large": np.full(2, 15), "below 0": np.array([0, -1]),
        "of 2^62": np.full(2, 2**62), "of 2^63": np.full(2, 2**63, np.uint64),
        "of 60 digits": [HUGE, 0], "the least": np.full(2, np.iinfo(np.int64).min),
        "a list of truths": [True, False], "a list with a real": [0, 1.0], "a word": "01",
        "a masked array": np.ma.masked_array(np.zeros(2), [True, False]),
        "a time": np.zeros(2, "datetime64[s]"), "a record": np.zeros(2, [("a", int)]),
        "the largest of uint8": np.full(2, 255, np.uint8),
        "backwards and too large": np.array([15, 14])[::-1],
    }  # fmt: skip


def _step(game: str, actions: Any, _: Place) -> None:
    env = _env(game)
    env.step(actions)


def _outs() -> dict[str, Callable[[tuple[int, ...]], Any]]:
    def fixed(shape: tuple[int, ...]) -> np.ndarray:
        array = np.zeros(shape, np.uint8)
        array.setflags(write=False)
        return array

    return {
        "read-only": fixed,
        "of reals": lambda shape: np.zeros(shape),
        "of int8": lambda shape: np.zeros(shape, np.int8),
        "an environment less": lambda shape: np.zeros((1, *shape[1:]), np.uint8),
        "a row less": lambda shape: np.zeros((*shape[:-1], shape[-1] - 1), np.uint8),
        "every other item": lambda shape: np.zeros((*shape, 2), np.uint8)[..., 0],
        "backwards": lambda shape: np.zeros(shape, np.uint8)[::-1],
        "in Fortran's order": lambda shape: np.zeros(shape, np.uint8, "F"),
        "broadcast": lambda shape: np.broadcast_to(np.zeros(1, np.uint8), shape),
        "a list": lambda shape: [0] * shape[0],
        "bytes": lambda shape: bytes(int(np.prod(shape))),
        "a subclass without memory": lambda shape: np.memmap,
    }


def _step_into(game: str, make: Callable[[tuple[int, ...]], Any], _: Place) -> None:
    env = _env(game, observation="image" if game == "maze" else "symbolic")
    env.step(np.zeros(2, int), make((2, *env.single_observation_space.shape)))


def _cells() -> dict[str, Callable[[np.ndarray], Any]]:
    """What is done to the cells of a level, in place or beside."""
    return {
        "codes that are none": lambda cells: np.full_like(cells, 250),
        "a row less": lambda cells: cells[:-1].copy(),
        "a column more": lambda cells: np.pad(cells, ((0, 0), (0, 1))),
        "no cell": lambda cells: cells[:0],
        "one cell": lambda cells: cells[:1, :1].copy(),
        "of 500 a side": lambda cells: np.full((500, 500), cells[0, 0]),
        "all the same": lambda cells: np.full_like(cells, cells[0, 0]),
        "of reals": lambda cells: cells.astype(float),
        "of int64": lambda cells: cells.astype(int),
        "of three dimensions": lambda cells: cells[None],
        "a list": lambda cells: cells.tolist(),
        "mirrored": lambda cells: cells[:, ::-1],
    }


def _cells_of(game: str, change: Callable[[np.ndarray], Any], _: Place) -> None:
    """Begin in a level with other cells, and play it where it can be."""
    from dataclasses import replace

    from astray.level import Level

    env = _env(game)
    level = Level.of(env.game, env.variant, env.states[0])
    env.reset(options={"level": replace(level, cells=change(level.cells))})
    for k in range(30):
        env.step(np.full(2, k % len(env.game.actions)))


def _of_others(game: str, other: str) -> dict[str, Callable[[Place], Any]]:
    def variant(place: Place) -> Any:
        from astray import games
        from astray.envs.vector import GameVectorEnv

        return GameVectorEnv(game, games.find(other).variants[SMALLEST[other]], 2)

    def states(place: Place) -> Any:
        from astray.envs.states import load_states

        return load_states(place.made / f"{other}.npz", game)

    def live(place: Place) -> Any:
        return _env(game).set_state(_env(other).get_state())

    def level(place: Place) -> Any:
        from astray.level import Level

        theirs = _env(other)
        return _env(game).reset(
            options={"level": Level.of(theirs.game, theirs.variant, theirs.states[0])}
        )

    def told(place: Place) -> Any:
        return place.astray(
            "replay",
            game,
            SMALLEST[game],
            "--level-file",
            place.made / f"{other}.json",
            "--actions",
            place.made / "actions.txt",
        )

    return {
        "a variant": variant,
        "a file of states": states,
        "states": live,
        "a level": level,
        "a level in a file": told,
    }


def _functions() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Compiled functions that Python calls."""

    def distances(x: Any, y: Any, shape: tuple[int, ...], _: Place) -> None:
        from astray.kernel.grid import distances as run

        run(np.ones(shape, bool), x, y)

    def noise(levels: int, times: int, rows: int, _: Place) -> None:
        from astray.kernel.rng import fill_noise

        fill_noise(0, np.zeros(levels, int), np.zeros(times, int), np.zeros((rows, 4), np.float32))

    def planes(shape: tuple[int, ...], kind: str, _: Place) -> None:
        import torch

        from astray.agents.policy import Architecture
        from astray.training.fast import sparse

        network = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=4).build()
        sparse.outputs(network, torch.zeros(shape).to(getattr(torch, kind)))

    def pictures(pixels: Any, _: Place) -> None:
        _env("maze").picture(pixels)

    def mutate(edits: Any, seeds: Any, kind: Any, place: Place) -> None:
        env = _env("maze")
        env.game.mutation.mutate(env.get_state(), env.variant, seeds, edits, kind)

    two = np.zeros(2, np.uint32)
    found: dict[str, tuple[Callable[[Place], Any], Any]] = {}
    for x, y, shape in (
        (3, 0, (3, 3)),
        (0, -1, (3, 3)),
        (HUGE, 0, (3, 3)),
        (0, 0, (0, 3)),
        (1.5, 0, (3, 3)),
        (0, 0, (3,)),
        (None, 0, (3, 3)),
    ):
        name = f"distances from {str(x)[:6]}, {y} in {shape}"
        found[name] = (functools.partial(distances, x, y, shape), "any")
    for sizes in ((2, 2, 99), (2, 99, 2), (99, 2, 2), (0, 2, 2)):
        found[f"noise of {sizes}"] = (functools.partial(noise, *sizes), "any")
    for shape, kind in (
        ((2, 4, 25, 25), "uint8"),
        ((2, 3, 7, 7), "uint8"),
        ((2, 4, 7, 7), "float"),
        ((0, 4, 7, 7), "uint8"),
        ((4, 7, 7), "uint8"),
        ((2, 4, 7, 7), "int8"),
    ):
        found[f"planes {shape} of {kind}"] = (functools.partial(planes, shape, kind), "any")
    for pixels in (0, -1, 4097, HUGE, 1.5, True, None, "64", float("nan")):
        found[f"pictures of {str(pixels)[:6]} pixels"] = (
            functools.partial(pictures, pixels),
            "refusal",
        )
    for name, given in {
        "edits below 0": (-1, two, "constant"),
        "10^18 edits": (10**18, two, "constant"),
        "a word of no kind": (1, two, "Constant"),
        "a seed too few": (1, two[:1], "constant"),
        "seeds of reals": (1, two / 2, "constant"),
        "no seeds": (1, None, "constant"),
        "true edits": (True, two, "constant"),
        "no kind": (1, two, None),
    }.items():
        found[f"mutate: {name}"] = (functools.partial(mutate, *given), "refusal")
    return found


def _trainings() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Trainings whose validation, samplers or teachers do not fit."""

    def validated(one: str, other: str, fused: bool, place: Place) -> Any:
        return place.astray("train", "maze", one, "--validation", other, "--num-envs", "4",
                            "--num-steps", "4", "--minibatches", "1", "--steps", "16", "--width",
                            "4", "--fused-cpu", str(fused), "--out", "there")  # fmt: skip

    def sampled(levels: Callable[[np.ndarray], Any], place: Place) -> Any:
        from dataclasses import replace

        from astray.training.config import PRESETS
        from astray.training.levels import Plan
        from astray.training.loop import train

        class Odd:
            def __init__(self, config: Any):
                pass

            def plan(self, steps: int) -> Any:
                return Plan()

            def next(self, places: np.ndarray) -> Any:
                return levels(places)

            def note(self, played: Any) -> None:
                pass

            def summary(self) -> dict[str, float]:
                return {}

            def arrays(self) -> dict[str, Any]:
                return {}

            def restore(self, arrays: Any) -> None:
                pass

        config = replace(
            PRESETS["small"],
            variant="corner-small",
            num_envs=4,
            num_steps=4,
            minibatches=1,
            steps=32,
            width=4,
        )
        Odd.__qualname__, globals()["Odd"] = "Odd", Odd  # settings name it
        train(config, place.work / "there", sampler=Odd, progress=False)

    found: dict[str, tuple[Callable[[Place], Any], Any]] = {}
    for one, other in (("corner-small", "corner"), ("corner", "anywhere-small")):
        for fused in (True, False):
            act = functools.partial(validated, one, other, fused)
            found[f"{one} validated on {other}, fused {fused}"] = (act, "refusal")
    for name, levels in {
        "reals": lambda p: p + 0.5,
        "a level too few": lambda p: p[:-1],
        "none": lambda p: None,
        "below 0": lambda p: p - 10,
        "of 2^40": lambda p: p + 2**40,
        "a word": lambda p: "0",
        "a row of rows": lambda p: p[None],
        "of 60 digits": lambda p: [HUGE] * len(p),
    }.items():
        found[f"a sampler's levels: {name}"] = (functools.partial(sampled, levels), "refusal")
    return found


def _threads() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Environments in several threads, closed, collected or interrupted while they step."""

    def stepped(how: str, _: Place) -> None:
        import threading

        env = _env("maze", threads=2)
        alone = _env("maze")
        errors: list[BaseException] = []

        def go_on() -> None:
            try:
                for _ in range(200):
                    env.step(np.zeros(2, int))
            except (RuntimeError, ValueError):
                pass
            except BaseException as error:
                errors.append(error)

        threads = [threading.Thread(target=go_on) for _ in range(3)]
        for thread in threads:
            thread.start()
        if how == "closed":
            env.close()
        elif how == "reset":
            for _again in range(20):
                env.reset()
        elif how == "set":
            for _again in range(20):
                env.set_state(alone.get_state())
        for thread in threads:
            thread.join()
        if errors:
            raise Wrong(repr(errors[0]))

    return {
        f"three threads step an environment that is {how}": (functools.partial(stepped, how), "any")
        for how in ("left", "closed", "reset", "set")
    }
