"""Gaussian along the clearance: a curve with a tube around it for every hypothesis.

Feature vectors are whitened by a linear discriminant analysis. In the few directions that are left, every hypothesis is
a curve over the logarithm of its clearance (a surface for two joints) with a covariance that changes along it; a
measurement is judged by its distance from each curve. The method and its derivation are in ``docs/diagnosis.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar
from scipy.special import gammaln, logsumexp

from catalogue.calibration import (
    TEMPERATURES,
    Tail,
    combined,
    fit_temperature,
    folds,
    largest,
    probabilities,
    row_weights,
)
from catalogue.errors import MatchingError
from catalogue.matching import (
    BoolArray,
    ClearanceEstimate,
    Draws,
    FloatArray,
    HypothesisMatch,
    IntArray,
    MatchResult,
    TrainingSet,
    ranked,
)
from catalogue.tube import ClearanceGrid, Tube, fit_tube


@dataclass(frozen=True)
class GaussianAlongClearance:
    """Settings of the method; :meth:`fit` learns a training set.

    Parameters
    ----------
    directions : int
        Discriminant directions kept with many draws.
    within_shrinkage : float
        Share of the within-class scatter replaced by its mean variance in all directions.
    kernel : tuple of float
        Width of the Gaussian kernel in ln(clearance), for hypotheses of one and of two joints.
    points : tuple of int
        Points of the clearance grid along each joint, for one and two joints.
    stride, full_stride : tuple of int
        Every so many points along a joint carry a covariance of their own, for one and two joints: in the whitened
        space, and in the full one that only judges how well a hypothesis fits.
    refinement : int
        Steps between two points, at which means are interpolated.
    bins : tuple of int
        Bins of each clearance that are classes of the discriminant analysis, for one and two joints.
    few_cases : int
        With fewer simulated cases a hypothesis the settings marked `sparse_` are used.
    degrees_of_freedom : float
        Of the Student-t likelihood; small ones forgive outliers.
    ridge : float
        Share of the mean variance added to every local variance.
    fold_count : int
        Parts the draws are split into for calibration.
    """

    directions: int = 30
    within_shrinkage: float = 0.005
    kernel: tuple[float, float] = (0.35, 0.55)
    sparse_directions: int = 15
    sparse_within_shrinkage: float = 0.02
    sparse_kernel: tuple[float, float] = (0.5, 0.8)
    few_cases: int = 60
    points: tuple[int, int] = (24, 10)
    stride: tuple[int, int] = (2, 1)
    full_stride: tuple[int, int] = (2, 2)
    bins: tuple[int, int] = (6, 3)
    refinement: int = 4
    degrees_of_freedom: float = 8.0
    ridge: float = 0.05
    fold_count: int = 4
    name: str = field(default="gaussian-along-clearance", init=False)
    version: str = field(default="1", init=False)

    def fit(self, training: TrainingSet) -> FittedGaussian:
        """Learn a training set and calibrate on folds of it.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than three draws, or more than two clearances to be told apart.
        """
        for draws in training.hypotheses:
            if len(draws.features) < 3:
                raise MatchingError(f"hypothesis {draws.label}: {len(draws.features)} draws: must be at least 3")
            if draws.log_clearance.shape[1] > 2:
                raise MatchingError(f"hypothesis {draws.label}: clearances of {draws.joints}: must be at most 2")
        sparse = training.cases < self.few_cases
        bare = _learn(self, training, sparse)
        return FittedGaussian(bare, _calibrate(self, training, sparse))


def _discriminant(training: TrainingSet, bins: tuple[int, int], directions: int, shrinkage: float) -> FloatArray:
    """Return the projection (d, r) of a linear discriminant analysis, classes = hypothesis x clearance bin."""
    features, hypothesis = training.stacked()
    share = row_weights(hypothesis)
    overall = share @ features
    d = training.length
    within = np.zeros((d, d))
    between = np.zeros((d, d))
    classes = 0
    for h, draws in enumerate(training.hypotheses):
        weight = share[hypothesis == h][0]
        label = np.zeros(len(draws.features), np.int64)
        for column in draws.log_clearance.T:
            count = bins[draws.log_clearance.shape[1] - 1]
            place = count * (column - column.min()) / (float(np.ptp(column)) or 1.0)
            label = label * count + np.minimum(place.astype(np.int64), count - 1)
        for value in np.unique(label):
            rows = draws.features[label == value]
            centre = rows.mean(axis=0)
            within += weight * (rows - centre).T @ (rows - centre)
            between += weight * len(rows) * np.outer(centre - overall, centre - overall)
            classes += 1
    mean_variance = float(np.trace(within)) / d
    within *= 1.0 - shrinkage
    within[np.diag_indices(d)] += shrinkage * mean_variance + 1e-9
    kept = max(1, min(directions, d, classes - 1))
    _, vectors = eigh(between, within, subset_by_index=[d - kept, d - 1])
    projection: FloatArray = vectors[:, ::-1]
    return projection


@dataclass(frozen=True)
class _Hypothesis:
    draws: Draws
    grid: ClearanceGrid
    whitened: Tube
    full: Tube


@dataclass(frozen=True)
class _Bare:
    """The fitted model before calibration."""

    projection: FloatArray
    hypotheses: tuple[_Hypothesis, ...]
    watched: BoolArray
    degrees_of_freedom: float

    def log_likelihood(self, features: FloatArray) -> list[FloatArray]:
        """Return for every hypothesis the log density (m, f) at each fine point of its clearance grid."""
        z = features @ self.projection
        d = z.shape[1]
        nu = self.degrees_of_freedom
        constant = float(gammaln(0.5 * (nu + d)) - gammaln(0.5 * nu)) - 0.5 * d * float(np.log((nu - 2.0) * np.pi))
        out = []
        for item in self.hypotheses:
            squared = item.whitened.squared_distance(z)
            half = 0.5 * item.whitened.log_determinant[item.whitened.nearest]
            out.append(constant - half[None, :] - 0.5 * (nu + d) * np.log1p(squared / (nu - 2.0)))
        return out

    def log_evidence(self, curves: Sequence[FloatArray]) -> FloatArray:
        """Average the likelihood over a log-uniform clearance and multiply with the prior: (m, hypotheses)."""
        columns = [
            logsumexp(curve, axis=1) - np.log(curve.shape[1]) + np.log(item.draws.prior)
            for curve, item in zip(curves, self.hypotheses, strict=True)
        ]
        return np.stack(columns, axis=1)

    def surprise(self, features: FloatArray, index: int, best: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return full-space distance (m,) and mean of the largest watched z (m,) at the points `best` (m,)."""
        full = self.hypotheses[index].full
        z = (features - full.mean[best]) / full.spread_at(best)
        return full.distance_at(features, best), largest(z, self.watched)


def _learn(settings: GaussianAlongClearance, training: TrainingSet, sparse: bool) -> _Bare:
    directions = settings.sparse_directions if sparse else settings.directions
    shrinkage = settings.sparse_within_shrinkage if sparse else settings.within_shrinkage
    kernel = settings.sparse_kernel if sparse else settings.kernel
    projection = _discriminant(training, settings.bins, directions, shrinkage)
    hypotheses = []
    for draws in training.hypotheses:
        k = max(draws.log_clearance.shape[1], 1)
        # Both grids have the same points and differ only in how many of them carry a covariance.
        grid, full_grid = (
            ClearanceGrid.over(draws.log_clearance, settings.points[k - 1], settings.refinement, stride[k - 1])
            for stride in (settings.stride, settings.full_stride)
        )
        whitened, full = (
            fit_tube(features, draws.log_clearance, each, cases=draws.cases, width=kernel[k - 1], ridge=settings.ridge)
            for features, each in ((draws.features @ projection, grid), (draws.features, full_grid))
        )
        hypotheses.append(_Hypothesis(draws, grid, whitened, full))
    return _Bare(projection, tuple(hypotheses), training.watched, settings.degrees_of_freedom)


@dataclass(frozen=True)
class Calibration:
    """What was fitted on held-out draws.

    Parameters
    ----------
    temperature : float
        Of the hypothesis probabilities.
    clearance_temperature : float
        Of the clearance posterior.
    distances, orders : tuple of Tail
        Per hypothesis: full-space distance, and mean of the largest watched z.
    """

    temperature: float
    clearance_temperature: float
    distances: tuple[Tail, ...]
    orders: tuple[Tail, ...]


def _calibrate(settings: GaussianAlongClearance, training: TrainingSet, sparse: bool) -> Calibration:
    evidence: list[FloatArray] = []
    truth: list[IntArray] = []
    count = len(training.hypotheses)
    distances: list[list[FloatArray]] = [[] for _ in range(count)]
    orders: list[list[FloatArray]] = [[] for _ in range(count)]
    own: list[tuple[FloatArray, IntArray]] = []
    for learned, held in folds(training, settings.fold_count):
        bare = _learn(settings, learned, sparse)
        features, index = held.stacked()
        curves = bare.log_likelihood(features)
        evidence.append(bare.log_evidence(curves))
        truth.append(index)
        for h, draws in enumerate(held.hypotheses):
            curve = curves[h][index == h]
            distance, order = bare.surprise(draws.features, h, curve.argmax(axis=1).astype(np.int64))
            distances[h].append(distance)
            orders[h].append(order)
            if draws.log_clearance.shape[1] == 1:
                fine = bare.hypotheses[h].grid.fine[:, 0]
                place = np.abs(fine[None, :] - draws.log_clearance).argmin(axis=1)
                own.append((curve, place.astype(np.int64)))
    stacked = np.concatenate(truth)
    return Calibration(
        fit_temperature(np.concatenate(evidence), stacked, row_weights(stacked)),
        _clearance_temperature(own),
        tuple(Tail.of(np.concatenate(values)) for values in distances),
        tuple(Tail.of(np.concatenate(values)) for values in orders),
    )


def _clearance_temperature(own: Sequence[tuple[FloatArray, IntArray]]) -> float:
    """Return the temperature with the least mean -ln density at the true clearance of held-out draws."""
    if not own:
        return 1.0

    def loss(log_temperature: float) -> float:
        scale = float(np.exp(-log_temperature))
        total = 0.0
        for curve, place in own:
            scaled = curve * scale
            total += float(np.sum(logsumexp(scaled, axis=1) - scaled[np.arange(len(place)), place]))
        return total

    low, high = np.log(TEMPERATURES)
    found = minimize_scalar(loss, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-2})
    return float(np.exp(found.x))


def _estimate(joint: str, axis: FloatArray, density: FloatArray) -> ClearanceEstimate:
    """Return median and central 90 % interval of a posterior given at evenly spaced points of ln(clearance)."""
    if len(axis) == 1:
        value = float(np.exp(axis[0]))
        return ClearanceEstimate(joint, value, value, value)
    # Each point stands for the cell around it, halves at the ends.
    step = axis[1] - axis[0]
    edges = np.clip(np.r_[axis - 0.5 * step, axis[-1] + 0.5 * step], axis[0], axis[-1])
    cumulated = np.r_[0.0, np.cumsum(density)]
    low, median, high = np.exp(np.interp([0.05, 0.5, 0.95], cumulated / cumulated[-1], edges))
    return ClearanceEstimate(joint, float(median), float(low), float(high))


@dataclass(frozen=True)
class FittedGaussian:
    """A learned training set; answers one feature vector or a block of them."""

    model: _Bare
    calibration: Calibration

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in the order of the training set."""
        return tuple(item.draws.label for item in self.model.hypotheses)

    def posterior(self, features: FloatArray) -> FloatArray:
        """Return the probabilities (m, hypotheses) of a block of feature vectors (m, d)."""
        evidence = self.model.log_evidence(self.model.log_likelihood(features))
        return probabilities(evidence, self.calibration.temperature)

    def match(self, feature: FloatArray) -> MatchResult:
        """Return the full answer for one feature vector (d,).

        Raises
        ------
        MatchingError
            The vector has another length than those learned, or is not finite.
        """
        expected = len(self.model.projection)
        if feature.shape != (expected,) or not np.isfinite(feature).all():
            raise MatchingError(f"feature vector of shape {feature.shape}: must be {expected} finite numbers")
        block = feature[None, :]
        curves = self.model.log_likelihood(block)
        posterior = probabilities(self.model.log_evidence(curves), self.calibration.temperature)[0]
        matches = []
        for h, item in enumerate(self.model.hypotheses):
            best = curves[h].argmax(axis=1).astype(np.int64)
            distance, order = self.model.surprise(block, h, best)
            predicted = item.full.mean[best[0]]
            p_value = combined(
                self.calibration.distances[h].p_value(float(distance[0])),
                self.calibration.orders[h].p_value(float(order[0])),
            )
            matches.append(
                HypothesisMatch(
                    item.draws.label,
                    item.draws.joints,
                    float(posterior[h]),
                    self._clearances(item, curves[h][0]),
                    float(np.sqrt(np.mean((feature - predicted) ** 2))),
                    p_value,
                    predicted,
                    item.full.spread_at(best)[0],
                )
            )
        return ranked(matches)

    def _clearances(self, item: _Hypothesis, curve: FloatArray) -> tuple[ClearanceEstimate, ...]:
        axes = item.grid.axes
        if not axes:
            return ()
        scaled = curve / self.calibration.clearance_temperature
        density = np.exp(scaled - logsumexp(scaled)).reshape([len(axis) for axis in axes])
        estimates = []
        for j, axis in enumerate(axes):
            others = tuple(k for k in range(len(axes)) if k != j)
            estimates.append(_estimate(item.draws.joints[j], axis, density.sum(axis=others)))
        return tuple(estimates)
