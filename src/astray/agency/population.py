"""Joint evidence of many episodes, which need not share one explanation."""

import numpy as np
from scipy.special import softmax

from astray.estimate import Estimate
from astray.validation import MOST, bounded

DRAWS, FORGOTTEN = 5000, 500  # of the sampler; those at its beginning do not count


def rates(log_evidence: np.ndarray, *, seed: int = 0) -> list[Estimate]:
    """Return the posterior mean rate of each explanation, with credible intervals.

    Each episode has one explanation, and all rates are equally likely a priori. An agent that
    sometimes gets stuck is therefore still seen to pursue its goal, while a single explanation of
    all episodes would have to explain the worst.

    Args:
        log_evidence: [E, H] nats, log p(episode | explanation), at least one finite per row.

    Raises:
        ValueError: If it is anything else.
    """
    log_evidence = _checked(log_evidence)
    bounded("seed", seed, 0, MOST)
    best = log_evidence.max(1, keepdims=True)
    likelihood, explanations = np.exp(log_evidence - best), log_evidence.shape[1]
    rng = np.random.default_rng(seed)
    theta, drawn = np.full(explanations, 1 / explanations), []
    for _ in range(FORGOTTEN + DRAWS):  # Gibbs: explanations given their fractions, and back
        cumulative = np.cumsum(likelihood * theta, axis=1)
        chosen = (cumulative < rng.random((len(best), 1)) * cumulative[:, -1:]).sum(1)
        theta = rng.dirichlet(1.0 + np.bincount(chosen, minlength=explanations))
        drawn.append(theta)
    kept = np.array(drawn[FORGOTTEN:])
    low, high = np.quantile(kept, [0.025, 0.975], axis=0)
    episodes = len(log_evidence)
    return [
        Estimate(*map(float, ends), agents=1, levels=episodes, rows=episodes)
        for ends in zip(kept.mean(0), low, high, strict=True)
    ]


def pooled(log_evidence: np.ndarray) -> np.ndarray:
    """Return the posterior [H] of one explanation for all episodes, from `log_evidence` [E, H].

    Raises:
        ValueError: If it is not as for `rates`, or no explanation is possible for all episodes.
    """
    joint = _checked(log_evidence).sum(0)
    if not np.isfinite(joint).any():
        raise ValueError("no explanation is possible for all episodes: see `rates`")
    return softmax(joint)


def _checked(log_evidence: np.ndarray) -> np.ndarray:
    log_evidence = np.asarray(log_evidence, float)
    if log_evidence.ndim != 2 or not log_evidence.size:
        raise ValueError(f"evidence must be of episodes x explanations; got {log_evidence.shape}")
    if not np.isfinite(log_evidence.max(1)).all():
        raise ValueError("an episode is impossible under every explanation, or one is NaN or inf")
    return log_evidence
