"""The verb that exports episodes of policies as data sets."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from astray.analysis.dataset import Format
from astray.cli.arguments import NUMBERS, Longest, Player, level_numbers
from astray.training.settings import otherwise
from astray.validation import MOST, bounded


def export(
    player: Annotated[Player, arg(name="")] = Player(),
    levels: Annotated[
        str | None, otherwise("the first 1,000 that the training does not draw from", NUMBERS)
    ] = None,
    form: Format = "parquet",
    batch: int = 32,
    longest: Longest = None,
    out: Path = Path("dataset"),
) -> None:
    """Write the trajectories of a policy as a data set, in Parquet or in Minari's layout.

    Example: astray export maze-corner --levels 200000:200100 --out walks

    Args:
        form: Format of the data set: parquet or minari.
        batch: Number of episodes to play in parallel, each in memory until it ends.
        out: New folder for the data set.
    """
    from astray.analysis.dataset import export as write

    bounded("batch", batch, 1, MOST)
    policy, game, variant, config = player.open()
    player.acting.check_seen(policy)
    first = config.unseen_levels.start if config else 0
    numbers = level_numbers(f"{first}:{first + 1000}" if levels is None else levels)
    print(write(policy, game, variant, numbers, out, form=form, batch=batch, longest=longest))
