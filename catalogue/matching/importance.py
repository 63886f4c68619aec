"""Weights of a sample that was not drawn where its weights lie: how far they can be believed, and tempered until so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import genpareto

from jointplay.solver.arrays import FloatArray

LEAST_EFFECTIVE = 8.0
"""Least effective size of a sample, or half of it where it is smaller."""

TEMPERATURES = tuple(np.geomspace(1.0, 200.0, 24).tolist())


@dataclass(frozen=True, eq=False)
class Weighed:
    """A sample and its weights.

    Parameters
    ----------
    weights : ndarray, shape (n,)
        They add up to 1.
    log_mean : float
        Logarithm of the mean of the weights before that.
    effective : float
        Effective size of the sample.
    k : float
        Pareto shape of the largest weights: above 0.7 they are not to be believed (A. Vehtari et al., J. Mach. Learn.
        Res. 25 (2024) 72). It is told, and not tempered away: of a dozen weights it is known to 0.3 at best.
    """

    weights: FloatArray
    log_mean: float
    effective: float
    k: float

    @property
    def error(self) -> float:
        """Standard error of `log_mean`, to first order."""
        return float(np.sqrt(max(0.0, 1.0 / self.effective - 1.0 / len(self.weights))))


def effective_size(weights: FloatArray) -> float:
    """Return the effective size of weights (n,), (sum w)^2 / sum w^2."""
    return float(weights.sum() ** 2 / np.square(weights).sum())


def pareto_k(log_weights: FloatArray) -> float:
    """Return the shape of the generalised Pareto law of the largest weights (n,); -1 where they are all the same."""
    count = max(5, min(len(log_weights) // 5, int(3 * np.sqrt(len(log_weights)))))
    if len(log_weights) <= count:
        return 0.0
    top = np.exp(np.sort(log_weights)[-count - 1 :] - log_weights.max())
    excess = top[1:] - top[0]
    if excess[-1] < 1e-12:
        return -1.0
    return float(genpareto.fit(excess, floc=0.0)[0])


def weigh(samples: list[FloatArray]) -> tuple[list[Weighed], float]:
    """Weigh samples by tempered weights: the least temperature that all of them bear.

    Parameters
    ----------
    samples : list of ndarray, each (n,)
        Logarithms of weights: likelihood times importance.

    Returns
    -------
    weighed : list of Weighed
    temperature : float
        What logarithms were divided by, >= 1.

    Notes
    -----
    Transformed weights of a population Monte Carlo: E. Koblents, J. Miguez, Stat. Comput. 25 (2015) 407. A sample of
    some dozens in as many dimensions has next to all of its weight in one case; tempered it is as sure as it may be.
    """
    found: list[Weighed] = []
    temperature = TEMPERATURES[-1]
    for temperature in TEMPERATURES:
        found = [_weighed(each / temperature) for each in samples]
        least = [min(LEAST_EFFECTIVE, 0.5 * len(each)) for each in samples]
        if all(w.effective >= enough for w, enough in zip(found, least, strict=True)):
            break
    return found, temperature


def _weighed(log_weights: FloatArray) -> Weighed:
    total = float(logsumexp(log_weights))
    weights = np.exp(log_weights - total)
    return Weighed(weights, total - float(np.log(len(weights))), effective_size(weights), pareto_k(log_weights))
