"""The verb that explains an agent."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from astray.cli.arguments import GivenLevel, TestedPlayer
from astray.files import check_free, check_writable
from astray.training.folders import AgentFolder
from astray.training.settings import otherwise
from astray.validation import bounded, command_of

MOST_LEVELS = 10_000


def explain(
    player: Annotated[TestedPlayer, arg(name="")] = TestedPlayer(),
    level: GivenLevel = GivenLevel(),
    layers: Annotated[str | None, otherwise("three layers, including the last")] = None,
    others: int = 100,
    out: Path = Path("explained"),
) -> None:
    """Write a page that shows how a policy behaves in a level, and why.

    The page shows policy and value at every place, the effects of edits to the level, the parts
    that the value depends on, probes of the layers, the evidence for each goal, and the episode
    step by step. By default the level is the first unseen one that distinguishes the goals. For a
    policy without a network, the parts that need one say so.

    Example: astray explain maze-corner

    Args:
        layers: Layers that probes read, separated by commas.
        others: Number of levels to fit the probes on.
        out: Folder for explain.html with its figures and tables.
    """
    from astray.acting import initial_states
    from astray.analysis.outcomes import load_shift
    from astray.analysis.runs import rehearse
    from astray.analysis.trained import Agent, looked_into
    from astray.insight.activations import check_layers
    from astray.insight.explain import PAGE, SIGN, Asked, default_layers, written
    from astray.insight.explain import explain as write
    from astray.lab.goals import first_distinguishing
    from astray.level import Level

    bounded("others", others, 2, MOST_LEVELS)
    level.check()
    player.policy.check_game("explain")
    policy, game, name, levels, named, config = player.open()
    agent = looked_into(policy, game)
    reads = tuple(layers.split(",")) if layers else default_layers(agent)
    if reads:
        check_layers(agent, reads)  # pyright: ignore[reportArgumentType]
    check_free(out, PAGE, SIGN, written(game))
    check_writable(out / PAGE)
    rehearse([policy], game, levels, [0])
    unseen = config.unseen_levels if config else range(MOST_LEVELS + 2)
    number = level.find(game, levels)
    if number is None:
        first, shift = int(unseen[0]), load_shift(game, named)
        number = first_distinguishing(game, levels, shift, first, agent)
    if not isinstance(number, Level):
        drawn = Level.of(game, levels, initial_states(game, levels, [number])[0])
        where, given = f"{name} level {number}", f"--level {number}"
    else:
        drawn, where = number, f"{name} {level.level_file}"
        given = f"--level-file {command_of(str(level.level_file))}"
    # Probes do not learn from the level that they read.
    after = [one for one in unseen[1 : others + 2] if one != number][:others]
    told: dict[str, Any] = {"lab": f"astray lab {player.words} --variant {name} {given}"}
    if config and isinstance(agent, Agent):
        deviation = AgentFolder.of(agent.path).deviation()
        told |= {"gamma": config.gamma, "lam": config.lam, "deviation": deviation}
    asked = Asked(agent, levels, drawn, named, reads, np.array(after), **told)
    who = player.agent.name if player.agent else policy.name
    print(write(asked, out, f"{who} in {game.name} {where}", progress=True))
