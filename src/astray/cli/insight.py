"""The verb that explains an agent."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from astray.cli.arguments import Agent, GivenLevel, Tested, pairs
from astray.files import check_free, check_writable
from astray.training.folders import AgentFolder
from astray.training.settings import otherwise
from astray.validation import bounded

MOST_LEVELS = 10_000


def explain(
    agent: Agent,
    tested: Annotated[Tested, arg(name="")] = Tested(),
    level: GivenLevel = GivenLevel(),
    layers: Annotated[str | None, otherwise("three of them, with the last one")] = None,
    others: int = 100,
    out: Path = Path("explained"),
) -> None:
    """Write a page that shows how an agent behaves in a level, and why.

    The page shows policy and value at every place, the effects of edits to the level, the parts
    that the value depends on, probes of the layers, the evidence for each goal, and the episode
    step by step. By default the level is the first unseen one that distinguishes the goals.

    Example: astray explain maze-corner

    Args:
        layers: Layers that probes read, separated by commas.
        others: Number of levels to fit the probes on.
        out: Folder for explain.html with its figures and tables.
    """
    from astray.acting import initial_states
    from astray.analysis.outcomes import load_shift
    from astray.analysis.runs import shift_of
    from astray.insight.activations import check_layers
    from astray.insight.explain import PAGE, SIGN, Asked, default_layers
    from astray.insight.explain import explain as write
    from astray.lab.goals import first_distinguishing
    from astray.level import Level

    bounded("others", others, 2, MOST_LEVELS)
    level.check()
    player, config = tested.acting.open(agent)
    game, named = config.find_game(), tested.shift or shift_of(config)
    shift = load_shift(game, named)
    name = tested.variant or shift.test
    levels = config.played_variant(name, pairs(tested.knobs))
    number = level.find(game, levels)
    if number is None:
        first = int(config.unseen_levels[0])
        number = first_distinguishing(game, levels, shift, first, player)
    if not isinstance(number, Level):
        drawn = Level.of(game, levels, initial_states(game, levels, [number])[0])
        where, given = f"{name} level {number}", f"--level {number}"
    else:
        drawn, where = number, f"{name} {level.level_file}"
        given = f"--level-file {shlex.quote(str(level.level_file))}"
    reads = tuple(layers.split(",")) if layers else default_layers(player)
    check_layers(player, reads)
    check_free(out, PAGE, SIGN, ())
    check_writable(out / PAGE)
    # Probes do not learn from the level that they read.
    after = [one for one in config.unseen_levels[1 : others + 2] if one != number][:others]
    deviation = AgentFolder.of(player.path).deviation()
    told = np.array(after), config.gamma, config.lam, deviation
    lab = f"astray lab {shlex.quote(str(agent.name))} --variant {name} {given}"
    asked = Asked(player, levels, drawn, named, reads, *told, lab=lab)
    print(write(asked, out, f"{agent.name} in {game.name} {where}", progress=True))
