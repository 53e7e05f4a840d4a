"""Maze: a mouse searches for its cheese, which in training is in the upper right corner."""

from astray.game import Benchmark, Game
from astray.games.maze import draw, levels, measures, mutate, original, rules, solve, variants
from astray.places import Placement

GAME = Game(
    "maze",
    "a mouse looks for its cheese in a maze",
    rules,
    levels,
    draw.LOOKS | original.LOOKS,
    variants.VARIANTS,
    variants.GOALS,
    variants.SHIFTS,
    symbols=draw,
    editing=levels,
    solver=solve,
    mutation=mutate,
    places=Placement(levels, solve),
    cells=solve,
    benchmark=Benchmark("anywhere", envpool="MazeHard-v0"),
    invariants=levels.invariants,
    labels=measures.LABELS,
    features=measures.features,
)
