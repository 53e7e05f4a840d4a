"""The report of an experiment: one self-contained HTML file."""

from __future__ import annotations

import base64
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import polars as pl

from astray.analysis.pages import templates
from astray.analysis.tables import write_table
from astray.bounds import renamed, shown
from astray.files import read, remove_left, write_aside
from astray.report.findings import Code, Findings, Heading, Scene, Section

WRITTEN = ("report.html", "findings.json", "figures", "tables")  # to a report's folder
COMPUTED = "computed"  # the folder of a report's tables, which are made once
FOLDERS = ("figures", "tables", COMPUTED)
MEDIA = {".png": "image/png", ".mp4": "video/mp4"}
NOTHING = "—"


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
    from astray.figures.style import save  # here, as matplotlib takes a second to import

    for plot in findings.plots:
        save(plot.figure, folder / "figures", plot.name)
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
    """Write a self-contained page; empty sections are left out.

    Args:
        path: The page.
        title: Its title.
        sections: What is on it.
        figures: The folder of the figures, which are written already.
        how: What else the template takes: `heading` and `answer` of a study, `beside` and `links`
            as in `write`; `sign` of what writes it.
    """
    usual = {"heading": None, "answer": "", "beside": {}, "links": {}, "sign": ""}
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
            print(f"left out of the index: {error}", file=sys.stderr, flush=True)
    write_aside(folder / "index.html", _render("index.html", reports=found).encode())
    return folder / "index.html"


def _findings(path: Path) -> dict[str, Any]:
    """Return the contents of findings.json; raise ValueError if `write` did not write it."""
    try:
        found = json.loads(read(path))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is no JSON: {error}") from error
    names = ("claims", "answer", *(f.name for f in fields(Heading)))
    missing = [name for name in names if not isinstance(found, dict) or name not in found]
    claims = [] if missing else found["claims"]
    if isinstance(claims, list):
        claims = [renamed(claim, {"held": "supported"}, str(path)) for claim in claims]
    if missing or not isinstance(claims, list) or not all(map(_is_claim, claims)):
        raise ValueError(f"{path} must be the findings of a report; got {shown(found)}")
    return found | {"claims": claims}


def _is_claim(given: Any) -> bool:
    return isinstance(given, dict) and all(
        name in given for name in ("sentence", "ours", "supported")
    )


def _render(template: str, **what: Any) -> str:
    environment = templates("astray.report")
    kind = {"kind": lambda item: type(item).__name__}
    environment.filters |= {"embedded": embedded, "columns": columns} | kind
    return environment.get_template(template).render(**what)


def embedded(path: Path) -> str:
    """Return a figure or video as a data URI; raise ValueError for another type."""
    if path.suffix not in MEDIA:
        raise ValueError(f"{path.name} cannot be shown; {', '.join(MEDIA)} can")
    return f"data:{MEDIA[path.suffix]};base64,{base64.b64encode(read(path)).decode()}"


def columns(frame: pl.DataFrame) -> dict[str, tuple[bool, list[str]]]:
    """Return for each column its heading, whether it is numeric, and its cells as text."""
    return {
        column.name.replace("_", " "): (column.dtype.is_numeric(), cells(column))
        for column in frame.iter_columns()
    }


def cells(column: pl.Series) -> list[str]:
    """Format a column; its reals have equally many places, four digits for the largest."""
    if column.dtype.is_float():
        real = [value for value in column if value is not None and math.isfinite(value)]
        largest = max((abs(value) for value in real), default=0.0)
        digits = math.floor(math.log10(largest)) if largest else 0
        form = f",.{min(3, max(0, 3 - digits))}f" if digits > -2 else ".3g"
        return [NOTHING if _missing(value) else format(value, form) for value in column]
    return [_text(value) for value in column]


def _missing(value: float | None) -> bool:
    return value is None or math.isnan(value)


def _text(value: Any) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else str(value)
