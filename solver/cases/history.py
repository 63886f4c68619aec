"""The history that a simulation gives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.answers import answers_of, wrench_on_frame
from jointplay.solver.cases.bending import Bending, seen_as_rigid, taken_for_rigid
from jointplay.solver.cases.case import Case, Status
from jointplay.solver.cases.start import Start
from jointplay.solver.cases.steps import Suspension
from jointplay.solver.cases.turning import Turning, even_angle
from jointplay.solver.equations.links import LinkMotion
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.modes import shapes_at
from jointplay.solver.spectra.by_angle import resample_by_angle
from jointplay.solver.spectra.sensor import sensor_signals
from jointplay.solver.spectra.spectrum import Quantity, Scaling, Spectrum, convert, rescale
from jointplay.solver.spectra.welch import welch

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


MOTIONS = ("x", "y", "theta")
WINDOW_REVOLUTIONS = 4.0
"""Of spectra of a history."""

MOTION_LINES = 40
"""Lowest lines of spectra of displacement and velocity that come from the motion: in the next, the lines beside that of
a sine, converted from its acceleration, hold 0.2 % too much of its displacement, and aliases are far below."""

FLAT_PART = 0.4
"""Of the sample rate: up to there a simulated acceleration is flat and free of aliases."""


@dataclass(frozen=True, eq=False, repr=False)
class History:
    """Motion of the frame in one case.

    Attributes
    ----------
    case : Case
    status : Status
    message : str
        Where and why, for a status other than ok; a remark otherwise, mostly empty.
    t : (n,) array
        s. A case that failed has the samples before its failure. Without those of the transient, where the settings do
        not want them.
    displacement, velocity, acceleration : (n, 3) arrays
        x, y (m ...) and theta (rad ...) of the frame's centre of gravity from the drawn pose, global axes, at t; no
        rows where the settings want no motion.
    band_limited_acceleration : (n, 3) array
        The acceleration to make spectra of: flat to 0.4 and free of aliases below 0.4 of the sample rate.
    sample_rate : float
        Hz.
    transient : float
        Time before which nothing is steady, s; it counts from the drawn pose, as t does.
    drive_speed : float
        rad/s (m/s for a translation); of a torque or a force the mean speed in its limit cycle; 0 where nothing
        repeats.
    step : float
        s; the mean of an error-controlled run.
    seconds : float
        Processor time spent on the case.
    links : LinkMotion or None
        Where it was asked for.
    end : Start or None
        Where the run stands, to go on from; a little later than the last sample, by what the filter needs beyond it.
    turning : Turning or None
        How the driver turned, of a machine whose drive is a torque or a force.
    period : int
        Revolutions after which the motion repeats, where the run was ended for that: it then is one of it; else 0.
    modes, suspension : Bending or None, Suspension or None
        Of a frame with modes; by what one with a frequency response was moved.
    """

    case: Case
    status: Status
    message: str
    t: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    band_limited_acceleration: FloatArray
    sample_rate: float
    transient: float
    drive_speed: float
    step: float
    seconds: float
    links: LinkMotion | None = None
    end: Start | None = None
    turning: Turning | None = None
    period: int = 0
    modes: Bending | None = None
    suspension: Suspension | None = None

    def __repr__(self) -> str:
        told = f"{self.t[-1]:.4g} s at {self.sample_rate:g} Hz" if len(self.t) else "no samples"
        speed = f", drive {self.drive_speed:.4g} rad/s" if self.drive_speed else ""
        return f"<History {self.status}: {self.case.fault.label}, {told}, transient {self.transient:.3g} s{speed}>"

    def spectrum(
        self,
        signals: FloatArray | None = None,
        channels: tuple[str, ...] = MOTIONS,
        point: str = "centre of gravity of the frame, global axes",
        *,
        quantity: Quantity = "acceleration",
        scaling: Scaling = "psd",
    ) -> Spectrum:
        """Return a spectrum after the transient, up to where it is flat: by default density of the acceleration.

        Parameters
        ----------
        signals : (n, c) array, optional
            Band-limited accelerations at t [m/s2], in place of those of the frame.
        channels : tuple of str, (c,)
        point : str
            For the record.
        quantity : {"displacement", "velocity", "acceleration"}
            What the acceleration is converted to, line by line. Of the frame the lowest lines come from the motion
            itself, because a window's neighbouring lines of one order are converted by different factors there.
        scaling : {"psd", "power", "rms", "peak"}

        Raises
        ------
        SettingsError
            The history is too short for a window of four revolutions, or was made without the motion; its driver
            reached no limit cycle.
        """
        if self.turning is not None and not self.turning.is_steady:
            raise SettingsError(f"not steady: {self.turning.reason}")
        used = self.band_limited_acceleration if signals is None else signals
        steady = self.t >= self.transient

        def spectrum_of(values: FloatArray, of: Quantity, units: tuple[str, ...] | None) -> Spectrum:
            return welch(
                values[steady],
                self.sample_rate,
                drive_speed=self.drive_speed or None,
                channels=channels,
                quantity=of,
                units=units,
                revolutions_per_window=WINDOW_REVOLUTIONS,
                transient=self.transient,
                point=point,
            )

        units = None if channels == MOTIONS else ("m/s2",) * len(channels)
        found = convert(spectrum_of(used, "acceleration", units), quantity)
        if signals is None and quantity != "acceleration":
            if not len(self.displacement):
                raise SettingsError(f"spectrum: of the {quantity}: this history was made without the motion")
            found.values[:MOTION_LINES] = spectrum_of(self._motion[quantity], quantity, None).values[:MOTION_LINES]
        flat = found.frequency <= FLAT_PART * self.sample_rate
        return rescale(replace(found, frequency=found.frequency[flat], values=found.values[flat]), scaling)

    def order_spectrum(self, point: str) -> Spectrum:
        """Return the density of the frame's acceleration to take orders from, that of :meth:`spectrum`.

        Of a machine whose drive is a torque or a force over the driver's angle, as if it turned at its mean speed.

        Raises
        ------
        SettingsError
            As there; the driver did not turn in one direction.
        """
        found = self.spectrum(point=point)
        if self.turning is None:
            return found
        steady = self.t >= self.transient
        even, samples = resample_by_angle(self.band_limited_acceleration[steady], self.turning.angle[steady])
        return welch(
            even, samples * abs(self.drive_speed) / (2 * math.pi), drive_speed=self.drive_speed, channels=MOTIONS,
            revolutions_per_window=WINDOW_REVOLUTIONS, transient=self.transient, point=point,
        )  # fmt: skip

    def by_revolutions(self, signals: FloatArray) -> tuple[FloatArray, float, float]:
        """Return signals (n, c) at t as what compares with recordings, which turn evenly within each revolution.

        Returns
        -------
        signals : (m, c) array
            After the transient; of a machine whose drive is a torque or a force at equal steps of its revolutions.
        sample_rate : float
            Hz, at the mean speed.
        angle : float
            Of the drive at the first sample, rad.

        Raises
        ------
        SettingsError
            Its driver reached no limit cycle.
        """
        steady = self.t >= self.transient
        if self.turning is None:
            return signals[steady], self.sample_rate, abs(self.drive_speed) * float(self.t[steady][0])
        if not self.turning.is_steady:
            raise SettingsError(f"not steady: {self.turning.reason}")
        if self.period:
            return signals, self.sample_rate, abs(float(self.turning.angle[0]))
        angle = even_angle(self.t[steady], self.turning.angle[steady])
        even, samples = resample_by_angle(signals[steady], angle)
        return even, samples * abs(self.drive_speed) / (2 * math.pi), abs(float(angle[0]))

    def at_sensors(self, machine: Machine, rows: slice = slice(None), *, instantaneous: bool = False) -> FloatArray:
        """Return what the sensors of a machine feel (n, s) [m/s2], in the order of its file.

        Parameters
        ----------
        machine : Machine
            The one that was simulated, with motion.
        rows : slice
            Samples that are wanted.
        instantaneous : bool
            Of the acceleration at t, not the band-limited one, which is all that a frequency response answers to.
        """
        if not machine.sensors:
            return np.empty((len(self.t[rows]), 0))
        if self.suspension is not None:
            motion = (self.displacement, self.velocity, self.band_limited_acceleration, self.sample_rate)
            wrench, early = wrench_on_frame(self.suspension, *motion), int((self.t < self.transient - 1e-9).sum())
            return answers_of(machine, wrench, self.sample_rate, steady=early, speed=self.drive_speed)[rows]
        quantity = "acceleration" if instantaneous else "band_limited_acceleration"
        points = [sensor.at for sensor in machine.sensors]
        bending = None
        if self.modes is not None:
            bending = (shapes_at(machine.modes, points), *self.modes.motion(rows, instantaneous=instantaneous))
        return sensor_signals(
            self.displacement[rows],
            self.velocity[rows],
            getattr(self, quantity)[rows],
            points,
            [sensor.direction for sensor in machine.sensors],
            machine.links[machine.frame].cg,
            bending,
        )

    def as_rigid(self, machine: Machine) -> FloatArray:
        """Return the band-limited acceleration (n, 3) of the rigid frame that a machine's sensors would take it for.

        That of the frame itself, and the least squares of what modes add at the sensors, or of all by a frequency
        response: exact for three sensors and for fewer, and for more as far as least squares are what is compared.
        """
        if self.suspension is not None:
            return np.asarray(self.at_sensors(machine) @ seen_as_rigid(machine).T)
        if self.modes is None or not machine.sensors:
            return self.band_limited_acceleration
        return self.band_limited_acceleration + self.modes.band_limited_acceleration @ taken_for_rigid(machine).T

    def to_pandas(self) -> pd.DataFrame:
        """Return the motion of the frame as a table over time, m and rad, ``acceleration_theta`` ...; needs pandas."""
        import pandas as pd

        columns = {
            f"{quantity}_{motion}": values[:, column]
            for quantity, values in self._motion.items()
            for column, motion in enumerate(MOTIONS)
            if len(values)
        }
        return pd.DataFrame(columns, index=pd.Index(self.t, name="t"))

    def to_xarray(self) -> xr.Dataset:
        """Return the motion of the frame over ``t`` and ``motion``, m and rad; needs xarray."""
        import xarray as xr

        content = {name: (("t", "motion"), values) for name, values in self._motion.items() if len(values)}
        told = {
            "fault": self.case.fault.label,
            "transient_s": self.transient,
            "drive_speed_rad_per_s": self.drive_speed,
        }
        return xr.Dataset(content, {"t": self.t, "motion": list(MOTIONS)}, told)

    @property
    def _motion(self) -> Mapping[str, FloatArray]:
        names = ("displacement", "velocity", "acceleration", "band_limited_acceleration")
        return {name: getattr(self, name) for name in names}

    @cached_property
    def steadiness_db(self) -> FloatArray:
        """Change of the mean square acceleration from the first to the second half after the transient, dB, (3,)."""
        steady = self.band_limited_acceleration[self.t >= self.transient]
        half = len(steady) // 2
        if half == 0:
            return np.full(3, np.inf)
        first, second = (np.mean(part**2, axis=0) for part in (steady[:half], steady[half : 2 * half]))
        return np.asarray(10 * np.log10((second + 1e-30) / (first + 1e-30)))
