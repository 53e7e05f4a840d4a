"""Dish mice trained on levels that a minimax-regret curriculum chooses."""

from astray.experiments.studies.mitigation import _regret as regret

# In the paper the dish is seen in six planes and the cheese in one. Here a plane is a 1, and the
# cheese two points on the unit circle, for its shape and its colour: a square of length 2.
PLANES = 12
EXPERIMENT = regret.experiment(
    "Minimax regret: cheese on a dish",
    "dish-small",
    "dish",
    {"dish_planes": PLANES},
    f"; the dish is seen in {PLANES} planes and the cheese as two points of length 1, where the "
    "paper has 6 planes and 1",
    # A mouse of 4 million steps at the preset's rate takes four fifths of the training's cheese.
    # One pass in minibatches of 2,048 at this rate takes half the time of the preset's three.
    steps=12_000_000,
    learning_rate=0.002,
    epochs=1,
    minibatches=8,
)
