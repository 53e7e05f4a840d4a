"""Initial state of a lab: its agents and its first level."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from astray import games
from astray.acting import Policy, check_policy
from astray.analysis.trained import Agent, Network, Opaque, looked_into
from astray.lab.agents import Agents
from astray.lab.goals import FIRST_FEW, typical
from astray.lab.messages import Message
from astray.lab.session import Lab
from astray.lab.worlds import read_world
from astray.level_files import read_level
from astray.training import folders
from astray.training.folders import AgentFolder
from astray.validation import of_kind, one_of, plain

FIRST = "maze-corner"  # of the agents, where nobody says which


def make_lab(
    agent: str | Path | Policy | None, start: Mapping[str, Any], few: int = FIRST_FEW
) -> Lab:
    """Return a lab that begins with an agent and the settings in `start`.

    Args:
        agent: Name or run folder, or any policy, for which `start` says the game.
        start: First fields of a `Message`; its level may be the path of a file.
        few: Number of levels that its first one is chosen from, if `start` has none.

    Raises:
        ValueError: If a setting is invalid.
        FileNotFoundError: If there is no such agent.
    """
    of_kind("start", start, Mapping)
    runs: dict[str, Path] = {}
    given: dict[str, Network | Opaque] = {}
    name, loaded = "", None
    if agent is not None and not isinstance(agent, str | Path):
        check_policy(agent)
        found = looked_into(agent, games.find(start.get("game") or ""))
        if isinstance(found, Agent):
            its, loaded = AgentFolder.of(found.path), found
            agent = its.weights.parent if its.is_older else its.path
        else:
            name = agent.name
            given[name] = found
    if isinstance(agent, str | Path):
        path = Path(agent)
        name = folders.name_of(path)
        if name == str(path) and (path.exists() or name not in folders.names()):
            runs[name] = path
    agents = Agents.of(runs, given=given, tested=start.get("variant"))
    if loaded:
        agents.hold(name, loaded, AgentFolder.of(loaded.path).config())
    if not name and start.get("game") is None:
        name = _first_agent(agents, start.get("variant"))
    first: dict[str, Any] = {"agent": name}
    about = agents.about(name) if name else {}
    if about:
        first |= {"game": about["game"], "variant": about["test"]}
    first |= {key: value for key, value in start.items() if value is not None}
    game = games.find(first.get("game", games.OWN[0]))
    if about and about["game"] != game.name:
        raise ValueError(f"the agent {name!r} plays {about['game']}, not {game.name}")
    variant = game.variant(first.setdefault("variant", next(iter(game.variants))))
    if about:
        one_of(f"variant that {name} sees", first["variant"], about["variants"])
    variant = variant.with_knobs(own := about.get("knobs", {}).get(first["variant"], {}))
    if isinstance(first.get("level"), Path):
        first["level"] = read_level(first["level"], game, variant).to_json()
    elif "level" in first:
        first["level"] = plain(first["level"])  # a page would tell what is wrong with it late
        read_world(Message(0, "level", game.name, first["variant"], own, first["level"]))
    shift = game.shifts.get(about.get("shift", ""))
    if "level" not in first and shift and first["variant"] == shift.test:
        first["level"], first["why"] = typical(game, variant, shift, agents.player(name), few=few)
    return Lab(agents, {"level": 0} | first | {"game": game.name})


def _first_agent(agents: Agents, variant: str | None) -> str:
    """Return an agent's name for a variant (None for any), or ""."""
    for name in sorted(agents.names, key=lambda name: name != FIRST):
        try:
            about = agents.about(name)
        except (ValueError, OSError):  # the page tells which agents are broken
            continue
        if variant is None or variant in about["variants"]:
            return name
    return ""
