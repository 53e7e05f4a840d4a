"""The lab as it opens: links, loading, widths and access."""

import base64
import itertools
import zlib

import pytest

from helpers.thorough import thorough

pytest.importorskip("starlette", reason="starlette is not installed")

from helpers.browsed import LOADED, WAYS, load_anew, opened, violations, wait

LONG = '{"grid": [[0]], "agent": [0, 0], "looks": "%s"}' % (400_000 * "x")
WIDTHS = {
    "laptop": {"width": 1280, "height": 800},
    "tablet": {"width": 820, "height": 1100},
    "phone": {"width": 390, "height": 780},
}


def packed(level):
    """A drawn level as links have it."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    data = deflate.compress(level.encode()) + deflate.flush()
    return base64.urlsafe_b64encode(data).decode().rstrip("=")


MAZE, POTTERY = ("game=maze&variant=anywhere-small&agent=maze-corner&level=17",
                 "game=pottery&variant=anywhere&agent=&level=3")  # fmt: skip


@pytest.mark.parametrize(
    "change, agent, said",
    [
        (("agent=maze-corner", "agent=foo"), "", "The agent 'foo' is not in this lab; no agent"),
        (("level=17", f"drawn={packed(LONG)}"), "maze-corner", "be at most 262144 characters; got"),
        (("anywhere-small", "anywhere"), "", "'maze-corner' cannot play in anywhere here; no ag"),
        (("agent=maze-corner", "agent="), "", ""),
    ],
)
def test_a_link_that_cannot_be_opened_says_so_and_shows_no_other_agent(
    window, served, change, agent, said
):
    page = load_anew(window, f"{served}#{MAZE.replace(*change)}", ready="lab.level")
    assert page.evaluate("lab.agent") == agent and not window[1]
    problem = page.locator("[data-lab=problem]")
    assert problem.is_visible() == bool(said) and said in problem.text_content()


READ = """async (link) => {
  const { fromLink } = await import(new URL("link.js", location.href));
  const { agent, wrong } = await fromLink(`#${link}`, lab.about);
  return [agent, wrong];
}"""


@pytest.mark.parametrize(
    "change, agent, said",
    [
        (("agent=maze-corner", "agent=constructor"), "", "'constructor' is not in this lab; no"),
        (("agent=maze-corner", "agent=coin-end"), "", "'coin-end' plays coinrun, not maze"),
        (("game=maze", "game=chess"), "", "This lab has no game 'chess'."),
        (("game=maze&", ""), "", "This lab has no game ''."),
        (("level=17", "level="), "maze-corner", "from 0 to 2147483646; the link has ''"),
        (("variant=anywhere-small", "variant=nope"), "maze-corner", "no variant 'nope' of maze"),
        (("level=17", "level=abc"), "maze-corner", "from 0 to 2147483646; the link has 'abc'"),
        (("level=17", "level=" + 200 * "9"), "maze-corner", f"the link has '{80 * '9'}…'."),
        (("level=17", f"drawn={packed('[1, 2]')}"), "maze-corner", "drawn cannot be read from the"),
    ],
)
def test_what_is_wrong_with_a_link_is_told_and_no_other_agent_chosen(page, change, agent, said):
    chosen, wrong = page.evaluate(READ, MAZE.replace(*change))
    assert chosen == agent and said in wrong


DRAWN_AS_ANY = """async (names) => {
  const { lookOf } = await import(new URL("games/looks.js", location.href));
  return names.filter((name) => lookOf(name) === lookOf("chess") && !lab.pictures[name]);
}"""


def test_a_game_may_have_the_name_of_what_every_object_has(page):
    names = ["constructor", "valueOf", "__proto__", "chess"]
    assert page.evaluate(DRAWN_AS_ANY, names) == names


FOLLOWED = "(hash) => { location.hash = hash; }"
SHOWN = "[lab.game, lab.variant, lab.number, lab.level.grid.length, location.hash.slice(1)]"


@pytest.mark.parametrize("way", WAYS)
def test_a_link_whose_level_cannot_be_opened_shows_another_of_its_game(chrome, request, way):
    with opened(chrome, request.getfixturevalue(way)) as (page, told):
        grid = packed('{"grid": [[0, 0], [0, 99]], "agent": [0.5, 0.5], "looks": {}}')
        page.evaluate(FOLLOWED, f"game=pottery&variant=corner&agent=&drawn={grid}")
        wait(
            page, "lab.game === 'pottery' && lab.number === 0 && location.hash.endsWith('level=0')"
        )
        assert "pottery" in page.evaluate("lab.level.game") and not told
        assert "at cell (1, 1); there are" in page.locator("[data-lab=problem]").text_content()
        assert page.evaluate("lab.level.grid.length") > 2


def test_a_code_of_no_kind_is_refused_without_python(chrome, static):
    room = "[[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 0, 99, 2, 1], [1, 0, 0, 0, 1], [1, 1, 1, 1, 1]]"
    link = f"{static}#game=maze&variant=anywhere-small&agent=maze-corner&drawn="
    level = packed(f'{{"grid": {room}, "agent": [1.5, 1.5], "looks": {{}}}}')
    with opened(chrome, link + level) as (page, told):
        assert page.evaluate("lab.number") == 0 and not told
        assert "at cell (2, 2); there are" in page.locator("[data-lab=problem]").text_content()


def test_links_that_come_before_others_are_answered_do_not_mix(chrome, served):
    slow = """void (lab.engine.ask = ((ask) => async (question, heard) => {
      const told = await ask(question, heard);
      if (question.kind === "art") await new Promise((on) => { setTimeout(on, 700); });
      return told;
    })(lab.engine.ask.bind(lab.engine)))"""
    with opened(chrome, f"{served}#{MAZE}") as (page, told):
        page.evaluate(slow)
        page.evaluate(FOLLOWED, POTTERY)
        wait(page, "lab.game === 'pottery'")
        page.go_back()
        wait(page, "lab.game === 'maze'")
        page.wait_for_timeout(1500)  # until the pottery's pictures are there
        assert page.evaluate(SHOWN) == ["maze", "anywhere-small", 17, 7, MAZE] and not told
        assert page.evaluate("lab.pictures.maze.images.has('cheese')")


@pytest.mark.thorough  # `test_links_that_come_before_others_are_answered_do_not_mix`
def test_a_link_that_comes_while_the_first_is_opened_is_followed(chrome, served):
    context = chrome.new_context()
    page = context.new_page()
    page.add_init_script(f"""const soon = setInterval(() => {{
      if (!globalThis.lab?.about) return;
      clearInterval(soon);
      location.hash = "{POTTERY}";
    }}, 0);""")
    page.goto(f"{served}#{MAZE}")
    wait(page, f"{LOADED} && lab.game === 'pottery' && lab.level?.game === 'pottery'")
    page.wait_for_timeout(500)
    assert page.evaluate("location.hash") == f"#{POTTERY}"
    context.close()


def test_a_level_that_was_not_exported_is_told_and_another_one_shown(chrome, static):
    link = f"{static}#game=maze&variant=anywhere-small&agent=maze-corner&level=777"
    with opened(chrome, link) as (page, told):
        assert page.evaluate("[lab.agent, lab.number]") == ["maze-corner", 0] and not told
        assert "levels 0 to 7" in page.locator("[data-lab=problem]").text_content()


def test_nothing_can_be_used_before_it_is_loaded(chrome, static):
    context = chrome.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(static)
    assert page.locator("[data-lab=main]").get_attribute("inert") is not None
    assert page.locator("[data-lab=lead]").text_content().startswith("Loading")
    context.close()


def test_a_page_without_python_does_not_say_that_it_compiles(chrome, static):
    page = chrome.new_context().new_page()
    page.route("**/data/*/**", lambda route: None)  # a slow server's
    page.goto(static)
    page.get_by_text("Loading.", exact=True).wait_for()
    page.context.close()


@pytest.mark.parametrize("begun", ["phone", *thorough("laptop", "tablet")])
def test_nothing_is_wider_than_the_page(window, served, begun):
    page = window[0]
    page.set_viewport_size(WIDTHS[begun])
    load_anew(window, served)
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    for size, theme in itertools.product(WIDTHS.values(), ("light", "dark")):
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=theme)
        wait(page, f"document.documentElement.scrollWidth <= {size['width']}")
        background = page.evaluate("getComputedStyle(lab.root).backgroundColor")
        assert (sum(map(int, background[4:-1].split(","))) < 200) == (theme == "dark")
    assert not window[1]


@pytest.mark.parametrize(
    "way, words, theme",
    [
        ("served", "", "light"),
        *thorough(
            ("served", "", "dark"), ("static", "?embedded=small", "dark"), ("static", "", "light")
        ),
    ],
)  # fmt: skip
def test_the_lab_is_accessible(chrome, request, way, words, theme):
    address = request.getfixturevalue(way) + words
    with opened(chrome, address, bypass_csp=True, color_scheme=theme) as (page, _):
        page.get_by_role("button", name="Hand over").click()
        wait(page, "lab.goals && !lab.running")
        assert violations(page) == []
