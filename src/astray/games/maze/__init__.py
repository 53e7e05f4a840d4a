"""Maze: a mouse looks for its cheese; in training it lies in the upper right corner."""

from astray.game import Game
from astray.games.maze import draw, levels, original, rules, solve, variants

GAME = Game(
    name="maze",
    about="a mouse looks for its cheese in a maze",
    actions=rules.ACTIONS,
    state=rules.STATE,
    variants=variants.VARIANTS,
    shifts=variants.SHIFTS,
    events=rules.EVENTS,
    goals=variants.GOALS,
    benchmark="anywhere",
    envpool="MazeHard-v0",
    real_time=False,
    generate=levels.generate,
    step=rules.step,
    paint_planes=draw.paint_planes,
    draw_planes=draw.draw_planes,
    looks=draw.LOOKS | original.LOOKS,
    planes_scene_shape=draw.planes_scene_shape,
    planes=draw.planes,
    facts=levels.facts,
    legend=levels.LEGEND,
    objects=levels.OBJECTS,
    describe=levels.describe,
    build=levels.build,
    reachable=solve.reachable,
    guide=solve.guide,
    optimal_return=solve.optimal_return,
)
