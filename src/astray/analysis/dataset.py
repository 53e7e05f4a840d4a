"""Data sets of trajectories, with states, from any policy.

dataset.json: what was played, and the layout of bytes. episodes.parquet: a row per episode with
level, return, length, terminated and every event. steps/00000.parquet, ...: a row per state with
level, step, observation, state, and what was done there: action, reward, terminated, truncated
(null in an episode's last state).

Minari's layout is data/main_data.hdf5, which its readers accept.
"""

import errno
import itertools
import json
import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import polars as pl
from gymnasium import spaces

from astray import imports, world
from astray.acting import Levels, Policy, check_policy, steps
from astray.analysis.tables import read_table, write_table
from astray.envs import VERSION
from astray.envs.steps import choices
from astray.envs.vector import GameVectorEnv, space_of
from astray.files import check_writable, new_folder, read, write_aside
from astray.game import Game, Variant
from astray.memory import check_memory
from astray.record import count_levels
from astray.validation import MOST, brief, of_kind, of_numbers, one_of, path_of, shown
from astray.world import World, WorldVariant

Format = Literal["parquet", "minari"]
FORMAT = 1  # version of dataset.json
PART = 64_000_000  # bytes of observations and states in a file of steps, or a little more
BATCH = 32  # episodes at once: of 500 steps and images they are 200 MB
LARGEST = 2**20  # bytes of dataset.json
A_STEP = 1000  # bytes of a step in memory, beside its observation
LOOKS = 4096  # steps in memory, after each so many of which it is looked whether they fit
SPARED = 2**20  # bytes of disk that HDF5 needs in addition; 0.7 MB were seen


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode of T steps.

    Attributes:
        observations: [T + 1, ...] uint8, including the final one.
        states: [T + 1] records, including the final one; "seed" and "turn", which only affect
            later levels, are 0.
    """

    level: int
    observations: np.ndarray
    states: np.ndarray
    actions: np.ndarray  # [T] int64
    rewards: np.ndarray  # [T] float64
    terminated: bool  # ended by the rules; otherwise truncated

    def __len__(self) -> int:
        return len(self.actions)


def trajectories(
    policy: Policy,
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    levels: Levels,
    *,
    batch: int = BATCH,
    longest: int | None = None,
) -> Iterator[Trajectory]:
    """Yield a policy's episode in each of `levels` as it ends, independent of the batch.

    Args:
        batch: Number of simultaneous episodes, which are in memory until they end.
        longest: Steps after which an episode is truncated; None for no limit.
    """
    parts: dict[int, list[tuple]] = {}
    played = game.in_every_step if isinstance(game, World) else game
    for step in steps(policy, played, variant, levels, batch=batch, longest=longest):
        of_numbers("what an environment shows in a data set", step.observations)
        count = sum(map(len, parts.values()))  # steps of episodes that go on
        if count % LOOKS < len(step.level):  # twice: an episode is put together in the end
            what = f"{count:,} steps of {len(parts)} episodes, which `longest` would truncate,"
            check_memory(2 * count * (step.observations[0].nbytes + A_STEP), what)
        for i, level in enumerate(step.level.tolist()):
            kept = step.observations[i].copy(), step.before[i].copy()
            done = np.array(step.actions[i]), float(step.rewards[i])
            parts.setdefault(level, []).append((*kept, *done))
            if not step.ended[i]:
                continue
            seen, before, actions, rewards = zip(*parts.pop(level), strict=True)
            states = np.array([*before, step.after[i]], step.before.dtype)
            for name in {"seed", "turn"} & {*(states.dtype.names or ())} if played is game else ():
                states[name] = 0  # belong to the batch; of a World, they are measures
            yield Trajectory(
                int(states["level"][0]),
                np.stack([*seen, step.seen[i]]),
                states,
                np.array(actions),
                np.array(rewards),
                bool(step.terminated[i]),
            )


def export(
    policy: Policy,
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    levels: Levels,
    folder: Path,
    *,
    form: Format = "parquet",
    batch: int = BATCH,
    longest: int | None = None,
) -> Path:
    """Play a policy in `levels`, write the data to a new folder, and return that folder.

    The folder appears only once it is complete.

    Args:
        longest: Steps after which an episode is truncated; None for no limit.

    Raises:
        ValueError: If `folder` exists, a level number occurs twice, or the game cannot be
            exported.
    """
    check_policy(policy)
    count_levels(levels)
    one_of("format", form, Format)
    _check_new(folder := path_of("folder", folder))
    game = world.find(game)
    given: Any = variant
    of: Any = game.variant(given)
    write = write_minari if form == "minari" else write_parquet
    is_world = isinstance(game, World)
    if is_world and form == "minari":
        raise ValueError(f"Minari's layout is of games; {game.name} is a World, for parquet alone")
    about = {
        "format": FORMAT, "astray": version("astray"), "levels_of": VERSION, "game": game.name,
        "variant": str(of) if is_world else asdict(of), "policy": policy.name,
        "observation": policy.observation, "art": policy.art,
        "actions": [] if is_world else list(game.actions), "events": list(game.events),
        "state": np.dtype(game.state.descr).descr,
    }  # fmt: skip
    check_writable(folder)  # before the work
    try:
        with new_folder(folder) as aside:
            played = trajectories(policy, game, of, levels, batch=batch, longest=longest)
            write(played, game, of, about, aside)
    except OSError:
        _check_new(folder)  # another export was sooner
        raise
    return folder


def _check_new(folder: Path) -> None:
    if os.path.lexists(folder):
        raise ValueError(f"a data set is written to a new folder; there is something at {folder}")


def write_parquet(
    played: Iterable[Trajectory],
    game: Game,
    variant: Variant,
    about: Mapping[str, Any],
    folder: Path,
) -> None:
    """Write trajectories as Parquet files; see the top of this module."""
    (folder / "steps").mkdir(parents=True)
    episodes, rows, size, files, shape, kind = [], [], 0, 0, None, "uint8"
    for one in played:
        kind = one.observations.dtype.name
        episodes.append(_episode(one, game))
        rows.append(_rows(one))
        shape, size = one.observations.shape[1:], size + one.observations.nbytes + one.states.nbytes
        if size >= PART:
            write_table(pl.concat(rows), folder / "steps" / f"{files:05}.parquet")
            rows, size, files = [], 0, files + 1
    if rows:
        write_table(pl.concat(rows), folder / "steps" / f"{files:05}.parquet")
    table = pl.DataFrame(episodes, schema_overrides=dict.fromkeys(game.events, pl.Int64))
    write_table(table.sort("level"), folder / "episodes.parquet")
    data = {**about, "shape": shape, "dtype": kind}
    write_aside(folder / "dataset.json", json.dumps(data, indent=1).encode())


def _episode(one: Trajectory, game: Game) -> dict[str, Any]:
    last, total = one.states[-1], float(one.rewards.sum())
    told = {"level": one.level, "return": total, "length": len(one), "terminated": one.terminated}
    return told | {event: int(last[event]) if last[event] >= 0 else None for event in game.events}


def _rows(one: Trajectory) -> pl.DataFrame:
    """Return a row for each state; action and results are null in the last one."""
    count, kind = len(one), pl.Float64() if one.actions.dtype.kind == "f" else pl.Int64()
    for _ in one.actions.shape[1:]:
        kind = pl.List(kind)
    return pl.DataFrame(
        {
            "level": pl.Series([one.level] * (count + 1), dtype=pl.Int64),
            "step": pl.Series(range(count + 1), dtype=pl.Int32),
            "action": pl.Series([*one.actions.tolist(), None], dtype=kind),
            "reward": pl.Series([*one.rewards.tolist(), None], dtype=pl.Float64),
            "terminated": [*_last(count, one.terminated), None],
            "truncated": [*_last(count, not one.terminated), None],
            "observation": [x.tobytes() for x in one.observations],
            "state": [x.tobytes() for x in one.states],
        }
    )


def read_trajectories(folder: Path, of: World | None = None) -> Iterator[Trajectory]:
    """Yield the trajectories that `export` wrote as Parquet, in the same order.

    For trajectories of a `World` that is not registered, `of` is that world.

    Raises:
        FileNotFoundError: If there is no data set.
        MemoryError: If it does not fit.
        ValueError: If the files are damaged, incomplete, of another version's states, or hold what
            `export` does not write.
    """
    folder = path_of("folder", folder)
    path = folder / "dataset.json"
    try:
        about = json.loads(read(path, LARGEST))
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise ValueError(f"it must be an object of format {FORMAT}; got {shown(about)}")
        game: Any = of or world.find(about["game"])
        if game.name != about["game"]:
            raise ValueError(f"it is of {shown(about['game'])}, not of {game.name!r}")
        if json.loads(json.dumps(np.dtype(game.state.descr).descr)) != about["state"]:
            raise ValueError("its states have other fields than those of this version")
        played = _played(game, about)
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no data set in {folder}") from None
    except (ValueError, KeyError, TypeError, RecursionError, SyntaxError) as error:  # of a dtype
        raise ValueError(f"{path} cannot be read as a data set: {brief(error)}") from error
    path = folder / "episodes.parquet"
    try:
        left = Counter(read_table(path, flat=True).rows())
        for path in sorted((folder / "steps").glob("[0-9]*.parquet")):
            table = read_table(path, flat=not isinstance(game, World))  # whose actions may be lists
            for one in _trajectories(table, game, *played):
                left[told := tuple(_episode(one, game).values())] -= 1
                if left[told] < 0:
                    raise ValueError(f"episodes.parquet has no such episode of level {one.level}")
                yield one
    except (ValueError, TypeError, IndexError, pl.exceptions.PolarsError) as error:
        raise ValueError(f"{path} is not as astray writes it: {brief(error)}") from error
    if missing := left.total():
        raise ValueError(f"{folder} lacks the steps of {missing} episodes")


def _played(
    game: Game, about: Mapping[str, Any]
) -> tuple[Variant | None, tuple[int, ...], np.dtype, Any]:
    """Return the variant of a data set, and its observations' shape, type and largest values.

    Raises:
        ValueError: If these are not the game's.
    """
    shape, kind = tuple(about["shape"]), np.dtype(about["dtype"])
    if isinstance(game, World):  # whose knobs are not written
        if kind.kind not in "biuf" or any(type(n) is not int or not 0 <= n <= MOST for n in shape):
            raise ValueError(f"its observations must be numbers; got {kind} of {shown(shape)}")
        return None, shape, kind, np.inf
    of_kind("variant", given := about["variant"], dict)
    makes = {type(one): one for one in game.variants.values()}
    make = next((kind for kind in makes if given.keys() == {f.name for f in fields(kind)}), None)
    if make is None:
        raise ValueError("its variant has other knobs than those of this version")
    variant = make(**given | {"shifted": given["shifted"] and make(**given["shifted"])})
    space = space_of(game, variant, about["observation"])
    if (shape, kind) != (space.shape, space.dtype):
        told = f"{space.dtype} of shape {space.shape}; got {kind} of {shown(shape)}"
        raise ValueError(f"its observations must be {told}")
    return variant, shape, kind, space.high


def _trajectories(
    rows: pl.DataFrame,
    game: Game,
    variant: Variant | None,
    shape: tuple[int, ...],
    kind: np.dtype,
    largest: Any,
) -> Iterator[Trajectory]:
    """Yield the episodes in a table of steps; raise ValueError for what `export` does not write."""
    states = np.frombuffer(b"".join(rows["state"]), game.state)
    seen = np.frombuffer(b"".join(rows["observation"]), kind).reshape(len(rows), *shape)
    if not (seen <= largest).all():  # nor is NaN
        raise ValueError("an observation has numbers that it cannot have")
    if variant is not None:
        game.check(states, variant)
    begins = np.flatnonzero(rows["step"].eq_missing(0))
    for begin, end in itertools.pairwise([0, *begins[1:].tolist(), len(rows)]):
        here, done = slice(begin, end), rows[begin : end - 1]
        actions, rewards = np.array(done["action"].to_list()), done["reward"].to_numpy()
        level, terminated = int(states["level"][begin]), bool(done["terminated"][-1])
        one = Trajectory(level, seen[here], states[here], actions, rewards, terminated)
        if not _rows(one).equals(rows[here]):
            raise ValueError("an episode must be a row for each state, in the columns of `export`")
        if not np.isfinite(rewards).all():
            raise ValueError("rewards must be finite")
        if variant is not None:
            choices("the data set", actions, len(one), spaces.Discrete(len(game.actions)))
        yield one


def write_minari(
    played: Iterable[Trajectory],
    game: Game,
    variant: Variant,
    about: Mapping[str, Any],
    folder: Path,
) -> None:
    """Write trajectories in Minari's exact layout, with states as infos and levels as seeds.

    Raises:
        ImportError: If minari is not installed.
        OSError: If the disk is full.
    """
    with imports.extra("minari", "Minari's layout needs it"):
        from minari.data_collector import EpisodeBuffer  # pyrefly: ignore
        from minari.dataset.minari_storage import MinariStorage  # pyrefly: ignore
    env = GameVectorEnv(game, variant, observation=about["observation"], art=about["art"])
    seen, taken = env.single_observation_space, env.single_action_space
    env.close()
    assert isinstance(taken, spaces.Discrete)
    _check_room(folder)
    name = next((n for n, other in game.variants.items() if other == variant), None)
    spec = gymnasium.registry.get(f"astray/{game.name}-{name}-{VERSION}")
    if spec:  # of the environment that shows what the data set has
        shown_as = {"observation": about["observation"], "art": about["art"]}
        spec = replace(spec, kwargs=spec.kwargs | shown_as)
    named = "".join(c if c.isalnum() else "-" for c in about["policy"])
    storage = MinariStorage.new(
        folder.absolute() / "data",
        observation_space=seen,
        action_space=taken,
        data_format="hdf5",
        env_spec=spec,
        jpeg_encoding=False,
    )
    storage.update_metadata(
        {
            "dataset_id": f"astray/{about['game']}/{named}-v0",
            "algorithm_name": about["policy"],
            "author": set(),
            "author_email": set(),
            "code_permalink": "",
            "description": json.dumps(about),
            "requirements": [],  # Minari tells to install them by a name that is not ours
            "minari_version": version("minari"),
        }
    )
    storage.update_episodes(
        EpisodeBuffer(
            id=k,
            seed=one.level,
            observations=one.observations,  # pyrefly: ignore
            actions=one.actions,  # pyrefly: ignore
            rewards=one.rewards.tolist(),
            terminations=_last(len(one), one.terminated),
            truncations=_last(len(one), not one.terminated),
            infos={"state": one.states.view(np.uint8).reshape(len(one) + 1, -1)},
        )
        for k, one in enumerate(_with_room(played, folder))
    )


def _with_room(played: Iterable[Trajectory], folder: Path) -> Iterator[Trajectory]:
    """Yield the trajectories as long as the disk has room for the next one."""
    for one in played:
        _check_room(folder, one.observations.nbytes + one.states.nbytes)
        yield one


def _check_room(folder: Path, size: int = 0) -> None:
    """Raise OSError unless the disk has room for so many bytes; HDF5 would end the process.

    In its chunks they take up to 1.6 times as much.
    """
    needed, free = SPARED + 2 * size, shutil.disk_usage(folder).free
    if free < needed:
        told = f"the next episode may take {needed / 1e6:.1f} MB, and {free / 1e6:.1f} are free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {told}", str(folder))


def _last(count: int, flag: bool) -> list[bool]:
    return [*[False] * (count - 1), flag]
