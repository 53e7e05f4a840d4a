"""The site of the documentation: its theme, its styles and the hook of links, on some pages."""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from helpers.browsed import folder_served, violations, wait
from helpers.thorough import thorough

ROOT = Path(__file__).parents[1]
# A page with a figure; one with a wide table, and one with an empty header.
WRITTEN = ("insight", "published")
REFERENCE = (
    "# api\n## one\n### same\n#### a\n## two\n### same\n#### b\n\n```pycon\n>>> 100\n100\n```\n"
)
SECTIONS = ("agents", "api")  # which have pages, and so the theme gives their lists no names


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the first page, `WRITTEN` and `SECTIONS`; what is made from the code is not."""
    pytest.importorskip("mkdocs", reason="MkDocs is not installed")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(ROOT / "docs"), *sys.path])
        patch.setenv("NO_MKDOCS_2_WARNING", "1")
        pages, links = import_module("pages"), import_module("links")
        folder = tmp_path_factory.mktemp("site")
        docs = folder / "docs"
        docs.mkdir()
        (docs / "index.md").write_text(pages.with_lab(pages.from_root("README.md")))
        for name in (*(f"{name}.md" for name in WRITTEN), "style.css", "figure-insight.png"):
            (docs / name).write_bytes((ROOT / "docs" / name).read_bytes())
        for name in SECTIONS:
            (docs / name).mkdir()
            (docs / name / "index.md").write_text(REFERENCE)
            (docs / name / "another.md").write_text("# another")
        config = load_config(
            str(ROOT / "mkdocs.yml"),
            docs_dir=str(docs),
            site_dir=str(folder / "site"),
            hooks=[],
            plugins=["search"],
            nav=None,
        )
        for event in ("page_markdown", "page_content", "post_page", "post_template"):
            if hook := getattr(links, f"on_{event}", None):
                config.plugins._register_event(event, hook)
        build(config)
    return folder / "site"


def test_a_dead_link_fails_the_build_of_make_docs(tmp_path):
    pytest.importorskip("mkdocs", reason="MkDocs is not installed")
    (words,) = re.findall("/mkdocs (.*)", (ROOT / "Makefile").read_text())
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[a](nowhere.md)")
    (tmp_path / "mkdocs.yml").write_text("site_name: a")
    command = [sys.executable, "-m", "mkdocs", *words.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode and "nowhere.md" in done.stderr  # --quiet takes the links as good


def test_the_page_for_what_is_not_there_leads_back(site):
    (said,) = re.findall("<article.*?</article>", (site / "404.html").read_text(), re.DOTALL)
    (way,) = re.findall('<a href="/(.*?)">', said)
    assert (site / way) == site / "index.html"


@pytest.mark.parametrize(
    "page, width",
    [
        ("insight", 420),
        *thorough(("index", 1400), ("published", 1400), ("404", 420), ("api/index", 1400)),
    ],
)
def test_axe_finds_nothing_on_a_page_of_the_site(page, width, site, chrome):
    context = chrome.new_context(viewport={"width": width, "height": 900})
    shown = context.new_page()
    with folder_served(site) as address:  # the page for what is not there has no relative paths
        shown.goto(f"{address}{page}.html", wait_until="domcontentloaded")
        assert violations(shown) == []
    assert shown.evaluate("document.documentElement.scrollWidth") <= width
    context.close()


BROKEN = """(widths) => {
  const told = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [];
  while (told.nextNode()) {
    if (!told.currentNode.parentElement.closest("code")) continue;
    for (const { index, 0: name } of told.currentNode.data.matchAll(/-{0,2}\\w+(-\\w+)+|--\\w+/g)) {
      const range = new Range();
      range.setStart(told.currentNode, index);
      range.setEnd(told.currentNode, index + name.length);
      found.push([name, range]);
    }
  }
  return found.length && widths.flatMap((width) => {
    document.body.style.width = `${width}px`;
    return found.filter(([, range]) => range.getClientRects().length > 1).map(([name]) => name);
  });
}"""


def test_no_line_ends_within_an_option_or_a_name_with_dashes(site, chrome):
    context = chrome.new_context(viewport={"width": 420, "height": 900})
    shown = context.new_page()
    shown.goto((site / "published.html").as_uri())
    assert shown.evaluate(BROKEN, [*range(300, 421, 10)]) == []
    assert "91.6\u00a0%" in shown.inner_text("main"), "nor before a percent sign"
    assert "(96.1\u00a0to\u00a098.1)" in shown.inner_text("main"), "nor within an interval"
    context.close()


SHADES = """(one) => ["::before", "::after"].map((side) => getComputedStyle(one, side).opacity)"""


def test_a_figure_that_a_phone_cuts_has_a_shade_where_there_is_more(site, chrome):
    context = chrome.new_context(viewport={"width": 1400, "height": 900})
    shown = context.new_page()
    shown.goto((site / "insight.html").as_uri())
    figure = shown.locator(".picture")
    assert figure.evaluate(SHADES) == ["0", "0"]
    shown.set_viewport_size({"width": 420, "height": 900})
    wait(shown, f"String(({SHADES})(document.querySelector('.picture'))) === '0,1'")
    figure.evaluate("(one) => { one.scrollLeft = one.scrollWidth; }")
    wait(shown, f"String(({SHADES})(document.querySelector('.picture'))) === '1,0'")
    context.close()


# What has the focus, and whether it is seen, with a line around it.
FOCUSED = """() => {
  const { activeElement: at } = document;
  const one = at.matches(".md-option") ? at.nextElementSibling : at;
  const { left, top, width, height } = one.getBoundingClientRect();
  const there = document.elementFromPoint(left + width / 2, top + height / 2);
  const seen = getComputedStyle(one).outlineStyle !== "none" && one.contains(there);
  return at.closest(".md-content") ? null : [at.textContent.trim() || at.tagName, seen];
}"""


def test_on_a_phone_keys_open_the_drawer_for_its_links(site, chrome):
    context = chrome.new_context(viewport={"width": 420, "height": 900})
    shown = context.new_page()
    shown.goto((site / "published.html").as_uri())
    shown.add_style_tag(content="* { transition: none !important; }")
    found = []
    while shown.keyboard.press("Tab") or (one := shown.evaluate(FOCUSED)):
        found.append(one)
    assert len(found) > 6 and [name for name, seen in found if not seen] == []
    assert shown.locator(".md-sidebar--primary").bounding_box()["x"] < 0, "closed again"
    context.close()


def test_a_header_without_words_has_no_border(site, chrome):
    context = chrome.new_context()
    shown = context.new_page()
    shown.goto((site / "published.html").as_uri())
    widths = "(cells) => cells.map((one) => getComputedStyle(one).borderTopWidth)"
    assert {*shown.eval_on_selector_all("thead td", widths)} == {"0px"}
    context.close()
