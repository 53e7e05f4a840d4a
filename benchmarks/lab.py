"""Time of the lab's answer to an edit: until its first arrows, and until its last.

From the message of an edited level to the parts of the answer, in this process, without browser and
socket. The network that sees images is the paper's, untrained: it computes as a trained one does.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import ClassVar

from astray.agents.policy import Architecture, weights
from astray.lab.serving import make_lab
from astray.lab.session import Session
from astray.training import checkpoint, folders
from benchmarks.tables import decimal

IMPALA = "the paper's network"
# what: agent, game, variant, milliseconds that the last arrow may take
EDITS = {
    "maze of 7 cells": ("maze-corner", "maze", "anywhere-small", 100),
    "maze of 25 cells, images": (IMPALA, "maze", "fixed-size", 1500),
    "CoinRun": ("coin-end", "coinrun", "coin-anywhere", 300),
    "Keys and Chests, 7 cells": ("many-chests", "keys", "many-keys-small", 100),
}


@dataclass(frozen=True)
class Row:
    """One kind of edit."""

    title: ClassVar[str] = "The lab: from an edit to its arrows"
    what: str
    places: int
    first: float  # milliseconds until the first arrows, median
    last: float  # until the last ones
    limit: float  # that the last ones are to keep

    def cells(self) -> dict[str, str]:
        return {
            "an edit in": self.what,
            "places": f"{self.places:,}",
            "first arrows, ms": decimal(self.first),
            "all, ms": decimal(self.last),
            "to be under, ms": f"{self.limit:,}",
        }


def measure(rounds: int = 9) -> list[Row]:
    """Measure every kind of edit in levels 0, 1, ..., one after the other."""
    with tempfile.TemporaryDirectory() as folder:
        run = untrained(Path(folder) / "run")
        lab = make_lab(run, {})
        return [
            _measured(
                Session(lab),
                what,
                (str(run) if agent == IMPALA else agent, game, variant),
                limit,
                rounds,
            )
            for what, (agent, game, variant, limit) in EDITS.items()
        ]


def untrained(folder: Path) -> Path:
    """A run folder with the paper's network for mazes, as it is before training."""
    config = replace(
        checkpoint.read_config(folders.find("maze-corner")), observation="image", network="impala"
    )
    architecture = Architecture("impala", (64, 64, 3), (), len(config.find_game().actions))
    path = folder / "checkpoints" / "1" / checkpoint.AGENT
    path.parent.mkdir(parents=True)
    path.write_bytes(weights(architecture.build(), architecture, config.game))
    (folder / "config.json").write_text(json.dumps({"config": config.to_json()}))
    return folder


def _measured(
    session: Session, what: str, where: tuple[str, str, str], limit: float, rounds: int
) -> Row:
    agent, game, variant = where
    first, last, places = [], [], []
    for number in range(-1, rounds):  # of which the first is compiled, and not counted
        common = {"id": 1, "game": game, "variant": variant}
        begun = [*session.answers(json.dumps(common | {"kind": "level", "level": max(number, 0)}))]
        told = begun[-1]["level"]
        level = {name: told[name] for name in ("grid", "agent", "looks")}
        question = common | {"level": level, "agent": agent}
        start = time.perf_counter()
        for _ in session.answers(json.dumps(question | {"kind": "level"})):
            pass
        times, count = [], 0
        for part in session.answers(json.dumps(question | {"kind": "fields"})):
            if "error" in part:
                raise ValueError(part["error"])
            times.append(1000 * (time.perf_counter() - start))
            count += len(part["cells"])
        if number >= 0:
            first.append(times[0])
            last.append(times[-1])
            places.append(count)
    return Row(what, round(median(places)), median(first), median(last), limit)
