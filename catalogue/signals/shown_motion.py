"""What is shown of a recording that is looked at, and the motion that it is about."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.sensors import MOTIONS, map_sensors
from jointplay.catalogue.signals.shown_units import UNITS, continued_samples, differentiate, high_pass_for
from jointplay.catalogue.signals.signal_question import LineKind, SignalQuestion
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.spectrum import DERIVATIVES, Quantity


@dataclass(frozen=True, eq=False)
class ShownLine:
    """A line over the axis.

    Parameters
    ----------
    name : str
        Of the channel, or of the motion.
    kind : {"value", "low", "high", "mean", "rms", "first", "second", "in_order"}
        Of the samples of each place: the sample itself, the lowest and highest, mean and rms by angle. Or whose it is:
        of the first or second hypothesis, or of machines in order.
    unit : str
    values : (k,) array
    """

    name: str
    kind: LineKind
    unit: str
    values: FloatArray


@dataclass(frozen=True)
class OverallLevel:
    """How much a channel shakes in all.

    Parameters
    ----------
    name, unit : str
    rms, peak : float
        Of the whole recording, without its mean.
    velocity_rms : float or None
        mm/s (mrad/s of a rotation), within the band; None where the sample rate has none of it.
    """

    name: str
    unit: str
    rms: float
    peak: float
    velocity_rms: float | None


@dataclass(frozen=True, eq=False)
class ShownSignal:
    """What is seen.

    Parameters
    ----------
    axis, axis_unit : str
        What the places are: "time" in s, "frequency" in Hz, "order", "revolution", "angle" in deg.
    ends : (float, float)
        Of the whole axis.
    at : (k,) array
    lines : tuple of ShownLine
    rows : (r,) array
        Of a spectrogram: frequencies [Hz] or orders.
    levels : (r, k) array
        Of a spectrogram, dB re 1 of its unit, rms in the row's band.
    overall : tuple of OverallLevel
    high_pass : float or None
        Hz; what is slower was left out where it was integrated. None where nothing was.
    band : (float, float) or None
        Of the overall velocity [Hz].
    resolution : float or None
        Distance of a spectrum's lines, in the unit of the axis.
    notes : tuple of str
    """

    axis: str
    axis_unit: str
    ends: tuple[float, float]
    at: FloatArray
    lines: tuple[ShownLine, ...] = ()
    rows: FloatArray | None = None
    levels: FloatArray | None = None
    overall: tuple[OverallLevel, ...] = ()
    high_pass: float | None = None
    band: tuple[float, float] | None = None
    resolution: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Motion:
    """Channels, or motions made of them, in some unit.

    Parameters
    ----------
    recording : Recording
    names, units : tuples of str, (m,)
    columns : tuple of int, (c,)
    weights : (m, c) array
    factors : (m,) array
        Of SI.
    derivatives : tuple of int, (c,)
        How often each column is to be differentiated.
    high_pass : float
    """

    recording: Recording
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: tuple[int, ...]
    weights: FloatArray
    factors: FloatArray
    derivatives: tuple[int, ...]
    high_pass: float
    period: float | None

    @property
    def integrates(self) -> bool:
        """Whether any channel is integrated."""
        return min(self.derivatives) < 0

    def as_measured(self) -> tuple[Motion, Quantity]:
        """The same motion in SI as what its sensors measure, where that is one quantity, else as acceleration."""
        channels = self.recording.channels
        measured = {channels[column].quantity for column in self.columns}
        quantity: Quantity = measured.pop() if len(measured) == 1 else "acceleration"
        derivatives = tuple(DERIVATIVES[quantity] - DERIVATIVES[channels[column].quantity] for column in self.columns)
        return replace(self, factors=np.ones(len(self.names)), derivatives=derivatives), quantity

    def only(self, name: str) -> Motion:
        """One of the channels.

        Raises
        ------
        MeasurementError
            There is none of this name.
        """
        if name not in self.names:
            rule = f"channel {name[:80]}: must be one of {', '.join(self.names)}"
            raise MeasurementError(self.recording.name, rule=rule, field="channel")
        place = self.names.index(name)
        used = np.flatnonzero(self.weights[place])
        return replace(
            self,
            names=(name,),
            units=(self.units[place],),
            columns=tuple(self.columns[each] for each in used),
            weights=self.weights[[place]][:, used],
            factors=self.factors[[place]],
            derivatives=tuple(self.derivatives[each] for each in used),
        )

    def part(self, first: int, last: int) -> FloatArray:
        """Samples of a stretch, (last - first, m)."""
        around = continued_samples(self.recording.sample_rate, self.high_pass) if any(self.derivatives) else 0
        begin, end = max(0, first - around), min(len(self.recording.signal), last + around)
        rate = self.recording.sample_rate
        columns = [
            differentiate(
                np.asarray(self.recording.signal[begin:end, column], np.float64),
                rate,
                times,
                self.high_pass,
                self.period,
            )
            for column, times in zip(self.columns, self.derivatives, strict=True)
        ]
        # Channel by channel in memory, as they are worked on.
        table = np.stack([column[first - begin : last - begin] for column in columns]).T
        if not np.array_equal(self.weights, np.eye(len(columns))):
            table = np.stack([table @ weights for weights in self.weights]).T
        return table if (self.factors == 1.0).all() else table * self.factors


def motion_of(
    recording: Recording, question: SignalQuestion, machine: Machine | None, mapping: Mapping[str, str] | None
) -> Motion:
    """Return what a question is about.

    Raises
    ------
    MeasurementError
        The machine is needed, or its sensors do not see the motions of the frame.
    """
    unit = UNITS[question.unit]
    high_pass = high_pass_for(question.speed)
    wanted = DERIVATIVES[unit.quantity]
    if question.of == "sensors":
        columns = tuple(range(len(recording.channels)))
        names = recording.channel_names
        weights = np.eye(len(columns))
        rotations = [False] * len(names)
    else:
        if machine is None:
            rule = "the motion of the frame needs the machine and which column is which sensor: name a diagnosis"
            raise MeasurementError(recording.name, rule=rule, field="diagnosis")
        sensing = map_sensors(recording, machine, mapping)
        if not sensing.rigid_body:
            rule = f"{', '.join(sensing.sensors)} do not see all motions of the frame: look at the sensors"
            raise MeasurementError(recording.name, rule=rule, field="of")
        columns, names, weights = sensing.columns, sensing.compared, sensing.channels
        rotations = [name == MOTIONS[2] for name in names]
    return Motion(
        recording,
        names,
        tuple(unit.rotation if turns else question.unit for turns in rotations),
        columns,
        weights,
        np.array([unit.rotation_factor if turns else unit.factor for turns in rotations]),
        tuple(wanted - DERIVATIVES[recording.channels[column].quantity] for column in columns),
        high_pass,
        None if question.speed is None else 2.0 * math.pi * recording.sample_rate / abs(question.speed),
    )
