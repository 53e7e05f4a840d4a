"""Linear probes of layers, with the controls that make them meaningful.

    rows = probe(agent, "coin-anywhere", states, ["block4.pool"], COINRUN.labels)

The result has a row for each label and layer, with intervals over levels.

A score is the accuracy in levels outside of the fit. Controls are the scores with shuffled labels,
on an untrained network of the same shape, and on the picture itself. A layer that loses nothing
contains everything in the picture, so a score alone does not show that the agent uses it.
"""

import copy
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import torch
from torch.nn.utils.spectral_norm import SpectralNorm
from torch.nn.utils.weight_norm import WeightNorm

from astray import imports
from astray.agents.policy import defaults
from astray.analysis.critic import observe
from astray.analysis.estimates import estimate_mean, quantile
from astray.analysis.evaluate import Measure, check_measures, measured
from astray.analysis.trained import Agent, AnyModel, Model
from astray.estimate import Estimate
from astray.game import Variant
from astray.insight.activations import activations, beginnings_in
from astray.protocols import Classes
from astray.validation import MOST, bounded, of_kind, shown

SEEN = "observation"  # in the place of a layer: what the agent is shown
TEST = 0.3  # fraction of levels that a probe is scored on
DIRECTIONS = 128  # of activations, those in which they vary most; more would be fitted to
# noise, and take long
STRENGTHS = np.logspace(-1, 5, 13)  # of ridge regression's penalty, of which it takes the best
LEAST = 20  # states of a class, and states with a number, below which there is nothing to fit
SELDOM = 0.01  # fraction of states in which something must differ from its median to be shown
FITS = 400  # steps of the solver, at most
SCORES = ("score", "shuffled", "untrained")


def probe(
    agent: Model,
    variant: str | Variant,
    states: np.ndarray,
    layers: Sequence[str],
    labels: Mapping[str, Measure],
    *,
    folds: int = 5,
    episodes: bool = False,
) -> pl.DataFrame:
    """Fit linear probes of each label to each layer and to the observation, and score them.

    Columns: label, layer, kind ("class" or "number"), states, levels, chance (of guessing); score,
    shuffled (labels), untrained (network; null for the observation), selectivity (score minus
    shuffled), gain (score minus untrained), each with its 95 % interval ("score low", "score
    high"). Scores are balanced accuracy for classes, and R squared for numbers (below 0 if worse
    than the mean), over the predictions in all levels. Intervals are over levels, of this agent
    alone; a level counts once. Classes and numbers of too few states, or that are in the levels of
    one fold alone, are left out, and so are labels with a single class.

    Args:
        states: [N], from several episodes; levels are split, so no level is in both parts.
        labels: Functions of states, as `game.labels`. Booleans and integers are classes, for
            logistic regression; reals are numbers, for ridge regression; -1 and NaN do not count.
        folds: Parts of the levels. Each is predicted by a probe fitted on the others, with its own
            shuffling and its own untrained network.
        episodes: Whether the states are whole episodes, as for `activations.capture`: probes then
            read what an agent with memory remembers.

    Raises:
        ImportError: If scikit-learn is not installed.
        ValueError: If a layer is unknown, no label is left, or states are not of whole episodes.
    """
    of_kind("states", states, np.ndarray)
    bounded("folds", folds, 2, MOST)
    of_kind("labels", labels, Mapping)
    check_measures(labels, ())
    need_sklearn()
    begins = beginnings_in(states) if episodes else None
    shown = observe(agent, variant, states)
    known = {name: measured(name, measure, states).to_numpy() for name, measure in labels.items()}
    fold = _folds(states["level"], folds)
    known = {name: y for name, y in known.items() if _usable(y, fold).any()}
    if not known:
        raise ValueError(
            f"no label of {', '.join(labels) or 'none'} has two classes of {LEAST} states each in "
            "several folds"
        )
    given = {SEEN: shown.astype(np.float32)} | activations(agent, shown, layers, begins)
    fresh = [activations(untrained(agent, k), shown, layers, begins) for k in range(folds)]
    rows = [
        {"label": label, "layer": layer}
        | _told(x, [one.get(layer) for one in fresh], y, states["level"], fold)
        for label, y in known.items()
        for layer, x in given.items()
    ]
    return pl.DataFrame(rows, infer_schema_length=None)


def untrained(agent: AnyModel, seed: int) -> AnyModel:
    """Return the agent with an untrained network; raise ValueError if a module cannot be reset."""
    bounded("seed", seed, 0, MOST)
    other = copy.copy(agent)
    with torch.random.fork_rng(devices=[]), defaults("cpu"):
        torch.manual_seed(seed)
        if isinstance(agent, Agent):
            other.network = agent.architecture.build().to(agent.device).eval()
        else:
            other.network = copy.deepcopy(agent.network)
            for name, module in other.network.named_modules():
                # These hooks compute `weight` from what reset_parameters() does not know.
                kinds = {type(hook) for hook in module._forward_pre_hooks.values()}
                normed = bool(kinds & {SpectralNorm, WeightNorm})
                anew = None if normed else getattr(module, "reset_parameters", None)
                if isinstance(anew, Callable):
                    anew()
                elif [*module.parameters(recurse=False)]:
                    told = f"{name!r} has no reset_parameters()" + " for normed weights" * normed
                    raise ValueError(
                        f"the untrained network of {agent.name} cannot be made: its module {told}"
                    )
    return other


def is_class(y: np.ndarray) -> bool:
    """Return whether a label's values [N] are classes: booleans or integers."""
    return y.dtype.kind in "biu"


def _usable(y: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Return a mask [N] of the states whose label is learned in some folds and told in others."""
    if y.dtype.kind not in "biuf":
        told = f"integers or booleans, for classes, or reals; got {shown(y[0])}"
        raise ValueError(f"the values of a label must be {told}")
    kinds = y.astype(np.int64) if is_class(y) else np.where(np.isfinite(y), 0, -1)
    counted = zip(*np.unique(kinds[kinds >= 0], return_counts=True), strict=True)
    usable = [k for k, n in counted if n >= LEAST and np.unique(fold[kinds == k]).size > 1]
    enough = len(usable) > is_class(y) and (is_class(y) or np.ptp(y[kinds == 0]) > 0)
    return np.isin(kinds, usable if enough else [])


def _folds(levels: np.ndarray, folds: int) -> np.ndarray:
    """Return the fold of each state's level, [N] from 0, with equally many levels each."""
    names, which = np.unique(levels, return_inverse=True)
    if len(names) < folds:
        raise ValueError(f"probes need states of at least {folds} levels; got {len(names)}")
    return np.random.default_rng(0).permutation(np.arange(len(names)) % folds)[which]


def _told(
    x: np.ndarray,
    fresh: Sequence[np.ndarray | None],
    y: np.ndarray,
    levels: np.ndarray,
    fold: np.ndarray,
) -> dict[str, Any]:
    """Return the scores of one label at one layer, with intervals.

    Args:
        fresh: Activations of the layer in an untrained network, for each fold.
    """
    keep = _usable(y, fold)
    y = y.astype(np.int64) if is_class(y) else y
    x, y, levels, fold = x[keep], y[keep], levels[keep], fold[keep]
    told = {name: (y.copy(), np.zeros(len(y))) for name in SCORES}  # the truth, and what is told
    for k in range(len(fresh)):
        test, network = fold == k, fresh[k]
        if not test.any():
            continue
        shuffled = np.random.default_rng(k).permutation(y)
        told["shuffled"][0][test] = shuffled[test]
        told["score"][1][test] = _predicted(x, y, ~test, k)
        told["shuffled"][1][test] = _predicted(x, shuffled, ~test, k)
        if network is None:
            told.pop("untrained", None)
        else:
            told["untrained"][1][test] = _predicted(network[keep], y, ~test, k)
    found = {name: score(*both, levels) for name, both in told.items()}
    contributions = {name: by_level(*both, levels) for name, both in told.items()}
    row = {
        "kind": "class" if is_class(y) else "number",
        "states": len(y),
        "levels": (count := len(np.unique(levels))),
        "chance": 1 / len(np.unique(y)) if is_class(y) else 0.0,
    }
    kinds = [y == one for one in np.unique(y)] if is_class(y) else []
    few = min((len(np.unique(levels[kind])) for kind in kinds), default=count)
    wider = quantile(few - 1) / quantile(count - 1)  # as a class in few levels varies
    for name, other in {"selectivity": "shuffled", "gain": "untrained"}.items():
        if other in found:
            one = estimate_mean(contributions["score"] - contributions[other], rate=False)
            low, high = (one.mean + wider * (end - one.mean) for end in (one.low, one.high))
            found[name] = replace(one, low=low, high=high)
    for name in (*SCORES, "selectivity", "gain"):
        one = found.get(name, Estimate.nothing())
        ends = (one.mean, one.low, min(one.high, 1.0) if name in SCORES else one.high)
        row |= {
            f"{name}{end}": None if np.isnan(value) else value
            for end, value in zip(("", " low", " high"), ends, strict=True)
        }
    return row


def by_level(y: np.ndarray, told: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return numbers [levels] with the score as mean and its variance over levels.

    They are the score plus each level's contribution, to first order.

    Args:
        y: [N] labels of states.
        told: [N] the predictions of a probe.
        levels: [N] the states' levels.
    """
    _, level = np.unique(levels, return_inverse=True)
    count = level.max() + 1

    def ratio(over: np.ndarray, under: np.ndarray) -> np.ndarray:
        """Return the ratio of two sums over states in the same form."""
        tops, bottoms = (np.bincount(level, part, count) for part in (over, under))
        whole = tops.sum() / bottoms.sum()
        return whole + (tops - whole * bottoms) / bottoms.mean()

    if is_class(y):
        right = told == y
        parts = [ratio(right & (y == one), (y == one).astype(float)) for one in np.unique(y)]
        return np.mean(parts, axis=0)
    return 1 - ratio((y - told) ** 2, (y - y.mean()) ** 2)


def score(y: np.ndarray, told: np.ndarray, levels: np.ndarray) -> Estimate:
    """Return the score of predictions `told` [N] of labels `y` [N] with its interval over levels.

    A class that few `levels` [N] have says little, also where each prediction is correct. The
    interval is therefore at least as wide as those of the classes give, by the sum of squares.
    """
    parts = by_level(y, told, levels)
    if not is_class(y):
        return estimate_mean(parts, rate=False)
    found, each = estimate_mean(parts, rate=True), []
    for one in np.unique(y):
        _, level = np.unique(levels[y == one], return_inverse=True)
        right = np.bincount(level, (told == y)[y == one])
        each.append(estimate_mean(right, np.bincount(level), rate=True))
    below = math.hypot(*(one.mean - one.low for one in each)) / len(each)
    above = math.hypot(*(one.high - one.mean for one in each)) / len(each)
    low, high = min(found.low, found.mean - below), max(found.high, found.mean + above)
    return replace(found, low=low, high=high)


def split(levels: np.ndarray, seed: int) -> np.ndarray:
    """Return a mask [N] of the states to learn from; raise ValueError for a single level.

    A fraction TEST of `levels` [N] is held out.
    """
    bounded("seed", seed, 0, MOST)
    names = np.unique(levels)
    if len(names) < 2:
        raise ValueError("probes need states of at least two levels; these are of one")
    test = np.random.default_rng(seed).permutation(names)[: max(1, round(TEST * len(names)))]
    return ~np.isin(levels, test)


def readings(
    agent: Model,
    variant: str | Variant,
    states: np.ndarray,
    here: np.ndarray,
    layers: Sequence[str],
    labels: Mapping[str, Measure],
) -> Iterator[dict[str, Any]]:
    """Yield readings of one state `here` [1] by probes fitted in `states` [N]; each takes a while.

    Keys: label, layer, read, true (None if undefined), both also as text by the names of classes
    ("read as", "true as"), score (of a probe fitted on most levels, in the others).

    Raises:
        ImportError: If scikit-learn is not installed.
        ValueError: If a layer is unknown or no label is left.
    """
    check_measures(labels, ())
    need_sklearn()
    both = [observe(agent, variant, some) for some in (states, here)]
    given, shown = (activations(agent, some, layers) for some in both)
    values = {
        label: [measured(label, measure, some).to_numpy() for some in (states, here)]
        for label, measure in labels.items()
    }
    learn = split(states["level"], 0)
    others = {label: y[_usable(y, learn) & ~learn] for label, (y, _) in values.items()}
    # Equal numbers have no variance that a score could be a fraction of.
    if not (left := [n for n, y in others.items() if y.size and (is_class(y) or np.ptp(y) > 0)]):
        raise ValueError(
            f"a label needs two classes of {LEAST} states, or {LEAST} numbers; none has them in "
            f"these {len(states)} states"
        )
    for label in left:
        measure, (y, true) = labels[label], values[label]
        known = y >= 0 if is_class(y) else np.isfinite(y)
        has = true[0] >= 0 if is_class(true) else np.isfinite(true[0])
        kind, y = y.dtype, y.astype(np.int64) if is_class(y) else y
        for layer in layers:
            x = given[layer][known]
            score = fit(x, y[known], learn[known], 0)
            model, varies = _fitted(x, y[known], 0)
            told = model.predict(shown[layer].reshape(1, -1)[:, varies])[0]
            yield {
                "label": label,
                "layer": layer,
                "read": float(told),
                "true": float(true[0]) if has else None,
                "read as": _as_text(measure, kind, told),
                "true as": _as_text(measure, kind, true[0]) if has else "none",
                "score": score,
            }


def _as_text(measure: Measure, kind: np.dtype, value: float) -> str:
    """Return a value of a label by the name of its class, as yes or no, or in figures."""
    if isinstance(measure, Classes):
        return measure.names[int(value)]
    if kind.kind == "b":
        return "yes" if value else "no"
    return f"{value:z.1f}" if kind.kind == "f" else f"{int(value)}"


def fit(x: np.ndarray, y: np.ndarray, learn: np.ndarray, seed: int) -> float:
    """Fit a probe on the states in `learn` [N] bool and return its score on the others.

    Args:
        x: [N, ...] activations.
        y: [N] classes (integers), or numbers.

    Raises:
        ImportError: If scikit-learn is not installed.
    """
    told = _predicted(x, y, learn, seed)
    return float(by_level(y[~learn], told, np.zeros(len(told)))[0])


def _predicted(x: np.ndarray, y: np.ndarray, learn: np.ndarray, seed: int) -> np.ndarray:
    """Fit a probe on the states in `learn` and return its predictions for the others."""
    need_sklearn()
    if not np.ptp(x[learn].reshape(np.count_nonzero(learn), -1), axis=0).any():  # nothing varies
        values, counts = np.unique(y[learn], return_counts=True)
        usual = values[counts.argmax()] if is_class(y) else y[learn].mean()
        return np.full(np.count_nonzero(~learn), usual)
    model, varies = _fitted(x[learn], y[learn], seed)
    return model.predict(x[~learn].reshape(np.count_nonzero(~learn), -1)[:, varies])


def _fitted(x: np.ndarray, y: np.ndarray, seed: int) -> tuple[Any, np.ndarray]:
    """Return the probe, and the mask [D] of activations that vary, its inputs."""
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


def need_sklearn() -> None:
    """Raise ImportError if scikit-learn is not installed."""
    with imports.extra("insight", "probes need scikit-learn"):
        import sklearn  # noqa: F401
