"""Mice whose cheese lay on a dish, with levels that a curriculum of regret chooses."""

from astray.experiments.studies.mitigation import _regret as regret

# Six for each that shows the cheese, as in the paper: shape and colour are two numbers each.
PLANES = 24
EXPERIMENT = regret.experiment(
    "Minimax regret: cheese on a dish",
    "dish-small",
    "dish",
    {"dish_planes": PLANES},
    f"; the dish is seen in {PLANES} planes and the cheese in 4, where the paper has 6 and 1",
)
