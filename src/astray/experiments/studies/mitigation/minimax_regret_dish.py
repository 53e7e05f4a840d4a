"""Mice whose cheese lay on a dish, with levels that a curriculum of regret chooses."""

from astray.experiments.studies.mitigation import _regret as regret

EXPERIMENT = regret.experiment("Minimax regret: cheese on a dish", "dish-small", "dish")
