"""The lab as it opens: links, loading, widths and access."""

import pytest

pytest.importorskip("starlette", reason="starlette is not installed")

from helpers.browsed import load_anew, opened, violations, wait

WIDTHS = {"laptop": (1280, 800), "tablet": (820, 1100), "phone": (390, 780)}


@pytest.mark.parametrize(
    "change, agent, said",
    [
        (("agent=maze-corner", "agent=foo"), "", "The agent 'foo' is not in this lab; no agent"),
        (("agent=maze-corner", "agent=constructor"), "", "'constructor' is not in this lab; no"),
        (("agent=maze-corner", "agent=coin-end"), "", "'coin-end' plays coinrun, not maze"),
        (("game=maze", "game=chess"), "", "This lab has no game 'chess'."),
        (("game=maze&", ""), "", "This lab has no game ''."),
        (("level=17", "level="), "maze-corner", "from 0 to 2147483646; the link has ''"),
        (("variant=anywhere-small", "variant=nope"), "maze-corner", "no variant 'nope' of maze"),
        (("level=17", "level=abc"), "maze-corner", "from 0 to 2147483646; the link has 'abc'"),
        (("agent=maze-corner", "agent="), "", ""),
    ],
)
def test_a_link_that_cannot_be_opened_says_so_and_shows_no_other_agent(
    window, served, change, agent, said
):
    link = f"{served}#game=maze&variant=anywhere-small&agent=maze-corner&level=17"
    page = load_anew(window, link.replace(*change), ready="lab.level")
    assert page.evaluate("lab.agent") == agent and not window[1]
    problem = page.locator("[data-lab=problem]")
    assert problem.is_visible() == bool(said) and said in problem.text_content()


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


@pytest.mark.parametrize(
    "width, theme",
    [
        *((width, "light") for width in WIDTHS),
        ("laptop", "dark"),
        *(pytest.param(width, "dark", marks=pytest.mark.thorough) for width in ("tablet", "phone")),
    ],
)
def test_nothing_is_wider_than_the_page(window, served, width, theme):
    columns, rows = WIDTHS[width]
    window[0].set_viewport_size({"width": columns, "height": rows})
    window[0].emulate_media(color_scheme=theme)
    page = load_anew(window, served)
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") <= columns
    background = page.evaluate("getComputedStyle(lab.root).backgroundColor")
    assert (sum(map(int, background[4:-1].split(","))) < 200) == (theme == "dark")
    assert not window[1]


@pytest.mark.parametrize(
    "way, words, theme",
    [
        ("served", "", "light"), ("served", "", "dark"), ("static", "?embedded=small", "dark"),
        pytest.param("static", "", "light", marks=pytest.mark.thorough),  # the page that is served
    ],
)  # fmt: skip
def test_the_lab_is_accessible(chrome, request, way, words, theme):
    address = request.getfixturevalue(way) + words
    with opened(chrome, address, bypass_csp=True, color_scheme=theme) as (page, _):
        page.get_by_role("button", name="Hand over").click()
        wait(page, "lab.goals && !lab.running")
        assert violations(page) == []
