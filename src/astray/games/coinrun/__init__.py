"""CoinRun: a runner jumps over hazards to a coin, which in training is at the end of the level."""

from astray.game import Benchmark, Game
from astray.games.coinrun import cells, draw, levels, measures, original, rules, solve, variants
from astray.places import Placement

GAME = Game(
    "coinrun",
    "a runner jumps over hazards to a coin",
    rules,
    levels,
    draw.LOOKS | original.LOOKS,
    variants.VARIANTS,
    variants.GOALS,
    variants.SHIFTS,
    symbols=draw,
    editing=cells,
    solver=solve,
    ends=variants.ENDS,
    places=Placement(
        cells, solve, (float(rules.HALF), float(rules.TALL)), vx=0, vy=0, on_crate=False
    ),
    benchmark=Benchmark("procgen", envpool="CoinrunHard-v0"),
    invariants=lambda states, variant: cells.truths(states),
    labels=measures.LABELS,
    real_time=True,
)
