"""The page without Python does what Python does: rules, networks, draws, posteriors, tables."""

import base64
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from astray import games, grid, load_agent
from astray.acting import initial_states
from astray.agents.mlp import MLP
from astray.agents.policy import Architecture
from astray.analysis.critic import policy_and_value
from astray.analysis.replay import replay
from astray.envs.vector import GameVectorEnv
from astray.lab import export as export_
from astray.lab import goals, rules
from astray.lab.agents import Agents
from astray.lab.export import export, file_names, is_computed
from astray.lab.link import link
from astray.lab.messages import read
from astray.lab.serving import make_lab
from astray.lab.session import Lab, Session
from astray.lab.worlds import is_drawn, read_world, snapshot
from astray.level import Level
from astray.training.ppo import RewardNormaliser, advantages
from helpers import killed, moor
from helpers.browsed import PLAY, folder_served, knobs, opened, usual_lab, wait, window_of
from helpers.thorough import thorough

WHOLE = "JSON.stringify(told, (_, x) => (typeof x === 'bigint' ? JSON.rawJSON(`${x}`) : x))"
MOOR = {"game": "moor", "agent": ""}


@pytest.fixture(scope="module")
def guests():
    """A lab with the world of a guest, in which chance decides more than cells show."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(games._registered, "moor", moor.GAME)
        yield make_lab("maze-corner", {})


@pytest.fixture(scope="module")
def moors(chrome, guests, tmp_path_factory):
    """A page of that lab."""
    folder = tmp_path_factory.mktemp("moor") / "site"
    export(guests, folder, 12, [], {"moor": "either"})
    with folder_served(folder) as address, opened(chrome, address, "true") as (page, told):
        yield page
        assert not told


def played(game, variant, number, actions):
    """The states and rewards of a numbered level in Python, until it ends."""
    env = GameVectorEnv(game, variant, 1, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": number})
    states, rewards = [snapshot(game, env.get_state().view(np.recarray)[0])], []
    for action in actions:
        if states[-1]["ended"]:
            break
        rewards.append(float(env.step(np.array([action]))[1][0]))
        states.append(snapshot(game, env.get_state().view(np.recarray)[0]))
    return states, rewards


@pytest.mark.parametrize("variant", ["walks", "jumps", "either"])
def test_a_numbered_level_of_a_guest_goes_on_as_in_python(moors, variant):
    ask = f"async (m) => {{ const told = await lab.engine.ask(m); return {WHOLE}; }}"
    random = np.random.default_rng(1)
    for number in range(12):
        actions = random.integers(5, size=40).tolist()
        states, rewards = played(moor.GAME, moor.GAME.variant(variant), number, actions)
        asked = MOOR | {"kind": "play", "variant": variant, "level": number}
        told = json.loads(moors.evaluate(ask, asked | {"actions": actions[: len(rewards)]}))
        assert told["states"] == states and told["rewards"] == rewards, number


def test_the_state_of_a_numbered_level_is_that_of_python_field_by_field(page, moors):
    """Also the random numbers to come, of which CoinRun's steps take some.

    Looks of its cells, `detail`, are drawn from the level.
    """
    ask = f"""async (m) => {{
      const {{ s: {{ scene, ...told }} }} = await lab.engine.world(m);
      return {WHOLE};
    }}"""
    for window in (page, moors):
        for name, about in window.evaluate("lab.about.games").items():
            game = moor.GAME if name == "moor" else games.find(name)
            fields = sorted({*game.state.names} - {"detail", "gap", "seed", "turn"})
            for variant in about["variants"]:
                for s in initial_states(game, game.variant(variant), range(8)):
                    asked = {"game": name, "variant": variant, "level": int(s.level), "agent": ""}
                    told = json.loads(window.evaluate(ask, asked))
                    there = {field: s[field].tolist() for field in fields}
                    assert {field: told[field] for field in fields} == there, (name, variant)


def test_a_world_of_cells_is_edited_and_played_without_python(page):
    asked = {"game": "pottery", "variant": "corner", "agent": "", "level": 0}
    told = page.evaluate("(m) => lab.engine.ask(m)", asked | {"kind": "level"})
    python = read_world(read(json.dumps(asked | {"id": 1, "kind": "level"}))).told()
    assert told["level"] == python["level"] and told["text"] == python["text"]
    edited = told["level"] | {"agent": [0.5, 3.5]}  # where the bin stands
    played = page.evaluate(
        "(m) => lab.engine.ask(m)", asked | {"kind": "play", "level": edited, "actions": [3, 0]}
    )
    assert (
        played["states"][-1]["agent"] == [0.5, 2.5] and played["states"][-1]["picture"] == "robot"
    )
    question = asked | {"kind": "posterior", "actions": [1], "agent": "maze-corner"}
    said = page.evaluate("(m) => lab.engine.ask(m).catch((error) => error.message)", question)
    (there,) = Session(usual_lab()).answers(json.dumps(question | {"id": 1}))
    assert said == there["error"] and said.startswith("In this level, no goal is reached")


def test_a_dish_is_seen_in_as_many_planes_as_the_variant_says(page):
    game = games.find("maze")
    variant = game.variant("dish-small").with_knobs({"dish_planes": 6})
    (s,) = initial_states(game, variant, [1])
    level = Level.of(game, variant, s)
    (told,) = json.loads(
        page.evaluate(PLAY, ["rules/maze.js", level.to_json(), knobs(variant), []])
    )
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


@pytest.mark.parametrize(
    "drawn",
    [
        DRAWN,
        *thorough(DRAWN.replace("%", "."), DRAWN.replace(".@", "@."), DRAWN.replace(".%", "o%")),
    ],
)
def test_a_drawn_level_of_coinrun_begins_and_ends_where_it_does_in_python(page, drawn):
    words = {"kind": "level", "game": "coinrun", "variant": "coin-end"}
    here, there = both(page, **words, level=drawn)
    edited = here["level"] | {"grid": [row.copy() for row in here["level"]["grid"]]}
    edited["grid"][3][20] = games.find("coinrun").editing.LEGEND["%"]
    for mine, python in ((here, there), both(page, **words, level=edited)):
        for name in ("end_x", "end_y", "permeable", "coin_x", "coin_y"):
            assert mine["state"][name] == python["state"][name], name


@pytest.mark.parametrize(
    "game, variant, looks",
    [
        ("keys", "many-keys-small", {"details": [[0, 0, 0.25, 0.5]]}),
        ("heist", "small", {"details": [[0, 0, 0.25, 0.5]]}),
        ("heist", "small", {"hand": ["purple"]}),
    ],
)
def test_looks_of_a_thing_that_is_gone_are_refused_as_in_python(page, game, variant, looks):
    asked = {"kind": "level", "game": game, "variant": variant, "agent": ""}
    _, there = both(page, **asked, level=3)
    level = {name: there["level"][name] for name in ("grid", "agent", "looks")}
    same, _ = both(page, **asked, level=level)
    assert same["text"] == there["text"]
    asked["level"] = level | {"looks": level["looks"] | looks}
    (refused,) = Session(usual_lab()).answers(json.dumps({"id": 1} | asked))
    told = page.evaluate("(m) => lab.engine.ask(m).catch((error) => error.message)", asked)
    assert "in this level []" in refused["error"] or refused["error"].endswith(told)
    assert "which has none" in told or "unknown key 'purple'" in told


SPLAYED = """async (m) => {
  const { splayed } = await import(new URL("engine/levels.js", location.href));
  const levels = splayed(await lab.engine.world(m), "crate", null, lab.about.games.coinrun);
  return levels.map(({ cell, level }) => [cell, level.looks]);
}"""


def test_a_walker_under_a_crate_that_is_lifted_is_in_the_level_as_in_python(page):
    words = {"game": "coinrun", "variant": "coin-end"}
    drawing = DRAWN.replace("@..", "@.c").replace("%", ".")
    _, there = both(page, **words, kind="level", level=drawing)
    met = {name: there["level"][name] for name in ("grid", "agent", "looks")}
    at = [4, len(DRAWN.splitlines()) - 4]
    walkers = [[*at, 0, 3], [*at, 1, 0]]  # of which one stays beneath the other
    met["looks"] = met["looks"] | {"details": [[*at, 1]], "walkers": walkers}
    same, _ = both(page, **words, kind="level", level=met)
    assert same["level"]["looks"]["walkers"] == walkers
    lifted = {**met, "grid": [[*row] for row in met["grid"]]}
    lifted["grid"][at[1]][at[0]] = 0
    lifted["looks"] = met["looks"] | {"details": []}
    here, there = both(page, **words, kind="level", level=lifted)
    assert here["text"] == there["text"] and here["text"] != same["text"]
    for name in ("grid", "looks"):
        assert here["level"][name] == there["level"][name], name
    assert here["level"]["looks"]["details"] == [[*at, 3]]
    splayed = page.evaluate(SPLAYED, words | {"level": met})
    assert splayed and at not in [cell for cell, _ in splayed]
    assert all(looks["walkers"] == walkers for _, looks in splayed)


@pytest.mark.parametrize(
    "game, variant, level",
    [
        ("coinrun", "coin-end", "\n".join([".@" + 63 * ".", 65 * "#"])),  # too large
        ("maze", "anywhere-small", "@....Go" + 6 * "\n......."),  # of an object without a look
    ],
)
def test_a_level_that_cannot_begin_is_refused_in_python_s_words(page, game, variant, level):
    words = {"kind": "level", "game": game, "variant": variant, "level": level}
    said = page.evaluate("(m) => lab.engine.ask(m).catch((error) => error.message)", words)
    (told,) = Session(usual_lab()).answers(json.dumps({"id": 1} | words))
    assert said == told["error"]


def test_networks_give_what_torch_gives(page, static, exported):
    for name in ("maze-corner", "many-chests", "coin-end"):
        agent, config = usual_lab().agents.open(name)
        env = GameVectorEnv(config.game, config.variant, 20, observation="symbolic")
        seen, _ = env.reset(seed=1)
        policy, value = policy_and_value(agent, seen)
        found = page.evaluate(
            """async ([name, shape, all]) => {
              const address = new URL("agent/network.js", location.href);
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


def both(page, lab=None, **message):
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
    session = Session(lab or usual_lab())
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


def test_at_the_end_of_an_episode_nothing_says_which_actions_do_the_same(page):
    asked = {"game": "maze", "variant": "corner-small", "agent": "maze-corner", "level": 4}
    played, _ = both(page, **asked, kind="play", steps=300)
    for actions, compared in ((played["actions"][:-1], True), (played["actions"], False)):
        for told in both(page, **asked, kind="fields", actions=actions, effects=True):
            assert told["policy"] and ("same" in told) == compared


def test_of_several_objects_a_splay_takes_none_that_is_not_named(page):
    splay = """async () => {
      const { splayed } = await import(new URL("engine/levels.js", location.href));
      const about = { legend: { G: 2 }, objects: { goal: "G" } };
      const level = { grid: [[2, 2]] };
      try { splayed({ level }, "goal", null, about); } catch ({ message }) { return message; }
    }"""
    assert page.evaluate(splay) == "which goal?"  # as `Level.splay` asks


def test_a_splay_is_that_of_python(page):
    here, there = both(page, kind="splay", **MAZE, level=3, thing="goal", draws=2)
    assert dict(zip(map(tuple, here["cells"]), here["outcomes"], strict=True)) == dict(
        zip(map(tuple, there["cells"]), there["outcomes"], strict=True)
    )


@pytest.mark.parametrize(
    "agent, variant, thing",
    [("pottery-corner", "anywhere", "shards"), ("many-chests", "many-keys-small", "key")],
)
def test_an_agent_that_stands_on_an_object_is_asked_everywhere_as_in_python(
    page, agent, variant, thing
):
    lab = usual_lab()
    game = lab.agents.open(agent)[0].game
    (s,) = initial_states(game, variant, [2])
    level = Level.of(games.find(game), games.find(game).variant(variant), s)
    on = replace(level, agent=(at := level.where(thing)[0]))
    asked = {"game": game, "variant": variant, "agent": agent, "level": on.to_json()}
    here, there = both(page, lab, kind="fields", **asked, effects=True)
    assert here["cells"] == there["cells"] and here["same"] == there["same"]
    assert [*at] in here["cells"] and np.allclose(here["policy"], there["policy"], atol=1e-5)
    for moved in ("agent", thing):
        here, there = both(page, lab, kind="splay", **asked, thing=moved, cell=[*at])
        ends = zip(map(tuple, there["cells"]), there["outcomes"], strict=True)
        assert dict(zip(map(tuple, here["cells"]), here["outcomes"], strict=True)) == dict(ends)
        assert (at in map(tuple, here["cells"])) == (moved == "agent")


@pytest.mark.thorough  # `test_constants` looks at others
def test_a_page_has_the_constants_that_python_has_now(chrome, untrained, tmp_path, monkeypatch):
    monkeypatch.setattr(goals, "TOGETHER", 5)
    architecture = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=8)
    untrained(tmp_path / "run", architecture, variant="anywhere-small", width=8)
    asked = {"game": "maze", "variant": "anywhere-small", "agent": "mouse"}
    lab = Lab(Agents.of({"mouse": tmp_path / "run"}), asked | {"level": 0})
    export(lab, tmp_path / "site", levels=2, agents=["mouse"])
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, _):
        here, there = both(page, lab, kind="splay", **asked, level=1, thing="goal", draws=3)
    assert dict(zip(map(tuple, here["cells"]), here["outcomes"], strict=True)) == dict(
        zip(map(tuple, there["cells"]), there["outcomes"], strict=True)
    )


def test_the_posterior_is_that_of_python(page):
    actions = replayed(3)
    here, there = both(page, kind="posterior", **MAZE, level=3, actions=actions)
    assert np.allclose(here["rates"], there["rates"], atol=2e-5)  # Python rounds to 1e-5
    for goal, rates in there["goals"].items():
        assert np.allclose(here["goals"][goal], rates, atol=1e-6)
    assert here["agent"] is None


def test_the_posterior_of_a_guest_knows_which_cells_are_open(moors, guests):
    for number in range(6):
        asked = MOOR | {"variant": "walks", "level": number, "kind": "posterior"}
        _, rewards = played(moor.GAME, "walks", number, actions := [1, 4, 4, 2, 2, 3])
        here, there = both(moors, guests, **asked, actions=actions[: len(rewards)])
        assert here["cells"] == [[*cell] for cell in there["cells"]], number
        assert np.allclose(here["rates"], there["rates"], atol=2e-5), number
        assert here["goals"].keys() == there["goals"].keys(), number


@pytest.mark.parametrize(
    "game, variant, said",
    [
        ("moor", "jumps", "a path moves one cell at a time; no move leads from (1, 0) to (3, 0)"),
        ("trees", "season", "no goal is reached by going to one cell: forest, wood."),
        ("keys", "many-keys-small", "the game 'keys' has no cells, which this needs"),
    ],
)
def test_a_posterior_is_refused_in_python_s_words(page, moors, guests, game, variant, said):
    drawn = "\n".join(["G....", *["....."] * 3, ".@..."])
    level = drawn if game == "moor" else 1
    asked = {"kind": "posterior", "game": game, "variant": variant, "agent": "", "level": level}
    asked["actions"] = [2]
    window = moors if game == "moor" else page
    told = window.evaluate("(m) => lab.engine.ask(m).catch((error) => error.message)", asked)
    (there,) = Session(guests).answers(json.dumps(asked | {"id": 1}))
    assert told == there["error"] and told.endswith(said)


@pytest.mark.parametrize(
    "drawing",
    ["\n    .....\n    ;...G\n" + 3 * "    ..@..\n", "\ufeff....;\r\n;.@ G\r\n" + 3 * ".....\r\n",
     "; a lake\n@.;..", "  .....\n ..@..", "..@..\n\n.....", "..@..\n..;.. ", "", "@\n@ on x",
     "..@..\u2028;...;\n.....\n.....\n.....\n@ on ;", "....@\n   . \n   . \n   . \n.. .."],
)  # fmt: skip
def test_a_drawing_is_read_as_in_python(moors, guests, drawing):
    asked = MOOR | {"kind": "level", "variant": "walks", "level": drawing}
    ask = "(m) => lab.engine.ask(m).then(({ text }) => text).catch((error) => error.message)"
    (there,) = Session(guests).answers(json.dumps(asked | {"id": 1}))
    assert moors.evaluate(ask, asked) == there.get("text", there.get("error"))


def test_a_numbered_level_with_looks_that_a_browser_rounds_is_refused(moors):
    said = moors.evaluate(
        """async (asked) => {
          const path = "data/levels/moor/jumps.json";
          const { levels: [one] } = await lab.engine.file(path);
          const far = { levels: [{ ...one, looks: { far: 2 ** 60 } }] };
          lab.engine.files.set(path, Promise.resolve(far));
          const said = await lab.engine.ask(asked).catch((error) => error.message);
          lab.engine.files.delete(path);
          return said;
        }""",
        MOOR | {"kind": "level", "variant": "jumps", "level": 0},
    )
    assert "whole numbers must be below 2 ** 53 here" in said


RING = "\n".join(["G......", *[".#####."] * 5, "@......"])  # two ways to the corner, one past G


def test_a_level_distinguishes_the_goals_where_it_does_in_python(page):
    def asked(level):
        here, there = both(page, kind="distinguishes", **MAZE, level=level)
        return here["distinguishes"], there["distinguishes"]

    told = [asked(number) for number in range(8)]
    assert all(here is there for here, there in told) and len({*told}) == 2
    assert asked(RING.replace("G.", "G#")) == (True, True)
    assert asked(RING[:-1] + "#") == (False, False)
    assert asked(RING)[0] is None  # as Python's walk may take either


def test_the_badge_of_a_level_is_shown_without_python(chrome, static):
    with opened(chrome, static) as (page, told):
        for number, said in ((0, "does not distinguish the goals"), (2, "distinguishes the goals")):
            assert page.evaluate("(number) => lab.open(number)", number)
            wait(page, f"!lab.part('badge').hidden && lab.part('badge').textContent === {said!r}")
        assert not told


def replayed(number):
    """What the agent does in a level."""
    parts = Session(usual_lab()).answers(
        json.dumps({"id": 1, "kind": "play", **MAZE, "level": number, "steps": 20})
    )
    return _joined(parts)["actions"]


LATE = """() => {
  const ask = lab.engine.ask.bind(lab.engine);
  const next = (heard) => requestAnimationFrame(() => requestAnimationFrame(heard));
  lab.engine.ask = async (...asked) => {
    lab.stage.redraw();
    await new Promise(next);
    return ask(...asked);
  };
}"""


def test_a_level_is_not_drawn_as_one_of_the_game_that_is_chosen_next(chrome, static):
    with opened(chrome, static) as (page, told):
        page.evaluate(LATE)  # the page draws before an answer comes
        page.click("[data-lab=once]")
        wait(page, "lab.now === 1 && lab.episode.value.length > 1")
        for agent in ("none maze", "many-chests", "maze-corner", "many-chests", "heist-small"):
            page.select_option("[data-lab=agent]", agent)
            wait(page, "lab.level.game === lab.game")
        assert not told


def test_what_is_done_to_a_level_while_another_game_s_is_on_its_way_is_let_be(chrome, static):
    """An edit of the level that was still shown took the place of the new game's first level."""
    with opened(chrome, static) as (page, told):
        page.evaluate(
            """async () => {
              const [choice, level] = [lab.part("agent"), { ...lab.level, agent: [0.5, 0.5] }];
              const asked = () => lab.engine.latest.get("level ");
              const before = asked();
              choice.value = "heist-small";
              choice.dispatchEvent(new Event("change"));
              while (asked() === before) await new Promise((done) => setTimeout(done, 0));
              await Promise.all([lab.act("up"), lab.edit(level), lab.undo(), lab.restore()]);
            }"""
        )
        wait(page, "lab.game === 'heist' && lab.level.game === 'heist' && lab.fields.size > 0")
        assert page.evaluate("[lab.number, lab.past.length, lab.episode.actions.length]") == [0] * 3
        assert page.locator("[data-lab=problem]").is_hidden() and not told
        page.evaluate(
            "lab.game = 'pottery', lab.variant = 'corner', lab.agent = '', lab.open('#@')"
        )
        wait(page, "lab.level.game === 'pottery' && lab.number === 0 && !lab.broken")
        said = "(1, 2); it must be 4 cells a side"
        assert said in page.locator("[data-lab=problem]").text_content()


def test_a_level_that_is_edited_while_the_agent_plays_begins_anew(chrome, static):
    """Its episode began with the agent's steps in the level as it was."""
    with opened(chrome, static) as (page, _):
        page.select_option("[data-lab=agent]", "coin-end")
        wait(page, "lab.level.game === 'coinrun' && lab.fields.size > 0")
        edit = """(async () => {
          const playing = lab.handOver();
          while (!lab.now) await new Promise((done) => setTimeout(done, 0));
          await Promise.all([playing, lab.edit({ ...lab.level })]);
          return [lab.now, lab.episode.actions.length, lab.number];
        })()"""
        page.locator("[data-lab=speed]").select_option("fast")
        for _ in range(4):
            assert page.evaluate(edit) == [0, 0, None]


def test_before_its_first_level_a_page_is_clicked_in_vain(chrome, static):
    with window_of(chrome) as (page, told):
        page.route("**/levels/**", lambda route: None)  # which does not come
        page.goto(static)
        wait(page, "globalThis.lab?.about && !lab.part('restore').disabled")
        for name in ("world", "restore"):
            page.dispatch_event(f"[data-lab={name}]", "pointerdown")
            page.dispatch_event(f"[data-lab={name}]", "click")
        assert not told


def test_what_a_lost_network_kept_away_is_shown_once_it_is_back(chrome, static):
    """Files of levels, of agents and of drawings; they are fetched when they are first needed."""
    with opened(chrome, static) as (page, told):

        def choose(part, name):
            page.select_option(f"[data-lab={part}]", name)
            wait(page, "lab.level.game === lab.game || lab.part('problem').textContent")

        choose("agent", "many-chests")  # so that the rules are here, which browsers keep themselves
        choose("agent", "maze-corner")
        page.evaluate(
            "lab.engine.files.clear(); lab.engine.loading.clear(); delete lab.pictures.keys"
        )
        page.route("**/data/**", lambda route: route.abort())
        choose("agent", "many-chests")
        wait(page, "lab.part('problem').textContent.includes('Failed to fetch')")
        page.unroute("**/data/**")
        choose("agent", "maze-corner")
        choose("agent", "many-chests")
        wait(page, "lab.level.game === 'keys' && lab.fields.size && lab.part('problem').hidden")
        assert page.evaluate("lab.pictures.keys.images.size") > 0
        assert all("ERR_FAILED" in line for line in told)


def test_drawings_that_cannot_be_had_are_told(chrome, static):
    with window_of(chrome) as (page, _):
        page.route("**/art/*", lambda route: route.abort())
        page.goto(static)
        wait(page, "globalThis.lab?.ready && lab.part('problem').textContent === 'Failed to fetch'")


def test_what_covering_parts_does_is_what_captum_says(page):
    pytest.importorskip("captum", reason="captum is not installed")
    here, there = both(page, kind="attribution", **MAZE, level=3, method="occlusion")
    assert np.allclose(here["map"], there["map"], atol=2e-5)


def test_a_level_is_refused_in_python_s_words(page):
    rows = "#######\n#...#G#\n#.#####\n#.#...#\n#.#.#.#\n#@....#\n#######"
    here, there = both(page, kind="level", **MAZE, level=rows)
    assert here["problem"] == there["problem"] and "cannot be reached" in here["problem"]
    assert here["text"] == there["text"]


CYAN = """([x, y]) => {
  const { left, low, rows } = lab.stage.frame;
  const side = Math.round(lab.stage.scale);
  const [across, down] = [(x - left) * side, (rows + low - 1 - y) * side];
  const { data } = lab.part("world").getContext("2d").getImageData(across, down, side, side);
  return data.some((red, k) => k % 4 === 0 && red < 80 && data[k + 1] > 150 && data[k + 2] > 150);
}"""


@pytest.mark.parametrize(
    "kind, thing",
    [
        ("dish-small", "goal on other"),
        *thorough(("dish-apart-small", "goal"), ("dish-small", "agent")),
    ],
)  # fmt: skip
def test_who_sees_dishes_does_as_in_python(chrome, untrained, tmp_path, kind, thing):
    architecture = Architecture("mlp", (5, 7, 7), (1, 1, 1, 6, 6), 15, width=8)
    untrained(tmp_path / "run", architecture, variant="dish-small", validation=None, width=8)
    asked = {"game": "maze", "variant": kind, "agent": "mouse"}
    lab = Lab(Agents.of({"mouse": tmp_path / "run"}), asked | {"level": 0})
    export(lab, tmp_path / "site", levels=3, agents=["mouse"])
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, told):
        here, there = both(page, lab, kind="level", **asked, level=0)
        assert here["text"] == there["text"] and here["problem"] == there["problem"]
        wait(page, f"({CYAN})({[there['state'][f'other_{axis}'] for axis in 'xy']})")
        here, there = both(page, lab, kind="play", **asked, level=0, steps=30)
        actions = here["actions"]
        assert actions == there["actions"] and here["rewards"] == there["rewards"]
        assert np.allclose(here["value"], there["value"], atol=1e-5)
        here, there = both(page, lab, kind="posterior", **asked, level=0, actions=actions[:3])
        assert here["goals"].keys() == there["goals"].keys() >= {"cheese", "corner"}
        assert np.allclose(here["rates"], there["rates"], atol=2e-5)
        here, there = both(page, lab, kind="splay", **asked, level=0, thing=thing)
        assert sorted(map(str, zip(here["cells"], here["outcomes"], strict=True))) == sorted(
            map(str, zip(map(list, there["cells"]), there["outcomes"], strict=True))
        )
        assert not told


def test_advantages_are_in_the_rewards_that_values_are_of(page):
    value, rewards, deviation = [0.5, 0.4, 2.0, 1.0], [0.0, 3.0, -50.0], 2.5
    told = page.evaluate(
        """async ([value, rewards, reward_deviation]) => {
          const { advantagesOf } = await import(new URL("timeline.js", location.href));
          const about = { agents: { mouse: { gamma: 0.9, lam: 0.8, reward_deviation } } };
          const episode = { value, rewards, terminated: false };
          return advantagesOf({ about, agent: "mouse", episode });
        }""",
        [value, rewards, deviation],
    )
    scaled = RewardNormaliser(1, variance=deviation**2).scaled(np.array(rewards))
    ends = torch.tensor([[False], [False], [True]])
    reward, before, after = (torch.tensor(x)[:, None] for x in (scaled, value[:-1], value[1:]))
    expected = advantages(reward, before, after, torch.zeros_like(ends), ends, 0.9, 0.8)
    assert np.allclose(told, expected[:, 0], atol=1e-6)


def test_an_agent_with_knobs_has_levels_of_its_own(chrome, untrained, tmp_path):
    architecture = Architecture("mlp", (4, 5, 5), (1, 1, 6, 6), 15, width=8)
    untrained(tmp_path / "run", architecture, knobs={"world": 5, "largest": 5}, width=8)
    lab = Lab(Agents.of({"mouse": tmp_path / "run"}), MAZE | {"level": 1})
    own = lab.agents.about("mouse")["knobs"]["anywhere-small"]
    export(lab, tmp_path / "site", levels=3, agents=["maze-corner", "mouse"])
    with folder_served(tmp_path / "site") as address, opened(chrome, address) as (page, told):
        several = itertools.product(("maze-corner", "mouse"), ({}, own), range(3))
        for agent, knobs, number in several:
            asked = MAZE | {"agent": agent, "knobs": knobs, "level": number}
            here, there = both(page, lab, kind="level", **asked)
            assert here["text"] == there["text"] and here["state"] == there["state"]
            assert here["text"].count("\n") == (4 if knobs else 6)
        for agent, knobs in (("mouse", own), ("maze-corner", {})):
            _, there = both(page, lab, kind="level", **MAZE | {"knobs": knobs}, level=1)
            page.locator("[data-lab=agent]").select_option(agent)
            wait(page, f"lab.agent === {agent!r} && lab.text === {there['text']!r}")
            wait(page, "lab.fields.size && lab.part('problem').hidden")
        asked = MAZE | {"kind": "level", "knobs": {"world": 9}, "level": 1}
        said = page.evaluate("(m) => lab.engine.ask(m).catch((error) => error.message)", asked)
        assert said.startswith("This page has no numbered levels of anywhere-small with world = 9;")
        assert not told


def test_levels_of_an_agent_are_in_no_file_of_another_variants(untrained, tmp_path):
    """Those of an agent called "small" with knobs of its own, and those of "anywhere-small"."""
    architecture = Architecture("mlp", (4, 25, 25), (1, 1, 6, 6), 15, width=8)
    own = {"variant": "corner", "validation": "anywhere", "knobs": {"time_limit": 50}, "width": 8}
    untrained(tmp_path / "run", architecture, **own)
    start = {"game": "maze", "variant": "anywhere-small", "level": 0, "agent": ""}
    export(Lab(Agents.of({"small": tmp_path / "run"}), start), tmp_path / "site", 1, ["small"])
    index = json.loads((tmp_path / "site" / "data" / "index.json").read_text())
    files = index["agents"]["small"]["levels"]["anywhere"], "data/levels/maze/anywhere-small.json"
    levels = [json.loads((tmp_path / "site" / file).read_text())["levels"][0] for file in files]
    assert [len(level["text"].splitlines()) for level in levels] == [25, 7]


def test_an_agent_is_exported_though_its_training_has_removed_the_checkpoint(untrained, tmp_path):
    architecture = Architecture("mlp", (4, 25, 25), (1, 1, 6, 6), 15, width=8)
    untrained(tmp_path / "run", architecture, variant="corner", width=8)
    start = {"game": "maze", "variant": "corner-small", "level": 0, "agent": ""}
    lab = Lab(Agents.of({"mouse": tmp_path / "run"}), start)
    path = lab.agents.open("mouse")[0].path
    opened = path.read_bytes()
    path.unlink()
    export(lab, tmp_path / "site", 1, ["mouse"])
    (exported,) = (tmp_path / "site").rglob("mouse.safetensors")
    assert exported.read_bytes() == opened


def test_an_agent_whose_network_was_edited_is_not_exported(monkeypatch, tmp_path):
    """The page computed the one from before the edit, and drew other arrows."""
    hidden = MLP.hidden
    monkeypatch.setattr(MLP, "hidden", lambda network, seen: 2 * hidden(network, seen))
    lab = make_lab("maze-corner", {"level": 0})
    with pytest.raises(ValueError, match="'maze-corner' has an edited mlp; a page computes"):
        export(lab, tmp_path / "site", 1, ["maze-corner"])
    assert not is_computed(load_agent("coin-end"))


@pytest.fixture
def namesake(monkeypatch):
    """Function: the pottery shop under another name, as a guest's."""

    def make(name):
        game = replace(games.find("pottery"), name=name)
        monkeypatch.setitem(games._registered, name, game)
        monkeypatch.setitem(grid._MADE, game, grid.world_of(games.find("pottery")))
        return game

    return make


@pytest.mark.parametrize("name", ["grid", "thief", "kernels", "maze-kernels"])
def test_rules_of_a_guest_are_in_no_file_of_the_page(name, namesake):
    page = Path(export_.__file__).with_name("page")
    path = rules.path(game := namesake(name))
    of_games = {rules.path(games.find(one)) for one in games.OWN}
    assert not (page / path).exists() and path not in {rules.SHARED, *of_games}
    assert not is_drawn(game) and path == rules.entry(game)


@pytest.mark.thorough  # the test before
@pytest.mark.parametrize("name", ["grid", "thief", "kernels", "maze-kernels"])
def test_a_guest_with_the_name_of_a_file_of_the_page_takes_its_place_nowhere(
    chrome, name, namesake, tmp_path
):
    game = namesake(name)
    export(usual_lab(), tmp_path / "site", 1, [], {name: "corner"})
    asked = {"kind": "play", "variant": "corner", "level": 0, "agent": "", "actions": [3, 0, 1]}
    with (
        folder_served(tmp_path / "site") as address,
        opened(chrome, address, "true") as (page, told),
    ):
        guest, own = (page.evaluate("(m) => lab.engine.ask(m)", asked | {"game": one})["states"]
                      for one in (name, "maze"))  # fmt: skip
    there = replay(game, game.variant("corner"), 0, asked["actions"])["steps"]
    assert [s["agent"] for s in guest[1:]] == [[s["x"], s["y"]] for s in there]
    assert "goal_x" in own[0] and not told


def test_nothing_is_written_over_and_nothing_outside(tmp_path):
    lab, mine = usual_lab(), tmp_path / "mine"
    (mine / "data").mkdir(parents=True)
    (mine / "data" / "index.json").write_text("mine")
    with pytest.raises(FileExistsError, match="must be new, or an empty folder"):
        export(lab, mine, levels=1)
    assert (mine / "data" / "index.json").read_text() == "mine"
    names = file_names(["maze-corner", "/home/me/runs/mice/seed-0", "../mice/seed-0", "../.."])
    assert list(names.values()) == ["maze-corner", "mice-seed-0", "mice-seed-0-2", "agent"]


def test_a_folder_that_is_filled_meanwhile_stays_as_it_is(tmp_path, monkeypatch):
    """As by another export: the system's error named the folder twice."""
    one = tmp_path / "site" / "index.html"

    def write(*_):
        one.parent.mkdir()
        one.write_text("mine")

    monkeypatch.setattr("astray.lab.export._write_data", write)
    killed.left(one.parent)
    with pytest.raises(FileExistsError, match="must be new, or an empty folder"):
        export(usual_lab(), one.parent, levels=1)
    assert one.read_text() == "mine" and [*tmp_path.iterdir()] == [one.parent]


def test_replay_and_the_page_agree_on_an_episode(page):
    actions = [7, 5, 5, 1, 8, 3, 7]
    here, _ = both(page, kind="play", **MAZE, level=6, actions=actions)
    told = replay("maze", games.find("maze").variant("anywhere-small"), 6, actions)
    assert [(s["x"], s["y"]) for s in here["states"][1:]] == [
        (s["x"], s["y"]) for s in told["steps"]
    ]


@pytest.mark.parametrize(
    "game, variant, agent",
    [
        ("maze", "anywhere-small", "maze-corner"),
        *thorough(
            ("coinrun", "coin-anywhere", "coin-end"), ("keys", "many-keys-small", "many-chests")
        ),
    ],
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


@pytest.mark.parametrize("most", [700, 300_000])  # bytes of a file: of the page, of the weights
def test_an_export_without_room_names_its_folder_and_leaves_nothing(tmp_path, full_disk, most):
    lab = usual_lab()
    full_disk(most)
    with pytest.raises(OSError, match=r"large; nothing was written: '[^']*[^.]site\b[^']*'$"):
        export(lab, tmp_path / "site", levels=1, agents=["maze-corner"])
    assert not list(tmp_path.iterdir())
