"""The verb that exports episodes of policies as data sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from astray import games
from astray.analysis.dataset import Format
from astray.bounds import MOST, bounded
from astray.cli.arguments import (
    NUMBERS,
    Acting,
    Knobs,
    Longest,
    OwnPolicy,
    TrainingVariant,
    level_numbers,
    pairs,
)
from astray.training.settings import otherwise

LEVELS = "0:1000"


def export(
    agent: Positional[
        Annotated[
            Path | None, otherwise("none", "Run folder, checkpoint in one, or name of an agent.")
        ]
    ] = None,
    variant: TrainingVariant = None,
    levels: Annotated[
        str | None, otherwise("the first 1,000 that the training does not draw from", NUMBERS)
    ] = None,
    knobs: Knobs = (),
    acting: Acting = Acting(),
    policy: OwnPolicy = OwnPolicy(),
    form: Format = "parquet",
    batch: int = 32,
    longest: Longest = None,
    out: Path = Path("dataset"),
) -> None:
    """Write trajectories of any policy as a data set: Parquet, or Minari's layout.

    Example: astray export maze-corner --levels 200000:200100 --out walks

    Args:
        form: Form of the data set: parquet or minari.
        batch: Number of episodes played at once, which are in memory until they end.
        out: New folder for the data set.
    """
    from astray.analysis.dataset import export as write

    bounded("batch", batch, 1, MOST)
    if policy.policy is None:
        policy.check_unused()
        if agent is None:
            raise ValueError("name an agent or a run folder, or give a --policy")
        player, config = acting.open(agent)
        played = config.find_game()
        of = config.played_variant(variant or config.variant, pairs(knobs))
        first = config.unseen_levels.start
        numbers = level_numbers(levels or f"{first}:{first + 1000}")
    elif agent or policy.world or policy.game is None or variant is None:
        raise ValueError("--policy needs --game and --variant, and no agent")
    else:
        played = games.find(policy.game)
        of = played.variant(variant).with_knobs(pairs(knobs))
        numbers = level_numbers(levels or LEVELS)
        player = policy.make(acting)
    print(write(player, played, of, numbers, out, form=form, batch=batch, longest=longest))
