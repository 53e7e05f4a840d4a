"""Replay of given actions in one level."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from astray import games
from astray.acting import Answer, Turn, initial_states, steps
from astray.envs.vector import Observation
from astray.game import OWN, Game, Variant
from astray.level import Level


@dataclass(frozen=True)
class Script:
    """Policy that takes the given actions in one episode, whatever it observes."""

    taken: Sequence[int]
    name: str = "script"
    observation: Observation = "symbolic"
    art: str = OWN

    def actions(self, turn: Turn) -> Answer:
        return Answer(np.array([self.taken[turn.env.states["time"][0]]]))


def replay(
    game: str | Game, variant: Variant, level: int | Level, actions: Sequence[int]
) -> dict[str, Any]:
    """Play `actions` until they or the episode end; return the record as plain data.

    Positions are the agent's centre in cells. Events are the steps at which they first happened,
    or -1.
    """
    game, chosen = games.find(game), {"": level} if isinstance(level, Level) else [level]
    s = initial_states(game, variant, chosen)[0]
    start, moves, total = game.editing.centre(s), [], 0.0
    ended = {"terminated": False, "truncated": False}
    policy, longest = Script(actions), len(actions) + 1  # never reached
    played = steps(policy, game, variant, chosen, longest=longest)
    for step in islice(played, len(actions)):
        s, reward = step.after[0].copy(), float(step.rewards[0])
        total += reward
        x, y = game.editing.centre(s)
        action = game.actions[step.actions[0]]
        moves.append({"action": action, "x": x, "y": y, "reward": reward})
        terminated = bool(step.terminated[0])
        ended = {"terminated": terminated, "truncated": bool(step.ended[0]) and not terminated}
    events = {event: int(s[event]) for event in game.events}
    told = {"return": total, "length": len(moves), "events": events, "steps": moves}
    return {"start": start} | ended | told
