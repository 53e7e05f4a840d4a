"""The benchmarks run in miniature, say what they did not measure, and reckon ratios right."""

import sys
from dataclasses import replace
from io import StringIO

import numba
import pytest
import torch
from rich.console import Console
from rich.table import Table

import astray
from astray import games
from astray.agents.policy import Architecture
from astray.art import original
from astray.cli.experiments import bench
from astray.envs.vector import GameVectorEnv
from astray.experiments import catalogue
from astray.training.teacher import Teacher
from benchmarks import agency, costs, environments, insight, profile, start, tables, train, worlds
from benchmarks.plain import Loop
from helpers.foreign import procgen_of_envpool

TINY = replace(train.SYMBOLIC[0], num_envs=8, num_steps=8, minibatches=2, width=8)


def speed(row):
    assert row.steps_per_second is not None
    return row.steps_per_second


@pytest.fixture
def small(monkeypatch):
    """The rates of a product and a copy are measured with small ones."""
    monkeypatch.setattr(profile, "SIDE", 256)
    monkeypatch.setattr(profile, "COPIED", 2**20)


@pytest.fixture(scope="module")
def rows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "envpool", None)
        return environments.measure_game(
            "maze", "anywhere-small", "Nothing", 0.01, 2, batches=(4, 8)
        )


def test_every_contender_gets_a_row(rows):
    what = [(row.what, row.batch, row.threads) for row in rows]
    images = [("images", batch, threads) for batch in (4, 8) for threads in (1, 2)]
    drawn = [("images, original art", batch, 1) for batch in (4, 8)]
    symbols = [("symbolic", batch, 1) for batch in (4, 8)]
    beside = [("images beside a busy process", 4, threads) for threads in (1, 2)]
    at_hand = set(original.missing()) <= set(original.FORK_ALONE)
    measured = [*images, *(drawn if at_hand else []), *symbols, *beside]
    assert what[: len(measured)] == measured
    others = [one for one, *_ in what[len(measured) :]]
    original_row = [] if at_hand else ["images, original art"]
    assert others == [*original_row, "EnvPool Nothing", "memory copy"]


def test_rates_are_positive_and_the_best_round_is_not_below_the_median(rows):
    for row in rows[:-2]:
        if "astray art import" in row.note:
            continue
        assert 0 < row.steps_per_second <= row.best
    assert rows[-1].gigabytes_per_second > 0


def test_bytes_are_those_of_the_observations(rows):
    assert rows[0].gigabytes_per_second == pytest.approx(rows[0].steps_per_second * 64**2 * 3 / 1e9)


def test_ratios_are_those_of_the_rows(rows):
    one, two, copy = rows[0], rows[1], rows[-1]
    assert two.to_one_thread == two.steps_per_second / one.steps_per_second
    assert one.of_copy == one.gigabytes_per_second / copy.gigabytes_per_second
    assert one.to_one_thread is None and one.to_peer is None


def test_a_world_without_an_original_is_measured_alone():
    images, symbols = environments.measure(["lavaland"], seconds=0.01, rounds=1)
    assert (images.what, symbols.what) == ("images", "symbolic")
    assert images.steps_per_second and symbols.steps_per_second


def test_a_game_is_measured_beside_envpool():
    procgen_of_envpool()
    rows = environments.measure_game("maze", "anywhere", "MazeHard-v0", 0.01, 1, batches=(4,))
    peer = next(row for row in rows if row.what == "EnvPool MazeHard-v0")
    assert rows[0].to_peer == speed(rows[0]) / speed(peer)


def test_without_envpool_the_row_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "envpool", None)
    rows = environments.measure_game("maze", "anywhere", "MazeHard-v0", 0.01, 1, batches=(4,))
    peer = next(row for row in rows if row.what == "EnvPool MazeHard-v0")
    assert "pip install envpool" in peer.note and peer.steps_per_second is None
    assert rows[0].to_peer is None


@pytest.mark.parametrize("name", games.OWN)
def test_what_is_measured_is_there(name):
    assert games.find(name).benchmark.variant in games.find(name).variants


def test_a_first_start_is_told_beside_the_median_of_later_ones(monkeypatch):
    told = iter([(8.0, 7.0), (1.5, 1.0), (1.25, 1.1), (9.0, 9.0)])
    monkeypatch.setattr(start, "_start", lambda *_: next(told))
    row = start.measure_game("maze", "corner-small", rounds=3)
    assert (row.first, row.first_cpu, row.later, row.later_cpu) == (8.0, 7.0, 1.5, 1.1)
    assert "| maze corner-small | 8.0 | 7.0 | 1.50 | 1.10 |" in tables.markdown([row])


@pytest.mark.thorough  # `test_processes_that_start_at_once_share_what_one_compiles` compiles one
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_first_start_compiles_and_a_later_one_does_not():
    row = start.measure_game("maze", "corner-small", rounds=1)
    assert 0 < 2 * row.later_cpu < row.first_cpu
    assert f"| maze corner-small | {row.first:.1f} |" in tables.markdown([row])


def test_a_world_is_measured_beside_a_plain_loop():
    (row,) = worlds.measure(["CartPole-v1"], rounds=1, steps=3, batch=2)
    assert row.plain > 0 and row.cells()["ratio"] == f"{row.world / row.plain:.2f}"


def test_training_is_measured_beside_stable_baselines3(small):
    pytest.importorskip("stable_baselines3")
    threads = torch.get_num_threads()
    ours, peer, *_ = train.measure([TINY], seconds=0.02, rounds=2)
    assert 0 < speed(ours) <= (ours.best or 0) and 0 < speed(peer) <= (peer.best or 0)
    assert peer.ratio == speed(ours) / speed(peer)
    assert torch.get_num_threads() == threads


def test_without_stable_baselines3_the_row_says_how_to_install_it(small, monkeypatch):
    monkeypatch.delitem(sys.modules, "benchmarks.sb3", raising=False)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    ours, peer, *_ = train.measure([TINY], seconds=0.02, rounds=2)
    assert speed(ours) > 0 and peer.ratio is None
    assert "pip install stable-baselines3" in peer.note


def test_training_on_images_is_measured_beside_plain_loops(small, monkeypatch):
    monkeypatch.setitem(sys.modules, "envpool", None)
    config = replace(train.IMAGES, num_envs=2, num_steps=2, minibatches=1, epochs=1)
    rows = train.measure([config], seconds=0.02, rounds=1)
    ours, missing, plain, original, *parts = rows
    assert speed(ours) > 0 and "pip install envpool" in missing.note
    assert plain.ratio == speed(ours) / speed(plain) and speed(original) > 0
    assert {type(part) for part in parts} == {profile.Row}
    assert tables.markdown(rows).count("| --- | ---:") == 2


@pytest.fixture
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def test_the_parts_of_an_iteration_come_near_to_the_whole(small, one_thread):
    config = replace(train.SYMBOLIC[0], num_envs=64, num_steps=16, minibatches=4)
    *parts, minibatch, whole = profile.measure(config, rounds=3)
    assert minibatch.part == "a minibatch, whole" and whole.fraction == 1
    assert all(part.milliseconds > 0 for part in parts)
    total = sum(part.milliseconds for part in parts)
    assert 0.3 < total / whole.milliseconds < 3  # on a machine that does other things too
    assert whole.floor == pytest.approx(sum(part.floor or 0 for part in parts))


def test_a_plain_loop_learns():
    config = replace(train.IMAGES, num_envs=4, num_steps=4, minibatches=2)
    network = Architecture("impala", (64, 64, 3), (), 15).build()
    before = [weight.clone() for weight in network.parameters()]
    for host in (True, False):
        env = GameVectorEnv("coinrun", "coin-end", 4, autoreset_mode="SameStep")
        Loop(config, network, env, host).iterate()
    assert all(not torch.equal(a, b) for a, b in zip(before, network.parameters(), strict=True))


def test_a_table_has_a_line_for_each_row(rows):
    lines = tables.markdown(rows).partition("\n\n")[0].splitlines()
    assert len(lines) == 2 + len(rows)
    assert len({line.count("|") for line in lines}) == 1
    text = StringIO()
    Console(file=text, width=200).print(tables.table(rows))
    assert text.getvalue().count("maze anywhere-small") == len(rows)


@pytest.mark.parametrize(
    "x, text", [(1_234_567, "1,230"), (98_765, "98.8"), (9_876, "9.88"), (None, "-")]
)
def test_rates_are_given_to_three_digits(x, text):
    assert tables.thousands(x) == text


def test_the_agency_measure_gets_a_row_for_each_preset_and_number():
    rows = agency.measure(numbers=(1, 2), steps=3, rounds=1)
    assert [(row.preset, row.trajectories) for row in rows] == [
        ("paper", 1), ("paper", 2), ("calibrated", 1), ("calibrated", 2)
    ]  # fmt: skip
    first = rows[0]
    assert first.to_fewest == 1 and rows[1].to_fewest == pytest.approx(
        rows[1].seconds / first.seconds / 2
    )
    assert "calibrated" in tables.markdown(rows)


def test_fields_get_a_row_for_each_network():
    rows = insight.measure(levels=(3, 1), rounds=1)
    assert [row.levels for row in rows] == [3, 1] and all(row.seconds > 0 for row in rows)
    assert rows[0].places > 3 and "places/s" in tables.markdown(rows)
    (table,) = tables.table(rows).renderables
    assert isinstance(table, Table) and table.row_count == 2


def test_where_there_is_no_clone_the_verb_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(astray, "__file__", str(tmp_path / "lib" / "astray" / "__init__.py"))
    with pytest.raises(ValueError, match="astray bench needs a clone of astray's repository"):
        bench("agency")


def test_in_a_clone_the_verb_finds_the_benchmarks(monkeypatch, capsys):
    monkeypatch.setattr(agency, "measure", lambda: agency_rows)
    agency_rows = [agency.Row("paper", 1, 2.0, 1.0)]
    bench("agency", markdown=True)
    assert "| paper | 1 | 2.00 | 1.00 |" in capsys.readouterr().out


def test_a_study_costs_what_its_agents_do_each_once_with_their_teachers(monkeypatch):
    def speeds(config, teacher, *_):
        assert (config.teacher is None) == (teacher is None)
        return (500.0 if config.teacher else 1000.0), 1000.0

    monkeypatch.setattr(costs, "speed", speeds)
    alone, taught = costs.measure(["maze-corner", "inherited-goals"], ["smoke"])
    plan = catalogue.load("maze-corner").sizes["smoke"]
    (mice,) = plan.agents.values()
    assert (alone.agents, alone.steps) == (plan.seeds, plan.seeds * mice.steps)
    assert alone.seconds == pytest.approx(alone.steps / 1000)
    plan = catalogue.load("inherited-goals").sizes["smoke"]
    lessons = plan.seeds * sum(plan.agents[name].steps for name in plan.teachers)
    assert taught.agents == plan.seeds * len(plan.agents)
    assert taught.seconds == pytest.approx(taught.steps / 1000 + lessons / 1000)  # all are lessons


def test_half_of_a_training_in_lessons_costs_the_mean_of_both_speeds():
    student = replace(TINY, teacher="solver", taught=0.5)
    assert costs.cost(student, 500.0, 1000.0) == pytest.approx(0.0015)
    assert costs.cost(TINY, 500.0, 1000.0) == pytest.approx(0.001)


def test_a_students_lessons_are_measured_with_its_teacher(monkeypatch):
    asked = []
    says = Teacher.says
    monkeypatch.setattr(Teacher, "says", lambda self, *at: asked.append(self) or says(self, *at))
    small = replace(TINY, steps=10 * TINY.batch)
    taught, alone = costs.speed(replace(small, teacher="a run"), small, 0.01, 1)
    assert taught > 0 and alone > 0 and asked
