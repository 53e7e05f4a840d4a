"""Rooms drawn in text, and what happens in them."""

import numpy as np

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.level import Level


def scene(game, drawing, variant=None, **knobs):
    """An environment of a game, in which the room that is drawn has begun."""
    game = games.find(game)
    made = game.variant(variant or next(iter(game.variants))).with_knobs(knobs)
    env = GameVectorEnv(game, made, 1, observation="symbolic", autoreset_mode="Disabled")
    env.set_state(Level.from_text(game, made, drawing).state(solvable=False))
    return env


def room(side, *rows):
    """A drawing of a square room: these rows are its lowest, left in it; all else is empty."""
    rows = ["." * side] * (side - len(rows)) + [row.ljust(side, ".") for row in rows]
    return "\n".join(rows)


def play(env, actions):
    """The rewards of named actions, and whether the last ended the level."""
    rewards, terminated = [], [False]
    for name in actions.split():
        _, reward, terminated, _, _ = env.step(np.array([env.game.actions.index(name)]))
        rewards.append(float(reward[0]))
    return rewards, bool(terminated[0])


def walk(env, goal):
    """The actions of the script that walks to a goal, until it is reached or the level ends."""
    expert, event, taken = env.game.solver.expert(env.states[0], goal), env.game.event(goal), []
    while not env.states[0].ended and env.states[0][event] < 0:
        action = expert(env.states[0])
        taken.append(env.game.actions[action])
        env.step(np.array([action]))
    return " ".join(taken)
