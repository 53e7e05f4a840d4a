"""Activations of an agent's network in states, with labels.

    found = capture(agent, "anywhere-small", states, ["features.relu1"])
    found.values["features.relu1"]  # [N, 64] float32
    found.labels  # N rows: level, step, and the requested measures

A layer is a named module of the network, such as `block2.residual1`, and its activation is the
module's output. This works for every network: astray's own, imported and custom ones.
"""

import contextlib
import io
import itertools
import json
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import torch
from torch import Tensor

from astray import world
from astray.analysis.critic import observe
from astray.analysis.evaluate import Measure, check_measures, measured
from astray.analysis.tables import read_table, write_table
from astray.analysis.trained import Model, check_network
from astray.envs.states import BROKEN, arrays_of
from astray.files import check_readable, new_folder, write_aside
from astray.game import Variant
from astray.memory import check_memory
from astray.training.folders import read_json
from astray.validation import MOST, bounded, brief, of_kind, one_of, path_of, shown

INDEX, LABELS, FORMAT = "index.json", "labels.parquet", 1
LABEL = "label:"  # before the names of labels in an .npz file


@dataclass(frozen=True, eq=False)
class Activations:
    """Activations of layers in N states, and labels of the states.

    Attributes:
        values: Layer -> [N, ...] float32; for convolutions [N, channels, rows, columns].
        labels: N rows: level, step, and measures of the states.
    """

    values: Mapping[str, np.ndarray]
    labels: pl.DataFrame

    def __post_init__(self) -> None:
        for name, value in self.values.items():
            one_of("type", getattr(value, "dtype", np.dtype(object)).name, ("float32",), name)
        lengths = {len(self.labels), *(len(value) for value in self.values.values())}
        if len(lengths) != 1:
            raise ValueError(f"activations and labels must be equally long; got {sorted(lengths)}")

    def save(self, path: Path) -> None:
        """Write everything to one .npz file; names of labels begin with "label:".

        Raises:
            ValueError: If a label cannot be stored.
        """
        labels = {LABEL + name: self.labels[name].to_numpy() for name in self.labels.columns}
        odd = [name for name, column in labels.items() if column.dtype.kind not in "biuf"]
        if odd:
            raise ValueError(f"labels must be numbers to be saved; got others in {odd}")
        file = io.BytesIO()
        np.savez(file, allow_pickle=False, **dict(self.values), **labels)
        write_aside(path, file.getvalue())


@contextlib.contextmanager
def hooked(agent: Model, names: Iterable[str], see: Callable[[str, Any], Any]) -> Iterator[None]:
    """Call `see` with the name and output of each named module; its result, if any, replaces it."""
    modules = dict(agent.network.named_modules())
    with contextlib.ExitStack() as stack:
        if "torch._dynamo" in sys.modules:  # which compiles; compiled code calls no hooks
            stack.enter_context(torch.compiler.set_stance("force_eager"))
        for name in names:
            hook = modules[name].register_forward_hook(
                lambda _, __, output, name=name: see(name, output)
            )
            stack.callback(hook.remove)
        yield


def layers(agent: Model) -> dict[str, tuple[int, ...]]:
    """Return the readable and changeable layers in the network's order: name -> output shape.

    These are the modules that are used once per pass and return a real tensor with one row per
    observation.
    """
    check_network(agent)
    calls: defaultdict[str, list[Any]] = defaultdict(list)
    names = [name for name, _ in agent.network.named_modules() if name]
    # Two, so that a layer is told whose rows are no observations.
    blank = torch.from_numpy(np.zeros((2, *agent.space.shape), agent.space.dtype))
    with torch.no_grad(), hooked(agent, names, lambda name, x: calls[name].append(x)):
        agent.asked(blank.to(agent.device))
    return {
        name: tuple(x.shape[1:])
        for name, (x, *more) in calls.items()
        if not more and isinstance(x, Tensor) and x.is_floating_point() and len(x) == 2
    }


def check_layers(agent: Model, names: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the named layers; raise ValueError if one does not exist."""
    if isinstance(names, str) or not isinstance(names, Sequence | Mapping) or not names:
        raise ValueError(f"layers must be a list of names, at least one; got {shown(names)}")
    shapes, modules = layers(agent), dict(agent.network.named_modules())
    for name in names:
        is_there = isinstance(name, str) and name in modules  # a pass may call it twice, or never
        one_of("layer", name, shapes, "those that a pass calls once" * is_there)
    return {name: shapes[name] for name in names}


def activations(
    agent: Model, observations: np.ndarray, names: Sequence[str], begins: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Return the activations of layers for observations [N, ...]: layer -> [N, ...] float32.

    They do not depend on the batch.

    Args:
        begins: [N] bool, whether each is the first of an episode, where the observations are whole
            episodes, which an agent with memory remembers; None to ask it in each state alone.

    Raises:
        ValueError: If a layer is unknown, or the observations are not the agent's.
    """
    shapes = check_layers(agent, names)
    parts: dict[str, list[Any]] = {name: [] for name in shapes}  # of tensors
    # A copy, as a later module, such as ReLU(inplace=True), may write to it.
    with hooked(agent, shapes, lambda name, x: parts[name].append(x.clone())):
        if begins is None or not agent.caveat:
            agent.outputs(observations)  # in chunks of one size, the last one padded
        else:
            for episode in np.split(observations, np.flatnonzero(begins)[1:]):
                agent.outputs(episode, episode=True)
    n = len(observations)
    return {
        name: torch.cat(some)[:n].float().numpy(force=True)
        if n
        else np.empty((0, *shapes[name]), np.float32)
        for name, some in parts.items()
    }


def capture(
    agent: Model,
    variant: str | Variant,
    states: np.ndarray,
    layers: Sequence[str],
    *,
    measures: Mapping[str, Measure] | None = None,
    folder: Path | None = None,
    batch: int = 1024,
    episodes: bool = False,
) -> Activations:
    """Capture the activations of `layers` in `states` [N] of the agent's game, with labels.

    States of a `World` are those that `critic.visit` returns.

    Args:
        measures: Further labels, functions of states.
        folder: New folder for an .npy file per layer if memory does not suffice; results are then
            read on demand.
        batch: States per pass; results do not depend on it.
        episodes: Whether the states are those of whole episodes, one episode after another, as
            `critic.visit` returns them. An agent with memory then remembers what it saw before.

    Raises:
        ValueError: If a layer is unknown, a state is not one of the variant, or states are not of
            whole episodes.
        MemoryError: If they do not fit in memory.
        OSError: If the disk has no room for the folder.
    """
    of_kind("states", states, np.ndarray)
    bounded("batch", batch, 1, MOST)
    shapes, game = check_layers(agent, layers), world.find(agent.game)
    game.check(states, game.variant(variant))
    n = len(states)
    begins = beginnings_in(states) if episodes else None
    columns = {"level": states["level"].copy(), "step": states["time"].copy()}
    check_measures(measures, columns)
    columns |= {name: measured(name, one, states) for name, one in (measures or {}).items()}
    labels = pl.DataFrame(columns)

    def fill(values: Mapping[str, np.ndarray]) -> None:
        """Write the activations into `values`, by episodes if these are whole."""
        firsts = range(0, n, batch) if begins is None else np.flatnonzero(begins)
        for part in itertools.starmap(slice, itertools.pairwise([*firsts, n])):
            shown = observe(agent, variant, states[part])
            first = None if begins is None else begins[part]
            for name, some in activations(agent, shown, list(values), first).items():
                values[name][part] = some

    if folder is not None:
        return _capture_aside(n, shapes, labels, folder, fill)
    check_memory(4 * n * sum(int(np.prod(s)) for s in shapes.values()), "activations")
    values = {name: np.empty((n, *shape), np.float32) for name, shape in shapes.items()}
    fill(values)
    return Activations(values, labels)


def beginnings_in(states: np.ndarray) -> np.ndarray:
    """Return [N] bool, whether each of `states` [N] begins an episode.

    Raises:
        ValueError: If they are not whole episodes, one after another, each from its first step on.
    """
    time, level = states["time"], states["level"]
    begins = time == 0
    goes_on = (time[1:] == time[:-1] + 1) & (level[1:] == level[:-1])
    if not len(states) or not begins[0] or not (begins[1:] | goes_on).all():
        raise ValueError(
            "states must be those of whole episodes, each from its first step on and one after "
            "another, as `critic.visit` returns them without `per_episode`"
        )
    return begins


def _capture_aside(
    count: int,
    shapes: Mapping[str, tuple[int, ...]],
    labels: pl.DataFrame,
    folder: Path,
    fill: Callable[[Mapping[str, np.ndarray]], None],
) -> Activations:
    """Capture `count` states to a folder, which is complete or absent."""
    folder = path_of("folder", folder)
    if os.path.lexists(folder):
        raise ValueError(f"{folder} must be a new folder; there is something already")
    files = {name: f"{k}.npy" for k, name in enumerate(shapes)}
    with new_folder(folder) as aside:
        values: dict[str, np.ndarray] = {
            name: np.lib.format.open_memmap(aside / files[name], "w+", np.float32, (count, *shape))
            for name, shape in shapes.items()
        }
        take = getattr(os, "posix_fallocate", lambda *_: None)  # Macs and Windows have none
        for file in files.values():  # a mapped page without room for it kills the process
            with open(path := aside / file, "r+b") as opened:
                try:
                    take(opened.fileno(), 0, path.stat().st_size)
                except OSError as error:
                    raise OSError(error.errno, error.strerror, str(path)) from error
        fill(values)
        for value in values.values():
            assert isinstance(value, np.memmap)
            value.flush()
        values.clear()
        write_table(labels, aside / LABELS)
        write_aside(aside / INDEX, json.dumps({"format": FORMAT, "layers": files}).encode())
    return load_activations(folder)


def load_activations(path: Path) -> Activations:
    """Load the files of `Activations.save` or `capture`, without executing anything in them.

    Arrays in a folder are read on access.

    Raises:
        FileNotFoundError: If nothing is at `path`.
        ValueError: If it is something else.
    """
    path = path_of("path", path)
    if not path.exists():
        raise FileNotFoundError(f"there are no activations at {path}")
    try:
        return _load_folder(path) if path.is_dir() else _load_file(path)
    except (*BROKEN, pl.exceptions.PolarsError, RecursionError, TypeError) as error:
        raise ValueError(f"{path} holds no activations: {brief(error)}") from error


def _load_file(path: Path) -> Activations:
    arrays = dict(arrays_of(path))
    labels = {n.removeprefix(LABEL): a for n, a in arrays.items() if n.startswith(LABEL)}
    if any(a.dtype.kind not in "biuf" or a.ndim != 1 for a in labels.values()):
        raise ValueError("its labels are not numbers, one of each state")
    values = {n: a for n, a in arrays.items() if not n.startswith(LABEL)}
    return Activations(values, pl.DataFrame(labels))


def _load_folder(path: Path) -> Activations:
    index = read_json(path / INDEX, dict, ("layers",))
    of_kind("layers", index["layers"], dict)
    if index.get("format") != FORMAT:
        raise ValueError(f"it has format {shown(index.get('format'))}; this version reads {FORMAT}")
    values = {}
    for name, file in index["layers"].items():
        one_of("file", file, os.listdir(path), of=f"layer {shown(name)}")  # none in other folders
        check_readable(path / file)
        with open(path / file, "rb") as opened:  # as to map items of 0 bytes ends the process
            np.lib.format.read_magic(opened)
            one_of("type", np.lib.format.read_array_header_1_0(opened)[2].name, ("float32",), file)
        values[name] = np.load(path / file, mmap_mode="r", allow_pickle=False)
    return Activations(values, read_table(path / LABELS))
