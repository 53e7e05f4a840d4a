"""The verb that looks into an agent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tyro.conf import Positional

from astray.analysis import kept
from astray.bounds import bounded
from astray.cli.arguments import Knobs, Mode, one_level, pairs
from astray.files import see_free, see_writable
from astray.record import LEVELS

MOST_LEVELS = 10_000


def explain(
    agent: Positional[Path],
    variant: str | None = None,
    level: int | None = None,
    level_file: Path | None = None,
    shift: str | None = None,
    layers: str | None = None,
    others: int = 100,
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: Knobs = (),
    out: Path = Path("explained"),
) -> None:
    """Write one page about an agent in a level: what it would do everywhere, and why.

    Arrows and values, what edits of the level change, what the value depends on, what probes read
    off its layers, which goal its episode speaks for, and the episode step by step.

    Args:
        agent: a run folder or a checkpoint in it, or a name as `astray list` has them
        variant: of the level; by default the test variant of the shift
        level: its number; by default the first that the training does not draw from
        level_file: the level instead; `astray level` prints such
        shift: which goals are intended and proxies; by default the one that the run trained for
        layers: that probes read, by commas; by default three, the last one among them
        others: levels that the probes learn from
        mode: draw from the agent's policy, or take the likeliest action
        art: that images are drawn with, own or original; by default what it was trained on
        knobs: of the variant, changed
        out: the folder for explain.html, its figures and tables
    """
    from astray.acting import initial_states
    from astray.analysis.outcomes import load_shift
    from astray.analysis.runs import open_run, reward_deviation, shift_of
    from astray.insight.activations import see_layers
    from astray.insight.explain import PAGE, SIGN, Asked, default_layers
    from astray.insight.explain import explain as write
    from astray.level import Level

    bounded("others", others, 2, MOST_LEVELS)
    if level is not None:
        bounded("level", level, LEVELS.start, LEVELS.stop - 1)
    player, config = open_run(kept.run_of(agent), mode, art)
    game, named = config.find_game(), shift or shift_of(config)
    name = variant or load_shift(game, named).test
    levels = config.variant_for(name, pairs(knobs))
    chosen = one_level(game, levels, level, level_file, unsolvable=True)
    first = int(config.unseen_levels[0])
    number = first if chosen is None else chosen
    if not isinstance(number, Level):
        drawn = Level.of(game, levels, initial_states(game, levels, [number])[0])
        where = f"{name} level {number}"
    else:
        drawn, where = number, f"{name} {level_file}"
    reads = tuple(layers.split(",")) if layers else default_layers(player)
    see_layers(player, reads)
    see_free(out, PAGE, SIGN, ())
    see_writable(out / PAGE)
    # Probes do not learn from the level that they read.
    after = [one for one in config.unseen_levels[1 : others + 2] if one != number][:others]
    told = np.array(after), config.gamma, config.lam, reward_deviation(player, config)
    asked = Asked(player, levels, drawn, named, reads, *told)
    print(write(asked, out, f"{agent.name} in {game.name} {where}"))
