"""Keys and Chests: a thief opens chests with keys; in training there are fewer keys than chests."""

from astray.game import Game
from astray.games.keys import draw, levels, original, rules, solve, variants

GAME = Game(
    name="keys",
    about="a thief takes keys in a maze and opens chests with them",
    actions=rules.ACTIONS,
    state=rules.STATE,
    variants=variants.VARIANTS,
    shifts=variants.SHIFTS,
    events=rules.EVENTS,
    goals=variants.GOALS,
    benchmark="many-chests",
    envpool="HeistHard-v0",
    real_time=True,
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
