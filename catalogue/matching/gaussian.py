"""Gaussian along the clearance: a curve with a tube around it for every hypothesis.

Feature vectors are whitened by a linear discriminant analysis. In the few directions that are left, every hypothesis is
a curve over the logarithm of its clearance (a surface for two joints) with a covariance that changes along it; a
measurement is judged by its distance from each curve. The method and its derivation: ``docs/explanation/method.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.matching.calibration import combine, folds, probabilities, row_weights, split_held_out
from jointplay.catalogue.matching.clearances import laws_of
from jointplay.catalogue.matching.curve_calibration import Calibration, calibrate
from jointplay.catalogue.matching.curves import ClearanceGrid, Curve, CurveModel, average, fit_tube
from jointplay.catalogue.matching.matcher import ClearanceEstimate, HypothesisMatch, MatchResult, TrainingSet, rank
from jointplay.catalogue.matching.network import Opinion
from jointplay.solver.arrays import FloatArray, IntArray

BROADBAND_SHARE = 0.8
"""Part of the false alarms left to the overall distance: what is broadband, as a second worn joint, shows there alone,
while foreign forces at low orders are far out where they show at all."""

STRATA_SHARE = 0.2
"""Part of the false alarms left to the network of strata: where it sees something it is sure of it, and half of them
would hide from the distances what it was not shown, as wear in more joints than the catalogue has: docs/decisions/0100.
"""


@dataclass(frozen=True)
class Smoothing:
    """How finely hypotheses are told apart, for as many draws as there are.

    Parameters
    ----------
    directions : int
        Of the discriminant analysis, kept at most.
    shrinkage : float
        Share of the within-class scatter replaced by its mean variance in all directions.
    kernel : tuple of float
        Width of the Gaussian kernel in ln(clearance), for hypotheses of one, two and three joints.
    bins : tuple of int
        Bins of each clearance that are classes of the discriminant analysis, likewise.
    """

    directions: int
    shrinkage: float
    kernel: tuple[float, ...]
    bins: tuple[int, ...]


#: Other directions, kernels and shrinkage, and other degrees of freedom (below), move the figures of an evaluation by
#: less than their own uncertainty (docs/measured/diagnosis.md).
MANY, FEW = Smoothing(40, 0.005, (0.3, 0.5, 0.8), (10, 4, 2)), Smoothing(15, 0.02, (0.5, 0.8, 1.0), (6, 3, 2))
FEW_CASES = 100
"""Simulated cases a hypothesis below which there are few: 2.5 a direction."""

SPLIT_CASES = 180
"""Simulated cases a hypothesis from which on a fifth of them is held out once and calibrates what the others taught;
with fewer every case is held out in turn, and all of them teach. From as many on there are networks."""

FOLDS = 4
"""Parts that draws are split into where every case is held out in turn: each model learns from three quarters."""

POINTS, REFINEMENT = (24, 10, 6), (4, 2, 1)
"""Points of the clearance grid along each joint, for one, two and three joints, and steps between two of them at which
means are interpolated: 24, 100 and 216 points, closer than a kernel is wide."""

STRIDE, FULL_STRIDE = (2, 2, 2), (4, 4, 5)
"""Every so many points along a joint carry a covariance of their own: in the whitened space, and in the full one, which
only judges how well a hypothesis fits."""

DEGREES_OF_FREEDOM = 8.0
"""Of the Student-t likelihood, so that one odd band does not decide."""

RIDGE = 0.05
"""Share of the mean variance added to every local variance."""

NAME = "gaussian-along-clearance"
"""Of the method, as answers have it."""


def fit_gaussian(
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
        Of a network that was trained without :func:`~jointplay.catalogue.matching.calibration.is_held_out` entries. It
        counts where there are many cases.
    witness : Opinion, optional
        Of a network of strata, trained so, too: a recording that it takes for one of a machine that differs from
        its file is not explained. It counts where there are many cases.

    Raises
    ------
    MatchingError
        A hypothesis has fewer than four draws, or clearances of more than three joints.
    """
    for draws in training.hypotheses:
        if len(draws.features) < FOLDS:
            raise MatchingError(f"hypothesis {draws.label}: {len(draws.features)} draws: must be at least {FOLDS}")
        if draws.log_clearance.shape[1] > len(POINTS):
            raise MatchingError(
                f"hypothesis {draws.label}: clearances of {draws.joints}: must be at most {len(POINTS)}"
            )
    smoothing = FEW if training.cases < FEW_CASES else MANY
    if training.cases >= SPLIT_CASES:
        learned, held = split_held_out(training)
        model = _learned(learned, smoothing, projection)
        return FittedGaussian(model, calibrate([(model, held)], opinion, witness), opinion, witness)
    pairs = ((_learned(learned, smoothing, projection), held) for learned, held in folds(training, FOLDS))
    calibration = calibrate(pairs)
    return FittedGaussian(_learned(training, smoothing, projection), calibration)


def _learned(training: TrainingSet, smoothing: Smoothing, projection: FloatArray | None) -> CurveModel:
    if projection is None:
        projection = _discriminant(training, smoothing)
    curves = []
    for draws in training.hypotheses:
        k = max(draws.log_clearance.shape[1], 1) - 1
        # Both grids have the same points and differ only in how many of them carry a covariance.
        grid, full_grid = (
            ClearanceGrid.over(draws.log_clearance, POINTS[k], REFINEMENT[k], stride[k])
            for stride in (STRIDE, FULL_STRIDE)
        )
        whitened, full = (
            fit_tube(
                features,
                draws.log_clearance,
                each,
                cases=draws.cases,
                width=smoothing.kernel[k],
                ridge=RIDGE,
                weights=draws.weights,
            )
            for features, each in (
                (draws.features @ projection, grid),
                (draws.features[:, : len(training.watched)], full_grid),
            )
        )
        curves.append(Curve(draws.label, draws.joints, draws.prior, grid, whitened, full))
    return CurveModel(projection, tuple(curves), training.watched, DEGREES_OF_FREEDOM)


def _discriminant(training: TrainingSet, smoothing: Smoothing) -> FloatArray:
    """Return the projection (d, r) of a linear discriminant analysis, classes = hypothesis x clearance bin.

    Whitening: the directions in which hypotheses and clearances differ most, in units of their scatter.
    """
    features, hypothesis = training.stack()
    features = features[:, : training.plain]
    share = row_weights(hypothesis)
    overall = share @ features
    d = features.shape[1]
    within = np.zeros((d, d))
    between = np.zeros((d, d))
    classes = 0
    for h, draws in enumerate(training.hypotheses):
        weight = share[hypothesis == h][0]
        label = _bins(draws.log_clearance, smoothing.bins)
        for value in np.unique(label):
            rows = draws.features[label == value, : training.plain]
            centre = rows.mean(axis=0)
            residual = rows - centre
            within += weight * residual.T @ residual
            between += weight * len(rows) * np.outer(centre - overall, centre - overall)
            classes += 1
    mean_variance = float(np.trace(within)) / d
    within *= 1.0 - smoothing.shrinkage
    within[np.diag_indices(d)] += smoothing.shrinkage * mean_variance + 1e-9
    kept = max(1, min(smoothing.directions, d, classes - 1))
    _, vectors = eigh(between, within, subset_by_index=[d - kept, d - 1])
    projection = np.zeros((training.length, kept))
    projection[:d] = vectors[:, ::-1]
    return projection


def _bins(log_clearance: FloatArray, bins: tuple[int, ...]) -> IntArray:
    label = np.zeros(len(log_clearance), np.int64)
    for column in log_clearance.T:
        count = bins[min(log_clearance.shape[1], len(bins)) - 1]
        place = count * (column - column.min()) / (float(np.ptp(column)) or 1.0)
        label = label * count + np.minimum(place.astype(np.int64), count - 1)
    return label


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
        evidence = np.array([average(each) for each in likelihoods])
        posterior = self._probabilities(evidence.T, block)[0]
        doubt = 0.0 if self.witness is None else float(self.witness.doubts(block)[0])
        matches = []
        for h, curve in enumerate(self.model.curves):
            best = likelihoods[h].argmax(axis=1).astype(np.int64)
            distance, order = curve.surprise(block, best, self.model.watched)
            predicted = curve.full.mean[best[0]]
            p_value = combine(
                self.calibration.distances[h].p_value(float(distance[0])),
                self.calibration.orders[h].p_value(float(order[0])),
                BROADBAND_SHARE,
            )
            if self.witness is not None:
                p_value = combine(self.calibration.doubts[h].p_value(doubt), p_value, STRATA_SHARE)
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
        return rank(matches, self.calibration.conformal, self.calibration.sightings)

    def _clearances(self, curve: Curve, likelihood: FloatArray) -> tuple[ClearanceEstimate, ...]:
        """Return medians and central 90 % intervals from the log likelihood (f,) along a curve."""
        axes = curve.grid.axes
        if not axes:
            return ()
        count = len(axes) - 1
        ranks = self.calibration.clearance_ranks[count]
        found = []
        laws = laws_of(likelihood[None, :], axes, self.calibration.clearance_temperatures[count])
        for joint, law in zip(curve.joints, laws, strict=True):
            below = ranks.corrected(law.below[0], float(law.quantile(0.5)[0]))
            low, median, high = np.exp(np.interp([0.05, 0.5, 0.95], below, law.edges)).tolist()
            found.append(ClearanceEstimate(joint, median, low, high, (law.edges, below)))
        return tuple(found)
