"""The command line, as it is typed."""

import io
import json
import shutil
import subprocess
import sys
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray import acting, cli, games
from astray.experiments.catalogue import NAMES, load
from astray.record import LEVELS
from helpers.drawn import DRAWN, environment

TINY = ["--steps", "512", "--num-envs", "16", "--num-steps", "16", "--minibatches", "4"]
TINY += ["--width", "16", "--checkpoint-every", "1"]


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A run of a few steps."""
    folder = tmp_path_factory.mktemp("runs")
    words = ["train", "maze", "corner-small", *TINY, "--out", str(folder)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["astray", *words])
        cli.main()
    return folder / "seed-0"


def test_it_lists_what_there_is(astray):
    found = json.loads(astray("list", "--json"))
    assert "corner" in found["games"]["maze"]["variants"]
    assert found["experiments"] == {name: load(name).title for name in NAMES}
    assert "cheese always in the upper right corner" in astray("list")


def test_levels_are_printed_as_drawings_and_as_data(astray):
    drawn = astray("level", "maze", "corner-small", "--levels", "7").splitlines()
    assert drawn[:3] == ["; maze corner-small level 7", "#######", "#....G#"]
    lines = astray("level", "maze", "corner", "--levels", "0:3,17", "--json").splitlines()
    levels = [json.loads(line) for line in lines]
    assert [level["level"] for level in levels] == [0, 1, 2, 17]
    grid = np.array(levels[0]["grid"])
    assert grid.shape == (25, 25)
    x, y = levels[0]["goal"]
    assert grid[y, x] == levels[0]["legend"]["goal"]


def test_knobs_are_changed(astray):
    said = astray(
        "level",
        "maze",
        "region-1",
        "--set",
        "region=25",
        "walls=hedge",
        "--set",
        "time_limit=9",
        "--json",
    )
    assert json.loads(said)["goal"] != json.loads(said)["corner"]


def test_a_replay_tells_what_happens(astray, tmp_path, reference):
    episode = json.loads((reference / "maze_corner.episodes.jsonl").read_text().splitlines()[-1])
    path = tmp_path / "actions.json"
    path.write_text(json.dumps(episode["actions"]))
    words = ("replay", "maze", "corner", "--level", episode["seed"], "--actions", path)
    told = json.loads(astray(*words, "--json"))
    assert told["length"] == episode["steps"]
    assert told["terminated"] == bool(episode["complete"])
    assert [step["x"] for step in told["steps"][::5]][: len(episode["x"])] == episode["x"]
    assert ("terminated" in astray(*words)) == told["terminated"]


def test_agents_are_trained_resumed_and_evaluated(astray, run_folder, tmp_path):
    words = ("train", "maze", "corner-small", *TINY, "--out", run_folder.parent)
    assert Path(astray(*words).strip()) == run_folder / "checkpoints" / "512"
    out = tmp_path / "episodes.parquet"
    words = ("evaluate", run_folder, "--levels", "1000000:1000020", "--out", out, "--json")
    rates = json.loads(astray(*words))
    name = str(run_folder)
    agents = [row for row in rates if row["policy"] == name and row["levels_played"] == "all"]
    assert sum(row["mean"] for row in agents) == pytest.approx(1)
    episodes = pl.read_parquet(out).filter(policy=name)
    assert episodes["level"].to_list() == list(range(1000000, 1000020))
    assert episodes["seed"].unique().to_list() == [0]
    assert "walk to corner" in astray(*words[:-1])


def test_the_table_of_an_evaluation_names_the_agent(astray, run_folder):
    told = " ".join(astray("evaluate", "maze-corner", "--levels", "0:3").split())
    assert "95 % intervals over agents and levels; for one agent, over levels alone" in told
    assert "maze-corner" in told and "│ sampled │" not in told


def test_levels_from_files_are_edited_and_played(astray, run_folder, tmp_path):
    drawn = astray("level", "maze", "anywhere-small", "--levels", "5:8", "--text")
    assert ";" not in drawn
    folder, out, actions = tmp_path / "levels", tmp_path / "episodes.parquet", tmp_path / "actions"
    folder.mkdir()
    for k, level in enumerate(drawn.strip().split("\n\n")):
        (folder / f"{k}.txt").write_text(level)
    astray("evaluate", run_folder, "--levels", folder, "--out", out, "--json")
    episodes = pl.read_parquet(out).filter(policy="walk to cheese")
    assert episodes["name"].to_list() == ["0.txt", "1.txt", "2.txt"]
    assert episodes["reached_goal"].is_not_null().all()

    (folder / "3.txt").write_text(f"; the first\n{(folder / '0.txt').read_text()}")
    said = astray("evaluate", run_folder, "--levels", folder, fails=True)
    assert "0.txt and 3.txt in" in said and "are one level; give it once" in said
    (folder / "3.txt").unlink()

    actions.write_text("stay")
    words = ("replay", "maze", "anywhere-small", "--actions", actions, "--level-file")
    assert "return 0, not ended" in astray(*words, folder / "0.txt")
    (folder / "0.txt").write_text((folder / "0.txt").read_text().replace("G", "#"))
    assert "return 0, not ended" in astray(*words, folder / "0.txt")
    (folder / "1.txt").write_text("#######\n#@#...#\n###G..#\n" + 3 * "#.....#\n" + "#######")
    said = astray("evaluate", run_folder, "--levels", folder, fails=True)
    assert "1.txt: the goal at cell (3, 4) cannot be reached from (1, 5)" in said
    assert "1.txt: the goal" in astray(*words, folder / "1.txt", fails=True)
    astray(*words, folder / "1.txt", "--unsolvable")
    assert "not both" in astray(*words, folder / "0.txt", "--level", "3", fails=True)
    (folder / "2.txt").write_text(drawn)
    assert "holds 3" in astray(*words, folder / "2.txt", fails=True)
    video = tmp_path / "video.gif"
    astray("record", run_folder, "--level-file", folder / "0.txt", "--pixels", "64", "--out", video)
    assert video.stat().st_size > 1000


def test_an_agent_is_recorded_as_a_video(astray, run_folder, tmp_path):
    out = tmp_path / "video.gif"
    astray("record", run_folder, "--pixels", "64", "--out", out)
    assert out.stat().st_size > 1000
    assert "a video is an .mp4 or a .gif" in astray(
        "record", run_folder, "--out", "x.avi", fails=True
    )


@pytest.mark.parametrize("name", ["config.json", "checkpoints/512/agent.safetensors"])
def test_an_evaluation_is_not_written_over_what_is_played(astray, run_folder, name):
    before = (run_folder / name).read_bytes()
    said = astray("evaluate", run_folder, "--out", run_folder / name, fails=True)
    assert "a table of episodes is a .parquet file" in said
    assert (run_folder / name).read_bytes() == before


@pytest.mark.parametrize(
    "words, name",
    [
        ("evaluate maze-corner --levels 0:2", "mine.parquet"),
        ("record maze-corner --pixels 64 --variant corner-small", "mine.gif"),
        ("record maze-corner --pixels 64 --variant corner-small", "mine.mp4"),
    ],
)
def test_a_file_is_replaced_only_if_astray_wrote_it(astray, tmp_path, words, name):
    table = io.BytesIO()
    pl.DataFrame({"a": [1]}).write_parquet(table)
    (out := tmp_path / name).write_bytes(table.getvalue())
    said = astray(*words.split(), "--out", out, fails=True)
    assert said == f"astray: {out} was not written by astray; it would be replaced\n"
    assert out.read_bytes() == table.getvalue()
    out.unlink()
    for _ in range(2):
        astray(*words.split(), "--out", out)
    assert out.read_bytes() != table.getvalue()


@pytest.mark.parametrize("setting", ["--loss", "--reward", "--network", "--sampler"])
def test_a_part_of_a_training_that_cannot_be_called_is_refused(astray, tmp_path, setting):
    words = ("train", "maze", "corner-small", *TINY, "--out", tmp_path / "o")
    assert "'os:sep' must be a function or a class, not a str" in astray(
        *words, setting, "os:sep", fails=True
    )
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != ".lock"]


def test_an_evaluation_that_finds_no_room_leaves_nothing(astray, run_folder, tmp_path, full_disk):
    full_disk(2048)
    out = tmp_path / "episodes.parquet"
    said = astray("evaluate", run_folder, "--levels", "0:5", "--out", out, fails=True)
    assert said.startswith("astray: ") and "nothing was written" in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words, message",
    [
        ("level mase corner", "unknown game 'mase'; there are: "),
        ("level maze cornr", "unknown variant 'cornr' of maze; there are: corner, anywhere"),
        ("level maze corner --levels 5-9", "levels are numbers and ranges as 5,17,100:200"),
        ("level maze corner --levels 5:5", "levels must have some, as 5:6 has one; got '5:5'"),
        ("level maze corner --levels 3,9:7", "levels must have some, as 5:6 has one; got '3,9:7'"),
        ("level maze corner --levels -1", "from 0 to 2147483646"),
        ("level maze corner --levels 99999999999999999999", "from 0 to 2147483646"),
        ("level maze corner --levels 0:99999999999", "from 0 to 2147483646"),
        ("level maze corner --levels 0:2000000000", "at most 10000000 are taken at once"),
        ("level maze corner --set region=5", "need placement 'region'"),
        ("train maze corner --seed x", "--seed cannot be read: invalid literal for int() with"),
        ("train maze corner --gamma x", "--gamma cannot be read: could not convert string to"),
        ("audit maze-corner --num-levels 0", "--num-levels must be an integer from 1 to"),
        ("train maze corner --num-levels 0", "--num-levels must be from 1 to 2147483647; got 0"),
        ("train maze corner --edits 0", "astray: edits must be from 1 to 10000; got 0"),
        ("train maze corner --seeds 0", "seeds must be an integer from 1 to 134217728; got 0"),
        (
            "train maze corner --fraction 0.5",
            "fraction is for the sampler mixed or growing; got 'uniform'",
        ),
        ("train maze corner --replay 0.5", "replay is for the sampler plr or accel; got 'uniform'"),
        ("train maze corner --schedule late", "schedule is for the sampler mixed; got 'uniform'"),
        ("train maze corner --sampler plr --edits 3", "edits is for the sampler accel; got 'plr'"),
        ("train maze corner --score regret", "score is for the sampler plr or accel; got 'unif"),
        (
            "evaluate maze-corner --world helpers.rooms:WORLD",
            "maze-corner plays maze, and --world helpers.rooms:WORLD is another",
        ),
        (
            "compare maze-corner random --world helpers.rooms:WORLD",
            "agents must play one game; got maze, room",
        ),
        ("evaluate maze-corner --levels 0:2 --unsolvable", "--unsolvable goes with --levels FILE"),
        ("evaluate --policy random --game maze --shift corner-small --pool", "--pool with agents"),
        ("record maze-corner --level 3 --unsolvable", "--unsolvable goes with --level-file"),
        ("level maze corner --text --json", "--text prints drawings, and --json data; give one"),
        ("agents fetch openai-coinrun --json", "--levels goes with check, --unchecked with fetch"),
        ("evaluate maze-corner --rewards math:pi", "rewards must be functions by name; got 'pi'"),
        ("lab --num-levels 5", "--num-levels says how many are exported: it needs --export FOLDER"),
        ("lab maze-corner --export x --port 80", "--export writes files and opens no --port"),
        ("lab maze-corner --export x --level 50", "levels 0 to 49 are exported; --num-levels says"),
        ("lab maze-corner --observation image", "--observation image needs --policy; agents have"),
        (
            "evaluate --policy builtins:len --game maze --shift corner --mode greedy",
            "a --policy chooses by itself; it has no mode 'greedy'",
        ),
        ("level maze corner --set region", "a knob must be set as NAME=VALUE; got 'region'"),
        ("level maze corner --set world=5 --set world=7", "knob 'world' is set twice: to '5' and"),
        (
            "train maze corner --set lr=1 learning_rate=2",
            "'learning_rate' is set twice: to '1' and",
        ),
        ("train maze corner --set", "a knob must be set as NAME=VALUE; got ''"),
        ("level maze corner --levels 5 --levels=7", "--levels is given more than once"),
        ("explain maze-corner --others 2 --num_levels 3", "--num-levels is given more than once"),
        ("train maze corner --learning-rate 1 --set lr=2", "--learning-rate is given more than"),
        ("sweep maze-corner --start maze-corner --set start=a,b", "--start is given more than"),
        ("level maze corner --set squid=5", "unknown knob 'squid'; there are: time_limit"),
        ("level maze corner --set region=5.5", "region must be of type int; got 5.5"),
        (
            "reproduce maze-cornr",
            "unknown experiment 'maze-cornr'; there are: absent-supervisor, agency, ",
        ),
        (
            "reproduce maze-corner maze-cornr",
            "unknown experiment 'maze-cornr'; there are: absent-supervisor, agency, ",
        ),
        (
            "evaluate nowhere",
            "unknown agent 'nowhere', which is neither a run folder nor a checkpoint",
        ),
        ("replay maze corner --level 1 --actions nowhere.txt", "nowhere.txt"),
    ],
)
def test_mistakes_are_explained(astray, words, message):
    assert message in astray(*words.split(), fails=True)


def test_a_level_whose_episode_may_last_for_ever_is_not_explained_for_minutes_first(
    astray, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    words = "explain maze-corner --level 3 --num-levels 4 --set time_limit=2147483647"
    assert "lower the variant's time_limit (--set" in (told := astray(*words.split(), fails=True))
    assert "1 of 6" not in told


@pytest.mark.parametrize("verb", ["evaluate maze-corner", "export maze-corner --out x"])
def test_art_is_of_who_sees_images(verb, astray):
    environment(DRAWN["maze"])  # else it is told first that there are no pictures
    told = astray(*verb.split(), "--art", "original", fails=True)
    assert "--art draws images; this policy sees symbolic" in told


def test_actions_are_read_as_powershell_writes_them(astray, tmp_path):
    path = tmp_path / "actions"
    path.write_text("left right", "utf-16")
    assert "left" in astray("replay", "maze", "corner-small", "--level", "1", "--actions", path)


def test_an_unknown_action_is_explained(astray, tmp_path):
    path = tmp_path / "actions"
    path.write_text("left jump")
    words = ("replay", "maze", "corner", "--level", "1", "--actions", path)
    assert "unknown action 'jump'; there are: 0 left-down" in astray(*words, fails=True)
    path.write_text("left " + 5000 * "9")
    assert "unknown action '9999" in (told := astray(*words, fails=True)) and len(told) < 1000
    path.write_bytes(b"left \xff\x00")
    assert f"astray: {path}: 'utf-8' codec can't decode" in astray(*words, fails=True)


def test_the_window_opens_and_plays(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    from astray import play

    shots = []

    def flip():
        shots.append(pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1))
        key = {1: pygame.K_n, 2: pygame.K_r}.get(len(shots), pygame.K_ESCAPE)
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))

    monkeypatch.setattr(pygame.display, "flip", flip)
    maze = games.find("maze")
    play.play(maze, maze.variants["corner"], level=LEVELS.stop - 1)  # after it comes the first
    shots.clear()
    play.play(maze, maze.variants["corner"], level=3)
    assert len(shots) == 4
    from astray.envs.vector import GameVectorEnv

    env = GameVectorEnv("maze", "corner")
    seen, _ = env.reset(seed=0, options={"level": 4})
    left = play.PICTURE + 2 * play.GAP
    view = shots[1][play.GAP : play.GAP + play.VIEW : 4, left : left + play.VIEW : 4]
    assert np.array_equal(view, seen[0])
    big = shots[1][play.GAP : play.GAP + play.PICTURE, play.GAP : play.GAP + play.PICTURE]
    assert np.array_equal(big, env.picture(play.PICTURE)[0])


@pytest.mark.parametrize(
    "game, variant, steps", [("maze", "corner", 1), ("coinrun", "coin-end", 4)]
)
def test_time_goes_on_without_keys_where_things_move(game, variant, steps, monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    from astray import play

    told, frames = [], []
    monkeypatch.setattr(pygame.key, "get_pressed", lambda: Keys())
    monkeypatch.setattr(play, "_lines", lambda env, *_: told.append(int(env.states[0].time)) or [])

    class Keys:
        def __getitem__(self, key):
            return key == pygame.K_RIGHT and len(frames) == 2

    def flip():
        frames.append(None)
        if len(frames) == 6:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE))

    monkeypatch.setattr(pygame.display, "flip", flip)
    play.play(games.find(game), games.find(game).variants[variant], level=3)
    assert told[:3] == [0, 0, 1] and told[5] == steps


def test_no_window_is_played_in_where_there_is_no_screen(astray, monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "offscreen")  # which SDL finds by itself there
    assert "playing needs a screen" in astray("play", "maze", "corner", fails=True)


def test_a_key_that_is_pressed_and_released_between_two_steps_is_a_step(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    from astray import play

    told, keys = [], [pygame.K_RIGHT, pygame.K_UP, pygame.K_ESCAPE, pygame.K_ESCAPE]
    monkeypatch.setattr(play, "_lines", lambda env, *_: told.append(int(env.states[0].time)) or [])

    def flip():
        for kind in (pygame.KEYDOWN, pygame.KEYUP):
            pygame.event.post(pygame.event.Event(kind, key=keys[len(told) - 1]))

    monkeypatch.setattr(pygame.display, "flip", flip)
    play.play(games.find("maze"), games.find("maze").variants["corner"], level=3)
    assert told == [0, 1, 2, 2]


def test_keys_press_the_actions_that_a_game_has():
    pygame = pytest.importorskip("pygame")
    from astray import play

    env = SimpleNamespace(game=games.find("pottery"))
    words = [(), ("SPACE",), ("LEFT",), ("a", "w"), ("UP", "SPACE"), ("1",), ("2",), ("3",)]
    pressed = [{getattr(pygame, f"K_{key}") for key in keys} for keys in words]
    keys = [defaultdict(bool, dict.fromkeys(held, True)) for held in pressed]
    found = [play._action(env, held, (), pygame) for held in keys]
    names = [None if action is None else env.game.actions[action] for action in found]
    assert names == [None, "stay", "left", "left", "up", "pick", "drop", None]


def test_levels_played_are_counted_on_standard_error(monkeypatch, capsys):
    monkeypatch.setattr(acting, "EVERY", 0)
    words = ["astray", "evaluate", "maze-corner", "--levels", "0:3", "--batch", "1", "--json"]
    monkeypatch.setattr(sys, "argv", words)
    cli.main()
    told = capsys.readouterr()
    assert json.loads(told.out) and "2 of 3 levels played\n" in told.err
    lines = [line for line in told.err.splitlines() if "levels played" in line]
    assert all(line != after for line, after in pairwise(lines)), "a number is told twice"


@pytest.mark.parametrize("words", ["--preset paper", "--preset=paper"])
def test_a_presets_settings_are_the_defaults(astray, monkeypatch, words):
    given = []
    train = "astray.training.track.train_tracked"
    monkeypatch.setattr(train, lambda config, *_, **__: given.append(config))
    astray("train", "maze", "corner", *words.split(), "--steps", "1000")
    assert given[0].network == "impala" and given[0].steps == 1000


def test_an_agent_is_evaluated_with_the_knobs_it_was_trained_with(astray, run_folder, tmp_path):
    folder, out = tmp_path / "changed", tmp_path / "episodes.parquet"
    astray("train", "maze", "corner-small", *TINY, "--set", "time_limit=7", "--out", folder)
    astray("evaluate", folder / "seed-0", "--out", out, "--json")
    episodes = pl.read_parquet(out)
    assert episodes["length"].max() == 7
    assert episodes["level"].min() == 100_000 and episodes["level"].n_unique() == 1000
    other = tmp_path / "other"  # trained in the levels that the first is tested on
    knobs = ("--set", "time_limit=7", "--first-level", "100000")
    astray("train", "maze", "corner-small", *TINY, *knobs, "--out", other)
    astray("evaluate", folder / "seed-0", other / "seed-0", "--out", out, "--json")
    assert pl.read_parquet(out)["level"].min() == 200_000
    said = astray("evaluate", run_folder, folder / "seed-0", fails=True)
    assert "share the knobs" in said and "has {}" in said and "has {'time_limit': 7}" in said


@pytest.mark.parametrize(
    "words", [["train", "maze", "corner-small", *TINY], ["distil", "maze-corner"]]
)
def test_no_seed_is_trained_if_a_later_one_cannot_be(astray, run_folder, tmp_path, words):
    (tmp_path / "seed-2").write_text("mine")
    given = (*words, "--seeds", "3", "--out", tmp_path)
    assert "seed-2" in astray(*given, fails=True)
    assert [path.name for path in tmp_path.iterdir()] == ["seed-2"]
    (tmp_path / "seed-2").unlink()
    shutil.copytree(run_folder, tmp_path / "seed-1")
    assert "seed-1 holds a run with other settings: " in astray(*given, fails=True)
    assert [path.name for path in tmp_path.iterdir()] == ["seed-1"]


def test_it_tells_agents_from_devices(astray, run_folder, tmp_path):
    words = ("agency", run_folder, "--levels", "0:4", "--set", "time_limit=12")
    told = json.loads(astray(*words, "--json"))
    assert set(told["explanations"]) == {"cheese", "corner", "another cell", "device"}
    assert told["episodes"] == 4 and told["moves"] >= told["decisions"]
    assert sum(one["mean"] for one in told["explanations"].values()) == pytest.approx(1)
    shown = astray(*words, "--measure", "paper", "--out", tmp_path / "told")
    assert "another cell" in shown and "4 episodes" in shown
    assert {path.name for path in (tmp_path / "told").iterdir()} == {
        "agency.json",
        "episodes.parquet",
        "posterior.gif",
        "posterior.mp4",
        "posterior.png",
    }
    assert json.loads((tmp_path / "told" / "agency.json").read_text())["episodes"] == 4
    (tmp_path / "episodes.parquet").write_text("mine")
    told = astray(*words, "--out", tmp_path, fails=True)
    assert (
        "episodes.parquet was not written by astray, which would have agency.json beside it" in told
    )


def test_help_does_not_wait_for_torch_nor_a_list_for_what_draws():
    program = """
import sys
from collections import defaultdict
from itertools import pairwise
from astray.cli import verbs
for name in verbs.VERBS:
    verbs.find(name)
print("torch" in sys.modules)
sys.argv = ["astray", "list"]
verbs.run()
print("matplotlib" in sys.modules)
"""
    # What they do with agents imports it when it is needed.
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    first, *_, last = told.stdout.splitlines()
    assert first == last == "False"


@pytest.mark.parametrize("words", [("--game", "keys"), ("--observation", "symbolic")])
@pytest.mark.parametrize("verb", ["evaluate", "export"])
def test_what_a_policy_is_told_is_nothing_for_a_run(astray, verb, words):
    assert f"{words[0]} {words[1]} needs --policy" in astray(
        verb, "maze-corner", *words, fails=True
    )
