"""Effects of each action in given states."""

from collections.abc import Iterator
from hashlib import sha256

import numpy as np

from astray import games
from astray.acting import Answer, Onward
from astray.envs.beginnings import without_autoreset
from astray.envs.vector import quickest
from astray.game import Game, Variant


def outcomes(game: str | Game, variant: str | Variant, states: np.ndarray) -> np.ndarray:
    """Return the agent's centre after each action in `states` [N]: [N, A, 2], in cells.

    It comes from the rules, with the random numbers of the states.
    """
    found = games.find(game)
    return np.stack([found.places.centre(s) for s in _after(found, variant, states)], 1)


def _after(game: Game, variant: str | Variant, states: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the successors of `states` [N] for each action."""
    count = len(states)
    env = without_autoreset(game, variant, count, quickest(game))
    for action in range(len(game.actions)):
        onward = Onward(env, env.set_state(states))
        yield onward.step(0, 0, Answer(np.full(count, action))).after.copy()
    env.close()


def effects(game: str | Game, variant: str | Variant, states: np.ndarray) -> np.ndarray:
    """Return for `states` [N] and each action the first action with the same next state, [N, A].

    Some actions are always equivalent, and others in single states, such as two moves into walls.
    """
    found = games.find(game)
    first = np.empty((len(states), len(found.actions)), np.int64)
    seen: list[dict[bytes, int]] = [{} for _ in states]
    reals = [name for name in found.state.names or () if found.state[name].base.kind == "f"]
    for action, after in enumerate(_after(found, variant, states)):
        for name in reals:
            after[name] += 0  # -0 does what 0 does
        for k, s in enumerate(after):
            first[k, action] = seen[k].setdefault(sha256(s.tobytes()).digest(), action)
    return first
