"""Anything at all is given to everything that takes something: it works, or says what is wrong.

ASTRAY_FUZZ multiplies how much is tried; `make fuzz` sets it, and counts in ASTRAY_FUZZ_LOG.
"""

import contextlib
import io
import json
import os
import string
import sys
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from safetensors.torch import save as to_bytes

from astray import cli, games
from astray.agents import policy
from astray.cli import arguments
from astray.envs.states import load_states, save_states
from astray.envs.vector import GameVectorEnv
from astray.experiments import spec
from astray.experiments.spec import SIZES, Experiment, Plan
from astray.level import Level
from astray.training import checkpoint
from astray.training.config import PRESETS, Config

MORE = int(os.environ.get("ASTRAY_FUZZ", "1"))
QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck), "database": None}
GAMES = list(games.OWN)
SMALLEST = {name: min(games.find(name).variants.values(), key=lambda v: games.find(name)
            .symbols.planes(v).size) for name in GAMES}  # fmt: skip


def tries(examples):
    """Settings for so many examples of an input each, and MORE times as many."""
    return settings(max_examples=examples * MORE, **QUIET)


@pytest.fixture(scope="module", autouse=True)
def count():
    """How many inputs were tried and how many of them refused, by kind; told at the end."""
    told: dict[str, list[int]] = {}
    count.told = told
    yield
    if log := os.environ.get("ASTRAY_FUZZ_LOG"):
        with open(log, "a") as file:
            file.write(json.dumps(told) + "\n")


def tried(kind, refused, inputs=1):
    counts = count.told.setdefault(kind, [0, 0])
    counts[0] += inputs
    counts[1] += refused


# Levels


@st.composite
def drawings(draw):
    """A drawing of a level with some characters changed, rows lost or doubled, or any text."""
    game = draw(st.sampled_from(GAMES))
    made, kind = games.find(game), SMALLEST[game]
    level = beginning(game, draw(st.integers(0, 50)))
    chars = "".join(made.editing.LEGEND) + "@?; \n"
    rows = str(level).split("\n")
    for _ in range(draw(st.integers(0, 4))):
        y = draw(st.integers(0, len(rows) - 1))
        x = draw(st.integers(0, max(len(rows[y]) - 1, 0)))
        rows[y] = rows[y][:x] + draw(st.sampled_from(chars)) + rows[y][x + 1 :]
    if draw(st.integers(0, 9)) == 0:
        rows.pop(draw(st.integers(0, len(rows) - 1)))
    if draw(st.integers(0, 9)) == 0:
        return made, kind, draw(st.text(chars, max_size=80))
    return made, kind, "\n".join(rows)


LEVELS: dict = {}


def beginning(game, number):
    """Level `number` of the game's smallest variant."""
    if (game, number) not in LEVELS:
        env = GameVectorEnv(game, SMALLEST[game], observation="symbolic")
        env.reset(seed=0, options={"level": number})
        LEVELS[game, number] = Level.of(env.game, env.variant, env.states[0])
    return LEVELS[game, number]


@tries(150)
@given(drawings(), st.booleans())
def test_a_drawing_is_a_level_or_is_refused(drawn, solvable):
    made, kind, drawing = drawn
    try:
        level = Level.from_text(made, kind, drawing)
        s = level.state(solvable=solvable)
    except ValueError as error:
        assert str(error)
        tried("drawings", 1)
        return
    states = np.array([s], made.state)
    made.check(states, kind)
    again = Level.of(made, kind, s)
    height, width = level.cells.shape  # CoinRun puts smaller ones into its world
    assert np.array_equal(again.cells[:height, :width], level.cells)
    assert again.agent == level.agent
    if solvable:
        reachable = made.solver.reachable(s)
        assert all(reachable[y, x] for name in made.editing.OBJECTS for x, y in level.where(name))
    tried("drawings", 0)


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda part: (
        st.lists(part, max_size=3) | st.dictionaries(st.text(max_size=5), part, max_size=3)
    ),
    max_leaves=5,
)  # fmt: skip


@tries(150)
@given(st.data())
def test_json_is_a_level_or_is_refused(data):
    game = data.draw(st.sampled_from(GAMES))
    level = beginning(game, data.draw(st.integers(0, 50)))
    told = json.loads(json.dumps(level.to_json()))
    for _ in range(data.draw(st.integers(0, 3))):
        name = data.draw(st.sampled_from([*told, "more"]))
        value = data.draw(ANYTHING | st.sampled_from(list(told.values())))
        if name == "grid" and data.draw(st.booleans()):
            row = data.draw(st.integers(0, len(level.cells) - 1))
            value = [list(map(int, r)) for r in level.cells]
            value[row][data.draw(st.integers(0, len(value[row]) - 1))] = data.draw(
                st.sampled_from(sorted(level.game.editing.LEGEND.values()))
            )
        if name == "looks" and data.draw(st.booleans()):
            looks = level.to_json()["looks"]
            value = looks | {data.draw(st.sampled_from(list(looks))): value}
        told[name] = value
    if data.draw(st.integers(0, 9)) == 0:
        told = data.draw(ANYTHING)
    try:
        made = Level.from_json(level.game, level.variant, told)
        s = made.state(solvable=False)
    except ValueError:
        tried("levels as JSON", 1)
        return
    level.game.check(np.array([s], level.game.state), level.variant)
    for name, value in made.to_json().items():
        if name in told and name not in ("game", "looks"):
            assert value == told[name] or [value] == [told[name]]
    tried("levels as JSON", 0)


# States

BATCH = 100
RUINS = ("byte", "field", "extreme")


@tries(125)
@given(st.sampled_from(GAMES), st.integers(0, 2**32), st.sampled_from(RUINS))
def test_a_ruined_state_is_refused_or_plays_on(game, seed, ruin):
    rng = np.random.default_rng(seed)
    made = games.find(game)
    names = list(made.variants)
    kind = made.variants[names[int(rng.integers(len(names)))]]
    env = GameVectorEnv(game, kind, BATCH, autoreset_mode="SameStep", observation="symbolic")
    env.reset(seed=seed)
    for _ in range(int(rng.integers(20))):
        env.step(rng.integers(len(made.actions), size=BATCH))
    states = ruined(env.get_state(), rng, ruin)
    good = []
    for k in range(BATCH):
        try:
            made.check(states[k : k + 1], kind)
            good += [] if states["ended"][k] else [k]
        except ValueError as error:
            assert str(error)
    tried("states", BATCH - len(good), BATCH)
    if not good:
        return
    player = GameVectorEnv(game, kind, len(good), autoreset_mode="SameStep",
                           observation=["image", "symbolic"][seed % 2])  # fmt: skip
    seen = player.set_state(states[good])
    for _ in range(3):
        assert seen in player.observation_space
        made.check(player.states, kind)
        seen = player.step(rng.integers(len(made.actions), size=len(good)))[0]


def ruined(states, rng, how):
    """`states` with bytes or fields changed."""
    rows = states.view(np.uint8).reshape(len(states), -1)
    names = [name for name in states.dtype.names if name not in ("mt", "gap")]
    for k in range(len(states)):
        if how == "byte":
            for _ in range(int(rng.integers(1, 4))):
                rows[k, rng.integers(rows.shape[1])] = rng.integers(256)
            continue
        name = names[int(rng.integers(len(names)))]
        field = states[name][k : k + 1]
        if how == "extreme" and field.dtype.kind in "iuf":
            values = {
                "i": [-1, 0, 1, 2**62, -(2**62), 64, 2**31],
                "u": [0, 1, 9, 255],
                "f": [np.nan, np.inf, -np.inf, 0, -0.5, 1e300, 64.5],
            }
            with np.errstate(over="ignore"):
                field[...] = rng.choice(values[field.dtype.kind])
        else:
            other = states[name][int(rng.integers(len(states)))]
            field[...] = other
    return states


@tries(30)
@given(data=st.data())
def test_a_ruined_file_of_states_is_refused_or_whole(data, tmp_path_factory):
    game = data.draw(st.sampled_from(GAMES))
    path = tmp_path_factory.getbasetemp() / f"{os.getpid()}.npz"
    env = GameVectorEnv(game, SMALLEST[game], 2)
    env.reset(seed=0)
    save_states(path, game, env.get_state())
    path.write_bytes(changed(data, path.read_bytes()))
    try:
        found = load_states(path, game)
        env.set_state(found)
        tried("files of states", 0)
    except ValueError:
        tried("files of states", 1)


def changed(data, content):
    """`content` cut, or with some bytes changed, or something else."""
    how = data.draw(st.sampled_from(["cut", "change", "other"]))
    if how == "cut":
        return content[: data.draw(st.integers(0, len(content)))]
    if how == "other":
        return data.draw(st.binary(max_size=100))
    ruin = bytearray(content)
    for _ in range(data.draw(st.integers(1, 4))):
        last = min(len(ruin), data.draw(st.sampled_from([8, 400, len(ruin)])))
        ruin[data.draw(st.integers(0, last - 1))] = data.draw(st.integers(0, 255))
    return bytes(ruin)


# Checkpoints

CONFIG = replace(PRESETS["small"], variant="corner-small", environments=2, rollout=4, minibatches=2,
                 width=8)  # fmt: skip


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A trainer, and the folder of its checkpoint."""
    folder = tmp_path_factory.mktemp("run")
    trainer = checkpoint.Trainer(CONFIG)
    for parameter in trainer.network.parameters():
        parameter.grad = parameter * 0
    trainer.optimizer.step()
    checkpoint.save(folder, trainer)
    return trainer, folder / "checkpoints" / "0"


@tries(60)
@given(data=st.data())
def test_a_ruined_agent_is_refused_or_an_agent(data, saved):
    path = saved[1].parent / "agent.safetensors"
    path.write_bytes(changed(data, (saved[1] / checkpoint.AGENT).read_bytes()))
    try:
        network, _ = policy.load(path, "maze")
        assert sum(p.numel() for p in network.parameters()) < 10_000
        tried("agents", 0)
    except ValueError as error:
        assert str(error).startswith(str(path))
        tried("agents", 1)


@tries(60)
@given(data=st.data())
def test_an_architecture_is_refused_or_that_of_its_weights(data, saved):
    path = saved[1].parent / "agent.safetensors"
    network, architecture = policy.load(saved[1] / checkpoint.AGENT, "maze")
    told = asdict(architecture)
    for _ in range(data.draw(st.integers(0, 2))):
        told[data.draw(st.sampled_from([*told, "more"]))] = data.draw(
            ANYTHING | st.integers(-1, 10**12) | st.lists(st.integers(-1, 10**6), max_size=4)
        )
    header = policy.header("maze", architecture=told)
    path.write_bytes(to_bytes(network.state_dict(), header))
    try:
        policy.load(path, "maze")
        tried("architectures", 0)
    except ValueError:
        tried("architectures", 1)


@tries(30)
@given(data=st.data())
def test_a_ruined_trainer_is_refused_or_goes_on(data, saved):
    trainer, folder = saved
    path = folder / checkpoint.TRAINER
    whole = path.read_bytes()
    path.write_bytes(changed(data, whole))
    try:
        checkpoint.restore(folder.parent.parent, trainer)
        tried("trainers", 0)
        env = trainer.player.envs[0]
        env.game.check(env.states, env.variant)
    except ValueError:
        tried("trainers", 1)
    finally:
        path.write_bytes(whole)


@tries(100)
@given(
    st.dictionaries(
        st.sampled_from([f.name for f in fields(Config)] + ["more"]),
        ANYTHING | st.sampled_from(["maze", "corner", 1, 0.5]),
        max_size=3,
    )
)
def test_settings_are_refused_or_kept(changes):  # fmt: skip
    try:
        config = Config.from_json(json.loads(json.dumps(CONFIG.to_json() | changes)))
    except ValueError:
        tried("settings", 1)
        return
    for name, value in changes.items():
        if name != "training_variant":
            assert getattr(config, name) == value
    tried("settings", 0)


@tries(100)
@given(st.data())
def test_knobs_are_refused_or_make_levels(data):
    game = data.draw(st.sampled_from(GAMES))
    made = games.find(game)
    name = data.draw(st.sampled_from(list(made.variants)))
    names = [f.name for f in fields(made.variants[name])] + ["more"]
    value = ANYTHING | st.integers(-2, 40) | st.sampled_from(["none", "corner", "1", "true", "2.5"])
    changes = data.draw(st.dictionaries(st.sampled_from(names), value, max_size=3))
    try:
        variant = games.find(game).variant(name).with_knobs(changes)
    except ValueError:
        tried("knobs", 1)
        return
    env = GameVectorEnv(game, variant, 2, observation="symbolic", autoreset_mode="SameStep")
    seen, _ = env.reset(seed=0)
    assert seen in env.observation_space
    made.check(env.states, variant)
    env.step(np.zeros(2, int))
    tried("knobs", 0)


# Experiments


@tries(60)
@given(st.data())
def test_an_experiment_is_refused_or_can_be_run(data):
    game = data.draw(st.sampled_from(GAMES))
    made = games.find(game)
    words = st.sampled_from([*made.variants, *made.shifts, *GAMES, "more"])

    def mostly(*right):  # one draw in ten is of anything
        return data.draw(words if data.draw(st.integers(0, 9)) == 0 else st.sampled_from(right))

    shift = mostly(*made.shifts)
    train = made.shifts[shift].train if shift in made.shifts else "corner"
    knobs = (
        {mostly("time_limit"): data.draw(st.integers(-1, 9))} if data.draw(st.booleans()) else {}
    )
    played = data.draw(st.booleans())
    try:
        agents = {
            name: replace(CONFIG, game=mostly(game), variant=mostly(train))
            for name in ("one", "two")[: data.draw(st.integers(0, 2))]
        }
        plan = Plan(
            agents=agents, seeds=data.draw(st.integers(0, 9)),
            tests={"test": spec.Test(mostly(*made.variants), shift, knobs)} if played else {},
            levels=data.draw(st.integers(-1, 10) | st.integers(2**31 - 200_000, 2**31)), smaller="",
        )  # fmt: skip
        size = data.draw(st.sampled_from(["smoke", "hour", "paper", "tiny"]))
        Experiment("", "", "", {size: plan}, find=print)
    except ValueError:
        tried("experiments", 1)
        return
    assert plan.seeds >= 1 and size in SIZES and len(plan.trainings()) == len(agents)
    for config in agents.values():
        assert 1 <= plan.levels <= len(config.unseen_levels)
        for test in plan.tests.values():
            assert test.variant_for(config).time_limit >= 1 and test.shift in made.shifts
    tried("experiments", 0)


# The command line

WORDS = st.sampled_from([
    "maze", "coinrun", "keys", "chess", "corner", "anywhere-small", "corner-xs", "--numbers",
    "--set", "--json", "--text", "--level", "--level-file", "--actions", "--levels", "--variant",
    "--shift", "--mode", "--batch", "--preset", "--seeds", "--folder", "--size", "--workers", "0",
    "5:8", "-1", "3", "1e9", "99999999999999999999", "a=b", "time_limit=5", "world=x", "smoke",
    "paper", "small", "greedy", "/nowhere", "", "-", "--", "\x00", "é", "--help", "--no-json",
    "--pixels", "--out", "x.gif", "--unsolvable", "--environments", "--rollout", "--steps",
])  # fmt: skip
VERBS = (
    "list", "level", "replay", "evaluate", "record", "train", "reproduce", "agency", "levels", "",
)  # fmt: skip


@tries(15)
@given(st.sampled_from(VERBS), st.lists(WORDS, max_size=6))
def test_a_command_does_something_or_says_what_is_wrong(verb, words):
    with pytest.MonkeyPatch.context() as patch:
        # What they would do takes long, and is tested elsewhere.
        patch.setattr("astray.training.loop.train", lambda *a, **k: Path("trained"))
        patch.setattr("astray.experiments.run.reproduce", lambda *a, **k: Path("reported"))
        patch.setattr(sys, "argv", ["astray", *([verb] if verb else []), *words])
        patch.setattr(sys, "stdin", io.StringIO("left right"))
        said, failed = io.StringIO(), io.StringIO()
        code = 0
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(failed):
            try:
                cli.main()
            except SystemExit as exit_:
                code = exit_.code or 0
    assert code in (0, 2), (verb, words, code)
    assert (said.getvalue() if code == 0 else failed.getvalue()).strip() or verb == "list"
    tried("commands", code == 2)


@tries(60)
@given(st.text(string.digits + ",:- x", max_size=12))
def test_level_numbers_are_refused_or_in_range(text):
    try:
        found = arguments.level_numbers(text)
    except ValueError as error:
        assert "level" in str(error)
        tried("level numbers", 1)
        return
    assert found.size and found.min() >= 0 and found.max() < 2**31 - 1
    tried("level numbers", 0)


# Environments, in any order


class Environments(RuleBasedStateMachine):
    """Resets, steps, masks, states and edited levels in any order, beside a second environment.

    The second never shares a batch with others, and is restored from the first's states at every
    turn: what it does must be the same.
    """

    @initialize(
        game=st.sampled_from(GAMES),
        mode=st.sampled_from(["SameStep", "Disabled", "NextStep"]),
        seed=st.integers(0, 2**40),
        threads=st.integers(1, 2),
        pick=st.integers(0, 99),
    )
    def begin(self, game, mode, seed, threads, pick):  # fmt: skip
        made = games.find(game)
        kind = list(made.variants.values())[pick % len(made.variants)]
        kind = replace(kind, time_limit=7)
        options = {"autoreset_mode": mode, "observation": "symbolic"}
        self.mode, self.game = mode, made
        self.env = GameVectorEnv(game, kind, 3, threads=threads, **options)
        self.alone = GameVectorEnv(game, kind, 1, **options)
        self.seen, _ = self.env.reset(seed=seed)
        self.kept = self.env.get_state()

    @rule(seed=st.none() | st.integers(0, 2**40), level=st.none() | st.integers(0, 2**31 - 2),
          mask=st.lists(st.booleans(), min_size=3, max_size=3))  # fmt: skip
    def reset(self, seed, level, mask):
        options = {"reset_mask": np.array(mask)} | ({} if level is None else {"level": level})
        before = self.env.get_state()
        self.seen, _ = self.env.reset(seed=seed, options=options)
        for k in range(3):
            if not mask[k]:
                assert self.env.states[k].tobytes() == before[k].tobytes()
            elif level is not None:
                assert self.env.states[k].level == level and self.env.states[k].time == 0
        tried("turns of environments", 0)

    @precondition(lambda self: not (self.mode == "Disabled" and self.env.states.ended.any()))
    @rule(seed=st.integers(0, 2**32))
    def step(self, seed):
        actions = np.random.default_rng(seed).integers(len(self.game.actions), size=3)
        before = self.env.get_state()
        self.seen, reward, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        assert not (terminated & truncated).any() and np.isfinite(reward).all()
        if ended.any() and self.mode == "SameStep":
            assert (info["final_info"]["time"][ended] <= 7).all()
        for k in range(3):
            self.alone.set_state(before[k])
            seen, *told, _ = self.alone.step(actions[k : k + 1])
            assert seen[0].tobytes() == self.seen[k].tobytes()
            assert [x[0] for x in told] == [reward[k], terminated[k], truncated[k]]
        tried("turns of environments", 0)

    @rule()
    def keep(self):
        self.kept = self.env.get_state()

    @rule()
    def go_back(self):
        self.seen = self.env.set_state(self.kept)
        assert self.env.get_state().tobytes() == self.kept.tobytes()
        tried("turns of environments", 0)

    @rule(name=st.integers(0, 9), place=st.integers(0, 10**6), mask=st.integers(1, 7))
    def edit(self, name, place, mask):
        which = np.array([bool(mask >> k & 1) for k in range(3)])
        first = int(which.argmax())
        self.env.reset(options={"reset_mask": which})
        level = Level.of(self.game, self.env.variant, self.env.states[first])
        there = [n for n in ("agent", *self.game.editing.OBJECTS) if n == "agent" or level.where(n)]
        name = there[name % len(there)]
        family = level.splay(name, level.where(name)[0] if name != "agent" else None)
        edited = family[place % len(family)]
        self.seen, _ = self.env.reset(options={"level": edited, "reset_mask": which})
        now = Level.of(self.game, self.env.variant, self.env.states[first])
        assert str(now) == str(edited)
        tried("turns of environments", 0)

    @invariant()
    def all_is_well(self):
        if hasattr(self, "env"):
            assert self.seen in self.env.observation_space
            self.game.check(self.env.states, self.env.variant)

    def teardown(self):
        if hasattr(self, "env"):
            self.env.close()


TestEnvironments = Environments.TestCase
TestEnvironments.settings = settings(max_examples=15 * MORE, stateful_step_count=25, **QUIET)
