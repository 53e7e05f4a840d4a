"""What would be taken for something else is refused, in a sentence that says what is possible."""

import copy
import json
import os
import sys
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from astray import games, imports
from astray.agency import devices, generators, population
from astray.agency.agents import Agents
from astray.agency.gridworld import World
from astray.agency.measure import Episode, Options, decisions, measure_named
from astray.agency.online import measure_online
from astray.agency.steps import log_table, rule
from astray.analysis.adapters import Function
from astray.analysis.estimates import detectable, group_means, minus, quantile
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import (
    INTENDED,
    amounts,
    label,
    load_shift,
    mark_distinguishing,
    rates,
)
from astray.analysis.overlap import overlap
from astray.analysis.policies import Random
from astray.analysis.runs import evaluate_policies, evaluate_runs
from astray.envs.beginnings import initial_states
from astray.envs.pictures import picture
from astray.envs.single import GameEnv
from astray.envs.vector import GameVectorEnv
from astray.estimate import Estimate
from astray.experiments import catalogue
from astray.level import Level
from astray.level_files import read_levels
from astray.training.config import PRESETS, Config
from astray.training.trainer import Trainer
from astray.validation import bounded, finite
from astray.world import register

MAZE, KEYS = games.find("maze"), games.find("keys")
SMALL = MAZE.variant("corner-small")
ROOM = World(np.ones((3, 3), bool))
WALK = Episode(ROOM, ROOM.walk((0, 0), [0]), (2, 2))
SHIFT = load_shift(MAZE, "corner")
PLAYED = pl.DataFrame({"policy": "a", "variant": "b", "level": 0, "outcome": "died"})
MASKED = np.ma.masked_array([1, 2], [True, False])


EVENT = "reached_corner"


def measure_of(values):
    return evaluate(Random(), "maze", SMALL, [1, 2], measures={"m": lambda states: values})


def small(**options):
    return GameVectorEnv("maze", "corner-small", 2, observation="symbolic", **options)


def drawn(number=3):
    env = small()
    env.reset(seed=0, options={"level": number})
    return Level.of(MAZE, SMALL, env.states[0])


@pytest.mark.parametrize(
    "misspelt",
    [
        lambda: Options(goals="Accessible"),
        lambda: Options(noise="other"),
        lambda: Options(at_goal="Done"),
        lambda: Options(first="Null"),
        lambda: Options(observations=("type", "Ego")),
        lambda: Agents(ROOM, ROOM.distance, at_goal="stays"),
        lambda: devices.see(ROOM, WALK.trajectory, None, "types"),
        lambda: devices.see(ROOM, WALK.trajectory, None, "type", "Skip"),
        lambda: log_table(rule(3), "other"),
        lambda: generators.Setting(ROOM, (0, 0), (2, 2), 0, ties="Straight"),
        lambda: generators.Setting(ROOM, (0, 0), (2, 2), 0).episodes("Robust", 1),
        lambda: replace(SMALL, placement="Corner"),
        lambda: replace(PRESETS["small"], timeouts="Terminate"),
        lambda: small(autoreset_mode="Samestep"),
        lambda: small(autoreset_mode=np.zeros((), "V4")),  # not to be compared with words
    ],
)
def test_a_misspelt_word_is_no_other_word(misspelt):
    with pytest.raises(ValueError, match=r"unknown .*; there are: |is not a valid AutoresetMode"):
        misspelt()


@pytest.mark.parametrize(
    "wrong, message",
    [
        (lambda: Options(beta=float("nan")), "number from 1 to 1e.08; got nan"),
        (lambda: Options(legal="no"), "legal must be a bool; got 'no'"),
        (lambda: Options(observations=("type", "type")), "each is given once"),
        (lambda: measure_online(WALK, switch="1/t"), r"not '1/\(t\+1\)', must be a finite number"),
        (
            lambda: Config(learning_rate=float("inf")),
            "learning_rate must be of type float, finite; got inf",
        ),
        (lambda: Config(learning_rate=10**400), "type float, finite; got 1000"),
        (lambda: Config(clip=float("nan")), "clip must be of type float, finite; got nan"),
        (lambda: replace(SMALL, time_limit=5.5), "time_limit must be an integer from"),
        (lambda: replace(SMALL, time_limit=True), "time_limit must be an integer"),
        (lambda: replace(SMALL, time_limit=10**30), r"time_limit must be an integer"),
        (lambda: replace(SMALL, strict="no"), "strict must be a bool; got 'no'"),
    ],
)
def test_a_number_or_a_fact_of_another_type_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


@pytest.mark.parametrize(
    "wrong, message",
    [
        (lambda: population.pooled(np.zeros(3)), r"must be of episodes x explanations; got \(3,\)"),
        (lambda: population.pooled(np.full((2, 2), np.nan)), "every explanation, or one is NaN"),
        (lambda: population.rates(np.array([[-1, np.nan]])), "every explanation, or one is NaN"),
        (
            lambda: population.pooled(np.array([[0, -np.inf], [-np.inf, 0]])),
            "no explanation is possible for all episodes",
        ),
        (lambda: Function(len, name=3), "name must be a str; got 3"),
        (lambda: Function(len, observation="images"), "unknown observation 'images'; there are"),
        (lambda: Function(len, remembers="no"), "remembers must be a bool; got 'no'"),
        (lambda: Agents(ROOM, ROOM.distance, legal="no"), "legal must be a bool; got 'no'"),
        (lambda: bounded("k", np.timedelta64(3), 0, 5), "k must be an integer from 0 to 5"),
        (lambda: finite("k", np.timedelta64(3)), "k must be a finite number; got"),
        (lambda: finite("k", False), "k must be a finite number; got False"),
        (lambda: evaluate(Random(), "maze", SMALL, MASKED), "levels must be integers of .*masked"),
        (
            lambda: evaluate(Random(), "maze", SMALL, [1], until=5),
            "until must be a tuple or list; got",
        ),
        (lambda: evaluate(Random(), "maze", SMALL, [1], until=EVENT), "until must be a tuple or"),
        (lambda: measure_of([1, "two"]), r"'m' must return 2 values of one type; got \[1, 'two'\]"),
        (lambda: measure_of(np.zeros(2, complex)), "'m' must return 2 values of one type"),
        (lambda: evaluate_runs(["maze-corner"], [1], knobs=5), "knobs must be a Mapping; got 5"),
        (lambda: Config().variant_for("anywhere", ["world"]), "knobs must be a Mapping; got"),
        (lambda: measure_of([1]), "'m' must return 2 values of one type"),
        (lambda: small(levels=MASKED), "levels must be integers of .*masked"),
        (lambda: Episode(3, WALK.trajectory), "world must be a World; got 3"),
        (lambda: ROOM.path(3), "cells must be a Iterable; got 3"),
        (lambda: ROOM.cell(-1), "the number of a cell must be an integer from 0 to 8; got -1"),
        (lambda: ROOM.accessible((0, 0)), r"number of a cell must be an integer .*got \(0, 0\)"),
        (lambda: measure_named([WALK], 3), "goals must be a Sequence; got 3"),
        (lambda: measure_named([WALK], {"a": [(0, 0)]}), "goals must be a Sequence; got {'a'"),
        (lambda: measure_named([WALK], [3]), "goals of an episode must be a Mapping; got 3"),
        (lambda: measure_named([WALK], [{"a": None}]), "cells of a goal must be a Collection; got"),
        (lambda: decisions(WALK, {}, Options()), "there must be a goal, and each"),
        (lambda: decisions(WALK, [(0, 0)], Options()), "goals must be a Mapping; got"),
        (lambda: decisions([WALK, WALK], {}, Options()), r"episode must be a Episode; got \[Epi"),
        (lambda: ROOM.trajectory(3), "steps must be pairs of a cell and an action; got 3"),
        (lambda: ROOM.trajectory([(1, 2, 3)]), "steps must be pairs .*; got .*1, 2, 3"),
        (lambda: ROOM.trajectory([((0, 0), 0), (0, 0)]), "a cell must be two integers, x and y"),
        (lambda: population.rates(np.zeros((1, 2)), seed=0.5), "seed must be an integer from 0 to"),
        (lambda: Random(seed=0.5), "seed must be an integer from 0 to .*; got 0.5"),
        (lambda: Random(observation="images"), "unknown observation 'images'; there are"),
        (lambda: register(3), "a world must be a World; got 3"),
        (lambda: rates(PLAYED, outcomes=["misspelt"]), "'misspelt' of these episodes; there are: "),
        (lambda: rates(PLAYED, outcomes=[INTENDED, "Died"]), "'Died' .*; there are: .*, died, "),
        (lambda: rates(PLAYED, outcomes="died"), "outcomes must be a list or tuple; got 'died'"),
        (lambda: rates(PLAYED, by="policy"), "by must be a list or tuple; got 'policy'"),
        (lambda: amounts(PLAYED, ["steps"]), "episodes must have the columns steps"),
        (lambda: label(3, MAZE, SHIFT), "episodes must be a DataFrame; got 3"),
        (lambda: label(PLAYED, "maze", SHIFT), "game must be a Game or World, .*; got 'maze'"),
        (lambda: label(PLAYED, MAZE, "corner"), "shift must be a Shift; got 'corner'"),
        (lambda: mark_distinguishing(PLAYED, None), "shift must be a Shift; got None"),
        (lambda: mark_distinguishing(PLAYED.drop("level"), SHIFT), "have the columns level"),
        (lambda: group_means(3, "level", ["policy"]), "rows must be a DataFrame; got 3"),
        (lambda: minus(0.5, Estimate.nothing()), "one must be a Estimate; got 0.5"),
        (lambda: quantile([3]), r"freedom must be a finite number from 0 on; got \[3\]"),
        (lambda: quantile(3, 1.5), "below must be a finite number from 0 to 1; got 1.5"),
        (lambda: detectable(0, 100, 0.1), "agents must be an integer from 1 to .*; got 0"),
        (lambda: detectable(3, 100, "0.1"), "spread must be a finite number from 0 on; got '0.1'"),
    ],
)
def test_an_argument_of_another_kind_is_refused_and_not_read_as_another(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


@pytest.mark.skipif(os.name == "nt", reason="never promises memory that is not there")
@pytest.mark.parametrize(
    "take, message",
    [
        (lambda: small_training(num_envs=10**9), "1,000,000,000 environments need"),
        (lambda: small_training(num_steps=10**9), r"rollouts of 4,000,000,004 samples need .* GB"),
        (lambda: small_training(width=10**6), r"weights and rollouts .* need .* GB of memory; the"),
        (lambda: small_training(width=2**31 - 1), "too many weights for any memory|weights and"),
        (
            lambda: GameVectorEnv("maze", "corner", 10**9),
            r"need [\d,]+\.\d GB of memory; there are",
        ),
        (
            lambda: picture("maze", SMALL, begun(10**4), 4096),
            "10,000 pictures of 4096 x 4096 pixels need",
        ),
    ],
)
def test_memory_that_is_not_there_is_told_beforehand(take, message):
    with pytest.raises(MemoryError, match=message):
        take()


def begun(count):
    env = small()
    env.reset(seed=0)
    return np.repeat(env.get_state()[:1], count)


def small_training(**change):
    sizes = {"num_envs": 4, "num_steps": 4, "minibatches": 1, "variant": "corner-small"} | change
    Trainer(PRESETS["small"].changed(**sizes))


def test_numpys_numbers_are_numbers():
    assert replace(SMALL, time_limit=np.int64(7)) == replace(SMALL, time_limit=7)


@pytest.mark.parametrize(
    "levels", [[1.5, 2.0], np.array([1.0]), [True, False], [1, True], "12", ["1"], [None], [], [-1],
               [2**31 - 1], [2**70], [[1, 2]], range(2**64), range(5, 2**63), np.array(5), 5]
)  # fmt: skip
@pytest.mark.parametrize(
    "take",
    [
        lambda levels: small(levels=levels),
        lambda levels: evaluate(Random(), "maze", SMALL, levels),
        lambda levels: overlap("maze", SMALL, levels, SMALL, [1]),
        lambda levels: initial_states("maze", SMALL, levels),
    ],
)
def test_numbers_of_levels_are_integers_that_are_levels(take, levels):
    with pytest.raises(ValueError, match="level"):
        take(levels)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"levels": [1, 2]}, "unknown option 'levels'; there are: level, state, reset_mask"),
        ({"level": 1.0}, "levels must be integers of at most 64 bits; got 1.0"),
        ({"level": [1, True]}, "levels must be integers"),
        ({"level": [1, 2, 3]}, r"give 2 levels, or one; got \[1, 2, 3\]"),
        ({"level": [[1, 2]]}, r"give 2 levels, or one; got \[\[1, 2\]\]"),
        ({"level": []}, r"give 2 levels, or one; got \[\]"),
        ({"level": 2**64}, "levels must be integers of at most 64 bits; got 18446744073709551616"),
        ({"level": range(9, 2**63)}, "at most 10,000,000 levels are taken at once; got range"),
        ({"level": 2**63}, "levels must be numbers from 0 to 2147483646; got 9223372036854775808"),
        ({"level": True}, "levels must be integers of at most 64 bits; got True"),
        ({"level": "1"}, "levels must be integers of at most 64 bits; got '1'"),
        ({"level": 1, "state": small().get_state()}, "by a level or by a state, not both"),
    ],
)
def test_a_reset_takes_no_option_in_silence(options, message):
    env = small()
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    assert env.get_state().tobytes() == before.tobytes()


@pytest.mark.parametrize("variant", [KEYS.variant("many-keys"), 3, None, ["corner"], b"corner"])
@pytest.mark.parametrize(
    "take",
    [
        lambda variant: GameVectorEnv("maze", variant),
        lambda variant: evaluate(Random(), "maze", variant, [1]),
        lambda variant: picture("maze", variant, small().get_state(), 64),
        lambda variant: Level(MAZE, variant, drawn().cells, (1, 1), {}),
    ],
)
def test_a_variant_is_one_of_the_game(take, variant):
    with pytest.raises(ValueError, match=r"the variant is a Keys, not one of maze|unknown variant"):
        take(variant)


@pytest.mark.parametrize("count", [0, -1, 2.0, True, "2", None])
@pytest.mark.parametrize(
    "take",
    [
        lambda n: GameVectorEnv("maze", "corner-small", n),
        lambda n: small(threads=n),
        lambda n: evaluate(Random(), "maze", SMALL, [1], batch=n),
        lambda n: picture("maze", SMALL, small().get_state(), n),
    ],
)
def test_a_count_is_a_whole_number_from_1_on(take, count):
    with pytest.raises(ValueError, match="must be an integer from 1 to "):
        take(count)


@pytest.mark.parametrize(
    "edit",
    [
        lambda level: level.moved("agent", (1.0, 1.0)),
        lambda level: level.moved("goal", (1.5, 1)),
        lambda level: level.moved("goal", (1, 1), at=tuple(map(float, level.where("goal")[0]))),
        lambda level: level.added("goal", (True, "1")),
        lambda level: level.removed("goal", (1, 2, 3)),
        lambda level: replace(level, agent=(1.5, 1)),
    ],
)
def test_a_level_is_edited_by_whole_cells(edit):
    with pytest.raises(ValueError, match="a cell must be two integers, x and y; got"):
        edit(drawn())


@pytest.mark.parametrize(
    "cells, message",
    [
        (np.full((7, 7), 77, np.uint8), r"unknown code 77 at cell \(0, 0\); there are: \["),
        (np.full((7, 7), 1.5), "cells are an array"),
        ([[1, 1], [1, 1]], "cells are an array"),
        (np.full(7, 1, np.uint8), "cells are an array"),
    ],
)
def test_a_levels_cells_are_of_its_legend(cells, message):
    with pytest.raises(ValueError, match=message):
        replace(drawn(), cells=cells)


@pytest.mark.parametrize(
    "use",
    [Level.state, str, Level.to_json, lambda level: level.added("goal", (1, 2))],
    ids=["state", "drawing", "JSON", "edit"],
)
def test_cells_that_were_changed_in_place_are_looked_at_again(use):
    level = drawn()
    level.cells[2, 1] = 77
    with pytest.raises(ValueError, match=r"unknown code 77 at cell \(1, 2\)"):
        use(level)


@pytest.mark.parametrize("agent", [(-1, 1), (7, 1), (1, 2**40)])
def test_the_agent_of_a_level_is_in_it(agent):
    with pytest.raises(ValueError, match=r"the agent is at cell \(.*\), outside of the level"):
        replace(drawn(), agent=agent)


def test_no_level_of_a_folder_is_lost_to_another_of_its_name(tmp_path):
    level = str(drawn())
    (tmp_path / "a").write_text(f"{level}\n\n{level}")
    (tmp_path / "a.txt").write_text(level)
    assert list(read_levels(tmp_path, MAZE, SMALL)) == ["a:1", "a:2", "a.txt"]
    (tmp_path / "a:1").write_text(level)
    with pytest.raises(ValueError, match=r"two levels in .* are called 'a:1'"):
        read_levels(tmp_path, MAZE, SMALL)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("name", ["level.txt", "level.json"])
def test_a_byte_order_mark_is_no_part_of_a_level(name, encoding, tmp_path):
    level = drawn()
    text = str(level) if name == "level.txt" else json.dumps(level.to_json())
    (tmp_path / name).write_text("\ufeff" + text, encoding=encoding)
    (found,) = read_levels(tmp_path / name, MAZE, SMALL).values()
    assert str(found) == str(level) == str(Level.from_text(MAZE, SMALL, f"\ufeff{level}"))


@pytest.mark.parametrize("make", [small, lambda: GameEnv("maze", SMALL, observation="symbolic")])
def test_a_copy_of_an_environment_shares_nothing(make):
    one = make()
    one.reset(seed=0)
    two = copy.copy(one)
    (ours, theirs) = (getattr(env, "vector", env) for env in (one, two))
    before = ours.get_state()
    theirs.step(np.zeros(theirs.num_envs, int))
    assert ours.get_state().tobytes() == before.tobytes() != theirs.get_state().tobytes()


@pytest.mark.parametrize("line", ["raise SystemExit(0)", "raise GeneratorExit", "1 / 0"])
def test_a_module_that_fails_is_named_whatever_it_raises(tmp_path, monkeypatch, line):
    (tmp_path / "failing.py").write_text(line)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=r"^the module 'failing' fails: "):
        imports.find("failing:GAME")
    with pytest.raises(ValueError, match=r"failing\.py"):
        catalogue.find(str(tmp_path / "failing.py"))


def test_the_line_of_a_mistake_is_one_of_a_file_that_is_there(tmp_path, monkeypatch):
    lines = "from dataclasses import replace\nfrom astray import games\nMAZE = games.find('maze')\n"
    (tmp_path / "remade.py").write_text(f"{lines}GAME = replace(MAZE, about=3)")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=r"about must be a str; got 3.*\(remade\.py, line 4\)"):
        imports.find("remade:GAME")


def test_a_module_whose_error_exits_when_it_is_read_is_named(tmp_path, monkeypatch):
    error = "class Odd(ImportError):\n    def __str__(self):\n        raise SystemExit(0)\n"
    (tmp_path / "unreadable.py").write_text(f"{error}\n\nraise Odd\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=r"^the module 'unreadable' fails: "):
        imports.find("unreadable:GAME")


def test_users_code_of_two_threads_at_once_leaves_the_streams_as_they_were(monkeypatch):
    monkeypatch.setattr(sys, "__stdout__", sys.stdout)  # as outside of tests
    own = sys.stdout, sys.stderr
    one, two = imports.guarded("one"), imports.guarded("two")
    one.__enter__()
    lent = sys.stdout
    two.__enter__()
    one.__exit__(None, None, None)
    assert sys.stdout is lent is not own[0]
    sys.stdout = None  # as the code may do
    two.__exit__(None, None, None)
    assert (sys.stdout, sys.stderr) == own


def test_a_single_environment_takes_the_seeds_of_a_batch():
    env = GameEnv("maze", "corner-small")
    assert env.reset(seed=np.int64(9))[1] == env.reset(seed=9)[1]
    for wrong in (-1, 2**63, True):
        with pytest.raises(ValueError, match=f"seed must be an integer from 0 to .*; got {wrong}"):
            env.reset(seed=wrong)


@pytest.mark.parametrize("seed", [-1, 2**31, 2**63, 0.5])
def test_a_seed_of_random_actions_is_one_that_its_numbers_have(seed):
    with pytest.raises(ValueError, match=r"^seed must be an integer from 0 to 2147483647; got"):
        evaluate(Random(seed), "maze", "corner-small", [0])


@pytest.mark.parametrize("name", ["../x", ".", "", "os", "os:", ":path", "os:path:join", "a b:c"])
def test_what_names_nothing_is_not_looked_for(name):
    with pytest.raises(ValueError, match="a name must be module:attribute, as"):
        imports.find(name)


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int32, np.uint64])
def test_a_number_of_numpy_is_that_number(kind):
    corners = "maze", "corner-small", range(3)
    told = evaluate(Random(kind(3)), *corners, batch=kind(2), longest=kind(4))
    assert told.equals(evaluate(Random(3), *corners, batch=2, longest=4))
    env = GameVectorEnv("maze", "corner-small", kind(2))
    assert env.reset(seed=kind(5))[0].shape[0] == 2


@pytest.mark.parametrize("nothing", ["", 0, False, {}])
def test_an_empty_variant_is_no_default(nothing):
    for played in (
        lambda: evaluate_policies([Random(name="mine")], "maze", "corner", [1], variant=nothing),
        lambda: evaluate_runs(["maze-corner"], [1], variant=nothing),
        lambda: evaluate_runs(["maze-corner"], [1], shift=nothing),
    ):
        with pytest.raises(ValueError, match=r"unknown (variant|shift) .* of maze; there are: "):
            played()


def test_a_truth_is_no_number_of_a_look():
    data = drawn().to_json()
    data["looks"] |= {"background": True}
    with pytest.raises(ValueError, match="background is True, but in this level 1"):
        Level.from_json(MAZE, SMALL, data).state()


def test_an_array_is_shown_in_one_line():
    with pytest.raises(ValueError, match=r"got array\(\[\[0, 0\], \[0, 0\]\]\)$"):
        World.parse(np.zeros((2, 2), int))  # pyrefly: ignore
