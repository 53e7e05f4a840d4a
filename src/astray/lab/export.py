"""The lab as static files: the page, levels and agents, without Python.

`page/engine/local.js` does the work of Python: the rules of astray's own games, small networks,
posteriors over goals. Networks for images become tables, computed here: in some levels, for every
place of goal and agent, facing left or right, the policy and the value, one byte each.
"""

import base64
import contextlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from astray import games
from astray.acting import initial_states
from astray.agents.policy import weights
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.trained import Agent
from astray.files import check_empty, new_folder, write_aside
from astray.game import Game, Variant
from astray.games import maze
from astray.insight.fields import states_at
from astray.kernel.jit import entry
from astray.kernel.rng import RNG_FIELDS, draw_u32, seed_twister
from astray.lab import rules
from astray.lab.agents import places, sees
from astray.lab.server import files
from astray.lab.session import FORMAT, Lab, about_game, drawings
from astray.lab.worlds import is_played
from astray.level import Level
from astray.record import NEVER, record_dtype
from astray.training.config import Config
from astray.training.fast.unedited import is_unedited
from astray.validation import MOST, bounded, of_kind, path_of

DRAWS = 100_000  # from the twister of a level's number, at most, until the level begins
OF_NO_LEVEL = ("level", "seed", "turn", "gap")  # fields that are not of a level
TABLE = 2**21  # bytes of an agent's table, at most
COMPUTED = "mlp"  # the network that the page computes
CERTAIN = 255  # a byte that is a probability of 1
ROUNDED = (
    "Its probabilities and values are rounded to 256 steps here, so draws may differ from Python's."
)
# Fields of a maze that images show, beside its cells.
SEEN = (
    "background", "background_offset", "walls", "window", "goal_shape", "goal_colour",
    "other_shape", "other_colour",
)  # fmt: skip
NOTE = (
    "This page has no Python behind it. Levels, rules, arrows, episodes, splays and the posterior "
    "over goals are computed in the browser, by the same rules and the same network. The odds that "
    "it is an agent at all, gradients, interventions, best ways and other levels need the lab "
    'itself: pip install ".[lab]" in a clone of astray, then astray lab.'
)


def export(
    lab: Lab,
    folder: Path,
    levels: int = 50,
    agents: list[str] | None = None,
    games: Mapping[str, str] | None = None,
) -> None:
    """Write the lab to `folder`, which must be new or empty.

    Args:
        levels: Number of levels of each variant, from number 0 on.
        agents: Names of agents; None for the lab's first one and all pretrained ones.
        games: Names of further games, to be played without an agent, each with a variant that is
            exported, too.

    Raises:
        FileExistsError: If the folder is not empty; nothing of the user's is removed.
        ValueError: If a game or an agent needs Python, or a variant does not exist.
    """
    of_kind("lab", lab, Lab)
    folder = path_of("folder", folder)
    bounded("levels", levels, 1, 10_000)
    check_empty(folder)
    chosen = check_exportable(lab, agents, further := games or {})
    with new_folder(folder) as aside:
        for path, (data, _) in files().items():
            if path != "widget.js":
                _write(aside / path, data.replace(b'engine="socket"', b'engine="static"'))
        _write(aside / rules.SHARED, rules.shared())
        _write_data(lab, aside / "data", levels, chosen, further)
        if check_empty(folder):  # another export may have filled it meanwhile
            folder.rmdir()


def check_exportable(
    lab: Lab, agents: Sequence[str] | None, further: Mapping[str, str]
) -> list[str]:
    """Return the agents to export; raise ValueError if one of them, or a game, needs Python."""
    opened = {name: lab.agents.open(name) for name in (_chosen(lab) if agents is None else agents)}
    for game in dict.fromkeys(
        (lab.start["game"], *further, *(config.game for _, config in opened.values()))
    ):
        if not is_played(games.find(game)):
            drawn = ", ".join(name for name in games.OWN if is_played(games.find(name)))
            raise ValueError(
                f"{game} must be a world of `astray.grid`, or one of {drawn}: others need Python; "
                "astray lab without --export shows any"
            )
    for game, variant in further.items():
        games.find(game).variant(variant)
    for name, (agent, config) in opened.items():
        why = "has a memory" if agent.caveat else f"sees images of {config.game}"
        is_tabled = not agent.caveat and config.find_game() is maze.GAME
        if agent.architecture.name == COMPUTED and not is_computed(agent):
            told = f"the agent {name!r} has an edited {COMPUTED}; a page computes astray's own"
            raise ValueError(f"{told}; astray lab without --export shows any")
        if agent.architecture.name != COMPUTED and not is_tabled:
            raise ValueError(f"the agent {name!r} {why}: there is no table of all that it may see")
    return [*opened]


def is_computed(agent: Agent) -> bool:
    """Return whether a page computes an agent's network: a small one that nobody has edited."""
    return agent.architecture.name == COMPUTED and is_unedited(type(agent.network))


def _chosen(lab: Lab) -> list[str]:
    """Return the agents to export: those with a run of a game that the page supports."""
    chosen = [first] if (first := lab.start.get("agent", "")) else []
    for name in lab.agents.paths:
        with contextlib.suppress(ValueError, OSError):  # a broken one keeps no other from the page
            agent = lab.agents.open(name)[0]
            if is_computed(agent) and is_played(games.find(agent.game)):
                chosen.append(name)
    return [*dict.fromkeys(chosen)]


def _write_data(
    lab: Lab, folder: Path, levels: int, agents: list[str], further: Mapping[str, str]
) -> None:
    called = file_names(agents)
    about = {called[name]: lab.agents.about(name) for name in agents}
    played = {told["game"] for told in about.values()} | {lab.start["game"], *further}
    found: dict[str, Any] = {}
    for game in sorted(map(games.find, played), key=lambda game: game.name):
        _write(folder / "art" / f"{game.name}.json", {"pictures": drawings(game)})
        variants = _variants(lab, game, about, further.get(game.name))
        told = about_game(game)
        kept = {n: {v: told[n][v] for v in variants} for n in ("variants", "knobs")}
        _write(folder.parent / rules.path(game), rules.module(game).encode())
        found[game.name] = told | kept | {"rules": rules.entry(game)}
        for name in variants:
            data = {"levels": _levels(game, game.variant(name), levels)}
            _write(folder / "levels" / game.name / f"{name}.json", data)
    for name in agents:
        told = about[called[name]]
        told["variants"] = [v for v in told["variants"] if v in found[told["game"]]["variants"]]
        _write_own_levels(lab.agents.open(name)[1], called[name], told, folder, levels)
        _write_agent(*lab.agents.open(name), called[name], told, folder, levels)
    start = dict(lab.start) | {"agent": called.get(lab.start.get("agent", ""), "")}
    if isinstance(start["level"], int) and start["level"] >= levels:
        start |= {"level": 0, "why": ""}  # which is always exported
    index = {
        "format": FORMAT, "engine": "static", "note": NOTE, "games": found, "agents": about,
        "broken": {}, "start": start,
    }  # fmt: skip
    _write(folder / "index.json", index)


def file_names(agents: Sequence[str]) -> dict[str, str]:
    """Return a name for each agent's files: its own, or the last part of its run folder's path.

    A full path would lead out of the exported folder.
    """
    called: dict[str, str] = {}
    for name in agents:
        short = re.sub(r"[^A-Za-z0-9]+", "-", "-".join(Path(name).parts[-2:])).strip("-") or "agent"
        called[name] = short if short not in called.values() else f"{short}-{len(called)}"
    return called


def _variants(lab: Lab, game: Game, about: Mapping[str, Any], named: str | None) -> list[str]:
    """Return the variants to export: those of the agents' shifts, the first one, and `named`.

    A game without an agent has those of its first shift.
    """
    wanted = {named, lab.start["variant"] if lab.start["game"] == game.name else None}
    agents = [told for told in about.values() if told["game"] == game.name]
    for told in agents:
        wanted |= {told["variant"], told["test"]} & set(told["variants"])
    for shift in [] if agents else [*game.shifts.values()][:1]:
        wanted |= {shift.train, shift.test}
    return [name for name in game.variants if name in wanted]


def _levels(game: Game, variant: Variant, count: int) -> list[dict[str, Any]]:
    """Return the levels of a variant as drawings with their looks and `_undecided` fields."""
    found = []
    for s in initial_states(game, variant, range(count)):
        level = Level.of(game, variant, s)
        told = {"number": int(s.level), "text": str(level), "looks": dict(level.looks)}
        found.append(told | _undecided(s, level.state(solvable=False)))
    return found


def _undecided(s: Any, built: Any) -> dict[str, Any]:
    """Return what a numbered level's state has otherwise than the state built of its cells.

    A field is NumPy's code of its type, and bytes. A twister that began with the level's number is
    the number of its draws.
    """
    differ = [n for n in s.dtype.names if s[n].tobytes() != built[n].tobytes()]
    fields = {n: s[n] for n in differ if n not in OF_NO_LEVEL}
    told: dict[str, Any] = {}
    if fields.keys() & {"mt", "mt_next"}:
        (twister,) = np.zeros(1, record_dtype(RNG_FIELDS))
        if (draws := _draws(twister, s.level, s.mt, s.mt_next)) < DRAWS:
            told["draws"] = draws
            fields = {n: value for n, value in fields.items() if n not in ("mt", "mt_next")}
    code = {n: s.dtype[n].base.str[1:] for n in fields}
    packed = {n: [code[n], base64.b64encode(x.tobytes()).decode()] for n, x in fields.items()}
    return told | ({"fields": packed} if packed else {})


@entry
def _draws(twister, level, words, at):
    """Draw from the twister of a level's number until it is that of `words`; return how often."""
    seed_twister(twister, level)
    for draws in range(DRAWS):
        if twister.mt_next == at and (twister.mt == words).all():
            return draws
        draw_u32(twister)
    return DRAWS


def _write_own_levels(
    config: Config, name: str, told: dict[str, Any], folder: Path, count: int
) -> None:
    """Write the levels of an agent whose variants have other knobs, and their paths to `told`."""
    game = config.find_game()
    told["levels"] = {}
    for variant in (name for name in told["variants"] if name in told["knobs"]):
        path = f"data/own/{name}/{variant}.json"  # no other agent has this name
        _write(folder.parent / path, {"levels": _levels(game, config.variant_for(variant), count)})
        told["levels"][variant] = path


def _write_agent(
    agent: Agent, config: Config, name: str, told: dict[str, Any], folder: Path, levels: int
) -> None:
    told.pop("layers", None)
    if agent.architecture.name == COMPUTED:
        held = weights(agent.network, agent.architecture, agent.game)  # its file may be gone
        _write(folder / "agents" / f"{name}.safetensors", held)
        return
    game = config.find_game()
    variant = config.variant_for(told["test"])
    index, data = table(agent, game, variant, levels)
    _write(folder / "agents" / f"{name}.json", index)
    _write(folder / "agents" / f"{name}.bin", data)
    told |= {"variants": [told["test"]], "caveat": f"{ROUNDED} {config.caveat}".strip()}
    told["table"] = {"path": f"data/agents/{name}.json", "bytes": f"data/agents/{name}.bin"}


def table(
    agent: Agent, game: Game, variant: Variant, count: int, most: int = TABLE
) -> tuple[dict[str, Any], bytes]:
    """Return an index and bytes of an agent's outputs in the first levels, for all places.

    A row is the policy [A] and the value, one byte each: of an agent that faces left in all its
    places, then of one that faces right. If all places of the goal would take more than `most`
    bytes divided by `count`, a level has only the goal's own place. All have answers without the
    goal, as after it was reached. ValueError is raised if the agent cannot see such levels.
    """
    bounded("levels", count, 1, MOST)
    if not sees(agent, game, variant):
        raise ValueError("the agent must see levels of the variant; it does not")
    levels, policies, values, rows = [], [], [], 0
    for s in initial_states(game, variant, range(count)):
        level = Level.of(game, variant, s)
        bare = level
        for name in filter(level.where, game.editing.OBJECTS):  # which are walked over
            bare = bare.removed(name)
        cells = places(game, bare.state(solvable=False)).tolist()
        family = level.splay("goal") if level.where("goal") else [level]
        if (len(family) + 1) * 2 * len(cells) * (len(game.actions) + 1) > most / count:
            family = [level]
        goals = {}
        for one in [*family, None]:
            states = states_at(one or level, cells * 2)
            if one is None:  # then it is gone
                states["goal_x"] = states["goal_y"] = NEVER
            x, y = states[["goal_x", "goal_y"]][0].item()
            goals["none" if x == NEVER else f"{x},{y}"] = rows
            states["faces_right"] = np.arange(len(states)) >= len(cells)
            policy, value = policy_and_value(agent, observe(agent, variant, states))
            policies.append(policy)
            values.append(value)
            rows += len(states)
        levels.append(
            {
                # Cells, the lowest row first, with "#" for walls.
                "walls": re.sub(r"[^#\n]", ".", "\n".join(reversed(str(level).split("\n")))),
                "looks": [s[name].item() for name in SEEN],
                "other": [] if s.other_x == NEVER else [f"{s.other_x},{s.other_y}"],
                "places": [f"{x},{y}" for x, y in cells],
                "goals": goals,
            }
        )
    policy, value = np.concatenate(policies), np.concatenate(values)
    low, high = float(value.min()), float(value.max())
    spread = (high - low) or 1.0
    data = np.empty((rows, len(game.actions) + 1), np.uint8)
    data[:, :-1] = np.round(CERTAIN * policy)
    best = policy.argmax(1)
    tied = data[:, :-1].argmax(1) != best  # else a page would take another as the likeliest
    data[tied, best[tied]] += 1
    data[:, -1] = np.round(CERTAIN * (value - low) / spread)
    numbers = {"actions": len(game.actions), "one": CERTAIN, "low": low, "high": high}
    return {**numbers, "seen": SEEN, "levels": levels}, data.tobytes()


def _write(path: Path, data: Any) -> None:
    """Write bytes as they are, and other data as JSON."""
    is_bytes = isinstance(data, bytes)
    write_aside(path, data if is_bytes else json.dumps(data, separators=(",", ":")).encode())
