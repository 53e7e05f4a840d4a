"""The variants that the original program was recorded with, by the recordings' names."""

from dataclasses import replace

from astray import games

MAZE, COINRUN, KEYS, HEIST = (
    games.find(game).variants for game in ("maze", "coinrun", "keys", "heist")
)
RECORDED = {
    "maze": MAZE["anywhere"],
    "maze_easy": MAZE["anywhere-easy"],
    "maze_fixed_size": MAZE["fixed-size"],
    "maze_corner": MAZE["corner"],
    "maze_yellow_line": MAZE["yellow-line"],
    "maze_red_line_yellow_gem": MAZE["red-line-yellow-gem"],
    "maze_yellow_star_red_gem": MAZE["yellow-star-red-gem"],
    "coinrun": COINRUN["coin-end"],
    "coinrun_aisc": COINRUN["coin-ledge-aisc"],
    "coinrun_easy": COINRUN["coin-end-easy"],
    "coinrun_permeable": COINRUN["coin-end-permeable"],
    "coinrun_permeable_continue": COINRUN["coin-end-permeable-continue"],
    "coinrun_random50": COINRUN["coin-half"],
    "coinrun_random100": COINRUN["coin-ledge"],
    "keys_many_chests": KEYS["many-chests"],
    "keys_many_chests_penalties": KEYS["many-chests-penalties"],
    "keys_many_keys": KEYS["many-keys"],
    "keys_many_keys_easy": KEYS["many-keys-easy"],
} | {f"maze_region{side}": replace(MAZE[f"region-{side}"], strict=True) for side in (1, 3, 8, 16)}
