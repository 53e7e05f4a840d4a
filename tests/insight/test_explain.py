"""The page about an agent in a level, and an episode from within."""

import io
import json
import re
import shutil
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

from astray import games, load_agent
from astray.acting import initial_states
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.evaluate import evaluate
from astray.analysis.runs import open_run
from astray.games.maze.measures import decision
from astray.insight import explain, field_figures
from astray.insight.episode import STILL, along, figure
from astray.lab.agents import Agents
from astray.lab.goals import TELLING, distinguishing, typical
from astray.level import Level
from astray.report.page import code
from astray.training import folders

# So short that arrows in all of its places are drawn in a moment.
RUN = """\
#......####
#......####
#@...o.####
===========
"""


def test_a_course_is_the_episode_that_is_played():
    runner = load_agent(folders.find("coin-end"))
    short = games.find("coinrun").variant("coin-anywhere").with_knobs({"time_limit": 150})
    played = evaluate(runner, "coinrun", short, range(200_000, 200_020))
    played = played.filter(pl.col("reached_end").is_not_null()).row(0, named=True)
    course = along(runner, short, played["level"], gamma=0.9, lam=0.8)
    table = course.table
    assert len(table) == played["length"] and table["reward"].sum() == played["return"]
    assert course.events == {name: played[name] for name in course.events}
    policy, value = policy_and_value(runner, observe(runner, short, course.states))
    assert table["value"].to_numpy() == pytest.approx(value)
    assert table.select(course.actions).to_numpy() == pytest.approx(policy)
    assert course.marks == ("coin in view", "end wall in view", "hazard ahead")
    assert table["end wall in view"].any() and not table["end wall in view"].all()


def test_advantages_are_the_discounted_sum_of_surprises():
    runner = load_agent(folders.find("coin-end"))
    played = evaluate(runner, "coinrun", "coin-end", range(200_000, 200_010))
    level = played.filter(pl.col("return") > 0)["level"][0]
    table = along(runner, "coin-end", level, gamma=0.9, lam=0.8).table
    value, reward = table["value"].to_numpy(), table["reward"].to_numpy()
    assert reward[-1] > 0, "the coin ends the episode"
    surprise = reward + 0.9 * np.append(value[1:], 0.0) - value
    expected = [sum(0.72**k * d for k, d in enumerate(surprise[t:])) for t in range(len(value))]
    assert table["advantage"].to_numpy() == pytest.approx(expected, abs=1e-4)
    # As in its training, values are of rewards that were divided; and at most 10.
    for deviation, last in ((2.0, 5.0), (0.5, 10.0)):
        course = along(runner, "coin-end", level, gamma=0.9, lam=0.8, deviation=deviation)
        assert course.table["advantage"][-1] == pytest.approx(last - value[-1], abs=1e-4)
        assert course.table["reward"][-1] == reward[-1] == 10


def test_the_figure_of_an_episode_has_its_marks():
    runner = load_agent(folders.find("coin-end"))
    course = along(runner, "coin-end", 200_001)
    shown = figure(course)
    view = shown.axes[3]
    assert view.get_title(loc="left") == "labels that hold"
    drawn = {line.get_label(): np.isfinite(line.get_ydata()).sum() for line in view.lines}
    assert {n: drawn[n] for n in course.marks} == {
        n: 2 * course.table[n].sum() for n in course.marks
    }
    hold = [n for n in course.marks if course.table[n].any()]
    assert [tick.get_text() for tick in view.get_yticklabels()] == hold
    rows = {line.get_label(): {*np.ravel(line.get_ydata())} for line in view.lines}
    assert all(k in rows[n] for k, n in enumerate(hold))
    short = replace(
        course, table=course.table.head(2).with_columns(hazard=False), marks=("hazard",)
    )
    drawn = figure(short)
    assert len(drawn.axes) == 3, "what never holds has no panel"
    assert all(float(tick).is_integer() for tick in drawn.axes[2].get_xticks())
    with pytest.raises(ValueError, match="marks must be true or false; level are not"):
        along(runner, "coin-end", 200_001, marks={"level": lambda s: s["level"]})


def test_steps_in_which_an_agent_stays_in_its_place_are_not_drawn():
    course = along(load_agent(folders.find("maze-corner")), "anywhere-small", 200_003)
    assert len(course.table) == 100 and course.events["reached_corner"] == 2
    assert course.idle == 100 - 1 - 1 - STILL  # it stays from its third state on
    assert max(max(line.get_xdata()) for line in figure(course).axes[0].lines) == 1 + STILL
    paced = pl.DataFrame({"x": [0, 1, 2] + [3, 4] * 20, "y": [0] * 43})  # to and fro at the end
    assert replace(course, table=paced).idle == 43 - 1 - 2 - STILL
    wandered = pl.DataFrame({"x": [3, 4, 5, 4] * 11, "y": [0] * 44})
    assert replace(course, table=wandered).idle == 0


def test_a_level_that_distinguishes_the_goals_is_looked_for_from_a_number_on():
    maze = games.find("maze")
    variant, shift = maze.variant("anywhere-small"), maze.shifts["corner-small"]
    found = [distinguishing(maze, variant, shift, range(n, 9))[0] for n in range(5)]
    parts = [decision(s) for s in initial_states(maze, variant, range(9)).view(np.recarray)]
    assert found == [next(k for k in range(n, 9) if parts[k]) for n in range(5)]
    assert found != [*range(5)]


def test_a_level_in_which_the_agent_reaches_a_goal_after_some_steps_comes_first():
    maze, mouse = games.find("maze"), load_agent("maze-corner")
    variant, shift = maze.variant("anywhere-small"), maze.shifts["corner-small"]
    assert distinguishing(maze, variant, shift, range(9))[0] == 2  # in which this mouse is stuck
    found, _ = typical(maze, variant, shift, mouse)
    (played,) = evaluate(mouse, maze, variant, [found]).to_dicts()
    assert found > 2 and played["reached_corner"] >= TELLING
    nearest = evaluate(mouse, maze, variant, range(found))["reached_corner"]
    assert nearest.min() < TELLING  # as in level 4, where the mouse begins beside the corner


def test_the_lab_opens_where_an_agent_shows_its_usual_goal_and_says_why():
    maze, mouse = games.find("maze"), load_agent("maze-corner")
    variant, shift = maze.variant("anywhere-small"), maze.shifts["corner-small"]
    number, why = typical(maze, variant, shift, mouse)
    level = Level.of(maze, variant, initial_states(maze, variant, [number])[0])
    places = {str(k): one for k, one in enumerate(level.splay("goal"))}
    played = evaluate(mouse, maze, variant, places)
    corner, cheese = (pl.col(f"reached_{one}").fill_null(1000) for one in ("corner", "goal"))
    assert played.select((corner < cheese).mean()).item() > 0.5  # in level 5, of 5 places in 16
    assert "the agent reaches “corner” first here, as in most levels that distinguish the" in why


def test_a_level_is_chosen_although_its_episodes_may_last_for_ever():
    maze, mouse = games.find("maze"), load_agent("maze-corner")
    variant, shift = maze.variant("anywhere-small"), maze.shifts["corner-small"]
    endless = variant.with_knobs({"time_limit": 2**31 - 1})
    assert typical(maze, endless, shift, mouse) == typical(maze, variant, shift, mouse)


def test_the_lab_opens_where_a_runner_passes_the_coin():
    game, runner = games.find("coinrun"), load_agent("coin-end")
    shift = game.shifts["coin-end"]
    number, why = typical(game, game.variant(shift.test), shift, runner)
    (played,) = evaluate(runner, game, shift.test, [number]).to_dicts()
    assert played["reached_end"] < (played["took_coin"] or 1000)  # in level 0, the coin is first
    assert why == f"Level {number} was chosen: the agent reaches “end” first here."


def test_no_tiny_level_is_chosen_while_a_larger_one_shows_the_goal():
    maze, mouse = games.find("maze"), load_agent("maze-corner")
    variant, shift = maze.variant("anywhere-small"), maze.shifts["corner-small"]
    number, why = typical(maze, variant, shift, mouse, 100_000)
    some = [number, *distinguishing(maze, variant, shift, range(100_000, 100_050))]
    begun = initial_states(maze, variant, some).view(np.recarray)
    size = [maze.places.stand(s).sum() for s in begun]
    assert size[0] == max(size) > 2 * min(size)  # in level 100027 the mouse has 8 cells
    (played,) = evaluate(mouse, maze, variant, [number]).to_dicts()
    assert played["reached_corner"] >= TELLING and why.endswith("the largest levels tried.")


@pytest.mark.parametrize(
    ("name", "said", "event", "steps"),
    [
        ("lava-dry", "No level distinguishes goals, as “cheese” has no proxy.", "reached_lava", 2),
        (
            "bridge-middle",
            "No level distinguishes goals, as “goal” has no proxy.",
            "burnt",
            TELLING,
        ),
        ("boat-race", "No level distinguishes “rounds” and “to and fro”, as only the", None, 0),
        ("trees-life", "“forest”, as only the end of an episode shows", "bare", TELLING),
        ("monsters-short", "the agent came to “more shields” in none.", None, 0),
    ],
)
def test_it_is_said_why_no_level_distinguishes_the_goals(name, said, event, steps):
    agent, config = open_run(folders.find(name))
    game = config.find_game()
    shift = next(iter(game.shifts.values()))
    number, why = typical(game, game.variant(shift.test), shift, agent)
    assert said in why
    if event:
        (played,) = evaluate(agent, game, shift.test, [number]).to_dicts()
        assert played[event] >= steps and f"Level {number} was chosen: the agent " in why


def test_a_level_is_found_where_goals_are_counts_that_the_end_tells():
    gardens, gardener = games.find("tomatoes"), load_agent("tomatoes-bucket")
    shift = gardens.shifts["bucket"]
    bucket = gardens.variant("bucket")
    assert distinguishing(gardens, bucket, shift, range(3)) is None  # nobody walks to a count
    found, why = typical(gardens, bucket, shift, gardener)
    (played,) = evaluate(gardener, gardens, "bucket", [found]).to_dicts()
    assert played["length"] >= TELLING
    assert played["steps in the bucket"] > played["tomatoes watered"]
    assert why.endswith(f"Level {found} was chosen: the agent comes to “more hiding” here.")


def test_the_agent_is_said_to_be_in_the_middle_only_where_it_is():
    agent, game = load_agent("supervisor-half"), games.find("supervisor")
    rows = [
        "########",
        "#......#",
        "#.####.#",
        "#@#..#.#",
        "#x#..#.#",
        "#.####.#",
        "#.G....#",
        "########",
    ]
    level = Level.from_text(game, game.variant("half"), "\n".join([*rows, "@ on x"]))
    asked = explain.Asked(agent, level.variant, level, "half", (), np.arange(3))
    (section,) = explain._attribution(asked)
    assert "in the middle of what it sees" not in str(section)


def test_a_page_without_room_is_told_before_anything_is_found_out(tmp_path, full_disk, monkeypatch):
    monkeypatch.setattr(explain, "_fields", lambda *_: pytest.fail("asked"))
    agent, game = load_agent("maze-corner"), games.find("maze")
    variant = game.variant("corner-small")
    level = Level.of(game, variant, initial_states(game, variant, [0])[0])
    asked = explain.Asked(agent, variant, level, "corner-small", (), np.arange(3))
    full_disk(100_000)
    with pytest.raises(OSError, match="large; nothing was written"):
        explain.explain(asked, tmp_path / "page", "a title")
    assert not list(tmp_path.iterdir())


def test_explain_writes_one_page_that_needs_nothing_else(astray, tmp_path, coarse, monkeypatch):
    monkeypatch.setattr(explain, "PLACES", 8)
    for module in (explain, field_figures):
        monkeypatch.setattr(module, "PIXELS", 96)
    monkeypatch.setattr(sys, "stderr", told := io.StringIO())
    (tmp_path / "explain.html").write_bytes(
        explain.SIGN
    )  # of an agent that was explained here before
    older, mine = tmp_path / "attribution.parquet", tmp_path / "notes.txt"
    older.write_text("its figure")
    mine.write_text("mine")
    path = astray(
        "explain", "maze-corner", "--level", 200_003, "--num-levels", 60, "--out", tmp_path
    )
    page = (tmp_path / "explain.html").read_text()
    assert path.strip() == str(tmp_path / "explain.html")
    assert told.getvalue().startswith("1 of 6: where it would go\n2 of 6: ")
    headings = re.findall("<h2>(.*?)</h2>", page)
    for heading in (
        "Where it would go",
        "With the cheese anywhere",
        "What its layers tell",
        "What the value depends on",
        "What it is after",
        "Its episode",
    ):
        assert heading in headings
    assert "Not available here" not in page and "`" not in page.split("<script>")[0]
    (answer,) = re.findall('<p class="answer">(.*?)</p>', page)
    assert answer.startswith("Here the agent goes to the corner rather than the cheese")
    said = "astray lab maze-corner --variant anywhere-small --level 200003"
    assert f"In the lab: {code(said)}" in page
    begins, *_ = re.findall("the likeliest actions are (.*?)\\. An arrow", page)
    assert begins == "up 1.00", "an action that is not taken is not named"
    assert "Advantages use undivided rewards, as the divisor of the training is unknown." in page
    (scores,) = re.findall("(?s)<table>(.*?)</table>", page.split("What its layers tell</h2>")[1])[
        :1
    ]
    assert len(re.findall(r"\(-?\d\.\d\d\)</td>", scores)) == 24
    assert page.count("data:image/svg+xml;base64,") == 6 and 'src="http' not in page
    field = pl.read_parquet(tmp_path / "field.parquet")
    assert field.select(games.find("maze").actions).sum_horizontal().to_numpy() == pytest.approx(1)
    probes = pl.read_parquet(tmp_path / "probes.parquet")
    assert probes["label"].unique().len() == 8 and (probes["score"] <= 1).all()
    ways = probes.filter(label="cheese direction")
    assert {*ways["read as"], *ways["true as"]} <= {"left", "right", "down", "up"}
    goals = pl.read_parquet(tmp_path / "goals.parquet")
    assert goals["posterior"].sum() == pytest.approx(1)
    assert (tmp_path / "field.svg").exists()
    assert mine.read_text() == "mine" and not older.exists()
    names = {path.name for path in tmp_path.iterdir()} - {"explain.html", mine.name}
    assert "without-goal.svg" in names < {*explain.written(games.find("maze"))}


def test_one_strong_pixel_does_not_leave_the_others_blank(monkeypatch):
    found, drawn = np.full((64, 64), 0.01), []
    found[60:, 0] = 0.6, -0.5, 0.2, 0.1
    monkeypatch.setattr(explain.attribution, "integrated_gradients", lambda *_: [found])
    monkeypatch.setattr(explain, "images", lambda rows, _size: drawn.extend(rows[0]) or Figure())
    agent = load_agent("maze-corner-pixels")
    maze, small = games.find("maze"), games.find("maze").variant("anywhere-small")
    level = Level.of(maze, small, initial_states(maze, small, [7])[0])
    explain._attribution(SimpleNamespace(agent=agent, level=level, variant=small))
    assert drawn[1].limits == (-0.01, 0.01)


@pytest.mark.thorough  # `test_a_policy_is_explained_as_far_as_it_can_be`
def test_what_a_game_does_not_have_is_told_in_its_place(astray, tmp_path):
    (tmp_path / "level.txt").write_text(RUN)
    astray(
        "explain",
        "coin-end",
        "--level-file",
        tmp_path / "level.txt",
        "--num-levels",
        10,
        "--out",
        tmp_path,
    )
    page = (tmp_path / "explain.html").read_text()
    assert RUN.strip() in page
    assert "has no cells, which this needs" in page and "<h2>Its episode</h2>" in page
    course = pl.read_parquet(tmp_path / "episode.parquet")
    assert course["step"].to_list() == list(range(len(course)))


def test_mistakes_are_told_before_anything_is_written(astray, tmp_path):
    out = tmp_path / "out"
    said = astray("explain", "maze-corner", "--layers", "nowhere", "--out", out, fails=True)
    assert "unknown layer 'nowhere'; there are: spread" in said
    assert "num_levels must be an integer" in astray(
        "explain", "maze-corner", "--num-levels", 1, fails=True
    )
    assert not out.exists()
    (tmp_path / "explain.html").write_text("mine")
    said = astray("explain", "maze-corner", "--num-levels", 2, "--out", tmp_path, fails=True)
    assert "explain.html was not written by astray; it would be replaced" in said
    assert (tmp_path / "explain.html").read_text() == "mine"


def test_probes_learn_from_other_levels_and_advantages_are_those_of_the_training(
    astray, tmp_path, monkeypatch
):
    given = []
    monkeypatch.setattr(explain, "explain", lambda asked, *_, **_options: given.append(asked))
    config = open_run(folders.find("maze-corner"))[1]
    first = config.unseen_levels[0]
    for level in (None, first + 3, 5):
        words = () if level is None else ("--level", level)
        astray("explain", "maze-corner", *words, "--num-levels", 6, "--out", tmp_path)
        assert (first if level is None else level) not in given[-1].others
        assert len(given[-1].others) == len({*given[-1].others}) == 6
        assert (given[-1].gamma, given[-1].lam) == (config.gamma, config.lam) != (0.999, 0.95)
        assert given[-1].deviation is None  # it was kept before this was


def test_values_of_a_reward_of_one_s_own_are_said_to_be_so(astray, tmp_path, monkeypatch):
    given = []
    monkeypatch.setattr(explain, "explain", lambda asked, *_, **_options: given.append(asked))
    shutil.copytree(folders.find("maze-corner"), run := tmp_path / "run")
    data = json.loads((run / folders.CONFIG).read_text())
    data["config"]["reward"] = "mine:speedy"
    (run / folders.CONFIG).write_text(json.dumps(data))
    astray("explain", run, "--num-levels", 6, "--level", 3, "--out", tmp_path)
    about = Agents.of({"mouse": run}).about("mouse")
    for said in (given[0].why, about["caveat"]):
        assert said.startswith("Its values are of the reward mine:speedy; advantages mix")


@pytest.mark.parametrize(
    ("name", "level", "said"),
    [
        ("trees-life", "........" * 7 + "@.....tt", "ends with the wood rather than the forest"),
        ("lava-dry", "#" * 56 + "@#....GG", "does not reach the cheese (capability failure)."),
    ],
)
def test_the_answer_tells_of_goals_that_are_no_events_and_of_shifts_without_a_proxy(
    name, level, said
):
    agent, config = open_run(folders.find(name))
    game = config.find_game()
    (between,) = game.shifts.values()
    drawn = "\n".join(level[k : k + 8] for k in range(0, 64, 8))
    shown = Level.from_text(game, game.variant(between.test), drawn)
    asked = SimpleNamespace(agent=agent, between=between, level=shown, variant=shown.variant)
    asked.named = str
    assert said in explain._verdict(asked)
