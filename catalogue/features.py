"""A recording made ready to be compared: band powers of the frame's motion, their noise, and the feature vector.

Features are levels in dB: orders 1 to 20, one order wide each, then third octaves to 4 kHz, of x, y and theta (or of
the sensors there are), clipped below at the noise of the band.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from catalogue.drivespeed import SpeedEstimate, SpeedTrack, track_speed
from catalogue.errors import MeasurementError
from catalogue.feature_bands import (
    FEATURE_ORDERS,
    LEAST_POWER,
    FeatureAxis,
    feature_axes,
    feature_vector,
    joined,
    usable_cuts,
)
from catalogue.hum import SteadyLine, remove_hum
from catalogue.measurement import Measurement
from catalogue.noise import NoiseFloor, noise_floor
from catalogue.parameters import nominal_drive_speed
from catalogue.sensors import SensorMap, map_sensors
from solver.machines.machine import Machine
from solver.spectra.band_power import BandMatrix, band_matrix
from solver.spectra.bands import BandScheme

__all__ = [
    "FEATURE_ORDERS",
    "FeatureAxis",
    "PreparedMeasurement",
    "feature_axes",
    "feature_vector",
    "prepare",
    "usable_cuts",
]

FloatArray = npt.NDArray[np.float64]

#: Revolutions below which a recording is refused, and warned of.
MIN_REVOLUTIONS = 3.0
FEW_REVOLUTIONS = 10.0
#: Deviation from the nominal speed that is warned of.
FAR_FROM_NOMINAL = 0.05

#: Difference of a given speed from the one in the recording, relative, up to which they agree.
GIVEN_AGREES = 0.005


@dataclass(frozen=True, eq=False)
class PreparedMeasurement:
    """A recording as it is compared with a catalogue.

    Parameters
    ----------
    name : str
    sensing : SensorMap
        Columns, sensors, and how they make the compared channels.
    speed : SpeedEstimate
    revolutions : float
        Drive revolutions in the recording.
    bands : BandMatrix
        Cross-powers (B, c, c) of the compared channels.
    noise_power : (B, c) array
        Power of the recording's own noise in every band of the compared channels.
    floor : NoiseFloor
        Of the used columns, as recorded.
    lines : tuple of SteadyLine
        Hum that was taken out.
    cuts : tuple of int, (G + 1,)
        Feature band ``g`` joins bands ``cuts[g]`` to ``cuts[g + 1] - 1``; only bands the sample rate covers.
    warnings : tuple of str
        Of the import and of the preparation.
    notes : tuple of str
        What was understood and done, without alarm.
    """

    name: str
    sensing: SensorMap
    speed: SpeedEstimate
    revolutions: float
    bands: BandMatrix
    noise_power: FloatArray
    floor: NoiseFloor
    lines: tuple[SteadyLine, ...]
    cuts: tuple[int, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """Compared channels, (c,)."""
        return self.sensing.compared

    @property
    def drive_speed(self) -> float:
        """Mean drive speed [rad/s]."""
        return self.speed.speed

    @property
    def group_power(self) -> FloatArray:
        """Power in each feature band, (G, c), noise included."""
        return joined(self.bands.auto_power, self.cuts)

    @property
    def group_noise(self) -> FloatArray:
        """Noise power in each feature band, (G, c)."""
        return np.maximum(joined(self.noise_power, self.cuts), LEAST_POWER)

    @property
    def group_degrees_of_freedom(self) -> FloatArray:
        """Degrees of freedom of the noise power in each feature band, (G,)."""
        return joined(self.bands.degrees_of_freedom[:, None], self.cuts)[:, 0]

    @property
    def features(self) -> FloatArray:
        """Feature vector, (G * c,), dB; see :func:`feature_vector`."""
        return feature_vector(self.bands.power, self.cuts, noise=self.group_noise)

    @property
    def axes(self) -> tuple[FeatureAxis, ...]:
        """What each number of the feature vector is, (G * c,)."""
        return feature_axes(self.bands.scheme, self.cuts, self.channels, self.drive_speed)


def prepare(
    measurement: Measurement,
    machine: Machine,
    mapping: Mapping[str, str] | None = None,
    speed: float | None = None,
    scheme: BandScheme | None = None,
) -> PreparedMeasurement:
    """Make a recording ready to be compared.

    Parameters
    ----------
    measurement : Measurement
    machine : Machine
        Gives sensors, frame and nominal drive speed.
    mapping : mapping of column to sensor, optional
    speed : float, optional
        Mean drive speed [rad/s] where it is known; estimated otherwise.
    scheme : BandScheme, optional
        The catalogue's; the default is that of the machine's nominal speed.

    Returns
    -------
    PreparedMeasurement

    Raises
    ------
    MeasurementError
        No column matches a sensor, the recording is shorter than three revolutions, does not reach order 20, or its
        speed cannot be found.
    """
    sensing = map_sensors(measurement, machine, mapping)
    signal = np.ascontiguousarray(measurement.signal[:, sensing.columns])
    rate = measurement.sample_rate
    nominal = nominal_drive_speed(machine)
    warnings = [*measurement.warnings, *sensing.warnings]
    if speed is not None and not (abs(speed) > 0 and math.isfinite(speed)):
        raise MeasurementError(measurement.name, value=speed, rule="drive speed must be finite and not zero")
    _refuse_short(measurement, speed or nominal, allowance=0.1 if speed is None else 0.0)
    track, doubt = _track(signal, rate, nominal, speed, measurement.name)
    warnings += doubt
    estimate = track.estimate
    revolutions = _refuse_short(measurement, estimate.speed)
    turn = estimate.speed / (2.0 * math.pi)
    if 0.5 * rate < (FEATURE_ORDERS + 0.5) * turn:
        rule = f"sample rate {rate:g} Hz: does not reach order {FEATURE_ORDERS} of a drive at {turn:.4g} Hz"
        raise MeasurementError(measurement.name, rule=rule)
    cleaned = remove_hum(signal, rate, track)
    floor = noise_floor(cleaned.signal, rate, measurement.name)
    scheme = scheme or BandScheme.for_drive(nominal)
    bands = band_matrix(
        cleaned.signal,
        rate,
        estimate.speed,
        scheme,
        channels=sensing.compared,
        derivatives=sensing.derivatives,
        combine=sensing.channels,
    )
    edges = scheme.edges_hz(estimate.speed)
    noise = floor.band_power(edges, sensing.derivatives) @ (sensing.channels**2).T
    cuts = usable_cuts(scheme, estimate.speed, rate)
    if round(revolutions) < FEW_REVOLUTIONS:
        warnings.append(f"only {revolutions:.1f} revolutions: results are less certain below {FEW_REVOLUTIONS:g}")
    if abs(estimate.speed / abs(nominal) - 1.0) > FAR_FROM_NOMINAL:
        warnings.append(
            f"drive speed {60 * turn:.4g} rpm is far from the nominal {abs(nominal) * 30 / math.pi:.4g} rpm"
        )
    if cuts[-1] < scheme.count:
        warnings.append(
            f"sample rate {rate:g} Hz: bands above {edges[cuts[-1]]:.4g} Hz are not compared"
            f" (the catalogue goes to {edges[-1]:.4g} Hz)"
        )
    notes = [*measurement.import_report, _speed_note(estimate)]
    notes += [
        f"steady line at {line.frequency:.2f} Hz taken out, amplitude up to {line.amplitude.max():.2g}"
        for line in cleaned.lines
    ]
    return PreparedMeasurement(
        name=measurement.name,
        sensing=sensing,
        speed=estimate,
        revolutions=revolutions,
        bands=bands,
        noise_power=noise,
        floor=floor,
        lines=cleaned.lines,
        cuts=cuts,
        warnings=tuple(warnings),
        notes=tuple(notes),
    )


def _speed_note(estimate: SpeedEstimate) -> str:
    rpm = estimate.speed * 30.0 / math.pi
    if estimate.given:
        return f"drive speed {rpm:.6g} rpm, as given"
    return f"drive speed {rpm:.6g} rpm +- {100 * estimate.uncertainty / estimate.speed:.2g} %, found in the recording"


def _refuse_short(measurement: Measurement, speed: float, allowance: float = 0.0) -> float:
    """Revolutions in the recording; refused when there are less than three even with the allowance."""
    revolutions = measurement.duration * abs(speed) / (2.0 * math.pi)
    if revolutions * (1.0 + allowance) < MIN_REVOLUTIONS:
        rule = (
            f"{measurement.duration:.4g} s are {revolutions:.2f} revolutions; at least {MIN_REVOLUTIONS:g} are needed"
        )
        raise MeasurementError(measurement.name, rule=rule)
    return revolutions


def _track(
    signal: FloatArray, rate: float, nominal: float, speed: float | None, source: str
) -> tuple[SpeedTrack, list[str]]:
    """Course of the speed, and what makes a given one doubtful.

    A given mean is kept; its course still tells hum from orders, where one can be found.
    """
    if speed is None:
        return track_speed(signal, rate, nominal, source), []
    given = SpeedEstimate(abs(speed), 0.0, True)
    steady = SpeedTrack(np.array([0.0]), np.array([abs(speed)]), given)
    try:
        track = track_speed(signal, rate, speed, source)
    except MeasurementError:
        return steady, []
    found = track.estimate.speed
    if abs(found / abs(speed) - 1.0) > GIVEN_AGREES:
        told, seen = (each * 30.0 / math.pi for each in (abs(speed), found))
        return steady, [f"drive speed {told:.5g} rpm is given, but the orders in the recording are of {seen:.5g} rpm"]
    return dataclasses.replace(track, estimate=given), []
