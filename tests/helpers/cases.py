"""Variants that tests are made for, and where recordings of the original are."""

from pathlib import Path

from astray import games

REFERENCE = Path(__file__).parents[1] / "reference"
ALL = [(game, variant) for game in games.OWN for variant in games.find(game).variants]
# A variant for each shape of world and each kind of placement: for tests that are slow.
FEW = [(g, v) for g, v in ALL if "region" not in v or v in ("region-3", "region-1-strict")]
