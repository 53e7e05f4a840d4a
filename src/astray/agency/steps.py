"""The likelihood of a step of a policy that errs, integrated over its error rate eps.

A step has probability alpha (1 - eps) + beta eps. Agents and devices are products of such steps,
so a trajectory is summarised by its number of steps of each kind:

    best of L       the action is one of the policy's k best, out of L possible ones
    not best of L   it is not, while k others are

A policy that is indifferent has k = L, and probability 1 / L for any eps.
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.special import logsumexp

from astray.agency.gridworld import ACTIONS
from astray.validation import finite, one_of

Noise = Literal["any action", "other actions"]

MOST = len(ACTIONS)
KINDS = tuple(
    (best, k, L) for L in range(1, MOST + 1) for best in (True, False) for k in range(1, L + best)
)
IMPOSSIBLE = len(KINDS)  # a step of probability 0
# [2, k, L]: the kind of a step; IMPOSSIBLE where there is none
KIND = np.full((2, MOST + 1, MOST + 1), IMPOSSIBLE, np.uint8)
for _code, (_best, _k, _L) in enumerate(KINDS):
    KIND[int(_best), _k, _L] = _code

LONGEST = 100_000  # steps; there the error of the integral is 3e-7, and beyond it grows fast
SURE = 1e8  # the largest beta of a prior; there the error is 3e-9, and at 1e9 already 3e-4
EXACT = 1023  # the highest degree integrated by Gauss-Legendre nodes of its own


@dataclass(frozen=True, eq=False)
class Rule:
    """Quadrature rule: N nodes eps in (0, 1) and the logs of their weights, with the prior."""

    eps: np.ndarray  # [N]
    certain: np.ndarray  # [N] 1 - eps, without cancellation
    log_weight: np.ndarray  # [N]

    def integrate(self, log_values: np.ndarray) -> np.ndarray:
        """Return the log of the integral of exp(log_values [..., N]) over eps."""
        return logsumexp(log_values + self.log_weight, axis=-1)  # pyrefly: ignore


@cache
def rule(degree: int, beta: float = 1.0) -> Rule:
    """Return a rule for polynomials of `degree` in eps, under the prior eps ~ Beta(1, beta).

    It is exact to rounding up to degree EXACT, if beta is an integer; otherwise a composite rule is
    good to 2e-11 at 10,000.

    Raises:
        ValueError: If the degree or beta is too large.
    """
    finite("beta", beta, 1, SURE)
    if degree > LONGEST:
        raise ValueError(f"at most {LONGEST} steps can be measured together; got {degree}")
    needed = degree + int(np.ceil(beta - 1))
    nodes = max(16, 1 << (needed // 2).bit_length())  # more than needed // 2; few rules differ
    exact = needed <= EXACT and beta % 1 == 0  # the prior of another beta is no polynomial
    x, weight = np.polynomial.legendre.leggauss(nodes) if exact else _panels()
    eps, certain = (1 + x) / 2, (1 - x) / 2
    if not exact:  # there x is eps in (0, 1/2), mirrored
        eps, certain = np.append(x, 1 - x), np.append(1 - x, x)
        weight = np.append(weight, weight) * 2
    prior = np.log(beta) + (beta - 1) * np.log(certain)
    return Rule(eps, certain, np.log(weight / 2) + prior)


def _panels() -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights in (0, 1/2), in panels that widen by sqrt 2 from 1e-7 to 1/128."""
    edges = [0.0, 1e-7]
    while edges[-1] < 0.5:
        edges.append(min(0.5, edges[-1] + min(edges[-1] * (np.sqrt(2) - 1), 1 / 128)))
    x, weight = np.polynomial.legendre.leggauss(16)
    low, width = np.array(edges[:-1])[:, None], np.diff(edges)[:, None]
    return (low + width * (1 + x) / 2).ravel(), (width * weight / 2).ravel()


@cache
def log_table(rule: Rule, noise: Noise = "any action") -> np.ndarray:
    """Return the log-probability of a step of each kind, [kinds, N].

    Args:
        noise: "any action" is uniformly random over all L actions with probability eps, as in the
            paper; "other actions" takes one that is not best. ValueError is raised for others.
    """
    one_of("noise", noise, Noise)
    rows = []
    for best, k, L in KINDS:
        if k == L:
            rows.append(np.full(len(rule.eps), -np.log(L)))
        elif noise == "other actions":
            rows.append(np.log(rule.certain / k) if best else np.log(rule.eps / (L - k)))
        else:
            rows.append(np.log(best * rule.certain / k + rule.eps / L))
    return np.array(rows)


def log_product(
    kinds: np.ndarray, table: np.ndarray, policy: np.ndarray | None = None
) -> np.ndarray:
    """Return the log of the product of step probabilities for G policies, [G, N].

    Impossible steps give -inf.

    Args:
        kinds: [T, P] uint8, kinds of steps.
        table: [kinds, N] of `log_table`.
        policy: [T, P] int64, policy of each step, from 0; None for one policy per column.
    """
    whose = np.arange(kinds.shape[1]) if policy is None else policy
    policies = kinds.shape[1] if policy is None else int(whose.max(initial=-1)) + 1
    width = IMPOSSIBLE + 1
    flat = kinds + width * whose
    counts = np.bincount(flat.ravel(), minlength=policies * width).reshape(policies, width)
    product = counts[:, :IMPOSSIBLE].astype(float) @ table
    product[counts[:, IMPOSSIBLE] > 0] = -np.inf
    return product
