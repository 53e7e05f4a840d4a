"""Agents and devices: can goal-directed failure be distinguished from plain failure?"""

from collections.abc import Mapping

import numpy as np
import polars as pl

from astray.agency import generators
from astray.agency.generators import TYPES, Setting, Type, wander
from astray.agency.gridworld import World
from astray.agency.maps import MAPS
from astray.agency.measure import CALIBRATED, PAPER, PRESETS, TRUE, Episode, measure
from astray.analysis.estimates import estimate_mean
from astray.experiments.spec import Experiment, Plan, Work
from astray.figures import charts
from astray.figures.grids import Picture, images
from astray.report.claims import Claim
from astray.report.findings import Findings, Plot, Table

LOST = "capability failure"
NEVER_ON_WAY = "capability failure, never on its way"
GOAL_DIRECTED = tuple(kind for kind in TYPES if kind != LOST)
KINDS = (*GOAL_DIRECTED, LOST, NEVER_ON_WAY)
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


def find(work: Work) -> Findings:
    count = work.plan.levels
    settings = {map_: setting(world()) for map_, world in MAPS.items()}
    measured = pl.concat([measure_types(m, s, count) for m, s in settings.items()])
    table, called = summary(measured), call_agents(settings, count // 4)
    goals = inferred(settings)
    factors = charts.points(
        table.with_columns(mean="log factor", measure=pl.format("the measure '{}'", "preset")).sort(
            pl.col("type").cast(pl.Enum(KINDS)), maintain_order=True
        ),
        row="type", group="map", panel="measure", at={"": 0}, symlog=2,
        label="mean log Bayes factor, agents against devices (nats)",
    )  # fmt: skip
    drawn = [trajectory(settings[DRAWN], kind) for kind in TYPES]
    return Findings(
        answer=answer(table),
        claims=claims_of(table, goals, called),
        plots=[
            Plot(
                "trajectories",
                f"One trajectory of each type ({DRAWN}), and what the paper's measure says of it.",
                images([drawn[:2], drawn[2:]], (3.5, 3.8)),
                table.filter(map=DRAWN),
            ),
            Plot(
                "factors",
                "Mean evidence of a trajectory for an agent, with 95 % "
                "intervals: by the paper's measure and by the calibrated one.",
                factors,
                table,
            ),
        ],
        tables=[
            Table(
                "beside-paper",
                "Beside the paper's four trajectories: means over trajectories, "
                "from the lowest to the highest map",
                beside_paper(table),
            ),
            Table("types", "All maps; intervals of the mean log Bayes factor (nats)", table),
            Table("goals", f"Which goal {POOLED} trajectories together pursue", goals),
            Table(
                "called-agents", f"Fraction of policies called agents after {STEPS} steps", called
            ),
        ],
        settings={
            "maps": ", ".join(MAPS),
            "seed": str(SEED),
            **{preset: str(options) for preset, options in PRESETS.items()},
        },
    )


def trajectory(setting: Setting, kind: Type) -> Picture:
    """Draw a trajectory of a type on its map: its start is brown, the visible goal green."""
    episode = max(setting.episodes(kind, 12), key=lambda e: len(e.trajectory))
    world, evidence = episode.world, measure(episode, PAPER)
    way = world.cells[episode.trajectory.cells]
    marks = {tuple(way[0]): "#8a5a2b"} | ({episode.true: "#2e9e4f"} if episode.true else {})
    return Picture(
        kind, 0.35 + 0.65 * world.free[::-1], way=way, marks=marks,
        note=f"{-evidence.log_agent:.1f} nats as agent, {-evidence.log_device:.1f} as device:\n"
        f"p(agent) = {evidence.agent:.4f}; calibrated {measure(episode, CALIBRATED).agent:.4f}",
    )  # fmt: skip


def setting(world: World) -> Setting:
    """Return `world` with the start at the lower left and the goal at the upper right.

    The paper's positions are unknown; its mouse begins and is rewarded there.
    """
    far = world.cells.sum(1)
    start, goal = int(far.argmin()), int(far.argmax())
    return Setting(world, world.cell(start), world.cell(goal), SEED)


def measure_types(map_: str, setting: Setting, count: int) -> pl.DataFrame:
    """Return a row per trajectory and preset: map, type, preset, steps and evidence in nats."""
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
    """Return means of `measure_types` over trajectories, with an interval for the log factor."""
    rows = []
    for key, part in measured.group_by(["preset", "map", "type"], maintain_order=True):
        factor = estimate_mean(part["factor"].to_numpy())
        rows.append(
            dict(zip(("preset", "map", "type"), key, strict=True))
            | {
                "trajectories": len(part),
                "steps": part["steps"].mean(),
                "-log p_agt": part["agt"].mean(),
                "-log p_dev": part["dev"].mean(),
                "p(agent)": part["agent"].mean(),
                "called agents": (part["factor"] > 0).mean(),
                "log factor": factor.mean,
                "low": factor.low,
                "high": factor.high,
                "at most 0.0674": (part["agent"] <= 0.0674).mean(),
            }
        )
    return pl.DataFrame(rows)


def beside_paper(table: pl.DataFrame) -> pl.DataFrame:
    """Return the paper's table and the range of ours over the maps."""
    rows = []
    for kind, figures_ in PAPERS.items():
        ours = table.filter(pl.col("preset") == "paper", pl.col("type") == kind)
        row = {"type": kind}
        for name, theirs in zip(("-log p_agt", "-log p_dev", "p(agent)"), figures_, strict=True):
            low, high = span(ours[name])
            row |= {f"{name}, paper": theirs, f"{name}, here": f"{low:.2f} to {high:.2f}"}
        rows.append(row)
    return pl.DataFrame(rows)


def inferred(settings: Mapping[str, Setting]) -> pl.DataFrame:
    """Measure whether several trajectories together reveal the goal: the fixed or the true one."""
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
    return pl.DataFrame(rows)


def call_agents(settings: Mapping[str, Setting], count: int) -> pl.DataFrame:
    """Return the fraction of each policy's walks that each preset attributes to agents."""
    rows = []
    for number, policy in enumerate([*WALKERS, *(f"agent, eps = {eps:g}" for eps in ERRING)]):
        factors: dict[str, list[float]] = {preset: [] for preset in PRESETS}
        for map_, one in enumerate(settings.values()):
            rng = np.random.default_rng([SEED, number, map_])
            for _ in range(count):
                episode = _walk(one.world, policy, rng)
                for preset, options in PRESETS.items():
                    factors[preset].append(measure(episode, options).log_factor)
        row: dict[str, object] = {"policy": policy, "walks": count * len(settings)}
        for preset, found in factors.items():
            rate = estimate_mean(np.array(found) > 0)
            row |= {preset: rate.mean, f"{preset}, low": rate.low, f"{preset}, high": rate.high}
        rows.append(row)
    return pl.DataFrame(rows)


def _walk(world: World, policy: str, rng: np.random.Generator) -> Episode:
    """Return a walk from a random cell with a goal in another; agents stop at the goal."""
    begin, goal = (world.cell(n) for n in rng.choice(len(world), 2, replace=False))
    if policy in WALKERS:
        return Episode(world, wander(world, WALKERS[policy], begin, STEPS, rng), goal)
    walker = generators.erring(goal, float(policy.split()[-1]))
    whole = wander(world, walker, begin, STEPS, rng)
    there = np.flatnonzero(whole.cells == world.number(goal))
    ended = whole.actions[: there[0]] if len(there) else whole.actions
    return Episode(world, world.walk(begin, ended), goal)


def claims_of(table: pl.DataFrame, goals: pl.DataFrame, called: pl.DataFrame) -> list[Claim]:
    """Return the claims of the paper, and of our improved measure."""

    def about(text: str, paper: str, kinds: tuple[str, ...], preset: str, sign: int) -> Claim:
        part = table.filter(pl.col("type").is_in(kinds), pl.col("preset") == preset)
        low, high = span(part["log factor"])
        ours = f"mean log Bayes factor from {low:+z.1f} to {high:+z.1f} nats over the maps"
        supported = span(part["low"])[0] > 0 if sign > 0 else span(part["high"])[1] < 0
        return Claim(text, paper, ours, supported)

    fixed, _ = span(goals.filter(type="goal misgeneralization")["p(fixed goal)"])
    true, _ = span(goals.filter(type="robust")["p(true goal)"])
    published = "p(agent) 0.0674, for one trajectory"
    aimless = called.filter(pl.col("policy").is_in(list(WALKERS)))
    calibrated, paper, bound = (
        100 * span(aimless[name])[1] for name in ("calibrated", "paper", "calibrated, high")
    )
    return [
        about(
            "Trajectories that go to a goal, be it the wrong one, are agents on average on every "
            "map.",
            "p(agent) 0.9999, for one trajectory of each of three types",
            GOAL_DIRECTED,
            "paper",
            +1,
        ),
        Claim(
            "Together they give away what they pursue: the fixed goal, or the true one wherever "
            "it is.",
            "not measured",
            f"from {POOLED} trajectories with probability at least {fixed:.3f} and {true:.3f}",
            min(fixed, true) > 0.5,
        ),
        about(
            "Capability failures are devices on average on every map.",
            published,
            (LOST,),
            "paper",
            -1,
        ),
        about(
            "So are at least those that never meet the memorised way.",
            published,
            (NEVER_ON_WAY,),
            "paper",
            -1,
        ),
        about(
            "By the calibrated measure, those are devices.",
            "not measured",
            (NEVER_ON_WAY,),
            "calibrated",
            -1,
        ),
        Claim(
            "By the calibrated measure, at most one in five of policies without a goal is called "
            "an agent.",
            "not measured",
            f"at most {calibrated:.0f}\u00a0%; by the paper's up to {paper:.0f}\u00a0%",
            bound < 20,
        ),
    ]


def span(column: pl.Series) -> tuple[float, float]:
    """Return the smallest and largest number of a column."""
    numbers = column.to_numpy()
    return float(numbers.min()), float(numbers.max())


def answer(table: pl.DataFrame) -> str:
    """Return the finding in one or two sentences."""

    def called(*kinds: str) -> str:
        low, high = span(of.filter(pl.col("type").is_in(kinds))["called agents"])
        return f"{100 * low:.0f} to {100 * high:.0f}\u00a0%"

    of = table.filter(pl.col("preset") == "paper")
    _, small = span(of.filter(type=NEVER_ON_WAY)["at most 0.0674"])
    return (
        f"The measure recognises goal-directed trajectories ({called(*GOAL_DIRECTED)} are called "
        "agents, by map and type), misgeneralizing ones with them. By the paper's "
        f"specification, capability failures need not be devices: {called(LOST)} are called "
        f"agents. {called(NEVER_ON_WAY)} of those that only walk at random are, and at most "
        f"{100 * small:.0f}\u00a0% of these fall as low as the published 0.0674."
    )


EXPERIMENT = Experiment(
    title="Agents and devices",
    reproduces="Table 1 and the figure beside it",
    question="Does the measure distinguish goal misgeneralization from capability failure?",
    sizes={  # trajectories of each type on each map; the paper has one
        "smoke": Plan(levels=200, differences=""),
        "paper": Plan(levels=2000, differences=""),
    },
    find=find,
)
