"""Agents that others published: downloaded whole or not at all, and then like any other agent."""

import hashlib
import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from astray import games
from astray.acting import initial_states
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.evaluate import evaluate
from astray.analysis.runs import open_run, shift_of
from astray.files import LOCK
from astray.published import catalogue, check
from astray.published.catalogue import Check, Published
from astray.published.imported import Known, import_agent
from astray.training import folders
from astray.training.config import Config
from astray.training.folders import NAME, AgentFolder
from helpers.file_server import serving
from helpers.foreign import clarity, joblib_bytes, reference, saved

MAZE = ("--game", "maze", "--variant", "anywhere-easy")


@pytest.fixture
def serve():
    with serving() as start:
        yield start


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Where imported agents go."""
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path / "agents"))
    return tmp_path / "agents"


@pytest.fixture(scope="module")
def runner():
    """A file of RL-Clarity with random weights."""
    return joblib_bytes(clarity()[0])


@pytest.fixture(scope="module")
def mouse():
    """A file of train-procgen-pytorch with random weights."""
    return saved({"state_dict": reference((2, 2, 2))[0]})


def digest(data):
    return hashlib.sha256(data).hexdigest()


def entry(server, sha256):
    return Published(
        "runner",
        Known(about="A test."),
        "agent.jd",
        server.address,
        size=len(server.data),
        sha256=sha256,
    )


# What is fetched


def test_what_is_published_is_downloaded_checked_and_imported(serve, home, runner):
    run = catalogue.fetch(entry(serve(runner), digest(runner)))
    assert run == home / "runner" and (run / "README.md").exists()
    assert open_run(run)[1].variant == "procgen"
    assert os.listdir(home / "downloads") == [LOCK]


def test_a_wrong_digest_imports_nothing_and_leaves_nothing(serve, home, runner):
    with pytest.raises(ValueError, match=f"its SHA-256 is {digest(runner)}, not 00"):
        catalogue.fetch(entry(serve(runner), "00" * 32))
    assert folders.imported() == [] and not (home / "downloads").exists()


def test_without_a_digest_nothing_is_fetched_unless_asked_for(serve, home, runner):
    one = replace(entry(serve(runner), None), size=None)
    with pytest.raises(ValueError, match=r"no digest of runner is known.*--unchecked"):
        catalogue.fetch(one)
    assert digest(runner) in (catalogue.fetch(one, unchecked=True) / "README.md").read_text()


# The catalogue


@pytest.mark.parametrize("one", catalogue.catalogue().values(), ids=lambda one: one.name)
def test_every_entry_of_the_catalogue_can_be_acted_on(one):
    assert NAME.fullmatch(one.name) and one.name not in folders.pretrained()
    assert one.known.about and one.known.source
    assert bool(one.address) != bool(one.by_hand)
    assert not one.address or (one.address.startswith("https://") and one.known.variant)
    assert not one.tried or (one.sha256 and len(one.sha256) == 64 and one.size)
    if one.known.game:
        assert one.known.variant in games.find(one.known.game).variants


def test_the_list_says_what_is_here_and_what_was_not_tried(astray, home, tmp_path, runner):
    (tmp_path / "agent.jd").write_bytes(runner)
    astray("import", tmp_path / "agent.jd", "--as", "mine")
    assert "list takes no name; got 'x'" in astray("agents", "list", "x", fails=True)
    for words in (("fetch", "x", "--levels", "0"), ("list", "--unchecked")):
        assert "--levels goes with check" in astray("agents", *words, fails=True)
    found = json.loads(astray("agents", "--json"))
    assert found["folder"] == str(home) and found["others"] == ["mine"]
    assert found["published"]["openai-coinrun"]["state"] == "can be fetched"
    assert found["published"]["yrc-bench"]["state"] == "by hand; not tried here"
    assert "imported beside these: mine" in astray("agents", "list")


@pytest.mark.parametrize(
    "words, message",
    [
        ("agents fetch", "name an agent to fetch"),
        ("agents fetch squid", "unknown published agent 'squid'; there are: openai-coinrun"),
        ("agents fetch yrc-bench", "cannot be fetched: download the archive"),
        ("agents check maze-corner", "comes with astray; its card"),
        ("agents check squid", "unknown agent 'squid'"),
        (
            "evaluate squid",
            "unknown agent 'squid', which is neither a run folder nor a checkpoint in one",
        ),
    ],
)
def test_mistakes_are_explained(astray, home, words, message):
    assert message in astray(*words.split(), fails=True)


# Imported agents


def test_a_file_that_does_not_say_needs_to_be_told(astray, home, tmp_path, mouse):
    file = tmp_path / "agent.pth"
    file.write_bytes(mouse)
    assert "a game and a variant must be given" in astray("import", file, "--as", "m", fails=True)
    said = astray("import", file, "--as", "m", "--game", "maze", fails=True)
    assert "a variant of maze must be given" in said
    said = astray("import", file, "--as", "m", "--game", "maze", "--variant", "easy", fails=True)
    assert "unknown variant 'easy' of maze" in said
    for option in ("--as", "--game"):
        said = astray("import", file, "--as", "m", *MAZE, option, "", fails=True)
        assert f"{option} needs a value; got ''" in said
    assert not (home / "m").exists()


@pytest.mark.parametrize(
    "name, message", [("maze-corner", "already"), ("m", "already"), ("../m", "got '../m'")]
)
def test_a_name_is_one_and_new(astray, home, tmp_path, mouse, name, message):
    file = tmp_path / "agent.pth"
    file.write_bytes(mouse)
    astray("import", file, "--as", "m", *MAZE)
    assert message in astray("import", file, "--as", name, *MAZE, fails=True)


def test_an_agent_of_another_game_of_procgen_is_refused(home, tmp_path):
    (tmp_path / "agent.jd").write_bytes(joblib_bytes(clarity(env_name="bigfish")[0]))
    with pytest.raises(ValueError, match=r"trained in .bigfish hard. of Procgen.*are: coinrun"):
        import_agent(tmp_path / "agent.jd", "fish", Known())


@pytest.mark.parametrize("said", ["in its file", "beside it"])
def test_what_is_too_long_to_be_noted_is_refused(home, tmp_path, said):
    settings, source = ({"note": "a" * 2**20}, "") if said == "in its file" else ({}, "a" * 2**20)
    (tmp_path / "agent.jd").write_bytes(joblib_bytes(clarity(**settings)[0]))
    told = r"agent\.jd is refused: its settings, or the notes on it, are too long"
    with pytest.raises(ValueError, match=told):
        import_agent(tmp_path / "agent.jd", "long", Known(source=source))


def test_a_file_whose_name_is_no_text_is_imported(home, tmp_path, runner):
    file = tmp_path / os.fsdecode(b"agent-\xff.jd")
    try:
        file.write_bytes(runner)
    except OSError:
        pytest.skip("names of files are text here")
    assert "`agent-?.jd`" in (import_agent(file, "mine", Known()) / "README.md").read_text()


@pytest.mark.parametrize("option", ["--game=", "--variant=", "--art="])
def test_an_empty_word_is_not_what_the_file_says(astray, home, tmp_path, runner, option):
    (tmp_path / "agent.jd").write_bytes(runner)
    told = astray("import", tmp_path / "agent.jd", "--as", "m", option, fails=True)
    assert re.search("needs a value; got ''|a variant must be given|unknown art ''", told)


def test_what_is_said_of_an_agent_stays_in_its_cell(home, tmp_path, mouse):
    (tmp_path / "agent.pth").write_bytes(mouse)
    said = "a | b |\n| --- | --- |\n| evil"
    known = Known(game="maze", variant="anywhere", source=said)
    card = (import_agent(tmp_path / "agent.pth", "mine", known) / "README.md").read_text()
    assert "| source | a \\| b \\| \\| --- \\| --- \\| \\| evil |\n" in card


def test_a_card_tells_origin_licence_and_what_is_not_known(astray, home, tmp_path, runner, mouse):
    (tmp_path / "a.jd").write_bytes(runner)
    (tmp_path / "m.pth").write_bytes(mouse)
    astray("import", tmp_path / "a.jd", "--as", "a", "--licence", "MIT", "--source", "a friend")
    astray("import", tmp_path / "m.pth", "--as", "m", *MAZE, "--mode", "greedy", "--art", "own")
    card = (home / "a" / "README.md").read_text()
    for said in (
        "| licence | MIT |",
        "| source | a friend |",
        digest(runner),
        "gamma | 0.999",
        "363,216",
        "`coinrun procgen`",
        "art original",
        "Procgen, sampled",
        "all there are",
    ):
        assert said in card
    card = (home / "m" / "README.md").read_text()
    for said in (
        "none is known: not to be passed on",
        "environment steps | not known",
        "None is known; `config.json`",
        "art own",
        "Procgen, greedy",
    ):
        assert said in card


def test_every_verb_takes_an_imported_agent_by_its_name(astray, home, tmp_path, mouse):
    file = tmp_path / "agent.pth"
    file.write_bytes(mouse)
    astray("import", file, "--as", "m", *MAZE, "--art", "own")
    words = ("--levels", "0:3", "--set", "time_limit=20", "--json")
    said = astray("evaluate", "m", *words)
    assert said == astray("evaluate", "m", *words) == astray("evaluate", home / "m", *words)
    assert json.loads(said)[0]["variant"] == "anywhere-easy"
    assert json.loads(astray("agency", "m", *words))["episodes"] == 3
    video = tmp_path / "m.gif"
    astray("record", "m", "--pixels", "64", "--set", "time_limit=5", "--out", video)
    assert video.stat().st_size > 1000
    assert json.loads(astray("list", "--json"))["agents"]["m"]["variant"] == "anywhere-easy"


def test_a_folder_of_that_name_comes_before_an_agent(home, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert AgentFolder.open("maze-corner").path == folders.PRETRAINED / "maze-corner"
    shutil.copytree(folders.PRETRAINED / "coin-end", tmp_path / "maze-corner")
    assert AgentFolder.open("maze-corner").path == Path("maze-corner")


@pytest.mark.parametrize(
    "game, variant, shift",
    [("coinrun", "procgen", "procgen"), ("maze", "anywhere-easy", "corner-easy"),
     ("coinrun", "coin-end", "coin-end"), ("maze", "corner", "corner")],
)  # fmt: skip
def test_an_agent_of_a_test_variant_is_the_control_of_its_shift(game, variant, shift):
    assert shift_of(Config(game, variant)) == shift


def test_attribution_takes_the_clear_network(home, tmp_path, runner):
    pytest.importorskip("captum")
    from astray.insight import attribution

    (tmp_path / "a.jd").write_bytes(runner)
    agent, _ = open_run(import_agent(tmp_path / "a.jd", "a", Known(art="own")))
    images = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), np.uint8)
    maps = attribution.integrated_gradients(agent, images, steps=64)
    black = agent.outputs(np.zeros_like(images))[1]
    rise = (agent.outputs(images)[1] - black).numpy() / 3  # the mean over three colours
    assert np.allclose(maps.sum((1, 2)), rise, atol=0.02 * abs(rise).max())


# Checks


@pytest.mark.parametrize(
    "lengths, count, environments, ended",
    [
        ([5, 1, 1, 1, 1], 3, 2, [1, 2, 3]),  # while the first goes on, the second plays three
        ([5, 1, 1, 1, 1], 5, 2, [1, 2, 3, 4, 0]),
        ([3, 2, 1], 3, 3, [2, 1, 0]),
        ([3, 2, 1], 2, 0, [0, 1, 2]),
        ([1, 2], 9, 1, [0, 1]),
    ],
)
def test_the_first_episodes_to_end_are_the_short_ones(lengths, count, environments, ended):
    assert check.first_to_end(np.array(lengths), count, environments).tolist() == ended


def test_intervals_are_wilsons_and_meet_or_not():
    assert str(check.Rate(158, 160)) == "98.8 % (95.6 to 99.7, n = 160)"
    assert check.Rate(158, 160).meets(check.Rate(150, 160))
    assert not check.Rate(158, 160).meets(check.Rate(120, 160))


def test_a_check_is_written_to_the_card(astray, home, tmp_path, monkeypatch, mouse):
    file = tmp_path / "agent.pth"
    file.write_bytes(mouse)
    astray("import", file, "--as", "m", *MAZE, "--art", "own")
    asked = Check("anywhere-small", 4, 4, 2, 7.5, "maze_size", ((3, 1.0),))
    one = Published("m", Known(), sha256=digest(mouse), checks=(asked,))
    monkeypatch.setattr(catalogue, "catalogue", lambda: {"m": one})
    rows = json.loads(astray("agents", "check", "m", "--json"))
    assert rows[0]["levels"] == 6 and rows[0]["published"] == "100.0 % (51.0 to 100.0, n = 4)"
    assert rows[0]["alike"].endswith("n = 4)") and rows[0]["published_value"] == 7.5
    card = (home / "m" / "README.md").read_text()
    assert rows[0]["here"] in card and rows[0]["verdict"] in card and "Not checked" not in card


def test_an_agent_without_published_measurements_is_compared_with_random_actions(
    astray, home, tmp_path, mouse
):
    file = tmp_path / "agent.pth"
    file.write_bytes(mouse)
    astray(
        "import", file, "--as", "m", "--game", "maze", "--variant", "corner-small", "--art", "own"
    )
    (row,) = json.loads(astray("agents", "check", "m", "--levels", "0:8", "--json"))
    assert row["levels"] == 8 and row["published"] == ""
    assert "random actions succeed in" in row["verdict"]
    assert row["verdict"].endswith("the agent is not shown to be better.")
    assert row["verdict"] in (home / "m" / "README.md").read_text()


def test_a_check_chooses_actions_as_the_card_says(astray, home, tmp_path, mouse):
    (tmp_path / "agent.pth").write_bytes(mouse)
    of = ("--game", "maze", "--variant", "corner-small", "--art", "own", "--mode", "greedy")
    astray("import", tmp_path / "agent.pth", "--as", "m", *of)
    (row,) = json.loads(astray("agents", "check", "m", "--levels", "6:7", "--json"))
    lengths = {
        mode: evaluate(open_run("m", mode)[0], "maze", "corner-small", [6])["length"].mean()
        for mode in ("greedy", "sampled")
    }
    assert row["length"] == lengths["greedy"] != lengths["sampled"]


HERE = Path(os.environ.get("ASTRAY_PUBLISHED", "")) if os.environ.get("ASTRAY_PUBLISHED") else None


@pytest.fixture
def real(home, request):
    """An agent of the catalogue, imported from its own file."""
    one = catalogue.find(request.param)
    files = [HERE / one.file] if HERE else []
    if not any(file.is_file() for file in files):
        pytest.skip(f"ASTRAY_PUBLISHED names no folder with {one.file}, nothing of astray")
    from astray.art import original

    if len(original.missing()) > len(original.FORK_ALONE):
        pytest.skip("the original's pictures are not here: astray art import")
    return import_agent(files[0], one.name, one.known, expected=one.sha256)


@pytest.mark.parametrize(
    "real, levels, steps, least, start",
    [
        ("openai-coinrun", range(260, 300), 200, 0.9, (8.9, 9.3)),
        ("maze-160m", range(60), 80, 0.8, (4.4, 4.7)),  # 88 % of mazes within so many steps
    ],
    indirect=["real"],
)
def test_published_agents_do_here_what_they_did_there(real, levels, steps, least, start):
    agent, config = open_run(real)
    variant = config.variant_for(config.variant, {"time_limit": steps})
    episodes = evaluate(agent, config.game, variant, levels)
    assert (episodes["return"] > 0).mean() >= least
    begun = initial_states(config.game, config.variant, levels)
    value = policy_and_value(agent, observe(agent, config.variant, begun))[1].mean()
    assert start[0] < value < start[1]
