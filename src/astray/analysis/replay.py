"""What given actions do in one level."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from astray.envs.vector import GameVectorEnv
from astray.game import Game, Variant
from astray.level import Level


def replay(
    game: str | Game, variant: Variant, level: int | Level, actions: Sequence[int]
) -> dict[str, Any]:
    """Play `actions` until they or the episode end; what happened, as plain data.

    Positions are the agent's centre, in cells; events the step they first happened, -1 for never.
    """
    env = GameVectorEnv(game, variant, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": level})
    s, steps, total = env.states[0], [], 0.0
    told: dict[str, Any] = {"start": [float(s.x), float(s.y)]}
    told |= {"terminated": False, "truncated": False}
    for action in actions:
        _, reward, terminated, truncated, _ = env.step(np.array([action]))
        total += float(reward[0])
        steps.append({"action": env.game.actions[action], "x": float(s.x), "y": float(s.y),
                      "reward": float(reward[0])})  # fmt: skip
        told |= {"terminated": bool(terminated[0]), "truncated": bool(truncated[0])}
        if terminated[0] or truncated[0]:
            break
    events = {event: int(s[event]) for event in env.game.events}
    env.close()
    return told | {"return": total, "length": len(steps), "events": events, "steps": steps}
