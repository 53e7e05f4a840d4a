"""Does one of two reward hypotheses, made to differ in the test, match the intended goal?"""

import numpy as np
import polars as pl

from astray import games
from astray.acting import initial_states
from astray.analysis.estimates import Estimate, estimate_mean
from astray.envs.vector import GameVectorEnv
from astray.experiments.spec import Experiment, Plan, Work
from astray.figures import charts
from astray.mitigation.hypotheses import Frames, agreement, chosen_rightly, train_heads
from astray.report.claims import above, below, rounded
from astray.report.findings import Findings, Plot, Table

CHEESE, CORNER = "cheese", "corner"
PLACED = {CHEESE: "goal", CORNER: "corner"}  # the field of states with its place
NAMES = list(PLACED)
TRAINING, TEST = "corner-small", "anywhere-small"
FIRST, SECOND, THIRD = 0, 1_000_000, 2_000_000  # numbers of training, unlabelled, test levels
FRAMES = 4000  # of each kind
ENSEMBLES = 10
KINDS = {"made to differ": 10.0, "left alone": 0.0}  # weight of the mutual information
MADE, ALONE = KINDS
HOLDS = 0.95  # of the distinguishing frames, that a head answers as a hypothesis does
LABELS = [1, 2, 4, 8, 16]
OFTEN, SELDOM, CHOSEN = 0.5, 0.2, 0.9  # bounds of the claims
PLACES = (0.5, 0.25, 0.25)  # of frames: the mouse anywhere, on the cheese, in the corner


def frames(variant: str, first: int, count: int, seed: int) -> Frames:
    """Return frames of `count` levels with the mouse anywhere, on the cheese, or in the corner.

    On the cheese both are visible, which occurs in no episode, since the cheese is gone then.
    """
    states = initial_states("maze", variant, range(first, first + count)).copy()
    random = np.random.default_rng(seed)
    solver = games.find("maze").solver
    for s, kind in zip(states, random.choice(3, count, p=PLACES), strict=True):
        cells = np.argwhere(solver.reachable(s))
        y, x = cells[random.integers(len(cells))]
        if kind:
            place = PLACED[NAMES[kind - 1]]
            x, y = s[f"{place}_x"], s[f"{place}_y"]
        s.x, s.y = x + 0.5, y + 0.5
    labels = {
        name: (np.floor(states["x"]) == states[f"{place}_x"])
        & (np.floor(states["y"]) == states[f"{place}_y"])
        for name, place in PLACED.items()
    }
    env = GameVectorEnv("maze", variant, count, observation="symbolic")
    largest = np.maximum(env.game.symbols.planes(env.variant), 1)
    seen = (env.set_state(states) / largest).astype(np.float32)
    env.close()
    return Frames(seen, labels)


def find(work: Work) -> Findings:
    table = work.keep("heads", lambda: heads(work.plan.levels))
    held = {kind: estimate_mean(of_ensembles(table, kind, CHEESE) >= HOLDS) for kind in KINDS}
    right = {k: estimate_mean(of_ensembles(table, MADE, f"chosen with {k}")) for k in LABELS}
    labels = pl.DataFrame([{"labels": k} | vars(one) for k, one in right.items()])
    four = right[4]
    both = charts.curves(
        table.select("kind", "seed", CORNER, mean=CHEESE), x=CORNER, panel="kind", each="seed",
        percent="xy", limits=(-0.03, 1.03), label="answers as the cheese does",
        x_label="answers as the corner does",
    )  # fmt: skip
    chosen = charts.curves(
        labels, x="labels", even=True, percent="y", limits=(0.45, 1.02),
        x_label="labelled frames of the test, among those on which the heads differ",
        label="the better head is chosen",
    )  # fmt: skip
    return Findings(
        answer="Two heads learned the reward while the cheese was in the corner. One of them "
        f"holds the cheese in {rounded(held[MADE].mean)} of ensembles that were made to differ on "
        f"unlabelled frames of the test, and in {rounded(held[ALONE].mean)} of those that were "
        f"not. The head that is nearest to the cheese answers as it does in "
        f"{rounded(nearest(table, MADE))} of distinguishing frames, in the middle ensemble, and in "
        f"{rounded(nearest(table, ALONE))} where heads are left alone. Four labels choose the "
        f"better head in {rounded(four.mean)}.",
        claims=[
            above(
                "Where heads are made to differ, one of them holds the intended goal.",
                "none: in the spirit of the literature",
                "ensembles with such a head",
                held[MADE],
                OFTEN,
                told=told,
            ),
            below(
                "Where they are not, none does.",
                "none",
                "ensembles with such a head",
                held[ALONE],
                SELDOM,
                told=told,
            ),
            above(
                "Four labels of the test choose the better head.",
                "none",
                "draws of four labels",
                four,
                CHOSEN,
                told=told,
            ),
        ],
        plots=[
            Plot(
                "heads",
                "Every head by how often it answers as either hypothesis does, in frames where "
                "the two differ: a line joins the heads of an ensemble.",
                both,
                table,
            ),
            Plot(
                "labels",
                "The rate at which a number of labels chooses the better head, of ensembles that "
                "were made to differ.",
                chosen,
                labels,
            ),
        ],
        tables=[Table("heads", "Heads, and the labels that choose them", table)],
        settings={
            "ensembles": f"{ENSEMBLES} of each kind, of two heads on shared features",
            "frames": f"{work.plan.levels} labelled of training levels, as many unlabelled of the "
            "test's, as many others to assess by; half with the mouse in any cell, a quarter on "
            "the cheese, a quarter in the corner",
            "a head holds a hypothesis": f"it answers as it does in {100 * HOLDS:g}\u00a0% of the "
            "frames in which cheese and corner differ",
            "weight of the mutual information": f"{KINDS[MADE]:g}",
        },
    )


def heads(count: int) -> pl.DataFrame:
    """Return a row per head: kind, seed, head, its agreement with each hypothesis, and labels."""
    known = frames(TRAINING, FIRST, count, 0)
    unlabelled, test = frames(TEST, SECOND, count, 1), frames(TEST, THIRD, count, 2)
    rows = []
    for kind, diversity in KINDS.items():
        for seed in range(ENSEMBLES):
            trained = train_heads(known, CHEESE, unlabelled.seen, diversity=diversity, seed=seed)
            agrees = agreement(trained, test, NAMES)
            rates = chosen_rightly(trained, test, CHEESE, LABELS, seed=seed)
            chosen = {f"chosen with {k}": x for k, x in zip(LABELS, rates, strict=True)}
            rows += [
                {"kind": kind, "seed": seed, "head": head}
                | dict(zip(NAMES, agrees[head].tolist(), strict=True))
                | chosen
                for head in range(2)
            ]
    return pl.DataFrame(rows)


def of_ensembles(table: pl.DataFrame, kind: str, column: str) -> np.ndarray:
    """Return the larger value over the heads of each ensemble, [ensembles, 1]."""
    best = table.filter(kind=kind).group_by("seed").agg(pl.col(column).max()).sort("seed")
    return best[column].to_numpy()[:, None]


def told(estimate: Estimate) -> str:
    """Format a rate of ensembles with its interval."""
    mean, low, high = (100 * x for x in (estimate.mean, estimate.low, estimate.high))
    return (
        f"{mean:.1f}\u00a0% (95\u00a0% interval {low:.1f} to {high:.1f}; "
        f"{estimate.agents} ensembles)"
    )


def nearest(table: pl.DataFrame, kind: str) -> float:
    """Return the median ensemble's best agreement of a head with the cheese."""
    return float(np.median(of_ensembles(table, kind, CHEESE)))


EXPERIMENT = Experiment(
    title="Reward ensembles",
    reproduces="in the spirit of DivDis (Lee et al. 2022) and concept extrapolation "
    "(Armstrong et al. 2023), not a reproduction",
    question="Rewards of training say cheese and corner alike. Do two hypotheses that are made to "
    "differ in the test hold the cheese, and how many labels choose it?",
    sizes={
        "smoke": Plan(
            levels=FRAMES,
            differences="mazes of 7 cells, seen as symbols; nothing acts on the hypotheses",
        )
    },
    find=find,
)
