"""Result files of others: tables in the original's metrics format, a row per episode.

The original's `run_coinrun.py` and its forks write one per agent, metrics_agent_seed_*.csv. Level
numbers relate them to episodes played here.
"""

import io
from pathlib import Path

import polars as pl

from astray.files import read
from astray.record import LEVELS

LARGEST = 512_000_000  # bytes
# What each of our columns may be called there: by the paper's program, and by its later fork.
NAMES = {
    "level": ("seed", "level_seed"),
    "length": ("steps",),
    "coin": ("coin_collected", "coin"),
    "end": ("inv_coin_collected", "inv_coin"),
    "died": ("died",),
    "timed_out": ("timed_out",),
}
LEFT = -1  # of what nobody knows, as the episode was left when it came to the end


def read_results(path: Path) -> pl.DataFrame:
    """Return a row per episode: level, length (steps), and booleans coin, end, died, timed_out.

    The column end means the end without the coin. The program leaves an episode at the invisible
    coin at the level's end, and writes -1 for unknown values.

    Raises:
        ValueError: If the file is not such a table.
    """
    try:
        table = pl.read_csv(io.BytesIO(read(path, LARGEST)), infer_schema_length=None)
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"{path} is not a table of results: {error}") from error
    found = {}
    for ours, theirs in NAMES.items():
        there = [name for name in theirs if name in table.columns]
        if not there:
            raise ValueError(
                f"{path} is not a table of results: it must have a column {' or '.join(theirs)}; "
                f"it has {', '.join(table.columns[:12])}"
            )
        found[ours] = table[there[0]]
        if not found[ours].dtype.is_integer() or found[ours].null_count():
            raise ValueError(f"{path}: column {there[0]} must hold integers alone")
    episodes = pl.DataFrame(found)
    if episodes.is_empty():
        raise ValueError(f"{path} holds no episodes")
    flags = list(NAMES)[2:]
    for name in flags:
        if not episodes[name].is_in([LEFT, 0, 1]).all():
            raise ValueError(f"{path}: {name} must be -1, 0 or 1 in every row")
    if episodes["level"].is_duplicated().any():
        raise ValueError(f"{path} has a level twice; each is to be one episode")
    first, last = episodes.select(pl.col("level").min(), pl.col("level").max().alias("last")).row(0)
    if first < LEVELS.start or last >= LEVELS.stop:
        raise ValueError(
            f"{path}: levels must be from 0 to {LEVELS.stop - 1}; they are from {first} to {last}"
        )
    return episodes.with_columns(
        *(pl.col(name) == 1 for name in ("coin", "died", "timed_out")),
        end=(pl.col("end") == 1) & (pl.col("coin") != 1),
    )
