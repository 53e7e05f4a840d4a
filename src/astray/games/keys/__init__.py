"""Keys and Chests: a thief opens chests with keys, which are scarcer than chests in training."""

from astray.game import Benchmark, Game
from astray.games.keys import draw, levels, measures, original, rules, solve, variants
from astray.kernel.thief import of_variant
from astray.places import Placement

GAME = Game(
    "keys",
    "a thief takes keys in a maze and opens chests with them",
    rules,
    levels,
    draw.LOOKS | original.LOOKS,
    variants.VARIANTS,
    variants.GOALS,
    variants.SHIFTS,
    symbols=draw,
    editing=levels,
    solver=solve,
    places=Placement(levels, solve, vx=0, vy=0),
    benchmark=Benchmark("many-chests", envpool="HeistHard-v0"),
    invariants=lambda states, variant: levels.truths(states) | of_variant(states, variant),
    labels=measures.LABELS,
    real_time=True,
)
