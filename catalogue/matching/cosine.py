"""Cosine similarity of spectra: what libraries of spectra are usually searched by, for comparison."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jointplay.catalogue.matching.entry_matcher import FittedEntries, fit_entries
from jointplay.catalogue.matching.matcher import FloatArray, TrainingSet


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


@dataclass(frozen=True)
class CosineEntry:
    """Settings of the method; :meth:`fit` learns a training set.

    Parameters
    ----------
    fold_count : int
        Parts the draws are split into for calibration.
    """

    fold_count: int = 4
    name: str = field(default="cosine", init=False)
    version: str = field(default="2", init=False)

    def fit(self, training: TrainingSet) -> FittedEntries:
        """Learn a training set and calibrate on folds of it.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than two draws.
        """
        return fit_entries(ChordDistance(), training, self.fold_count)


def _unit(rows: FloatArray) -> FloatArray:
    centred = rows - rows.mean(axis=1, keepdims=True)
    norm = np.linalg.norm(centred, axis=1, keepdims=True)
    unit: FloatArray = centred / np.where(norm > 0.0, norm, 1.0)
    return unit
