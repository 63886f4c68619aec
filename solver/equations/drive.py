"""The drive: a prescribed relative motion, or a known effort, made of harmonics or of tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from jointplay.solver.equations.numbers import Number, Numbers
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import ForceDrive, MotionDrive, Ripple, RotationDrive, TorqueDrive, TravelDrive


class Harmonics:
    """Sines and cosines of multiples of an angle.

    Parameters
    ----------
    angle : casadi.SX
        rad.
    """

    def __init__(self, angle: ca.SX) -> None:
        self._angle = angle
        self._known: dict[int, tuple[ca.SX, ca.SX]] = {}

    def wave(self, order: float, phase: float) -> tuple[ca.SX, ca.SX]:
        """Return sin(order angle + phase) and cos(order angle + phase)."""
        whole = round(order)
        if order != whole or whole < 1:
            turned = order * self._angle + phase
            return ca.sin(turned), ca.cos(turned)
        sine, cosine = self._multiple(whole)
        s, c = _exact(phase)
        return sine * c + cosine * s, cosine * c - sine * s

    def _multiple(self, order: int) -> tuple[ca.SX, ca.SX]:
        if order not in self._known:
            if order == 1:
                self._known[1] = (ca.sin(self._angle), ca.cos(self._angle))
            else:
                (s, c), (t, d) = self._multiple(order // 2), self._multiple(order - order // 2)
                self._known[order] = (s * d + c * t, c * d - s * t)
        return self._known[order]


def _exact(phase: float) -> tuple[float, float]:
    """Sine and cosine of a phase; of quarter turns without rounding, so that one of the products vanishes."""
    quarters = phase / (0.5 * math.pi)
    if quarters == round(quarters):
        return ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))[round(quarters) % 4]
    return math.sin(phase), math.cos(phase)


def interpolate(x: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Linear between the points, ends held.

    Parameters
    ----------
    x : symbol
        Argument.
    points : sequence of (x, y)
        Strictly increasing in x; one point is a constant.
    """
    value = ca.SX(points[0][1])
    for (x0, y0), (x1, y1) in pairwise(points):
        # Each segment adds its own rise, clamped outside of it: no nest of conditions.
        value += (y1 - y0) / (x1 - x0) * (ca.fmin(ca.fmax(x, x0), x1) - x0)
    return value


def linear_integral(x: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Integral of :func:`interpolate` from 0 to `x`, exact, for x >= 0.

    Its second derivative at a point of the table is the slope that follows: comparisons, because that of `fmin` and
    `fmax` where both are equal would be half of either, and runs begin at such a point.
    """

    def primitive(s: Number) -> ca.SX:
        y0 = points[0][1]
        total = y0 * s
        for (xa, ya), (xb, yb) in pairwise(points):
            slope = (yb - ya) / (xb - xa)
            inside = ca.if_else(s < xa, 0.0, ca.if_else(s < xb, s - xa, xb - xa))
            total += slope * (inside * inside / 2 + inside * ca.if_else(s < xb, 0.0, s - xb))
        return ca.SX(total)

    return primitive(x) - primitive(0.0)


def interpolate_periodic(angle: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Linear between the points, repeated with 2 pi, linear across the seam.

    Parameters
    ----------
    angle : symbol
        Drive angle, rad, unbounded.
    points : sequence of (angle, value)
        Angles strictly increasing within one turn (last - first < 2 pi).
    """
    turn = 2 * math.pi
    first = points[0][0]
    closed = [(a - first, v) for a, v in points] + [(turn, points[0][1])]
    wrapped = angle - first
    return interpolate(wrapped - turn * ca.floor(wrapped / turn), closed)


#: Orders that are this far from a whole number count as one.
_WHOLE = 1e-6
#: Samples of a travel in one period of its fastest harmonic, 0.05 % of an amplitude; and of all periods of a long run.
_TRAVEL_SAMPLES = 100
_MOST_TRAVEL_SAMPLES = 1_000_000


@dataclass(frozen=True)
class PrescribedMotion:
    """Motion of a drive as a function of time: of links[0] to links[1] of its joint, or of its link in space.

    Attributes
    ----------
    joint : str
        Empty for a link in space.
    rotation : bool
        True for a rotation (rad), False for a motion along the direction of the joint or the drive (m).
    value, rate, acceleration : casadi.SX
        Functions of the time symbol; zero value at t = 0 (the drawn pose).
    """

    joint: str
    rotation: bool
    value: ca.SX
    rate: ca.SX
    acceleration: ca.SX


def prescribes_motion(machine: Machine) -> bool:
    """Whether the input motion is known and the effort unknown."""
    return isinstance(machine.drive, MotionDrive)


def drive_rates(machine: Machine, values: dict[str, float]) -> tuple[float, float]:
    """What revolutions are counted by, and the fastest motion that the drive prescribes; rad/s.

    Parameters
    ----------
    machine : Machine
    values : dict of str to float
        Lane parameters by path, the drive speed among them where it is one.

    Returns
    -------
    (float, float)
        The speed of a rotation; for a translation 2 pi times its lowest harmonic frequency. The first is 0 where the
        motion does not repeat: a run-up, a constant travel, a known effort, no drive.
    """
    drive = machine.drive
    if isinstance(drive, RotationDrive):
        highest = max((abs(r.order) for r in drive.ripple), default=1.0)
        if isinstance(drive.speed, tuple):
            return 0.0, max(1.0, highest) * max(abs(speed) for _, speed in drive.speed)
        speed = values.get("drive.speed", drive.speed)
        return speed, max(1.0, highest) * abs(speed)
    if isinstance(drive, TravelDrive) and drive.harmonics:
        frequencies = [2 * math.pi * abs(h.frequency) for h in drive.harmonics if h.frequency]
        return (min(frequencies), max(frequencies)) if frequencies else (0.0, 0.0)
    return 0.0, 0.0


def repeating_frequency(machine: Machine, drive_speed: float) -> float:
    """How often the machine comes round, Hz.

    Parameters
    ----------
    machine : Machine
    drive_speed : float
        The first of :func:`drive_rates`, rad/s.

    Raises
    ------
    SettingsError
        It does not, or not in a way that repeats: there is no steady state and no harmonics.
    """
    drive = machine.drive
    if not drive_speed:
        kind = "none" if drive is None else drive.kind
        raise SettingsError(f"{machine.name}: drive: {kind}: must turn at a constant speed for spectra in orders")
    frequency = abs(drive_speed) / (2 * math.pi)
    if isinstance(drive, TravelDrive):
        odd = [h.frequency for h in drive.harmonics if abs(h.frequency / frequency % 1.0 - 0.5) < 0.5 - _WHOLE]
        if odd or drive.speed:
            rule = "must repeat with the lowest of its frequencies for spectra in orders"
            raise SettingsError(f"{machine.name}: drive: {rule}")
    if isinstance(drive, RotationDrive):
        for i, ripple in enumerate(drive.ripple):
            if ripple.amplitude and abs(ripple.order - round(ripple.order)) > _WHOLE:
                rule = "must be a whole number for spectra in orders: the drive does not repeat with its revolution"
                raise SettingsError(f"{machine.name}: drive.ripple.{i}.order: {ripple.order:g}: {rule}")
    for i, load in enumerate(machine.loads):
        if load.over_time is not None:
            raise SettingsError(f"{machine.name}: loads.{i}.over_time: must not change in time for spectra in orders")
    for i, support in enumerate(machine.supports):
        for k, part in enumerate(support.motion):
            often = part.order if part.frequency is None else part.frequency / frequency
            if often is None or abs(often - round(often)) > _WHOLE or not round(often):
                rule = "must repeat with the drive's revolution for spectra in orders"
                raise SettingsError(f"{machine.name}: supports.{i}.motion.{k}: {rule}")
    return frequency


def prescribed_motion(machine: Machine, number: Callable[[str, float], Number], t: ca.SX) -> PrescribedMotion | None:
    """Motion of a drive that prescribes one, ``None`` when the drive is an effort or absent.

    Contract: f = w t + sum a [sin(k w t + p) - sin p], and for translation + sum A [sin(2 pi f t + p) - sin p].
    """
    drive = machine.drive
    if not isinstance(drive, MotionDrive):
        return None
    if isinstance(drive.speed, tuple):
        base = linear_integral(t, drive.speed)
    else:
        base = number("drive.speed", drive.speed) * t
    value = ca.SX(base)
    if isinstance(drive, RotationDrive):
        return PrescribedMotion(drive.joint, True, *_add_ripple(value, drive.ripple, number, t))
    for i, harmonic in enumerate(drive.harmonics):
        amplitude = number(f"drive.harmonics.{i}.amplitude", harmonic.amplitude)
        phase = 2 * ca.pi * harmonic.frequency * t + harmonic.phase
        value += amplitude * (ca.sin(phase) - ca.sin(harmonic.phase))
    rate = ca.jacobian(value, t)
    return PrescribedMotion(machine.driven_joint, False, value, rate, ca.jacobian(rate, t))


def _add_ripple(
    base: ca.SX, ripples: Sequence[Ripple], number: Callable[[str, float], Number], t: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Angle, rate and acceleration of a drive with ripple; sums of the same sines and cosines."""
    rate = ca.jacobian(base, t)
    acceleration = ca.jacobian(rate, t)
    waves = Harmonics(base)
    shift, slope, bend = ca.SX(0), ca.SX(0), ca.SX(0)
    for i, ripple in enumerate(ripples):
        amplitude = number(f"drive.ripple.{i}.amplitude", ripple.amplitude)
        sine, cosine = waves.wave(ripple.order, ripple.phase)
        shift += amplitude * (sine - math.sin(ripple.phase))
        slope += amplitude * ripple.order * cosine
        bend -= amplitude * ripple.order**2 * sine
    return base + shift, rate * (1 + slope), acceleration * (1 + slope) + rate * rate * bend


def travel_range(machine: Machine, values: Mapping[str, float], duration: float) -> tuple[float, float]:
    """Least and largest travel of a drive from the drawing, m.

    Parameters
    ----------
    machine : Machine
        With a drive that prescribes a travel.
    values : mapping of str to float
        Numbers of the drive by path that differ from the file.
    duration : float
        s.
    """
    drive, t = machine.drive, ca.SX.sym("t")
    assert isinstance(drive, TravelDrive)
    motion = prescribed_motion(machine, lambda path, value: values.get(path, value), t)
    assert motion is not None
    fastest = max((h.frequency for h in drive.harmonics), default=0.0)
    count = int(min(_TRAVEL_SAMPLES * (1 + fastest * duration), _MOST_TRAVEL_SAMPLES))
    travel = ca.Function("travel", [t], [motion.value])(np.linspace(0.0, duration, count + 1)[None, :]).full()
    return float(travel.min()), float(travel.max())


def known_effort(machine: Machine, number: Numbers, rate: Number) -> ca.SX | None:
    """Torque (N m) or force (N) of the drive on links[0] at the relative `rate`; ``None`` for a prescribed motion."""
    drive = machine.drive
    if not isinstance(drive, TorqueDrive | ForceDrive):
        return None
    if drive.curve:
        effort: Number = interpolate(rate / number("drive.speed_factor", drive.speed_factor), drive.curve)
    elif isinstance(drive, TorqueDrive):
        effort = number("drive.torque", drive.torque or 0.0)
    else:
        effort = number("drive.force", drive.force or 0.0)
    return ca.SX(number("drive.effort_factor", drive.effort_factor) * effort)
