"""Import of a published agent into a run folder.

config.json: its training's settings; unknown ones are the paper's. origin.json: its source, digest
and licence, and which settings are known. checks.json: results of its check; see
`published.check`. README.md: its card, made from these. checkpoints/<steps>/agent.safetensors: the
network; 0 steps if unknown.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from jinja2 import TemplateError

from astray import games
from astray.agents import policy
from astray.agents.importers import files
from astray.agents.importers.imported import Imported
from astray.analysis.pages import templates
from astray.files import write_aside
from astray.record import LEVELS
from astray.training import folders
from astray.training.config import PRESETS, Config
from astray.training.folders import AGENT, CONFIG, ORIGIN, AgentFolder, made, read_json
from astray.validation import shown

CHECKS = "checks.json"
SPARED = 1_000_000  # numbers after the training levels, where all levels were trained on


@dataclass(frozen=True)
class Known:
    """Facts about an agent that are not in its file. Empty text and None mean unknown.

    Attributes:
        variant: Variant of its training.
        actions: Choice of actions from the policy in its published measurements.
        steps: Environment steps of its training.
        about: Description, one sentence.
        facts: Published results, one sentence each.
    """

    game: str | None = None
    variant: str | None = None
    art: str = "original"
    actions: Literal["sampled", "greedy"] = "sampled"
    steps: int | None = None
    source: str = ""
    licence: str = ""
    about: str = ""
    facts: tuple[str, ...] = ()


def import_agent(file: Path, name: str, known: Known, *, expected: str | None = None) -> Path:
    """Import the agent in an outside file as `name`; return its run folder.

    Args:
        expected: SHA-256 that the file must have.

    Raises:
        ValueError: If the file is refused, the name is invalid or taken, or the training's game
            and variant are unknown.
    """
    folders.check_new(name)
    digest = files.digest(file)
    if expected and digest != expected:
        raise ValueError(f"{file} is refused: its SHA-256 is {digest}, not {expected}")
    found = files.read(file)
    config, told = _config(file, found, known)
    origin = {
        "file": file.name, "bytes": file.stat().st_size, "sha256": digest, "format": found.about,
        "settings_told": told, "all_levels": _on_all_levels(found),
        "steps": known.steps, "actions": known.actions,
        "source": known.source, "licence": known.licence, "about": known.about,
        "facts": known.facts, "file_says": dict(found.told),
    }  # fmt: skip
    if len(json.dumps(origin, indent=2)) > folders.LARGEST:
        raise ValueError(f"{file} is refused: its settings, or the notes on it, are too long")
    with made(folders.home(), name) as aside:
        there = aside / "checkpoints" / f"{known.steps or 0}"
        weights = policy.weights(found.network, found.architecture, config.game)
        write_aside(there / AGENT, weights)
        _write(aside / CONFIG, {"config": config.to_json()})
        _write(aside / ORIGIN, origin)
        write_card(aside, name)
    return folders.home() / name


def write_checks(run: Path, checks: list[dict[str, Any]]) -> None:
    """Write the results of an agent's check, and update its card."""
    _write(run / CHECKS, checks)
    write_card(run, run.name)


def write_card(run: Path, name: str) -> None:
    """Write `README.md` of the agent in `run`; raise ValueError if its files are damaged."""
    its, checks = AgentFolder.open(run), run / CHECKS
    config, said = its.config(), its.origin()
    network, architecture = policy.load(its.weights, config.game)
    environment = templates("astray.published", markdown=True)
    environment.filters["cell"] = lambda value: " ".join(str(value).split()).replace("|", "\\|")
    try:
        told = [str(key) for key in said["settings_told"]]
        text = environment.get_template("card.md").render(
            name=name,
            config=config,
            origin=said,
            architecture=architecture,
            weights=sum(p.numel() for p in network.parameters()),
            trained_on=config.training_variant().about,
            settings={key: getattr(config, key) for key in told},
            checks=read_json(checks, list) if os.path.lexists(checks) else [],
        )
    except (TemplateError, AttributeError, TypeError) as error:
        raise ValueError(f"{run} has {ORIGIN} or {CHECKS} as astray does not: {error}") from error
    write_aside(its.card, text.encode(errors="replace"))  # a file's name may be no text


def _config(file: Path, found: Imported, known: Known) -> tuple[Config, list[str]]:
    """Return the settings of its training, and which of them are known."""
    game, variant = known.game, known.variant
    if found.world and game is None and variant is None:
        if found.world not in games.PROCGEN:
            there = ", ".join(" ".join(world) for world in games.PROCGEN)
            raise ValueError(
                f"{file} is refused: it was trained in {shown(' '.join(found.world))} of Procgen, "
                f"which is not a game here; there are: {there}"
            )
        game, variant = games.PROCGEN[found.world]
    if not game or not variant:
        missing = "a game and a variant" if not game else f"a variant of {game}"
        raise ValueError(
            f"{file.name} does not say what its agent was trained on: {missing} must be given"
        )
    games.find(game).variant(variant)
    settings: dict[str, Any] = dict(found.settings)
    if known.steps:
        settings["steps"] = known.steps
    told = sorted(settings)
    if _on_all_levels(found):
        settings["levels"] = LEVELS.stop - SPARED
    base = {"game": game, "variant": variant, "observation": "image", "art": known.art,
            "network": found.architecture.name, "scale": found.architecture.scale}  # fmt: skip
    return PRESETS["paper"].changed(**base | settings), told


def _on_all_levels(found: Imported) -> bool:
    """Return whether the file has the training's settings without a number of levels: all, then."""
    return bool(found.told) and "levels" not in found.settings


def _write(path: Path, data: Mapping[str, Any] | list[Any]) -> None:
    write_aside(path, json.dumps(data, indent=2).encode())


def known_as(data: Mapping[str, Any]) -> Known:
    """Build `Known` from plain data such as a catalogue entry; other fields are ignored."""
    names = asdict(Known())
    values: dict[str, Any] = {name: value for name, value in data.items() if name in names}
    values["facts"] = tuple(values.get("facts", ()))
    return Known(**values)
