"""Trajectories in files: what is read is what was played."""

import json
import struct
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

import astray
from astray import memory
from astray.analysis import dataset
from astray.analysis.policies import Random
from astray.analysis.tables import read_table, write_table
from astray.analysis.video import play
from astray.envs.vector import GameVectorEnv
from helpers import killed

LEVELS = range(10**6, 10**6 + 12)
SYMBOLS = Random(observation="symbolic")


@pytest.fixture(scope="module")
def mouse():
    return astray.load_agent("maze-corner")


def test_a_trajectory_is_the_episode_that_is_played_alone(mouse):
    for one in dataset.trajectories(mouse, "maze", "anywhere-small", LEVELS[:4], batch=3):
        alone = play(mouse, "maze", "anywhere-small", one.level)
        assert np.array_equal(one.observations, alone.observations)
        alone.states["seed"] = alone.states["turn"] = 0  # which decide on other episodes
        assert np.array_equal(one.states, alone.states)
        assert np.array_equal(one.rewards, alone.rewards) and one.terminated == alone.terminated


def test_what_a_function_does_to_its_observations_is_not_what_was_seen():
    def blind(seen):
        seen[:] = 0
        return np.full(len(seen), 7)

    here = ("maze", "anywhere-small", LEVELS[:1])
    (one,) = dataset.trajectories(astray.Function(blind), *here, longest=3)
    (seen,), _ = GameVectorEnv(*here[:2]).reset(options={"level": LEVELS[0]})
    assert np.array_equal(one.observations[0], seen)


def test_what_is_read_is_what_was_written(mouse, tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "PART", 40_000)  # bytes: several files
    folder = dataset.export(mouse, "maze", "anywhere-small", LEVELS, tmp_path / "set")
    assert len(list((folder / "steps").iterdir())) > 1
    played = {t.level: t for t in dataset.trajectories(mouse, "maze", "anywhere-small", LEVELS)}
    again = {t.level: t for t in dataset.read_trajectories(folder)}
    assert again.keys() == played.keys() == set(LEVELS)
    for level, one in played.items():
        for name, value in vars(one).items():
            assert np.array_equal(getattr(again[level], name), value), name


def test_a_folders_name_is_no_pattern_and_a_part_that_is_none_is_refused(mouse, tmp_path):
    folder = dataset.export(mouse, "maze", "anywhere-small", LEVELS[:2], tmp_path / "a[bc]")
    assert len(list(dataset.read_trajectories(folder))) == 2
    (folder / "steps" / "00000.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(ValueError, match=r"00000\.parquet is not as astray writes it"):
        list(dataset.read_trajectories(folder))


def test_episodes_are_those_of_an_evaluation(mouse, tmp_path):
    folder = dataset.export(mouse, "maze", "anywhere-small", LEVELS, tmp_path / "set")
    episodes = pl.read_parquet(folder / "episodes.parquet")
    wanted = astray.evaluate(mouse, "maze", "anywhere-small", LEVELS)
    assert episodes.equals(wanted.select(episodes.columns))


def test_a_state_of_a_data_set_goes_on(mouse, tmp_path):
    folder = dataset.export(mouse, "maze", "anywhere-small", LEVELS[:1], tmp_path / "set")
    one = next(dataset.read_trajectories(folder))
    env = GameVectorEnv("maze", "anywhere-small", observation="symbolic", autoreset_mode="Disabled")
    middle = len(one) // 2
    assert np.array_equal(
        env.set_state(one.states[middle : middle + 1])[0], one.observations[middle]
    )
    seen, reward, *_ = env.step(one.actions[middle : middle + 1])
    assert np.array_equal(seen[0], one.observations[middle + 1])
    assert reward[0] == one.rewards[middle]


def test_images_are_written_to_the_byte(tmp_path):
    folder = dataset.export(
        Random(observation="image"), "coinrun", "coin-end-calm", [3], tmp_path / "set"
    )
    about = json.loads((folder / "dataset.json").read_text())
    assert about["shape"] == [64, 64, 3] and about["actions"][4] == "stay"
    one = next(dataset.read_trajectories(folder))
    env = GameVectorEnv("coinrun", "coin-end-calm", autoreset_mode="Disabled")
    assert np.array_equal(env.reset(seed=0, options={"level": 3})[0], one.observations[:1])


@pytest.mark.skipif(not find_spec("minari"), reason="minari is not installed")
def test_a_full_disk_is_told_before_hdf5_meets_it(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset.shutil, "disk_usage", lambda _: SimpleNamespace(free=10**6))
    with pytest.raises(OSError, match=r"may take 1.0 MB, and 1.0 are free: .*set'$"):
        dataset.export(SYMBOLS, "maze", "corner-small", LEVELS, tmp_path / "set", form="minari")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(dataset.shutil, "disk_usage", lambda _: SimpleNamespace(free=4 * 10**6))
    dataset.export(SYMBOLS, "maze", "corner-small", [0], tmp_path / "set", form="minari")


@pytest.mark.skipif(not find_spec("minari"), reason="minari is not installed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_minari_reads_its_layout(mouse, tmp_path, monkeypatch):
    from minari import MinariDataset

    monkeypatch.chdir(tmp_path)  # Minari takes a path that is not absolute for another
    folder = dataset.export(mouse, "maze", "anywhere-small", LEVELS, Path("set"), form="minari")
    theirs = MinariDataset(folder / "data")
    assert theirs.storage.metadata["requirements"] == []  # the index's astray is not ours
    assert theirs.total_episodes == len(LEVELS)
    played = {t.level: t for t in dataset.trajectories(mouse, "maze", "anywhere-small", LEVELS)}
    assert theirs.total_steps == sum(map(len, played.values()))
    levels = [m["seed"] for m in theirs.storage.get_episode_metadata(range(len(LEVELS)))]
    for episode, level in zip(theirs.iterate_episodes(), levels, strict=True):
        one = played[int(level)]
        assert np.array_equal(episode.observations, one.observations)
        assert np.array_equal(episode.actions, one.actions)
        assert np.array_equal(episode.rewards, one.rewards)
        assert (episode.terminations[-1], episode.truncations[-1]) == (
            one.terminated,
            not one.terminated,
        )
        assert episode.infos["state"].tobytes() == one.states.tobytes()
    env = theirs.recover_environment()
    assert env.unwrapped.vector.variant == GameVectorEnv("maze", "anywhere-small").variant
    assert env.unwrapped.vector.art == mouse.art
    assert np.array_equal(env.reset(options={"level": level})[0], one.observations[0])


def test_a_folder_that_is_there_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ValueError, match="a data set is written to a new folder"):
        dataset.export(SYMBOLS, "maze", "corner-small", [0], tmp_path)
    with pytest.raises(ValueError, match="unknown format 'csv'; there are: parquet, minari"):
        dataset.export(SYMBOLS, "maze", "corner-small", [0], tmp_path / "new", form="csv")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_of_two_exports_to_one_folder_the_later_is_told_that_there_is_one(tmp_path):
    def slow(seen):  # another one is done meanwhile
        (tmp_path / "walks").mkdir(exist_ok=True)
        (tmp_path / "walks" / "mine").touch()
        return np.full(len(seen), 7)

    policy = astray.Function(slow, observation="symbolic")
    killed.left(tmp_path / "walks")
    with pytest.raises(ValueError, match="new folder; there is something at"):
        dataset.export(policy, "maze", "corner-small", [5], tmp_path / "walks")
    assert [path.name for path in tmp_path.rglob("*")] == ["walks", "mine"]


def test_an_interrupted_export_leaves_nothing(tmp_path):
    class Interrupted(Random):
        def actions(self, turn):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dataset.export(Interrupted(), "maze", "corner-small", [0], tmp_path / "set")
    assert list(tmp_path.iterdir()) == []


def ruined(folder, what):
    if what == "settings":
        (folder / "dataset.json").write_text('{"format": 9}')
    elif what == "states":
        data = json.loads((folder / "dataset.json").read_text())
        data["state"][0][0] = "other"
        (folder / "dataset.json").write_text(json.dumps(data))
    elif what == "dtype":
        data = json.loads((folder / "dataset.json").read_text()) | {"dtype": ","}
        (folder / "dataset.json").write_text(json.dumps(data))
    elif what == "a part":
        next((folder / "steps").iterdir()).unlink()
    else:
        part = next((folder / "steps").iterdir())
        table = pl.read_parquet(part)
        table.with_columns(state=pl.col("state").bin.slice(1)).write_parquet(part)


@pytest.mark.parametrize(
    "what, message",
    [
        ("settings", "must be an object of format 1"),
        ("states", "other fields than those of this version"),
        ("steps", "is not as astray writes it"),
        ("dtype", "cannot be read as a data set"),
        ("a part", "set lacks the steps of 1 episodes"),
    ],
)
def test_what_is_no_data_set_is_told(tmp_path, what, message):
    folder = dataset.export(SYMBOLS, "maze", "corner-small", [0], tmp_path / "set")
    ruined(folder, what)
    with pytest.raises(ValueError, match=message):
        next(dataset.read_trajectories(folder))
    with pytest.raises(FileNotFoundError, match="there is no data set in"):
        next(dataset.read_trajectories(tmp_path))


C = pl.col


def bytes_of(value):
    return lambda name: C(name).map_elements(lambda x: value * len(x), pl.Binary)


@pytest.mark.parametrize(
    "file, changed, message",
    [
        ("dataset.json", {"shape": [7, 7, 4]}, r"must be uint8 of shape \(4, 7, 7\); got uint8 of"),
        ("dataset.json", {"dtype": "int8"}, r"must be uint8 .*; got int8 of \(4, 7, 7\)"),
        ("dataset.json", {"observation": "image"}, r"must be uint8 of shape \(64, 64, 3\); got"),
        ("dataset.json", {"variant": {"side": 5}}, "its variant has other knobs"),
        ("steps/00000.parquet", bytes_of(b"\xff")("observation"), "numbers that it cannot have"),
        ("steps/00000.parquet", bytes_of(b"\xff")("state"), "state 0 is invalid"),
        ("steps/00000.parquet", C("observation").bin.slice(1), "cannot reshape array"),
        ("steps/00000.parquet", pl.lit(b"").alias("state"), "is not as astray writes it"),
        ("steps/00000.parquet", C("reward").cast(pl.String), "is not as astray writes it"),
        ("steps/00000.parquet", C("reward") / 0.0, "must be finite"),
        ("steps/00000.parquet", C("action") + 99, "must be from 0 to 14; got"),
        ("steps/00000.parquet", C("action") * 0.5, "must return integers"),
        ("steps/00000.parquet", C("level") + 7, "a row for each state"),
        ("steps/00000.parquet", C("step") * 3, "a row for each state"),
        ("steps/00000.parquet", C("step") + 1, "a row for each state"),
        ("steps/00000.parquet", ~C("truncated"), "a row for each state"),
        ("steps/00000.parquet", pl.lit(None, pl.Float64).alias("reward"), "a row for each state"),
        ("episodes.parquet", C("return") + 1, "has no such episode of level 0"),
        ("episodes.parquet", pl.lit("a").alias("level"), "has no such episode of level 0"),
        ("episodes.parquet", pl.concat_list("level"), "it must be without lists"),
        ("steps/00000.parquet", C("action").implode(), "it must be without lists"),
    ],
)
def test_what_export_does_not_write_is_refused(tmp_path, file, changed, message):
    folder = dataset.export(SYMBOLS, "maze", "corner-small", range(3), tmp_path / "set", longest=9)
    if file == "dataset.json":
        data = json.loads((folder / file).read_text()) | changed
        (folder / file).write_text(json.dumps(data))
    else:
        pl.read_parquet(folder / file).with_columns(changed).write_parquet(folder / file)
    with pytest.raises(ValueError, match=message):
        list(dataset.read_trajectories(folder))


def test_a_table_of_more_rows_than_the_memory_holds_is_not_read(tmp_path, monkeypatch):
    table = pl.DataFrame({"level": pl.repeat(1, 10**7, dtype=pl.Int64, eager=True)})
    write_table(table, path := tmp_path / "episodes.parquet")
    assert path.stat().st_size < 10**5 and read_table(path).equals(table)
    monkeypatch.setattr(memory, "available", lambda: 8 * 10**7 - 1)
    with pytest.raises(MemoryError, match=r"the table .* needs? 0.. GB of memory; there are 0.1"):
        read_table(path)


def test_observations_that_a_file_holds_once_for_all_rows_are_not_read(tmp_path, monkeypatch):
    """In memory each row has its own: a file of 30 kB took 12 GB."""
    folder = dataset.export(SYMBOLS, "maze", "corner-small", [0], tmp_path / "set", longest=2)
    first = pl.read_parquet(part := folder / "steps" / "00000.parquet").head(1)
    first.select(pl.all().repeat_by(10**5).explode()).write_parquet(part)
    assert part.stat().st_size < 10**5
    monkeypatch.setattr(memory, "available", lambda: 10**8)
    with pytest.raises(MemoryError, match=r"the table .* needs? 1.. GB of memory; there are 0.1"):
        next(dataset.read_trajectories(folder))


def test_episodes_that_do_not_fit_into_memory_are_left_with_what_helps(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 10**6)
    monkeypatch.setattr(dataset, "LOOKS", 8)
    said = r"144 steps of 4 episodes, which `longest` would truncate, need 0.0 GB of memory"
    with pytest.raises(MemoryError, match=said):
        dataset.export(Random(), "maze", "corner", range(8), tmp_path / "set", batch=4)
    assert not list(tmp_path.iterdir())


def test_a_table_of_columns_in_columns_is_not_read_as_polars_would_end_python(tmp_path):
    group, leaf = b"5\0\x18\1a\x15\2\0", b"\x15\4%\0\x18\1a\0"  # a column in a column, and numbers
    parts = b"H\4root\x15\2\0" + 300 * group + leaf
    footer = b"\x15\2\x19\xfc\xae\2" + parts + b"\x16\0\x19\x0c\0"
    path = tmp_path / "episodes.parquet"
    path.write_bytes(b"PAR1" + footer + struct.pack("<I", len(footer)) + b"PAR1")
    with pytest.raises(ValueError, match=r"not a table .*: it must be of at most 254 columns"):
        read_table(path)


def test_the_verb_writes_agents_and_scripts(astray, tmp_path):
    out = tmp_path / "agent"
    words = ("export", "maze-corner", "--variant", "anywhere-small", "--levels", "1000000:1000003")
    assert astray(*words, "--out", out).strip() == str(out)
    assert len(pl.read_parquet(out / "episodes.parquet")) == 3
    walk = ("export", "--policy", "walk:cheese", "--game", "maze", "--variant", "anywhere-small")
    astray(*walk, "--observation", "symbolic", "--levels", "0:4", "--out", tmp_path / "walk")
    assert pl.read_parquet(tmp_path / "walk" / "episodes.parquet")["terminated"].all()
    assert "--policy needs --variant; there are: " in astray(*walk[:5], fails=True)
    world = ("--policy", "random", "--world", "helpers.rooms:WORLD", "--variant", "anywhere")
    astray("export", *world, "--levels", "0:3", "--out", tmp_path / "room")
    assert pl.read_parquet(tmp_path / "room" / "episodes.parquet")["level"].to_list() == [0, 1, 2]


def test_a_level_that_is_given_twice_is_refused(tmp_path):
    with pytest.raises(ValueError, match="is given 2 times"):
        dataset.export(Random(), "maze", "corner-small", np.array([3, 3, 5]), tmp_path / "data")
    assert not (tmp_path / "data").exists()
