"""Verbs for published agents: import a file, list, fetch, check."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.table import Table
from tyro.conf import Positional, arg

from astray.cli.arguments import Json, Mode, level_numbers, print_json, show
from astray.training import folders
from astray.training.settings import otherwise
from astray.validation import printable, shown

TOLD = "stated by the file or the catalogue"


def import_(
    file: Positional[Path],
    name: Annotated[str, arg(name="as", help="Name that other verbs find the agent by.")],
    game: Annotated[str | None, otherwise(TOLD)] = None,
    variant: Annotated[str | None, otherwise(TOLD)] = None,
    art: Annotated[str | None, otherwise("original")] = None,
    mode: Annotated[Mode | None, otherwise("sampled")] = None,
    source: Annotated[str | None, otherwise(TOLD)] = None,
    licence: Annotated[str | None, otherwise(TOLD)] = None,
) -> None:
    """Import an agent that others trained from its file. No code in the file is run.

    Leave out the options that the file or the catalogue already states.

    Example: astray import model_200015872.pth --as their-runner --game coinrun --variant coin-end

    Args:
        file: File of the agent: .pth or .pt (train-procgen-pytorch), .cleanrl_model (CleanRL), or
            .jd (RL-Clarity).
        game: Game that the agent was trained in.
        variant: Variant that the agent was trained on.
        art: Art of the images that the agent was trained on.
        mode: Choice of actions when its published results were measured.
        source: Source of the file.
        licence: Licence of the file.
    """
    from astray.agents.importers import files
    from astray.published.catalogue import by_digest
    from astray.published.imported import Known, import_agent

    entry = by_digest(files.digest(file))
    given: Any = {"game": game, "variant": variant, "art": art, "actions": mode,
             "source": source, "licence": licence}  # fmt: skip
    known = replace(
        entry.known if entry else Known(), **{k: v for k, v in given.items() if v is not None}
    )
    print(import_agent(file, name, known))


def agents(
    what: Positional[Literal["list", "fetch", "check"]] = "list",
    name: Positional[Annotated[str | None, otherwise("none")]] = None,
    levels: Annotated[str | None, otherwise("the first ones, as many as others played")] = None,
    unchecked: bool = False,
    json: Json = False,
) -> None:
    """List agents that others published, download one, or check one that was downloaded.

    Example: astray agents fetch openai-coinrun

    Args:
        what: Action: list, fetch or check. Fetch downloads an agent, checks its digest and stores
            it in the user's data folder, or in the folder that ASTRAY_AGENTS names. Check plays it,
            compares the results with the published ones, and writes both to its card.
        name: Name of the agent.
        levels: Level numbers and ranges for check, such as 5,17,100:200.
        unchecked: Fetch an agent even if its digest is unknown.

    Raises:
        ValueError: If options do not go with the action.
    """
    if (levels and what != "check") or (json if what == "fetch" else unchecked):
        raise ValueError("--levels goes with check, --unchecked with fetch, --json with the others")
    if what == "list" and name is not None:
        raise ValueError(f"list takes no name; got {shown(name)}")
    if what == "list":
        _list(json)
    elif name is None:
        raise ValueError(f"name an agent to {what}; there are: astray agents list")
    elif what == "fetch":
        _fetch(name, unchecked)
    else:
        _check(name, levels, json)


def _list(json: bool) -> None:
    from astray.published.catalogue import catalogue

    here = folders.imported()
    rows = {
        name: {
            "imported": name in here,
            "state": _state(name in here, one.tried, one.address, one.digest),
            "about": one.known.about, "game": one.known.game, "variant": one.known.variant,
            "address": one.address, "by_hand": one.by_hand, "sha256": one.sha256, "blob": one.blob,
            "bytes": one.size, "licence": one.known.licence, "source": one.known.source,
        }
        for name, one in catalogue().items()
    }  # fmt: skip
    others = [name for name in here if name not in rows]
    if json:
        print_json({"folder": str(folders.home()), "published": rows, "others": others})
        return
    table = Table("agent", "state", "licence", "what it is", box=None, padding=(0, 2, 1, 0))
    for name, row in rows.items():
        table.add_row(name, row["state"], row["licence"] or "none known", row["about"])
    show(table, width=120)
    if others:
        print(f"imported beside these: {printable(', '.join(others))}")
    print(f"Imported agents are in {folders.home()}; to get one: astray agents fetch NAME")


def _state(imported: bool, tried: bool, address: str, digest: str | None) -> str:
    if imported:
        return "imported"
    how = "by hand" if not address else "can be fetched" if digest else "can be fetched, unchecked"
    return how if tried else f"{how}; not tried here"


def _fetch(name: str, unchecked: bool) -> None:
    from astray.published.catalogue import fetch, find

    one = find(name)
    run = fetch(one, unchecked=unchecked)
    print(run)
    if one.known.licence == "":
        print("no licence of it is known: use it, and do not pass it on")
    if one.checks:
        print(f"before you believe it: astray agents check {name}")


def _check(name: str, levels: str | None, json: bool) -> None:
    from astray.published.catalogue import by_digest
    from astray.published.check import check, check_unmeasured
    from astray.published.imported import write_checks

    run = folders.find(name)
    if name not in folders.imported():
        raise ValueError(f"{name!r} comes with astray; its card has what was measured: {run}")
    entry = by_digest(folders.AgentFolder.open(run).origin()["sha256"])
    chosen = None if levels is None else level_numbers(levels)
    published = entry.checks if entry else ()
    rows = check(run, published, chosen) if published else check_unmeasured(run, chosen)
    write_checks(run, rows)
    if json:
        print_json(rows)
        return
    table = Table(
        "levels", "published", "here, counted alike", "here, every level once", "mean length",
        "value at the start",
    )  # fmt: skip
    for row in rows:
        value = f"{row['start_value']:z.2f}"
        if row["published_value"] is not None:
            value += f" (published: {row['published_value']:z.2f})"
        where = f"{row['variant']} {row['what']}".strip()
        rates = row["published"], row["alike"], row["here"]
        table.add_row(where, *rates, f"{row['length']:.1f}", value)
    show(table, width=120)
    for row in rows:
        if row["verdict"]:
            print(row["verdict"])
    print(f"written to {run / 'README.md'}")
