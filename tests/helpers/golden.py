"""Digests of levels, observations and episodes: the same everywhere, and in every way to run.

In the folder `tests`:

    python -m helpers.golden            compare with what games keep; exit with 1 where any differs
    python -m helpers.golden --write    write it anew, after a change that is meant

The first takes --batch, --threads and --steps. Without compiled code it takes long:

    NUMBA_DISABLE_JIT=1 python -m helpers.golden --steps 100
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from astray import games
from astray.envs.vector import GameVectorEnv
from helpers.cases import SHAPES

LEVELS = {"levels": 100, "images": 10, "symbols": 10}  # how many of each are digested
STEPS = (10, 100, 1000)  # after which an episode's digest so far is told
SEED, PLAYED = 7, (0, 6)  # of the batch, and which of its environments are looked at


def golden(
    game: str,
    variant: str,
    *,
    batch: int = 7,
    threads: int = 1,
    steps: int = 1000,
    levels: Mapping[str, int] = LEVELS,
) -> dict:
    """The digests of a variant by name; those of episodes up to `steps`."""
    found = {}
    for observation in ("symbolic", "image"):
        env = GameVectorEnv(game, variant, batch, observation=observation, threads=threads)
        found |= _of_levels(env, levels) | _of_episodes(env, steps)
        env.close()
    return found


def _of_levels(env: GameVectorEnv, counts: Mapping[str, int]) -> dict[str, str]:
    """Of levels as data, with symbols; and of what is seen at their beginning."""
    seen = "symbols" if env.symbolic else "images"
    digests = {name: hashlib.sha256() for name in ("levels", seen)}
    count = counts["levels"] if env.symbolic else counts[seen]
    for first in range(0, count, env.num_envs):
        numbers = np.arange(first, first + env.num_envs)
        observations, _ = env.reset(seed=0, options={"level": numbers})
        for number, s, observation in zip(numbers, env.states, observations, strict=True):
            if number < counts[seen]:
                digests[seen].update(observation.tobytes())
            if env.symbolic and number < count:
                digests["levels"].update(json.dumps(env.game.editing.describe(s)).encode())
    told = digests if env.symbolic else {seen: digests[seen]}
    return {name: digest.hexdigest()[:16] for name, digest in told.items()}


def _of_episodes(env: GameVectorEnv, steps: int) -> dict[str, str]:
    """Of all that two environments show and tell, level after level; batch by batch if small."""
    found = {}
    for i in PLAYED:
        if i >= env.num_envs:
            found |= _of_batch(env, SEED + i, {0: i}, steps)
    return found | _of_batch(env, SEED, {i: i for i in PLAYED if i < env.num_envs}, steps)


def _of_batch(env: GameVectorEnv, seed: int, names: dict[int, int], steps: int) -> dict[str, str]:
    # Environment i of a batch seeded with k is environment 0 of one seeded with k + i.
    kind = "symbolic" if env.symbolic else "image"
    env.reset(seed=seed)
    first = seed - SEED
    actions = np.stack(
        [
            np.random.default_rng(first + i).integers(len(env.game.actions), size=steps)
            for i in range(env.num_envs)
        ]
    )
    digests, found = {i: hashlib.sha256() for i in names}, {}
    fields = ("level", "shifted", "time", *env.game.events)
    for t in range(steps):
        observation, reward, terminated, truncated, _ = env.step(actions[:, t])
        states = np.asarray(env.states)  # a plain array, whose fields are at hand sooner
        told = np.stack([terminated, truncated, *(states[name] for name in fields)], axis=1)
        for i, digest in digests.items():
            digest.update(observation[i].tobytes() + reward[i].tobytes())
            digest.update(told[i].astype(np.int64).tobytes())
            if t + 1 in STEPS:
                found[f"{kind} {names[i]} after {t + 1}"] = digest.hexdigest()[:16]
    return found


def over_an_end(game: str) -> str:
    """Digest of states, too, of two environments of a game while time ends their episodes."""
    digest = hashlib.sha256()
    for observation in ("image", "symbolic"):
        env = GameVectorEnv(
            game,
            games.find(game).benchmark.variant,
            2,
            observation=observation,
            autoreset_mode="SameStep",
            levels=range(50),
        )
        digest.update(env.reset(seed=0)[0].tobytes())
        states = env.get_state()
        states["time"] = states["time_limit"] - [2, 4]
        env.set_state(states)
        for action in np.random.default_rng(0).integers(len(env.game.actions), size=(7, 2)):
            seen, reward, *_ = env.step(action)
            digest.update(seen.tobytes() + reward.tobytes() + env.states.tobytes())
        env.close()
    return digest.hexdigest()[:16]


def few_of_all() -> dict[str, list]:
    """Return digests of an end of each game, and of few levels, pictures and steps of two shapes.

    Without compiled code, they take seconds, and all digests many minutes.
    """
    few = {"levels": 10, "images": 2, "symbols": 2}
    found: dict[str, list] = {game: [over_an_end(game)] for game in games.OWN}
    for game, variant in SHAPES:
        if len(found[game]) < 3:
            found[game].append(golden(game, variant, batch=1, steps=10, levels=few))
    return found


def file(game: str) -> Path:
    """Where a game keeps its digests: in its own folder, by variant."""
    return Path(games.__file__).parent / game / "tests" / "golden.json"


def kept(game: str) -> dict[str, dict[str, str]]:
    """The digests that a game keeps, by variant."""
    return json.loads(file(game).read_text())


def differing(game: str, found: dict[str, dict[str, str]]) -> list[str]:
    """What differs from what the game keeps, among what was found of its variants."""
    there = kept(game)
    return [
        f"{game} {variant}: {name}"
        for variant, digests in found.items()
        for name, digest in digests.items()
        if there.get(variant, {}).get(name) != digest
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    for name, default in (("batch", 7), ("threads", 1), ("steps", STEPS[-1])):
        parser.add_argument(f"--{name}", type=int, default=default)
    how = vars(parser.parse_args())
    write, wrong, count = how.pop("write"), [], 0
    for game in games.OWN:
        found = {variant: golden(game, variant, **how) for variant in games.find(game).variants}
        if write:
            file(game).write_text(json.dumps(found, indent=1) + "\n")
        wrong += differing(game, found)
        count += sum(map(len, found.values()))
    print("\n".join(wrong) or f"all {count} digests agree")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
