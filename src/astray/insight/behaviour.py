"""Level features that predict an agent's behaviour, and a tested regression on them.

    table = level_features("maze", "anywhere-easy", levels)
    found = predict(table.join(outcomes, on="level"), "cheese", FEATURES)

Mini et al. (2023, arXiv 2310.08043) regressed whether a mouse takes the cheese on distances in the
maze, and were unsure of these features. Here each coefficient has an interval, its variance
inflation factor, and the frequency of its sign among subsets of the features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import polars as pl
from scipy.stats import rankdata

from astray import games, imports
from astray.acting import Levels
from astray.analysis.estimates import ends, estimate_mean, quantile
from astray.envs.beginnings import in_chunks
from astray.estimate import Estimate
from astray.game import Game, Variant
from astray.validation import MOST, bounded, of_kind

FOLDS = 5
SUBSETS = 200  # of features, in which signs are compared
RESAMPLES = 200  # of levels, for the intervals of coefficients
PENALTIES = np.logspace(-3, 1, 9)  # C of the regression: the larger, the less is held back


def level_features(game: str | Game, variant: str | Variant, levels: Levels) -> pl.DataFrame:
    """Return a game's `features` of each of `levels`, a row each: level, then reals.

    In Maze these are distances in cells between cheese, corner, start and the decision square,
    where the ways to cheese and corner part; null if they do not.

    Raises:
        ValueError: If the game has no features.
    """
    found = games.find(game)
    if found.features is None:
        raise ValueError(f"the game {found.name!r} has no features of levels; maze has")
    of_kind("levels", levels, Sequence | range | np.ndarray | dict)
    parts = [
        pl.DataFrame({"level": states["level"].copy()} | found.features(states))
        for states in in_chunks(found, variant, levels)
    ]
    return pl.concat(parts).with_columns(pl.selectors.float().fill_nan(None))


@dataclass(frozen=True)
class Prediction:
    """Quality of a prediction, and the effect of each feature.

    Attributes:
        accuracy: On left-out levels, with its interval over them.
        always: Accuracy of always predicting the more common outcome.
        auc: Area under the ROC curve on left-out levels, with its interval: 0.5 is chance.
        features: A row each: feature, coefficient (log odds per standard deviation, held back by
            the penalty), low, high (of the weakest penalty, over levels, and the coefficient), vif,
            sign (fraction of subsets of features with the same sign), alone (auc of that
            feature by itself), deviation (in cells).
        outcomes: [levels] bool, observed.
        chances: [levels] predicted probability from folds that exclude the level.
    """

    levels: int
    accuracy: Estimate
    always: float
    auc: Estimate
    features: pl.DataFrame
    outcomes: np.ndarray
    chances: np.ndarray

    def better_than(self, other: Prediction) -> Estimate:
        """Return this area under the curve minus another's in the same levels, with its interval.

        The interval is over levels.

        Raises:
            ValueError: If the levels differ.
        """
        if not np.array_equal(self.outcomes, other.outcomes):
            raise ValueError("predictions must be of the same levels")

        both = (placements(one.outcomes, one.chances) for one in (self, other))
        found = _area([mine - its for mine, its in zip(*both, strict=True)], rate=False)
        return replace(found, low=max(-1.0, found.low), high=min(1.0, found.high))


def predict(
    rows: pl.DataFrame, outcome: str, features: Sequence[str], *, seed: int = 0
) -> Prediction:
    """Fit a logistic regression with an L1 penalty chosen by cross-validation.

    Args:
        rows: A row per level, with columns `outcome` (boolean) and `features` (reals); rows with
            nulls are ignored. Levels of a column "level" must differ, as folds and intervals are
            over them.

    Raises:
        ImportError: If scikit-learn is not installed.
        ValueError: If a column is missing or constant, or an outcome is too rare.
    """
    with imports.extra("insight", "predictions need scikit-learn"):
        from sklearn.linear_model import LogisticRegression
    model = partial(
        LogisticRegression, l1_ratio=1.0, solver="liblinear", max_iter=1000, random_state=seed
    )
    bounded("seed", seed, 0, MOST)
    of_kind("rows", rows, pl.DataFrame)
    for name in (outcome, *features):
        of_kind("the name of a column", name, str)
    missing = {outcome, *features} - set(rows.columns)
    if missing or not features:
        raise ValueError(
            f"no column {', '.join(sorted(missing)) or 'is named'}; there are: "
            f"{', '.join(rows.columns)}"
        )
    if len({outcome, *features}) <= len(features):
        raise ValueError(f"columns must differ; got {outcome} and {', '.join(features)}")
    if rows[outcome].dtype != pl.Boolean:
        raise ValueError(f"the column {outcome} must be true or false; it is {rows[outcome].dtype}")
    known = rows.drop_nulls([outcome, *features])
    if "level" in known.columns and (twice := int(known["level"].is_duplicated().sum())):
        raise ValueError(
            f"rows must be one per level; {twice} of {len(known)} share the number in the column "
            "level with another, as rows of several agents do: take those of one agent"
        )
    if odd := [name for name in features if not _is_real(known[name])]:
        told = ", ".join(odd)
        raise ValueError(f"features must be finite numbers, or null if unknown; {told} is not")
    x, y = known.select(features).to_numpy(), known[outcome].cast(pl.Int64).to_numpy()
    if len(y) < 2 * FOLDS or min(y.sum(), len(y) - y.sum()) < FOLDS:
        raise ValueError(
            f"{outcome} must be true in {FOLDS} levels and false in {FOLDS}; "
            f"it is true in {y.sum()} of {len(y)}"
        )
    deviation, varies = x.std(0), np.ptp(x, axis=0) != 0  # equal reals can have one
    if not varies.all():
        flat = [name for name, some in zip(features, varies, strict=True) if not some]
        raise ValueError(f"features must vary; {', '.join(flat)} is the same in all levels")
    x = (x - x.mean(0)) / deviation
    random = np.random.default_rng(seed)
    fold = random.permutation(np.arange(len(y)) % FOLDS)
    while any(np.ptp(y[fold != k]) == 0 for k in range(FOLDS)):  # a fit needs both outcomes
        fold = random.permutation(fold)
    strength = max(PENALTIES, key=lambda c: _left_out(x, y, fold, model(C=c))[1])
    chances, _ = _left_out(x, y, fold, model(C=strength))

    def coefficients(which: np.ndarray, columns: np.ndarray, c: float = strength) -> np.ndarray:
        return model(C=c).fit(x[which][:, columns], y[which]).coef_[0]

    every, all_rows = np.arange(len(features)), np.arange(len(y))
    whole = coefficients(all_rows, every)
    # A strong penalty keeps weak effects near 0 in every sample, so that intervals are too narrow.
    drawn = [coefficients(_resample(y, random), every, PENALTIES[-1]) for _ in range(RESAMPLES)]
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    low, high = np.minimum(low, whole), np.maximum(high, whole)
    areas = [area_under(y, x[:, k]) for k in every]
    return Prediction(
        levels=len(y),
        accuracy=estimate_mean((chances > 0.5) == y),
        always=float(max(y.mean(), 1 - y.mean())),
        auc=_area(placements(y, chances)),
        features=pl.DataFrame(
            {
                "feature": list(features),
                "coefficient": whole,
                "low": low,
                "high": high,
                "vif": variance_inflation(x),
                "sign": _signs(coefficients, all_rows, whole, random),
                "alone": [max(area, 1 - area) for area in areas],  # in the better direction
                "deviation": deviation,
            }
        ),
        outcomes=y == 1,
        chances=chances,
    )


def area_under(y: np.ndarray, scores: np.ndarray) -> float:
    """Return the area under the ROC curve of scores [N] of outcomes [N], in which ties are a half.

    scikit-learn's `roc_auc_score` takes 20 times as long.
    """
    return float(placements(y, scores)[0].mean())


def placements(y: np.ndarray, scores: np.ndarray) -> list[np.ndarray]:
    """Return for levels of each outcome the fraction of the other levels on the right side of it.

    The first array is for the levels whose outcome in y [N] is true, and counts others of lower
    scores [N]; the second is for these, and counts the first of higher scores. The mean of each
    is the area under the curve.
    """
    some, found = y.astype(bool), []
    for mine, its in ((some, scores), (~some, -scores)):
        below = rankdata(its)[mine] - rankdata(its[mine])
        found.append(below / np.count_nonzero(~mine))
    return found


def _is_real(column: pl.Series) -> bool:
    """Return whether a column has finite numbers, or booleans, only."""
    is_number = column.dtype.is_numeric() or column.dtype == pl.Boolean
    return is_number and bool(column.cast(pl.Float64).is_finite().all())


def variance_inflation(x: np.ndarray) -> np.ndarray:
    """Return each feature's variance inflation factor [F], given x [N, F].

    It is 1 for an uncorrelated feature and infinite for one that others determine.
    """
    correlation = np.corrcoef(x, rowvar=False).reshape(x.shape[1], x.shape[1])
    if np.linalg.matrix_rank(correlation, tol=1e-8) < len(correlation):
        return np.array([_inflation(x, k) for k in range(x.shape[1])])
    return np.diag(np.linalg.inv(correlation)).copy()


def _inflation(x: np.ndarray, k: int) -> float:
    """Return the variance inflation of one feature, also if others are collinear."""
    others = np.column_stack([np.delete(x, k, 1), np.ones(len(x))])
    left = x[:, k] - others @ np.linalg.lstsq(others, x[:, k], rcond=None)[0]
    fraction = left.var() / x[:, k].var()
    return float(1 / fraction) if fraction > 1e-10 else np.inf


def _resample(y: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Resample levels so that both outcomes occur."""
    while True:
        some = random.integers(len(y), size=len(y))
        if 0 < y[some].sum() < len(y):
            return some


def _area(parts: Sequence[np.ndarray], *, rate: bool = True) -> Estimate:
    """Return the area under the curve, or a difference of two, with its interval over levels.

    The variance is that of DeLong et al. (1988), Biometrics 44. Resampled levels would all have the
    area 1 where these do, and an interval without width.

    Args:
        parts: Results of `placements`, or differences of them.
    """
    few, levels, mean = min(map(len, parts)), sum(map(len, parts)), float(parts[0].mean())
    wide = quantile(few - 1) ** 2
    square = wide * sum(float(part.var(ddof=1)) / len(part) for part in parts)
    low, high = ends(mean, square, rate, wide / few)
    return Estimate(mean, low, high, 1, levels, levels, few - 1)


def _signs(
    coefficients: Any, rows: np.ndarray, whole: np.ndarray, random: np.random.Generator
) -> list[float | None]:
    """Return for each feature the fraction of random subsets that agree with its sign in the whole.

    It is None for features with coefficient 0.
    """
    count = len(whole)
    same: list[list[bool]] = [[] for _ in range(count)]
    for _ in range(SUBSETS if count > 1 else 0):
        columns = np.flatnonzero(random.random(count) < 0.5)
        if not len(columns):
            continue
        for k, value in zip(columns, coefficients(rows, columns), strict=True):
            if value:
                same[k].append(bool(np.sign(value) == np.sign(whole[k])))
    return [
        float(np.mean(s or [True])) if whole[k] and (s or count == 1) else None
        for k, s in enumerate(same)
    ]


def _left_out(
    x: np.ndarray, y: np.ndarray, fold: np.ndarray, model: Any
) -> tuple[np.ndarray, float]:
    """Return each level's probability from a fit without its fold, and mean log likelihood."""
    chances = np.empty(len(y))
    for k in range(FOLDS):
        fitted = model.fit(x[fold != k], y[fold != k])
        chances[fold == k] = fitted.predict_proba(x[fold == k])[:, 1]
    clipped = chances.clip(1e-9, 1 - 1e-9)
    return chances, float(np.mean(y * np.log(clipped) + (1 - y) * np.log(1 - clipped)))
