"""CoinRun: a runner jumps over hazards to a coin; in training it lies at the end of the level."""

from astray.game import Game
from astray.games.coinrun import draw, levels, original, rules, solve, variants

GAME = Game(
    name="coinrun",
    about="a runner jumps over hazards to a coin",
    actions=rules.ACTIONS,
    state=rules.STATE,
    variants=variants.VARIANTS,
    shifts=variants.SHIFTS,
    events=rules.EVENTS,
    goals=variants.GOALS,
    benchmark="procgen",
    envpool="CoinrunHard-v0",
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
