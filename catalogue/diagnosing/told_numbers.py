"""What recordings of a machine in order tell of its numbers: load, ripple, frame and mounts, by simulations of it.

Low orders of a rigid frame tell how a load differs between the strokes, if that takes work from the drive. A constant
load along a slide does not shake the frame, and ripple, frame and mounts change the same orders; but all of them change
how fits rattle, which simulations know.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of, view_of, watched_levels
from jointplay.catalogue.diagnosing.found_cases import ToldNumbers, draw_cases, simulate_cases
from jointplay.catalogue.diagnosing.stroke_loads import COMMON, DIFFERENCE, FoundLoad, find_load
from jointplay.catalogue.matching.learning import Learning, training_set
from jointplay.catalogue.matching.model_library import one_thread
from jointplay.catalogue.plans.entry import HEALTHY
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

CASES = 768
"""Of the machine in order."""

COMPONENTS = 60
"""Principal components of the features that numbers are told by."""

FARTHEST = 4.0
"""A feature further from the mean of the cases, in standard deviations, counts as so far."""

WIDTHS = (1.0, 2.0, 3.0, 5.0, 8.0, 16.0)
"""Of the kernel, in standard deviations of the first component."""

RIDGES = np.geomspace(1e-3, 30.0, 12)
"""Variance of what features do not tell, as a part of a number's own."""


def tell_numbers(
    in_order: Sequence[PreparedMeasurement], catalogue: Catalogue
) -> tuple[FoundLoad | None, ToldNumbers | None]:
    """Tell numbers of a machine by recordings of it in order.

    Parameters
    ----------
    in_order : sequence of PreparedMeasurement
        One at least; those by the sensors and at the speed of the first one count, by their mean.
    catalogue : Catalogue
        Of the machine.

    Returns
    -------
    (FoundLoad or None, ToldNumbers or None)
        The load, where the machine may have one; and what else is told. Neither where the machine cannot be simulated.
    """
    first = in_order[0]
    speed = math.copysign(first.drive_speed, catalogue.recipe.nominal_drive_speed)
    with one_thread():
        load = find_load(catalogue, [(first, HEALTHY, 1.0)], speed, takes_work=True)
    machine, drawn = draw_cases(catalogue, speed, [()], load, CASES, doubted=True)
    cases = simulate_cases(catalogue, machine, drawn)
    if len(cases.entries) < CASES // 2:
        return None, None
    sensing = exact_sensing(first)
    shown = np.mean([features_of(each, sensing) for each in _alike(in_order, catalogue)], axis=0)
    rows = {HEALTHY: cases.rows(HEALTHY)}
    (draws,) = training_set(cases, sensing, watched_levels(first), Learning(rows=1), rows=rows).hypotheses
    own = (f"links.{machine.frame}.", "supports.", "modes.", "drive.ripple.")
    paths = tuple(path for path in cases.entries[0].parameters if path.startswith(own))
    numbers = np.array([[entry.parameters[path] for path in paths] for entry in cases.entries])
    logarithmic = np.asarray((numbers > 0.0).all(axis=0), bool)
    numbers[:, logarithmic] = np.log(numbers[:, logarithmic])
    parts, of_load = np.array([COMMON, DIFFERENCE]), load.paths if load else ()
    sizes = np.array([[entry.parameters[path] for path in of_load] for entry in cases.entries])
    sizes = sizes @ parts.T if load else sizes
    with one_thread():
        mean, error = regress(draws.features, np.hstack([sizes, numbers]), shown)
    if load:
        back = np.linalg.inv(parts)
        load = replace(load, mean=back @ mean[:2], covariance=back @ np.diag(error[:2] ** 2) @ back.T, wider=1.0)
    return load, ToldNumbers(paths, mean[len(of_load) :], error[len(of_load) :], logarithmic)


def _alike(in_order: Sequence[PreparedMeasurement], catalogue: Catalogue) -> list[PreparedMeasurement]:
    """Recordings by the sensors, in the bands and at the stored speed of the first one."""

    def seen(each: PreparedMeasurement) -> tuple[object, ...]:
        return (*view_of(each), each.cuts, catalogue.matrix.nearest_speed(each.drive_speed))

    return [each for each in in_order if seen(each) == seen(in_order[0])]


def regress(features: FloatArray, numbers: FloatArray, shown: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return numbers (p,) of what shows features (d,), and their errors, by cases of both, (n, d) and (n, p).

    Kernel ridge regression on principal components; width and penalty are those of the least error where one case is
    left out, for every number (B. Schölkopf, A. Smola, Learning with Kernels (2002), 4).
    """
    middle, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    away, here = (features - middle) / scale, np.clip((shown - middle) / scale, -FARTHEST, FARTHEST)
    axes = np.linalg.svd(away, full_matrices=False)[2][:COMPONENTS].T
    points, point = away @ axes, here @ axes
    unit = points[:, 0].std()
    squares = np.sum(points**2, axis=1)
    apart = np.maximum(squares[:, None] + squares - 2.0 * points @ points.T, 0.0) / unit**2
    off = np.sum((points - point) ** 2, axis=1) / unit**2
    mean, spread = numbers.mean(axis=0), numbers.std(axis=0) + 1e-300
    known = (numbers - mean) / spread
    found, errors = np.zeros(len(mean)), np.full(len(mean), np.inf)
    for width in WIDTHS:
        sizes, ways = np.linalg.eigh(np.exp(-0.5 * apart / width**2))
        sizes, turned = np.maximum(sizes, 0.0), ways.T @ known
        near = np.exp(-0.5 * off / width**2) @ ways
        for ridge in RIDGES:
            part = sizes / (sizes + ridge)
            left = (known - (ways * part) @ turned) / (1.0 - np.sum(ways**2 * part, axis=1))[:, None]
            error = np.sqrt(np.mean(left**2, axis=0))
            told = (near / (sizes + ridge)) @ turned
            found, errors = np.where(error < errors, told, found), np.minimum(error, errors)
    return mean + spread * found, spread * errors
