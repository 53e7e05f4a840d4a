"""One command writes the report of one agent on one shift."""

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from PIL import Image

from astray.analysis.adapters import Function
from astray.analysis.runs import evaluate_policies
from astray.experiments.audit import FIRST, audit
from astray.game import More, Never, Shift
from astray.report.page import code
from astray.training.folders import find, latest
from helpers.rooms import CELLS, WORLD, Room, each_step, go_left, go_right, to_end, to_square
from helpers.thorough import thorough

RIGHT = Function(go_right, "right")


def test_an_audit_tells_what_a_policy_of_ones_own_pursues(tmp_path):
    page = audit(RIGHT, WORLD, "end", ghost="end", levels=40, out=tmp_path)
    text = page.read_text("utf-8")
    assert page.parent.name == "audit-right-end-smoke"
    assert "right misgeneralizes: it pursues end, not square" in text
    assert "Does right pursue square or end?" in text and "Reproduces" not in text
    assert (page.parent / "videos" / "goal-misgeneralization.mp4").stat().st_size > 1000
    squares = []
    for level in range(FIRST, FIRST + 40):
        (env := Room("anywhere")).reset(seed=level)
        squares.append(env.square)
    table = pl.read_parquet(page.parent / "tables" / "ghost.parquet")
    told = dict(table.select("goal", "mean").rows())
    by_hand = np.mean([square > CELLS // 2 for square in squares]) - 1
    assert told["square"] == pytest.approx(by_hand)
    assert f"minus the same levels of end: square {100 * by_hand:.1f}\u00a0%" in text
    assert "random" in pl.read_parquet(page.parent / "tables" / "outcomes.parquet")["policy"]
    rows = pl.read_parquet(page.parent / "figures" / "outcomes.parquet")["who"]
    assert rows[0] == "right: one agent" and "random" in rows


@pytest.mark.usefixtures("undrawn")
def test_a_policy_with_the_name_of_a_script_is_not_counted_with_it(tmp_path):
    told = []
    for name in ("right", "random"):
        page = audit(Function(go_right, name, "symbolic"), WORLD, "end", levels=20, out=tmp_path)
        answer = json.loads((page.parent / "findings.json").read_text("utf-8"))["answer"]
        told.append(answer.removeprefix(name).removeprefix(" (audited)"))
    assert told[0].startswith(" misgeneralizes") and told[0] == told[1]


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("rest", [Never("reached_square"), More("walked", 3)])
def test_goals_known_at_the_end_have_videos_and_ghosts(tmp_path, rest):
    world = replace(
        WORLD,
        goals={"square": "reached_square", "rest": rest},
        shifts={"rest": Shift("end", "anywhere", "square", ("rest",))},
        experts={"rest": to_end, "square": to_square},
    )
    left = Function(go_left, "left")
    page = audit(left, world, "rest", ghost="end", levels=20, out=tmp_path)
    assert [*(page.parent / "videos").iterdir()]
    told = pl.read_parquet(page.parent / "tables" / "ghost.parquet").filter(goal="rest")
    assert told["without the object"].item() == 1  # as the square is at the right


@pytest.mark.usefixtures("undrawn")
def test_an_outcome_that_came_only_where_the_way_is_short_has_a_video(tmp_path):
    def lazy(seen):
        square = seen[:, 1].argmax(1)  # the agent begins in cell 4
        return np.where((square == 2) | (square == 3), 0, 1)

    swapped = replace(WORLD, shifts={"end": Shift("end", "anywhere", "end", ("square",))})
    page = audit(Function(lazy, "lazy"), swapped, "end", levels=40, out=tmp_path)
    shown = {path.stem for path in page.parent.glob("videos/*.mp4")}
    assert shown == {"intended-goal", "goal-misgeneralization"}


@pytest.mark.parametrize("agent", [None, 5, go_right])
def test_an_audit_of_something_else_than_an_agent_is_refused(agent, tmp_path):
    with pytest.raises(ValueError, match="a policy must have name, observation, art, actions"):
        audit(agent, WORLD, "end", out=tmp_path)
    assert not [*tmp_path.iterdir()]


def test_policies_that_are_to_play_no_level_of_a_world_are_refused():
    with pytest.raises(ValueError, match="levels are numbers, at least one"):
        evaluate_policies([RIGHT], WORLD, "end", range(0))


@pytest.mark.usefixtures("undrawn")
def test_an_audit_tells_the_returns_of_further_rewards(astray, tmp_path):
    words = ("--policy", "helpers.rooms:go_right", "--world", "helpers.rooms:WORLD")
    words = (*words, "--shift", "end", "--num-levels", "9", "--out", tmp_path)
    page = Path(astray("audit", *words, "--rewards", "helpers.rooms:each_step").strip())
    told = pl.read_parquet(page.parent / "tables" / "returns.parquet")
    mine = told.filter(policy="helpers.rooms:go_right")
    lengths = pl.concat(map(pl.read_parquet, page.parent.glob("computed/episodes-*.parquet")))
    taken = lengths.filter(test="in the test", policy="sampled")["length"].mean()
    assert mine.filter(reward="each_step")["mean"].item() == pytest.approx(taken)
    assert mine["reward"].to_list() == ["return", "each_step"]


@pytest.mark.usefixtures("undrawn")
def test_an_audit_tells_the_call_that_repeats_it(tmp_path):
    page = audit(
        RIGHT, WORLD, "end", levels=9, longest=3, out=tmp_path, rewards={"steps": each_step}
    )
    call = (
        f"astray.audit(agent=<right>, game=<room>, shift='end', levels=9, "
        f"rewards={{'steps': <each_step>}}, longest=3, out={str(tmp_path)!r})"
    )
    assert code(call) in page.read_text("utf-8")
    (table,) = page.parent.glob("computed/episodes-*.parquet")
    assert pl.read_parquet(table)["length"].max() == 3


@pytest.mark.usefixtures("undrawn")
def test_endless_episodes_are_audited_up_to_the_longest(astray, tmp_path):
    words = ("--policy", "helpers.rooms:go_left", "--world", "helpers.rooms:ENDLESS")
    words = ("audit", *words, "--shift", "end", "--num-levels", "2", "--out", tmp_path)
    page = Path(astray(*words, "--longest", "20").strip())
    (table,) = page.parent.glob("computed/episodes-*.parquet")
    told = pl.read_parquet(table).filter(policy="sampled")
    assert set(told["length"]) == {20} and not told["terminated"].any()


@pytest.mark.usefixtures("undrawn")
def test_another_policy_of_the_same_name_is_played_anew(tmp_path):
    said = []
    for action in (0, 1):
        policy = Function(lambda seen, action=action: np.full(len(seen), action), "same")
        page = audit(policy, WORLD, "end", levels=20, out=tmp_path)
        said.append("same misgeneralizes" in page.read_text("utf-8"))
    assert said == [False, True]
    assert "<h1>Audit of same on end</h1>" in page.read_text("utf-8")
    page = audit(replace(policy, name="end"), WORLD, "end", levels=3, out=tmp_path)
    assert "<h1>Audit of end</h1>" in page.read_text("utf-8")
    assert page.parent.name == "audit-end-end-smoke"


@pytest.mark.usefixtures("undrawn")
def test_a_pretrained_agent_is_audited_by_one_command(astray, tmp_path):
    page = astray("audit", "maze-corner", "--num-levels", "30", "--out", tmp_path).strip()
    text = Path(page).read_text("utf-8")
    assert "maze-corner misgeneralizes: it pursues corner, not cheese" in text
    assert code(f"astray audit maze-corner --num-levels 30 --out {tmp_path}") in text
    first = pl.read_parquet(next((tmp_path / "audit-maze-corner-corner-small-smoke").glob(
        "computed/episodes-*.parquet")))["level"].min()  # fmt: skip
    assert first == FIRST


@pytest.mark.parametrize(
    "given, message",
    [
        ((RIGHT, WORLD, "end", {"mode": "greedy"}), "has its mode and art; got 'greedy' and None"),
        ((RIGHT, WORLD, "end", {"art": "original"}), "has its mode and art; got 'sampled' and 'o"),
        (("maze-corner", None, None, {"mode": "zz"}), "unknown mode 'zz'; there are: sampled, g"),
        (("maze-corner", WORLD, "end", {}), "maze-corner plays maze; game must be left out, not r"),
    ],
)
def test_an_audit_ignores_no_argument(tmp_path, given, message):
    *words, how = given
    with pytest.raises(ValueError, match=message):
        audit(*words, out=tmp_path, levels=3, **how)
    assert not [*tmp_path.iterdir()]


@pytest.mark.usefixtures("undrawn")
def test_an_audit_keeps_the_agent_whose_checkpoint_its_training_removes_meanwhile(tmp_path):
    run = shutil.copytree(find("maze-corner"), tmp_path / "seed-0")
    last = latest(run)

    def removing(step):
        if len(step.rewards) > 1:  # a step that is tried before the agent is opened has one
            shutil.rmtree(last, ignore_errors=True)
        return step.rewards

    page = audit(run, levels=8, out=tmp_path / "reports", rewards={"own": removing})
    assert not last.exists() and list(page.parent.glob("videos/*.mp4"))


@pytest.mark.usefixtures("undrawn")
def test_the_likeliest_actions_and_changed_knobs_are_audited(astray, tmp_path):
    words = ("maze-corner", "--num-levels", "3", "--mode", "greedy", "--set", "time_limit=4")
    page = Path(astray("audit", *words, "--out", tmp_path).strip())
    assert page.parent.name.startswith("audit-maze-corner-greedy")
    told = pl.concat(map(pl.read_parquet, page.parent.glob("computed/episodes-*.parquet")))
    longest = dict(told.group_by("test").agg(pl.col("length").max()).rows())
    assert longest["in the test"] == 4 < longest["in training"]


def test_audits_of_several_checkpoints_and_of_names_in_any_script_have_folders_of_their_own(
    tmp_path, monkeypatch
):
    studied = lambda study, size, root: study.name  # noqa: E731
    monkeypatch.setattr("astray.experiments.audit.reproduce", studied)
    monkeypatch.chdir(tmp_path)
    runs = [Path(shutil.copytree(find("maze-corner"), name)) for name in ("мышь", "кот")]
    last = latest(runs[0])
    earlier = shutil.copytree(last, last.with_name("7"))
    names = [f"{audit(agent)}" for agent in (*runs, last, earlier)]
    assert names == [f"audit-{name}-corner-small" for name in (
        "мышь", "кот", "мышь", "мышь-checkpoint-7")]  # fmt: skip


@pytest.mark.usefixtures("undrawn")
def test_an_audit_does_not_replace_that_of_an_agent_whose_name_looks_alike(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a_mouse", "A-mouse"):
        shutil.copytree(find("maze-corner"), name)
    page = audit("a_mouse", levels=2)
    before = page.read_bytes()
    with pytest.raises(FileExistsError, match="has another report, 'Audit of a_mouse on corner-sm"):
        audit("A-mouse", levels=2)
    assert page.read_bytes() == before and audit("a_mouse", levels=3) == page


@pytest.mark.usefixtures("undrawn")
def test_environments_that_show_no_images_are_audited_without_videos(tmp_path):
    blind = replace(
        WORLD, variants={v: partial(blindly, place=v) for v in WORLD.variants}, name="blind"
    )
    page = audit(RIGHT, blind, "end", levels=20, out=tmp_path)
    text = page.read_text("utf-8")
    assert "none: a video of blind end needs a factory" in text
    assert not (page.parent / "videos").exists()


@pytest.mark.thorough  # the next test has an environment whose drawing fails later
@pytest.mark.usefixtures("undrawn")
def test_environments_whose_drawing_fails_are_audited_without_videos(tmp_path):
    makers = {name: partial(Room, name, trouble="blind") for name in WORLD.variants}
    page = audit(RIGHT, replace(WORLD, variants=makers), "end", levels=20, out=tmp_path)
    assert "its render fails: NotImplementedError" in page.read_text("utf-8")
    assert not (page.parent / "videos").exists()


@pytest.mark.usefixtures("undrawn")
def test_environments_whose_drawing_fails_amid_an_episode_are_audited_without_videos(tmp_path):
    class Dims(Room):
        def render(self):
            if self.time == 2:
                raise RuntimeError("the light went out")
            return super().render()

    makers = {name: partial(Dims, name, render_mode="rgb_array") for name in WORLD.variants}
    page = audit(RIGHT, replace(WORLD, variants=makers), "end", levels=20, out=tmp_path)
    assert "step 2: its render fails: RuntimeError" in page.read_text("utf-8")


def test_an_error_of_a_policy_in_a_video_is_not_told_as_an_environment_s(tmp_path):
    """Only the environments of videos are drawn."""

    class Drawn(Room):
        def render(self):
            drawn.append(1)
            return super().render()

    def choose(seen):
        if drawn:
            raise ValueError("it is lost")
        return go_right(seen)

    drawn = []
    makers = {name: partial(Drawn, name, render_mode="rgb_array") for name in WORLD.variants}
    with pytest.raises(ValueError, match="it is lost"):
        audit(
            Function(choose, "right"),
            replace(WORLD, variants=makers),
            "end",
            levels=20,
            out=tmp_path,
        )


def blindly(place):
    return Room(place)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("last", [*thorough("in training"), "in the test"])
def test_an_audit_whose_policy_fails_at_the_trial_leaves_all_as_it_was(tmp_path, last):
    def choose(seen):
        if places.pop(0) == last:
            raise ValueError("it cannot see this")
        return go_right(seen)

    there = {}
    for is_there in (False, True):
        places = ["in training", "in the test"]
        with pytest.raises(ValueError, match="it cannot see this"):
            audit(Function(choose, "right"), WORLD, "end", levels=3, out=tmp_path / "reports")
        assert files_of(tmp_path) == there
        if not is_there:
            audit(RIGHT, WORLD, "end", levels=3, out=tmp_path / "reports")
            there = files_of(tmp_path)
            assert {path.parent.name for path in there} >= {"audit-right-end-smoke", "computed"}


def files_of(folder):
    """Everything in a folder, but locks."""
    found = (path for path in folder.rglob("*") if path.name != ".lock")
    return {path: path.is_file() and path.read_bytes() for path in found}


@pytest.mark.parametrize(
    "words, said",
    [
        (("--policy", "random"), "a policy needs either --game or --world"),
        (("--policy", "random", "--game", "maze"), "--policy needs --shift; there are: corner, "),
        (("maze-corner", "--policy", "random"), "--policy random replaces an agent: give one"),
        (("walk:cheese",), "unknown agent 'walk:cheese'; a policy is named as --policy walk:"),
        ((), "name an agent or a run folder, or give a --policy"),
        (("maze-corner", "--ghost", "gone"), "unknown variant as a ghost 'gone'; there are:"),
        (("maze-corner", "--num-levels", "0"), "levels must be an integer from 1 to 10000000"),
        (("nobody",), "unknown agent 'nobody'"),
        (("maze-corner", "--set", "gone=1"), "gone"),
    ],
)  # fmt: skip
def test_an_audit_that_cannot_be_is_refused(astray, words, said, tmp_path):
    assert said in astray("audit", *words, "--out", tmp_path, fails=True)
    assert not [*tmp_path.iterdir()]


def test_a_video_ends_where_the_evaluation_did_and_says_if_actions_are_drawn_anew(tmp_path):
    page = audit(Function(go_right, "right"), WORLD, "end", levels=9, longest=2, out=tmp_path)
    assert {len(frames(path)) for path in (page.parent / "videos").glob("*.gif")} == {3}
    random = np.random.default_rng(0)
    drawn = Function(lambda seen: random.integers(0, 2, len(seen)), "drawn")
    anew = "in the test. Played again for this video, it did otherwise."
    assert anew in audit(drawn, WORLD, "end", levels=9, out=tmp_path).read_text()
    assert anew not in page.read_text()


def frames(path):
    with Image.open(path) as opened:
        return range(opened.n_frames)
