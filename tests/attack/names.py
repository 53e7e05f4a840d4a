"""Class 6: hostile words in reports, cards, tables, pages and terminals."""

from __future__ import annotations

import base64
import functools
import hashlib
import os
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

from attack.core import Attempt, Place, Told, Wrong

HOSTILE = {
    "a script": "<script>alert(1)</script>", "an image": '<img src=x onerror="alert(1)">',
    "an end of the title": "</title><script>alert(1)</script>",
    "an address of a script": "javascript:alert(1)", "an attribute": '" onmouseover="alert(1)',
    "an end of the style": "</style><script>alert(1)</script>", "a template": "{{ 7 * 191 }}",
    "a block": "{% include '/etc/passwd' %}", "a comment": "--><script>alert(1)</script><!--",
    "a formula": "=cmd|' /C calc'!A0", "a row": "a | b |\n| --- | --- |\n| evil", "a NUL": "a\0b",
    "a terminal's": "\x1b]0;evil\x07\x1b[2J", "right to left": "\u202egnp.exe",
    "half a character": "\udc80", "markup": "[bold]x[/] [link=http://e]y[/link] [/nothing]",
    "an entity": "&lt;script&gt;alert(1)", "a frame": "<iframe src=//evil></iframe>",
    "a base": "<base href=//evil><meta http-equiv=refresh content=0>", "words": "x" * 100_000,
}  # fmt: skip
EVENTS = ("iframe", "object", "embed", "base", "form")


def attempts() -> Iterator[Attempt]:
    for name, text in HOSTILE.items():
        for where, act in WHERE.items():
            done = functools.partial(act, text)
            yield Attempt(6, f"{where}: {name}", done, "any", seconds=40, leaves=True)


class _Page(HTMLParser):
    """Looks for what could run in a page, or be loaded by it."""

    def __init__(self) -> None:
        super().__init__()
        self.policies: list[str] = []
        self.title: list[str] = []
        self.scripts: list[str] = []
        self.last = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.last = tag
        told = dict(attrs)
        if tag == "script":
            self.scripts.append("" if not told else f"{told}")
        if tag in EVENTS:
            raise Wrong(f"the page has a {tag}")
        if found := [name for name in told if name.startswith("on")]:
            raise Wrong(f"the page has an attribute {found[0]}")
        for name in ("href", "src", "action"):
            address = (told.get(name) or "").strip().lower()
            if address.startswith(("javascript:", "vbscript:", "http:", "//", "data:text")):
                raise Wrong(f"the page leads to {address[:30]}")
        if tag == "meta" and (told.get("http-equiv") or "").lower() == "refresh":
            raise Wrong("the page leads elsewhere by itself")
        if tag == "meta" and (told.get("http-equiv") or "") == "Content-Security-Policy":
            self.policies.append(told.get("content") or "")

    def handle_data(self, data: str) -> None:
        if self.last == "script" and self.scripts:
            self.scripts[-1] += data

    def handle_endtag(self, tag: str) -> None:
        self.last = ""


def check_page(path: Path) -> None:
    """See that a page runs nothing but its own script, whatever the words in it."""
    text = path.read_text(encoding="utf-8", errors="surrogatepass")
    page = _Page()
    page.feed(text)
    if len(page.policies) != 1 or "default-src 'none'" not in page.policies[0]:
        raise Wrong(f"the page's policies are {page.policies}")
    own = files("astray.report").joinpath("hover.js").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
    if page.scripts not in ([], [own]):
        raise Wrong(f"the page has scripts: {page.scripts}")
    allowed = [part.strip() for part in page.policies[0].split(";") if "script-src" in part]
    if "unsafe-eval" in page.policies[0] or allowed not in ([], [f"script-src 'sha256-{digest}'"]):
        raise Wrong(f"the page's policy is {page.policies[0]}")
    if "{{ 7" not in text and "1337" in text:
        raise Wrong("a template in the words was run")


def _page(text: str, place: Place) -> None:
    """A report all of whose words are hostile, and the index of it."""
    import polars as pl
    from matplotlib.figure import Figure

    from astray.report import page as report
    from astray.report.claims import Claim
    from astray.report.findings import Findings, Heading, Plot, Table

    words = (text,) * 7
    folder = place.work / "reports" / "one"
    findings = Findings(
        answer=text,
        claims=[Claim(text, text, text, False, text)],
        plots=[Plot("plot", text, Figure(), pl.DataFrame({"a": [text]}))],
        tables=[Table("table", text, pl.DataFrame({text: [text]}))],
        settings={text: text},
    )
    page = report.write(Heading(**dict(zip(
        ("name", "size", "title", "reproduces", "question", "differences", "command"), words,
        strict=True))), findings, folder, {text: text})  # fmt: skip
    check_page(page)
    check_page(report.write_index(place.work / "reports"))


def _index(text: str, place: Place) -> None:
    """An index of reports in a folder by that name."""
    from astray.report import page as report

    name = text.replace("/", "\u2215").replace("\0", "")[:80]
    there = place.work / "reports" / name
    there.mkdir(parents=True)
    source = place.made / "reports" / "experiment-smoke" / "findings.json"
    (there / "findings.json").write_bytes(source.read_bytes())
    page = report.write_index(place.work / "reports")
    check_page(page)
    if "../" in page.read_text(errors="surrogatepass"):
        raise Wrong("the index leads out of its folder")


def _imported(text: str, place: Place) -> Any:
    """An agent's card, of hostile words on the command line."""
    os.environ["ASTRAY_AGENTS"] = str(place.work / "agents")
    place.copy("agent.pth")
    told = place.astray(
        "import",
        "agent.pth",
        "--as",
        "mine",
        "--game",
        "maze",
        "--variant",
        "anywhere",
        "--art",
        "own",
        f"--source={text}",
        f"--licence={text}",
    )
    if told.code == 0:
        card = (place.work / "agents" / "mine" / "README.md").read_text(errors="surrogatepass")
        plain = card[: card.index("## Checked")].replace(text, "")
        rows = [line for line in card.splitlines() if line.startswith("| --- ")]
        if "\n" in text and len(rows) != plain.count("| --- | --- |"):
            raise Wrong("the words are a table of their own")
    return told


def _listed(text: str, place: Place) -> Told:
    """An imported agent in a folder by that name, listed and shown in a terminal."""
    name = text.replace("/", "\u2215").replace("\0", "")[:80]
    os.environ["ASTRAY_AGENTS"] = str(place.copy("agents"))
    (place.work / "agents" / "other").rename(place.work / "agents" / name)
    told = place.astray("list")
    if "\x1b]0;" in told.out or "\x07" in told.out:
        raise Wrong("a terminal is told what to do")
    second = place.astray("agents", "list")
    if "\x1b]0;" in second.out or "\x07" in second.out:
        raise Wrong("a terminal is told what to do")
    return told if told.code else second


def _refused(text: str, place: Place) -> Told:
    """The words in the errors of several commands."""
    place.watch()
    for given in (
        ("level", text, "corner"),
        ("level", "maze", text),
        ("evaluate", text),
        ("evaluate", "--agent", text),
        ("agents", "fetch", text),
    ):
        told = place.astray(*given)
        if "\x1b" in told.err or "\x07" in told.err or "\u202e" in told.err:
            raise Wrong(f"a terminal is told what to do, by {given[0]}")
        if told.code != 2:
            return told
    return told


def _figure(text: str, place: Place) -> None:
    """Words in figures, which their library reads as mathematics."""
    import polars as pl

    from astray.figures.style import save
    from astray.report.learning import learning_curves

    data = pl.DataFrame({"steps": [1, 2], "return": [0.0, 1.0], "seed": [0, 0]})
    drawn = learning_curves(data, {"return": text[:200] + "$x_{$"}, "return")
    save(drawn, place.work, "figure")


def _level(text: str, place: Place) -> Told:
    """Words as levels, drawn and as JSON, and as actions."""
    import json

    place.copy("actions.txt")
    place.mine("level.json", json.dumps({"grid": [[text]], "agent": text, "looks": {text: text}}))
    place.mine("level.txt", text.encode(errors="surrogatepass"))
    for name in ("level.json", "level.txt"):
        told = place.astray(
            "replay", "maze", "corner-small", "--level-file", name, "--actions", "actions.txt"
        )
        if told.code != 2 or "\x1b" in told.err:
            return told
    return told


WHERE: dict[str, Callable[[str, Place], Any]] = {
    "a report": _page, "a folder of a report": _index, "an agent's card": _imported,
    "a listed agent": _listed, "an error": _refused, "a figure": _figure, "a level": _level,
}  # fmt: skip
