"""A page that compares agents: verdict first, outcomes, paired differences, curves and a video."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

import astray
from astray.analysis.adapters import Function
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, load_shift
from astray.analysis.policies import Random, Walk
from astray.analysis.results import Result
from astray.cli import pages
from astray.cli.arguments import Acting
from astray.experiments import compare as comparison
from astray.experiments.compare import _answer, _short, compare, paired
from astray.figures import charts
from astray.game import Shift
from astray.report.findings import Plot
from astray.training import folders
from helpers.rooms import WORLD, go_right
from helpers.thorough import thorough

AGENT = "maze-corner"


def test_agents_and_scripts_are_compared_on_one_page(astray, tmp_path):
    out = tmp_path / "page"
    words = ("compare", AGENT, "walk:cheese", "--shift", "corner-small", "--levels", "0:60")
    assert astray(*words, "--out", out).strip() == str(out / "compare.html")
    page = (out / "compare.html").read_text()
    said = "maze-corner misgeneralizes more often than walk to cheese: a proxy comes first in"
    assert page.index(said) < page.index("<h2>Outcomes") < page.index("<h2>Side by side")
    assert "walk to cheese" in page and "data:video/mp4" in page and "astray compare" in page
    assert "Learning curves" not in page, "nobody trained here"
    row = page.split("<tbody>")[1].split("</tr>")[0]
    assert "maze-corner</td>" in row and "distinguishing</td>" in row, "its own row is the first"
    assert row.count('class="number"') > 3, "and its rates are not broken into lines"


@pytest.mark.usefixtures("undrawn")
def test_a_mode_is_of_the_agents_and_not_of_policies_beside_them(astray, tmp_path):
    words = ("walk:cheese", "--mode", "greedy", "--levels", "0:3", "--out", tmp_path)
    words += ("--shift", "corner-small")
    astray("compare", AGENT, *words)
    shown = (tmp_path / "compare.html").read_text()
    assert "maze-corner (greedy), walk to cheese in " in shown
    told = astray("compare", "random", *words, "--game", "maze", fails=True)
    assert "has no mode 'greedy'" in told


def test_a_page_without_room_is_told_before_the_agents_are_played(tmp_path, full_disk, monkeypatch):
    monkeypatch.setattr(comparison, "evaluate_policies", lambda *_, **__: pytest.fail("played"))
    full_disk(100_000)
    with pytest.raises(OSError, match="large; nothing was written"):
        compare([Walk("cheese"), Random()], "maze", "corner-small", range(9), tmp_path / "page")
    assert not list(tmp_path.iterdir())


def test_an_own_policy_of_the_name_of_a_script_is_not_taken_for_it(tmp_path):
    own = Function(lambda seen: np.full(len(seen), 7), "random")
    with pytest.raises(ValueError, match="policies must have names of their own"):
        compare([own, Walk("cheese")], "maze", "corner-small", range(9), tmp_path / "page")


@pytest.mark.usefixtures("undrawn")
def test_runs_are_named_without_the_folders_that_they_share(astray, tmp_path):
    home = tmp_path / "mazes-with-cheese-in-the-corner" / "of-november"
    runs = [shutil.copytree(folders.find(AGENT), home / f"seed-{k}") for k in (0, 1)]
    astray("compare", *runs, "--levels", "0:9", "--out", tmp_path)
    page = (tmp_path / "compare.html").read_text()
    assert "seed-0, seed-1 in anywhere-small</h1>" in page and "seed-0</td>" in page
    assert page.count(home.name) == 2, "in the command alone"


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_trains_on_is_compared_by_its_name_at_the_start(tmp_path, monkeypatch):
    run = shutil.copytree(folders.find(AGENT), tmp_path / "mouse")
    before, evaluate = folders.latest(run), comparison.evaluate_policies

    def goes_on(*given, **how):
        shutil.copytree(before, before.with_name(f"{int(before.name) * 2}"), dirs_exist_ok=True)
        return evaluate(*given, **how)

    monkeypatch.setattr(comparison, "evaluate_policies", goes_on)
    policies = [astray.load_agent(run), Random()]
    page = compare(policies, "maze", "corner-small", range(9), tmp_path / "page").read_text()
    assert "mouse</td>" in page and "steps</td>" not in page


@pytest.mark.parametrize(
    "names, short",
    [
        (["a/b/c", "a/d/c", "walk to x"], ["b/c", "d/c", "walk to x"]),
        (["/r/mice/seed-0", "maze-corner"], ["seed-0", "maze-corner"]),
        (["r/maze-corner", "maze-corner"], ["r/maze-corner", "maze-corner"]),  # which is another
        (["random", "walk to x"], ["random", "walk to x"]),
        (["r/random", "r/mouse"], ["r/random", "r/mouse"]),  # beside the script of that name
    ],
)
def test_names_stay_apart(names, short):
    found = _short(list(map(str, map(Path, names))), {"random", "walk to x"})
    assert [*found.values()] == list(map(str, map(Path, short)))


@pytest.mark.usefixtures("undrawn")
def test_an_agent_in_a_folder_of_the_name_of_a_script_is_not_taken_for_it(tmp_path, monkeypatch):
    both = [shutil.copytree(folders.find(AGENT), tmp_path / name) for name in ("random", "other")]
    agents, drawn = [astray.load_agent(one) for one in both], []
    monkeypatch.setattr(charts, "outcome_bars", lambda data: drawn.append(data) or Figure())
    compare(agents, "maze", "corner-small", range(9), tmp_path / "page")
    assert drawn[0]["who"].n_unique() == 5, "two agents and three scripts"


def test_differences_are_of_the_same_levels():
    result = astray.evaluate_policies([], "maze", "corner-small", range(60))
    rows = paired(result, ["walk to cheese", "walk to corner"]).to_dicts()
    assert [row["mean"] for row in rows] == [1, -1] and all(row["differ"] for row in rows)
    (apart,) = {row["levels"] for row in rows}
    assert apart == result.episodes.filter("distinguishing")["level"].n_unique() < 60
    same = paired(result, ["random", "random"])
    assert not same["differ"].any() and (same["mean"] == 0).all()


def test_differences_are_corrected_for_their_number():
    came = [MISGENERALIZED] * 7 + [INTENDED] * 293  # p = 0.004, of one difference alone
    others = dict.fromkeys("abcdefg", [INTENDED] * 300)
    parts = [
        pl.DataFrame({"policy": name, "seed": 0, "level": range(300), "outcome": outcome})
        for name, outcome in {"seldom": came, **others}.items()
    ]
    result = Result(pl.DataFrame({"levels_played": ["all"]}), pl.concat(parts), (), None)
    assert paired(result, ["seldom", "a"])["differ"].all()
    many = paired(result, ["seldom", *others])
    assert ((many["low"] > 0) | (many["high"] < 0)).sum() == 14 and not many["differ"].any()


def test_the_largest_difference_of_many_pairs_has_an_interval_for_the_largest():
    """Its own interval, from pairs that differ for certain, held the truth in 65 to 86 of 100."""
    random, names, held = np.random.default_rng(0), "abcdefgh", []
    chance, shift = np.linspace(0.3, 0.7, 8), load_shift("maze", "corner-small")
    table = pl.DataFrame(
        {"policy": np.repeat([*names], 100), "level": [*range(100)] * 8, "seed": 0}
    )
    for _ in range(20):
        came = (random.random((8, 100)) < chance[:, None]).ravel()
        outcome = np.where(came, MISGENERALIZED, INTENDED)
        episodes = table.with_columns(outcome=outcome)
        rates = pl.DataFrame({"levels_played": ["all"]})
        told = _answer(paired(Result(rates, episodes, (), shift), [*names]), shift)
        found = re.match(r"(.) \w+ .*than (.):.* interval (\S+) to (\S+), as", told).groups()
        more, less = (chance[names.index(one)] for one in found[:2])
        held.append(float(found[2]) <= 100 * (more - less) <= float(found[3]))
    assert np.mean(held) >= 0.92


@pytest.mark.usefixtures("undrawn")
def test_agents_of_the_same_outcomes_have_no_level_in_which_they_differ(tmp_path):
    also = Function(go_right, "also right")
    page = compare([Function(go_right, "right"), also], WORLD, "end", range(9), tmp_path / "page")
    told = page.read_text()
    assert "in it they have the same outcome, as in all levels." in told
    assert "the first in which most" not in told


@pytest.mark.usefixtures("undrawn")
def test_a_video_of_actions_that_are_drawn_anew_says_so(tmp_path):
    random = np.random.default_rng(0)
    drawn = Function(lambda seen: random.integers(0, 2, len(seen)), "drawn")
    both = [Function(go_right, "right"), drawn]
    told = compare(both, WORLD, "end", range(9), tmp_path / "page").read_text()
    assert "differ. Played again for this video, drawn did otherwise." in told


@pytest.mark.usefixtures("undrawn")
def test_in_a_shift_without_proxies_the_intended_goal_is_compared(tmp_path):
    world = replace(WORLD, shifts={"end": Shift("end", "anywhere", "square", ())})
    left = Function(lambda seen: np.zeros(len(seen), int), "left")
    both = [Function(go_right, "right"), left]
    told = compare(both, world, Shift("end", "end", "square", ()), range(9), tmp_path).read_text()
    assert "right reaches square more often than left: square comes first in 100.0" in told
    assert "distinguish the goals." not in told, "as there is one goal alone"


@pytest.mark.usefixtures("undrawn")
def test_policies_of_a_world_are_compared(astray, tmp_path):
    words = ("helpers.rooms:go_right", "walk:square", "--world", "helpers.rooms:WORLD")
    astray("compare", *words, "--shift", "end", "--levels", "0:40", "--out", tmp_path)
    page = (tmp_path / "compare.html").read_text()
    assert "helpers.rooms:go_right misgeneralizes more often than walk to square" in page
    right = Function(go_right, "right")
    left = Function(lambda seen: np.zeros(len(seen), int), "left")
    blind = replace(WORLD, name="blind", variants={v: Blind for v in WORLD.variants})
    page = compare([right, left], blind, "end", range(4), tmp_path).read_text()
    assert "There is no video: " in page


class Blind(WORLD.variants["end"].func):  # pyrefly: ignore
    """A room that renders nothing."""

    def __init__(self):
        super().__init__("anywhere")


def test_a_comparison_that_finds_no_room_leaves_nothing(tmp_path, full_disk, monkeypatch):
    monkeypatch.setattr(comparison, "check_writable", lambda _: None)  # the disk is full later
    left = Function(lambda seen: np.zeros(len(seen), int), "left")
    full_disk(2048)
    with pytest.raises(OSError, match=r"nothing was written: .*page.videos.together.mp4"):
        compare([Function(go_right, "right"), left], WORLD, "end", range(4), tmp_path / "page")
    full_disk()
    assert not list(tmp_path.iterdir())
    assert compare([Function(go_right, "right"), left], WORLD, "end", range(4), tmp_path / "page")


@pytest.mark.parametrize("policies", [[], [Random()], [Random(), Random()]])
def test_what_cannot_be_compared_is_told(policies, tmp_path):
    with pytest.raises(ValueError, match="compare takes 2 to 8 agents of different names"):
        compare(policies, WORLD, "end", range(4), tmp_path)


def test_policies_without_a_game_are_told_of_options_that_there_are(astray):
    said = astray("compare", "random", "walk:cheese", fails=True)
    assert "a policy needs either --game or --world" in said


def test_returns_of_trainings_are_drawn(monkeypatch, tmp_path):
    import astray.experiments.compare as page

    agent = astray.load_agent(AGENT)
    folder = page.AgentFolder.of(agent.path).path
    drawn, plot = {}, Plot("curves", "", Figure(), None)
    monkeypatch.setattr(page, "curve_plot", lambda runs: drawn.update(runs) or plot)
    monkeypatch.setattr(page, "METRICS", "config.json")  # which the folder has
    page._curves({"mouse": agent, "random": Random()})
    assert drawn == {"mouse": [folder]}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    "lines", ['{"steps": 9, "training/return": 1.5}\n', *thorough("", '{"steps": 9}\n')]
)
def test_trainings_without_returns_are_compared_without_curves(
    lines, astray, tmp_path, monkeypatch
):
    runs = [shutil.copytree(folders.find(AGENT), tmp_path / f"seed-{k}") for k in (0, 1)]
    for run in runs:
        (run / "metrics.jsonl").write_text(lines)  # of a training that had hardly begun
    out = tmp_path / "page"
    assert astray("compare", *runs, "--levels", "0:3", "--longest", "9", "--out", out)
    assert "Learning curves" not in (out / "compare.html").read_text()
    (runs[1] / "metrics.jsonl").write_text("no JSON\n")
    monkeypatch.setattr("astray.experiments.compare.evaluate_policies", None)  # nobody plays
    told = astray("compare", *runs, "--levels", "0:3", "--out", out, fails=True)
    assert "metrics.jsonl, line 1: it is not JSON" in told


def test_knobs_that_were_given_in_another_order_are_the_same(tmp_path, monkeypatch):
    given, played = {"time_limit": 50, "walls": "hedge"}, []
    small = replace(astray.PRESETS["small"], variant="corner-small")
    configs = iter(replace(small, knobs=dict(k)) for k in (given.items(), [*given.items()][::-1]))
    monkeypatch.setattr(Acting, "open", lambda *_: (Random(), next(configs)))
    page = "astray.experiments.compare.compare"
    monkeypatch.setattr(page, lambda *_, **named: played.append(named["variant"]))
    for name in "ab":
        (tmp_path / name).mkdir()
    pages.compare((str(tmp_path / "a"), str(tmp_path / "b")), out=tmp_path / "page")
    assert (played[0].time_limit, played[0].walls) == (50, "hedge")
