"""Questions of a page are answered; whatever else is sent is refused with what is wrong."""

import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from safetensors.numpy import load_file

from astray import games
from astray.acting import initial_states
from astray.agents.policy import Architecture, weights
from astray.analysis.adapters import Function
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.policies import Walk
from astray.analysis.replay import replay
from astray.analysis.runs import load_agent, play_all
from astray.insight.fields import fields
from astray.lab import agents
from astray.lab.agents import Agents
from astray.lab.messages import LARGEST, read
from astray.lab.serving import make_lab
from astray.lab.session import ANSWERS, Lab, Session, about_game, drawings
from astray.lab.worlds import play_on, read_world, snapshot
from astray.level import Level
from astray.record import COMMON, state_dtype
from astray.training import checkpoint
from astray.training.ppo import RewardNormaliser
from helpers.browsed import usual_lab
from helpers.trainings import PLAIN, train_to_first_checkpoint

MESSAGES = int(os.environ.get("ASTRAY_LAB_MESSAGES", "400"))  # of those at random
MAZE = {"game": "maze", "variant": "anywhere-small", "agent": "maze-corner"}
MAZE_STARTS = {"game": "maze", "variant": "anywhere-small", "level": 0}
MAZE_TESTED = (
    games.find("maze"),
    "test",
    games.find("maze").variant("anywhere-small"),
    "corner-small",
)
ROOM = "#######\n#....G#\n#.###.#\n#.#...#\n#.#.#.#\n#@....#\n#######"


@pytest.fixture(scope="module")
def lab():
    return usual_lab()


@pytest.fixture
def session(lab):
    return Session(lab)


def ask(session, kind, **more):
    """The parts of an answer, joined where they are lists."""
    parts = list(session.answers(json.dumps({"id": 7, "kind": kind, **more})))
    assert all(part["id"] == 7 for part in parts) and parts[-1]["done"]
    joined = {}
    for part in parts:
        for name, value in part.items():
            joined[name] = joined.get(name, []) + value if isinstance(value, list) else value
    return joined


@pytest.mark.parametrize("code", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_level_of_a_file_is_read_as_other_verbs_read_it(tmp_path, code):
    drawn, data = tmp_path / "l.txt", tmp_path / "l.json"
    drawn.write_text(f"; a comment\n\n{ROOM}\n", code)
    level = Level.from_text(*MAZE_TESTED[::2], ROOM).to_json() | {"looks": {"background": 2}}
    data.write_text(json.dumps(level), code)
    for path, background in ((drawn, 0), (data, 2)):
        lab = make_lab("maze-corner", {"level": path})
        (told,) = Session(lab).answers(json.dumps(MAZE | {"id": 1, "kind": "level"} | lab.start))
        assert told["text"] == ROOM and told["level"]["looks"]["background"] == background
    drawn.write_bytes(b"\xff\x00")
    with pytest.raises(ValueError, match=r"l\.txt: 'utf-8' codec can't decode"):
        make_lab("maze-corner", {"level": drawn})


def test_the_first_agent_is_one_that_sees_the_levels():
    assert make_lab(None, {"level": 0}).start["agent"] == "maze-corner"
    dish = make_lab(None, {"variant": "dish-small", "level": 0})  # of more symbolic planes
    assert dish.agents.open(dish.start["agent"])[0].observation == "image"
    assert dish.start["variant"] == "dish-small"
    assert (
        make_lab(None, {"game": "pottery", "variant": "anywhere", "level": 0}).start["agent"] == ""
    )
    with pytest.raises(ValueError, match="unknown variant 'dishes' of maze"):
        make_lab(None, {"game": "maze", "variant": "dishes"})
    with pytest.raises(ValueError, match="variant that maze-corner sees 'dish-small'; there"):
        make_lab("maze-corner", {"variant": "dish-small"})


def test_a_level_distinguishes_the_goals_as_walks_to_them_do(session, lab):
    begun = lab.start["level"]
    played = play_all(*MAZE_TESTED, range(begun + 1), [])
    told = [
        ask(session, "distinguishes", **MAZE, level=k)["distinguishes"] for k in range(begun + 1)
    ]
    assert told[:6] == [False, False, True, False, True, True] and told[begun]  # stuck in 2
    walks = played.filter(policy="walk to corner").sort("level")
    assert walks["distinguishing"].to_list() == told
    runner = {"game": "coinrun", "variant": "coin-anywhere", "agent": "coin-end", "level": 0}
    assert ask(session, "distinguishes", **runner)["distinguishes"] is None


def test_hello_tells_games_and_agents(session):
    about = ask(session, "hello")
    assert set(games.OWN) <= about["games"].keys()
    assert about["agents"]["maze-corner"]["game"] == "maze"
    assert "anywhere" not in about["agents"]["maze-corner"]["variants"]  # of 25 cells
    assert about["start"]["variant"] == "anywhere-small"


def test_a_page_gets_every_drawing_that_a_world_of_cells_is_made_of():
    worlds = [game for game in map(games.find, games.OWN) if game.sprites]
    assert len(worlds) > 7
    for game in worlds:
        about, art = about_game(game), drawings(game)
        named = {
            *about["floors"],
            *(name for names in about["pictures"].values() for name in names),
        }
        assert about["pictures"].keys() == about["legend"].keys()
        assert named <= art.keys() and all("<svg" in text for text in art.values())
    art, (s,) = drawings(games.find("lavaland")), initial_states("lavaland", "dry", [0])
    assert games.find("lavaland").sprites.agent(s) in art


def test_what_rewards_were_divided_by_is_told_where_it_was_kept(tmp_path, monkeypatch):
    train_to_first_checkpoint(PLAIN, tmp_path / "divided", monkeypatch)
    train_to_first_checkpoint(
        replace(PLAIN, normalise_reward=False), tmp_path / "whole", monkeypatch
    )
    named = Agents.of({name: tmp_path / name for name in ("divided", "whole")})
    kept = load_file(checkpoint.latest(tmp_path / "divided") / "trainer.safetensors")
    normaliser = RewardNormaliser(1, variance=kept["training.moments"][1])
    told = named.about("divided")["reward_deviation"]
    assert 3 / told == pytest.approx(normaliser.scaled(np.array([3.0]))[0])
    assert named.about("whole")["reward_deviation"] is None
    named.open("divided")[0].path.with_name("trainer.safetensors").write_bytes(b"half of it")
    assert named.about("divided")["reward_deviation"] == told  # as its training removes it later
    later = Agents.of({"divided": tmp_path / "divided"})
    assert later.about("divided")["reward_deviation"] is None  # as pretrained agents' is
    assert named.about("maze-corner")["reward_deviation"] is None


def test_an_agent_is_shown_as_it_is_when_its_training_has_gone_on(untrained, tmp_path):
    """A lab of the agent of a checkpoint showed that of the last one; long paths were refused."""
    architecture = load_agent("maze-corner").architecture
    path = untrained(tmp_path / ("long-" * 30), architecture)
    agent = load_agent(path.parent)
    later = path.parent.with_name("2") / path.name
    later.parent.mkdir()
    later.write_bytes(weights(architecture.build(), architecture, "maze"))
    session = Session(make_lab(agent, {"game": "maze", "level": 0}))
    told = ask(session, "fields", **MAZE | {"agent": session.lab.start["agent"]}, level=ROOM)
    level = Level.from_text(*MAZE_TESTED[::2], ROOM)
    (expected,) = fields(agent, "anywhere-small", {"": level})
    assert np.allclose(sorted(told["value"]), sorted(expected.value), atol=1e-5)


def test_fields_are_those_of_insight(session):
    level = Level.from_text(games.find("maze"), games.find("maze").variant("anywhere-small"), ROOM)
    (expected,) = fields(load_agent("maze-corner"), "anywhere-small", {"": level})
    told = ask(session, "fields", **MAZE, level=ROOM)
    policy = {tuple(cell): p for cell, p in zip(told["cells"], told["policy"], strict=True)}
    value = {tuple(cell): v for cell, v in zip(told["cells"], told["value"], strict=True)}
    for cell, p, v in zip(expected.cells.tolist(), expected.policy, expected.value, strict=True):
        assert np.allclose(policy[tuple(cell)], p, atol=1e-6)
        assert np.isclose(value[tuple(cell)], v, atol=1e-5)


@pytest.mark.parametrize(
    "change, said",
    [
        (ROOM.replace("@", "."), "a level has one '@'"),
        (ROOM.replace("G", "GG").replace("...GG", "..GG"), "a level has at most one goal"),
        (ROOM.replace("....#\n", "....\n", 1), "a level's rows are equally long"),
    ],
)
def test_a_level_that_cannot_begin_is_told_in_the_words_of_levels(session, change, said):
    assert said in ask(session, "level", **MAZE, level=change)["error"]


def test_what_cannot_be_reached_is_told_and_arrows_are_there(session):
    walled = ROOM.replace("#....G#\n#.###.#", "#...#G#\n#.#####")
    told = ask(session, "level", **MAZE, level=walled)
    assert told["problem"] == "the goal at cell (5, 5) cannot be reached from (1, 1)"
    assert ask(session, "fields", **MAZE, level=walled)["cells"]


@pytest.mark.parametrize(
    "game, variant, agent",
    [("maze", "anywhere-small", "maze-corner"), ("keys", "many-keys-small", "many-chests"),
     ("coinrun", "coin-end-calm", "coin-end")],
)  # fmt: skip
def test_an_episode_goes_as_replay_has_it(session, game, variant, agent):
    actions = [7, 7, 8, 1, 5, 4, 7, 8, 3, 3, 6, 2]
    told = ask(session, "play", game=game, variant=variant, level=4, agent=agent, actions=actions)
    expected = replay(game, games.find(game).variant(variant), 4, actions)
    states = told["states"][1:]
    assert [(s["x"], s["y"]) for s in states] == [(s["x"], s["y"]) for s in expected["steps"]]
    assert told["rewards"] == [step["reward"] for step in expected["steps"]]
    events = games.find(game).events
    assert {event: states[-1][event] for event in events} == expected["events"]


def test_an_agent_goes_on_from_any_step(session):
    whole = ask(session, "play", **MAZE, level=5, steps=30)
    begun = whole["actions"][:4]
    later = ask(session, "play", **MAZE, level=5, actions=begun, steps=26)
    assert later["actions"][: len(begun)] == begun
    assert later["actions"] == whole["actions"]


def test_the_posterior_comes_to_the_goal_that_is_walked_to(session):
    up, right = 5, 7
    told = ask(session, "posterior", **MAZE, level=ROOM, actions=[up] * 4 + [right] * 4)
    cheese, corner = told["goals"]["cheese"], told["goals"]["corner"]
    assert cheese == corner and cheese[-1] > 0.4 > cheese[0]  # here they are the same cell
    assert len(told["agent"]) == len(cheese) == 9


def test_a_splay_counts_every_place_of_the_cheese(session):
    told = ask(session, "splay", **MAZE, level=ROOM, thing="goal", draws=2)
    level = Level.from_text(games.find("maze"), games.find("maze").variant("anywhere-small"), ROOM)
    assert {tuple(c) for c in told["cells"]} == {
        one.where("goal")[0] for one in level.splay("goal")
    }
    assert all(sum(outcome.values()) == 2 for outcome in told["outcomes"])


def test_a_splay_counts_goals_that_only_the_end_of_an_episode_shows(session):
    asked = {"game": "tomatoes", "variant": "bucket", "agent": "tomatoes-bucket"}
    drawn = "dddddd\ndddddd\n######\n######\n######\n@B####"  # no tomato can be reached
    told = ask(session, "splay", **asked, level=drawn, thing="agent")
    assert told["outcomes"] == [{"more hiding": 1}]


def test_a_splay_of_episodes_without_an_end_says_what_can_be_done_in_the_lab(session):
    asked = MAZE | {"knobs": {"time_limit": 10**9}, "level": ROOM, "thing": "goal"}
    told = ask(session, "splay", **asked)["error"]
    assert told.startswith("a splay plays whole episodes, and here one lasts up to 1,000,000,000")
    assert "hand over to the agent" in told and "--set" not in told


@pytest.mark.parametrize("game", ["maze", "keys", "coinrun"])
def test_a_level_that_a_page_moved_the_agent_in_is_one(session, game):
    variant = {"maze": "anywhere-small", "keys": "many-keys-small", "coinrun": "coin-end"}[game]
    told = ask(session, "level", game=game, variant=variant, level=3)["level"]
    x, y = map(int, told["agent"])
    to = next([u, y] for u in (x + 1, x - 1, x) if told["grid"][y][u] == 0)
    moved = {name: told[name] for name in ("grid", "looks")} | {"agent": [to[0] + 0.5, y + 0.5]}
    again = ask(session, "level", game=game, variant=variant, level=moved)
    assert "error" not in again and list(map(int, again["level"]["agent"])) == to


def test_an_intervention_changes_the_arrows_of_its_question_alone(session):
    plain = ask(session, "fields", **MAZE, level=ROOM)
    steering = {"what": "ablate", "layer": "features.relu2"}
    ablated = ask(session, "fields", **MAZE, level=ROOM, steering=steering)
    assert plain["policy"] != ablated["policy"]
    assert len({json.dumps(p) for p in ablated["policy"]}) == 1  # of a layer of zeros all is alike
    assert ask(session, "fields", **MAZE, level=ROOM)["policy"] == plain["policy"]


def test_an_answer_keeps_its_intervention_while_another_page_asks_for_another(lab, monkeypatch):
    monkeypatch.setattr(agents, "AT_ONCE", 4)
    steering = {"what": "ablate", "layer": "features.relu2"}
    asked = MAZE | {"id": 7, "kind": "fields", "level": ROOM, "steering": steering}
    parts = Session(lab).answers(json.dumps(asked))
    told = [next(parts)]
    ask(Session(lab), "fields", **MAZE, level=ROOM, steering=steering | {"channels": [1]})
    told += parts
    assert len({json.dumps(one) for part in told for one in part["policy"]}) == 1


def test_probes_read_what_is_true_of_the_state(session, monkeypatch):
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    monkeypatch.setattr(agents, "VISITED", 40)
    told = ask(session, "reading", **MAZE, level=17, layer="features.relu1")
    assert told["rows"] and all(row["layer"] == "features.relu1" for row in told["rows"])
    assert any(row["true"] is not None and row["score"] > 0.5 for row in told["rows"])
    assert "layer" in ask(session, "reading", **MAZE, level=17, layer="nothing")["error"]


def test_the_best_way_takes_the_coin_that_ends_the_episode(session):
    runner = {"game": "coinrun", "variant": "coin-anywhere", "level": 3}
    told = ask(session, "route", **runner, goal="coin")
    s = initial_states("coinrun", "coin-anywhere", [3])[0]
    ((x, y, _),) = told["takes"]
    assert (x, y) == (s.coin_x, s.coin_y) and told["steps"] == len(told["cells"]) - 1


@pytest.mark.parametrize(
    "game, variant, goal",
    [
        ("maze", "anywhere-small", "dish"),
        ("box", "bare", "push"),
        ("tomatoes", "bare", "bucket"),
        ("coinrun", "coin-end", "beyond"),
        ("heist", "hard", "keys"),
    ],
)
def test_a_way_to_what_a_level_lacks_is_none(session, game, variant, goal):
    told = ask(session, "route", game=game, variant=variant, level=3, goal=goal)
    assert told["error"] == f"there is no way to {goal!r} from here that the solver knows"


def test_there_is_no_best_way_after_the_end(session):
    runner = {"game": "coinrun", "variant": "coin-end", "level": 3, "agent": "coin-end"}
    played = ask(session, "play", **runner, steps=400)
    assert played["ended"]
    told = ask(session, "route", **runner, actions=played["actions"], goal="wall")
    assert told["error"] == "the episode has ended: go back a step, and ask from there"


def test_probes_are_not_fitted_to_the_level_that_they_read(monkeypatch):
    lab, played = make_lab("maze-corner", {"level": 0}), []

    def visit(agent, variant, levels, **more):
        played.append(list(levels))
        return None, np.zeros(1)

    monkeypatch.setattr(agents, "visit", visit)
    for number in (7, agents.FIRST_VISITED + 3):
        world = read_world(read(json.dumps({"id": 1, "kind": "level", **MAZE, "level": number})))
        lab.agents.visited("maze-corner", world)
        assert number not in played[-1] and len(played[-1]) == agents.VISITED


def test_the_best_way_takes_a_key_before_a_chest(session):
    told = ask(session, "route", game="keys", variant="many-keys-small", level=5, goal="chests")
    ((x, _, what), *_) = told["takes"]
    assert what == games.find("keys").editing.LEGEND["k"]
    assert (int(told["cells"][told["steps"]][0]) - x) ** 2 <= 1 and told["steps"] > 0


@pytest.mark.parametrize(
    "game, variant, goal, takes",
    [("pottery", "corner", "bin", "s"), ("monsters", "short", "apple", "a"),
     ("follow", "expert", "partner", None)],
)  # fmt: skip
def test_the_best_way_takes_what_lies_where_the_agent_stands(session, game, variant, goal, takes):
    """It stands still to pick up, and movers that move are not taken."""
    told = ask(session, "route", game=game, variant=variant, level=2, goal=goal)
    if not takes:
        assert told["takes"] is None
        return
    ((x, y, what),) = told["takes"]
    assert what == games.find(game).editing.LEGEND[takes]
    assert told["cells"][told["steps"]] == [x + 0.5, y + 0.5]


@pytest.mark.parametrize(
    "message, said",
    [
        ("{", "must be JSON"),
        ("[" * 100_000, "must be JSON"),
        ('{"id": ' + 5000 * "9" + "}", "must be JSON; Exceeds the limit"),
        ("x" * (LARGEST + 1), "at most"),
        ('{"id": 1}', "must have a field 'kind'"),
        ('{"id": 1, "kind": "level", "path": "/etc/passwd"}', "unknown field 'path'"),
        ('{"id": 1, "kind": "level", "game": "../maze"}', "unknown game"),
        ('{"id": 1, "kind": "play", "game": "maze", "variant": "corner", "agent": "/tmp"}',
         "unknown agent '/tmp'"),
        ('{"id": 1, "kind": "fields", "seed": NaN}', "must be finite"),
        ('{"id": 1, "kind": "play", "steps": 1e9}', "steps must be an integer"),
    ],
)  # fmt: skip
def test_what_is_no_question_is_refused(session, message, said):
    (answer,) = session.answers(message)
    assert said in answer["error"] and answer["done"]


@pytest.mark.parametrize("network", ["mlp+gru", "mlp+lstm"])
def test_an_agent_with_memory_goes_on_from_what_it_saw(untrained, tmp_path, network):
    architecture = Architecture(network, (4, 7, 7), (1, 1, 6, 6), 15, width=8)
    untrained(tmp_path / "run", architecture, network=network, width=8)
    session = Session(Lab(Agents.of({"mouse": tmp_path / "run"}), {}))
    body = session.lab.agents.open("mouse")[0].network.body
    body.policy.weight.data *= 5_000  # from near uniform
    asked = MAZE | {"agent": "mouse", "level": 12}
    whole, stepped = ask(session, "play", **asked, steps=16)["actions"], []
    for _ in whole:
        stepped = ask(Session(session.lab), "play", **asked, actions=stepped, steps=1)["actions"]
    handed = ask(Session(session.lab), "play", **asked, actions=whole[:7], steps=9)["actions"]
    assert stepped == handed == whole
    world = read_world(read(json.dumps({"id": 1, "kind": "level", **asked})))
    states = play_on(None, world, whole[:9]).states
    agent = session.lab.agents.open("mouse")[0]
    seen = observe(agent, world.variant, np.concatenate(states))
    (first, *others), _ = policy_and_value(agent, seen, episode=True)
    told = ask(session, "fields", **asked, actions=whole[:9])
    assert np.allclose(told["policy"][0], others[-1], atol=1e-6)  # the nearest place is its own
    begun = ask(session, "fields", **asked)
    known = dict(zip(map(str, begun["cells"]), begun["policy"], strict=True))
    assert np.allclose(known[str(begun["cells"][0])], first, atol=1e-6)
    assert not np.allclose(told["policy"][0], known[str(told["cells"][0])], atol=1e-3)


def counting(seen, memory, begins):
    """Goes up in the first step of an episode, right in the second, and stays in all others."""
    assert memory is not None or begins.all()  # as every loop that plays has it
    age = np.where(begins, 0, 0 if memory is None else memory + 1)
    return np.array([5, 7, 4])[np.minimum(age, 2)], age


def test_a_function_with_memory_remembers_where_it_stands_and_nowhere_else():
    policy = Function(counting, "counting", observation="symbolic", remembers=True)
    session = Session(make_lab(policy, MAZE_STARTS))
    asked = MAZE | {"agent": "counting", "level": ROOM}
    for actions, here, does in (([], [1, 1], 5), ([5], [1, 2], 7), ([7, 7], [3, 1], 4)):
        told = ask(session, "fields", **asked, actions=actions)
        found = dict(zip(map(tuple, told["cells"]), np.argmax(told["policy"], 1), strict=True))
        assert found.pop(tuple(here)) == does and len(found) > 10 and {*found.values()} == {5}
    assert ask(session, "play", **asked, actions=[5], steps=3)["actions"] == [5, 7, 4, 4]
    assert "elsewhere it is asked as at" in session.lab.agents.about("counting")["caveat"]


def late(seen, memory, begins):
    """Goes right, then up and then stays; there is nothing to remember in the first step."""
    age = np.zeros(len(seen), int) if memory is None else memory + 1
    return np.array([7, 5, 4])[np.minimum(age + ~begins, 2)], None if begins.all() else age


def test_a_function_remembers_in_the_lab_though_it_has_nothing_to_remember_at_first():
    policy = Function(late, "late", observation="symbolic", remembers=True)
    session = Session(make_lab(policy, MAZE_STARTS))
    asked = MAZE | {"agent": "late", "level": ROOM}
    whole = ask(session, "play", **asked, steps=6)["actions"]
    assert ask(session, "play", **asked, actions=whole[:4], steps=2)["actions"] == whole


class Raises:
    """A policy of a user's own with an error in it."""

    name, observation, art = "mine", "symbolic", "own"

    def actions(self, turn):
        raise KeyError("x")


@pytest.mark.parametrize("kind", ["fields", "play"])
def test_an_error_of_a_user_s_policy_is_told_with_its_name_and_line(kind):
    session, line = Session(make_lab(Raises(), MAZE_STARTS)), Raises.actions.__code__.co_firstlineno
    told = ask(session, kind, **MAZE | {"agent": "mine", "level": 0, "steps": 3})["error"]
    assert told == f"the policy 'mine' fails: KeyError('x') (test_session.py, line {line + 1})"


def test_a_walk_to_what_the_game_lacks_is_refused_before_a_lab_begins():
    with pytest.raises(ValueError, match="unknown goal 'moon' of maze; there are: cheese"):
        make_lab(Walk("moon"), MAZE_STARTS)


def test_walks_in_drawn_levels_are_not_mixed_up():
    session = Session(make_lab(Walk("cheese"), MAZE_STARTS))
    other = ROOM.replace("....G", ".....").replace("@....", "@...G")
    asked = MAZE | {"agent": "walk to cheese"}
    here = asked | {"level": other, "actions": [5]}
    expected = ask(Session(session.lab), "fields", **here)
    ask(session, "fields", **asked, level=ROOM)  # as where one level is compared with another
    assert ask(session, "fields", **here) == expected


def test_arrows_are_compared_at_the_end_of_an_episode_too(session):
    actions = ask(session, "play", **MAZE, level=4, steps=300)["actions"]
    told = ask(session, "fields", **MAZE, level=4, actions=actions, effects=True)
    assert told["policy"] and "same" not in told


def random_message(random, samples):
    """A question with some fields changed to anything, or no question at all."""
    junk = [None, True, -1, 2**70, 1.5, "", "x" * 200, [], {}, [1] * 50, "maze", "corner", "goal"]
    message = dict(samples[random.integers(len(samples))])
    for _ in range(random.integers(0, 4)):
        name = list(message)[random.integers(len(message))]
        message[name] = junk[random.integers(len(junk))]
    text = json.dumps(message)
    if random.random() < 0.2:
        k = int(random.integers(len(text)))
        text = text[:k] + chr(int(random.integers(1, 0x2FF))) + text[k + random.integers(0, 5) :]
    return text


def test_random_messages_are_answered_and_nothing_breaks(session):
    samples = [
        {"id": 1, "kind": kind, **MAZE, "level": level, "mode": "greedy", "seed": 3, "slot": "a",
         "actions": [7, 5], "steps": 2, "thing": "goal", "cell": [1, 1], "goal": "cheese",
         "draws": 1, "knobs": {}, "steering": {}, "method": "occlusion"}
        for kind in ANSWERS if kind not in ("hello", "art", "reading") for level in (3, ROOM)
    ]  # fmt: skip
    random, refused = np.random.default_rng(0), 0
    for _ in range(MESSAGES):
        text = random_message(random, samples)
        parts = list(session.answers(text))
        assert parts[-1]["done"] and all(isinstance(part["id"], int) for part in parts)
        json.dumps(parts)
        refused += "error" in parts[-1]
    assert MESSAGES / 4 < refused < MESSAGES  # some are whole, and are answered


def test_a_message_is_read_as_it_was_written():
    message = read('{"id": 2, "kind": "splay", "thing": "goal", "cell": [3, 4], "draws": 5}')
    assert (message.kind, message.cell, message.draws) == ("splay", (3, 4), 5)


def test_a_page_is_told_no_numbers_that_its_json_does_not_have():
    box = games.find("box")
    fields = [(name, box.state[name]) for name in box.state.names if name not in {*COMMON, "gap"}]
    odd = [("near", np.float32), ("ways", float, 2), ("wave", complex), ("word", "U4")]
    rules = SimpleNamespace(**vars(box.rules) | {"STATE": state_dtype(*fields, *odd)})
    s = np.zeros(1, rules.STATE).view(np.recarray)[0]
    s.near, s.ways, s.x = np.inf, (np.nan, 0.5), 2
    told = snapshot(replace(box, name="odd", rules=rules), s)
    json.dumps(told, allow_nan=False)
    assert told["near"] is None and told["ways"] == [None, 0.5] and told["x"] == 2
    assert not {"wave", "word"} & {*told}
