"""Mice of the corner whose levels a curriculum of regret chooses."""

from astray.experiments.studies.mitigation import _regret as regret

EXPERIMENT = regret.experiment("Minimax regret", "corner-small", "corner", {})
