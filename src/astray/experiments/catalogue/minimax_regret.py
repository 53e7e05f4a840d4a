"""Mice of the corner whose levels a curriculum of regret chooses."""

from astray.experiments import regret

EXPERIMENT = regret.experiment("Minimax regret", "corner-small", "corner")
