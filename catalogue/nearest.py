"""Nearest entry in clipped decibels: the plain cross-check of the probabilistic matcher.

A hypothesis is as far away as the nearest of its draws. Nothing is modelled between draws; what makes probabilities and
intervals of it are the errors the same rule makes on held-out draws.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from catalogue.calibration import Tail, fit_temperature, folds, probabilities, row_weights
from catalogue.errors import MatchingError
from catalogue.matching import (
    ClearanceEstimate,
    FloatArray,
    HypothesisMatch,
    IntArray,
    MatchResult,
    TrainingSet,
    ranked,
)


@dataclass(frozen=True)
class DecibelDistance:
    """Root mean square difference of two feature vectors, dB."""

    def pair(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two vectors (d,): the definition."""
        return float(np.sqrt(np.mean((first - second) ** 2)))

    def block(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the distances (m, n) of all rows of `first` (m, d) from all rows of `second` (n, d)."""
        shift = second.mean(axis=0)  # close vectors far from the origin would lose digits in the products
        a, b = first - shift, second - shift
        squared = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1)[None, :] - 2.0 * a @ b.T
        distances: FloatArray = np.sqrt(np.maximum(squared, 0.0) / first.shape[1])
        return distances


@dataclass(frozen=True)
class NearestEntry:
    """Settings of the method; :meth:`fit` learns a training set.

    Parameters
    ----------
    fold_count : int
        Parts the draws are split into for calibration.
    """

    fold_count: int = 4
    name: str = field(default="nearest-entry", init=False)
    version: str = field(default="1", init=False)

    def fit(self, training: TrainingSet) -> FittedNearest:
        """Learn a training set and calibrate on folds of it.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than two draws.
        """
        for draws in training.hypotheses:
            if len(draws.features) < 2:
                raise MatchingError(f"hypothesis {draws.label}: {len(draws.features)} draws: must be at least 2")
        count = len(training.hypotheses)
        evidence: list[FloatArray] = []
        truth: list[IntArray] = []
        distances: list[list[FloatArray]] = [[] for _ in range(count)]
        errors: list[list[FloatArray]] = [[] for _ in range(count)]
        for learned, held in folds(training, self.fold_count):
            features, index = held.stacked()
            nearest, which = _nearest(learned, features)
            evidence.append(_log_evidence(learned, nearest))
            truth.append(index)
            for h, draws in enumerate(held.hypotheses):
                own = index == h
                distances[h].append(nearest[own, h])
                errors[h].append(draws.log_clearance - learned.hypotheses[h].log_clearance[which[own, h]])
        stacked = np.concatenate(truth)
        temperature = fit_temperature(np.concatenate(evidence), stacked, row_weights(stacked), between=(1e-3, 1e3))
        return FittedNearest(
            training,
            temperature,
            tuple(Tail.of(np.concatenate(values)) for values in distances),
            tuple(np.quantile(np.concatenate(values), [0.05, 0.5, 0.95], axis=0) for values in errors),
        )


def _nearest(training: TrainingSet, features: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distance and row of the nearest draw of every hypothesis, each (m, hypotheses)."""
    metric = DecibelDistance()
    near = np.empty((len(features), len(training.hypotheses)))
    which = np.empty(near.shape, np.int64)
    for h, draws in enumerate(training.hypotheses):
        distances = metric.block(features, draws.features)
        which[:, h] = distances.argmin(axis=1)
        near[:, h] = distances[np.arange(len(features)), which[:, h]]
    return near, which


def _log_evidence(training: TrainingSet, nearest: FloatArray) -> FloatArray:
    prior = np.log([draws.prior for draws in training.hypotheses])
    evidence: FloatArray = -0.5 * nearest**2 + prior
    return evidence


@dataclass(frozen=True)
class FittedNearest:
    """A learned training set; answers one feature vector or a block of them.

    Parameters
    ----------
    training : TrainingSet
    temperature : float
        Variance, dB^2, a squared distance is divided by to become a log probability.
    distances : tuple of Tail
        Held-out distances per hypothesis.
    errors : tuple of ndarray, each (3, k)
        5, 50 and 95 % quantiles of the held-out error of ln(clearance), per hypothesis.
    """

    training: TrainingSet
    temperature: float
    distances: tuple[Tail, ...]
    errors: tuple[FloatArray, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in the order of the training set."""
        return self.training.labels

    def posterior(self, features: FloatArray) -> FloatArray:
        """Return the probabilities (m, hypotheses) of a block of feature vectors (m, d)."""
        nearest, _ = _nearest(self.training, features)
        return probabilities(_log_evidence(self.training, nearest), self.temperature)

    def match(self, feature: FloatArray) -> MatchResult:
        """Return the full answer for one feature vector (d,).

        Raises
        ------
        MatchingError
            The vector has another length than those learned, or is not finite.
        """
        expected = self.training.length
        if feature.shape != (expected,) or not np.isfinite(feature).all():
            raise MatchingError(f"feature vector of shape {feature.shape}: must be {expected} finite numbers")
        nearest, which = _nearest(self.training, feature[None, :])
        posterior = probabilities(_log_evidence(self.training, nearest), self.temperature)[0]
        matches = []
        for h, draws in enumerate(self.training.hypotheses):
            row = which[0, h]
            estimates = []
            for j, value in enumerate(draws.log_clearance[row]):
                low, median, high = np.exp(value + self.errors[h][:, j])
                estimates.append(ClearanceEstimate(draws.joints[j], float(median), float(low), float(high)))
            spread = draws.features.std(axis=0)
            if draws.log_clearance.shape[1]:
                # Draws of about the same clearance say how far levels scatter at one clearance.
                offset = np.linalg.norm(draws.log_clearance - draws.log_clearance[row], axis=1)
                close = np.argsort(offset, kind="stable")[: max(8, len(offset) // 12)]
                spread = draws.features[close].std(axis=0)
            matches.append(
                HypothesisMatch(
                    draws.label,
                    draws.joints,
                    float(posterior[h]),
                    tuple(estimates),
                    float(nearest[0, h]),
                    self.distances[h].p_value(float(nearest[0, h])),
                    draws.features[row],
                    spread,
                )
            )
        return ranked(matches)
