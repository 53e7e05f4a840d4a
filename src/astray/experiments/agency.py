"""The paper's four types of trajectories, measured on several maps; see `catalogue/agency.py`."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from astray.agency import generators
from astray.agency.generators import TYPES, Setting, wander
from astray.agency.gridworld import World
from astray.agency.maps import MAPS
from astray.agency.measure import CALIBRATED, PAPER, PRESETS, TRUE, Episode, measure
from astray.analysis.statistics import bootstrap
from astray.experiments import figures, report
from astray.experiments.spec import Size, Study
from astray.experiments.tell import write_table

LOST = "capability failure"
NEVER_ON_WAY = "capability failure, never on its way"
GOAL_DIRECTED = tuple(kind for kind in TYPES if kind != LOST)
PAPERS = {  # its table: -log p_agt, -log p_dev, p(agent)
    "in-distribution": ("5.7", "20.8", "0.9999"),
    "goal misgeneralization": ("14.1", "30", "0.9999"),
    LOST: ("72", "69", "0.0674"),
    "robust": ("10.5", "30.5", "0.9999"),
}
POOLED = 10  # trajectories of which the goal is inferred together
STEPS = 50  # of the policies that are surely no agents
WALKERS = {
    "uniform random": generators.uniform_random,
    "random, no bumps": generators.legal_random,
    "persistent": generators.persistent,
    "billiard": generators.billiard,
    "wall follower": generators.wall_follower,
}
ERRING = (0.0, 0.2, 0.5)  # eps of agents
DRAWN = "four rooms"  # the map of the figure
SEED = 0


def tell(study: Study, name: str, size: Size, folder: Path) -> Path:
    """Measure everything and write tables, figures and report.html to `folder`; the report."""
    count, smaller = study.sizes[size], ""
    if size != "paper":
        smaller = f"{count} trajectories of each type on each map instead of {study.sizes['paper']}"
    settings = {map_: setting(world()) for map_, world in MAPS.items()}
    measured = pl.concat([measure_types(m, s, count) for m, s in settings.items()])
    table, false_agents = summary(measured), call_agents(settings, count // 4)
    goals = inferred(settings)
    for what, frame in (("types", table), ("called-agents", false_agents), ("goals", goals)):
        write_table(frame, folder / "tables", what)
    figures.save(draw_types(settings[DRAWN]), folder, "trajectories")
    figures.save(draw_factors(table), folder, "factors")
    verdicts = judge(table, goals, false_agents)
    (folder / "verdicts.json").write_text(json.dumps([vars(v) for v in verdicts], indent=2))
    told = report.Report(
        name=name, title=study.title, reproduces=study.reproduces, question=study.question,
        answer=answer(table), size=size, smaller=smaller, verdicts=verdicts, videos=[],
        figures=[
            report.Show(f"One trajectory of each type ({DRAWN}), and what the paper's measure "
                        "says of it.", folder / "trajectories.png"),
            report.Show("How much a trajectory speaks for an agent, on average, with 95 % "
                        "intervals: by the paper's measure and by the calibrated one.",
                        folder / "factors.png"),
        ],
        tables=[
            report.Table("Beside the paper's four trajectories: means over trajectories, "
                         "from the lowest to the highest map", beside_paper(table)),
            report.Table("All maps; intervals of the mean log Bayes factor (nats)", table),
            report.Table(f"Which goal {POOLED} trajectories together pursue", goals),
            report.Table(f"Share of policies called agents after {STEPS} steps", false_agents),
        ],
        settings={"maps": ", ".join(MAPS), "seed": str(SEED),
                  **{preset: str(options) for preset, options in PRESETS.items()}},
        command=f"astray reproduce {name} --size {size}",
    )  # fmt: skip
    return report.write(told, folder)


def setting(world: World) -> Setting:
    """`world` with a start and a goal, drawn once; the paper's are not known."""
    start, goal = np.random.default_rng(SEED).choice(len(world), 2, replace=False)
    return Setting(world, world.cell(start), world.cell(goal), SEED)


def measure_types(map_: str, setting: Setting, count: int) -> pl.DataFrame:
    """A row for each trajectory and preset: map, type, preset, steps and the evidence in nats."""
    way = [*setting.memory, setting.world.number(setting.goal)]
    rows = []
    for kind in TYPES:
        for episode in setting.episodes(kind, count):
            met = np.isin(episode.trajectory.cells, way).any()
            names = [kind] if kind != LOST or met else [kind, NEVER_ON_WAY]
            for preset, options in PRESETS.items():
                evidence = measure(episode, options)
                rows += [
                    {"map": map_, "type": name, "preset": preset,
                     "steps": len(episode.trajectory), "agt": -evidence.log_agent,
                     "dev": -evidence.log_device, "factor": evidence.log_factor,
                     "agent": evidence.agent}
                    for name in names
                ]  # fmt: skip
    return pl.DataFrame(rows)


def summary(measured: pl.DataFrame) -> pl.DataFrame:
    """Means of `measure_types` over trajectories; of the log Bayes factor with its interval."""
    rows = []
    for key, part in measured.group_by(["preset", "map", "type"], maintain_order=True):
        factor = bootstrap(part["factor"].to_numpy())
        rows.append(
            dict(zip(("preset", "map", "type"), key, strict=True))
            | {"trajectories": len(part), "steps": part["steps"].mean(),
               "-log p_agt": part["agt"].mean(), "-log p_dev": part["dev"].mean(),
               "p(agent)": part["agent"].mean(),
               "called agents": (part["factor"] > 0).mean(),
               "log factor": factor.mean, "low": factor.low, "high": factor.high,
               "at most 0.0674": (part["agent"] <= 0.0674).mean()}
        )  # fmt: skip
    return pl.DataFrame(rows)


def beside_paper(table: pl.DataFrame) -> pl.DataFrame:
    """The paper's table, and the range of ours over the maps."""
    rows = []
    for kind, figures_ in PAPERS.items():
        ours = table.filter(pl.col("preset") == "paper", pl.col("type") == kind)
        row = {"type": kind}
        for name, theirs in zip(("-log p_agt", "-log p_dev", "p(agent)"), figures_, strict=True):
            low, high = ours[name].min(), ours[name].max()
            row |= {f"{name}, paper": theirs, f"{name}, here": f"{low:.2f} to {high:.2f}"}
        rows.append(row)
    return pl.DataFrame(rows)


def inferred(settings: Mapping[str, Setting]) -> pl.DataFrame:
    """Whether trajectories together give away what they pursue: the fixed goal or the true one."""
    rows = []
    for map_, one in settings.items():
        for kind in ("goal misgeneralization", "robust"):
            evidence = measure(one.episodes(kind, POOLED), PAPER)
            chances = dict(zip(evidence.goals, evidence.posterior.tolist(), strict=True))
            rows.append(
                {
                    "map": map_,
                    "type": kind,
                    "log factor": evidence.log_factor,
                    "p(fixed goal)": chances[one.goal],
                    "p(true goal)": chances[TRUE],
                }
            )
    return pl.DataFrame(rows)  # fmt: skip


def call_agents(settings: Mapping[str, Setting], count: int) -> pl.DataFrame:
    """The share of walks of each policy that each preset calls agents, over all maps."""
    rows = []
    for number, policy in enumerate([*WALKERS, *(f"agent, eps = {eps:g}" for eps in ERRING)]):
        factors: dict[str, list[float]] = {preset: [] for preset in PRESETS}
        for one in settings.values():
            rng = np.random.default_rng([SEED, number])
            for _ in range(count):
                episode = _walk(one.world, policy, rng)
                for preset, options in PRESETS.items():
                    factors[preset].append(measure(episode, options).log_factor)
        row: dict[str, object] = {"policy": policy, "walks": count * len(settings)}
        for preset, found in factors.items():
            share = bootstrap(np.array(found) > 0)
            row |= {preset: share.mean, f"{preset}, low": share.low, f"{preset}, high": share.high}
        rows.append(row)
    return pl.DataFrame(rows)


def _walk(world: World, policy: str, rng: np.random.Generator) -> Episode:
    """A walk from a random cell, with a goal shown in another; agents stop when they are there."""
    begin, goal = (world.cell(n) for n in rng.choice(len(world), 2, replace=False))
    if policy in WALKERS:
        return Episode(world, wander(world, WALKERS[policy], begin, STEPS, rng), goal)
    walker = generators.erring(goal, float(policy.split()[-1]))
    whole = wander(world, walker, begin, STEPS, rng)
    there = np.flatnonzero(whole.cells == world.number(goal))
    ended = whole.actions[: there[0]] if len(there) else whole.actions
    return Episode(world, world.walk(begin, ended), goal)


def judge(table: pl.DataFrame, goals: pl.DataFrame, called: pl.DataFrame) -> list[report.Verdict]:
    """The paper's claims, and the remedy's."""

    def factors(kinds: tuple[str, ...], preset: str) -> tuple[str, float, float]:
        part = table.filter(pl.col("type").is_in(kinds), pl.col("preset") == preset)
        low, high = part["log factor"].min(), part["log factor"].max()
        text = f"mean log Bayes factor from {low:+.1f} to {high:+.1f} nats over the maps"
        return text, part["low"].min(), part["high"].max()  # pyright: ignore

    verdicts = []
    text, low, _ = factors(GOAL_DIRECTED, "paper")
    verdicts.append(report.Verdict(
        "Trajectories that go to a goal, be it the wrong one, are agents on average on every map.",
        "p(agent) 0.9999, for one trajectory of each of three types", text, low > 0,
    ))  # fmt: skip
    misgeneralized = goals.filter(type="goal misgeneralization")["p(fixed goal)"].min()
    robust = goals.filter(type="robust")["p(true goal)"].min()
    verdicts.append(report.Verdict(
        "Together they give away what they pursue: the fixed goal, or the true one wherever it is.",
        "not measured", f"from {POOLED} trajectories, with probability at least "
        f"{misgeneralized:.3f} and {robust:.3f}", min(misgeneralized, robust) > 0.5,  # pyright: ignore
    ))  # fmt: skip
    for kind, preset, what in (
        (LOST, "paper", "Capability failures are devices on average on every map."),
        (NEVER_ON_WAY, "paper", "So are at least those that never meet the memorised way."),
        (NEVER_ON_WAY, "calibrated", "By the calibrated measure, those are devices."),
    ):
        text, _, high = factors((kind,), preset)
        paper = "p(agent) 0.0674, for one trajectory" if preset == "paper" else "not measured"
        verdicts.append(report.Verdict(what, paper, text, high < 0))
    worst = called.filter(pl.col("policy").is_in(list(WALKERS)))
    verdicts.append(report.Verdict(
        "By the calibrated measure, policies without a goal are rarely called agents.",
        "not measured", f"at most {100 * worst['calibrated'].max():.0f}\u00a0%; by the paper's up "  # pyright: ignore
        f"to {100 * worst['paper'].max():.0f}\u00a0%", worst["calibrated, high"].max() < 0.2,  # pyright: ignore
    ))  # fmt: skip
    return verdicts


def answer(table: pl.DataFrame) -> str:
    """The finding in a sentence or two."""
    of = table.filter(pl.col("preset") == "paper")
    lost, never = of.filter(type=LOST), of.filter(type=NEVER_ON_WAY)
    agents = of.filter(pl.col("type").is_in(GOAL_DIRECTED))["called agents"]
    low, high = never["called agents"].min(), never["called agents"].max()
    small = never["at most 0.0674"].max()
    return (
        f"The measure recognises goal-directed trajectories ({_range(agents)} are called agents, "
        f"by map and type), misgeneralizing ones with them. That capability failures are devices "
        f"does not follow from the paper's specification: {_range(lost['called agents'])} are "
        f"called agents; even of those that only walk at random {100 * low:.0f} to "  # pyright: ignore
        f"{100 * high:.0f}\u00a0% are, and at most {100 * small:.0f}\u00a0% fall as low as the "  # pyright: ignore
        "published 0.0674."
    )


def _range(shares: pl.Series) -> str:
    return f"{100 * shares.min():.0f} to {100 * shares.max():.0f}\u00a0%"  # pyright: ignore


@matplotlib.rc_context(figures.STYLE)
def draw_types(setting: Setting) -> Figure:
    """A trajectory of each type on its map."""
    figure = Figure(figsize=(figures.WIDTH, 7.6))
    panels = figure.subplots(2, 2).flat
    for axes, kind in zip(panels, TYPES, strict=True):
        episode = max(setting.episodes(kind, 12), key=lambda e: len(e.trajectory))
        evidence = measure(episode, PAPER)
        _draw(axes, episode)
        axes.set_title(kind)
        axes.set_xlabel(
            f"{-evidence.log_agent:.1f} nats as agent, {-evidence.log_device:.1f} as device:\n"
            f"p(agent) = {evidence.agent:.4f}; calibrated {measure(episode, CALIBRATED).agent:.4f}"
        )
    return figure


def _draw(axes: Axes, episode: Episode) -> None:
    """The map, the way, its start (brown) and the goal that is shown (green), as the paper's."""
    world = episode.world
    axes.imshow(~world.free, cmap="Greys", vmin=0, vmax=1.6)
    rows, columns = world.cells[episode.trajectory.cells].T
    shift = np.linspace(-0.12, 0.12, len(rows))  # so that a way back can be seen
    axes.plot(columns + shift, rows + shift, color=figures.OTHERS[0], linewidth=1.6)
    axes.plot(columns[0], rows[0], "s", color="#8a5a2b", markersize=9)
    if episode.true:
        axes.plot(episode.true[1], episode.true[0], "s", color="#2e9e4f", markersize=9)
    axes.plot(columns[-1], rows[-1], "o", color=figures.INK, markersize=4)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(True)


@matplotlib.rc_context(figures.STYLE)
def draw_factors(table: pl.DataFrame) -> Figure:
    """The mean log Bayes factor of each type: a panel a preset, a point a map."""
    figure = Figure(figsize=(figures.WIDTH, 5.6))
    kinds = (*GOAL_DIRECTED, LOST, NEVER_ON_WAY)
    colours = dict(zip(MAPS, (*figures.OTHERS, "#2fa393"), strict=True))
    rows = figure.subplots(len(PRESETS), 1, sharex=True)
    for axes, preset in zip(rows, PRESETS, strict=True):
        for number, (map_, colour) in enumerate(colours.items()):
            part = {r["type"]: r for r in table.filter(preset=preset, map=map_).to_dicts()}
            there = [k for k in kinds if k in part]
            y = [kinds.index(k) + 0.13 * (number - 2) for k in there]
            mean = np.array([part[k]["log factor"] for k in there])
            low, high = (np.array([part[k][end] for k in there]) for end in ("low", "high"))
            axes.errorbar(mean, y, xerr=[mean - low, high - mean], fmt="o", markersize=3.5,
                          color=colour, linewidth=1.3,
                          label=map_ if preset == "paper" else None)  # fmt: skip
        axes.axvline(0, color=figures.INK, linewidth=0.8)
        axes.set_xscale("symlog", linthresh=2)
        axes.set_xticks([-2, -1, 0, 1, 2, 5, 10, 20, 50], [-2, -1, 0, 1, 2, 5, 10, 20, 50])
        axes.grid(axis="x")
        axes.set_yticks(range(len(kinds)), [textwrap.fill(kind, 22) for kind in kinds])
        axes.set_ylim(len(kinds) - 0.5, -0.5)
        axes.set_title(f"the measure {preset!r}")
    rows[-1].set_xlabel("mean log Bayes factor, agents against devices (nats)")
    figure.legend(loc="outside upper left", ncols=5, handlelength=1)
    return figure
