"""Studies of agents that others trained, in a world of nobody's: trained or found, told, filmed."""

import contextlib
import importlib
import json
import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import FunctionType, SimpleNamespace

import numpy as np
import polars as pl
import pytest
from filelock import Timeout
from torch import nn

from astray import games
from astray.analysis import video
from astray.analysis.adapters import Function
from astray.analysis.estimates import estimate_paired
from astray.analysis.outcomes import INTENDED, MISGENERALIZED
from astray.analysis.trained import Network
from astray.experiments import outcomes, run, spec
from astray.experiments.run import inputs, make_own, own_runs, reproduce, resolved
from astray.experiments.spec import Experiment, OwnAgents, Plan
from astray.files import hold
from astray.game import More, Shift
from astray.training.config import Config
from helpers import lava
from helpers.edits import forget
from helpers.lava import GAME as LAVA
from helpers.rooms import CELLS, WORLD, Room


def load(path):
    """An agent that goes right as often as its file says, as the cells that it sees decide."""
    often = float((path / "agent.txt" if path.is_dir() else path).read_text())
    return Function(lambda seen: (seen[:, 1].argmax(1) % 10 < 10 * often).astype(int))


def train(seed, folder, log=None):
    if log:
        log.write_text((log.read_text() if log.exists() else "") + f"{seed} ")
    (folder / "agent.txt").write_text(str(1 - seed / 4))


def experiment(world=WORLD, **own):
    plan = Plan(
        world=world,
        own={"right": OwnAgents(load, **own)},
        seeds=2,
        tests=spec.tests_of(world, "end"),
        levels=30,
        differences="",
    )
    return Experiment("Right", "nothing", "Where to?", {"smoke": plan}, outcomes.findings)


def episodes_of(folder):
    (table,) = (folder / "computed").glob("episodes-*.parquet")
    return pl.read_parquet(table), table


def test_agents_are_trained_once_each_and_a_report_tells_what_they_do(tmp_path):
    study = experiment(train=partial(train, log=tmp_path / "log"))
    page = reproduce(study, "smoke", tmp_path)
    episodes, table = episodes_of(page.parent)
    mine = episodes.filter(policy="sampled", test="in the test")
    assert mine["seed"].unique().to_list() == [0, 1] and mine["agent"].unique().to_list() == [
        "right"
    ]
    for seed, level, square in mine.select("seed", "level", "reached_square").rows():
        (env := Room("anywhere")).reset(seed=level)
        goes_right = env.square < (10, 7.5)[seed]
        assert (square is not None) == ((env.square > CELLS // 2) == goes_right)
    assert (page.parent / "videos" / "goal-misgeneralization.mp4").stat().st_size > 1000
    told = page.read_text("utf-8")
    assert "reaches “square” first" in told and "played by seed 0: level " in told  # alone
    when = table.stat().st_mtime_ns
    reproduce(study, "smoke", tmp_path)
    assert (tmp_path / "log").read_text() == "0 1 " and table.stat().st_mtime_ns == when


@pytest.mark.usefixtures("undrawn")
def test_kinds_of_agents_have_claims_of_their_own(tmp_path):
    for name, often in (("one", "1"), ("two", "0.9"), ("three", "0.1"), ("four", "0")):
        (tmp_path / name).write_text(often)
    files = [tmp_path / name for name in ("one", "two", "three", "four")]
    plan = experiment(files=files[:2]).sizes["smoke"]
    own = {"right": OwnAgents(load, files[:2]), "left": OwnAgents(load, files[2:])}
    study = Experiment("Both", "nothing", "Where to?", {"smoke": replace(plan, own=own)},
                       outcomes.findings)  # fmt: skip
    page = reproduce(study, "smoke", tmp_path)
    assert "the goals, played by right, seed 0: level " in page.read_text("utf-8")  # in a video
    told = json.loads((page.parent / "findings.json").read_bytes())
    ours = {claim["sentence"]: claim["ours"] for claim in told["claims"]}
    learned = [ours[f"In the training levels of the shift, {kind} reaches “square” first."] for
               kind in own]  # fmt: skip
    assert len(ours) == 4 and all("over 2 agents and 30 levels" in one for one in learned)
    assert ["100.0" in one for one in learned] == [True, False]
    with pytest.raises(ValueError, match="must be of agents of one name; got left, right: filter"):
        outcomes.rate(both := episodes_of(tmp_path / "both-smoke")[0], "in the test", INTENDED)
    with pytest.raises(ValueError, match="must be of agents of one name; got left, right: filter"):
        outcomes.played(SimpleNamespace(episodes=both), "in the test", "length")


@pytest.mark.usefixtures("undrawn")
def test_usual_findings_take_further_tests_and_refuse_one_before_the_work(tmp_path):
    for name, often in (("one", "1"), ("two", "0.9")):
        (tmp_path / name).write_text(often)
    left = Shift("end", "anywhere", "left", ("square",))
    world = replace(
        WORLD,
        events={**WORLD.events, "reached_left": lambda env, info: env.x == 0},
        goals={**WORLD.goals, "left": "reached_left"},
        shifts={**WORLD.shifts, "left": left},
        experts={**WORLD.experts, "left": lambda env: 0},
    )
    study = experiment(world, files=[tmp_path / "one", tmp_path / "two"])
    (plan,) = study.sizes.values()
    others = {"again": spec.Test("anywhere", "end"), "other goals": spec.Test("anywhere", "left")}
    more = replace(plan, tests={**plan.tests, **others})
    page = reproduce(replace(study, sizes={"smoke": more}), "smoke", tmp_path)
    assert {*episodes_of(page.parent)[0]["test"]} == {*more.tests}
    drawn = pl.read_parquet(page.parent / "figures" / "outcomes.parquet")
    walks = {f"walks to the {one}" for one in ("square", "end, blind to the rest", "left")}
    assert {*drawn["who"]} == {*walks, "random", "right: 2 agents"}
    own = {"right": OwnAgents(load, train=lambda *_: pytest.fail("it trains"))}
    for few in ({}, {"in the test": spec.Test("anywhere", "end")}):
        one = replace(study, sizes={"smoke": replace(plan, own=own, tests=few)})
        with pytest.raises(ValueError, match=r"of two tests, in training and .*; got \["):
            reproduce(one, "smoke", tmp_path)


@pytest.mark.usefixtures("undrawn")
def test_plans_take_numbers_of_numpy_and_variants_of_worlds(tmp_path):
    (tmp_path / "one").write_text("1")
    own = {"right": OwnAgents(load, [tmp_path / "one"])}
    tests = {**spec.tests_of(WORLD, "end"), "2": spec.Test("end", "end", {"vector": np.int64(0)})}
    tests["3"] = spec.Test(WORLD.variant("end").with_knobs({"vector": False}), "end")
    one, two, three, four = np.arange(1, 5)
    given = {"seeds": one, "levels": two, "first_level": three, "longest": four}
    (plan,) = experiment(files=[tmp_path / "one"] * 2).sizes.values()
    sizes = {"smoke": replace(plan, own=own, tests=tests, **given)}
    study = Experiment("Numbers", "nothing", "Where to?", sizes, outcomes.findings)
    played, _ = episodes_of(reproduce(study, "smoke", tmp_path).parent)
    assert {*played["level"]} == {3, 4} and {*played["test"]} == {*tests}
    assert played["length"].max() == 4


def test_agents_are_trained_anew_where_the_environment_of_their_training_reads_another_file(
    tmp_path,
):
    class Reads(Room):
        def _seen(self):
            return super()._seen() * np.float32((tmp_path / f"light-{self.place}").read_text())

    made = {name: partial(Reads, name) for name in WORLD.variants}
    plan = experiment(replace(WORLD, variants=made), train=train).sizes["smoke"]
    folders = []
    for training, test in (("1", "1"), ("1", "0.5"), ("0.5", "0.5")):
        for place, light in (("end", training), ("anywhere", test)):
            (tmp_path / f"light-{place}").write_text(light)
        folders.append(own_runs(plan, "right", tmp_path))
    assert folders[0] == folders[1] != folders[2]


class Trains:
    def __init__(self, rate):
        self.rate = rate

    def __call__(self, seed, folder):
        train(seed, folder)


def carrying(way, rate):
    """Return a function that trains, and carries a rate in that way."""
    code = (lambda seed, folder: train(seed, folder) or (lambda: RATE)).__code__  # noqa: F821  # pyrefly: ignore
    read = {"rates": [rate, np.array([rate])]}  # as from a file
    return {
        "closure": lambda seed, folder: train(seed, folder) or rate,
        "default": lambda seed, folder, rate=rate: train(seed, folder),
        "global": FunctionType(code, {**globals(), "RATE": rate}),
        "data": FunctionType(code, {**globals(), "RATE": read}),
        "attribute": Trains(rate),
        "method": Trains(rate).__call__,
        "partial": partial(lambda rate, *given: train(*given), SimpleNamespace(rate=rate)),
    }[way]


@pytest.mark.parametrize(
    "way", ["closure", "default", "global", "data", "attribute", "method", "partial"]
)
def test_agents_and_tables_are_computed_anew_where_a_function_carries_another_value(way, tmp_path):
    folders, digests = [], []
    for rate in (0.5, 0.5, 0.25):  # as in a loop, or of a command line: the source is one
        plan = experiment(train=carrying(way, rate)).sizes["smoke"]
        folders.append(own_runs(plan, "right", tmp_path))
        make_own(plan, "right", folders[-1])
        measured = replace(plan, measures={"far": carrying(way, rate)})
        digests.append(inputs(measured, {"right": folders[0]})[1])
    assert folders[0] == folders[1] != folders[2]
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.parametrize("way", ["event", "bound"])
def test_tables_of_agents_trained_here_are_computed_anew_where_a_world_carries_another_value(way):
    digests = []
    for given in (2.0, 2.0, 3.0):
        late = partial(lambda than, env, info: False, given if way == "event" else 0)
        goals = WORLD.goals | {"long": More("no", given if way == "bound" else 0)}
        events, no = {**WORLD.events, "late": late}, {**WORLD.measures, "no": lambda env: 0.0}
        world = replace(WORLD, name="carries", events=events, goals=goals, measures=no)
        config = Config(world, "end")
        plan = Plan(
            agents={"a": config}, tests=spec.tests_of(world, "end"), levels=3, differences=""
        )
        digests.append(inputs(plan, {})[1])
    assert digests[0] == digests[1] != digests[2]


def test_an_agent_that_another_study_has_trained_meanwhile_is_taken(tmp_path):
    runs = [tmp_path / "room-right" / f"seed-{seed}" for seed in range(2)]

    def trains(seed, folder):
        train(seed, folder)
        with pytest.raises(Timeout), hold(runs[0].parent, "trains in", wait=False):
            pytest.fail("two train at once")

    @contextlib.contextmanager
    def waits(*_):
        runs[0].mkdir(parents=True)
        yield

    make_own(plan := experiment(train=trains).sizes["smoke"], "right", runs[1:])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "hold", waits)
        make_own(plan, "right", runs[:1])
    assert [list(path.iterdir()) for path in runs] == [[], [runs[1] / "agent.txt"]]


@pytest.mark.usefixtures("undrawn")
def test_code_that_is_edited_while_agents_are_trained_is_not_what_measured(tmp_path, monkeypatch):
    source, text = tmp_path / "measuring.py", "def far(states):\n    return [{}] * len(states)\n"

    def edits(seed, folder):
        train(seed, folder)
        source.write_text(text.format(2.0))

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # which tells no edit within a second
    source.write_text(text.format(1.0))
    for told in (1.0, 2.0):
        monkeypatch.delitem(sys.modules, "measuring", raising=False)
        far = importlib.import_module("measuring").far
        study = experiment(train=edits)
        plan = replace(study.sizes["smoke"], measures={"far": far}, seeds=1, levels=3)
        page = reproduce(replace(study, sizes={"smoke": plan}), "smoke", tmp_path)
        assert episodes_of(page.parent)[0]["far"].unique().to_list() == [told]


def test_agents_that_astray_trains_have_a_folder_for_each_state_of_your_code(tmp_path, monkeypatch):
    class Reads(Room):
        def _seen(self):
            return super()._seen() * np.float32((tmp_path / "light").read_text())

    monkeypatch.syspath_prepend(tmp_path)
    variants = {name: partial(Reads, name) for name in WORLD.variants}
    world = replace(WORLD, name="reads", variants=variants)
    own = f"net{tmp_path.name.replace('-', '_')}:Net"
    names = []
    for light, doc in (("1", "a"), ("0.5", "a"), ("0.5", "b")):
        forget(monkeypatch)
        (tmp_path / "light").write_text(light)
        (tmp_path / f"{own.partition(':')[0]}.py").write_text(f"class Net:\n    'Is {doc}.'\n")
        each = [Config(world, "end"), Config("maze", "corner", network=own), Config("maze")]
        names.append([spec.name_of_run(config) for config in each])
    changed = [[one != other for one, other in zip(*pair, strict=True)] for pair in pairwise(names)]
    assert changed == [[True, False, False], [False, True, False]]


READ = "B = float((pathlib.Path(__file__).parent / 'b').read_text())\n"
PAYS = {
    "read": f"{READ}def pay(given): return B * given.reward\n",
    "made elsewhere": f"import pays\n{READ}pay = pays.scaled(B)\ndel B\n",
    "a part": f"import functools, pays\n{READ}pay = functools.partial(pays.by, B)\ndel B\n",
    "an object": f"import pays\n{READ}pay = pays.Scaled(B)\ndel B\n",
}
ELSEWHERE = """
def by(factor, given): return factor * given.reward

def scaled(by):
    return lambda given: by * given.reward

class Scaled:
    def __init__(self, by): self.by = by
    def __call__(self, given): return self.by * given.reward
"""


@pytest.mark.parametrize("how", PAYS)
def test_agents_have_a_folder_for_each_value_that_their_reward_keeps(how, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "pays.py").write_text(ELSEWHERE)
    (tmp_path / "named.py").write_text(f"import pathlib\n{PAYS[how]}")
    names = []
    for value in ("1", "1", "0.5"):
        (tmp_path / "b").write_text(value)
        for module in ("pays", "named"):
            monkeypatch.delitem(sys.modules, module, raising=False)
        names.append(spec.name_of_run(Config("maze", "corner", reward="named:pay")))
    assert names[0] == names[1] != names[2]


def test_agents_of_a_guest_have_a_folder_for_each_value_that_its_rules_keep(monkeypatch):
    monkeypatch.setitem(games._registered, LAVA.name, LAVA)
    names = []
    for start in (2, 2, 3):
        monkeypatch.setattr(lava, "START", start)
        names.append(spec.name_of_run(Config(LAVA.name, next(iter(LAVA.variants)))))
    assert names[0] == names[1] != names[2]


@pytest.mark.parametrize("repeats", [True, False])
def test_tables_are_computed_anew_where_an_environment_reads_another_file(repeats, tmp_path):
    class Reads(Room):
        def _seen(self):
            return super()._seen() * np.float32((tmp_path / "light").read_text())

    made = {name: partial(Reads, name) for name in WORLD.variants}
    plan = experiment(replace(WORLD, variants=made, repeats=repeats), files=["a", "b"]).sizes[
        "smoke"
    ]
    digests = []
    for light in ("1", "1", "0.5"):
        (tmp_path / "light").write_text(light)
        digests.append(resolved(plan))
    assert digests[0] == digests[1] and (digests[1] != digests[2]) == repeats


def test_a_test_without_end_is_told_before_anybody_trains(tmp_path):
    plan = Plan(
        world=LAVA,
        own={"right": OwnAgents(load, train=lambda *_: pytest.fail("it trains"))},
        tests={name: spec.Test("for-ever", "lava") for name in ("in training", "in the test")},
        levels=3,
        differences="",
    )
    study = Experiment("Right", "nothing", "Where to?", {"smoke": plan}, outcomes.findings)
    with pytest.raises(ValueError, match="last up to 1,000,000,000 steps"):
        reproduce(study, "smoke", tmp_path)


@pytest.mark.usefixtures("undrawn")
def test_agents_from_files_are_played_and_another_file_is_another_agent(tmp_path):
    files = [tmp_path / name for name in ("one", "two")]
    for file, often in zip(files, ("1", "0.9"), strict=True):
        file.write_text(often)
    study = experiment(files=files)
    _, first = episodes_of(reproduce(study, "smoke", tmp_path).parent)
    files[1].write_text("0")
    episodes, second = episodes_of(reproduce(study, "smoke", tmp_path).parent)
    assert first != second and episodes.filter(seed=1)["reached_end"].null_count() == 60
    files[1].unlink()
    with pytest.raises(FileNotFoundError, match=r"there is no agent 'right' at .*two"):
        reproduce(study, "smoke", tmp_path)


def same(seed, folder):
    train(0, folder)


@pytest.mark.usefixtures("undrawn")
def test_new_agents_have_the_seeds_that_the_plan_says(tmp_path):
    """They were the agents that were there, of seeds from 0 on."""
    study = experiment(train=train)
    reproduce(study, "smoke", tmp_path)
    new = {"smoke": replace(study.sizes["smoke"], first_seed=2)}
    episodes, _ = episodes_of(reproduce(replace(study, sizes=new), "smoke", tmp_path).parent)
    assert {*episodes.filter(policy="sampled")["seed"]} == {2, 3}
    (kept,) = (tmp_path / "agents").iterdir()
    told = [(kept / f"seed-{seed}" / "agent.txt").read_text() for seed in range(4)]
    assert told == ["1.0", "0.75", "0.5", "0.25"]


@pytest.mark.parametrize("own", [{"train": same}, {"files": ["a.txt", "b.txt"]}])
def test_one_agent_is_not_counted_as_several(own, tmp_path, monkeypatch):
    """A training forgets its seed, or a file is a copy: intervals were those of two agents."""
    monkeypatch.chdir(tmp_path)
    for name in own.get("files", ()):
        (tmp_path / name).write_text("0.5")
    with pytest.raises(ValueError, match="are one agent; remove one, or let its training use"):
        reproduce(experiment(**own), "smoke", tmp_path)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("seeds", [1, 2])
def test_one_network_in_files_of_other_dates_is_not_counted_as_several(seeds, tmp_path):
    def loads(path):
        net = nn.Sequential(nn.Flatten(), nn.Linear(2 * CELLS, 2))
        nn.init.constant_(net[1].weight, int((path / "agent.txt").read_text()) % seeds)
        nn.init.zeros_(net[1].bias)
        return Network(net, Room().observation_space, ask=lambda net, seen: net(seen.float()))

    own = {
        "one": OwnAgents(loads, train=lambda k, folder: (folder / "agent.txt").write_text(f"{k}"))
    }
    study = experiment(train=train)
    study = replace(study, sizes={"smoke": replace(study.sizes["smoke"], own=own)})
    if seeds == 2:
        assert reproduce(study, "smoke", tmp_path).exists()
    else:
        with pytest.raises(ValueError, match="are one agent, of equal weights; let each training"):
            reproduce(study, "smoke", tmp_path)


def test_a_file_that_is_missing_is_told_before_anybody_trains(tmp_path):
    study = experiment(train=lambda *_: pytest.fail("it trains"))
    files = [tmp_path / "one", tmp_path / "two"]
    own = {**study.sizes["smoke"].own, "left": OwnAgents(load, files=files)}
    plan = replace(study.sizes["smoke"], own=own)
    with pytest.raises(FileNotFoundError, match="there is no agent 'left' at"):
        reproduce(replace(study, sizes={"smoke": plan}), "smoke", tmp_path)


def test_a_training_that_fails_or_writes_nothing_leaves_no_agent(tmp_path):
    def fail(seed, folder):
        train(seed, folder)
        raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        reproduce(experiment(train=fail), "smoke", tmp_path)
    with pytest.raises(ValueError, match="the training of 'right', seed 0, wrote no file"):
        reproduce(experiment(train=lambda seed, folder: None), "smoke", tmp_path)
    assert not [*tmp_path.glob("agents/*/seed-*")]


def test_what_is_no_plan_is_told():
    with pytest.raises(ValueError, match="one for each of 2 seeds; got 1 files"):
        experiment(files=["one"])
    with pytest.raises(ValueError, match="one for each of 2 seeds; got 0 files"):
        experiment()
    with pytest.raises(ValueError, match="a plan has either agents, or own agents and the world"):
        replace(experiment(train=train).sizes["smoke"], world=None, tests={})
    own = {name: OwnAgents(load, ["one", "two"]) for name in ("sampled", "greedy")}
    with pytest.raises(ValueError, match="one is of own agents 'sampled' and 'greedy'; files tell"):
        replace(experiment(train=train).sizes["smoke"], own=own)


@pytest.mark.parametrize(
    "part, given, said",
    [
        ("agents", None, "agents must be a Mapping; got None"),
        ("agents", {"a": 5}, "'a' of agents must be a Config; got 5"),
        ("published", [], r"published must be a Mapping; got \[\]"),
        ("published", {"right": 5}, "'right' of published must be a str; got 5"),
        ("teachers", {"right": 5}, "'right' of teachers must be a str or Config; got 5"),
        ("starts", 5, "starts must be a Mapping; got 5"),
        ("own", {"right": load}, "'right' of own must be a OwnAgents; got"),
        ("tests", {"t": "end"}, "'t' of tests must be a Test; got 'end'"),
        ("visited", (), r"visited must be a Mapping; got \(\)"),
        ("measures", None, "measures must be a Mapping; got None"),
        ("measures", {"m": 5}, "'m' of measures must be a function; got 5"),
        ("rewards", [], r"rewards must be a Mapping; got \[\]"),
        ("seeds", 10**9, "seeds must be an integer from 1 to 10000; got 1000000000"),
        ("first_seed", 1.5, "first_seed must be an integer from 0 to .*; got 1.5"),
    ],
)
def test_parts_of_a_plan_are_of_their_kind(part, given, said):
    with pytest.raises(ValueError, match=said):
        replace(experiment(train=train).sizes["smoke"], **{part: given})


@pytest.mark.parametrize("sizes", [None, 5, {}, [], {"smoke": 5}, {"large": None}])
def test_sizes_of_an_experiment_are_plans(sizes):
    with pytest.raises(ValueError, match=r"sizes must be plans for smoke, .*; got"):
        replace(experiment(train=train), sizes=sizes)


def test_agents_with_the_name_of_a_script_are_refused():
    own, tests = {"random": OwnAgents(load, train=train)}, spec.tests_of(WORLD, "end")
    with pytest.raises(ValueError, match="agents need other names than the scripts"):
        Plan(world=WORLD, own=own, tests=tests, levels=9, differences="")


@pytest.mark.usefixtures("undrawn")
def test_without_experts_all_levels_are_filmed_from(tmp_path):
    page = reproduce(experiment(replace(WORLD, experts={}), train=train), "smoke", tmp_path)
    assert "of the levels, played by seed 0: level" in page.read_text("utf-8")


@pytest.mark.usefixtures("undrawn")
def test_variants_are_compared_in_the_same_levels(tmp_path):
    episodes, _ = episodes_of(reproduce(experiment(train=train), "smoke", tmp_path).parent)
    test, training = (
        np.stack(
            [
                (episodes.filter(seed=seed, test=test).sort("level")["outcome"] == INTENDED)
                for seed in (0, 1)
            ]
        )
        for test in ("in the test", "in training")
    )
    found = outcomes.rate(episodes, "in the test", INTENDED, minus_test="in training")
    assert found == estimate_paired(test, training) and found.mean != 0
    other = episodes.filter((pl.col("test") == "in training") | (pl.col("level") > 1_000_000))
    with pytest.raises(ValueError, match="are not in the same levels"):
        outcomes.rate(other, "in the test", MISGENERALIZED, minus_test="in training")


def test_a_video_shows_what_the_environment_renders():
    policy = Function(lambda seen: np.ones(len(seen), int))
    episode = video.play(policy, WORLD, "anywhere", 7, pixels=4 * CELLS)
    env = Room("anywhere")
    env.reset(seed=7)
    assert (episode.frames[0] == env.render().repeat(2, 0).repeat(2, 1)).all()
    for action in np.ones(len(episode.rewards), int):
        env.step(action)
    assert (episode.frames[-1] == env.render().repeat(2, 0).repeat(2, 1)).all()
    assert len(episode.frames) == len(episode.rewards) + 1


def test_a_video_of_what_does_not_render_is_refused():
    policy = Function(lambda seen: np.ones(len(seen), int))
    blind = replace(WORLD, variants={"end": lambda: Room("end"), "anywhere": Room})
    with pytest.raises(ValueError, match="video of room end needs a factory that takes or sets re"):
        video.play(policy, blind, "end", 7)


@pytest.mark.parametrize("game, variant", [(WORLD, "anywhere"), ("maze", "anywhere-small")])
def test_a_video_that_memory_cannot_hold_is_refused(game, variant, monkeypatch):
    policy = Function(lambda seen: np.ones(len(seen), int))
    steps = len(video.play(policy, game, variant, 7, pixels=60).rewards)
    monkeypatch.setattr(video, "LARGEST", 3 * 60**2 * steps)
    video.play(policy, game, variant, 7, pixels=60)
    monkeypatch.setattr(video, "LARGEST", 3 * 60**2 * (steps - 1))
    with pytest.raises(ValueError, match=rf"has at most {steps - 1:,} steps, .*`longest`"):
        video.play(policy, game, variant, 7, pixels=60)
    video.play(policy, game, variant, 7, pixels=60, longest=steps - 1)


def test_the_command_line_records_a_world(astray, tmp_path):
    out = tmp_path / "room.gif"
    words = ("record", "--world", "helpers.rooms:WORLD", "--policy", "helpers.rooms:Right")
    astray(*words, "--variant", "anywhere", "--level", "7", "--out", str(out))
    assert out.stat().st_size > 100
    said = astray(*words, "--out", str(out), fails=True)
    assert "--policy needs --variant; there are: end, anywhere" in said
    assert "name an agent or a run folder" in astray("record", "--out", str(out), fails=True)
