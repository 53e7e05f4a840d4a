"""The report of an experiment: one self-contained HTML file."""

import base64
import hashlib
import json
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import polars as pl
from markupsafe import Markup, escape

from astray.analysis.pages import templates
from astray.analysis.tables import write_table
from astray.files import read, remove_left, write_aside
from astray.report.findings import Code, Findings, Heading, Plot, Scene, Section
from astray.validation import printable, shown

WRITTEN = ("report.html", "findings.json", "figures", "tables")  # to a report's folder
INDEX, INDEX_SIGN = "index.html", b"<title>What agents pursue</title>"  # the latter is in it
COMPUTED = "computed"  # the folder of a report's tables, which are made once
FOLDERS = ("figures", "tables", COMPUTED)
MEDIA = {".png": "image/png", ".svg": "image/svg+xml", ".mp4": "video/mp4"}
NOTHING = "—"
MEAN = ("mean", "low", "high")
ONE = 1 + 1e-9  # a rate, whose sums are rounded
UNTOLD = ("rows", "freedom")  # of tables: what intervals were computed with
PERCENT = re.compile(r"<(code|script)\b.*?</\1>|(?<=\d) (?=%)", re.DOTALL)  # a space only in texts
WHOLE = re.compile(r"(?<![\w-])(?:--?\w[\w-]*|\w+(?:-\w+)+)")  # an option, a name with dashes


def write(
    heading: Heading,
    findings: Findings,
    folder: Path,
    beside: Mapping[str, str] | None = None,
    links: Mapping[Scene, str] | None = None,
) -> Path:
    """Write tables, figures and the self-contained `report.html` to `folder`; return its path.

    Args:
        beside: Results of other agents' report for some claims, from `of_claims`.
        links: Links from the report's folder to scenes of videos in a lab.
    """
    for plot in findings.plots:
        if plot.data is not None:
            write_table(plot.data, folder / "figures" / f"{plot.name}.parquet")
    for table in findings.tables:
        for ending in ("csv", "parquet"):
            write_table(table.frame, folder / "tables" / f"{table.name}.{ending}")
    beside = beside or {}
    claims = [asdict(c) | {"beside": beside.get(c.sentence)} for c in findings.claims]
    found = {"answer": findings.answer, "claims": claims}
    write_aside(folder / "findings.json", json.dumps(asdict(heading) | found, indent=2).encode())
    repeat = [Code(heading.command), findings.settings]
    sections = [
        Section("Claims", [findings.claims] if findings.claims else []),
        Section("What it looks like", findings.videos),
        Section("Figures", findings.plots),
        Section("Numbers", findings.tables),
        Section("How to repeat it", repeat),
    ]
    write_page(
        folder / "report.html", f"{heading.title} ({heading.name})", sections,
        figures=folder / "figures", heading=heading, answer=findings.answer, beside=beside,
        links=links or {},
    )  # fmt: skip
    for place in filter(Path.is_dir, (folder, *(folder / name for name in FOLDERS))):
        remove_left(place, [path.name for path in place.iterdir()])  # of one that was killed
    return folder / "report.html"


def write_page(
    path: Path, title: str, sections: Sequence[Section], *, figures: Path, **how: Any
) -> None:
    """Write the figures of a page and the self-contained page; empty sections are left out.

    Args:
        how: Further variables of the template: `heading` and `answer` of a study, `beside` and
            `links` as in `write`, `sign` of the writer, and `lab`, the command that opens a lab.
    """
    from astray.figures.style import save  # here, as matplotlib takes a second to import

    for plot in (item for one in sections for item in one.items if isinstance(item, Plot)):
        save(plot.figure, figures, plot.name)
    usual = {"heading": None, "answer": "", "beside": {}, "links": {}, "sign": "", "lab": ""}
    page = _render(
        "page.html", title=title, sections=[s for s in sections if s.items], figures=figures,
        **usual | how,
    )  # fmt: skip
    write_aside(path, page.encode())


def of_claims(folder: Path) -> dict[str, str]:
    """Return the result of each claim in a folder's report; empty without a report.

    Raises:
        ValueError: If its findings cannot be read.
    """
    path = folder / "findings.json"
    if not path.exists():
        return {}
    said = {True: "supported", False: "not supported"}
    return {
        claim["sentence"]: f"{claim['ours']} ({said[bool(claim['supported'])]})"
        for claim in _findings(path)["claims"]
    }


def write_index(folder: Path) -> Path:
    """Write `index.html` with links to all reports in subfolders; return its path.

    Reports with unreadable findings are left out, with a note.
    """
    found = []
    for path in sorted(folder.glob("*/findings.json")):
        try:
            found.append(_findings(path) | {"folder": path.parent.name})
        except (ValueError, OSError) as error:  # of an older report, which hides no newer one
            print(printable(f"left out of the index: {error}"), file=sys.stderr, flush=True)
    write_aside(folder / INDEX, _render(INDEX, reports=found).encode())
    return folder / INDEX


def _findings(path: Path) -> dict[str, Any]:
    """Return the contents of findings.json; raise ValueError if `write` did not write it."""
    try:
        found = json.loads(read(path))
        json.dumps([found, f"{path}"], ensure_ascii=False).encode()  # or it can be on no page
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    kinds = dict.fromkeys(("answer", *(f.name for f in fields(Heading))), str)
    claims = found.get("claims") if isinstance(found, dict) else None
    of_claim = {"sentence": str, "ours": str, "supported": bool}
    are_claims = isinstance(claims, list) and all(_has(claim, of_claim) for claim in claims)
    if not (_has(found, kinds) and are_claims):
        raise ValueError(f"{path} must be the findings of a report; got {shown(found)}")
    return found


def _has(given: Any, kinds: Mapping[str, type]) -> bool:
    """Return whether data are an object with these kinds of values by name."""
    return isinstance(given, dict) and all(type(given.get(n)) is kind for n, kind in kinds.items())


def _render(template: str, **what: Any) -> str:
    from astray.figures.hover import points

    environment = templates("astray.report")
    kind = {"kind": lambda item: type(item).__name__}
    more = {"embedded": embedded, "laid_out": laid_out, "points": points}
    environment.filters |= more | kind | {"code": code, "coded": coded}
    script = files("astray.report").joinpath("hover.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page = environment.get_template(template).render(script=Markup(script), digest=digest, **what)
    return with_percent(page)


def with_percent(page: str) -> str:
    """Return a page in HTML in whose texts no line ends between a number and its percent sign."""
    return PERCENT.sub(lambda found: found[0] if found[1] else "\u00a0", page)


def coded(text: str) -> Markup:
    """Escape text for HTML, with parts between backticks as code; no line ends within 1e-9."""
    whole = re.sub(r"[\d.]+e-\d+", r'<span class="short">\g<0></span>', str(escape(text)))
    return Markup(re.sub("`([^`]+)`", lambda part: code(Markup(part[1])), whole))


def code(text: str) -> Markup:
    """Return escaped code, in which no line ends within an option or a name with dashes."""
    return Markup("<code>" + WHOLE.sub(r"<span>\g<0></span>", str(escape(text))) + "</code>")


def embedded(path: Path) -> str:
    """Return a figure or video as a data URI; raise ValueError for another type.

    Figures in SVG follow a dark theme.
    """
    if path.suffix not in MEDIA:
        raise ValueError(f"{path.name} cannot be shown; {', '.join(MEDIA)} can")
    data = read(path)
    if path.suffix == ".svg":
        from astray.figures.style import themed

        data = themed(data.decode()).encode()
    return f"data:{MEDIA[path.suffix]};base64,{base64.b64encode(data).decode()}"


def laid_out(frame: pl.DataFrame) -> tuple[dict[str, tuple[bool, list[str]]], str]:
    """Return a table as it is shown, and a note on it.

    Intervals are next to their means, and rates of outcomes, which are at most 1, side by side in
    percent. With scripts, agents are named as policies. Constant columns are in the note, except
    yes and no, which are findings. Empty columns, and those that intervals were computed from, are
    left out.

    Returns:
        For each column its heading, whether it is numeric, and its cells as text.
    """
    if {"agent", "policy"} <= {*frame.columns} and frame["agent"].has_nulls():  # of scripts
        frame = frame.with_columns(pl.coalesce("agent", "policy").alias("policy")).drop("agent")
    means = frame["mean"].cast(pl.Float64).fill_nan(None) if "mean" in frame.columns else None
    rates = means is not None and "outcome" in frame.columns and means.abs().le(ONE).all()
    if rates:
        frame = frame.with_columns(pl.col(name for name in MEAN if name in frame.columns) * 100)
    measures = dict(_means(frame))
    for name, ends in measures.items():
        frame = frame.with_columns(_with_interval(frame, name, ends)).drop(*ends)
    frame = frame.drop(UNTOLD, strict=False)
    frame = _side_by_side(frame) if rates else frame
    shown, same = {}, []
    for column in frame.iter_columns():
        name, text = column.name.replace("_", " "), cells(column)
        measured = column.name in measures or name.endswith(", %")
        if {*text} == {NOTHING}:
            continue
        found = measured or column.dtype == pl.Boolean
        if len(text) > 1 and len({*text}) == 1 and not found:
            same.append(_said(name, text[0], column.dtype))
        else:
            shown[name] = measured or column.dtype.is_numeric(), text
    notes = ["95\u00a0% intervals are in brackets."] * bool(measures)
    notes += [f"In every row: {', '.join(same)}."] * bool(same)
    return shown, " ".join(notes)


def _said(name: str, value: str, kind: pl.DataType) -> str:
    """Return a column's one value in words, as "97 levels", "size 25" or "test “training”"."""
    if kind.is_integer() and name.endswith("s"):
        return f"{value} {name if value != '1' else name[:-1]}"
    return f"{name} {value}" if kind.is_numeric() else f"{name} “{value}”"


def _means(frame: pl.DataFrame) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the columns that have intervals, with the columns of their ends."""
    for before, name in pairwise(["", *frame.columns]):
        if name == "low" and "high" in frame.columns and frame.schema[before].is_numeric():
            yield before, ("low", "high")
        for mark in (" ", ", "):
            ends = f"{name}{mark}low", f"{name}{mark}high"
            if {*ends} <= {*frame.columns}:
                yield name, ends


def _with_interval(frame: pl.DataFrame, name: str, ends: tuple[str, str]) -> pl.Series:
    count = len(frame)
    text = cells(pl.concat([frame[one].cast(pl.Float64).alias("") for one in (name, *ends)]))
    told = zip(text[:count], text[count : 2 * count], text[2 * count :], strict=True)
    both = [f"{mean} ({a} to {b})" if NOTHING not in (a, b) else mean for mean, a, b in told]
    return pl.Series(name, both, dtype=pl.String)


def _side_by_side(frame: pl.DataFrame) -> pl.DataFrame:
    """Return the table with a column for each outcome, where the other columns are equal."""
    names = frame["outcome"].unique(maintain_order=True).to_list()
    rest = [name for name in frame.columns if name not in ("outcome", "mean")]
    if not rest or frame.select(*rest).unique().height * len(names) != frame.height:
        return frame
    wide = frame.pivot("outcome", index=rest, values="mean", maintain_order=True)
    return wide.rename({name: f"{name}, %" for name in names})


def cells(column: pl.Series) -> list[str]:
    """Format a column as text; reals get equally many decimals, four digits for the largest."""
    if column.dtype.is_float():
        real = [value for value in column if value is not None and math.isfinite(value)]
        largest = max((abs(value) for value in real), default=0.0)
        digits = math.floor(math.log10(largest)) if largest else 0
        form = f",.{min(3, max(0, 3 - digits))}f" if digits > -2 else ".3g"
        known = column.fill_nan(None)
        return [NOTHING if value is None else format(value, form) for value in known]
    return [_text(value) for value in column]


def _text(value: Any) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else str(value)
