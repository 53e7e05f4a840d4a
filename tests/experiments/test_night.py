"""Size night: the paper's own worlds, played to the end as the paper plays them."""

from dataclasses import replace
from pathlib import Path

import pytest

from astray.art.original import FORK_ALONE
from astray.experiments import catalogue, run, workers
from astray.experiments.spec import Plan, name_of_run
from astray.experiments.workers import expected
from astray.training.config import Config
from astray.training.folders import START, TEACHER, AgentFolder
from astray.training.levels import Growing
from astray.training.loop import train
from astray.training.settings import SEEDS
from helpers.drawn import MISSING
from helpers.trainings import TINY

NAMES = [name for name in catalogue.NAMES if {"night", "paper"} <= {*catalogue.load(name).sizes}]
PURE = 10_000_000  # steps of rewards alone in the variant's own levels, at least


def plans(name):
    sizes = catalogue.load(name).sizes
    return sizes["night"], sizes["paper"]


def test_the_studies_of_the_paper_have_a_night():
    assert set(NAMES) >= {
        "maze-corner", "maze-region", "colour-or-shape", "moved-coin", "coin-diversity",
        "permeable-wall", "critic-value", "keys-and-chests",
    }  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_night_trains_in_the_papers_worlds_on_a_processor(name):
    night, paper = plans(name)
    corner = catalogue.load("maze-corner").sizes["paper"].config  # which is region 1, called so
    there = {str(config.training_variant()) for config in (*paper.agents.values(), corner)}
    for config in night.agents.values():
        assert str(config.training_variant()) in there
        assert config.device == "cpu" and config.observation == "image"
        assert config.levels == 100_000
    assert {name: (t.variant, t.shift) for name, t in night.tests.items()} == {
        name: (t.variant, t.shift) for name, t in paper.tests.items()
    }
    assert night.differences and night.speed and night.seeds >= 2


@pytest.mark.parametrize("name", NAMES)
def test_a_night_ends_with_rewards_alone_in_the_papers_distribution(name):
    for config in plans(name)[0].agents.values():
        assert config.sampler.kind in ("uniform", "growing")
        grown = config.sampler.fraction or 0
        assert (1 - max(grown, config.taught if config.teacher else 0)) * config.steps >= PURE


def test_the_levels_of_a_night_have_grown_when_its_rewards_alone_teach():
    config: Config = plans("maze-corner")[0].config
    few, grown = Growing(replace(config, levels=300)), config.sampler.fraction
    assert grown
    few.plan(int(0.9 * grown * config.steps))
    assert few.count < 300
    for part in (grown, config.taught, 1.0):
        few.plan(int(part * config.steps))
        assert few.count == 300


@pytest.mark.parametrize("name", NAMES)
def test_how_long_a_night_takes_can_be_told(name, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "usable_processors", lambda: 2)
    night = plans(name)[0]
    trainings = night.trainings()
    configs = [c for name in night.agents for c in trainings[name]]
    told = expected({run.run_folder(tmp_path, c): c for c in configs}, night.speed, 2)
    hours = sum(c.steps for c in configs) / night.speed / 2 / 3600
    assert f"{len(configs)} agents, 0 of them trained" in told
    assert f"about {max(hours, configs[0].steps / night.speed / 3600):.1f} hours with 2" in told


def train_here(todo, *_):
    for folder, config in todo.items():
        train(config, folder, progress=False)


def test_agents_that_only_teach_are_trained_first_and_are_in_no_table(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "train_all", train_here)  # processes have tests of their own
    pupil = replace(TINY, levels=300, teacher="of the same seed", taught=0.5)
    teaching = replace(TINY, levels=300, width=8)
    plan = Plan(
        agents={"pupil": pupil}, teachers={"pupil": teaching}, seeds=2, levels=1, differences=""
    )
    runs = run.train_agents(plan, tmp_path, 1, "here")
    assert [*runs] == ["pupil"]
    for seed, folder in enumerate(runs["pupil"]):
        teacher = AgentFolder.open(run.run_folder(tmp_path, replace(teaching, seed=seed)))
        assert (folder / TEACHER).read_bytes() == teacher.weights.read_bytes()
        assert "update/kl" in (folder / "metrics.jsonl").read_text()


def test_an_agent_names_the_teacher_and_the_start_of_its_number_whose_solver_teaches_too():
    agents = {"pupil": replace(TINY, seed=9), "later": replace(TINY, seed=7)}
    teaching = {"pupil": replace(TINY, width=8, seed=5, teacher="solver", taught=0.5)}
    more = {"starts": {"later": "pupil"}, "seeds": 2, "first_seed": 3}
    made = Plan(agents=agents, teachers=teaching, **more, levels=1, differences="").trainings()
    names = {name: [name_of_run(one) for one in its] for name, its in made.items()}
    assert [one.teacher for one in made["pupil"]] == names["teacher of pupil"]
    assert [one.start for one in made["later"]] == names["pupil"]
    assert [(one.seed, one.teacher) for one in made["teacher of pupil"]] == [
        (8, "solver"), (9, "solver"),
    ]  # fmt: skip
    nobody = {"pupil": replace(teaching["pupil"], teacher="nobody")}
    with pytest.raises(ValueError, match="teacher of pupil is a student of nobody: name it in"):
        Plan(agents=agents, teachers=nobody, levels=1, differences="")


def test_a_teacher_sees_the_art_of_its_students():
    mouse = replace(TINY, observation="image", network="patch")
    how = {"teachers": {"pupil": mouse}, "levels": 1, "differences": ""}
    with pytest.raises(ValueError, match="teacher of pupil sees art 'own'; pupil has 'original'"):
        Plan(agents={"pupil": replace(mouse, art="original")}, **how)
    if MISSING - {*FORK_ALONE}:
        pytest.skip("the original's pictures are not imported")
    made = Plan(agents={"pupil": mouse}, **how).drawn_with("original").trainings()
    assert {one.art for its in made.values() for one in its} == {"original"}


@pytest.mark.parametrize("seed, first_seed", [(0, SEEDS - 1), (SEEDS - 1, 0), (5, SEEDS - 6)])
def test_more_agents_than_there_are_seeds_are_refused_by_their_number(seed, first_seed):
    agents = {"mouse": replace(TINY, seed=seed)}
    with pytest.raises(ValueError, match="seeds must be an integer from 1 to 1; got 2"):
        Plan(agents=agents, seeds=2, first_seed=first_seed, levels=1, differences="")


def test_agents_begin_with_those_of_their_seed_that_were_trained_before(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "train_all", train_here)  # processes have tests of their own
    mouse = replace(TINY, levels=300)
    agents = {
        "paid": replace(mouse, variant="anywhere-small", learning_rate=0.0),
        "later": replace(mouse, steps=512),
        "first": mouse,
    }
    starts = {"paid": "later", "later": "first"}
    plan = Plan(agents=agents, starts=starts, seeds=2, first_seed=3, levels=1, differences="")
    assert plan.phases() == [["first"], ["later"], ["paid"]]
    runs = run.train_agents(plan, tmp_path, 1, "here")
    for name, first in starts.items():
        for one, before in zip(runs[name], runs[first], strict=True):
            weights = AgentFolder.open(before).weights
            assert (one / START).read_bytes() == weights.read_bytes()
            assert one.name == before.name
    later, paid = (AgentFolder.open(runs[name][0]).weights for name in ("later", "paid"))
    assert later.read_bytes() == paid.read_bytes()  # with a learning rate of 0
    # Whoever begins with another agent is another agent.
    other = replace(plan, agents={**agents, "first": replace(mouse, levels=200)})
    assert not {run.run_folder(tmp_path, one) for one in plan.trainings()["paid"]} & {
        run.run_folder(tmp_path, one) for one in other.trainings()["paid"]
    }


@pytest.mark.parametrize(
    "starts, width, message",
    [
        ({"one": "nobody"}, 16, "must name agents of the plan that are trained here"),
        ({"one": "two", "two": "one"}, 16, "begin with each other's weights: one, two"),
        ({"one": "two"}, 8, "one begins with two, of width 8; got 16"),
    ],
)
def test_agents_that_cannot_begin_with_each_other_are_no_plan(starts, width, message):
    agents = {"one": TINY, "two": replace(TINY, width=width)}
    with pytest.raises(ValueError, match=message):
        Plan(agents=agents, starts=starts, levels=1, differences="")


def test_the_runners_of_a_night_have_teachers_of_their_coins_and_seeds():
    trainings = catalogue.load("coin-diversity").sizes["night"].trainings()
    pupils = {name: made for name, made in trainings.items() if made[0].teacher}
    assert len(pupils) == 3
    for name, made in pupils.items():
        for pupil, teacher in zip(made, trainings[f"teacher of {name}"], strict=True):
            assert (teacher.seed, teacher.knobs) == (pupil.seed, pupil.knobs)
            assert pupil.teacher == name_of_run(teacher) and teacher.observation == "symbolic"


def test_a_study_is_trained_on_another_device_as_the_same_agents():
    for name in NAMES:
        plan = catalogue.load(name).sizes["night"]
        there, here = replace(plan, device="cuda").trainings(), plan.trainings()
        for kind, made in there.items():
            assert {(one.device, one.threads) for one in made} == {("cuda", 4)}
            assert [*map(name_of_run, made)] == [*map(name_of_run, here[kind])]
    published = catalogue.load("moved-coin").sizes["published"]
    with pytest.raises(ValueError, match="for agents that are trained here; got 'cuda'"):
        replace(published, device="cuda")


def test_the_hours_are_told_before_the_first_training_begins(tmp_path, monkeypatch, capsys):
    def stopped(*_):
        assert "hours with" in capsys.readouterr().err
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "train_all", stopped)
    monkeypatch.setattr(run, "check_tests", lambda _: None)  # which takes seconds
    whole = catalogue.load("maze-corner")
    plan = whole.sizes["night"]  # with fewer levels, as all of them are made before they are told
    few = replace(plan, agents={"mouse": replace(plan.config, levels=1000)}, levels=10)
    with pytest.raises(KeyboardInterrupt):
        run.reproduce(replace(whole, sizes={"night": few}), "night", Path(tmp_path))
