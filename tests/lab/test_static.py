"""The page without Python does what Python does: rules, networks, draws, posteriors, tables."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from astray import games
from astray.agents.policy import Architecture, weights
from astray.analysis.critic import judge, observe
from astray.analysis.episodes import initial_states
from astray.analysis.policies import Agent
from astray.analysis.replay import replay
from astray.envs.vector import GameVectorEnv
from astray.lab.export import export, file_names, table
from astray.lab.link import link
from astray.lab.serving import make_lab
from astray.lab.session import Session
from astray.lab.worlds import snapshot
from astray.level import Level
from helpers.browsed import folder_served, opened, wait

STEPS = 150  # of each episode at random, each three times
PLAYED = [
    ("maze", "anywhere-small"), ("maze", "red-line-yellow-gem"), ("maze", "anywhere-memory"),
    ("maze", "dish-small"), ("maze", "dish-apart-small"),
    ("keys", "many-keys-small"), ("keys", "many-chests"), ("keys", "many-keys-penalties"),
    ("coinrun", "coin-anywhere"), ("coinrun", "coin-end-permeable-continue"),
]  # fmt: skip
PLAY = """async ([game, level, variant, actions]) => {
  const { rules } = await import(new URL(`rules/${game}.js`, location.href));
  const { advance } = await import(new URL("rules/common.js", location.href));
  const { snapshot } = await import(new URL("engine/local.js", location.href));
  const s = rules.build(level, variant);
  const packed = () => btoa(String.fromCharCode(...rules.planes(s).data));
  const told = [[snapshot(s), packed(), 0, false]];
  for (const action of actions) {
    const { reward } = advance(rules, s, action);
    told.push([snapshot(s), packed(), reward, s.ended]);
    if (s.ended) break;
  }
  return JSON.stringify(told);
}"""


@pytest.fixture(scope="module")
def page(chrome, static):
    with opened(chrome, static) as (page, told):
        yield page
        assert not told  # on the console


def knobs(variant):
    return json.loads(json.dumps({k: v for k, v in vars(variant).items() if k != "shifted"}))


@pytest.mark.parametrize("name, kind", PLAYED)
def test_rules_are_those_of_python_state_by_state(page, name, kind):
    game = games.find(name)
    variant, random = game.variant(kind), np.random.default_rng(3)
    env = GameVectorEnv(name, kind, 1, observation="symbolic", autoreset_mode="Disabled")
    for number in range(4):
        env.reset(seed=0, options={"level": number})
        level = Level.of(game, variant, env.get_state()[0])
        # runs of one action, as players make them, mostly to the right
        actions = np.repeat(
            random.choice(15, STEPS, p=[*[0.03] * 6, 0.1, 0.3, 0.3, *[0.02] * 6]), 3
        )
        given = [name, level.to_json(), knobs(variant), actions.tolist()]
        told = json.loads(page.evaluate(PLAY, given))
        seen, _ = env.reset(options={"state": level.state(solvable=False)})
        reward = 0.0
        for t, (state, planes, there_reward, ended) in enumerate(told):
            s = env.get_state().view(np.recarray)[0]
            expected = snapshot(game, s)
            # Fields of the page's own are none of Python's; all others are equal, to the bit.
            for field, value in state.items():
                if field in expected and field not in ("level",):
                    mine = expected[field]
                    if isinstance(value, list):
                        mine = mine[: len(value)]
                    assert value == mine, (number, t, field)
            assert base64.b64decode(planes) == seen.tobytes(), (number, t)
            assert there_reward == reward and ended == s.ended
            if t < len(told) - 1:
                seen, rewards, _, _, _ = env.step(actions[t : t + 1])
                reward = float(rewards[0])
        assert ended or len(told) == len(actions) + 1


def test_a_dish_is_seen_in_as_many_planes_as_the_variant_says(page):
    game = games.find("maze")
    variant = game.variant("dish-small").with_knobs({"dish_planes": 6})
    (s,) = initial_states(game, variant, [1])
    level = Level.of(game, variant, s)
    (told,) = json.loads(page.evaluate(PLAY, ["maze", level.to_json(), knobs(variant), []]))
    env = GameVectorEnv(game, variant, 1, observation="symbolic")
    seen, _ = env.reset(options={"state": np.array([level.state()], game.state)})
    assert base64.b64decode(told[1]) == seen.tobytes() and seen.shape[1] == 10


DRAWN = """\
##############################
#.............................
#........................%%%..
#.@......................%%%..
############...########..%%%==
##############################
"""  # of CoinRun, with ground beyond the columns that let pass


@pytest.mark.parametrize("drawn", [DRAWN, DRAWN.replace("%", "."), DRAWN.replace(".@", "@.")])
def test_a_drawn_level_of_coinrun_ends_where_it_does_in_python(page, drawn):
    here, there = both(page, kind="level", game="coinrun", variant="coin-end", level=drawn)
    for name in ("end_x", "end_y", "permeable"):
        assert here["state"][name] == there["state"][name], name


def test_networks_give_what_torch_gives(page, static, exported):
    for name in ("maze-corner", "many-chests", "coin-end"):
        agent, config = make_lab(name, {}).minds.open(name)
        env = GameVectorEnv(config.game, config.variant, 20, observation="symbolic")
        seen, _ = env.reset(seed=1)
        policy, value = judge(agent, seen)
        found = page.evaluate(
            """async ([name, shape, all]) => {
              const address = new URL("mind/network.js", location.href);
              const { readNetwork, softmax } = await import(address);
              const file = await fetch(`data/agents/${name}.safetensors`);
              const network = readNetwork(await file.arrayBuffer());
              return all.map((data) => {
                const { logits, value } = network.outputs({ shape, data });
                return [softmax(logits), value];
              });
            }""",
            [name, list(seen.shape[1:]), seen.reshape(20, -1).tolist()],
        )
        assert np.allclose([p for p, _ in found], policy, atol=1e-5)
        assert np.allclose([v for _, v in found], value, atol=1e-5)


def both(page, **message):
    """The answers of the page's own engine and of Python, the parts of each joined."""
    here = json.loads(
        page.evaluate(
            """async (message) => {
              const parts = [];
              parts.push(await lab.engine.ask(message, (part) => parts.push(part)));
              return JSON.stringify(parts);
            }""",
            message,
        )
    )
    session = Session(make_lab("maze-corner", {}))
    there = list(session.answers(json.dumps({"id": 1} | message)))
    return _joined(here), _joined(there)


def _joined(parts):
    joined = {}
    for part in parts:
        assert "error" not in part, part
        for name, value in part.items():
            joined[name] = joined.get(name, []) + value if isinstance(value, list) else value
    return joined


MAZE = {"game": "maze", "variant": "anywhere-small", "agent": "maze-corner"}


@pytest.mark.parametrize("number", range(4))
def test_an_agent_plays_as_it_does_in_python_draw_by_draw(page, number):
    here, there = both(page, kind="play", **MAZE, level=number, steps=100)
    assert here["actions"] == there["actions"] and here["rewards"] == there["rewards"]
    assert np.allclose(here["value"], there["value"], atol=1e-5)


def test_the_thief_and_the_runner_play_as_in_python(page):
    for game, variant, agent in (
        ("keys", "many-keys-small", "many-chests"),
        ("coinrun", "coin-anywhere", "coin-end"),
    ):
        here, there = both(
            page, kind="play", game=game, variant=variant, agent=agent, level=2, steps=60
        )
        assert here["actions"] == there["actions"]


def test_a_splay_is_that_of_python(page):
    here, there = both(page, kind="splay", **MAZE, level=3, thing="goal", draws=2)
    assert dict(zip(map(tuple, here["cells"]), here["outcomes"], strict=True)) == dict(
        zip(map(tuple, there["cells"]), there["outcomes"], strict=True)
    )


def test_the_posterior_is_that_of_python(page):
    actions = replayed(3)
    here, there = both(page, kind="posterior", **MAZE, level=3, actions=actions)
    assert np.allclose(here["shares"], there["shares"], atol=2e-5)  # Python rounds to 1e-5
    for goal, shares in there["goals"].items():
        assert np.allclose(here["goals"][goal], shares, atol=1e-6)
    assert here["agent"] is None


def replayed(number):
    """What the agent does in a level."""
    parts = Session(make_lab("maze-corner", {})).answers(
        json.dumps({"id": 1, "kind": "play", **MAZE, "level": number, "steps": 20})
    )
    return _joined(parts)["actions"]


def test_what_covering_parts_does_is_what_captum_says(page):
    pytest.importorskip("captum", reason="captum is not installed")
    here, there = both(page, kind="attribution", **MAZE, level=3, method="occlusion")
    assert np.allclose(here["map"], there["map"], atol=2e-5)


def test_a_level_is_refused_in_python_s_words(page):
    rows = "#######\n#...#G#\n#.#####\n#.#...#\n#.#.#.#\n#@....#\n#######"
    here, there = both(page, kind="level", **MAZE, level=rows)
    assert here["problem"] == there["problem"] and "cannot be reached" in here["problem"]
    assert here["text"] == there["text"]


def test_a_large_agent_is_looked_up_in_a_table(chrome, tmp_path):
    torch.manual_seed(0)
    architecture = Architecture("impala", (64, 64, 3), (), 15, widths=(4, 4, 4))
    folder = tmp_path / "run"
    config = replace(
        make_lab("maze-corner", {}).minds.open("maze-corner")[1],
        observation="image",
        network="impala",
    )
    path = folder / "checkpoints" / "1" / "agent.safetensors"
    path.parent.mkdir(parents=True)
    path.write_bytes(weights(architecture.build(), architecture, "maze"))
    (folder / "config.json").write_text(json.dumps({"config": config.to_json()}))
    lab = make_lab(folder, {})
    export(lab, tmp_path / "site", levels=3, agents=[str(folder)])
    agent, game = Agent(path, "maze"), games.find("maze")
    variant = game.variant("anywhere-small")
    levels = [Level.of(game, variant, _begun(game, variant, number)) for number in range(3)]
    edited = levels[2].moved("goal", _another(levels[2]))
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, told):
        first = page.evaluate("[...lab.fields.values()]")
        wait(page, "lab.ready")
        message = {"kind": "fields", "agent": page.evaluate("lab.part('agent').value")}
        message |= {"game": "maze", "variant": "anywhere-small", "level": edited.to_json()}
        asked = page.evaluate("(message) => lab.engine.ask(message)", message)
        assert not told
    second = [
        {"cell": cell, "policy": policy, "value": value}
        for cell, policy, value in zip(asked["cells"], asked["policy"], asked["value"], strict=True)
    ]
    for level, found in ((levels[0], first[:5]), (edited, second[:5])):
        for one in found:
            s = level.moved("agent", tuple(one["cell"])).state(solvable=False)
            policy, value = judge(agent, observe(agent, variant, np.array([s], game.state)))
            assert np.allclose(one["policy"], policy[0], atol=0.01)  # a byte for each
            assert abs(one["value"] - value[0]) < 0.01


def _another(level):
    """The last cell but its own that the goal could be in."""
    return [one.where("goal")[0] for one in level.splay("goal")][-1]


def test_an_agent_with_knobs_has_levels_of_its_own(chrome, tmp_path):
    architecture = Architecture("mlp", (4, 5, 5), (1, 1, 6, 6), 15, width=8)
    config = make_lab("maze-corner", {}).minds.open("maze-corner")[1]
    config = replace(config, knobs={"world": 5, "largest": 5}, width=8)
    path = tmp_path / "run" / "checkpoints" / "1" / "agent.safetensors"
    path.parent.mkdir(parents=True)
    path.write_bytes(weights(architecture.build(), architecture, "maze"))
    (tmp_path / "run" / "config.json").write_text(json.dumps({"config": config.to_json()}))
    lab = make_lab(tmp_path / "run", {})
    export(lab, tmp_path / "site", levels=3, agents=[str(tmp_path / "run")])
    variant = config.variant_for("anywhere-small")
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, told):
        wait(page, "lab.ready")
        agent = page.evaluate("lab.part('agent').value")
        for number in range(3):
            level = page.evaluate(
                """([agent, variant, level]) => lab.engine.ask({kind: "level", game: "maze",
                  variant, level, agent, knobs: lab.about.agents[agent].knobs[variant]})
                """,
                [agent, "anywhere-small", number],
            )
            game = config.find_game()
            assert level["text"] == str(Level.of(game, variant, _begun(game, variant, number)))
        assert not told


def _begun(game, variant, number):
    env = GameVectorEnv(game, variant, 1, observation="symbolic")
    env.reset(seed=0, options={"level": number})
    return env.get_state()[0]


def test_a_table_is_no_larger_than_is_asked_for():
    agent, config = make_lab("maze-corner", {}).minds.open("maze-corner")
    game = config.find_game()
    index, data = table(agent, game, game.variant("anywhere-small"), 2, most=2000)
    assert len(data) <= 2000  # a level too large for its half has one place of the goal alone
    assert 1 in {len(level["goals"]) for level in index["levels"]}


def test_nothing_is_written_over_and_nothing_outside(tmp_path):
    lab, mine = make_lab("maze-corner", {}), tmp_path / "mine"
    (mine / "data").mkdir(parents=True)
    (mine / "data" / "index.json").write_text("mine")
    with pytest.raises(FileExistsError, match="must be new, or an empty folder"):
        export(lab, mine, levels=1)
    assert (mine / "data" / "index.json").read_text() == "mine"
    names = file_names(["maze-corner", "/home/me/runs/mice/seed-0", "../mice/seed-0", "../.."])
    assert list(names.values()) == ["maze-corner", "mice-seed-0", "mice-seed-0-2", "agent"]


def test_replay_and_the_page_agree_on_an_episode(page):
    actions = [7, 5, 5, 1, 8, 3, 7]
    here, _ = both(page, kind="play", **MAZE, level=6, actions=actions)
    told = replay("maze", games.find("maze").variant("anywhere-small"), 6, actions)
    assert [(s["x"], s["y"]) for s in here["states"][1:]] == [
        (s["x"], s["y"]) for s in told["steps"]
    ]


@pytest.mark.parametrize(
    "game, variant, agent",
    [("maze", "anywhere-small", "maze-corner"), ("coinrun", "coin-anywhere", "coin-end"),
     ("keys", "many-keys-small", "many-chests")],
)  # fmt: skip
def test_a_link_has_a_level_that_was_not_exported(chrome, static, game, variant, agent):
    of = games.find(game)
    (s,) = initial_states(of, of.variant(variant), [200_007])
    level = Level.of(of, of.variant(variant), s)
    with opened(chrome, static + link(level, variant, agent)) as (page, told):
        assert page.evaluate("lab.part('text').value").strip() == str(level)
        assert page.evaluate("lab.part('variant').value") == variant
        assert page.evaluate("lab.part('agent').value") == agent
        assert not told
