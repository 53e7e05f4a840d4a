"""Corner mice trained on levels that a minimax-regret curriculum chooses."""

from astray.experiments.studies.mitigation import _regret as regret

EXPERIMENT = regret.experiment("Minimax regret", "corner-small", "corner", {}, steps=4_000_000)
