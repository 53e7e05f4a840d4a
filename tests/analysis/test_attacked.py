"""What an attack found, by class: each of these ended in something else than a sentence before."""

import http.server
import json
import os
import shutil
import stat
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from astray import games
from astray.agency import measure
from astray.agency.gridworld import World
from astray.agents import policy
from astray.agents.importers import files as importers
from astray.agents.mlp import MLP
from astray.agents.policy import Architecture
from astray.analysis.adapters import Function
from astray.analysis.critic import visit
from astray.analysis.estimates import estimate_mean, over_agents
from astray.analysis.evaluate import evaluate
from astray.analysis.policies import Random
from astray.analysis.runs import evaluate_policies, evaluate_runs, load_agent
from astray.analysis.video import play, write_gif
from astray.envs.states import save_states
from astray.envs.vector import GameVectorEnv
from astray.files import check_writable, read, write_aside
from astray.level import Level
from astray.published import imported
from astray.published.download import download
from astray.training.config import PRESETS
from astray.training.folders import AgentFolder, latest
from astray.training.loop import train
from helpers.cases import FEW

MAZE = games.find("maze")
SMALL = MAZE.variant("corner-small")
TINY = replace(
    PRESETS["small"],
    variant="corner-small",
    num_envs=4,
    num_steps=8,
    minibatches=2,
    epochs=1,
    width=8,
    steps=192,
    levels=50,
    checkpoint_every=2,
)
ROOM = World.parse("..\n..")
LEVELS = range(2)
NUMBERED = SimpleNamespace(name=5, observation="symbolic", art="own", actions=len)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run that has come to its end."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    train(TINY, folder, progress=False)
    return folder


@pytest.fixture
def run(trained, tmp_path):
    """A copy of it, which may be ruined."""
    shutil.copytree(trained, tmp_path / "run")
    return tmp_path / "run"


def test_an_older_checkpoint_is_named_in_its_verdict_and_opened_from_within_or_by_a_link(
    run, tmp_path, monkeypatch
):
    last, older = latest(run), run / "checkpoints" / "7"
    shutil.copytree(last, older)
    assert evaluate_runs([older], LEVELS).agents == (f"{run} at 7 steps",)
    assert (
        evaluate_runs([last], LEVELS).agents == evaluate_runs([run], LEVELS).agents == (str(run),)
    )
    (tmp_path / "link").symlink_to(older)
    (run / "checkpoints" / "best").symlink_to("7")
    monkeypatch.chdir(older)
    for path in (".", tmp_path / "link", run / "checkpoints" / "best", "../7"):
        assert AgentFolder.open(path).weights.samefile(older / "agent.safetensors")
        assert AgentFolder.open(path).steps == 7


# Records that were changed by hand, given to a solver.


@pytest.mark.parametrize("game, variant", FEW[::4])
@pytest.mark.parametrize("ability", ["expert", "optimal_return", "reachable"])
def test_a_solver_sees_the_record_that_it_is_given(game, variant, ability):
    env = GameVectorEnv(game, variant, observation="symbolic")
    env.reset(seed=0)
    solver, goal = env.game.solver, next(iter(env.game.event_goals))
    others = {"expert": (goal,), "optimal_return": (goal, 0.9), "reachable": ()}[ability]
    getattr(solver, ability)(env.get_state().view(np.recarray)[0], *others)
    for field, value in (("x", np.nan), ("y", np.inf), ("x", -1.0), ("mt_next", 2**40)):
        ruined = env.get_state()
        if ruined[field].dtype.kind in "iu" and not np.isfinite(value):
            continue  # a field of integers cannot hold it
        ruined[field] = value
        with pytest.raises(
            ValueError, match=r"the state is invalid for this game: its .* cannot be"
        ):
            getattr(solver, ability)(ruined.view(np.recarray)[0], *others)
    with pytest.raises(ValueError, match="must be a record of this game; got"):
        getattr(solver, ability)(np.zeros(3), *others)


def test_an_expert_sees_the_records_that_come_later():
    env = GameVectorEnv("keys", "many-chests-small", observation="symbolic")
    env.reset(seed=0)
    expert, later = env.game.solver.expert(env.states[0], "chests"), env.get_state()
    later["vx"] = np.nan  # it ended the process
    with pytest.raises(ValueError, match="its vx cannot be"):
        expert(later.view(np.recarray)[0])


@pytest.mark.skipif(sys.platform != "linux", reason="memory is told in other units, or not")
def test_a_solver_takes_no_memory_for_time_that_nobody_needs():
    import resource

    endless = replace(games.find("coinrun").variant("coin-end"), time_limit=2**31 - 1)
    env = GameVectorEnv("coinrun", endless, observation="symbolic")
    env.reset(seed=0, options={"level": 3})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert env.game.solver.optimal_return(env.states[0], "end") > 0
    # kB; it was 2 GB, a byte for each step.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000


# Files: pipes, devices, links, what is the user's beside what is astray's.


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
@pytest.mark.parametrize("reader", [importers.digest, importers.read])
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_an_agent_is_read_from_a_file_alone(tmp_path, kind, reader):
    path = tmp_path / "agent.pth"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with pytest.raises(
        OSError, match=r"agent\.pth must be a file; it is a folder, a pipe or a dev"
    ):
        reader(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
@pytest.mark.parametrize("write", [check_writable, lambda path: write_aside(path, b"new")])
def test_a_pipe_is_not_replaced_by_a_file(tmp_path, write):
    os.mkfifo(tmp_path / "pipe")  # as a device: root replaced /dev/full
    with pytest.raises(OSError, match="pipe must be a file to write; it is a pipe or a device"):
        write(tmp_path / "pipe")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


def test_what_is_to_be_written_is_no_link(tmp_path):
    (tmp_path / "stdout").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="stdout must be a file to write; it is a link"):
        check_writable(tmp_path / "stdout")


def test_a_folder_in_place_of_a_file_is_named_and_not_left_open(tmp_path):
    before = len(os.listdir("/dev/fd")) if os.path.isdir("/dev/fd") else 0
    for _ in range(5):
        with pytest.raises(OSError, match=f"{tmp_path} must be a file"):
            read(tmp_path)
    assert not before or len(os.listdir("/dev/fd")) == before


@pytest.fixture(params=["many", "9" * 5000])
def address(request):
    """Download from a server that gives a few bytes, and a length that nothing can have."""

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Length", request.param)
            self.end_headers()
            self.wfile.write(b"published")

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/agent.pth"
        server.shutdown()


def test_a_download_writes_through_no_link(address, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (tmp_path / "agent.pth.part").symlink_to(precious)
    with pytest.raises(OSError, match=r"agent\.pth\.part must be a file to write; it is a link"):
        download(address, tmp_path / "agent.pth", size=9, digest="0" * 64)
    assert precious.read_text() == "mine"


def test_a_length_that_is_no_number_is_no_length(address, tmp_path):
    download(address, tmp_path / "agent.pth", size=None, digest=None)
    assert (tmp_path / "agent.pth").read_bytes() == b"published"


@pytest.mark.parametrize("content", [b"", b"[]", b"null", b"{}", b"[" * 100_000, b"\xff\xfe"])
def test_the_origin_of_an_agent_is_what_was_written(run, content):
    (run / imported.ORIGIN).write_bytes(content)
    with pytest.raises(ValueError, match=r"origin\.json (is not JSON|must be a dict with file)"):
        AgentFolder.open(run).origin()


def test_the_card_of_an_agent_whose_checks_are_none_is_not_written(run):
    told = ("sha256", "settings_told", "file_says", "file", "format")
    (run / imported.ORIGIN).write_text(json.dumps({name: [] for name in told}))
    (run / imported.CHECKS).write_text('[{"variant": 1}]')
    with pytest.raises(ValueError, match="as astray does not"):
        imported.write_card(run, "agent")
    assert not AgentFolder.open(run).card.exists()


# Trust: what a file says is called.


@pytest.mark.parametrize("name", ["sys:exit", "os:abort", "torch:load", "threading:Thread"])
def test_a_file_has_nothing_called_that_is_no_network(name):
    architecture = Architecture(name, (5, 7, 7), (1,) * 5, 15)
    with pytest.raises(ValueError, match="must be a class derived from Module, or one of the entr"):
        architecture.build()


class Own(MLP):
    def __init__(self, a):
        super().__init__(a.shape, list(a.largest), a.actions, a.width)


def test_a_class_of_a_module_that_is_there_is_taken_from_a_file():
    architecture = Architecture(f"{__name__}:Own", (5, 7, 7), (1,) * 5, 15)
    assert isinstance(architecture.build(), Own)
    assert policy.GROUP == "astray.networks"


# What is given to functions.


def level(**changes):
    env = GameVectorEnv("maze", "corner-small", observation="symbolic")
    env.reset(seed=0, options={"level": 3})
    return replace(Level.of(MAZE, SMALL, env.states[0]), **changes)


def stepped(**options):
    env = GameVectorEnv("maze", "corner-small", 2)
    env.reset(seed=0)
    return env.step(np.zeros(2, int), **options)


def reset(**options):
    return GameVectorEnv("maze", "corner-small", 2).reset(**options)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: reset(seed=-1), "seed must be an integer from 0 to 9223372036854775807; got -1"),
        (lambda: reset(seed=True), "seed must be an integer from 0 .*; got True"),
        (lambda: reset(seed=10**60), "seed must be an integer from 0"),
        (lambda: reset(seed=0, options=5), "options must be a Mapping; got 5"),
        (lambda: stepped(out=5), "out must be an array .2, 64, 64, 3. of uint8"),
        (lambda: GameVectorEnv(["maze"], "corner"), "a game must be a Game or its name; got"),
        (lambda: GameVectorEnv("maze", "corner", art=[]), "unknown art"),
        (lambda: GameVectorEnv("maze", "corner", autoreset_mode="never"), "there are: NextStep"),
        (lambda: SMALL.with_knobs(None), "knobs must be a Mapping; got None"),
        (lambda: save_states("states.npz", "maze", [1]), "states must be a ndarray; got"),
        (lambda: level(game="maze"), "a level's game must be a Game; got 'maze'"),
        (lambda: level(variant="corner"), "a level's variant must be a Variant; got 'corner'"),
        (lambda: level(looks=None), "a level's looks must be a Mapping; got None"),
        (lambda: level(looks={"background": "x"}).state(), "a level's looks are .*cannot be"),
        (lambda: level().where([]), "unknown object"),
        (lambda: Level.from_text(MAZE, SMALL, 5), "a level's drawing must be a str; got 5"),
        (lambda: evaluate(len, "maze", "corner-small", LEVELS), "a policy must have name, obser"),
        (lambda: rows([NUMBERED]), "a policy's name must be a str; got 5"),
        (lambda: evaluate_policies(["random"], "maze", "corner"), "got 'random'"),
        (lambda: play(None, "maze", "corner-small", 0), "a policy must have name"),
        (lambda: play(Random(), "maze", "corner-small", None), "level must be a int or"),
        (lambda: play(Random(), "maze", "corner-small", 0, longest=np.nan), "longest must be an i"),
        (lambda: evaluate_runs("runs/mice"), "runs must be a list of run folders; got 'runs/mice'"),
        (lambda: write_gif([[1]], "a.gif"), "frames must be a ndarray; got"),
        (lambda: write_gif(np.zeros((2, 8, 8, 3), np.uint8), "a.gif", 0), "fps must be an integer"),
        (lambda: estimate_mean([]), "values must be .agents, levels., at least one of each"),
        (lambda: estimate_mean([[1.0, 2.0]], [[-1.0, 1.0]]), "numbers, none below 0"),
        (lambda: over_agents(np.zeros(3)), "values must be .agents, points."),
        (lambda: Function(None), "choose must be a function; got None"),
        (lambda: World(None), "a world must be a ndarray; got None"),
        (lambda: ROOM.number((0.0, 1)), "a cell must be two integers, x and y; got"),
        (lambda: ROOM.number((True, 0)), "a cell must be two integers, x and y; got .True, 0."),
        (lambda: level().moved("agent", (np.True_, 0)), "a cell must be two integers, x and y"),
        (lambda: evaluate(Random(), "maze", "corner-small", [np.True_, 3]), "levels must be int"),
        (lambda: ROOM.walk((0, 0), [1.5]), "an action must be an integer from 0 to 3; got 1.5"),
        (lambda: measure.measure([1]), "an episode must be a Episode; got 1"),
        (lambda: measure.Options(beta="x"), "number from 1 to 1e.08; got 'x'"),
        (lambda: train({}, "run"), "config must be a Config; got {}"),
        (
            lambda: evaluate_policies([Function(len)], "maze", "corner-small", {1, 2}),
            "must be integer",
        ),
        (
            lambda: evaluate_policies([Function(len)], "maze", "corner-small", map(int, "12")),
            "must be",
        ),
    ],
)
def test_what_is_something_else_is_told(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    "measures, message",
    [
        (5, "measures must be a Mapping; got 5"),
        ({"m": lambda: 5}, r"the measure 'm' fails: TypeError\("),
        ({"m": 5}, "measures must be functions by name; got 'm': 5"),
        ({"level": len}, "measures have the names of other columns: level"),
        ({"m": lambda s: s["time"][:1]}, "the measure 'm' must return 2 values"),
        ({"m": lambda s: None}, "the measure 'm' must return 2 values"),
    ],
)
def test_measures_are_seen(measures, message):
    with pytest.raises(ValueError, match=message):
        evaluate(Random(), "maze", "corner-small", LEVELS, measures=measures)


@pytest.mark.parametrize("given", [{"per_episode": np.nan}, {"per_episode": 1.5}, {"seed": "x"}])
def test_what_a_visit_is_given_is_seen(trained, given):
    with pytest.raises(ValueError, match="must be an integer from"):
        visit(load_agent(trained), "corner-small", LEVELS, **given)


def rows(policies, levels=LEVELS, **how):
    """Names and levels played, by policy."""
    found = evaluate_policies(policies, MAZE, "corner-small", levels, **how)
    every = found.rates.filter(levels_played="all")
    return found.agents, dict(zip(every["policy"], every["levels"], strict=True))


def test_modes_and_checkpoints_of_one_run_are_agents_of_their_own(trained):
    first, *_, last = sorted((trained / "checkpoints").iterdir(), key=lambda path: int(path.name))
    one, other = load_agent(first), load_agent(last)
    greedy = load_agent(last, mode="greedy")
    found, levels = rows([other, greedy])
    assert found == (str(trained), f"{trained} (greedy)")
    assert all(levels[name] == len(LEVELS) for name in found)
    named = [f"{trained} at {path.name} steps" for path in (first, last)]
    assert rows([one, greedy])[0] == (named[0], f"{named[1]} (greedy)")
    assert evaluate_runs([first, last], LEVELS).agents == (*named,)
    with pytest.raises(ValueError, match=r"must be of several trainings; .* are of one"):
        evaluate_runs([first, last], LEVELS, pool=True)


def test_what_has_a_name_of_its_own_is_counted_by_itself(trained):
    mouse = load_agent(trained)
    namesake = Function(lambda seen: np.zeros(len(seen), int), str(trained), "symbolic")
    for policies in ([mouse, load_agent(trained)], [mouse, namesake]):
        with pytest.raises(ValueError, match="policies must have names of their own"):
            rows(policies)


@pytest.mark.parametrize("levels", [[4, 7, 4], np.array([7, 7])])
def test_a_level_is_not_counted_as_several(levels):
    with pytest.raises(ValueError, match=r"level \d is given 2 times"):
        evaluate_policies([Random(1, "other")], MAZE, "corner-small", levels)
