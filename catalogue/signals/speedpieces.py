"""A recording in which the drive speed changes, cut into pieces that are each about one speed of a catalogue.

A run-up passes the speeds that a catalogue has, a speed set by steps stays at some. Each piece is a recording of its
own, with the ends of its revolutions, by which it is sampled anew as one with a tacho is.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import (
    SEARCH_RANGE,
    SpeedEstimate,
    SpeedTrack,
    track_speed,
)
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.measurements.speedcourse import WINDOW_REVOLUTIONS, SpeedCourse, find_course
from jointplay.catalogue.measurements.tacho import misses_pulses
from jointplay.catalogue.signals.sensors import map_sensors
from jointplay.catalogue.signals.steadiness import at_mean_speed, places_at_mean_speed
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray
from jointplay.solver.cases.preparation import modes_of_suspension
from jointplay.solver.machines.machine import Machine

#: How far from a stored speed a piece goes, relative: as far as the draws of a catalogue do.
COVERED = 0.03
#: Revolutions of a piece at least.
LEAST_REVOLUTIONS = 6
#: Pieces about one stored speed at most, the longest: a third tells hardly anything more.
MOST_ABOUT_A_SPEED = 2
#: What an order may be swept by within the decay time (to 1/e) of a mode of the suspension, in half-power widths of it.
#: Levels are then off by 0.4 dB in a run-up and 0.9 dB in a coast-down (rms, ``benchmarks/sweeps.py``).
QUASI_STEADY = 0.1
#: Decay times after which a faster change is over.
DECAYS = 3.0
#: Damping ratio below which a mode never decays: it is in the catalogue's spectra as well.
UNDAMPED = 1e-4
#: The course is looked at so many times a revolution.
LOOKS = 8
#: A machine stands where its frame shakes less than so much of what it does elsewhere: noise and hum of recordings are
#: up to 0.18 of all that they hold (those of the tests), and noise that hides orders makes 1.3 times of it.
STANDING = 0.5
#: Revolutions over which its change is taken at least, and the relative change that is more than its speeds' errors.
LAG_REVOLUTIONS, COURSE_ERROR = 2, 0.03
#: Degree of the polynomial that a piece's course is smoothed by, and how far beyond its ends, in its lengths.
COURSE_DEGREE, BESIDE = 3, 0.25


@dataclass(frozen=True)
class Cut:
    """Pieces of a recording.

    Parameters
    ----------
    pieces : tuple of Recording or MeasuredSpectrum
        In the order of time; what was measured itself where its speed is one.
    left_out : tuple of str
        What is not compared and why, one line each.
    """

    pieces: tuple[Recording | MeasuredSpectrum, ...]
    left_out: tuple[str, ...] = ()


def cut_by_speed(
    recording: Recording | MeasuredSpectrum,
    machine: Machine,
    speeds: Sequence[float],
    mapping: Mapping[str, str] | None = None,
) -> Cut:
    """Cut a recording into pieces that are each about one speed.

    Parameters
    ----------
    recording : Recording or MeasuredSpectrum
        A spectrum is not cut.
    machine : Machine
        Gives sensors and suspension.
    speeds : sequence of float
        Drive speeds [rad/s] that a catalogue has.
    mapping : mapping of column to sensor, optional

    Returns
    -------
    Cut
        The recording as it is where it stays about one of the speeds, or about none: its steady part is found later.

    Raises
    ------
    MeasurementError
        No column matches a sensor.

    Notes
    -----
    A piece lies within 3 % of a stored speed, or, where the machine stays at another speed for most of the time that it
    is within 10 % of a stored one, within 3 % of that. What is swept faster than the suspension follows is left out,
    and so are three of its decay times after that.
    """
    if isinstance(recording, MeasuredSpectrum):
        return Cut((recording,))
    stored = np.sort(np.abs(speeds))
    columns = list(map_sensors(recording, machine, mapping).columns)
    if recording.turns is not None and misses_pulses(recording.turns):
        return Cut((recording,))  # refused, with where it is, when its speed is asked for
    course = _course(recording, columns, stored)
    if np.count_nonzero(np.isfinite(course.speed)) < 2:
        return Cut((recording,))
    time, speed = _looked_at(course, recording.duration, float(stored[-1]))
    seen = speed[np.isfinite(speed)]
    if np.abs(seen / np.median(seen) - 1.0).max() <= COVERED and not _stands(recording, columns, time, speed):
        return Cut((recording,))  # one piece, the whole: most recordings
    nearest = np.abs(np.log(stored[:, None] / speed)).argmin(axis=0)
    nearest[~(np.abs(speed / stored[nearest] - 1.0) <= SEARCH_RANGE)] = -1
    followed: BoolArray | None = None
    found: list[tuple[float, bool, Recording]] = []
    left_out = []
    for first, last in _runs(nearest):
        about, own = float(stored[nearest[first]]), speed[first:last]
        stays = np.abs(own / np.median(own) - 1.0) <= COVERED
        dwells = bool(np.count_nonzero(stays) > 0.5 * len(own))
        inside = np.full(len(time), -1)
        inside[first:last] = np.where(stays if dwells else np.abs(own / about - 1.0) <= COVERED, 1, -1)
        for begin, end in _runs(inside):
            followed = _followed(time, speed, machine) if followed is None else followed
            sound = [(begin + i, begin + j - 1) for i, j in _runs(np.where(followed[begin:end], 1, -1))]
            try:
                if not sound:
                    raise MeasurementError(recording.name, rule="its speed changes faster than the suspension follows")
                i, j = max(sound, key=lambda ends: ends[1] - ends[0])
                centre = float(np.median(own)) if dwells else about
                piece = _piece(recording, columns, course, centre, float(time[i]), float(time[j]))
                found.append((about, dwells, piece))
            except MeasurementError as error:
                when = f"{time[begin]:.3g} to {time[end - 1]:.3g} s"
                left_out.append(f"{when}, about {_rpm(about)} rpm: left out: {error.rule}")
    longest = sorted(found, key=lambda each: -each[2].duration)
    chosen = [
        each for each in found
        if each in [other for other in longest if other[0] == each[0]][:MOST_ABOUT_A_SPEED]
    ]  # fmt: skip
    if len(chosen) < 2 and all(dwells for _, dwells, _ in chosen):
        return Cut((recording,), () if chosen else tuple(left_out))
    pieces = [piece for *_, piece in chosen]
    left_out += [
        f"{piece.name}: left out: others about this speed are longer" for *_, piece in found if piece not in pieces
    ]
    used = math.fsum(piece.duration for piece in pieces)
    said = f"its speed changes: {used:.3g} s of {recording.duration:.3g} s are about speeds of the catalogue"
    pieces[0] = replace(pieces[0], warnings=(*recording.warnings, said))
    return Cut(tuple(pieces), tuple(left_out))


def fastest_change(machine: Machine) -> tuple[float, float]:
    """Relative change of the drive speed [1/s] that the suspension of a machine follows, and its longest decay [s].

    Notes
    -----
    A mode of decay rate d and frequency w [rad/s] has the half-power width d / pi [Hz] and the decay time 1 / d. An
    order that passes it is swept by w / (2 pi) times the relative change of the speed.
    """
    modes = [mode for mode in modes_of_suspension(machine) if -mode.real > UNDAMPED * abs(mode)]
    change = min((2.0 * QUASI_STEADY * mode.real**2 / abs(mode) for mode in modes), default=math.inf)
    return change, max((-1.0 / mode.real for mode in modes), default=0.0)


def _course(recording: Recording, columns: list[int], stored: FloatArray) -> SpeedCourse:
    """By pulses where there are any, else by orders."""
    turns = recording.turns
    if turns is not None:
        ends = turns / recording.sample_rate
        return SpeedCourse(0.5 * (ends[1:] + ends[:-1]), 2.0 * math.pi / np.diff(ends))
    beyond = 1.0 + SEARCH_RANGE + COVERED
    return find_course(recording.signal[:, columns], recording.sample_rate, stored[0] / beyond, stored[-1] * beyond)


def _looked_at(course: SpeedCourse, duration: float, fastest: float) -> tuple[FloatArray, FloatArray]:
    """Times (g,) all over a recording, and speeds there; not a number where none is to be seen."""
    known = np.isfinite(course.speed)
    at, speed = course.time[known], course.speed[known]
    # Windows end half of their length before the recording does.
    ends = [speed[0] - (speed[1] - speed[0]) / (at[1] - at[0]) * at[0],
            speed[-1] + (speed[-1] - speed[-2]) / (at[-1] - at[-2]) * (duration - at[-1])]  # fmt: skip
    time = np.arange(0.0, duration, 2.0 * math.pi / (LOOKS * fastest))
    found = np.interp(time, [0.0, *at, duration], [max(ends[0], 1e-9), *speed, max(ends[1], 1e-9)])
    place = np.clip(np.searchsorted(course.time, time), 1, len(course.time) - 1)
    nearer = np.where(time - course.time[place - 1] < course.time[place] - time, place - 1, place)
    return time, np.where(known[nearer], found, np.nan)


def _stands(recording: Recording, columns: list[int], time: FloatArray, speed: FloatArray) -> bool:
    """Whether it is quiet where no speed is to be seen, as of a machine that stands, rather than disturbed."""
    unseen = np.isnan(speed)
    if not unseen.any():
        return False
    place = np.searchsorted(time, np.arange(len(recording.signal)) / recording.sample_rate, side="right") - 1
    there = unseen[place]
    signal = recording.signal[:, columns]
    return bool(signal[there].std(axis=0).sum() < STANDING * signal[~there].std(axis=0).sum())


def _followed(time: FloatArray, speed: FloatArray, machine: Machine) -> BoolArray:
    """Where (g,) the suspension follows the speed, and has forgotten what it did not follow."""
    most, decay = fastest_change(machine)
    step = float(time[1] - time[0])
    lag = max(round(LAG_REVOLUTIONS * LOOKS), math.ceil(COURSE_ERROR / most / step))
    level = np.log(speed)
    ends = [np.clip(np.arange(len(time)) + by, 0, len(time) - 1) for by in (-(lag // 2), lag - lag // 2)]
    fast = ~(np.abs(level[ends[1]] - level[ends[0]]) <= most * step * np.maximum(ends[1] - ends[0], 1))
    reach = round(0.5 * WINDOW_REVOLUTIONS * LOOKS)
    after = reach + math.ceil(DECAYS * decay / step)
    found = np.ones(len(time), dtype=bool)
    for first, last in _runs(np.where(fast, 1, -1)):
        found[max(0, first - reach) : last + after] = False
    return found


def _piece(
    recording: Recording, columns: list[int], course: SpeedCourse, about: float, begin: float, end: float
) -> Recording:
    """What is recorded between two times [s], with the ends of its revolutions.

    Raises
    ------
    MeasurementError
        Too few revolutions, no orders stand out, or those that do are of another speed.
    """
    rate = recording.sample_rate
    _refuse_few((end - begin) * about / (2.0 * math.pi), recording.name)
    first, last = round(begin * rate), min(len(recording.signal), round(end * rate) + 1)
    signal = recording.signal[first:last]
    if recording.turns is None:
        turns = _turns(signal[:, columns], rate, course, begin, end, recording.name)
    else:
        turns = recording.turns[(recording.turns >= first) & (recording.turns < last)] - first
    count = len(turns) - 1
    _refuse_few(count, recording.name)
    mean = 2.0 * math.pi * rate * count / float(turns[-1] - turns[0])
    if abs(mean / about - 1.0) > COVERED:
        rule = f"seen as a whole it turns at {_rpm(mean)} rpm"
        raise MeasurementError(recording.name, rule=rule)
    flaws = [replace(flaw, first=flaw.first - first, last=flaw.last - first) for flaw in recording.flaws]
    return replace(
        recording,
        name=f"{recording.name}, {_rpm(mean)} rpm, {first / rate:.3g} to {last / rate:.3g} s",
        signal=signal,
        warnings=(),
        sha256=hashlib.sha256(f"{recording.sha256} {first} {last}".encode()).hexdigest(),
        flaws=tuple(flaw for flaw in flaws if flaw.kind != "dropout" or (flaw.last > 0 and flaw.first < last - first)),
        turns=turns,
    )


def _refuse_few(revolutions: float, source: str) -> None:
    if revolutions < LEAST_REVOLUTIONS:
        rule = (
            f"{max(revolutions, 0.0):.2g} revolutions; at least {LEAST_REVOLUTIONS} are needed of a speed that changes"
        )
        raise MeasurementError(source, rule=rule)


def _turns(signal: FloatArray, rate: float, course: SpeedCourse, begin: float, end: float, source: str) -> FloatArray:
    """Ends of revolutions (k,) in samples by phases of the orders, once a course is taken out that is nearly right."""
    near = np.isfinite(course.speed) & (course.time >= begin - BESIDE * (end - begin)) & (
        course.time <= end + BESIDE * (end - begin)
    )  # fmt: skip
    time, speed = course.time[near] - begin, course.speed[near]
    if len(time) < 2:
        raise MeasurementError(source, rule="no orders of a drive speed stand out")
    smooth = np.polynomial.Polynomial.fit(time, speed, min(COURSE_DEGREE, len(time) - 1))
    at = np.linspace(0.0, end - begin, max(2, 2 * len(time)))
    rough = SpeedTrack(at, smooth(at), SpeedEstimate(float(smooth(at).mean()), 0.0, False))
    place = places_at_mean_speed(len(signal), rate, rough)
    mean = float(np.trapezoid(smooth(at), at) / at[-1])
    track = track_speed(at_mean_speed(signal, rate, rough), rate, mean, source)
    fine = np.interp(np.arange(len(signal)) / rate, track.time, track.speed)
    revolutions = np.concatenate([[0.0], np.cumsum(0.5 * (fine[1:] + fine[:-1]))]) / (2.0 * math.pi * rate)
    return np.interp(np.arange(math.floor(revolutions[-1]) + 1.0), revolutions, place)


def _runs(labels: IntArray) -> list[tuple[int, int]]:
    """First and last + 1 of stretches of one label that is not negative."""
    edges = np.flatnonzero(np.diff(labels)) + 1
    bounds = zip([0, *edges.tolist()], [*edges.tolist(), len(labels)], strict=True)
    return [(first, last) for first, last in bounds if labels[first] >= 0]


def _rpm(speed: float) -> str:
    return f"{speed * 30.0 / math.pi:.4g}"
