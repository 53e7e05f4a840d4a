"""Context managers that modify a network's activations.

    with steer(agent, {"block2.residual1": vector}, -1.0):
        rates, episodes = astray.evaluate_policies([agent], "maze", "corner-easy")

They can be nested; inner ones see the outer ones' results. Afterwards, also after an error, the
agent is unchanged to the bit. They affect everything that asks the agent: episodes, fields,
videos, gradients.
"""

import contextlib
import functools
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.agents.drc import DRC
from astray.analysis.critic import observe
from astray.analysis.trained import Agent, AnyModel, Model
from astray.game import Variant
from astray.insight.activations import activations, check_layers, hooked
from astray.level import Cell
from astray.validation import MOST, bounded, finite, integers, of_kind, shown

AT_ONCE = 64  # states per pass
Change = Callable[[Tensor], Tensor]  # activations [B, ...] -> those in their place


@contextlib.contextmanager
def changed(agent: AnyModel, changes: Mapping[str, Change]) -> Iterator[AnyModel]:
    """Apply functions to the outputs of the named layers; other interventions use this.

    Args:
        changes: Layer -> function of its output [B, ...] that returns a replacement of the same
            shape without changing it in place.

    Raises:
        ValueError: If a layer is unknown, or, once it is used, a function returns anything else.
    """
    of_kind("changes", changes, Mapping)
    check_layers(agent, list(changes))
    for name, change in changes.items():
        of_kind(f"the change of {name}", change, Callable)

    def replaced(name: str, x: Tensor) -> Tensor:
        new: Any = changes[name](x)  # None would leave the layer as it is
        if getattr(new, "shape", None) != x.shape:
            given = shown(getattr(new, "shape", new))
            raise ValueError(f"the change of {name} must return a tensor of {x.shape}; got {given}")
        return new

    with hooked(agent, changes, replaced):
        yield agent


def steer(
    agent: AnyModel, vectors: Mapping[str, np.ndarray], coefficient: float = 1.0
) -> AbstractContextManager[AnyModel]:
    """Add `coefficient` times a vector to the output of each named layer, in every state.

    Args:
        vectors: Layer -> array that broadcasts to the layer's output for one observation, such as
            [channels, 1, 1] for all places.

    Raises:
        ValueError: If a layer is unknown, or a vector does not fit.
    """
    of_kind("vectors", vectors, Mapping)
    finite("coefficient", coefficient)
    shapes = check_layers(agent, list(vectors))
    changes: dict[str, Any] = {}
    for name, vector in vectors.items():
        added = coefficient * _fitting(f"the vector at {name}", vector, shapes[name])
        changes[name] = lambda x, y=added: x + torch.as_tensor(y).to(x) if coefficient else x
    return changed(agent, changes)


def patch(
    agent: AnyModel,
    layer: str,
    channels: Sequence[int] | None,
    value: float | np.ndarray,
    cell: tuple[int, int] | None = None,
) -> AbstractContextManager[AnyModel]:
    """Set channels of a layer's output, at one place or everywhere.

    Args:
        channels: Channels, or units of a layer without places; None for all.
        value: A scalar, or [channels].
        cell: (row, column) of the layer: `place` finds that of a level's cell.

    Raises:
        ValueError: If the layer has no such channels or place.
    """
    shape, which = _channels(agent, layer, channels)
    if cell is not None:
        if len(shape) != 3:
            raise ValueError(f"{layer} has no places; its activations have the shape {shape}")
        _check_cell(cell, ("row", "column"), shape[1:])
    array = np.broadcast_to(_fitting("value", value, (len(which),)), len(which))
    new = torch.from_numpy(array.copy()).float()
    if cell is None:
        new = new.view(-1, *[1] * (len(shape) - 1))
    return changed(agent, {layer: lambda x: _with(x, which, new, *cell or ())})


def ablate(
    agent: AnyModel,
    layer: str,
    channels: Sequence[int] | None = None,
    *,
    mean_of: np.ndarray | None = None,
) -> AbstractContextManager[AnyModel]:
    """Set channels of a layer to 0, or to their mean at each place.

    Args:
        channels: None for all.
        mean_of: Activations in some states, [M, ...], as returned by `capture`.

    Raises:
        ValueError: If the layer has other shapes.
    """
    shape, which = _channels(agent, layer, channels)
    mean = np.zeros(shape) if mean_of is None else _given(mean_of, shape).mean(0)
    new = torch.from_numpy(mean[which]).float()
    return changed(agent, {layer: lambda x: _with(x, which, new)})


def resample(
    agent: AnyModel,
    layer: str,
    donors: np.ndarray,
    channels: Sequence[int] | None = None,
    *,
    seed: int = 0,
) -> AbstractContextManager[AnyModel]:
    """Replace channels of a layer by their values in random other states.

    The replacement depends on `seed` and on the original output, so it is the same in every batch.
    An agent with memory is rounded otherwise where it is asked along an episode, as by `visit` for
    values and `episode.along`, than where it plays: other states are drawn there than it acted by.

    Args:
        donors: Activations in some states, [M, ...], as returned by `capture`.
        channels: None for all.

    Raises:
        ValueError: If the donors have other shapes, or there is no such channel.
    """
    shape, which = _channels(agent, layer, channels)
    bounded("seed", seed, 0, MOST)
    pool = torch.from_numpy(np.ascontiguousarray(_given(donors, shape)[:, which]))

    def change(x: Tensor) -> Tensor:
        rows = x.detach().float().numpy(force=True)  # numpy has no bfloat16
        drawn = [zlib.crc32(row.tobytes(), seed) % len(pool) for row in rows]
        return _with(x, which, pool[drawn])

    return changed(agent, {layer: change})


def interchange(
    agent: Model,
    variant: str | Variant,
    states: np.ndarray,
    others: np.ndarray,
    layer: str,
    channels: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return policy [N, A] and values [N] in `states`, with a layer's activations in `others`.

    Everything else is as in `states`: if the result is that of `others`, what differs between the
    two passes through these channels.

    Args:
        states: [N], of the agent's game.
        others: [N], from which the activations are taken, row by row.
        channels: Channels, or units of a layer without places; None for all.

    Raises:
        ValueError: If there are not as many states, or the layer has no such channels.
    """
    _, which = _channels(agent, layer, channels)
    if np.shape(states) != np.shape(others):
        raise ValueError(
            f"there must be another state for each; got {np.shape(states)} and {np.shape(others)}"
        )
    seen, donors = (observe(agent, variant, some) for some in (states, others))
    given = torch.from_numpy(activations(agent, donors, [layer])[layer][:, which])
    said = []
    for first in range(0, len(seen), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        change = functools.partial(_with, which=which, new=given[part])
        with torch.no_grad(), changed(agent, {layer: change}):
            logits, values = agent.asked(torch.from_numpy(seen[part]).to(agent.device))
        said.append((logits.double().softmax(-1).cpu(), values.double().cpu()))
    policy, value = (torch.cat(parts).numpy() for parts in zip(*said, strict=True))
    return policy, value


@contextlib.contextmanager
def thinking(agent: Agent, ticks: int) -> Iterator[Agent]:
    """Let a DRC tick fewer times per step than it was trained with.

    Fields within show what it would do after each tick: {k: fields(...)} with k ticks each.

    Raises:
        ValueError: If the network does not tick, or not as often.
    """
    network: Any = getattr(agent, "network", None)
    of_kind("the network that ticks", network, DRC)
    bounded("ticks", ticks, 1, network.repeats)
    before, network.repeats = network.repeats, ticks
    try:
        yield agent
    finally:
        network.repeats = before


def place(agent: Model, variant: Variant, cell: Cell, shape: Sequence[int]) -> tuple[int, int]:
    """Return the (row, column) of a layer at the middle of a level's cell.

    The first row of images is the highest, of symbolic planes the lowest, as in levels.

    Args:
        cell: (x, y) of the level, from the lower left.
        shape: Shape of the layer's output, [channels, rows, columns].

    Raises:
        ValueError: If the agent sees only a part of the world, or the layer has no places.
    """
    of_kind("variant", variant, Variant)
    of_kind("shape", shape, Sequence)
    if not sees_world(variant):
        told = "place finds a cell where `world` is a knob of the variant, and all of it is seen"
        raise ValueError(f"{told}; here, give patch the layer's row and column")
    if len(shape) != 3:
        raise ValueError(f"the layer has no places; its activations have the shape {tuple(shape)}")
    p: Any = variant
    world, (_, rows, columns) = int(p.world), shape
    _check_cell(cell, "xy", (world, world))
    across, up = ((number + 0.5) / world for number in cell)
    down = up if agent.observation == "symbolic" else 1 - up
    return int(down * rows), int(across * columns)


def sees_world(variant: Variant) -> bool:
    """Return whether images of the variant show the whole world, with fixed places of cells."""
    names = variant.records().dtype.names or ()
    return "world" in names and not ("window" in names and variant.records()[0]["window"])


def _check_cell(cell: Any, names: Sequence[str], sizes: Sequence[int]) -> None:
    """Raise ValueError unless `cell` is two integers below their sizes."""
    if np.shape(cell) != (2,):
        raise ValueError(f"a cell must be two integers, {' and '.join(names)}; got {shown(cell)}")
    for name, number, size in zip(names, cell, sizes, strict=True):
        bounded(f"the cell's {name}", number, 0, size - 1)


def _channels(
    agent: Model, layer: str, channels: Sequence[int] | None
) -> tuple[tuple[int, ...], np.ndarray]:
    """Return the shape of a layer, and `channels` of it as an array; all channels for None."""
    shape = check_layers(agent, [layer])[layer]
    count = shape[0]
    if channels is None:
        return shape, np.arange(count)
    found = integers(channels, "channels")
    if found.ndim != 1 or (found < 0).any() or (found >= count).any():
        raise ValueError(f"channels must be from 0 to {count - 1}, listed; got {shown(channels)}")
    return shape, found.astype(np.int64)


def _with(x: Tensor, which: np.ndarray, new: Tensor, *cell: int) -> Tensor:
    """Return a copy of activations [B, ...] with `new` values in channels, in a cell or in all."""
    x = x.clone()
    x[(slice(None), which, *cell)] = new.to(x)
    return x


def _fitting(name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return `given` as finite reals that broadcast to `shape`."""
    try:
        array = np.asarray(given).astype(np.float64, casting="same_kind")  # no text, none complex
        np.broadcast_to(array, shape)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be real numbers that go with what is of shape {shape}; got {shown(given)}"
        ) from None
    if np.ma.is_masked(given) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be of finite numbers; it is not")
    return array


def _given(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return checked activations of a layer of `shape` in some states."""
    of_kind("what the layer gave", values, np.ndarray)
    if values.shape[1:] != shape or not len(values):
        raise ValueError(f"what the layer gave must be [M, {shape}]; got {values.shape}")
    _fitting("what the layer gave", values, values.shape)
    return values
