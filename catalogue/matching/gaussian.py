"""Gaussian along the clearance: a curve with a tube around it for every hypothesis.

Feature vectors are whitened by a linear discriminant analysis. In the few directions that are left, every hypothesis is
a curve over the logarithm of its clearance (a surface for two joints) with a covariance that changes along it; a
measurement is judged by its distance from each curve. The method and its derivation: ``docs/explanation/method.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jointplay.catalogue import MATCHER_VERSION
from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.matching.calibration import combined, folds, kept_apart, probabilities
from jointplay.catalogue.matching.curve_calibration import Calibration, calibrated
from jointplay.catalogue.matching.curves import Curve, CurveModel, averaged
from jointplay.catalogue.matching.discriminant import discriminant
from jointplay.catalogue.matching.log_sums import log_sum_exp
from jointplay.catalogue.matching.matcher import (
    ClearanceEstimate,
    FloatArray,
    HypothesisMatch,
    MatchResult,
    TrainingSet,
    ranked,
)
from jointplay.catalogue.matching.network import Opinion
from jointplay.catalogue.matching.tube import ClearanceGrid, fit_tube

BROADBAND_SHARE = 0.8
"""Part of the false alarms left to the overall distance: what is broadband, as a second worn joint, shows there alone,
while foreign forces at low orders are far out where they show at all."""

STRATA_SHARE = 0.2
"""Part of the false alarms left to the network of strata: where it sees something it is sure of it, and half of them
would hide from the distances what it was not shown, as wear in more joints than the catalogue has: docs/decisions/0100.
"""


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
        Width of the Gaussian kernel in ln(clearance), for hypotheses of one, two and three joints.
    points : tuple of int
        Points of the clearance grid along each joint, for one, two and three joints.
    stride, full_stride : tuple of int
        Every so many points along a joint carry a covariance of their own, for one, two and three joints: in the
        whitened space, and in the full one that only judges how well a hypothesis fits.
    refinement : tuple of int
        Steps between two points, at which means are interpolated.
    bins : tuple of int
        Bins of each clearance that are classes of the discriminant analysis.
    few_cases : int
        With fewer simulated cases a hypothesis the settings marked `sparse_` are used.
    many_cases : int
        From so many cases a hypothesis on, a fifth of them is held out once and calibrates what the others taught;
        with fewer ones every case is held out in turn, and all of them teach.
    degrees_of_freedom : float
        Of the Student-t likelihood; small ones forgive outliers.
    ridge : float
        Share of the mean variance added to every local variance.
    fold_count : int
        Parts the draws are split into for calibration.
    """

    directions: int = 40
    within_shrinkage: float = 0.005
    kernel: tuple[float, ...] = (0.3, 0.5, 0.8)
    sparse_directions: int = 15
    sparse_within_shrinkage: float = 0.02
    sparse_kernel: tuple[float, ...] = (0.5, 0.8, 1.0)
    sparse_bins: tuple[int, ...] = (6, 3, 2)
    few_cases: int = 100
    many_cases: int = 180
    points: tuple[int, ...] = (24, 10, 6)
    stride: tuple[int, ...] = (2, 2, 2)
    full_stride: tuple[int, ...] = (4, 4, 5)
    refinement: tuple[int, ...] = (4, 2, 1)
    bins: tuple[int, ...] = (10, 4, 2)
    degrees_of_freedom: float = 8.0
    ridge: float = 0.05
    fold_count: int = 4
    name: str = field(default="gaussian-along-clearance", init=False)
    version: str = field(default=str(MATCHER_VERSION), init=False)

    def fit(
        self,
        training: TrainingSet,
        projection: FloatArray | None = None,
        opinion: Opinion | None = None,
        witness: Opinion | None = None,
    ) -> FittedGaussian:
        """Learn a training set and calibrate on draws held out of it.

        Parameters
        ----------
        training : TrainingSet
        projection : ndarray, shape (d, r), optional
            Whitening found before; found anew unless given.
        opinion : Opinion, optional
            Of a network that was trained without :func:`~jointplay.catalogue.matching.calibration.held_out` entries. It
            counts where there are many cases.
        witness : Opinion, optional
            Of a network of strata, trained so, too: a recording that it takes for one of a machine that differs from
            its file is not explained. It counts where there are many cases.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than three draws, or more clearances than there are settings for.
        """
        for draws in training.hypotheses:
            if len(draws.features) < 3:
                raise MatchingError(f"hypothesis {draws.label}: {len(draws.features)} draws: must be at least 3")
            if draws.log_clearance.shape[1] > len(self.points):
                most = len(self.points)
                raise MatchingError(f"hypothesis {draws.label}: clearances of {draws.joints}: must be at most {most}")
        sparse = training.cases < self.few_cases
        if training.cases >= self.many_cases:
            learned, held = kept_apart(training)
            model = self._learned(learned, sparse, projection)
            return FittedGaussian(model, calibrated([(model, held)], opinion, witness), opinion, witness)
        splits = folds(training, self.fold_count)
        pairs = ((self._learned(learned, sparse, projection), held) for learned, held in splits)
        calibration = calibrated(pairs)
        return FittedGaussian(self._learned(training, sparse, projection), calibration)

    def _learned(self, training: TrainingSet, sparse: bool, projection: FloatArray | None) -> CurveModel:
        directions = self.sparse_directions if sparse else self.directions
        shrinkage = self.sparse_within_shrinkage if sparse else self.within_shrinkage
        kernel = self.sparse_kernel if sparse else self.kernel
        if projection is None:
            bins = self.sparse_bins if sparse else self.bins
            projection = discriminant(training, bins, directions, shrinkage)
        curves = []
        for draws in training.hypotheses:
            k = max(draws.log_clearance.shape[1], 1) - 1
            # Both grids have the same points and differ only in how many of them carry a covariance.
            grid, full_grid = (
                ClearanceGrid.over(draws.log_clearance, self.points[k], self.refinement[k], stride[k])
                for stride in (self.stride, self.full_stride)
            )
            whitened, full = (
                fit_tube(
                    features,
                    draws.log_clearance,
                    each,
                    cases=draws.cases,
                    width=kernel[k],
                    ridge=self.ridge,
                    weights=draws.weights,
                )
                for features, each in (
                    (draws.features @ projection, grid),
                    (draws.features[:, : len(training.watched)], full_grid),
                )
            )
            curves.append(Curve(draws.label, draws.joints, draws.prior, grid, whitened, full))
        return CurveModel(projection, tuple(curves), training.watched, self.degrees_of_freedom)


def _estimate(joint: str, axis: FloatArray, density: FloatArray) -> ClearanceEstimate:
    """Return median and central 90 % interval of a posterior given at evenly spaced points of ln(clearance)."""
    if len(axis) == 1:
        value = float(np.exp(axis[0]))
        return ClearanceEstimate(joint, value, value, value)
    # Each point stands for the cell around it, halves at the ends.
    step = axis[1] - axis[0]
    edges = np.clip(np.r_[axis - 0.5 * step, axis[-1] + 0.5 * step], axis[0], axis[-1])
    cumulated = np.r_[0.0, np.cumsum(density)]
    cumulated /= cumulated[-1]
    low, median, high = np.exp(np.interp([0.05, 0.5, 0.95], cumulated, edges))
    return ClearanceEstimate(joint, float(median), float(low), float(high), (edges, cumulated))


@dataclass(frozen=True)
class FittedGaussian:
    """A learned training set; answers one feature vector or a block of them."""

    model: CurveModel
    calibration: Calibration
    opinion: Opinion | None = None
    witness: Opinion | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in the order of the training set."""
        return tuple(curve.label for curve in self.model.curves)

    def posterior(self, features: FloatArray) -> FloatArray:
        """Return the probabilities (m, hypotheses) of a block of feature vectors (m, d)."""
        return self._probabilities(self.model.log_evidences(features), features)

    def _probabilities(self, evidence: FloatArray, features: FloatArray) -> FloatArray:
        """Pool opinions (m, hypotheses), each as far as held-out draws say, and multiply with the priors."""
        pooled = evidence / self.calibration.temperature + self.model.log_prior
        if self.opinion is not None:
            pooled = pooled + self.calibration.share * self.opinion.log_evidences(features, self.labels)
        return probabilities(pooled)

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
        whitened = block @ self.model.projection
        likelihoods = [self.model.log_likelihood(whitened, h) for h in range(len(self.model.curves))]
        evidence = np.array([averaged(each) for each in likelihoods])
        posterior = self._probabilities(evidence.T, block)[0]
        doubt = 0.0 if self.witness is None else float(self.witness.doubts(block)[0])
        matches = []
        for h, curve in enumerate(self.model.curves):
            best = likelihoods[h].argmax(axis=1).astype(np.int64)
            distance, order = curve.surprise(block, best, self.model.watched)
            predicted = curve.full.mean[best[0]]
            p_value = combined(
                self.calibration.distances[h].p_value(float(distance[0])),
                self.calibration.orders[h].p_value(float(order[0])),
                BROADBAND_SHARE,
            )
            if self.witness is not None:
                p_value = combined(self.calibration.doubts[h].p_value(doubt), p_value, STRATA_SHARE)
            matches.append(
                HypothesisMatch(
                    curve.label,
                    curve.joints,
                    float(posterior[h]),
                    self._clearances(curve, likelihoods[h][0]),
                    float(np.sqrt(np.mean((feature[: len(predicted)] - predicted) ** 2))),
                    p_value,
                    predicted,
                    curve.full.spread_at(best)[0],
                )
            )
        return ranked(matches, self.calibration.conformal, self.calibration.sightings)

    def _clearances(self, curve: Curve, likelihood: FloatArray) -> tuple[ClearanceEstimate, ...]:
        axes = curve.grid.axes
        if not axes:
            return ()
        scaled = likelihood / self.calibration.clearance_temperatures[len(axes) - 1]
        density = np.exp(scaled - log_sum_exp(scaled)).reshape([len(axis) for axis in axes])
        estimates = []
        for j, axis in enumerate(axes):
            others = tuple(k for k in range(len(axes)) if k != j)
            estimates.append(_estimate(curve.joints[j], axis, density.sum(axis=others)))
        return tuple(estimates)
