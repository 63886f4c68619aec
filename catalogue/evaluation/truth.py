"""What a held-out recording is of: a machine with worn joints, drawn from a seed, and what else its sensors hear."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.signals.suspension import accelerance, on_mounts
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.modes import swing
from jointplay.solver.spectra.sensor import sensor_transform


@dataclass(frozen=True)
class Response:
    """Transfer function from the rigid frame to each sensor, 1 + g times how a mode swings.

    A gain g of 1 is a sensor on a spring: H = (1 + 2 i z r) / (1 - r^2 + 2 i z r), r = f / frequency.

    Parameters
    ----------
    frequency : float
        Of the mode, Hz.
    damping : float
        Damping ratio z.
    gains : tuple of float, (s,)
        g of each sensor; none for a rigid structure.
    """

    frequency: float = 1.0
    damping: float = 0.0
    gains: tuple[float, ...] = ()

    def of(self, signal: FloatArray, sample_rate: float) -> FloatArray:
        """Return sensor signals (n, s) of a rigid frame as this structure passes them on."""
        if not any(self.gains):
            return signal
        count = len(signal)
        ratio = np.fft.rfftfreq(count, 1.0 / sample_rate)[:, None] / self.frequency
        function = 1.0 + np.array(self.gains) * swing(ratio, self.damping)
        passed: FloatArray = np.fft.irfft(np.fft.rfft(signal, axis=0) * function, n=count, axis=0)
        return passed


Wrench = tuple[float, float, float]
"""Force in x and y and moment about the frame's centre of gravity, in any unit: sizes are said otherwise."""

RINGS_FOR = 2.0
"""Time after the end of a recording in which what rings on dies away [s], so that it does not come round to the
beginning."""


class ForeignForce(Protocol):
    """What shakes the frame besides its machine."""

    def of(self, machine: Machine, sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what ideal sensors report of it (n, s), m/s2, beside a signal (n, s) of the machine."""


class RecorderFlaw(Protocol):
    """What is wrong with sensors or the recorder."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensors that are to be named; none where the recorder is at fault."""

    def of(self, names: tuple[str, ...], sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what is recorded of a signal (n, s) of sensors of these names."""


@dataclass(frozen=True)
class Tones:
    """Steady tones of one force: harmonics of another machine, or a mesh of teeth.

    Parameters
    ----------
    frequencies : tuple of float, (k,)
        Hz.
    sizes, phases : tuple of float, (k,)
        Of the force; phases in rad.
    wrench : (float, float, float)
    rms : float
        Of all sensors together, as a multiple of the recording's own.
    """

    frequencies: tuple[float, ...]
    sizes: tuple[float, ...]
    phases: tuple[float, ...]
    wrench: Wrench
    rms: float

    def of(self, machine: Machine, sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what ideal sensors report of it (n, s), m/s2, beside a signal (n, s) of the machine."""
        amplitudes = np.array(self.sizes) * np.exp(1j * np.array(self.phases))
        moved = amplitudes[:, None] * (_accelerance(machine, np.array(self.frequencies)) @ np.array(self.wrench))
        t = np.arange(len(signal)) / sample_rate
        motion = (np.exp(2j * math.pi * np.outer(t, self.frequencies)) @ moved).real
        return _as_loud(motion @ transform_of(machine).T, self.rms * _rms(signal), _rms)


@dataclass(frozen=True)
class Blows:
    """Single blows against the frame.

    Parameters
    ----------
    times : tuple of float, (k,)
        As shares of the recording.
    sizes : tuple of float, (k,)
        Of the force, the largest 1.
    width : float
        Of one blow, half a sine [s].
    wrench : (float, float, float)
    peak : float
        Of all sensors together, as a multiple of the recording's rms.
    """

    times: tuple[float, ...]
    sizes: tuple[float, ...]
    width: float
    wrench: Wrench
    peak: float

    def of(self, machine: Machine, sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what ideal sensors report of it (n, s), m/s2, beside a signal (n, s) of the machine."""
        t = np.arange(len(signal)) / sample_rate
        force = np.zeros(len(signal))
        for at, size in zip(self.times, self.sizes, strict=True):
            after = t - at * t[-1]
            within = (after >= 0.0) & (after < self.width)
            force += np.where(within, size * np.sin(math.pi * after / self.width), 0.0)
        sensed = _move(machine, sample_rate, np.outer(force, self.wrench)) @ transform_of(machine).T
        return _as_loud(sensed, self.peak * _rms(signal), lambda each: float(np.abs(each).max()))


@dataclass(frozen=True)
class Bursts:
    """Short ringing that comes again and again, as of a rolling bearing with a pit.

    Parameters
    ----------
    every : float
        From one burst to the next [s].
    first : float
        Of the first one [s].
    frequency, damping : float
        Of the ringing, Hz; damping ratio.
    wrench : (float, float, float)
    rms : float
        Of all sensors together, as a multiple of the recording's own.
    """

    every: float
    first: float
    frequency: float
    damping: float
    wrench: Wrench
    rms: float

    def of(self, machine: Machine, sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what ideal sensors report of it (n, s), m/s2, beside a signal (n, s) of the machine."""
        t = np.arange(len(signal)) / sample_rate
        force = np.zeros(len(signal))
        circular = 2.0 * math.pi * self.frequency
        lasting = int(20.0 / (self.damping * circular) * sample_rate)  # nothing is left of one by then
        for start in np.arange(self.first, t[-1], self.every):
            first = math.ceil(start * sample_rate)
            after = t[first : first + lasting] - start
            force[first : first + lasting] += np.exp(-self.damping * circular * after) * np.sin(circular * after)
        sensed = _move(machine, sample_rate, np.outer(force, self.wrench)) @ transform_of(machine).T
        return _as_loud(sensed, self.rms * _rms(signal), _rms)


def transform_of(machine: Machine) -> FloatArray:
    """What a machine's sensors report (s, 3) of x, y and theta of its frame."""
    return sensor_transform(
        [sensor.at for sensor in machine.sensors],
        [sensor.direction for sensor in machine.sensors],
        machine.links[machine.frame].cg,
    )


def _move(machine: Machine, sample_rate: float, wrench: FloatArray) -> FloatArray:
    """Acceleration (n, 3) of the frame under a wrench (n, 3), at rest before."""
    count = len(wrench)
    padded = count + round(RINGS_FOR * sample_rate)
    spectrum = np.fft.rfft(wrench, padded, axis=0)
    frequency = np.asarray(np.fft.rfftfreq(padded, 1.0 / sample_rate), dtype=np.float64)
    moved = np.zeros_like(spectrum)
    moved[1:] = (_accelerance(machine, frequency[1:]) @ spectrum[1:, :, None])[..., 0]
    return np.asarray(np.fft.irfft(moved, padded, axis=0)[:count], dtype=np.float64)


def _accelerance(machine: Machine, frequency: FloatArray) -> ComplexArray:
    """Acceleration of the frame for a unit wrench, (f, 3, 3), as if it floated where it stands on more than mounts."""
    known = machine if on_mounts(machine) else machine.model_copy(update={"supports": ()})
    return accelerance(known, {}, frequency)


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean((signal - signal.mean(axis=0)) ** 2)))


def _as_loud(signal: FloatArray, size: float, measured: Callable[[FloatArray], float]) -> FloatArray:
    """A signal with a size, unless no sensor sees anything of it."""
    own = measured(signal)
    return signal * (size / own) if own else signal


RESTITUTION = (0.5, 0.85)
"""Drawn restitutions, uniform."""


@dataclass(frozen=True)
class Truth:
    """What one held-out recording is of.

    Parameters
    ----------
    hypothesis : Hypothesis
        The true one.
    machine : Machine
        As it really is, which may differ from the catalogue's.
    clearances : mapping of str to float
        Radial clearance by joint, m.
    parameters : mapping of str to float
        Numbers that differ from `machine`, by path, SI.
    seconds : float
        Length of the recording.
    response : Response
        Of the structure between frame and sensors.
    gains : tuple of float
        Of the sensors, 1 for a true one.
    seed : int
        Of the noise.
    causes : tuple of str
        What differs beside play, in the words of answers; empty where no answer has a name for it.
    disturbance : Disturbance, optional
        What shakes the frame besides.
    flaw : RecorderFlaw, optional
        What is wrong with sensors or the recorder.
    """

    hypothesis: Hypothesis
    machine: Machine
    clearances: Mapping[str, float]
    parameters: Mapping[str, float]
    seconds: float
    response: Response = field(default_factory=Response)
    gains: tuple[float, ...] = ()
    seed: int = 0
    causes: tuple[str, ...] = ()
    disturbance: ForeignForce | None = None
    flaw: RecorderFlaw | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with clearance: all that can wear."""
        return tuple(self.clearances)


def draw_contacts(
    machine: Machine, joints: Sequence[str], scatter: float, draws: np.random.Generator
) -> dict[str, float]:
    """Draw the numbers of the contact law in every joint, by path: log-normal factors, uniform restitutions; oil."""
    found: dict[str, float] = {}
    for joint in joints:
        contact = machine.joints[joint].contact
        for name in ("stiffness", "damping", "hysteresis", "restitution"):
            own = getattr(contact, name)
            deviate, uniform = float(draws.normal()), float(draws.uniform(*RESTITUTION))
            if own and contact.has(name):
                path = f"joints.{joint}.contact.{name}"
                found[path] = uniform if name == "restitution" else own * math.exp(scatter * deviate)
    for joint in joints:
        film = getattr(machine.joints[joint], "film", None)
        if film:
            found[f"joints.{joint}.film.viscosity"] = film.viscosity * 2 ** float(draws.uniform(-1, 1))
    return found
