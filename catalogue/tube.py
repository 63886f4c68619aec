"""The curve a hypothesis draws through feature space as its clearance grows, and the scatter around it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from catalogue.matching import BoolArray, FloatArray, IntArray

REACH = 3.5
"""Kernel widths beyond which a draw does not count."""


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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

    def squared_distance(self, features: FloatArray) -> FloatArray:
        """Return squared Mahalanobis distances (m, f) of features (m, d) from every fine point."""
        out = np.empty((len(features), len(self.mean)))
        for anchor, whitener in enumerate(self.whitener):
            inside = np.flatnonzero(self.nearest == anchor)
            if len(inside):
                # Centred before the products, so that no digits are lost far from the origin.
                centre = self.mean[inside[0]]
                point = (self.mean[inside] - centre) @ whitener.T
                row = (features - centre) @ whitener.T
                square = np.sum(row**2, axis=1)[:, None] + np.sum(point**2, axis=1)[None, :]
                out[:, inside] = square - 2.0 * row @ point.T
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
    features: FloatArray, log_clearance: FloatArray, grid: ClearanceGrid, *, cases: int, width: float, ridge: float
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

    Notes
    -----
    Local linear regression: W. S. Cleveland, J. Am. Stat. Assoc. 74 (1979) 829. The local covariance S is shrunk to
    the covariance P of all residuals of the hypothesis, m S + (1 - m) P with m = n_eff / (n_eff + d), and P to its own
    diagonal by the same rule with all draws.
    """
    n, d = features.shape
    k = log_clearance.shape[1]
    carries = np.zeros(len(grid.coarse), bool)
    carries[grid.anchors] = True
    mean = np.empty((len(grid.coarse), d))
    local: list[tuple[FloatArray, float]] = []
    for g, centre in enumerate(grid.coarse):
        squared = np.sum(((log_clearance - centre) / width) ** 2, axis=1)
        # The nearest rows always take part: in the corner of a plane the kernel alone may find next to nothing.
        least = min(n, 3 * (k + 1)) - 1
        rows = np.flatnonzero(squared <= max(REACH**2, float(np.partition(squared, least)[least])))
        weight = np.exp(-0.5 * squared[rows]) + 1e-6
        weight /= weight.sum()
        offset, inside = log_clearance[rows] - centre, features[rows]
        design = np.hstack([np.ones((len(rows), 1)), offset])
        normal = design.T @ (design * weight[:, None])
        normal[np.diag_indices_from(normal)] += np.r_[0.0, np.full(k, 1e-3 * width**2)]
        line = np.linalg.solve(normal, design.T @ (inside * weight[:, None]))
        mean[g] = line[0]
        if carries[g]:
            residual = inside - design @ line
            effective = cases / (n * float(np.sum(weight**2)))
            unbiased = max(0.3, 1.0 - (1.0 + k) / max(effective, 1.0))
            local.append(((residual * weight[:, None]).T @ residual / unbiased, effective))
    fine = grid.weights @ mean
    residual = features - fine[grid.index(log_clearance)]
    pooled = residual.T @ residual / n
    target = _mixed(pooled, np.diag(np.diag(pooled)), cases / (cases + d))
    whitener = np.empty((len(local), d, d))
    log_determinant = np.empty(len(local))
    variance = np.empty((len(local), d))
    identity = np.eye(d)
    for anchor, (covariance, effective) in enumerate(local):
        shrunk = _mixed(covariance, target, effective / (effective + d))
        shrunk[np.diag_indices(d)] += ridge * float(np.mean(np.diag(shrunk))) + 1e-9
        factor = cholesky(shrunk, lower=True, check_finite=False)
        whitener[anchor] = solve_triangular(factor, identity, lower=True, check_finite=False)
        log_determinant[anchor] = 2.0 * float(np.sum(np.log(np.diag(factor))))
        variance[anchor] = np.diag(shrunk)
    return Tube(fine, whitener, log_determinant, variance, grid.nearest)


def _mixed(covariance: FloatArray, target: FloatArray, keep: float) -> FloatArray:
    mixed: FloatArray = keep * covariance + (1.0 - keep) * target
    return mixed
