"""A page about an agent in a level: its behaviour everywhere, and what that depends on."""

import functools
import os
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from astray.acting import check_ending
from astray.analysis import agency
from astray.analysis.critic import observe, policy_and_value, visit
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, label, load_shift
from astray.analysis.tables import write_table
from astray.analysis.trained import Model, Opaque, check_network
from astray.envs.pictures import picture
from astray.figures.grids import FADED, SIGNS, Picture, images
from astray.files import check_free, check_writable, files_aside
from astray.game import Game, Shift, Variant
from astray.insight import attribution, episode, field_figures, probes
from astray.insight.activations import layers
from astray.insight.fields import cell_of, difference, fields
from astray.insight.interventions import sees_world
from astray.level import Level
from astray.report.findings import Code, Plot, Section, Table
from astray.report.page import write_page
from astray.validation import bounded, counted, path_of, slug

PAGE = "explain.html"
WRITER = "astray explain"
SIGN = f'<meta name="generator" content="{WRITER}">'.encode()  # in it
PIXELS = 384  # a side of a picture
LIKELIEST, LEAST = 4, 0.005  # actions that are named: at most, and the probability of each
MOST_OF_PIXELS = 0.995  # have colours of their own: a few strong ones would leave the rest blank
PLACES, FEWER = 128, 32  # of an object, at most; fewer where levels are large and episodes long


@dataclass(frozen=True, eq=False)
class Asked:
    """Request for an explanation.

    Attributes:
        agent: Agent, network, or other policy, which has no values, attribution and layers.
        layers: Layers for probes.
        others: Level numbers that the probes learn from.
        gamma, lam: Discount and lambda of its training, for advantages.
        deviation: Reward-normalisation scale of its training.
        lab: Command that opens the level in the lab.
        why: Sentences on the choice of the level, if it was chosen, and on what its values are of.
    """

    agent: Model | Opaque
    variant: Variant
    level: Level
    shift: str
    layers: tuple[str, ...]
    others: np.ndarray
    gamma: float = episode.GAMMA
    lam: float = episode.LAMBDA
    deviation: float | None = None
    lab: str = ""
    why: str = ""

    @property
    def between(self) -> Shift:
        """Shift between the goals that are compared."""
        return load_shift(self.level.game, self.shift)

    def named(self, thing: str) -> str:
        """Return the name of an object; a maze's goal is named by its shape."""
        return self.between.intended if thing == "goal" else thing


def written(game: Game) -> list[str]:
    """Return the names of all files that `explain` may write for a game, except the page."""
    objects = game.editing.OBJECTS if game.editing else ()
    names = [f"{what}-{slug(name)}" for what in ("without", "moved") for name in objects]
    names += ["field", "paths", "attribution", "probes", "goals", "episode"]
    return [f"{name}.{ending}" for name in names for ending in ("png", "svg", "parquet")]


def explain(asked: Asked, folder: str | Path, heading: str, progress: bool = False) -> Path:
    """Write the page, its figures (PNG and SVG) and tables (Parquet); return the page's path.

    Parts that an agent or a game does not support, such as goals without cells, say so.

    Args:
        progress: Name each part on standard error before it is computed.

    Raises:
        OSError: If the folder has files of these names that astray did not write, or no room.
        ValueError: If episodes of the variant may last for ever.
    """
    makers: Mapping[str, Callable[[Asked], list[Section]]] = {
        "Where it would go": _fields,
        "What an edit of the level changes": _edits,
        "What the value depends on": _attribution,
        "What its layers tell": _probes,
        "What it is after": _goals,
        "Its episode": _episode,
    }
    check_ending(asked.level.game, asked.variant, None)
    check_free(folder := path_of("folder", folder), PAGE, SIGN, written(asked.level.game))
    check_writable(folder / PAGE)
    parts: list[Section] = []
    for number, (title, make) in enumerate(makers.items(), 1):
        if progress:
            print(f"{number} of {len(makers)}: {title.lower()}", file=sys.stderr, flush=True)
        try:
            parts += make(asked)
        except (ValueError, ImportError) as error:
            parts.append(Section(title, [f"Not available here: {error}."]))
    shown = [item for part in parts for item in part.items]
    tables = {item.name: item.frame for item in shown if isinstance(item, Table)}
    plots = (item for item in shown if isinstance(item, Plot))
    tables |= {plot.name: plot.data for plot in plots if plot.data is not None}
    about = "Figures and tables lie beside this page. The level, for `--level-file`:"
    last = Section("How to go on", [about, Code(asked.level)])
    answer = " ".join(filter(None, (_verdict(asked), asked.agent.caveat, asked.why)))
    with files_aside(folder, PAGE, SIGN) as aside:
        for name, table in tables.items():
            write_table(table, aside / f"{name}.parquet")
        write_page(
            aside / PAGE, heading, [*parts, last], figures=aside, sign=WRITER, lab=asked.lab,
            answer=answer,
        )  # fmt: skip
        older = {*written(asked.level.game)} - {*os.listdir(aside)}
    for name in older:  # of an agent that was explained here before
        (folder / name).unlink(missing_ok=True)
    return folder / PAGE


def _verdict(asked: Asked) -> str:
    """Tell which goal the agent reaches first, here and with an object in each place."""
    shift, level = asked.between, asked.level
    played = evaluate(asked.agent, level.game, asked.variant, {"level": level})
    outcome = str(label(played, level.game, shift)["outcome"][0])
    goals = [f"the {goal}" for goal in (shift.intended, *shift.proxies)]
    proxies = " or ".join(goals[1:])
    is_event = shift.intended in level.game.event_goals
    verb, first = ("goes to", " first") if is_event else ("ends with", "")
    said = {
        INTENDED: f"{verb} {goals[0]}{first}, the intended goal",
        MISGENERALIZED: f"{verb} {proxies} rather than {goals[0]}: it misgeneralizes",
    }.get(outcome, f"does not reach {' or '.join(goals)} ({outcome})")
    objects = level.game.editing.OBJECTS
    single = [name for name in objects if len(level.where(name)) == 1]
    if not single:
        return f"Here the agent {said}."
    _, others = _anywhere(asked, single[0])
    alike = others.filter(outcome=outcome).height
    return (
        f"Here the agent {said}. With the {asked.named(single[0])} anywhere in the level, the "
        f"outcome is the same in {alike} of {len(others)} places."
    )


@functools.lru_cache(maxsize=1)
def _anywhere(asked: Asked, name: str) -> tuple[dict[str, Level], pl.DataFrame]:
    """Play an episode for every place of an object: its levels by name, and the outcomes."""
    game, everywhere = asked.level.game, asked.level.splay(name)
    most = PLACES if sees_world(asked.variant) else FEWER
    some = np.unique(np.linspace(0, len(everywhere) - 1, most).round().astype(int))
    family = {str(one.where(name)[0]): one for one in (everywhere[k] for k in some)}
    return family, label(evaluate(asked.agent, game, asked.variant, family), game, asked.between)


def _part(
    name: str, heading: str, text: str, figure: Figure, table: pl.DataFrame | None = None
) -> Section:
    """Return a section with a figure and its numbers."""
    return Section(heading, [Plot(name, text, figure, table)])


def _fields(asked: Asked) -> list[Section]:
    """Show policy and value everywhere, and the preferred ways."""
    (found,) = fields(asked.agent, asked.variant, {"level": asked.level})
    begin = found.places.number[asked.level.agent]
    policy, art, value = found.policy[begin], asked.agent.art, found.value[begin]
    order = [k for k in np.argsort(-policy)[:LIKELIEST] if policy[k] >= LEAST]
    said = ", ".join(f"{asked.level.game.actions[k]} {policy[k]:.2f}" for k in order)
    valued = "" if np.isnan(value) else f"the value is {value:z.2f}, and "
    letters = ", ".join(f"{c}: {n}" for n, c in asked.level.game.editing.OBJECTS.items())
    lettered = "" if sees_world(asked.variant) else f" Letters are objects ({letters})."
    field = _part(
        "field",
        "Where it would go",
        f"At the beginning {valued}the likeliest actions are {said}. An arrow is the step to "
        f"be expected in that place.{lettered}",
        field_figures.draw({"policy and value": found}, art=art),
        found.table(),
    )
    if 2 * len(found.path_probability()) < len(found.cells):  # objects are in the way
        return [field]
    return [
        field,
        _part(
            "paths",
            "Which ways it would take",
            "The geometric mean of the probabilities of the steps of the shortest way from the "
            "beginning to each cell. Cells without a colour are not reached.",
            field_figures.draw_paths({"from the beginning": found}, art=art),
        ),
    ]


def _edits(asked: Asked) -> list[Section]:
    """Show the differences without each object, and with the first object elsewhere."""
    agent, level = asked.agent, asked.level
    (plain,) = fields(agent, asked.variant, {"level": level})
    parts = []
    for name in level.game.editing.OBJECTS:
        where = level.where(name)
        if not where:
            continue
        (without,) = fields(agent, asked.variant, {"level": level.removed(name, where[0])})
        change = difference(plain, without)
        value = change.value.mean()
        valued = "" if np.isnan(value) else f"the value changes by {value:+z.2f}, and "
        parts.append(
            _part(
                f"without-{slug(name)}",
                f"Without the {asked.named(name)} at {where[0]}",
                f"On the mean over places {valued}{100 * change.policy.mean():.0f} % of the policy "
                "moves to other effects.",
                field_figures.draw({"without it": without, "change": change}, art=agent.art),
                change.table(),
            )
        )
        if len(where) == 1:
            parts.append(_moved(asked, name))
    if not parts:
        raise ValueError("there is no object in the level")
    return parts


def _moved(asked: Asked, name: str) -> Section:
    """Show the first goal for every place of an object."""
    family, played = _anywhere(asked, name)
    counts = Counter(played["outcome"])
    reached = {
        one.where(name)[0]: float(outcome == "intended goal")
        for one, outcome in zip(family.values(), played["outcome"], strict=True)
    }
    shaded = field_figures.heat_map(
        asked.level.removed(name), reached, art=asked.agent.art, label=INTENDED
    )
    told = ", ".join(f"{outcome} in {count}" for outcome, count in counts.most_common())
    called = asked.named(name)
    return _part(
        f"moved-{slug(name)}",
        f"With the {called} anywhere",
        f"An episode for each of {len(family)} places: {told}. A cell is bright where "
        f"the episode has the intended goal if the {called} lies there.",
        field_figures.side_by_side([shaded]),
        played.select("name", "outcome", "return", "length"),
    )


def _attribution(asked: Asked) -> list[Section]:
    """Show integrated gradients of the value at the beginning."""
    agent = check_network(asked.agent)
    states = np.array([asked.level.state(solvable=False)], asked.level.game.state)
    shown = observe(agent, asked.variant, states)
    (found,) = attribution.integrated_gradients(agent, shown)
    image = picture(asked.level.game, asked.variant, states, PIXELS, agent.art)[0]
    flat = found if found.ndim == 2 else found.sum(0)[::-1]  # planes have the lowest row first
    most = max(np.quantile(abs(flat), MOST_OF_PIXELS), np.finfo(float).tiny)
    figure = images([[
        Picture("level", image),
        Picture("integrated gradients", heat=flat, limits=(-most, most), colours=SIGNS,
                label="part of the value", opacity=FADED),
    ]], (3.5, 3.6))  # fmt: skip
    _, (value,) = policy_and_value(agent, shown)
    of_cells = found.ndim == 3 and len(flat) != len(asked.level.cells)
    around = " The agent is in the middle of what it sees." if of_cells else ""
    return [
        _part(
            "attribution",
            "What the value depends on",
            f"Integrated gradients of the value, {value:z.2f}, from an empty observation: blue "
            f"raises it, red lowers it.{around}",
            figure,
        )
    ]


def _probes(asked: Asked) -> list[Section]:
    """Show the readings of linear probes at the beginning, and their quality elsewhere."""
    game, agent = asked.level.game, check_network(asked.agent)
    if not game.labels:
        raise ValueError(f"{game.name} has no labels that probes could look for")
    _, states = visit(agent, asked.variant, asked.others, per_episode=4)
    here = np.array([asked.level.state(solvable=False)], game.state)
    given = (agent, asked.variant, states, here, asked.layers, game.labels)
    table = pl.DataFrame([*probes.readings(*given)])
    caption = (
        f"Linear probes of layers, fitted in {len(asked.others)} other levels: what they read at "
        "the beginning of this one, and in brackets how well they read levels that they were not "
        "fitted on (balanced accuracy, or R squared, below 0 where the mean would be closer)."
    )
    read = [f"{row['read as']} ({row['score']:z.2f})" for row in table.to_dicts()]
    here = table.with_columns(pl.col("true as").alias("true"), pl.Series("read as", read)).pivot(
        "layer", index=["label", "true"], values="read as", maintain_order=True
    )
    return [Section("What its layers tell", [Table("probes", caption, table, here)])]


def _goals(asked: Asked) -> list[Section]:
    """Show the posterior over the goals of its episode."""
    shift = asked.between
    goals = (shift.intended, *shift.proxies)
    if missing := [goal for goal in goals if not cell_of(asked.level, goal)]:
        raise ValueError(f"no cell of the level alone is the goal: {', '.join(missing)}")
    only: Mapping[str, Level] = {"level": asked.level}
    played = agency.play(asked.agent, asked.level.game, asked.variant, only, shift)
    found = agency.assess(played)
    row = found.episodes.row(0, named=True)
    table = pl.DataFrame(
        {
            "explanation": list(found.explanations),
            "posterior": [float(row[f"p {name}"]) for name in found.explanations],
        }
    )
    caption = (
        "The posterior over what its episode here is explained by: a goal with a name, another "
        "cell, or no goal at all (a device). One episode says little; `astray agency` weighs many."
    )
    return [Section("What it is after", [Table("goals", caption, table)])]


def _episode(asked: Asked) -> list[Section]:
    """Show value, advantage and policy along the episode."""
    course = episode.along(
        asked.agent,
        asked.variant,
        asked.level,
        gamma=asked.gamma,
        lam=asked.lam,
        deviation=asked.deviation,
    )
    happened = {n.replace("_", " "): k for n, k in course.events.items() if k is not None}
    events = [f"{name} at step {k}" for name, k in happened.items()]
    said = f"{counted(len(course.table), 'step')}: {', '.join(events) or 'no event'}."
    if course.idle:
        said += f" The last {course.idle} steps, in one or two places, are not drawn."
    if not isinstance(asked.agent, Opaque) and not asked.deviation:
        said += " Advantages use undivided rewards, as the divisor of the training is unknown."
    return [_part("episode", "Its episode", said, episode.figure(course), course.table)]


def default_layers(agent: Model | Opaque, count: int = 3) -> tuple[str, ...]:
    """Return some layers, evenly spread over the network up to the heads; none without one."""
    if isinstance(agent, Opaque):
        return ()
    heads = ("policy", "value")  # with a recurrent cell, of its body
    names = [name for name in layers(agent) if name.removeprefix("body.") not in heads]
    which = np.unique(np.linspace(0, len(names) - 1, count + 1).round().astype(int))[1:]
    bounded("count", count, 1, len(names))
    return tuple(names[k] for k in which)
