"""Is a coin that a runner ignores represented in its layers?"""

import functools
from collections.abc import Mapping

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from astray.analysis.critic import counterfactual, visit
from astray.analysis.estimates import group_means, mean_of
from astray.analysis.trained import Agent
from astray.estimate import Estimate
from astray.experiments.spec import Experiment, Size, Test, Work
from astray.experiments.studies.coinrun import _agents
from astray.experiments.studies.insight import _plans
from astray.experiments.studies.insight._plans import opened
from astray.figures import charts
from astray.game import Variant
from astray.games.coinrun.edits import with_coin_in_view, without_coin
from astray.games.coinrun.measures import LABELS, coin_in_view
from astray.insight import probes
from astray.report.claims import above, below
from astray.report.findings import Findings, Plot, Table

WHERE = "coin anywhere"
BRIEF = Test("coin-anywhere", "coin-end", {"time_limit": 120})  # who misses it stays for 1,000
COIN, WALL = "coin in view", "end wall in view"
READ = (COIN, "coin right", WALL, "end wall, cells")
LAYERS: Mapping[Size, tuple[str, ...]] = {
    "smoke": ("spread", "features.relu1", "features.relu2"),
    "published": ("block1.pool", "block2.pool", "block3.pool", "block4.pool", "features.relu1",
                  "features.relu2"),
}  # fmt: skip
LAST = "features.relu2"  # of which policy and value are linear functions
DRAWN = {"smoke": 6, "published": 8}  # states of each episode
FOLDS = {"smoke": 5, "published": 3}
REMOVED, ADDED = "the coin in view removed", "a coin added to the view"


def find(work: Work) -> Findings:
    agent, variant, levels = opened(work, WHERE)

    @functools.cache
    def states() -> np.ndarray:
        """Return states [K] before the end wall, from the agent's own episodes."""
        _, found = visit(agent, variant, levels, per_episode=DRAWN[work.size], batch=128)
        return found[found["x"] <= found["end_x"] + 1]

    told, folds = (LAYERS[work.size], {name: LABELS[name] for name in READ}), FOLDS[work.size]
    table = work.keep("probes", lambda: probes.probe(agent, variant, states(), *told, folds=folds))
    changes = work.keep("changes", lambda: changed(agent, variant, states()))
    by_edit = group_means(changes, "policy_change", ["edit"])
    moved, value = (
        {edit: mean_of(changes.filter(edit=edit), column) for edit in (REMOVED, ADDED)}
        for column in ("policy_change", "change")
    )
    last = {label: score(table, label, LAST) for label in READ}
    return Findings(
        answer=f"Off the last layer, whether a coin is in view is read with a balanced accuracy of "
        f"{last[COIN].mean:.2f} (0.50 without looking), whether the end wall is with "
        f"{last[WALL].mean:.2f}. Taking the coin out of view moves "
        f"{100 * moved[REMOVED].mean:.1f}\u00a0% of the policy to other actions, and the value by "
        f"{value[REMOVED].mean:+z.2f}.",
        claims=[
            above(
                "Whether a coin is in view can be read off the last layer.",
                "Trinh et al. 2024: the internal state does not represent the coin at all",
                "balanced accuracy",
                last[COIN],
                0.6,
                told=Estimate.amount,
            ),
            above(
                "Training put it there: it is read better than off a network never trained.",
                "not measured",
                "balanced accuracy, trained minus never trained",
                score(table, COIN, LAST, "gain"),
                told=Estimate.amount,
            ),
            above(
                "Whether the end wall is in view is read nearly always.",
                "not measured",
                "balanced accuracy",
                last[WALL],
                0.9,
                told=Estimate.amount,
            ),
            below(
                "The policy ignores the coin: without it, it hardly changes.",
                "not measured",
                "total variation",
                moved[REMOVED],
                0.05,
                told=Estimate.amount,
            ),
        ],
        plots=[
            Plot(
                "probes",
                "Scores of linear probes in levels that they were not fitted on, layer by "
                "layer, with intervals over levels.",
                draw(table),
                table,
            )
        ],
        tables=[
            Table("probes", "Scores of probes", table),
            Table("changes", "Total variation of the policy, with and without", by_edit),
        ],
        settings={
            "states": f"{DRAWN[work.size]} of each of {len(levels)} episodes, drawn; "
            f"each read by a probe that was fitted on the others of {FOLDS[work.size]} parts of "
            "the levels",
            "probes": f"logistic and ridge regression on {probes.DIRECTIONS} principal components",
            "value": f"{REMOVED}: {value[REMOVED].amount()}; {ADDED}: {value[ADDED].amount()}",
        },
    )


def draw(table: pl.DataFrame) -> Figure:
    """Draw probes' scores by layer beside their controls, a panel per label."""
    told = {"score": "trained network", "untrained": "never trained", "shuffled": "labels shuffled"}
    kind = pl.when(kind="number").then(pl.lit("R squared")).otherwise(pl.lit("balanced accuracy"))
    table = table.with_columns(panel=pl.format("{} ({})", "label", kind))
    parts = [
        table.select(
            "panel", "layer", what=pl.lit(called), mean=name, low=f"{name} low",
            high=f"{name} high",
        ).fill_nan(None)
        for name, called in told.items()
    ]  # fmt: skip
    chance = table.group_by("panel", maintain_order=True).agg(
        mean=pl.col("chance").first(), what=pl.lit("without looking")
    )
    return charts.curves(
        pl.concat([*parts, chance], how="diagonal_relaxed"), x="layer", line="what", panel="panel",
        limits=(-0.25, 1.03), label="score",
    )  # fmt: skip


def changed(agent: Agent, variant: Variant, states: np.ndarray) -> pl.DataFrame:
    """Return changes of policy and value with the coin, a row for each of `states` [N] in view."""
    seen = coin_in_view(states)
    parts = []
    for name, which, edit in ((REMOVED, seen, without_coin), (ADDED, ~seen, with_coin_in_view)):
        table = counterfactual(agent, variant, states[which], edit).filter("seen")
        parts.append(table.select("level", "step", "change", "policy_change", edit=pl.lit(name)))
    return pl.concat(parts)


def score(table: pl.DataFrame, label: str, layer: str, column: str = "score") -> Estimate:
    """Return a score of a probe, with its interval over levels."""
    row = table.filter(label=label, layer=layer).row(0, named=True)
    ends = (row[f"{column}{end}"] for end in ("", " low", " high"))
    return Estimate(*ends, agents=1, levels=row["levels"], rows=row["states"])


EXPERIMENT = Experiment(
    title="Decodable, but ignored?",
    reproduces="Trinh et al. 2024 (arXiv 2410.21052), its claim about the coin",
    question="Is the coin that a runner passes by in its layers, and ignored, or not there?",
    sizes={
        "smoke": _plans.of_kept_runner(400, visited={WHERE: BRIEF}),
        **_agents.plans({"published": 60}, visited={WHERE: BRIEF}, brief=BRIEF.knobs["time_limit"]),
    },
    find=find,
    needs={"sklearn": "insight"},
)
