"""What agents that see images do is looked up: tables of it, and a page that reads them."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from astray import games, grid
from astray.acting import initial_states
from astray.agents.policy import Architecture
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.trained import Agent
from astray.insight.fields import states_at
from astray.lab.agents import Agents
from astray.lab.export import check_exportable, export, table
from astray.lab.serving import make_lab
from astray.lab.session import Lab, Session
from astray.level import Level
from helpers import moor
from helpers.browsed import folder_served, opened, usual_lab, wait

SIGHTED = Architecture("impala", (64, 64, 3), (), 15, widths=(4, 4, 4))
IMAGES = {"observation": "image", "network": "impala"}


def test_a_large_agent_is_looked_up_in_a_table(chrome, untrained, tmp_path):
    path = untrained(tmp_path / "run", SIGHTED, **IMAGES)
    lab = make_lab(tmp_path / "run", {"level": 0})
    export(lab, tmp_path / "site", levels=2, agents=[str(tmp_path / "run")])
    agent, game = Agent(path, "maze"), games.find("maze")
    variant = game.variant("anywhere-small")
    levels = [Level.of(game, variant, s) for s in initial_states(game, variant, range(2))]
    edited = levels[1].moved("goal", _another(levels[1]))
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, told):
        first = page.evaluate("[...lab.fields.values()]")
        assert "rounded to 256 steps here" in page.locator("[data-lab=lead]").text_content()
        wait(page, "lab.ready")
        message = {"kind": "fields", "agent": page.evaluate("lab.part('agent').value")}
        message |= {"game": "maze", "variant": "anywhere-small", "level": edited.to_json()}
        asked = page.evaluate("(message) => lab.engine.ask(message)", message)
        splay = {"kind": "splay", "level": 1, "thing": "goal"}
        ended = page.evaluate("(message) => lab.engine.ask(message)", message | splay)
        assert ended["of"] == len(levels[1].splay("goal")) and not told
    second = [
        {"cell": cell, "policy": policy, "value": value}
        for cell, policy, value in zip(asked["cells"], asked["policy"], asked["value"], strict=True)
    ]
    for level, found in ((levels[0], first[:5]), (edited, second[:5])):
        for one in found:
            s = level.moved("agent", tuple(one["cell"])).state(solvable=False)
            policy, value = policy_and_value(
                agent, observe(agent, variant, np.array([s], game.state))
            )
            assert np.allclose(one["policy"], policy[0], atol=0.01)  # a byte for each
            assert abs(one["value"] - value[0]) < 0.01


def test_a_table_knows_where_the_agent_faces_and_what_is_likeliest(chrome, untrained, tmp_path):
    untrained(tmp_path / "run", SIGHTED, **IMAGES)
    lab = make_lab(tmp_path / "run", {"level": 0})
    export(lab, tmp_path / "site", levels=2, agents=[str(tmp_path / "run")])
    (index,) = (tmp_path / "site" / "data" / "agents").glob("*.json")
    told = json.loads(index.read_text())
    right = games.find("maze").actions.index("right")
    words = {"kind": "play", "game": "maze", "variant": "anywhere-small", "level": 1}
    words |= {"actions": [right], "steps": 3, "mode": "greedy"}
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, _):
        message = words | {"agent": page.evaluate("lab.part('agent').value")}
        here = page.evaluate("(message) => lab.engine.ask(message)", message)
    message = {"id": 1} | words | {"agent": str(tmp_path / "run")}
    *_, there = Session(lab).answers(json.dumps(message))
    assert here["actions"] == there["actions"]
    half = (told["high"] - told["low"]) / told["one"] / 2  # of what a byte tells
    assert np.allclose(here["value"], there["value"], rtol=0, atol=half + 1e-6)


def test_a_table_knows_that_a_goal_is_gone_and_of_what_looks(chrome, untrained, tmp_path):
    """Else a page shows arrows at cheese that was eaten, and those of cheese for a red star."""
    for name, knobs in (("yellow", {}), ("red", {"goal_shape": "star", "goal_colour": "red"})):
        untrained(tmp_path / name, SIGHTED, **IMAGES, knobs=knobs)
    lab = Lab(
        Agents.of({name: tmp_path / name for name in ("yellow", "red")}),
        {"game": "maze", "variant": "anywhere-small", "level": 1, "agent": "yellow"},
    )
    export(lab, tmp_path / "site", levels=2, agents=["yellow", "red"])
    told = json.loads((tmp_path / "site" / "data" / "agents" / "yellow.json").read_text())
    words = {"id": 1, "kind": "fields", "game": "maze", "variant": "anywhere-small", "level": 1}
    words |= {"agent": "yellow", "actions": _way(lab, words)}
    ask = "(message) => lab.engine.ask(message).catch((error) => error.message)"
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, _):
        here = page.evaluate(ask, words)
        said = page.evaluate(ask, words | {"actions": [], "agent": "red"})
    *_, there = Session(lab).answers(json.dumps(words))
    half = (told["high"] - told["low"]) / told["one"] / 2  # of what a byte tells
    assert here["cells"] == there["cells"]
    assert np.allclose(here["value"], there["value"], rtol=0, atol=half + 1e-6)
    assert "it and its goal may be moved here, but nothing else" in said


def _way(lab, words):
    """The actions of the best way to the cheese."""
    asked = words | {"kind": "route", "goal": "cheese", "agent": ""}
    *_, told = Session(lab).answers(json.dumps(asked))
    names = {(1, 0): "right", (-1, 0): "left", (0, 1): "up", (0, -1): "down"}
    moves = np.diff(told["cells"], axis=0).astype(int).tolist()
    return [games.find("maze").actions.index(names[move[0], move[1]]) for move in moves]


@pytest.mark.thorough  # `test_a_large_agent_is_looked_up_in_a_table`
def test_a_table_knows_a_level_by_its_other_object_too(chrome, untrained, tmp_path):
    untrained(tmp_path / "run", SIGHTED, **IMAGES, variant="dish-small", validation=None)
    lab = make_lab(tmp_path / "run", {"level": 0})
    export(lab, tmp_path / "site", levels=2, agents=[str(tmp_path / "run")])
    game = games.find("maze")
    variant = game.variant("dish-apart-small")
    level = Level.of(game, variant, initial_states(game, variant, [1])[0])
    (first, second, *_) = level.splay("other")
    moved = second if str(first) == str(level) else first
    ask = """([level, agent]) => lab.engine.ask({ kind: "fields", game: "maze",
      variant: "dish-apart-small", level, agent }).catch((error) => error.message)"""
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, _):
        agent = page.evaluate("lab.part('agent').value")
        assert page.evaluate(ask, [level.to_json(), agent])["value"]
        said = page.evaluate(ask, [moved.to_json(), agent])
        assert "it and its goal may be moved here, but nothing else" in said


def test_a_table_has_the_place_of_the_other_object_over_which_an_agent_walks(untrained, tmp_path):
    path = untrained(tmp_path / "run", SIGHTED, **IMAGES, variant="dish-small", validation=None)
    game = games.find("maze")
    agent, apart = Agent(path, "maze"), game.variant("dish-apart-small")
    index, data = table(agent, game, apart, 2)
    for number, told in enumerate(index["levels"]):
        assert [*told["other"]] and {*told["other"]} <= {*told["places"]}
        level = Level.of(game, apart, initial_states(game, apart, [number])[0])
        (where,), (goal,) = level.where("other"), level.where("goal")
        s = states_at(level, [where])
        _, value = policy_and_value(agent, observe(agent, apart, s))
        row = told["goals"][f"{goal[0]},{goal[1]}"] + told["places"].index(told["other"][0])
        kept = np.frombuffer(data, np.uint8).reshape(-1, index["actions"] + 1)[row, -1]
        step = (index["high"] - index["low"]) / index["one"]
        assert abs(index["low"] + step * kept - value[0]) < step


def test_a_table_has_a_goal_that_lies_on_its_dish(untrained, tmp_path):
    path = untrained(tmp_path / "run", SIGHTED, **IMAGES, variant="dish-small", validation=None)
    game = games.find("maze")
    variant = game.variant("dish-small")
    (told,) = table(Agent(path, "maze"), game, variant, 1)[0]["levels"]
    s = initial_states(game, variant, [0])[0]
    assert [*told["goals"]] == [*told["other"], "none"] == [f"{s.goal_x},{s.goal_y}", "none"]


def _another(level):
    """The last cell but its own that the goal could be in."""
    return [one.where("goal")[0] for one in level.splay("goal")][-1]


def test_a_table_is_no_larger_than_is_asked_for():
    agent, config = usual_lab().agents.open("maze-corner")
    game = config.find_game()
    index, data = table(agent, game, game.variant("anywhere-small"), 2, most=3000)
    assert len(data) <= 3000  # a level too large for its half has one place of the goal alone
    assert 2 in {len(level["goals"]) for level in index["levels"]}


@pytest.mark.parametrize(
    "network, settings, why",
    [
        ("mlp+gru", {}, "has a memory"),
        ("patch", {"game": "pottery", "variant": "corner"}, "sees images of pottery"),
    ],
)
def test_an_agent_that_no_table_can_stand_for_is_refused(
    untrained, tmp_path, network, settings, why
):
    """A page would play an agent with memory as if each step began its episode."""
    kind = {"network": network, "observation": "image" if settings else "symbolic"}
    actions = len(games.find(settings.get("game", "maze")).actions)
    architecture = Architecture(network, (64, 64, 3), (), actions, width=8)
    if not settings:
        architecture = Architecture(network, (4, 7, 7), (1, 1, 6, 6), actions, width=8)
    untrained(tmp_path / "run", architecture, **kind, **settings, validation=None, width=8)
    lab = make_lab(tmp_path / "run", {"level": 0})
    with pytest.raises(ValueError, match=f"{why}: there is no table of all that it may see"):
        check_exportable(lab, None, {})


def test_a_world_of_a_guest_that_has_a_goal_is_no_maze(untrained, tmp_path, monkeypatch):
    fields = grid.rules.state(moor.SIDE, moor.EVENTS, "stride", "goal_x", "goal_y")
    rules = SimpleNamespace(**vars(moor) | {"STATE": fields})
    fen = replace(moor.GAME, name="fen", rules=rules)
    monkeypatch.setitem(games._registered, "fen", fen)
    monkeypatch.setitem(grid._MADE, fen, grid.world_of(moor.GAME))
    kind = {"observation": "image", "game": "fen", "variant": "walks", "validation": None}
    untrained(tmp_path / "run", replace(SIGHTED, actions=5), **kind, network="impala")
    lab = Lab(Agents.of({"sighted": tmp_path / "run"}), {"game": "maze"})
    with pytest.raises(ValueError, match="sees images of fen: there is no table"):
        check_exportable(lab, ["sighted"], {})
