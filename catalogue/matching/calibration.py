"""From scores to probabilities that mean what they say: held-out draws, temperature, tails, quality figures.

Everything here is fitted on draws the matcher has not learned from. Rows made from one simulated case are always held
out together, because they share everything but the noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import logsumexp, softmax

from jointplay.catalogue.matching.matcher import TrainingSet
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

TEMPERATURES = (0.5, 8.0)
"""Range in which a temperature is sought; 1 leaves probabilities as they are, more makes them less sure."""

TAIL = 0.2
"""Share of the held-out values that the law of their tail is fitted to."""

LEAST_P_VALUE = 1e-9
"""Smallest p-value that is told: beyond it the law of a tail is no longer to be believed."""


def folds(training: TrainingSet, count: int, seed: int = 0) -> Iterator[tuple[TrainingSet, TrainingSet]]:
    """Split a training set into (learned, held out) pairs so that every row is held out exactly once.

    Parameters
    ----------
    training : TrainingSet
    count : int
        Number of splits, >= 2. A hypothesis with fewer cases than that is split by rows.
    seed : int
        Of the shuffling of cases; the same seed gives the same splits.

    Yields
    ------
    learned, held_out : TrainingSet
        Both hold all hypotheses, in the same order.
    """
    generator = np.random.default_rng(seed)
    assigned: list[IntArray] = []
    for draws in training.hypotheses:
        _, case = np.unique(draws.entry, return_inverse=True)
        if draws.cases < count:
            case = np.arange(len(draws.entry))
        order = generator.permutation(int(case.max()) + 1)
        assigned.append((order % count)[case].astype(np.int64))
    for fold in range(count):
        parts = list(zip(training.hypotheses, assigned, strict=True))
        learned = tuple(draws.rows(part != fold) for draws, part in parts)
        held = tuple(draws.rows(part == fold) for draws, part in parts)
        yield replace(training, hypotheses=learned), replace(training, hypotheses=held)


def is_held_out(entry: IntArray) -> BoolArray:
    """Return which entries nothing that is calibrated may learn from: a fifth of them, whoever asks.

    Draws of a hypothesis follow each other in a pattern that fills their range, so that every fifth one would be one
    part of it; numbers are scrambled first (Fibonacci hashing: D. E. Knuth, The Art of Computer Programming 3, 6.4).
    """
    scrambled = (entry.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    out: BoolArray = (scrambled >> np.uint64(40)) % np.uint64(5) == 0
    return out


def split_held_out(training: TrainingSet) -> tuple[TrainingSet, TrainingSet]:
    """Split a training set into what may be learned and what :func:`is_held_out` keeps for calibration.

    Where that leaves fewer than two cases of a hypothesis on a side, every fifth of its cases is held out; of a single
    case, every fifth row.
    """
    learned, held = [], []
    for draws in training.hypotheses:
        cases, case = np.unique(draws.entry, return_inverse=True)
        apart = is_held_out(cases)[case]
        if not 2 <= np.sum(is_held_out(cases)) <= len(cases) - 2:
            apart = (case if len(cases) > 1 else np.arange(len(case))) % 5 == 0
        learned.append(draws.rows(~apart))
        held.append(draws.rows(apart))
    return replace(training, hypotheses=tuple(learned)), replace(training, hypotheses=tuple(held))


def probabilities(log_evidence: FloatArray) -> FloatArray:
    """Turn log evidences (m, h), priors included, into probabilities (m, h)."""
    out: FloatArray = softmax(log_evidence, axis=1)
    return out


def log_loss(posterior: FloatArray, truth: IntArray) -> float:
    """Return the mean of -ln p(true hypothesis); probabilities below 1e-12 count as 1e-12."""
    return float(-np.mean(np.log(np.maximum(posterior[np.arange(len(truth)), truth], 1e-12))))


def calibration_error(posterior: FloatArray, truth: IntArray, bins: int = 10) -> float:
    """Return the expected calibration error of the top probability, over equally wide bins of confidence."""
    top = posterior.max(axis=1)
    right = posterior.argmax(axis=1) == truth
    index = np.minimum((top * bins).astype(int), bins - 1)
    error = 0.0
    for k in range(bins):
        inside = index == k
        if inside.any():
            error += inside.mean() * abs(float(top[inside].mean()) - float(right[inside].mean()))
    return float(error)


def fit_temperature(
    log_evidence: FloatArray, truth: IntArray, weights: FloatArray, between: tuple[float, float] = TEMPERATURES
) -> float:
    """Return the temperature with the least weighted log-loss on held-out rows.

    Parameters
    ----------
    log_evidence : ndarray, shape (m, h)
    truth : ndarray of int, shape (m,)
        Index of the true hypothesis of each row.
    weights : ndarray, shape (m,)
        So that a hypothesis with many rows does not count more than one with few.
    between : tuple of float
        Range searched.
    """
    rows = np.arange(len(truth))

    def loss(log_temperature: float) -> float:
        scaled = log_evidence * np.exp(-log_temperature)
        return float(np.sum(weights * (logsumexp(scaled, axis=1) - scaled[rows, truth])))

    low, high = np.log(between)
    found = minimize_scalar(loss, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-3})
    return float(np.exp(found.x))


def fit_shares(first: FloatArray, second: FloatArray, truth: IntArray, weights: FloatArray) -> tuple[float, float]:
    """Return the exponents of two opinions whose product has the least weighted log-loss on held-out rows.

    Parameters
    ----------
    first, second : ndarray, shape (m, h)
        Log evidences.
    truth : ndarray of int, shape (m,)
    weights : ndarray, shape (m,)
        As for :func:`fit_temperature`.

    Notes
    -----
    A logarithmic opinion pool (C. Genest, J. V. Zidek, Stat. Sci. 1 (1986) 114); its loss is convex in the exponents.
    """
    rows = np.arange(len(truth))

    def loss(shares: FloatArray) -> tuple[float, FloatArray]:
        scaled = shares[0] * first + shares[1] * second
        total = logsumexp(scaled, axis=1)
        posterior = np.exp(scaled - total[:, None])
        slope = [
            float(np.sum(weights * ((posterior * each).sum(axis=1) - each[rows, truth]))) for each in (first, second)
        ]
        return float(np.sum(weights * (total - scaled[rows, truth]))), np.array(slope)

    found = minimize(loss, np.array([0.3, 0.7]), jac=True, method="L-BFGS-B", bounds=[(1e-3, 2.0), (0.0, 2.0)])
    return float(found.x[0]), float(found.x[1])


@dataclass(frozen=True, eq=False)
class Tail:
    """Held-out values of a statistic that is large where the model fails.

    Parameters
    ----------
    values : ndarray, shape (n,)
        In rising order.

    Notes
    -----
    Among the largest fifth of the values, and beyond them, p-values follow an exponential law of the mean excess over
    the 80 % quantile: the limit for thin tails (J. Pickands, Ann. Stat. 3 (1975) 119). A hundred held-out draws can so
    tell a value far outside of them from one that just is the largest.
    """

    values: FloatArray

    @classmethod
    def of(cls, values: FloatArray) -> Tail:
        """Make a tail from values in any order."""
        return cls(np.sort(values))

    def p_value(self, value: float) -> float:
        """Return the probability of a value at least as large, in (0, 1]."""
        n = len(self.values)
        count = n - int(np.searchsorted(self.values, value, side="left"))
        empirical = (1.0 + count) / (1.0 + n)
        top = max(1, round(TAIL * n))
        start = n - top - 1
        if start < 0 or value <= self.values[start]:
            return empirical
        excess = float(np.mean(self.values[start + 1 :]) - self.values[start])
        begin = (1.0 + top) / (1.0 + n)
        if excess <= 0.0:
            return LEAST_P_VALUE
        return max(LEAST_P_VALUE, begin * math.exp(-(value - float(self.values[start])) / excess))


def combine(first: float, second: float, share: float = 0.5) -> float:
    """Combine two p-values of the same question, without assuming independence (Bonferroni, weighted).

    Parameters
    ----------
    first, second : float
    share : float
        Part of the false alarms that the first may cause, in (0, 1).
    """
    return min(1.0, first / share, second / (1.0 - share))


def row_weights(index: NDArray[np.integer]) -> FloatArray:
    """Return a weight for each row such that every hypothesis index weighs the same; they add up to 1."""
    _, inverse, counts = np.unique(index, return_inverse=True, return_counts=True)
    weights: FloatArray = 1.0 / counts[inverse] / len(counts)
    return weights


def largest(z: FloatArray, watched: BoolArray, count: int = 3) -> FloatArray:
    """Return the mean of the `count` largest absolute z-scores among the watched features of each row; 0 if none."""
    chosen = np.abs(z[:, watched])
    if chosen.shape[1] == 0:
        return np.zeros(len(z))
    top = np.sort(chosen, axis=1)[:, -count:]
    mean: FloatArray = top.mean(axis=1)
    return mean
