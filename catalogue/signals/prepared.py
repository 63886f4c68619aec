"""A recording as it is compared with a catalogue: band powers of its sensors, their noise, and the feature vector.

Features are levels in dB: orders 1 to 20, one order wide each, then third octaves to 4 kHz, of x, y and theta (or of
the sensors there are), clipped below at the noise of the band.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import SpeedEstimate
from jointplay.catalogue.signals.disturbances import Disturbance
from jointplay.catalogue.signals.feature_bands import FeatureAxis, feature_axes, join_bands
from jointplay.catalogue.signals.hum import SteadyLine
from jointplay.catalogue.signals.noise import NoiseFloor
from jointplay.catalogue.signals.recipe_steps import RecipeStep, note_step
from jointplay.catalogue.signals.sensor_flaws import SensorContradiction
from jointplay.catalogue.signals.sensors import SensorMap
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.spectra.band_power import BandMatrix, transform_power
from jointplay.solver.spectra.bands import LEAST_POWER, BandScheme


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
        Drive revolutions in the part that is used, without what was left out of it.
    sensor_bands : BandMatrix
        Cross-powers (B, s, s) of the sensors, as accelerations.
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
    steps : tuple of RecipeStep
        What was done, in order.
    flaws : tuple of SensorContradiction
        Sensors that cannot be as the machine file has them. Nothing was corrected: levels are as recorded.
    disturbances : tuple of Disturbance
        What is not of the machine, and was left out.
    left_out : float
        Share of the time that shocks, drop-outs and clipping cost.
    hum_power : (B,) array, optional
        Power [(m/s2)^2] of every sensor that may be hum, in orders which it cannot be told from; none unless given.
    """

    name: str
    sensing: SensorMap
    speed: SpeedEstimate
    revolutions: float
    sensor_bands: BandMatrix
    noise_power: FloatArray
    floor: NoiseFloor
    lines: tuple[SteadyLine, ...]
    cuts: tuple[int, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    steps: tuple[RecipeStep, ...]
    flaws: tuple[SensorContradiction, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    left_out: float = 0.0
    hum_power: FloatArray | None = None

    @property
    def channels(self) -> tuple[str, ...]:
        """Compared channels, (c,)."""
        return self.sensing.compared

    @property
    def drive_speed(self) -> float:
        """Mean drive speed [rad/s]."""
        return self.speed.speed

    @property
    def scheme(self) -> BandScheme:
        """Bands, in orders of the drive."""
        return self.sensor_bands.scheme

    @cached_property
    def power(self) -> ComplexArray:
        """Cross-powers of the compared channels, (B, c, c)."""
        return transform_power(self.sensor_bands.power, self.sensing.channels)

    @property
    def group_cyclic(self) -> ComplexArray:
        """Cyclic power of the compared channels in each feature band, (G, k, c); phases from the first sample on."""
        whole = transform_power(self.sensor_bands.cyclic, self.sensing.channels)
        return np.ascontiguousarray(np.diagonal(whole, axis1=-2, axis2=-1))

    @property
    def group_power(self) -> FloatArray:
        """Power in each feature band, (G, c), noise included."""
        auto = np.ascontiguousarray(np.diagonal(self.power, axis1=-2, axis2=-1).real)
        return join_bands(auto, self.cuts)

    @property
    def group_noise(self) -> FloatArray:
        """Noise power in each feature band, (G, c)."""
        return np.maximum(join_bands(self.noise_power, self.cuts), LEAST_POWER)

    @property
    def group_hum(self) -> FloatArray:
        """Power that may be hum in each feature band, (G, c)."""
        power = np.zeros(len(self.noise_power)) if self.hum_power is None else self.hum_power
        return join_bands(np.outer(power, np.sum(self.sensing.channels**2, axis=1)), self.cuts)

    @property
    def group_degrees_of_freedom(self) -> FloatArray:
        """Degrees of freedom of the noise power in each feature band, (G,)."""
        return join_bands(self.sensor_bands.degrees_of_freedom[:, None], self.cuts)[:, 0]

    @property
    def axes(self) -> tuple[FeatureAxis, ...]:
        """What each level of the feature vector is, (G * c,): band by band, the channels of a band side by side."""
        return feature_axes(self.scheme, self.cuts, self.channels, self.drive_speed)

    def with_gains(self, gains: Mapping[str, float]) -> PreparedMeasurement:
        """Return the recording as sensors of the right gain would have made it.

        Parameters
        ----------
        gains : mapping of sensor to float
            What each multiplies accelerations by, 1 where it is right; > 0. Sensors that are not in this recording are
            ignored.

        Raises
        ------
        MeasurementError
            A gain is not a positive number.
        """
        factor = np.array([float(gains.get(sensor, 1.0)) for sensor in self.sensing.sensors])
        if not (np.isfinite(factor).all() and (factor > 0).all()):
            raise MeasurementError(self.name, value=dict(gains), rule="sensor gains must be positive and finite")
        power = self.sensor_bands.power / np.outer(factor, factor)
        cyclic = self.sensor_bands.cyclic / np.outer(factor, factor)
        floor = dataclasses.replace(self.floor, density=self.floor.density / factor**2)
        edges, squared = self.scheme.edges_hz(self.drive_speed), (self.sensing.channels**2).T
        before, after = (each.band_power(edges, self.sensing.derivatives) @ squared for each in (self.floor, floor))
        shown = {name: float(value) for name, value in zip(self.sensing.sensors, factor, strict=True)}
        found = ", ".join(f"{name} {100 * (value - 1):+.1f} %" for name, value in shown.items())
        return dataclasses.replace(
            self,
            sensor_bands=dataclasses.replace(self.sensor_bands, power=power, cyclic=cyclic),
            noise_power=after
            * (self.noise_power / np.maximum(before, 1e-300)),  # what sensors have in common changes like their own
            floor=floor,
            steps=(*self.steps, note_step("gains", parameters=shown, found=f"divided out: {found}")),
        )
