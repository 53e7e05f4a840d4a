"""Keys and Chests: a thief opens chests with keys, which are scarcer than chests in training."""

from astray.game import Benchmark, Game
from astray.games.keys import draw, levels, measures, original, places, rules, solve, variants

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
    places=places,
    benchmark=Benchmark("many-chests", envpool="HeistHard-v0"),
    invariants=levels.invariants,
    labels=measures.LABELS,
    real_time=True,
)
