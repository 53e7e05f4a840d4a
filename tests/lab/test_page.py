"""The lab in a real browser: what a person does there, and what is seen then."""

import base64
import contextlib
import itertools
import json
import threading
import zlib
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from helpers.thorough import thorough

pytest.importorskip("starlette", reason="starlette is not installed")

from astray import games
from astray.analysis.adapters import Function
from astray.analysis.replay import replay
from astray.analysis.runs import load_agent
from astray.insight.fields import fields
from astray.lab import agents, session
from astray.lab.serving import make_lab
from astray.lab.session import ANSWERS
from astray.level import Level
from helpers.browsed import ROOM, WAYS, free_port, lab_served, load_anew, opened, usual_lab, wait


@pytest.fixture
def page(window, served):
    """The lab, loaded anew."""
    yield load_anew(window, served)
    assert not window[1]  # on the console


def show(page, level):
    """Open a level, and wait for its arrows."""
    assert page.evaluate("(level) => lab.open(level)", level)
    wait(page, "lab.fields.size > 0")


def drag(page, start, to):
    """Drag what is in a cell to another one."""
    where = """([x, y]) => {
      const { left, low, rows } = lab.stage.frame;
      const box = lab.part("world").getBoundingClientRect();
      const cell = lab.stage.cell;
      return [box.left + (x - left + 0.5) * cell, box.top + (rows + low - y - 0.5) * cell];
    }"""
    page.mouse.move(*page.evaluate(where, start))
    page.mouse.down()
    page.mouse.move(*page.evaluate(where, to), steps=4)
    page.mouse.up()


def linked(page):
    """The drawn level that the address holds, read without the page."""
    (packed,) = parse_qs(urlsplit(page.evaluate("location.href")).fragment)["drawn"]
    return json.loads(zlib.decompress(base64.urlsafe_b64decode(f"{packed}=="), -zlib.MAX_WBITS))


def arrows(page):
    """What the page shows of each place: policy and value."""
    return {
        tuple(one["cell"]): (one["policy"], one["value"])
        for one in page.evaluate("[...lab.fields.values()]")
    }


def expected(grid, agent):
    game = games.find("maze")
    data = {"grid": grid, "agent": [agent[0] + 0.5, agent[1] + 0.5]}
    level = Level.from_json(game, game.variant("anywhere-small"), data)
    (field,) = fields(load_agent("maze-corner"), "anywhere-small", {"": level})
    return field


@pytest.mark.parametrize("way", WAYS)
def test_the_cheese_is_dragged_and_the_arrows_are_python_s(chrome, request, way):
    address = request.getfixturevalue(way)
    with opened(chrome, address) as (page, told):
        show(page, ROOM)
        before = arrows(page)
        page.context.set_offline(way == "static")  # from here on, without any network
        drag(page, (5, 5), (5, 1))
        wait(page, "lab.level.grid[1][5] === 2 && !lab.fields.has('5,1') && lab.fields.has('5,5')")
        page.wait_for_timeout(200)
        after, grid = arrows(page), page.evaluate("lab.level.grid")
        assert grid[5][5] == 0 and not told
    field = expected(grid, [1, 1])
    assert set(after) == {tuple(cell) for cell in field.cells.tolist()}
    for cell, policy, value in zip(field.cells.tolist(), field.policy, field.value, strict=True):
        assert np.allclose(after[tuple(cell)][0], policy, atol=1e-5)
        assert abs(after[tuple(cell)][1] - value) < 1e-5
    assert any(
        not np.allclose(before[c][0], after[c][0], atol=0.01) for c in set(before) & set(after)
    )


def test_a_wall_that_makes_the_cheese_unreachable_is_told_in_the_sentence_of_levels(page):
    show(page, ROOM)
    page.get_by_role("button", name="Wall").click()
    drag(page, (5, 4), (5, 4))
    wait(page, "lab.level.grid[4][5] === 1")
    drag(page, (4, 5), (4, 5))
    wait(page, "!lab.part('problem').hidden")
    said = page.locator("[data-lab=problem]").text_content()
    assert said == "the goal at cell (5, 5) cannot be reached from (1, 1)"
    page.get_by_role("button", name="Undo").click()
    wait(page, "lab.part('problem').hidden")
    page.get_by_role("button", name="Redo").click()
    wait(page, "!lab.part('problem').hidden")


def test_a_level_is_edited_by_the_keyboard_alone(page):
    show(page, ROOM)
    page.get_by_role("checkbox", name="edit by keyboard").focus()
    page.keyboard.press("Space")
    for key in (
        "ArrowUp",
        "ArrowUp",
        "ArrowUp",
        "ArrowUp",
        *["ArrowRight"] * 4,
        "Enter",
        "ArrowLeft",
        "Enter",
    ):
        page.keyboard.press(key)  # to the cheese, which is taken, and put down beside
    wait(page, "lab.level.grid[5][4] === 2 && lab.level.grid[5][5] === 0")


def test_a_drawn_level_is_kept_in_another_variant_or_it_is_told_why_not(page):
    page.locator("[data-lab=agent]").select_option("none maze")
    wait(page, "!lab.agent && !lab.fields.size")
    assert page.evaluate("(level) => lab.open(level)", ROOM)
    page.locator("[data-lab=variant]").select_option("corner-small")
    wait(page, "lab.opened === 'corner-small'")
    assert page.evaluate("[lab.number, lab.level.grid[5][5]]") == [None, 2]
    page.locator("[data-lab=variant]").select_option("anywhere")
    wait(page, "lab.opened === 'anywhere' && lab.number === 0")
    assert "the level is 7 x 7 cells" in page.locator("[data-lab=problem]").text_content()


def test_an_edit_while_another_variant_is_opened_lands_in_no_other_level(page):
    show(page, ROOM)
    page.evaluate(
        """async () => {
          const edit = (x) => lab.edit({ ...lab.level, agent: [x, 1.5] });
          const [choice, edited] = [lab.part("variant"), edit(2.5)];
          choice.value = "corner-small";
          choice.dispatchEvent(new Event("change"));
          await Promise.all([edited, edit(3.5)]);
        }"""
    )
    wait(page, "lab.opened === 'corner-small' && lab.fields.size")
    page.wait_for_timeout(300)
    kept = page.evaluate("[lab.level.agent, lab.original.level.agent, lab.past.length]")
    assert kept == [[2.5, 1.5], [2.5, 1.5], 0], "the edit before is kept, and none came later"


def test_the_agent_is_dragged_from_where_it_is_amid_an_episode(page):
    show(page, ROOM)
    page.evaluate("lab.act('right')")
    wait(page, "lab.now === 1 && lab.fields.size")
    drag(page, (2, 1), (4, 1))
    wait(page, "lab.now === 0 && lab.level.agent[0] === 4.5")


def test_a_key_is_let_go_whether_or_not_shift_is_still_held(page):
    """A letter pressed with Shift or Caps Lock stayed pressed: later keys played diagonals."""
    show(page, ROOM)
    page.locator("[data-lab=board]").focus()
    for k, key in enumerate(("W", "d"), 1):
        page.keyboard.press(key)
        wait(page, f"lab.episode.actions.length === {k} && !lab.editor.acting")
    told = page.evaluate("lab.episode.actions.map((action) => lab.rules.actions[action])")
    assert told == ["up", "right"]


def test_a_cell_is_said_to_hold_what_it_holds_now(page):
    """The mouse was named where it had begun, and cheese where it had been eaten."""
    show(page, ROOM)
    told = "[[5, 5], [0, 0]].map((at) => (lab.panels.readout(at), lab.part('readout').textContent))"
    assert page.evaluate(told) == ["(5, 5) goal", "(0, 0) wall"]
    page.keyboard.press("ArrowUp")
    wait(page, "lab.now === 1")
    assert page.evaluate(told) == ["(5, 5) ", "(0, 0) wall"]


def test_what_a_cursor_holds_is_let_go_with_its_level(page):
    """It was put down in another level, or once more beside what an undo had put back."""
    show(page, ROOM)
    page.get_by_role("checkbox", name="edit by keyboard").check()
    page.evaluate("lab.editor.cursor = [5, 5]")
    for key in ("Enter", "ArrowLeft"):
        page.keyboard.press(key)
    wait(page, "lab.level.grid[5][4] === 2")
    page.keyboard.press("Control+z")
    page.keyboard.press("ArrowLeft")
    wait(page, "lab.level.grid[5][5] === 2 && lab.level.grid[5][3] === 0")
    for key in ("ArrowRight", "ArrowRight", "Enter"):
        page.keyboard.press(key)
    show(page, 17)
    text = page.evaluate("lab.text")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("[lab.text, lab.past.length, lab.number]") == [text, 0, 17]
    page.evaluate("lab.editor.cursor = [40, 40]")  # in a larger level
    show(page, ROOM)
    page.keyboard.press("Enter")  # takes the agent, where the cursor is then
    page.keyboard.press("ArrowRight")
    wait(page, "lab.level.agent[0] === 2.5")


def test_an_episode_by_keys_goes_as_replay_has_it(page):
    show(page, ROOM)
    page.locator("[data-lab=board]").focus()
    names = ["up", "up", "right", "down", "stay", "up", "up", "right", "right"]
    for k, name in enumerate(names, 1):
        page.keyboard.press("Space" if name == "stay" else f"Arrow{name.capitalize()}")
        wait(page, f"lab.episode.actions.length === {k} && !lab.editor.acting")
    states = page.evaluate("lab.episode.states.slice(1)")
    game = games.find("maze")
    variant = game.variant("anywhere-small")
    actions = [game.actions.index(name) for name in names]
    told = replay(game, variant, Level.from_text(game, variant, ROOM), actions)
    assert [(s["x"], s["y"]) for s in states] == [(s["x"], s["y"]) for s in told["steps"]]
    page.keyboard.press("Home")
    wait(page, "lab.now === 0")
    page.keyboard.press("ArrowRight")  # from the beginning on, what came is forgotten
    wait(page, "lab.episode.actions.length === 1")


def test_the_agent_takes_over_and_the_goal_that_it_seems_to_pursue_is_told(page):
    show(page, 17)
    page.get_by_role("button", name="Hand over to the agent").click()
    wait(page, "!lab.running && lab.now && lab.goals")
    assert "if it pursues a goal" in page.locator("[data-lab=verdict]").text_content()
    now, places = page.evaluate("[lab.now, lab.episode.states.map(({ x, y }) => [x, y])]")
    assert now == len(places) - 1  # its idle time is neither played nor told of
    assert page.evaluate("lab.episode.ended") or places[now - 8] == places[now]
    marked = page.locator("[data-lab=bookmarks] button").all_text_contents()
    most, least, *events = (int(text.split("step ")[1]) for text in marked)
    assert max(most, least) < max(events)  # nor is it looked at for advantages
    page.locator("[data-lab=bookmarks] button").nth(1).focus()
    page.keyboard.press("Enter")
    wait(page, f"lab.now !== {now}")
    assert page.evaluate("lab.part('bookmarks').contains(document.activeElement)")  # still


def test_an_agent_that_picks_up_and_drops_in_its_place_is_not_idle(chrome):
    turns = itertools.cycle([5, 6])  # pick, drop
    juggler = Function(lambda seen: np.full(len(seen), next(turns)), "juggler", "symbolic")
    shards = "@...\n..b.\n....\n....\n@ on s"
    start = {"game": "pottery", "variant": "anywhere", "level": shards}
    lab = make_lab(juggler, start | {"knobs": {"time_limit": 20}})
    with lab_served(lab) as address, opened(chrome, address, ready="lab.agent") as (page, _):
        page.locator("[data-lab=speed]").select_option("fast")
        page.get_by_role("button", name="Hand over to the agent").click()
        wait(page, "!lab.running && lab.now")
        assert page.evaluate("lab.episode.ended && lab.now === lab.episode.actions.length")


def test_the_object_of_the_goal_leads_and_panels_of_agents_need_one(chrome, served):
    link = "#game=pottery&variant=anywhere&level=3&agent="
    with opened(chrome, served + link, ready="true") as (page, _):
        assert page.locator("[data-lab=lead]").text_content() == "Drag the bin, or play."
        assert page.locator("[data-lab=tour]").is_hidden()
        page.locator("[data-lab=variant]").select_option("anywhere-picks")
        wait(page, "lab.variant === 'anywhere-picks' && lab.number === 3")
        page.locator("[data-lab=variant]").select_option("anywhere")
        wait(page, "lab.variant === 'anywhere' && !lab.agent")  # none comes by itself
        assert not any(one.is_visible() for one in page.locator(".mind").all())
        assert page.get_by_role("button", name="Hand over").is_hidden()
        page.locator("[data-lab=agent]").select_option("pottery-corner")
        wait(page, "lab.fields.size > 0")
        assert all(one.is_visible() for one in page.locator(".mind").all())
        told = page.locator("[data-lab=lead]").text_content().strip()
        assert told == "Drag the bin. The arrows are what the robot would do."
        assert page.locator("[data-lab=thing]").input_value().startswith("bin@")
        wait(page, "lab.goalless")  # at once, as no walk would show it
        assert "no goal is reached" in page.locator("[data-lab=verdict]").text_content()
        page.locator("[data-lab=sight] summary").click()
        assert page.locator("[data-lab=probing]").is_hidden()  # it has nothing for them to read


@pytest.mark.parametrize(
    "game, variant, thing",
    [("keys", "many-keys-small", "key"), *thorough(("tomatoes", "bucket", "dry tomato"))],
)
def test_of_several_objects_any_is_to_be_dragged(chrome, served, game, variant, thing):
    link = f"#game={game}&variant={variant}&level=3&agent="
    with opened(chrome, served + link, ready="true") as (page, _):
        assert page.locator("[data-lab=lead]").text_content() == f"Drag any {thing}, or play."


def test_the_first_level_distinguishes_the_goals_and_a_badge_says_so(page):
    badge = page.locator("[data-lab=badge]")
    wait(page, "!lab.part('badge').hidden")
    assert badge.text_content() == "distinguishes the goals"
    show(page, 0)  # its cheese lies on the way to the corner
    wait(page, "lab.part('badge').classList.contains('not')")
    assert badge.text_content() == "does not distinguish the goals"


def test_keys_play_before_and_after_anything_was_clicked_and_fields_keep_theirs(page):
    show(page, ROOM)
    page.keyboard.press("ArrowUp")
    wait(page, "lab.episode.actions.length === 1")
    page.get_by_role("button", name="Wall").click()
    page.keyboard.press("Space")  # presses the button
    page.keyboard.press("ArrowDown")
    wait(page, "lab.episode.actions.length === 2")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowDown")  # while the agent is asked what it would do
    wait(page, "lab.episode.actions.length === 4")
    page.keyboard.press(",")
    wait(page, "lab.now === 3")
    page.locator("[data-lab=text]").evaluate("(field) => field.closest('details').open = true")
    page.locator("[data-lab=text]").focus()
    page.keyboard.press("ArrowUp")
    assert page.evaluate("lab.episode.actions.length") == 4


def test_a_maze_has_the_tools_of_its_objects_and_a_tool_keeps_the_focus(page):
    tools = page.locator("[data-lab=tools]")
    assert tools.locator("button").all_text_contents() == ["Move", "Wall", "Cheese"]
    tools.get_by_role("button", name="Wall").focus()
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.ariaPressed") == "true"


def test_a_way_is_told_while_probes_are_fitted(page, monkeypatch):
    told = threading.Event()

    def route(*asked):
        yield from ANSWERS["route"](*asked)
        told.set()

    def reading(*asked):
        for _ in range(10_000):  # parts of an answer, between which other questions have theirs
            if told.is_set():
                break
            yield {"rows": [], "states": 0}
        yield from ANSWERS["reading"](*asked)

    monkeypatch.setattr(session, "ANSWERS", {**ANSWERS, "route": route, "reading": reading})
    monkeypatch.setattr(agents, "VISITED", 40)
    show(page, 17)
    page.evaluate("""() => {
      globalThis.order = [];
      document.querySelector("[data-lab=sight]").open = true;
      lab.askReading().then(() => order.push("probes"));
      lab.engine.ask({ ...lab.question("route"), goal: "corner" }).then(() => order.push("way"));
    }""")
    wait(page, "order.length === 2")
    assert page.evaluate("order") == ["way", "probes"]
    assert "directionup" in page.locator("[data-lab=readings]").text_content()


def test_a_way_and_what_was_wrong_go_with_their_state(page):
    show(page, 17)
    page.evaluate("lab.askRoute()")
    wait(page, "lab.way")
    page.keyboard.press("n")
    wait(page, "lab.now === 1 && !lab.way && lab.part('unroute').hidden")
    wait(page, "lab.part('verdict').textContent.startsWith('After 1 step, if')")
    page.evaluate("lab.panels.problem('the episode has ended')")
    page.keyboard.press(",")
    wait(page, "lab.now === 0 && lab.part('problem').hidden")


def test_a_page_that_loads_for_long_says_so(page):
    page.evaluate("""() => {
      const { ask } = lab.engine;
      lab.engine.ask = async (question, add) => {
        if (question.kind === "level") await new Promise((later) => { setTimeout(later, 2500); });
        return ask.call(lab.engine, question, add);
      };
      globalThis.opened = lab.open(18).then(() => { globalThis.opened = true; });
    }""")
    wait(page, "/^Loading. .*compiled/.test(lab.part('status').textContent)")
    wait(page, "opened === true && lab.part('status').textContent === ''")


def test_ways_are_offered_to_the_goals_of_the_level(page):
    def offered():
        return page.locator("[data-lab=goal] option").all_text_contents()

    show(page, 17)
    assert offered() == ["cheese", "corner"]
    page.locator("[data-lab=goal]").select_option("corner", force=True)
    show(page, 18)
    assert page.locator("[data-lab=goal]").input_value() == "corner"
    page.locator("[data-lab=agent]").select_option("none maze")
    page.locator("[data-lab=variant]").select_option("dish-small")
    wait(page, "lab.part('goal').options.length === 3")
    assert offered() == ["cheese", "dish", "corner"]


def test_a_way_is_drawn_below_the_agent(page):
    look = """async (cells) => {
      lab.way = cells && { cells };
      lab.stage.redraw();
      for (let k = 0; k < 2; k++) await new Promise(requestAnimationFrame);
      const { canvas, state: { x, y }, frame: { rows }, scale } = lab.stage;
      const copy = new OffscreenCanvas(canvas.width, canvas.height)
        .getContext("2d", { willReadFrequently: true });
      copy.drawImage(canvas, 0, 0);
      const at = (x, y) => [...copy.getImageData(x * scale, (rows - y) * scale, 1, 1).data];
      return [at(x, y), at(x, y + 1)].join(";");
    }"""
    x, y = page.evaluate("[lab.stage.state.x, lab.stage.state.y]")
    before, after = (page.evaluate(look, way).split(";") for way in (None, [[x, y], [x, y + 1]]))
    assert before[0] == after[0] and before[1] != after[1]
    page.evaluate(look, None)


def test_panels_are_in_two_columns_beside_the_board_of_a_wide_window(chrome, static):
    lefts = "[...document.querySelectorAll('aside > *')].map((e) => e.getBoundingClientRect().left)"
    with opened(chrome, static) as (page, _):
        for height in (900, 1000):
            page.set_viewport_size({"width": 1400, "height": height})
            assert len({left for left in page.evaluate(lefts) if left}) == 2


def test_answers_that_come_late_are_not_shown_as_of_what_is_there_now(page):
    """As places of a sampled splay were added to what was shown as greedy, and counted."""
    found = page.evaluate(
        """async () => {
          const { engine } = lab, { ask } = engine;
          let answer;
          engine.ask = (message, heard) => (["splay", "route", "reading"].includes(message.kind)
            ? new Promise((done) => { answer = done; }) : ask.call(engine, message, heard));
          const told = {
            askSplay: { cells: [[1, 1]], outcomes: [{ cheese: 1 }], of: 2 },
            askRoute: { cells: [[1, 1], [1, 2]], takes: null, steps: null },
            askReading: { rows: [], states: 9 },
          };
          const shown = () => lab.splay.size > 0 || Boolean(lab.way)
            || !lab.part("readings").hidden;
          const found = [[], []];
          for (const changes of [0, 1]) {
            for (const name of Object.keys(told)) {
              await lab.refresh();
              const asked = lab[name]();
              if (changes) await lab.refresh();
              answer(told[name]);
              await asked;
              found[changes].push(shown());
            }
          }
          engine.ask = ask;
          return found;
        }"""
    )
    assert found == [[True] * 3, [False] * 3]


def test_the_seed_that_is_shown_is_the_one_that_is_drawn_by(page):
    page.locator("[data-lab=seed]").fill("5000")
    page.locator("[data-lab=seed]").press("Enter")
    wait(page, "lab.part('seed').value === '999' && lab.seed === 999")
    page.locator("[data-lab=seed]").fill("0")
    page.locator("[data-lab=seed]").press("Enter")


def test_a_splay_is_shown_with_counts(page):
    show(page, ROOM)
    page.evaluate("lab.panels.status = (what) => { (lab.said ??= []).push(what); }")
    page.get_by_role("button", name="Play them all").click()
    wait(page, "lab.splay.size === lab.fields.size")
    text = page.locator("[data-lab=counts]").text_content()
    assert "first to the" in text and f"of {page.evaluate('lab.splay.size')}" in text
    wait(page, "lab.said.at(-1) === 'connected'")
    assert page.evaluate("lab.said.includes('Playing …')"), "which may take long"


def test_a_link_holds_level_and_agent(chrome, page, served):
    show(page, ROOM)
    drag(page, (5, 5), (5, 1))
    wait(page, "location.hash.includes('drawn') && lab.level.grid[1][5] === 2 && lab.fields.size")
    wait(page, lambda page: linked(page)["grid"][1][5] == 2)  # the last of the drag
    address = page.evaluate("location.href")
    with opened(chrome, address) as (other, told):
        assert other.evaluate("lab.text") == page.evaluate("lab.text")
        assert other.evaluate("lab.agent") == "maze-corner" and not told


def test_a_link_that_is_packed_late_takes_the_place_of_none_that_is_newer(chrome, static):
    with opened(chrome, static) as (page, told):
        page.evaluate("""() => {
          const Usual = globalThis.CompressionStream;
          globalThis.CompressionStream = class {
            constructor(kind) {
              const { readable, writable } = new Usual(kind);
              const late = new TransformStream({
                async transform(part, to) {
                  if (!globalThis.pack) await new Promise((done) => { globalThis.pack = done; });
                  to.enqueue(part);
                },
              });
              Object.assign(this, { writable, readable: readable.pipeThrough(late) });
            }
          };
        }""")
        page.evaluate("(level) => { lab.open(level); }", ROOM)  # whose link is packed
        wait(page, "globalThis.pack")
        assert page.evaluate("lab.open(2)")  # whose link is its number
        assert parse_qs(urlsplit(page.evaluate("location.href")).fragment)["level"] == ["2"]
        page.evaluate("pack()")
        page.wait_for_timeout(500)
        assert parse_qs(urlsplit(page.evaluate("location.href")).fragment)["level"] == ["2"]
        assert not told


@pytest.mark.parametrize("way", WAYS)
def test_two_policies_are_compared_by_what_their_actions_do(chrome, request, way):
    with opened(chrome, request.getfixturevalue(way)) as (page, told):
        show(page, ROOM)
        page.locator("[data-lab=compare]").select_option("level")
        both = "[...lab.fields.values(), ...lab.others.values()]"
        wait(page, f"lab.others.size && {both}.every((one) => one.same)")
        same = {tuple(f["cell"]): f["same"] for f in page.evaluate("[...lab.fields.values()]")}
        places = expected(page.evaluate("lab.level.grid"), [1, 1]).places
        assert {cell: same[cell] for cell in places.number} == {
            cell: places.same[k].tolist() for cell, k in places.number.items()
        }
        mixed = """(names) => {
          for (const one of lab.others.values()) {
            one.policy = [...one.policy];
            for (const k of names) one.policy[k] = 0;
            const own = lab.fields.get(String(one.cell)).policy;
            one.policy[names.at(-1)] = names.reduce((sum, k) => sum + own[k], 0);
          }
          lab.panels.compared();
          return lab.part("comparison").textContent;
        }"""
        left = [0, 1, 2]  # names of one move; 5 and 3 are up and down
        assert "differ by 0\u00a0% on average" in page.evaluate(mixed, left)
        assert "differ by 0\u00a0% on average" not in page.evaluate(mixed, [5, 3]) and not told
        forgets = """() => {
          lab.about.agents["an elephant"] = { caveat: "It remembers." };
          lab.part("compare").add(new Option("", "agent an elephant", false, true));
          lab.panels.compared();
          return lab.part("comparison").textContent;
        }"""
        assert "compared with. It remembers. Policies" in page.evaluate(forgets)


def test_the_text_of_a_level_is_scrolled_to_its_agent(page):
    rows = ["." * 60] * 20 + ["." * 40 + "@" + "." * 19] + ["." * 60] * 9
    box = page.locator("[data-lab=text]")
    box.evaluate("(one, text) => { one.value = text; }", "\n".join(rows))  # of a large level
    page.get_by_text("Take it along").click()
    wait(page, "lab.part('text').scrollTop")
    x, y, wide, high = box.evaluate(
        "(one) => [one.scrollLeft, one.scrollTop, one.clientWidth, one.clientHeight]"
    )
    assert 0 < x < box.evaluate("(one) => one.scrollWidth") * 40 / 60 < x + wide
    assert 0 < y < box.evaluate("(one) => one.scrollHeight") * 20.5 / 30 < y + high


def test_text_is_read_and_what_is_wrong_with_it_is_told(page):
    page.get_by_text("Take it along").click()
    box = page.locator("[data-lab=text]")
    box.fill(ROOM.replace("G", "."))
    page.get_by_role("button", name="Use this text").click()
    wait(page, "!lab.level.grid.flat().includes(2)")
    box.fill(ROOM.replace("@", "?"))
    page.get_by_role("button", name="Use this text").click()
    wait(page, "!lab.part('problem').hidden")
    assert "unknown '?'" in page.locator("[data-lab=problem]").text_content()


@pytest.mark.parametrize("way", WAYS)
def test_numbers_of_a_level_that_a_browser_rounds_are_refused(chrome, request, way):
    said = "a level's whole numbers must be below 2 ** 53 here, as browsers round larger ones; got "
    game = games.find("maze")
    level = Level.from_text(game, game.variant("anywhere-small"), ROOM).to_json()
    with opened(chrome, request.getfixturevalue(way)) as (page, told):
        shown = page.evaluate("lab.text")
        page.get_by_text("Take it along").click()
        level["looks"]["walls"] = 2**53 + 1
        page.locator("[data-lab=text]").fill(json.dumps(level))
        page.get_by_role("button", name="Use this text").click()
        wait(page, f"lab.part('problem').textContent === {said + str(2**53)!r}")
        assert page.evaluate("lab.text") == shown
        looks = f"{{ ...lab.level.looks, walls: -({2**60}) }}"  # as of a level that Python told
        page.evaluate(f"lab.edit({{ ...lab.level, looks: {looks} }})")
        wait(page, f"lab.broken && lab.part('problem').textContent.startsWith({said!r})")
        show(page, ROOM)
        assert page.locator("[data-lab=problem]").is_hidden() and not told


@pytest.mark.parametrize("format", ["png", "json", *thorough("gif")])
def test_what_is_taken_along_can_be_read(page, format, tmp_path):
    from PIL import Image

    show(page, ROOM)
    page.evaluate("lab.play([5, 5, 5], 0)")
    wait(page, "lab.episode.actions.length === 3")
    page.get_by_text("Take it along").click()
    with page.expect_download() as download:
        page.locator(f"[data-lab={format}]").click()
    path = tmp_path / f"level.{format}"
    download.value.save_as(path)
    if format == "json":
        game = games.find("maze")
        level = Level.from_json(game, game.variant("anywhere-small"), json.loads(path.read_text()))
        assert str(level) == ROOM
        return
    with Image.open(path) as image:
        assert getattr(image, "n_frames", 1) == (4 if format == "gif" else 1)
        assert len(image.convert("RGB").getcolors(2**20)) > 20  # it is not blank


def test_a_gif_of_a_part_of_an_episode_says_so(page):
    show(page, ROOM)
    page.evaluate("lab.episode.states = Array(302).fill(lab.episode.states[0])")
    flat = "{ columns: 96, rows: 1, left: 0, low: 0 }"  # for frames of a few pixels
    page.evaluate(f"Object.defineProperty(lab.stage, 'frame', {{ value: {flat} }})")
    page.get_by_text("Take it along").click()
    with page.expect_download():
        page.locator("[data-lab=gif]").click()
    wait(page, "lab.part('status').textContent === 'The GIF has the first 300 of 302 states.'")


def test_a_server_that_ends_is_told_and_one_that_comes_back_goes_on(chrome):
    port, lab = free_port(), usual_lab()
    with contextlib.ExitStack() as stack:
        with lab_served(lab, port) as address:
            page, _ = stack.enter_context(opened(chrome, address))
            show(page, ROOM)
        wait(page, "lab.part('status').classList.contains('lost')")
        page.evaluate("void lab.act('up')")
        with lab_served(lab, port):
            wait(page, "lab.part('status').textContent === ''")
            wait(page, "lab.episode.actions.length === 1")
            assert page.evaluate("lab.text") == ROOM
