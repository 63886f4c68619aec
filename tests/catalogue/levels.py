"""Levels in feature bands: as they are defined, and as the product compares them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of
from jointplay.catalogue.signals.feature_bands import join_bands
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.spectra.bands import LEAST_POWER


def defined_levels(
    power: ComplexArray,
    cuts: tuple[int, ...],
    matrix: FloatArray | None = None,
    noise: FloatArray | None = None,
) -> FloatArray:
    """Levels (..., G * c), dB, of cross-powers (..., B, k, k) through a matrix (c, k), not below a noise (G, c)."""
    mix = np.eye(power.shape[-1]) if matrix is None else matrix
    auto = np.einsum("ci,...bij,cj->...bc", mix, power.real, mix, optimize=True)
    found = 10.0 * np.log10(np.maximum(join_bands(auto, cuts), LEAST_POWER if noise is None else noise))
    return np.asarray(found.reshape(*found.shape[:-2], -1))


def levels_of(prepared: PreparedMeasurement) -> FloatArray:
    """Levels (G * c,), dB, of a recording, no lower than its own noise."""
    sensing = replace(exact_sensing(prepared), noise=prepared.group_noise, phases=False)
    return features_of(prepared, sensing)
