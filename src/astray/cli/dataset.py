"""The verb that writes what policies do as data sets for others."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from astray import games, imports
from astray.analysis.dataset import Format
from astray.bounds import MOST, bounded
from astray.cli.arguments import Knobs, Mode, chosen, level_numbers, pairs, see_of_policy
from astray.game import OWN

LEVELS = "0:1000"
WALK = "walk:"


def export(
    run: Positional[Path | None] = None,
    agent: str | None = None,
    policy: str | None = None,
    game: str | None = None,
    observation: Literal["image", "symbolic"] | None = None,
    variant: str | None = None,
    levels: str | None = None,
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: Knobs = (),
    form: Format = "parquet",
    batch: int = 32,
    out: Path = Path("dataset"),
) -> None:
    """Write trajectories of any policy as a data set: Parquet, or Minari's layout.

    Args:
        run: a run folder or a checkpoint in it, or a name as `astray list` has them
        agent: instead, the name of a kept or imported one
        policy: instead, random, walk:GOAL, or a function of your own, module:function, of
            observations [N, ...] that returns actions [N]; needs --game and --variant
        game: that the policy plays
        observation: that the policy is shown, and that is written; by default images
        variant: of the levels; by default that of the training
        levels: numbers and ranges, as 5,17,100:200; by default the first 1,000 that the training
            does not draw from
        mode: draw from the agent's policy, or take the likeliest action
        art: that images are drawn with, own or original; by default what it was trained on
        knobs: of the variant, changed
        form: parquet or minari
        batch: episodes at once, which are in memory until they end
        out: a new folder
    """
    from astray.analysis.adapters import Function
    from astray.analysis.dataset import export as write
    from astray.analysis.policies import Random, Walk
    from astray.analysis.runs import open_run

    bounded("batch", batch, 1, MOST)
    if policy is None:
        see_of_policy(game, observation)
        player, config = open_run(chosen((run,) if run else (), agent)[0], mode, art)
        played, of = config.find_game(), config.variant_for(variant or config.variant, pairs(knobs))
        first = config.unseen_levels.start
        numbers = level_numbers(levels or f"{first}:{first + 1000}")
    elif run or agent or game is None or variant is None:
        raise ValueError("--policy needs --game and --variant, and neither a run nor --agent")
    else:
        played = games.find(game)
        of = played.variant(variant).with_knobs(pairs(knobs))
        numbers = level_numbers(levels or LEVELS)
        seen, shown = observation or "image", art or OWN
        if policy == "random":
            player = Random(observation=seen, art=shown)
        elif policy.startswith(WALK):
            player = Walk(policy.removeprefix(WALK), seen, shown)
        else:
            player = Function(imports.find(policy), policy, seen, shown)
    print(write(player, played, of, numbers, out, form=form, batch=batch))
