"""Write the register of claims on its page, below its introduction: python docs/register.py.

It has bounds, when these were set, what was measured, and the power of the plans. `register.toml`
has the claims, from the repository's history. Tests run reports in miniature and find unregistered
claims. Power is computed from the plans. With a folder of reports (python docs/register.py
reports), what these measured is first added to `register.json`.
"""

import json
import math
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from astray.experiments import catalogue
from astray.experiments.spec import SPREADS, Plan, Size
from astray.files import write_aside
from astray.report.page import of_claims

OPEN = "…"  # in a sentence or rule, for what depends on the size or on what was measured
RULE = re.compile(r"; supported if (.*?)(?=;|, which is not enough|$)")
PAGE = Path(__file__).with_suffix(".md")


def register() -> dict[str, dict[str, Any]]:
    """Return the entries of each study: its claims and their history."""
    return tomllib.loads(PAGE.with_suffix(".toml").read_text("utf-8"))


def measured() -> dict[str, dict[Size, dict[str, Any]]]:
    """Return when each size of a study was run, and what its report said of each claim."""
    return json.loads(PAGE.with_suffix(".json").read_text("utf-8"))


def add(reports: Path) -> None:
    """Add what the reports in a folder said to `register.json`."""
    found: Any = measured()
    for name in register():
        for size in catalogue.load(name).sizes:
            folder = reports / f"{name}-{size}"
            if said := of_claims(folder):
                ran = date.fromtimestamp((folder / "findings.json").stat().st_mtime)
                found.setdefault(name, {})[size] = {"run": f"{ran}", "claims": said}
    text = json.dumps(found, indent=1, sort_keys=True, ensure_ascii=False)
    write_aside(PAGE.with_suffix(".json"), f"{text}\n".encode())


def fits(pattern: str, text: str) -> re.Match[str] | None:
    """Match a text with one of the register, whose `OPEN` places may be anything."""
    return re.fullmatch("(.*)".join(map(re.escape, pattern.split(OPEN))), text)


def rule_of(ours: str) -> str:
    """Return the rule by which a claim is supported, from its report; "" if there is none."""
    return " and ".join(dict.fromkeys(RULE.findall(ours))).replace("\u00a0", " ")


def page() -> str:
    """Return the page: its introduction as it is, and the register of today."""
    about, _, _ = PAGE.read_text("utf-8").partition("## ")
    lines = [*about.splitlines()]
    for name, study in sorted(register().items()):
        whole = catalogue.load(name)
        lines += [f"## `{name}`: {whole.title}", "", _about(study, whole.sizes), ""]
        lines += [f"- {change}" for change in study.get("changes", [])]
        lines += [""] if study.get("changes") else []
        claims = [one | {"said": _said(name, one)} for one in study["claims"]]
        lines += [*_claims(claims), "", *_plans(name, whole.sizes), ""]
    return "\n".join(lines).rstrip() + "\n"


def _about(study: Mapping[str, Any], sizes: Mapping[Size, Plan]) -> str:
    when = {
        "yes": "Bounds were set before any run.",
        "no": "Bounds were set after a first agent had been looked at.",
        "not recorded": "Whether bounds were set before any run was not written down.",
    }[study["before"]]
    if study.get("changes"):
        looked = f"{when} The design was changed after a first look"
        if all(plan.first_seed for plan in sizes.values()):
            return f"{looked} at other seeds:"
        return f"*Exploratory.* {looked}:"
    return when if study["before"] == "yes" else f"*Exploratory.* {when}"


def _claims(claims: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Return the lines of a table of claims; a column without entries is left out."""
    columns = {"claim": "sentence", "supported if": "rule", "set": "set"}
    further = {"measured": "said", "note": "note"}
    columns |= {head: key for head, key in further.items() if any(one.get(key) for one in claims)}
    yield f"| {' | '.join(columns)} |"
    yield f"|{' --- |' * len(columns)}"
    for one in claims:
        said = {**one, "rule": one["rule"] or "see the report"}
        yield f"| {' | '.join(said.get(key, '') for key in columns.values())} |"


def _said(study: str, claim: Mapping[str, Any]) -> str:
    """Return what the reports of a study's sizes say of a claim, without its rule.

    A report that has another rule of the same sentence says nothing of it.
    """
    found = []
    for size, report in measured().get(study, {}).items():
        for of, ours in report["claims"].items():
            said, verdict = ours.replace("\u00a0", " ").removesuffix(")").rsplit(" (", 1)
            its = fits(claim["sentence"], of.replace("\u00a0", " "))
            if its and fits(claim["rule"], rule_of(said)):
                said = RULE.sub("", said).replace("95 % interval ", "").replace("|", "\\|")
                found.append(": ".join([f"`{size}`, {verdict}", *filter(None, its.groups()), said]))
    return "<br>".join(found)


def _plans(study: str, sizes: Mapping[Size, Plan]) -> Iterator[str]:
    """Return the lines of a table of each size: seeds, when it was run, and power."""
    heads = [
        f"{what}, {_points(spread)}" for what in ("fraction", "difference") for spread in SPREADS
    ]
    yield f"| size | seeds | run | {' | '.join(heads)} |"
    yield f"| --- | --- | --- |{' ---: |' * len(heads)}"
    for size, plan in sizes.items():
        first, last = plan.first_seed, plan.first_seed + plan.seeds - 1
        trained = f"{first} to {last}" if last > first else f"{first}"
        seeds = "none" if plan.published or not plan.agents else trained
        ran = measured().get(study, {}).get(size, {}).get("run", "")
        yield f"| `{size}` | {seeds} | {ran} | {' | '.join(map(_points, plan.power()))} |"


def _points(rate: float) -> str:
    if math.isnan(rate):
        return ""
    return "none" if math.isinf(rate) else f"{100 * rate:.0f} points"


if __name__ == "__main__":
    for folder in map(Path, sys.argv[1:]):
        add(folder)
    write_aside(PAGE, page().encode())
