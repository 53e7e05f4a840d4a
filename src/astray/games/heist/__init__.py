"""Heist: a thief looks for a gem behind coloured doors, which keys of their colours open."""

from astray.game import Benchmark, Game
from astray.games.heist import draw, levels, measures, original, rules, solve, variants
from astray.kernel.thief import of_variant
from astray.places import Placement

GAME = Game(
    "heist",
    "a thief gets at a gem, through doors of three colours that keys of their colours open",
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
    benchmark=Benchmark("hard", envpool="HeistHard-v0"),
    invariants=lambda states, variant: levels.truths(states) | of_variant(states, variant),
    labels=measures.LABELS,
    real_time=True,
)
