"""Matching by the nearest entry of every hypothesis, whatever "near" means.

A hypothesis is as far away as the nearest of its draws. Nothing is modelled between draws; what makes probabilities and
intervals of it are the errors the same rule makes on held-out draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.matching.calibration import Tail, fit_temperature, folds, probabilities, row_weights
from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.matcher import (
    ClearanceEstimate,
    Draws,
    FloatArray,
    HypothesisMatch,
    IntArray,
    MatchResult,
    TrainingSet,
    ranked,
)


class Metric(Protocol):
    """How far two feature vectors are from each other."""

    def pair(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two vectors (d,): the definition."""

    def block(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the distances (m, n) of all rows of `first` (m, d) from all rows of `second` (n, d)."""


def fit_entries(metric: Metric, training: TrainingSet, fold_count: int) -> FittedEntries:
    """Learn a training set and calibrate on folds of it.

    Parameters
    ----------
    metric : Metric
    training : TrainingSet
    fold_count : int
        Parts the draws are split into for calibration.

    Raises
    ------
    MatchingError
        A hypothesis has fewer than two draws.
    """
    for draws in training.hypotheses:
        if len(draws.features) < 2:
            raise MatchingError(f"hypothesis {draws.label}: {len(draws.features)} draws: must be at least 2")
    training = training.only_levels()
    count = len(training.hypotheses)
    evidence: list[FloatArray] = []
    truth: list[IntArray] = []
    distances: list[list[FloatArray]] = [[] for _ in range(count)]
    errors: list[list[FloatArray]] = [[] for _ in range(count)]
    for learned, held in folds(training, fold_count):
        features, index = held.stacked()
        near, which = nearest(metric, learned, features)
        evidence.append(-0.5 * near**2)
        truth.append(index)
        for h, draws in enumerate(held.hypotheses):
            own = index == h
            distances[h].append(near[own, h])
            errors[h].append(draws.log_clearance - learned.hypotheses[h].log_clearance[which[own, h]])
    stacked, joined = np.concatenate(truth), np.concatenate(evidence)
    weights = row_weights(stacked)
    temperature = fit_temperature(joined, stacked, weights, between=(1e-6, 1e3))
    return FittedEntries(
        metric,
        training,
        temperature,
        tuple(Tail.of(np.concatenate(values)) for values in distances),
        tuple(np.quantile(np.concatenate(values), [0.05, 0.5, 0.95], axis=0) for values in errors),
        Conformal.fit(_posterior(training, joined, temperature), stacked, weights),
    )


def nearest(metric: Metric, training: TrainingSet, features: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distance and row of the nearest draw of every hypothesis, each (m, hypotheses)."""
    near = np.empty((len(features), len(training.hypotheses)))
    which = np.empty(near.shape, np.int64)
    for h, draws in enumerate(training.hypotheses):
        distances = metric.block(features, draws.features)
        which[:, h] = distances.argmin(axis=1)
        near[:, h] = distances[np.arange(len(features)), which[:, h]]
    return near, which


def _posterior(training: TrainingSet, log_evidence: FloatArray, temperature: float) -> FloatArray:
    """Return probabilities (m, hypotheses); the prior is not scaled, because a distance has a unit and it has none."""
    prior = np.log([draws.prior for draws in training.hypotheses])
    return probabilities(log_evidence / temperature + prior)


@dataclass(frozen=True, eq=False)
class FittedEntries:
    """A learned training set; answers one feature vector or a block of them.

    Parameters
    ----------
    metric : Metric
    training : TrainingSet
    temperature : float
        Variance a squared distance is divided by to become a log probability.
    distances : tuple of Tail
        Held-out distances per hypothesis.
    errors : tuple of ndarray, each (3, k)
        5, 50 and 95 % quantiles of the held-out error of ln(clearance), per hypothesis.
    conformal : Conformal
    """

    metric: Metric
    training: TrainingSet
    temperature: float
    distances: tuple[Tail, ...]
    errors: tuple[FloatArray, ...]
    conformal: Conformal

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in the order of the training set."""
        return self.training.labels

    def posterior(self, features: FloatArray) -> FloatArray:
        """Return the probabilities (m, hypotheses) of a block of feature vectors (m, d)."""
        near, _ = nearest(self.metric, self.training, features[:, : self.training.length])
        return _posterior(self.training, -0.5 * near**2, self.temperature)

    def match(self, feature: FloatArray) -> MatchResult:
        """Return the full answer for one feature vector (d,).

        Raises
        ------
        MatchingError
            The vector has another length than those learned, or is not finite.
        """
        expected = self.training.length
        if feature.ndim != 1 or len(feature) < expected or not np.isfinite(feature).all():
            raise MatchingError(f"feature vector of shape {feature.shape}: must be {expected} finite numbers")
        feature = feature[:expected]
        near, which = nearest(self.metric, self.training, feature[None, :])
        posterior = _posterior(self.training, -0.5 * near**2, self.temperature)[0]
        matches = []
        for h, draws in enumerate(self.training.hypotheses):
            row = int(which[0, h])
            estimates = []
            for j, value in enumerate(draws.log_clearance[row]):
                low, median, high = np.exp(value + self.errors[h][:, j])
                estimates.append(ClearanceEstimate(draws.joints[j], float(median), float(low), float(high)))
            matches.append(
                HypothesisMatch(
                    draws.label,
                    draws.joints,
                    float(posterior[h]),
                    tuple(estimates),
                    float(np.sqrt(np.mean((feature - draws.features[row]) ** 2))),
                    self.distances[h].p_value(float(near[0, h])),
                    draws.features[row],
                    _spread(draws, row),
                )
            )
        return ranked(matches, self.conformal)


def _spread(draws: Draws, row: int) -> FloatArray:
    """Return how far levels scatter at one clearance, by the draws of about the same one."""
    if not draws.log_clearance.shape[1]:
        whole: FloatArray = draws.features.std(axis=0)
        return whole
    offset = np.linalg.norm(draws.log_clearance - draws.log_clearance[row], axis=1)
    close = np.argsort(offset, kind="stable")[: max(8, len(offset) // 12)]
    spread: FloatArray = draws.features[close].std(axis=0)
    return spread
