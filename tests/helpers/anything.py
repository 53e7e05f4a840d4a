"""Anything at all, for everything that takes something; and how much of it is tried.

ASTRAY_FUZZ multiplies how much is tried; `make fuzz` sets it, and counts in ASTRAY_FUZZ_LOG.
"""

import os
from dataclasses import replace

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.level import Level
from astray.training.config import PRESETS

MORE = int(os.environ.get("ASTRAY_FUZZ", "1"))
QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck), "database": None}
GAMES = list(games.OWN)
SMALLEST = {
    name: min(
        games.find(name).variants.values(), key=lambda v: games.find(name).symbols.planes(v).size
    )
    for name in GAMES
}


def tries(examples):
    """Settings for so many examples of an input each, and MORE times as many."""
    return settings(max_examples=examples * MORE, **QUIET)


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda part: (
        st.lists(part, max_size=3) | st.dictionaries(st.text(max_size=5), part, max_size=3)
    ),
    max_leaves=5,
)


CONFIG = replace(
    PRESETS["small"], variant="corner-small", num_envs=2, num_steps=4, minibatches=2, width=8
)


COUNTS: dict[str, list[int]] = {}  # of inputs tried, and of those refused, by kind


def tried(kind, refused, inputs=1):
    """Count inputs of a kind, and how many of them were refused."""
    counts = COUNTS.setdefault(kind, [0, 0])
    counts[0] += inputs
    counts[1] += refused


LEVELS: dict = {}


def beginning(game, number):
    """Level `number` of the game's smallest variant."""
    if (game, number) not in LEVELS:
        env = GameVectorEnv(game, SMALLEST[game], observation="symbolic")
        env.reset(seed=0, options={"level": number})
        LEVELS[game, number] = Level.of(env.game, env.variant, env.states[0])
    return LEVELS[game, number]


def changed(data, content):
    """`content` cut, or with some bytes changed, or something else; or as it was."""
    how = data.draw(st.sampled_from(["cut", "change", "other", "none"]))
    if how == "none":
        return content
    if how == "cut":
        return content[: data.draw(st.integers(0, len(content)))]
    if how == "other":
        return data.draw(st.binary(max_size=100))
    ruin = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        last = min(len(ruin), data.draw(st.sampled_from([8, 400, len(ruin)])))
        ruin[data.draw(st.integers(0, last - 1))] = data.draw(st.integers(0, 255))
    return bytes(ruin)
