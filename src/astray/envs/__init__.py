"""The games as Gymnasium environments, with ids such as `astray/maze-corner-v0`."""

import gymnasium

from astray import games, world
from astray.game import Game
from astray.world import World

VERSION = "v0"  # goes up when a level, a picture or a reward of the same number changes


def register(game: Game | World) -> None:
    """Register a game of your own in this process, by its name and by Gymnasium ids.

    A `World` is registered by its name alone. `games.register` also describes how a package
    offers its games to all processes.

    Examples:
        >>> from dataclasses import replace
        >>> astray.register(replace(astray.games.find("maze"), name="my_maze"))
        >>> env = gymnasium.make("astray/my_maze-corner-v0")

    Raises:
        ValueError: If the name is that of one of astray's own games.
    """
    if isinstance(game, World):
        world.register(game)
        return
    games.register(game)
    _register_ids(game)


def register_own() -> None:
    """Register every variant of astray's own games, without compiling anything."""
    for name in games.OWN:
        _register_ids(games.find(name))


def _register_ids(game: Game) -> None:
    # Registered again, a game takes its own place.
    before = [n for n, spec in gymnasium.registry.items() if spec.kwargs.get("game") == game.name]
    for name in before:
        if name.startswith("astray/"):
            gymnasium.registry.pop(name)
    for variant in game.variants:
        name = f"astray/{game.name}-{variant}-{VERSION}"
        gymnasium.register(
            name,
            entry_point="astray.envs.single:GameEnv",
            vector_entry_point="astray.envs.vector:GameVectorEnv",
            kwargs={"game": game.name, "variant": variant},
        )
