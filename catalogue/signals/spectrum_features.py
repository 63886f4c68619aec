"""From a spectrum to what is compared, as :mod:`jointplay.catalogue.signals.features` does it with recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import COMB_CONTRAST_DB, OTHER_MACHINE, SEARCH_RANGE, SpeedEstimate
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.plans.driving import nominal_drive_speed
from jointplay.catalogue.signals.feature_bands import usable_cuts
from jointplay.catalogue.signals.noise import FLOOR_FROM, FREQUENCY_QUANTILE, LINES_TOGETHER, NoiseFloor
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.recipe_steps import note_step
from jointplay.catalogue.signals.sensors import map_sensors, sensors_one_by_one
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.band_power import BandMatrix
from jointplay.solver.spectra.bands import FEATURE_ORDERS, BandScheme

#: Lines an order that a spectrum must have at least: coarser, an order is not to be told from its neighbours.
LINES_AN_ORDER = 3.0
#: Last order of the coarse comb and of the fine one; the first order lies in the skirt of the offset.
COMB = (12, 40)


def prepare_spectrum(
    spectrum: MeasuredSpectrum,
    machine: Machine,
    mapping: Mapping[str, str] | None = None,
    speed: float | None = None,
    scheme: BandScheme | None = None,
    nominal: float | None = None,
) -> PreparedMeasurement:
    """Make a spectrum ready to be compared; parameters and errors as for
    :func:`jointplay.catalogue.signals.features.prepare`.
    """
    nominal = nominal or nominal_drive_speed(machine)
    if speed is not None and not (abs(speed) > 0 and math.isfinite(speed)):
        raise MeasurementError(spectrum.name, value=speed, rule="drive speed must be finite and not zero")
    sensing = sensors_one_by_one(map_sensors(spectrum, machine, mapping))
    step, top = spectrum.resolution, float(spectrum.frequency[-1])
    turn = abs(speed or nominal) / (2.0 * math.pi)
    if turn / step < LINES_AN_ORDER:
        rule = f"lines {step:.4g} Hz apart: a drive at {turn:.4g} Hz needs {turn / LINES_AN_ORDER:.3g} Hz or less"
        raise MeasurementError(spectrum.name, rule=rule)
    _refuse_beyond(spectrum.name, top, (1.0 - SEARCH_RANGE * (speed is None)) * turn)
    density = spectrum.density[:, list(sensing.columns)]
    density = density * (2.0 * np.pi * spectrum.frequency[:, None]) ** (2 * np.array(sensing.derivatives))
    estimate = (
        SpeedEstimate(abs(speed), 0.0, True)
        if speed is not None
        else _speed(density, spectrum.frequency, step, turn, spectrum.name)
    )
    turn = estimate.speed / (2.0 * math.pi)
    _refuse_beyond(spectrum.name, top, turn)
    scheme = scheme or BandScheme.for_drive(nominal)
    edges = scheme.edges_hz(estimate.speed)
    begin = float(spectrum.frequency[0]) - 0.5 * step
    if begin > edges[0]:
        rule = f"begins at {begin:.4g} Hz: the first band of a drive at {turn:.4g} Hz begins at {edges[0]:.4g} Hz"
        raise MeasurementError(spectrum.name, rule=rule)
    cuts = usable_cuts(scheme, estimate.speed, 2.0 * top)
    power = band_power(density, spectrum.frequency, step, edges)
    floor = NoiseFloor(_floor(density, spectrum.frequency), 2.0 * top)
    freedom = np.maximum(2.0, 2.0 * np.diff(edges) / step)
    count = len(sensing.sensors)
    bands = BandMatrix(
        power=np.einsum("bc,cd->bcd", power, np.eye(count)).astype(np.complex128),
        spread_db=np.zeros((scheme.count, count)),
        segments=1,
        degrees_of_freedom=freedom,
        covered=edges[1:] <= top,
        scheme=scheme,
        drive_speed=estimate.speed,
        sample_rate=2.0 * top,
        channels=sensing.sensors,
    )
    rpm, share = estimate.speed * 30.0 / math.pi, 100.0 * estimate.uncertainty / estimate.speed
    told = "as given" if estimate.given else f"+- {share:.2g} %, found in the spectrum"
    steps = (
        note_step("sensors", parameters={"compared": ", ".join(sensing.compared)},
                   found=f"{', '.join(sensing.sensors)}, one by one: a spectrum has no phases"),
        note_step("drive speed", parameters={"search_range": SEARCH_RANGE},
                   found=f"drive speed {rpm:.6g} rpm {told}"),
        note_step("noise floor", parameters={},
                   found="the quietest tenth of the spectrum: by its course in time it cannot be told"),
        note_step("bands", parameters={"lines_an_order": turn / step},
                   found=f"{', '.join(sensing.compared)} in {len(cuts) - 1} bands up to {edges[cuts[-1]]:.4g} Hz"),
    )  # fmt: skip
    return PreparedMeasurement(
        name=spectrum.name,
        sensing=sensing,
        speed=estimate,
        revolutions=turn / step,
        sensor_bands=bands,
        noise_power=floor.band_power(edges, [0] * count),
        floor=floor,
        lines=(),
        cuts=cuts,
        warnings=(*spectrum.warnings, *sensing.warnings),
        notes=(*spectrum.import_report, steps[1].found),
        steps=steps,
    )


def band_power(density: FloatArray, frequency: FloatArray, step: float, edges: FloatArray) -> FloatArray:
    """Integral of a density over bands; a line that straddles an edge is split in proportion.

    Parameters
    ----------
    density : (n, c) array
    frequency : (n,) array
        Hz.
    step : float
        Hz.
    edges : (B + 1,) array
        Hz.

    Returns
    -------
    (B, c) array
    """
    borders = np.concatenate([frequency - 0.5 * step, [frequency[-1] + 0.5 * step]])
    total = np.vstack([np.zeros(density.shape[1]), np.cumsum(density * step, axis=0)])
    return np.column_stack([np.diff(np.interp(edges, borders, column)) for column in total.T])


def _refuse_beyond(name: str, top: float, turn: float) -> None:
    """Refuse a spectrum that ends [Hz] before the last single order of a drive at `turn` Hz."""
    if top < (FEATURE_ORDERS + 0.5) * turn:
        rule = f"ends at {top:.4g} Hz: does not reach order {FEATURE_ORDERS} of a drive at {turn:.4g} Hz"
        raise MeasurementError(name, rule=rule)


def _speed(density: FloatArray, frequency: FloatArray, step: float, turn: float, source: str) -> SpeedEstimate:
    """Drive frequency whose multiples stand out most from what lies between them, by the low orders, then by all."""
    level = np.log(density + 1e-12 * density.max(axis=0))

    def contrast(candidates: FloatArray, last: int) -> FloatArray:
        orders = np.arange(2, last + 1, dtype=np.float64)
        orders = orders[(orders + 1) * turn * (1.0 + SEARCH_RANGE) < frequency[-1]]
        found = 0.0
        for column in level.T:
            on, off = (np.interp(np.outer(candidates, orders - each), frequency, column) for each in (0.0, 0.5))
            # An order lost in noise says nothing; it must not outvote those that stand out.
            found = found + np.maximum(on - off, 0.0).mean(axis=1)
        return np.asarray(found / level.shape[1], dtype=np.float64)

    candidates = np.arange(1.0 - SEARCH_RANGE, 1.0 + SEARCH_RANGE, step / (20.0 * turn * COMB[0])) * turn
    coarse = contrast(candidates, COMB[0])
    best = int(np.argmax(coarse))
    decibels = float(coarse[best]) * 10.0 / math.log(10.0)
    if decibels < 0.5 * COMB_CONTRAST_DB or best in (0, len(candidates) - 1):
        low, high = (60.0 * turn * (1.0 + side * SEARCH_RANGE) for side in (-1, 1))
        rule = f"no drive speed between {low:.4g} and {high:.4g} rpm stands out of the spectrum: {OTHER_MACHINE}"
        raise MeasurementError(source, rule=rule, field="speed")
    reach = step / COMB[0]
    near = candidates[best] + np.linspace(-reach, reach, 161)
    fine = contrast(near, COMB[1])
    # Half a line at the comb's last order: what the lines next to a maximum cannot tell apart.
    uncertainty = math.pi * step / COMB[0]
    return SpeedEstimate(2.0 * math.pi * float(near[int(np.argmax(fine))]), uncertainty, False, 0.0, decibels)


def _floor(density: FloatArray, frequency: FloatArray) -> FloatArray:
    """Quietest tenth of the lines, some averaged together, (c,)."""
    heard = density[frequency >= FLOOR_FROM]
    count = len(heard) // LINES_TOGETHER
    if count < 1:
        return np.asarray(density.min(axis=0), dtype=np.float64)
    means = heard[: count * LINES_TOGETHER].reshape(count, LINES_TOGETHER, -1).mean(axis=1)
    return np.asarray(np.maximum(np.quantile(means, FREQUENCY_QUANTILE, axis=0), 1e-30), dtype=np.float64)
