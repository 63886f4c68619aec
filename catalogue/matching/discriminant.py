"""Whitening: the directions in which hypotheses and clearances differ most, in units of their scatter."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from jointplay.catalogue.matching.calibration import row_weights
from jointplay.catalogue.matching.matcher import FloatArray, IntArray, TrainingSet


def discriminant(training: TrainingSet, bins: tuple[int, ...], directions: int, shrinkage: float) -> FloatArray:
    """Return the projection (d, r) of a linear discriminant analysis, classes = hypothesis x clearance bin.

    Parameters
    ----------
    training : TrainingSet
    bins : tuple of int
        Bins of each clearance, for hypotheses of one, two, ... joints.
    directions : int
        Kept, at most.
    shrinkage : float
        Share of the within-class scatter replaced by its mean variance in all directions.
    """
    features, hypothesis = training.stacked()
    features = features[:, : training.plain]
    share = row_weights(hypothesis)
    overall = share @ features
    d = features.shape[1]
    within = np.zeros((d, d))
    between = np.zeros((d, d))
    classes = 0
    for h, draws in enumerate(training.hypotheses):
        weight = share[hypothesis == h][0]
        label = _bins(draws.log_clearance, bins)
        for value in np.unique(label):
            rows = draws.features[label == value, : training.plain]
            centre = rows.mean(axis=0)
            residual = rows - centre
            within += weight * residual.T @ residual
            between += weight * len(rows) * np.outer(centre - overall, centre - overall)
            classes += 1
    mean_variance = float(np.trace(within)) / d
    within *= 1.0 - shrinkage
    within[np.diag_indices(d)] += shrinkage * mean_variance + 1e-9
    kept = max(1, min(directions, d, classes - 1))
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
