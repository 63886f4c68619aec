"""The curve a hypothesis draws through feature space as its clearance grows, the scatter around it, and how likely a
feature vector is along it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import gammaln

from jointplay.catalogue.matching.calibration import largest
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

REACH = 3.5
"""Kernel widths beyond which a draw does not count."""


@dataclass(frozen=True, eq=False)
class ClearanceGrid:
    """Points over the logarithm of the clearances of one hypothesis.

    Parameters
    ----------
    coarse : ndarray, shape (g, k)
        Points at which means are fitted.
    fine : ndarray, shape (f, k)
        Points at which means are interpolated and likelihoods evaluated.
    weights : ndarray, shape (f, g)
        Linear interpolation from coarse to fine points.
    anchors : ndarray of int, shape (a,)
        Coarse points that carry a covariance of their own.
    nearest : ndarray of int, shape (f,)
        Number of the anchor next to each fine point.
    axes : tuple of ndarray
        The k axes whose product is `fine`; empty for a hypothesis without clearance, whose grid is one point.
    """

    coarse: FloatArray
    fine: FloatArray
    weights: FloatArray
    anchors: IntArray
    nearest: IntArray
    axes: tuple[FloatArray, ...]

    @classmethod
    def over(cls, log_clearance: FloatArray, points: int, refinement: int, stride: int) -> ClearanceGrid:
        """Lay a grid over draws with clearances (n, k).

        Parameters
        ----------
        log_clearance : ndarray, shape (n, k)
        points : int
            Coarse points of each axis, at most; no more than there are different clearances.
        refinement : int
            Fine steps from one coarse point to the next.
        stride : int
            Every so many coarse points of an axis one is an anchor.
        """
        k = log_clearance.shape[1]
        if k == 0:
            empty, single = np.zeros((1, 0)), np.zeros(1, np.int64)
            return cls(empty, empty, np.ones((1, 1)), single, single, ())
        lines: list[FloatArray] = []
        axes: list[FloatArray] = []
        weights: FloatArray = np.ones((1, 1))
        is_anchor: BoolArray = np.ones(1, bool)
        for column in log_clearance.T:
            count = min(points, len(np.unique(column)))
            lines.append(np.linspace(column.min(), column.max(), count))
            axes.append(np.linspace(column.min(), column.max(), (count - 1) * refinement + 1))
            position = np.linspace(0.0, count - 1.0, len(axes[-1]))
            hats = np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(count)))
            weights = np.kron(weights, hats).astype(np.float64, copy=False)
            is_anchor = np.kron(is_anchor, np.arange(count) % stride == 0)
        coarse = np.array(list(itertools.product(*lines)))
        fine = np.array(list(itertools.product(*axes)))
        anchors = np.flatnonzero(is_anchor).astype(np.int64)
        offset = fine[:, None, :] - coarse[anchors][None, :, :]
        nearest = np.sum(offset**2, axis=2).argmin(axis=1).astype(np.int64)
        return cls(coarse, fine, weights, anchors, nearest, tuple(axes))

    def index(self, log_clearance: FloatArray) -> IntArray:
        """Return the fine point next to each row of `log_clearance` (n, k)."""
        index = np.zeros(len(log_clearance), np.int64)
        for axis, column in zip(self.axes, log_clearance.T, strict=True):
            index = index * len(axis) + np.abs(column[:, None] - axis[None, :]).argmin(axis=1)
        return index


@dataclass(frozen=True, eq=False)
class Tube:
    """Mean along the clearance and covariance around it.

    Parameters
    ----------
    mean : ndarray, shape (f, d)
        At the fine points of the grid.
    whitener : ndarray, shape (a, d, d)
        Inverse Cholesky factors of the covariances at the anchors.
    log_determinant : ndarray, shape (a,)
    variance : ndarray, shape (a, d)
        Diagonals of the covariances.
    nearest : ndarray of int, shape (f,)
        Anchor of each fine point.
    """

    mean: FloatArray
    whitener: FloatArray
    log_determinant: FloatArray
    variance: FloatArray
    nearest: IntArray

    @cached_property
    def _points(self) -> tuple[FloatArray, FloatArray]:
        """Centre (a, d) of every anchor's fine points, and fine points (f, d) whitened about it."""
        anchors = len(self.whitener)
        centre, point = np.zeros((anchors, self.mean.shape[1])), np.empty(self.mean.shape)
        for anchor in range(anchors):
            inside = np.flatnonzero(self.nearest == anchor)
            if len(inside):
                # Centred before the products, so that no digits are lost far from the origin.
                centre[anchor] = self.mean[inside[0]]
                point[inside] = (self.mean[inside] - centre[anchor]) @ self.whitener[anchor].T
        return centre, point

    def squared_distance(self, features: FloatArray) -> FloatArray:
        """Return squared Mahalanobis distances (m, f) of features (m, d) from every fine point."""
        centre, point = self._points
        if len(features) == 1:
            row = np.einsum("aij,aj->ai", self.whitener, features[0] - centre)
            single: FloatArray = np.sum((row[self.nearest] - point) ** 2, axis=1)[None, :]
            return single
        out = np.empty((len(features), len(self.mean)))
        for anchor, whitener in enumerate(self.whitener):
            inside = np.flatnonzero(self.nearest == anchor)
            row = (features - centre[anchor]) @ whitener.T
            square = np.sum(row**2, axis=1)[:, None] + np.sum(point[inside] ** 2, axis=1)[None, :]
            out[:, inside] = square - 2.0 * row @ point[inside].T
        return np.maximum(out, 0.0)

    def distance_at(self, features: FloatArray, point: IntArray) -> FloatArray:
        """Return the Mahalanobis distance (m,) of each row (m, d) from the fine point (m,) chosen for it."""
        residual = features - self.mean[point]
        anchors = self.nearest[point]
        distance = np.empty(len(features))
        for anchor in np.unique(anchors):
            rows = anchors == anchor
            distance[rows] = np.sqrt(np.sum((residual[rows] @ self.whitener[anchor].T) ** 2, axis=1))
        return distance

    def spread_at(self, point: IntArray) -> FloatArray:
        """Return the standard deviations (m, d) at fine points (m,)."""
        spread: FloatArray = np.sqrt(self.variance[self.nearest[point]])
        return spread


def fit_tube(
    features: FloatArray,
    log_clearance: FloatArray,
    grid: ClearanceGrid,
    *,
    cases: int,
    width: float,
    ridge: float,
    weights: FloatArray | None = None,
) -> Tube:
    """Fit local lines along ln(clearance) and the covariance of what they leave.

    Parameters
    ----------
    features : ndarray, shape (n, d)
    log_clearance : ndarray, shape (n, k)
    grid : ClearanceGrid
    cases : int
        Number of independent draws behind the n rows.
    width : float
        Standard deviation of the Gaussian kernel in ln(clearance).
    ridge : float
        Share of the mean variance added to every variance.
    weights : ndarray, shape (n,), optional
        How much each row counts, of mean 1.

    Notes
    -----
    Local linear regression: W. S. Cleveland, J. Am. Stat. Assoc. 74 (1979) 829. The local covariance S is shrunk to
    the covariance P of all residuals of the hypothesis, m S + (1 - m) P with m = n_eff / (n_eff + d), and P to its own
    diagonal by the same rule with all draws.
    """
    n, d = features.shape
    k = log_clearance.shape[1]
    shares = np.ones(n) if weights is None else weights
    offset = log_clearance[None, :, :] - grid.coarse[:, None, :]
    squared = np.sum((offset / width) ** 2, axis=2)
    # The nearest rows always take part: in the corner of a plane the kernel alone may find next to nothing.
    least = min(n, 3 * (k + 1)) - 1
    reach = np.maximum(REACH**2, np.partition(squared, least, axis=1)[:, least])
    weight = np.where(squared <= reach[:, None], (np.exp(-0.5 * squared) + 1e-6) * shares, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    design = np.concatenate([np.ones((*squared.shape, 1)), offset], axis=2)
    weighted = np.swapaxes(design * weight[:, :, None], 1, 2)
    normal = weighted @ design
    normal[:, np.arange(1, k + 1), np.arange(1, k + 1)] += 1e-3 * width**2
    shift = features.mean(axis=0)
    centred = features - shift
    lines = np.linalg.solve(normal, (weighted.reshape(-1, n) @ centred).reshape(len(grid.coarse), k + 1, d))
    fine = grid.weights @ lines[:, 0] + shift
    residual = features - fine[grid.index(log_clearance)]
    pooled = (residual * shares[:, None]).T @ residual / n
    spread = cases * float(np.sum(shares)) ** 2 / (n * float(np.sum(shares**2)))
    target = _mix(pooled, np.diag(np.diag(pooled)), spread / (spread + d))
    anchors = len(grid.anchors)
    whitener = np.empty((anchors, d, d))
    log_determinant = np.empty(anchors)
    variance = np.empty((anchors, d))
    identity = np.eye(d)
    for anchor, point in enumerate(grid.anchors):
        rows = np.flatnonzero(weight[point])
        left = centred[rows] - design[point, rows] @ lines[point]
        effective = cases / (n * float(np.sum(weight[point] ** 2)))
        unbiased = max(0.3, 1.0 - (1.0 + k) / max(effective, 1.0))
        local = (left * weight[point, rows, None]).T @ left / unbiased
        shrunk = _mix(local, target, effective / (effective + d))
        shrunk[np.diag_indices(d)] += ridge * float(np.mean(np.diag(shrunk))) + 1e-9
        factor = cholesky(shrunk, lower=True, check_finite=False)
        whitener[anchor] = solve_triangular(factor, identity, lower=True, check_finite=False)
        log_determinant[anchor] = 2.0 * float(np.sum(np.log(np.diag(factor))))
        variance[anchor] = np.diag(shrunk)
    return Tube(fine, whitener, log_determinant, variance, grid.nearest)


def _mix(covariance: FloatArray, target: FloatArray, keep: float) -> FloatArray:
    mixed: FloatArray = keep * covariance + (1.0 - keep) * target
    return mixed


def log_sum_exp(values: FloatArray) -> FloatArray:
    """Return the logarithm of the sum of exponentials along the last axis.

    Parameters
    ----------
    values : ndarray, shape (..., n)
        Finite; n > 0.

    Notes
    -----
    What :func:`scipy.special.logsumexp` computes for finite real numbers, to the last bit, without its provisions for
    all other kinds: those take most of the time of a short sum.
    """
    largest = values.max(axis=-1, keepdims=True)
    at_top = values == largest
    count = at_top.sum(axis=-1, keepdims=True, dtype=np.float64)
    others = np.exp(np.where(at_top, -np.inf, values) - largest).sum(axis=-1, keepdims=True)
    total: FloatArray = (np.log1p(others / count) + np.log(count) + largest)[..., 0]
    return total


@dataclass(frozen=True)
class Curve:
    """One hypothesis: a curve over its clearance, or a surface, with the scatter around it.

    Parameters
    ----------
    label : str
    joints : tuple of str
    prior : float
    grid : ClearanceGrid
        Points over the logarithm of the clearances.
    whitened, full : Tube
        In the discriminant directions, which tell hypotheses apart; in all levels, which judge the fit.
    """

    label: str
    joints: tuple[str, ...]
    prior: float
    grid: ClearanceGrid
    whitened: Tube
    full: Tube

    def surprise(self, features: FloatArray, best: IntArray, watched: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return full-space distance (m,) and mean of the largest watched z (m,) at the fine points `best` (m,)."""
        levels = features[:, : len(watched)]
        z = (levels - self.full.mean[best]) / self.full.spread_at(best)
        return self.full.distance_at(levels, best), largest(z, watched)


@dataclass(frozen=True, eq=False)
class CurveModel:
    """All hypotheses in one whitened space; not calibrated yet.

    Parameters
    ----------
    projection : ndarray, shape (d, r)
    curves : tuple of Curve
    watched : ndarray of bool, shape (l,)
    degrees_of_freedom : float
        Of the Student-t likelihood.
    """

    projection: FloatArray
    curves: tuple[Curve, ...]
    watched: BoolArray
    degrees_of_freedom: float

    def log_likelihood(self, whitened: FloatArray, index: int) -> FloatArray:
        """Return the log density (m, f) of whitened features (m, r) at each fine point of one hypothesis."""
        tube = self.curves[index].whitened
        d, nu = whitened.shape[1], self.degrees_of_freedom
        constant = float(gammaln(0.5 * (nu + d)) - gammaln(0.5 * nu)) - 0.5 * d * float(np.log((nu - 2.0) * np.pi))
        half = 0.5 * tube.log_determinant[tube.nearest]
        squared = tube.squared_distance(whitened)
        density: FloatArray = constant - half[None, :] - 0.5 * (nu + d) * np.log1p(squared / (nu - 2.0))
        return density

    @property
    def log_prior(self) -> FloatArray:
        """Logarithm of the weight (hypotheses,) of each hypothesis before the measurement."""
        return np.log([curve.prior for curve in self.curves])

    def log_evidences(self, features: FloatArray) -> FloatArray:
        """Return the log evidence (m, hypotheses) of features (m, d), priors left out."""
        whitened = features @ self.projection
        columns = [average(self.log_likelihood(whitened, h)) for h in range(len(self.curves))]
        return np.stack(columns, axis=1)


def average(likelihood: FloatArray) -> FloatArray:
    """Average a log likelihood (m, f) over a log-uniform clearance: (m,)."""
    evidence: FloatArray = log_sum_exp(likelihood) - np.log(likelihood.shape[1])
    return evidence
