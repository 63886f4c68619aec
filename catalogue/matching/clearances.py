"""Clearances of a hypothesis, from the likelihood along its curve, and intervals that hold as often as they say.

A temperature that suits all clearances of a hypothesis at once makes intervals too wide where clearances are well known
and too narrow where they are not. So the ranks of the true clearances of held-out draws say, next to the clearance that
was found, how much wider than they should be the laws are that the likelihood makes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr, ndtri

from jointplay.solver.arrays import FloatArray

FINER = (1, 3, 3)
"""Steps between two points of the grid along a joint at which likelihoods are interpolated, for one, two and three
joints: points of grids of three joints lie as far apart as the posterior is wide."""

NEAR = 0.5
"""Standard deviation of ln(clearance) over which held-out draws say how true a law is."""

LEAST_RANK = 1e-3
"""Ranks next to 0 and 1 count as this: they are those of clearances at an end of what was drawn."""

SCALES = (0.4, 2.5)
"""Factors on the width of a law, at least and at most."""


@dataclass(frozen=True, eq=False)
class Laws:
    """Laws of the clearance of one joint, for m feature vectors.

    Parameters
    ----------
    edges : ndarray, shape (n,)
        ln(clearance), in rising order.
    below : ndarray, shape (m, n)
        Probability of a smaller one.
    """

    edges: FloatArray
    below: FloatArray

    def quantile(self, share: float) -> FloatArray:
        """Return the ln(clearance) (m,) below which lies a share of the probability."""
        rows = np.arange(len(self.below))
        right = np.clip(np.sum(self.below < share, axis=1), 1, len(self.edges) - 1)
        low, high = self.below[rows, right - 1], self.below[rows, right]
        part = (share - low) / np.maximum(high - low, 1e-300)
        found: FloatArray = self.edges[right - 1] + part * (self.edges[right] - self.edges[right - 1])
        return found

    def ranks(self, log_clearance: FloatArray) -> FloatArray:
        """Return the probability (m,) of less than a ln(clearance) (m,)."""
        rows = np.arange(len(self.below))
        right = np.clip(np.searchsorted(self.edges, log_clearance), 1, len(self.edges) - 1)
        low, high = self.edges[right - 1], self.edges[right]
        part = np.clip((log_clearance - low) / np.maximum(high - low, 1e-300), 0.0, 1.0)
        found: FloatArray = self.below[rows, right - 1] * (1.0 - part) + self.below[rows, right] * part
        return found


def laws_of(likelihood: FloatArray, axes: Sequence[FloatArray], temperature: float) -> list[Laws]:
    """Return the laws of each joint, whatever the others are like.

    Parameters
    ----------
    likelihood : ndarray, shape (m, f)
        Logarithm, at the points of a grid.
    axes : sequence of ndarray
        Those of the grid, evenly spaced, of k joints.
    temperature : float
        What the likelihood is divided by.
    """
    joints = len(axes)
    fine = likelihood.reshape(-1, *(len(axis) for axis in axes)) / temperature
    steps = FINER[joints - 1]
    for j, axis in enumerate(axes):
        fine = np.moveaxis(np.tensordot(fine, _finer(len(axis), steps), (1 + j, 1)), -1, 1 + j)
    density = np.exp(fine - fine.max(axis=tuple(range(1, joints + 1)), keepdims=True))
    found = []
    for j, axis in enumerate(axes):
        points = np.linspace(axis[0], axis[-1], density.shape[1 + j])
        step = points[1] - points[0] if len(points) > 1 else 0.0
        # Each point stands for the cell around it, halves at the ends.
        edges = np.clip(np.r_[points - 0.5 * step, points[-1] + 0.5 * step], points[0], points[-1])
        own = density.sum(axis=tuple(1 + other for other in range(joints) if other != j))
        below = np.concatenate([np.zeros((len(own), 1)), np.cumsum(own, axis=1)], axis=1)
        found.append(Laws(edges, below / below[:, -1:]))
    return found


@lru_cache
def _finer(count: int, steps: int) -> FloatArray:
    """Matrix (n, count) from values at evenly spaced points to those at `steps` times as many, by a cubic spline."""
    if steps == 1 or count < 2:
        return np.eye(count)
    at = np.linspace(0.0, count - 1.0, (count - 1) * steps + 1)
    found: FloatArray = make_interp_spline(np.arange(count), np.eye(count), k=min(3, count - 1))(at)
    return found


@dataclass(frozen=True, eq=False)
class Ranks:
    """Ranks of true clearances of held-out draws in the laws that a likelihood made of them.

    Parameters
    ----------
    log_median : ndarray, shape (n,)
        ln(clearance) that was found.
    squared : ndarray, shape (n,)
        Squared normal score of the rank of the true one: 1 on average, where laws are true.
    weight : ndarray, shape (n,)
        Probability that was given to the true hypothesis: clearances are told of a hypothesis that leads.

    Notes
    -----
    A. P. Dawid, J. R. Stat. Soc. A 147 (1984) 278 (ranks); V. Kuleshov, N. Fenner, S. Ermon, ICML 2018 (recalibration).
    """

    log_median: FloatArray
    squared: FloatArray
    weight: FloatArray

    @classmethod
    def of(cls, parts: Sequence[tuple[Laws, FloatArray, FloatArray]]) -> Ranks:
        """Learn from laws, true ln(clearance) (m,), and weights (m,) of held-out draws of some joints."""
        columns: list[list[FloatArray]] = [[np.empty(0)], [np.empty(0)], [np.empty(0)]]
        for laws, true, weight in parts:
            score: FloatArray = ndtri(np.clip(laws.ranks(true), LEAST_RANK, 1.0 - LEAST_RANK))
            for column, values in zip(columns, (laws.quantile(0.5), score**2, weight), strict=True):
                column.append(values)
        return cls(*map(np.concatenate, columns))

    def scale(self, log_median: float) -> float:
        """Return how much too narrow laws are, in normal scores, next to a ln(clearance)."""
        share = self.weight * np.exp(-0.5 * ((self.log_median - log_median) / NEAR) ** 2)
        # One more draw, whose law was true: nothing is known where there is none.
        mean = (1.0 + float(share @ self.squared)) / (1.0 + float(share.sum()))
        return float(np.clip(np.sqrt(mean), *SCALES))

    def corrected(self, below: FloatArray, log_median: float) -> FloatArray:
        """Return the probabilities (n,) of a law that was found as held-out draws say they are."""
        found: FloatArray = ndtr(ndtri(below) / self.scale(log_median))
        return found
