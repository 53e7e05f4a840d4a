"""The figures of `agency.py`: trajectories on their map, and how much they speak for agents."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import matplotlib
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from astray.agency.generators import TYPES, Setting
from astray.agency.maps import MAPS
from astray.agency.measure import CALIBRATED, PAPER, PRESETS, Episode, measure
from astray.experiments import figures


@matplotlib.rc_context(figures.STYLE)
def draw_types(setting: Setting) -> Figure:
    """A trajectory of each type on its map."""
    figure = Figure(figsize=(figures.WIDTH, 7.6))
    panels = figure.subplots(2, 2).flat
    for axes, kind in zip(panels, TYPES, strict=True):
        episode = max(setting.episodes(kind, 12), key=lambda e: len(e.trajectory))
        evidence = measure(episode, PAPER)
        _draw(axes, episode)
        axes.set_title(kind)
        axes.set_xlabel(
            f"{-evidence.log_agent:.1f} nats as agent, {-evidence.log_device:.1f} as device:\n"
            f"p(agent) = {evidence.agent:.4f}; calibrated {measure(episode, CALIBRATED).agent:.4f}"
        )
    return figure


def _draw(axes: Axes, episode: Episode) -> None:
    """The map, the way, its start (brown) and the goal that is shown (green), as the paper's."""
    world = episode.world
    axes.imshow(~world.free, cmap="Greys", vmin=0, vmax=1.6, origin="lower")
    x, y = world.cells[episode.trajectory.cells].T
    shift = np.linspace(-0.12, 0.12, len(x))  # so that a way back can be seen
    axes.plot(x + shift, y - shift, color=figures.OTHERS[0], linewidth=1.6)
    axes.plot(x[0], y[0], "s", color="#8a5a2b", markersize=9)
    if episode.true:
        axes.plot(*episode.true, "s", color="#2e9e4f", markersize=9)
    axes.plot(x[-1], y[-1], "o", color=figures.INK, markersize=4)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(True)


@matplotlib.rc_context(figures.STYLE)
def draw_factors(table: pl.DataFrame, kinds: Sequence[str]) -> Figure:
    """The mean log Bayes factor of each type: a panel a preset, a point a map."""
    figure = Figure(figsize=(figures.WIDTH, 5.6))
    colours = dict(zip(MAPS, (*figures.OTHERS, "#2fa393"), strict=True))
    rows = figure.subplots(len(PRESETS), 1, sharex=True)
    for axes, preset in zip(rows, PRESETS, strict=True):
        for number, (map_, colour) in enumerate(colours.items()):
            part = {r["type"]: r for r in table.filter(preset=preset, map=map_).to_dicts()}
            there = [k for k in kinds if k in part]
            y = [kinds.index(k) + 0.13 * (number - 2) for k in there]
            mean = np.array([part[k]["log factor"] for k in there])
            low, high = (np.array([part[k][end] for k in there]) for end in ("low", "high"))
            axes.errorbar(
                mean,
                y,
                xerr=[mean - low, high - mean],
                fmt="o",
                markersize=3.5,
                color=colour,
                linewidth=1.3,
                label=map_ if preset == "paper" else None,
            )
        axes.axvline(0, color=figures.INK, linewidth=0.8)
        axes.set_xscale("symlog", linthresh=2)
        axes.set_xticks([-2, -1, 0, 1, 2, 5, 10, 20, 50], [-2, -1, 0, 1, 2, 5, 10, 20, 50])
        axes.grid(axis="x")
        axes.set_yticks(range(len(kinds)), [textwrap.fill(kind, 22) for kind in kinds])
        axes.set_ylim(len(kinds) - 0.5, -0.5)
        axes.set_title(f"the measure {preset!r}")
    rows[-1].set_xlabel("mean log Bayes factor, agents against devices (nats)")
    figure.legend(loc="outside upper left", ncols=5, handlelength=1)
    return figure
