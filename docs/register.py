"""Write the register of claims on its page, below its introduction: python docs/register.py.

It has bounds, when these were set, and the power of the plans. `register.toml` has the claims, from
the repository's history. Tests run reports in miniature and find unregistered claims. Power is
computed from the plans.
"""

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from astray.experiments import catalogue
from astray.experiments.spec import SPREADS, Plan, Size
from astray.files import write_aside

PAGE = Path(__file__).with_suffix(".md")


def register() -> dict[str, dict[str, Any]]:
    """Return the entries of each study: its claims and their history."""
    return tomllib.loads(PAGE.with_suffix(".toml").read_text("utf-8"))


def page() -> str:
    """Return the page: its introduction as it is, and the register of today."""
    about, _, _ = PAGE.read_text("utf-8").partition("## ")
    lines = [*about.splitlines()]
    for name, study in sorted(register().items()):
        whole = catalogue.load(name)
        lines += [f"## `{name}`: {whole.title}", "", _about(study, whole.sizes), ""]
        lines += [f"- {change}" for change in study.get("changes", [])]
        lines += [""] if study.get("changes") else []
        lines += [*_claims(study["claims"]), "", *_plans(whole.sizes), ""]
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
    """Return the lines of a table of claims, with a column of notes if there are any."""
    columns = {"claim": "sentence", "supported if": "rule", "set": "set"}
    if any("note" in one for one in claims):
        columns["note"] = "note"
    yield f"| {' | '.join(columns)} |"
    yield f"|{' --- |' * len(columns)}"
    for one in claims:
        said = {**one, "rule": one["rule"] or "see the report"}
        yield f"| {' | '.join(said.get(key, '') for key in columns.values())} |"


def _plans(sizes: Mapping[Size, Plan]) -> Iterator[str]:
    """Return the lines of a table of each size's power."""
    heads = [
        f"{what}, {_points(spread)}" for what in ("fraction", "difference") for spread in SPREADS
    ]
    yield f"| size | seeds | {' | '.join(heads)} |"
    yield f"| --- | --- |{' ---: |' * len(heads)}"
    for size, plan in sizes.items():
        first, last = plan.first_seed, plan.first_seed + plan.seeds - 1
        trained = f"{first} to {last}" if last > first else f"{first}"
        seeds = "none" if plan.published or not plan.agents else trained
        yield f"| `{size}` | {seeds} | {' | '.join(map(_points, plan.power()))} |"


def _points(rate: float) -> str:
    if math.isnan(rate):
        return ""
    return "none" if math.isinf(rate) else f"{100 * rate:.0f} points"


if __name__ == "__main__":
    write_aside(PAGE, page().encode())
