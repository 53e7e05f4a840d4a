"""The games as Gymnasium environments: ids like `astray/maze-corner-v0`."""

import gymnasium

from astray import games

VERSION = "v0"  # goes up when a level, a picture or a reward of the same number changes


def register() -> None:
    """Register every variant of every game; nothing is compiled by this."""
    for game in games.OWN:
        for variant in games.find(game).variants:
            gymnasium.register(
                f"astray/{game}-{variant}-{VERSION}",
                entry_point="astray.envs.single:GameEnv",
                vector_entry_point="astray.envs.vector:GameVectorEnv",
                kwargs={"game": game, "variant": variant},
            )
