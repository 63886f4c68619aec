"""Nearest entry in clipped decibels: the plain cross-check of the probabilistic matcher."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jointplay.catalogue.matching.entry_matcher import FittedEntries, fit_entries
from jointplay.catalogue.matching.matcher import FloatArray, TrainingSet


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
    version: str = field(default="3", init=False)

    def fit(self, training: TrainingSet) -> FittedEntries:
        """Learn a training set and calibrate on folds of it.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than two draws.
        """
        return fit_entries(DecibelDistance(), training, self.fold_count)
