"""Links: in the repository they lead to its files, on the site to the pages made of these.

A hook of MkDocs. So one Markdown is right in both places, and no page of the site leads nowhere.
"""

from __future__ import annotations

import html
import os
import re
from pathlib import Path
from urllib.parse import unquote

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

from astray.report import page as report

ROOT = Path(__file__).parents[1]
MADE = {  # pages of the site that are made of files elsewhere in the repository
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "benchmarks/README.md": "speed.md",
    "src/astray/agents/pretrained/README.md": "agents/index.md",
}
LINK = re.compile(r"(?<!!)\[([^\[\]]+)\]\((?!\w+:)([^)\s#]+)(#[^)\s]*)?\)")
STUDY = re.compile(r"src/astray/experiments/studies/\w+/([a-z]\w*)\.py")
PICTURE = re.compile(r"(!\[[^\]]*\]\()(?!\w+:)([^)\s]+)\)")
HREF = re.compile(r'<a\b[^>]*?\bhref="([^"]+)"')
# In the theme's navigation, the list of a section that has a page: its title, and its name.
SECTION = re.compile(
    r'(<span class="md-ellipsis">\s*([^<]*?)\s*</span>\s*</a>\s*<label\b[^>]*>.*?</label>'
    r'\s*</div>\s*<nav [^>]*)aria-labelledby="\w+"',
    re.DOTALL,
)
# In its table of contents, the list below a heading: a landmark, by a name that others may have.
CONTENTS = re.compile(r'(<nav class="md-nav") aria-label="[^"]*">')
SEARCH = 'data-md-component="search" role="dialog"'
PLAIN_TABLE = re.compile(r"<table>(?=(?:(?!</table>|<a\b).)*</table>)", re.DOTALL)
PICTURE_ALONE = re.compile(r'<p>(?=<img [^>]*src="(?:figure-|lab-|first-|outcomes)[^>]*></p>)')
DATE = re.compile(r"<td>(?=\d{4}-\d\d-\d\d</td>)")
CODE = re.compile(r"<code\b.*?</code>", re.DOTALL)
# An option, a name with dashes or an extra, in a text and not in a tag.
WHOLE = re.compile(rf"(?:{report.WHOLE.pattern}|\.\[[\w,]+\])(?![^<]*>)")
# The spaces of an interval in a text, such as (1.0 to 2.0), and not in code.
INTERVAL = re.compile(r"<code\b.*?</code>|\(-?[\d.,]+ to -?[\d.]+(?:, n = [\d,]+)?\)", re.DOTALL)
NAMED = re.compile(r'\b(?:id|name)="([^"]+)"')


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links of a page that somebody wrote lead to other pages."""
    made = page.file.generated_by is not None
    return markdown if made else for_site(markdown, Path(config.docs_dir).name)


def on_post_page(output: str, *, page: Page, config: MkDocsConfig) -> str:
    """Make a page one for screen readers and keyboards."""
    del page, config
    return accessible(output)


def on_post_template(output: str, *, template_name: str, config: MkDocsConfig) -> str:
    """Make the page for what is not there accessible, too; other templates are no pages."""
    del config
    return accessible(output) if template_name.endswith(".html") else output


def accessible(output: str) -> str:
    """Return a page of the theme whose search and sections have names.

    No landmark has another's name, no header of a table is empty, and figures and tables without
    links can be reached, to be scrolled. No line ends within an option, a name with dashes in code,
    a date in a table, an interval, or before a percent sign.
    """
    output = CODE.sub(
        lambda m: WHOLE.sub(r'<span class="whole">\g<0></span>', m[0]), report.with_percent(output)
    )
    output = INTERVAL.sub(
        lambda m: m[0] if m[0].startswith("<") else m[0].replace(" ", "\u00a0"), output
    )
    output = DATE.sub('<td class="whole">', output)
    output = SECTION.sub(r'\1aria-label="\2"', output).replace("<th></th>", "<td></td>")
    output = CONTENTS.sub(r'\1 role="presentation">', output)
    output = PICTURE_ALONE.sub('<p class="picture" tabindex="0">', output)
    return PLAIN_TABLE.sub('<table tabindex="0">', output).replace(
        SEARCH, f'{SEARCH} aria-label="search"'
    )


def on_post_build(config: MkDocsConfig) -> None:
    """See that every link of every page leads to something that is there."""
    site = Path(config.site_dir)
    texts = {path: path.read_text() for path in site.rglob("*.html")}
    names = {path: set(map(html.unescape, NAMED.findall(text))) for path, text in texts.items()}
    lab = site / "lab"  # which has a page's state behind the #
    for path, text in texts.items():
        for address in set(HREF.findall(text)):
            name, _, anchor = unquote(html.unescape(address)).partition("#")
            if re.match(r"\w+:|//|/|\.$", name) or path.name == "404.html" or lab in path.parents:
                continue
            there = Path(os.path.normpath(path.parent / name.partition("?")[0])) if name else path
            known = anchor in names.get(there, ()) or lab in there.parents
            if not there.exists() or (anchor and there.suffix == ".html" and not known):
                page = path.relative_to(site)
                raise PluginError(f"{page} leads to {address}, which is not there")


def for_site(text: str, folder: str) -> str:
    """A text of a folder of the repository with the site's links; words where there is no page."""

    def moved(match: re.Match) -> str:
        words, path, anchor = match[1], os.path.normpath(Path(folder, match[2])), match[3] or ""
        if path.startswith("docs/"):
            return f"[{words}]({path.removeprefix('docs/')}{anchor})"
        if not (ROOT / path).exists():
            raise PluginError(f"{folder}: a link leads to {match[2]}, which is not there")
        page = page_of(path)
        return f"[{words}]({page}{anchor if '#' not in page else ''})" if page else words

    def pictured(match: re.Match) -> str:
        return f"{match[1]}{os.path.relpath(Path(folder, match[2]), 'docs')})"

    return LINK.sub(moved, PICTURE.sub(pictured, text))


def page_of(path: str) -> str:
    """The page that is made of a file of the repository; empty where there is none."""
    readme = f"{path}/README.md"
    if page := MADE.get(path) or MADE.get(readme):
        return page
    if study := STUDY.fullmatch(path):
        return f"experiments/{study[1].replace('_', '-')}.md"
    if path.startswith("src/astray/") and (ROOT / path).suffix in ("", ".py"):
        module = path.removeprefix("src/").removesuffix(".py").replace("/", ".")
        return f"{api_page(module)}#{module}"
    return ""


def api_page(module: str) -> str:
    """The page that a module is told on."""
    parts = module.split(".")
    package = (ROOT / "src" / "/".join(parts[:2])).is_dir() and len(parts) > 1
    return f"api/{parts[1]}.md" if package else "api/index.md"
