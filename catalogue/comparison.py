"""How a recording is compared with a catalogue: what its sensors see of an entry, and its own feature vector."""

from __future__ import annotations

import dataclasses

import numpy as np

from catalogue.feature_bands import joined
from catalogue.features import PreparedMeasurement
from catalogue.matching import BoolArray, FloatArray
from catalogue.observation import Sensing, rounded_up
from catalogue.store import Catalogue

__all__ = ["NOISE_STEP_DB", "canonical_sensing", "exact_sensing", "measured_levels", "watched"]

NOISE_STEP_DB = 3.0
"""Steps a noise floor is rounded up to, so that a learned model serves all recordings of about the same noise."""

LEAST_NOISE_DENSITY = 2e-10
"""Acceleration noise, (m/s2)^2/Hz, a recording is taken to have at least (1 mm/s2 up to 5 kHz): no simulation and no
sensor is cleaner, and what lies below says nothing about joints."""

WATCHED_ORDERS = 10
"""Orders checked one by one, besides the overall distance."""


def canonical_sensing(prepared: PreparedMeasurement, catalogue: Catalogue) -> Sensing:
    """Return how the sensors of a recording see entries, with noise and length rounded to a few values.

    The loudest column's noise is rounded up to steps of 3 dB, the others lie whole steps below it; the effective length
    is rounded down to steps of 3 dB. Both are taken at the nominal drive speed. So recordings made in the same way
    share a learned model.
    """
    nominal = catalogue.recipe.nominal_drive_speed
    edges = catalogue.scheme.edges_hz(nominal)
    sensors = prepared.sensing
    floor = prepared.floor
    density = np.maximum(floor.density, 1e-30)
    loudest = np.array([density[np.equal(sensors.derivatives, kind)].max() for kind in sensors.derivatives])
    density = rounded_up(loudest, NOISE_STEP_DB) * rounded_up(density / loudest, NOISE_STEP_DB)
    excess = rounded_up(floor.excess, NOISE_STEP_DB)
    recorded = dataclasses.replace(floor, density=density, excess=excess).band_power(edges, sensors.derivatives)
    least = rounded_up(np.array(LEAST_NOISE_DENSITY), NOISE_STEP_DB) * np.diff(edges)[:, None]
    noise = np.maximum(recorded, least) @ (sensors.channels**2).T
    width = np.diff(catalogue.scheme.edges_hz(prepared.drive_speed)[list(prepared.cuts)])
    # Two degrees of freedom for each independent cell: the widest band says how long the recording is in effect.
    seconds = float(prepared.group_degrees_of_freedom[-1] / (2.0 * width[-1]))
    shorter = 1.0 / float(rounded_up(np.array(1.0 / seconds), NOISE_STEP_DB))
    cells = np.maximum(1.0, shorter * np.diff(edges[list(prepared.cuts)]))
    return Sensing(sensors.transform, sensors.channels, prepared.cuts, joined(noise, prepared.cuts), 2.0 * cells)


def exact_sensing(prepared: PreparedMeasurement) -> Sensing:
    """Return how the sensors of a recording see entries, with the recording's own noise and length: what a library of
    models is asked with, which rounds them itself where it needs to.
    """
    sensors = prepared.sensing
    width = np.diff(prepared.scheme.edges_hz(prepared.drive_speed)[list(prepared.cuts)])
    least = LEAST_NOISE_DENSITY * width[:, None] * np.sum(sensors.channels**2, axis=1)
    noise = np.maximum(prepared.group_noise, least)
    return Sensing(sensors.transform, sensors.channels, prepared.cuts, noise, prepared.group_degrees_of_freedom)


def measured_levels(prepared: PreparedMeasurement, sensing: Sensing) -> FloatArray:
    """Return the feature vector (d,) of a recording, its noise filled up to that of `sensing`."""
    missing = np.maximum(sensing.noise - prepared.group_noise, 0.0)
    return sensing.levels(prepared.group_power + missing).ravel()


def watched(prepared: PreparedMeasurement) -> BoolArray:
    """Return which features (d,) are single orders low enough to show foreign forces."""
    axes = prepared.axes
    return np.array([axis.single_order and axis.low_order < WATCHED_ORDERS for axis in axes], dtype=bool)
