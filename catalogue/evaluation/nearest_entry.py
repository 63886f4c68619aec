"""The nearest entry of every hypothesis, whatever "near" means: in decibels, or by the cosine of spectra.

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
    DrawnFeatures,
    HypothesisMatch,
    MatchResult,
    TrainingSet,
    rank,
)
from jointplay.solver.arrays import FloatArray, IntArray

FOLDS = 4
"""Parts that draws are split into for calibration."""


class Metric(Protocol):
    """How far two feature vectors are from each other."""

    def pair(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two vectors (d,): the definition."""

    def block(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the distances (m, n) of all rows of `first` (m, d) from all rows of `second` (n, d)."""


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
class ChordDistance:
    """Distance of two feature vectors without their means on the unit sphere, sqrt(2 - 2 cos): 0 to 2.

    Levels are centred because the mean level would make all spectra alike.
    """

    def pair(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two vectors (d,): the definition."""
        a, b = first - first.mean(), second - second.mean()
        cosine = float(a @ b) / float(np.sqrt((a @ a) * (b @ b)) or 1.0)
        return float(np.sqrt(max(0.0, 2.0 - 2.0 * cosine)))

    def block(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the distances (m, n) of all rows of `first` (m, d) from all rows of `second` (n, d)."""
        distances: FloatArray = np.sqrt(np.maximum(0.0, 2.0 - 2.0 * _unit(first) @ _unit(second).T))
        return distances


def _unit(rows: FloatArray) -> FloatArray:
    centred = rows - rows.mean(axis=1, keepdims=True)
    norm = np.linalg.norm(centred, axis=1, keepdims=True)
    unit: FloatArray = centred / np.where(norm > 0.0, norm, 1.0)
    return unit


@dataclass(frozen=True)
class NearestEntry:
    """The method; :meth:`fit` learns a training set.

    Parameters
    ----------
    metric : Metric
    name, version : str
    """

    metric: Metric = DecibelDistance()
    name: str = "nearest-entry"
    version: str = "3"

    def fit(self, training: TrainingSet) -> FittedEntries:
        """Learn a training set and calibrate on folds of it.

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
        for learned, held in folds(training, FOLDS):
            features, index = held.stack()
            near, which = _nearest(self.metric, learned, features)
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
            self.metric,
            training,
            temperature,
            tuple(Tail.of(np.concatenate(values)) for values in distances),
            tuple(error_quantiles(np.concatenate(values)) for values in errors),
            Conformal.fit(_posterior(training, joined, temperature), stacked, weights),
        )


def cosine_entry() -> NearestEntry:
    """Return the method that libraries of spectra are usually searched by: cosine similarity."""
    return NearestEntry(ChordDistance(), "cosine", "2")


def _nearest(metric: Metric, training: TrainingSet, features: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distance and row of the nearest draw of every hypothesis, each (m, hypotheses)."""
    near = np.empty((len(features), len(training.hypotheses)))
    which = np.empty(near.shape, np.int64)
    for h, draws in enumerate(training.hypotheses):
        distances = metric.block(features, draws.features)
        which[:, h] = distances.argmin(axis=1)
        near[:, h] = distances[np.arange(len(features)), which[:, h]]
    return near, which


def error_quantiles(errors: FloatArray) -> FloatArray:
    """Return 5, 50 and 95 % quantiles (3, k) of held-out errors of ln(clearance) (n, k)."""
    found: FloatArray = np.quantile(errors, [0.05, 0.5, 0.95], axis=0)
    return found


def estimates(joints: tuple[str, ...], value: FloatArray, errors: FloatArray) -> tuple[ClearanceEstimate, ...]:
    """Return clearances of joints, from ln(clearance) (k,) and the quantiles of its error (3, k)."""
    low, median, high = np.exp(value + errors).tolist()
    # A hypothesis may know its joints, and not their clearances.
    return tuple(ClearanceEstimate(*each) for each in zip(joints, median, low, high, strict=False))


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
        near, _ = _nearest(self.metric, self.training, features[:, : self.training.length])
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
        near, which = _nearest(self.metric, self.training, feature[None, :])
        posterior = _posterior(self.training, -0.5 * near**2, self.temperature)[0]
        matches = []
        for h, draws in enumerate(self.training.hypotheses):
            row = int(which[0, h])
            matches.append(
                HypothesisMatch(
                    draws.label,
                    draws.joints,
                    float(posterior[h]),
                    estimates(draws.joints, draws.log_clearance[row], self.errors[h]),
                    float(np.sqrt(np.mean((feature - draws.features[row]) ** 2))),
                    self.distances[h].p_value(float(near[0, h])),
                    draws.features[row],
                    _spread(draws, row),
                )
            )
        return rank(matches, self.conformal)


def _spread(draws: DrawnFeatures, row: int) -> FloatArray:
    """Return how far levels scatter at one clearance, by the draws of about the same one."""
    if not draws.log_clearance.shape[1]:
        whole: FloatArray = draws.features.std(axis=0)
        return whole
    offset = np.linalg.norm(draws.log_clearance - draws.log_clearance[row], axis=1)
    close = np.argsort(offset, kind="stable")[: max(8, len(offset) // 12)]
    spread: FloatArray = draws.features[close].std(axis=0)
    return spread
