"""What recordings of a machine in order tell of its numbers: load, ripple, frame and mounts, by simulations of it.

Low orders of a rigid frame tell how a load differs between the strokes, if that takes work from the drive. A constant
load along a slide does not shake the frame, and ripple, frame and mounts change the same orders; but all of them change
how fits rattle, which simulations know.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.diagnosing.comparison import common_sensing, features_of, view_of, watched_levels
from jointplay.catalogue.diagnosing.found_cases import counting, draw_cases, on_a_day
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.kept_cases import simulate_once
from jointplay.catalogue.diagnosing.stroke_loads import COMMON, DIFFERENCE, FoundLoad, find_load
from jointplay.catalogue.diagnosing.told import ToldContacts, ToldNumbers, geometric_mean, of_joints
from jointplay.catalogue.matching.learning import Learning, training_set
from jointplay.catalogue.matching.model_library import one_thread
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.plans.entry import HEALTHY
from jointplay.catalogue.plans.parameters import SHARED
from jointplay.catalogue.plans.variants import LawChoice
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

CASES = 768
"""Of the machine in order."""

SAME_SPEED = 0.01
"""Speeds that differ by less, as a part, are one."""

FARTHEST = 4.0
"""A feature further from the mean of the cases, in standard deviations, counts as so far."""

LEAST_LAW = 0.1
"""Probability of a contact law, at least: real contacts obey none."""

LEAST_OF_LAW = 48
"""Cases of a contact law, at least: fewer tell nothing."""

WIDTHS = (1.0, 2.0, 3.0, 5.0, 8.0, 16.0)
"""Of the kernel, in standard deviations of the largest principal component of the features."""

RIDGES = np.geomspace(1e-3, 30.0, 12)
"""Variance of what features do not tell, as a part of a number's own."""


def tell_numbers(
    in_order: Sequence[PreparedMeasurement],
    catalogue: Catalogue,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FoundLoad | None, ToldNumbers | None]:
    """Tell numbers of a machine by recordings of it in order.

    Parameters
    ----------
    in_order : sequence of PreparedMeasurement
        One at least; those by the sensors and at the speed of the first one count, by their mean.
    catalogue : Catalogue
        Of the machine.
    progress : callable, optional
        Called with the number of cases done and their total, where they are simulated.

    Returns
    -------
    (FoundLoad or None, ToldNumbers or None)
        The load, where the machine may have one; and what else is told, of mounts as they are when it is neither warm
        nor cold. Neither where the machine cannot be simulated.
    """
    first = in_order[0]
    speed = math.copysign(first.drive_speed, catalogue.recipe.nominal_drive_speed)
    with one_thread():
        load = find_load(catalogue, [(first, HEALTHY, 1.0)], speed, takes_work=True)
    machine, drawn = draw_cases(catalogue, speed, [()], load, CASES, doubted=True)
    doubtful = (f"links.{machine.frame}.", "supports.", "modes.", "drive.ripple.")
    paths = tuple(path for path in drawn[0].parameters if path.startswith(doubtful))
    if not (paths or load):
        return None, None
    asked = [on_a_day(entry, machine, catalogue.recipe) for entry in drawn]
    cases = simulate_once(catalogue, machine, asked, counting(progress, 0, len(asked)))
    if len(cases.entries) < CASES // 2:
        return None, None
    parts, of_load = np.array([COMMON, DIFFERENCE]), load.paths if load else ()
    usual = {entry.draw: entry.parameters for entry in drawn}
    sizes, numbers = (
        np.array([[usual[entry.draw][path] for path in some] for entry in cases.entries]) for some in (of_load, paths)
    )
    logarithmic = np.asarray((numbers > 0.0).all(axis=0), bool)
    numbers[:, logarithmic] = np.log(numbers[:, logarithmic])
    with one_thread():
        sensing, shown = _shown(in_order)
        rows = {HEALTHY: cases.rows(HEALTHY)}
        (draws,) = training_set(cases, sensing, watched_levels(first), Learning(rows=1), rows=rows).hypotheses
        both = np.hstack([sizes @ parts.T if load else sizes, numbers])
        mean, error, left = regress(draws.features, both, shown)
        contacts = _tell_contacts(cases, draws.features, shown, catalogue.plan.law_weights(machine))
    if load:
        back = np.linalg.inv(parts)
        load = replace(load, mean=back @ mean[:2], covariance=back @ np.diag(error[:2] ** 2) @ back.T, wider=1.0)
    first_own = len(of_load)
    covariance = covariance_of(left[:, first_own:], error[first_own:])
    return load, ToldNumbers(paths, mean[first_own:], covariance, logarithmic, contacts)


def _tell_contacts(
    cases: FoundSpectra, features: FloatArray, shown: FloatArray, laws: Collection[LawChoice]
) -> ToldContacts | None:
    """What features (d,) tell of which contact law a machine has, and of its contacts by each, by cases (n, d).

    What is expected of whether it has a law is how probable that is. None where contacts are not drawn, or cases of a
    law could not be simulated.
    """
    drawn = np.array([entry.variant.law for entry in cases.entries])
    if min(np.count_nonzero(drawn == law) for law in laws) < LEAST_OF_LAW:
        return None
    expected, _, _ = regress(features, np.column_stack([drawn == law for law in laws]).astype(float), shown)
    shares = np.clip(expected, LEAST_LAW, 1.0)
    numbers = {}
    for law in laws:
        own = [entry.parameters for entry in cases.entries if entry.variant.law == law]
        paths = tuple(path for path in SHARED if path.startswith("contact.") and _is_drawn(own, path))
        if not paths:
            return None
        means = np.log([[geometric_mean(of_joints(each, path)) for path in paths] for each in own])
        mean, error, left = regress(features[drawn == law], means, shown)
        numbers[law] = ToldNumbers(paths, mean, covariance_of(left, error), np.full(len(paths), True))
    return ToldContacts(dict(zip(laws, (shares / shares.sum()).tolist(), strict=True)), numbers)


def _is_drawn(parameters: Sequence[Mapping[str, float]], path: str) -> bool:
    """Whether all joints of all cases have a number > 0 that a short path stands for."""
    return all(min(of_joints(each, path).values(), default=0.0) > 0.0 for each in parameters)


def _shown(in_order: Sequence[PreparedMeasurement]) -> tuple[Sensing, FloatArray]:
    """How recordings like the first one see cases, by the loudest noise and the shortest length; their mean features.

    Those by its sensors, in its bands and at its speed.
    """
    first = in_order[0]
    alike = [
        each
        for each in in_order
        if (view_of(each), each.cuts) == (view_of(first), first.cuts)
        and abs(each.drive_speed / first.drive_speed - 1.0) < SAME_SPEED
    ]
    sensing = common_sensing(alike)
    return sensing, np.mean([features_of(each, sensing) for each in alike], axis=0)


def regress(features: FloatArray, numbers: FloatArray, shown: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return numbers (p,) of what shows features (d,), their errors, and those (n, p) of cases that are left out.

    By cases of both, (n, d) and (n, p).

    Kernel ridge regression; width and penalty are those of the least error where one case is left out, for every
    number. Away from all cases the error grows to the scatter of the number (C. E. Rasmussen, C. K. I. Williams,
    Gaussian Processes for Machine Learning (2006), 2.2 and 5.4.2).
    """
    middle, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    points, point = (features - middle) / scale, np.clip((shown - middle) / scale, -FARTHEST, FARTHEST)
    unit = np.linalg.norm(points, 2) / math.sqrt(len(points))
    squares = np.sum(points**2, axis=1)
    apart = np.maximum(squares[:, None] + squares - 2.0 * points @ points.T, 0.0) / unit**2
    off = np.sum((points - point) ** 2, axis=1) / unit**2
    mean, spread = numbers.mean(axis=0), numbers.std(axis=0) + 1e-300
    known = (numbers - mean) / spread
    found, errors = np.zeros(len(mean)), np.full(len(mean), np.inf)
    beyond, missed = np.zeros(len(mean)), np.zeros_like(numbers)
    for width in WIDTHS:
        sizes, ways = np.linalg.eigh(np.exp(-0.5 * apart / width**2))
        sizes, turned = np.maximum(sizes, 0.0), ways.T @ known
        near = np.exp(-0.5 * off / width**2) @ ways
        for ridge in RIDGES:
            inverse = np.sum(ways**2 / (sizes + ridge), axis=1)
            left = (ways / (sizes + ridge)) @ turned / inverse[:, None]
            error = np.sqrt(np.mean(left**2, axis=0))
            told = (near / (sizes + ridge)) @ turned
            # What a Gaussian process knows less of what is shown than of cases that are left out.
            less = max(0.0, 1.0 - float(np.sum(near**2 / (sizes + ridge))) - float(np.mean(1.0 / inverse - ridge)))
            better = error < errors
            found, beyond = np.where(better, told, found), np.where(better, less, beyond)
            missed = np.where(better, left, missed)
            errors = np.minimum(error, errors)
    return mean + spread * found, spread * np.minimum(1.0, np.sqrt(errors**2 + beyond)), spread * missed


def covariance_of(left: FloatArray, error: FloatArray) -> FloatArray:
    """Return the covariance (p, p) of numbers with such errors (p,), which go together as those (n, p) of cases do.

    Both directions of a mount are one number of a draw, and a day is common to all mounts. A number that no case draws
    anew has none.
    """
    scaled = left * (error / np.maximum(np.sqrt(np.mean(left**2, axis=0)), 1e-300))
    return np.asarray(scaled.T @ scaled / len(left))
