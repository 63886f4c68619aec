"""The catalogue browser's worker task: what a worn joint looks like against a machine in order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from jointplay.app.jobs.tasks import open_catalogue
from jointplay.app.pages.understanding import RPM
from jointplay.solver.spectra.bands import BandScheme

if TYPE_CHECKING:
    from jointplay.catalogue.storage.matrix import FeatureMatrix
    from jointplay.solver.spectra.spectrum import Quantity, Scaling

HEALTHY = "healthy"
#: Power shown at least: 10 um/s2 is less than any accelerometer sees, and an ideal machine is far stiller than that.
LEAST = 1e-10


def nearest(
    directory: str, stamp: str, hypothesis: str, clearance: float, quantity: Quantity, scaling: Scaling
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

    Returns
    -------
    dict
        ``orders`` (G,); ``levels``, ``healthy``, ``low`` and ``high`` by channel, (G,) each, dB: of the entry, and the
        median and the central 90 % of the healthy ones; ``key``, ``clearances_um``, ``speed_rpm``, ``healthy_entries``.
    """
    catalogue = open_catalogue(directory, stamp)
    matrix = catalogue.matrix
    rows = _select_trusted(matrix, hypothesis)
    worn = [matrix.joints.index(joint) for joint in joints_of(matrix, hypothesis)]
    chosen = int(rows[0])
    if worn:
        off = np.abs(np.log(matrix.clearance(rows)[:, worn] / clearance)).sum(axis=1)
        chosen = int(rows[np.argmin(off)])
    in_order = _select_trusted(matrix, HEALTHY)
    table = matrix.table(np.array([chosen]))
    singles = int(np.sum(np.diff(matrix.edges) <= 1.0 + 1e-9))
    scheme = BandScheme(matrix.edges, singles)

    speed = float(table.drive_speed[0])

    def levels(rows: Any) -> Any:
        power = np.maximum(matrix.packed(rows)[..., :3], LEAST).astype(np.float64)
        return (20 if scaling in ("rms", "peak") else 10) * np.log10(scheme.scale(power, speed, quantity, scaling))

    spectrum = levels(np.array([chosen]))[0]
    sound = levels(in_order) if len(in_order) else spectrum[None]
    low, middle, high = np.quantile(sound, (0.05, 0.5, 0.95), axis=0)
    channels = ("x", "y", "theta")
    return {
        "orders": scheme.centres.tolist(),
        "levels": {name: spectrum[:, i].tolist() for i, name in enumerate(channels)},
        "healthy": {name: middle[:, i].tolist() for i, name in enumerate(channels)},
        "low": {name: low[:, i].tolist() for i, name in enumerate(channels)},
        "high": {name: high[:, i].tolist() for i, name in enumerate(channels)},
        "key": str(table.key[0]),
        "clearances_um": {matrix.joints[i]: float(1e6 * table.clearance[0, i]) for i in worn},
        "speed_rpm": abs(float(table.drive_speed[0])) * RPM,
        "healthy_entries": len(in_order),
    }


def joints_of(matrix: FeatureMatrix, hypothesis: str) -> tuple[str, ...]:
    """Return the worn joints of a hypothesis of a catalogue."""
    return next(tuple(found.joints) for found in matrix.hypotheses if found.label == hypothesis)


def _select_trusted(matrix: FeatureMatrix, label: str) -> Any:
    """Rows at the machine's own speed, of the machine as modelled where there are such entries."""
    for stratum in ("trusted", "wide"):
        rows = matrix.rows(label, stratum, speed=matrix.nominal_speed)
        if len(rows):
            return rows
    return matrix.rows(label)
