"""How a recording is compared with a catalogue: what its sensors see of an entry, and its own feature vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.matching.coherence import common_noise, pairs_of
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.solver.arrays import BoolArray, ComplexArray, FloatArray

LEAST_NOISE_DENSITY = 2e-10
"""Acceleration noise, (m/s2)^2/Hz, a recording is taken to have at least (1 mm/s2 up to 5 kHz): no simulation and no
sensor is cleaner, and what lies below says nothing about joints."""

WATCHED_ORDERS = 10
"""Orders checked one by one, besides the overall distance."""


def exact_sensing(prepared: PreparedMeasurement) -> Sensing:
    """Return how the sensors of a recording see entries, with the recording's own noise and length: what a library of
    models is asked with, which rounds them itself where it needs to. What may be hum in an order counts as noise.
    """
    sensors = prepared.sensing
    width = np.diff(prepared.scheme.edges_hz(prepared.drive_speed)[list(prepared.cuts)])
    least = LEAST_NOISE_DENSITY * width[:, None] * np.sum(sensors.channels**2, axis=1)
    noise = np.maximum(prepared.group_noise, least) + prepared.group_hum
    return Sensing(
        sensors.transform, sensors.channels, prepared.cuts, noise, prepared.group_degrees_of_freedom, sensors.phases
    )


def features_of(prepared: PreparedMeasurement, sensing: Sensing) -> FloatArray:
    """Return the feature vector (d,) of a recording, its noise filled up to that of `sensing`."""
    missing = np.maximum(sensing.noise - prepared.group_noise, 0.0)
    cross: ComplexArray | None = None
    cyclic: ComplexArray | None = None
    if sensing.phases:
        first, second = np.array(pairs_of(len(sensing.channels)), np.int64).reshape(-1, 2).T
        joint = np.add.reduceat(prepared.power[: prepared.cuts[-1]], prepared.cuts[:-1], axis=0)
        cross = np.asarray(joint[None, :, first, second] + common_noise(missing, sensing.alike), np.complex128)
        cyclic = sensing.cyclic.chosen(prepared.group_cyclic[None])
    found: FloatArray = sensing.features(prepared.group_power[None] + missing, cross, cyclic)[0]
    return found


def beside_past(
    prepared: PreparedMeasurement, past: Sequence[PreparedMeasurement]
) -> tuple[Sensing, FloatArray] | None:
    """Return how a recording and earlier ones of the machine see entries, and the features (d,) of it and of them.

    With the loudest noise and the shortest length of all; earlier ones count by their mean. None where no other is by
    the same sensors in the same bands.
    """
    before = [each for each in past if view_of(each) == view_of(prepared) and each.cuts == prepared.cuts]
    if not before:
        return None
    sensing = common_sensing([prepared, *before])
    mean: FloatArray = np.mean([features_of(each, sensing) for each in before], axis=0)
    return replace(sensing, past=True), np.concatenate([features_of(prepared, sensing), mean])


def common_sensing(recordings: Sequence[PreparedMeasurement]) -> Sensing:
    """Return how recordings by the same sensors in the same bands all see entries: the loudest, the shortest."""
    every = [exact_sensing(each) for each in recordings]
    return replace(
        every[0],
        noise=np.max([each.noise for each in every], axis=0),
        degrees_of_freedom=np.min([each.degrees_of_freedom for each in every], axis=0),
    )


def view_of(prepared: PreparedMeasurement) -> tuple[object, ...]:
    """Return what recordings have to have in common to be compared with each other: what their sensors see."""
    sensing = prepared.sensing
    return sensing.sensors, sensing.compared, sensing.phases


def watched_levels(prepared: PreparedMeasurement) -> BoolArray:
    """Return which levels (l,) are single orders low enough to show foreign forces."""
    axes = prepared.axes
    return np.array([axis.single_order and axis.low_order < WATCHED_ORDERS for axis in axes], dtype=bool)
