"""The catalogue browser's worker task: what a worn joint looks like against a machine in order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from jointplay.app.jobs.tasks import BaselineFile, in_order, open_catalogue
from jointplay.app.pages.understanding import RPM
from jointplay.catalogue.signals.shown_matched import nearest_rows, trusted_rows
from jointplay.solver.spectra.bands import BandScheme

if TYPE_CHECKING:
    from jointplay.catalogue.storage.matrix import FeatureMatrix
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.arrays import FloatArray
    from jointplay.solver.spectra.spectrum import Quantity, Scaling

CHANNELS = ("x", "y", "theta")
HEALTHY = "healthy"
"""Label of the machine in order: no joint is worn, every one has the play of a new fit."""

#: Power shown at least: 10 um/s2 is less than any accelerometer sees, and an ideal machine is far stiller than that.
LEAST = 1e-10
#: Clearances in a family, and entries about each of which the median is drawn.
FAMILY, ALIKE = 4, 9


def nearest(
    directory: str,
    stamp: str,
    hypothesis: str,
    clearance: float,
    quantity: Quantity,
    scaling: Scaling,
    baseline: BaselineFile | None = None,
) -> dict[str, Any]:
    """Return the entry that is nearest to a clearance, beside the entries of a machine in order.

    Parameters
    ----------
    directory, stamp : str
        Of the catalogue, as for :func:`jointplay.app.jobs.tasks.diagnose`.
    hypothesis : str
        Its label; one that the catalogue has entries of.
    clearance : float
        Radial, of every worn joint, m, greater than 0.
    quantity, scaling : str
        Of the levels.
    baseline : BaselineFile, optional
        Path, name and what is told of a recording of a machine in order, to be shown, too.

    Returns
    -------
    dict
        ``orders`` (G,); ``levels``, ``healthy``, ``low`` and ``high`` by channel, (G,) each, dB: of the entry, and the
        median and the central 90 % of the healthy ones; ``family``: medians of entries alike in clearance, each with
        ``clearance_um`` and ``levels``; ``baseline``: levels of those channels that the recording has, None in bands
        that it does not reach, and ``refused``, why it has none; ``key``, ``clearances_um``, ``speed_rpm``,
        ``healthy_entries``.
    """
    catalogue = open_catalogue(directory, stamp)
    matrix = catalogue.matrix
    rows = trusted_rows(matrix, hypothesis)
    worn = [matrix.joints.index(joint) for joint in joints_of(matrix, hypothesis)]
    chosen = int(rows[0])
    if worn:
        chosen = int(nearest_rows(matrix, rows, dict.fromkeys(joints_of(matrix, hypothesis), clearance))[0])
    sound_rows = trusted_rows(matrix, HEALTHY)
    table = matrix.table(np.array([chosen]))
    singles = int(np.sum(np.diff(matrix.edges) <= 1.0 + 1e-9))
    scheme = BandScheme(matrix.edges, singles)
    speed = float(table.drive_speed[0])

    def decibels(power: FloatArray, speed: float) -> Any:
        found = scheme.scale(np.maximum(power, LEAST), speed, quantity, scaling)
        return (20 if scaling in ("rms", "peak") else 10) * np.log10(found)

    def levels(rows: Any) -> Any:
        return decibels(np.asarray(matrix.packed(rows)[..., :3], dtype=np.float64), speed)

    def reached(power: FloatArray, speed: float) -> list[float | None]:
        bands, whole = len(power), len(scheme.centres)
        found = decibels(np.pad(power, (0, whole - bands))[:, None], speed)[:bands, 0]
        return [*found.tolist(), *([None] * (whole - bands))]

    spectrum = levels(np.array([chosen]))[0]
    sound = levels(sound_rows) if len(sound_rows) else spectrum[None]
    low, middle, high = np.quantile(sound, (0.05, 0.5, 0.95), axis=0)
    measured, refused = ({}, "") if baseline is None else _measured(catalogue, baseline)
    return {
        "orders": scheme.centres.tolist(),
        "levels": _by_channel(spectrum),
        "healthy": _by_channel(middle),
        "low": _by_channel(low),
        "high": _by_channel(high),
        "family": [
            {"clearance_um": 1e6 * size, "levels": _by_channel(np.median(levels(alike), axis=0))}
            for size, alike in _family(matrix, rows, worn)
        ],
        "baseline": {name: reached(power, turned) for name, (power, turned) in measured.items()},
        "refused": refused,
        "key": str(table.key[0]),
        "clearances_um": {matrix.joints[i]: float(1e6 * table.clearance[0, i]) for i in worn},
        "speed_rpm": abs(float(table.drive_speed[0])) * RPM,
        "healthy_entries": len(sound_rows),
    }


def _by_channel(levels: Any) -> dict[str, list[float]]:
    return {name: levels[:, i].tolist() for i, name in enumerate(CHANNELS)}


def _family(matrix: FeatureMatrix, rows: Any, worn: list[int]) -> list[tuple[float, Any]]:
    """Clearances [m] evenly over what entries of a hypothesis have, each with the rows nearest to it."""
    if not worn:
        return []
    sizes = np.log(matrix.clearance(rows)[:, worn]).mean(axis=1)
    sorted_rows, sorted_sizes = rows[np.argsort(sizes)], np.sort(sizes)
    found = []
    for wanted in np.linspace(sorted_sizes[0], sorted_sizes[-1], FAMILY):
        alike = np.sort(np.argsort(np.abs(sorted_sizes - wanted))[:ALIKE])
        found.append((float(np.exp(np.median(sorted_sizes[alike]))), sorted_rows[alike]))
    return found


def _measured(catalogue: Catalogue, baseline: BaselineFile) -> tuple[dict[str, tuple[FloatArray, float]], str]:
    """Power in bands and drive speed [rad/s] of a recording, by motion of the frame; or why there is none."""
    from jointplay.catalogue.errors import MeasurementError
    from jointplay.catalogue.signals.features import prepare

    try:
        healthy = in_order(baseline)
        found = prepare(
            healthy.recording,
            catalogue.machine,
            healthy.mapping,
            healthy.speed,
            scheme=catalogue.scheme,
            nominal=catalogue.recipe.nominal_drive_speed,
            near=catalogue.drive_speeds,
        )
    except MeasurementError as error:
        return {}, str(error)
    power = found.group_power
    known = {name: (power[:, i], found.drive_speed) for i, name in enumerate(found.channels) if name in CHANNELS}
    return known, "" if known else "its sensors do not give the motions of the frame"


def joints_of(matrix: FeatureMatrix, hypothesis: str) -> tuple[str, ...]:
    """Return the worn joints of a hypothesis of a catalogue."""
    return next(tuple(found.joints) for found in matrix.hypotheses if found.label == hypothesis)
