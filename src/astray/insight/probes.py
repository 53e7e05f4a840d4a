"""What can be read off a layer: linear probes, with the controls without which they say little.

    found = probe(agent, "coin-anywhere", states, ["block4.pool"], COINRUN.labels)
    summary(found)  # a row for each label and layer, with intervals over splits

A score is what a probe reads in levels that it was not fitted on. Beside it stand the score of the
same probe fitted to labels that were shuffled, that on a network of the same shape that was never
trained, and that on the picture itself: what is in the picture can be read off any layer that
loses nothing, so that alone does not make it something that the agent attends to.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
import torch

from astray import imports
from astray.analysis.critic import observe
from astray.analysis.estimates import estimate_mean
from astray.analysis.given import Measure, measured, see_measures
from astray.analysis.trained import Agent
from astray.bounds import MOST, bounded, of_kind
from astray.game import Variant
from astray.insight.activations import activations

SEEN = "observation"  # in the place of a layer: what the agent is shown
TEST = 0.3  # share of levels that a probe is scored on
DIRECTIONS = 128  # of what a layer gives, those in which it varies most; more would be fitted to
# noise, and take long
STRENGTHS = np.logspace(-1, 5, 13)  # of ridge regression's penalty, of which it takes the best
LEAST = 20  # states of a class, and states with a number, below which there is nothing to fit
SELDOM = 0.01  # share of states in which something must differ from its median to be shown
FITS = 400  # steps of the solver, at most
SCORES = ("score", "shuffled", "untrained")
FIXED = ("kind", "states", "chance")


def probe(
    agent: Agent,
    variant: str | Variant,
    states: np.ndarray,
    layers: Sequence[str],
    labels: Mapping[str, Measure],
    *,
    seeds: int = 5,
) -> pl.DataFrame:
    """What linear probes of each layer, and of the observation, read of each label.

    states  of several episodes; levels are split, so that no level is in both parts
    labels  functions of states, as `game.labels`: booleans and integers are classes, for logistic
            regression; reals are numbers, for ridge regression; states with -1 or NaN do not count
    seeds   splits, each with its own shuffling and its own untrained network

    Columns: label, layer, seed, kind ("class" or "number"), states, levels, chance (what is right
    without looking), score, shuffled (labels), untrained (network; null for the observation),
    selectivity (score less shuffled). Scores are the mean share of each class that is right
    (balanced accuracy), or of numbers the share of their variance that is told (R squared, which is
    below 0 where the mean would tell more).

    Labels with too few states, or of one class alone, are left out. Raises ImportError without
    scikit-learn, ValueError where a layer is unknown or no label is left.
    """
    of_kind("states", states, np.ndarray)
    bounded("seeds", seeds, 1, MOST)
    see_measures(labels, ())
    _sklearn()
    shown = observe(agent, variant, states)
    known = {name: measured(name, measure, states).to_numpy() for name, measure in labels.items()}
    known = {name: y for name, y in known.items() if _enough(y)}
    if not known:
        raise ValueError(f"no label of {', '.join(labels)} has two classes of {LEAST} states each")
    given = {SEEN: shown.astype(np.float32)} | activations(agent, shown, layers)
    rows = []
    for seed in range(seeds):
        fresh = activations(untrained(agent, seed), shown, layers)
        for layer, x in given.items():
            for label, y in known.items():
                rows.append(
                    {"label": label, "layer": layer, "seed": seed}
                    | _fit_all(x, fresh.get(layer), y, states["level"], seed)
                )
    return pl.DataFrame(rows, infer_schema_length=None)


def summary(found: pl.DataFrame) -> pl.DataFrame:
    """The means over splits of what `probe` found, with 95 % intervals: of each score mean, low and
    high as "score", "score low", "score high"; rows in the order of labels, then layers."""
    rows = []
    for (label, layer), part in found.group_by(["label", "layer"], maintain_order=True):
        row: dict[str, Any] = {"label": label, "layer": layer}
        row |= {name: part[name][0] for name in FIXED}
        for name in (*SCORES, "selectivity"):
            values = part[name].drop_nulls().to_numpy()
            if len(values):
                of = estimate_mean(values)
                row |= {name: of.mean, f"{name} low": of.low, f"{name} high": of.high}
        rows.append(row)
    order = {label: k for k, label in enumerate(found["label"].unique(maintain_order=True))}
    table = pl.DataFrame(rows, infer_schema_length=None)
    return table.sort(pl.col("label").replace_strict(order), maintain_order=True)


def untrained(agent: Agent, seed: int) -> Agent:
    """The same agent with a network of the same shape that was never trained."""
    bounded("seed", seed, 0, MOST)
    other = copy.copy(agent)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        other.network = agent.architecture.build().to(agent.device)
    return other


def is_class(y: np.ndarray) -> bool:
    """Whether a label's values are classes: booleans or integers."""
    return y.dtype.kind in "biu"


def _enough(y: np.ndarray) -> bool:
    if not is_class(y):
        return bool(np.count_nonzero(np.isfinite(y)) >= LEAST and np.nanstd(y) > 0)
    _, counts = np.unique(y[y >= 0], return_counts=True)
    return bool(np.count_nonzero(counts >= LEAST) >= 2)


def _fit_all(
    x: np.ndarray, fresh: np.ndarray | None, y: np.ndarray, levels: np.ndarray, seed: int
) -> dict[str, Any]:
    """The scores of one label at one layer, for one split."""
    if is_class(y):
        y = y.astype(np.int64)
        classes, counts = np.unique(y[y >= 0], return_counts=True)
        keep = np.isin(y, classes[counts >= LEAST])  # a class of a few states tells nothing
        chance = 1 / np.count_nonzero(counts >= LEAST)
    else:
        keep, chance = np.isfinite(y), 0.0
    x, y, levels = x[keep], y[keep], levels[keep]
    learn = split(levels, seed)
    shuffled = np.random.default_rng(seed).permutation(y)
    score, control = fit(x, y, learn, seed), fit(x, shuffled, learn, seed)
    return {
        "kind": "class" if is_class(y) else "number",
        "states": len(y),
        "levels": len(np.unique(levels)),
        "chance": chance,
        "score": score,
        "shuffled": control,
        "untrained": None if fresh is None else fit(fresh[keep], y, learn, seed),
        "selectivity": score - control,
    }


def split(levels: np.ndarray, seed: int) -> np.ndarray:
    """[N] bool, the states to learn from: of levels [N], a share of TEST is for the test."""
    bounded("seed", seed, 0, MOST)
    names = np.unique(levels)
    if len(names) < 2:
        raise ValueError("probes need states of at least two levels; these are of one")
    test = np.random.default_rng(seed).permutation(names)[: max(1, round(TEST * len(names)))]
    return ~np.isin(levels, test)


def read(
    agent: Agent,
    variant: str | Variant,
    states: np.ndarray,
    here: np.ndarray,
    layers: Sequence[str],
    labels: Mapping[str, Measure],
) -> pl.DataFrame:
    """What probes that are fitted in `states` read of one other state, `here` [1].

    Columns: label, layer, read, true (null where the state does not have it), score (of a probe
    that was fitted on most levels, in the others).
    """
    see_measures(labels, ())
    _sklearn()
    both = [observe(agent, variant, some) for some in (states, here)]
    given, shown = (activations(agent, some, layers) for some in both)
    rows = []
    for label, measure in labels.items():
        y, true = (measured(label, measure, some).to_numpy() for some in (states, here))
        if not _enough(y):
            continue
        known = y >= 0 if is_class(y) else np.isfinite(y)
        has = true[0] >= 0 if is_class(true) else np.isfinite(true[0])
        y = y.astype(np.int64) if is_class(y) else y
        for layer in layers:
            x, levels = given[layer][known], states["level"][known]
            score = fit(x, y[known], split(levels, 0), 0)
            model, varies = _fitted(x, y[known], 0)
            told = model.predict(shown[layer].reshape(1, -1)[:, varies])[0]
            rows.append(
                {
                    "label": label,
                    "layer": layer,
                    "read": float(told),
                    "true": float(true[0]) if has else None,
                    "score": score,
                }
            )
    if not rows:
        raise ValueError("no label has two classes, or numbers, in enough of these states")
    return pl.DataFrame(rows)


def fit(x: np.ndarray, y: np.ndarray, learn: np.ndarray, seed: int) -> float:
    """The score of a probe that is fitted on the states in `learn` [N] bool, on the others.

    x  [N, ...] what a layer gave
    y  [N] classes (integers), or numbers
    """
    _sklearn()
    from sklearn.metrics import balanced_accuracy_score, r2_score

    if not np.ptp(x[learn].reshape(np.count_nonzero(learn), -1), axis=0).any():
        return 0.0 if not is_class(y) else 1 / len(np.unique(y))  # nothing varies
    model, varies = _fitted(x[learn], y[learn], seed)
    told = model.predict(x[~learn].reshape(np.count_nonzero(~learn), -1)[:, varies])
    if not is_class(y):
        return float(r2_score(y[~learn], told))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a class may be missing in the test
        return float(balanced_accuracy_score(y[~learn], told))


def _fitted(x: np.ndarray, y: np.ndarray, seed: int) -> tuple[Any, np.ndarray]:
    """The probe, and which of what a layer gives varies [D] bool, which is all that it is shown."""
    from sklearn.decomposition import PCA
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import LogisticRegression, RidgeCV
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    flat = x.reshape(len(x), -1)
    # What is otherwise in hardly any state has next to no deviation to be divided by.
    varies = (flat != np.median(flat, axis=0)).mean(0) >= SELDOM
    varies |= ~varies.any() & (np.ptp(flat, axis=0) > 0)
    flat = flat[:, varies]
    most = min(DIRECTIONS, flat.shape[1], len(flat) - 1)
    steps: list[Any] = [StandardScaler()]
    if most < flat.shape[1]:
        steps.append(PCA(most, svd_solver="randomized", random_state=seed))
    if is_class(y):
        steps.append(LogisticRegression(class_weight="balanced", max_iter=FITS, C=0.1))
    else:
        steps.append(RidgeCV(STRENGTHS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # of what is separable, weights grow
        return make_pipeline(*steps).fit(flat, y), varies


def _sklearn() -> None:
    try:
        import sklearn  # noqa: F401
    except ImportError:
        raise imports.missing("probes need scikit-learn", "insight") from None
