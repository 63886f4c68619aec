"""A recording as analysts look at it: over time, by frequency, over revolutions, by the angle of the drive.

Every answer is bounded by the number of points that is asked for, whatever the length of the recording.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import scipy.fft

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import track_speed
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.shown_motion import (
    Motion,
    OverallLevel,
    ShownLine,
    ShownSignal,
    motion_of,
)
from jointplay.catalogue.signals.shown_units import UNITS, continued_samples, pass_factor
from jointplay.catalogue.signals.signal_question import SignalQuestion
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.spectrum import DERIVATIVES, Quantity, scale_power, value_units
from jointplay.solver.spectra.welch import HANN_NOISE_LINES, welch

#: Revolutions in a window of a spectrum at most, and of a spectrogram; seconds where no speed is known.
WINDOW_REVOLUTIONS, WINDOW_S = 32.0, 2.0
FEWEST_WINDOWS = 4
SHORT_REVOLUTIONS, SHORT_S = 4.0, 0.1
#: Columns and rows of a spectrogram at most, its highest order, and what is not drawn below its loudest [dB].
COLUMNS, ROWS, HIGHEST_ORDER, FLOOR_DB = 240, 120, 60.0, 80.0
#: Parts of a revolution.
ANGLES, FEWEST_ANGLES = 360, 12
#: Samples that a revolution needs to be one.
FEWEST_SAMPLES = 4.0
#: Revolutions that one profile is made of where many are laid over each other, and parts it is shifted by at most.
STEP_REVOLUTIONS, MOST_SHIFTED = 10.0, 18
#: Band of the overall velocity, Hz, and the share of the sample rate to which a recording is trusted.
OVERALL_HZ, PASS = (10.0, 1000.0), 0.4


def show_signal(
    recording: Recording,
    question: SignalQuestion,
    machine: Machine | None = None,
    mapping: Mapping[str, str] | None = None,
) -> ShownSignal:
    """Show a recording.

    Parameters
    ----------
    recording : Recording
    question : SignalQuestion
    machine : Machine, optional
        Needed for the motion of its frame.
    mapping : mapping of column to sensor, optional

    Returns
    -------
    ShownSignal

    Raises
    ------
    MeasurementError
        A speed or a machine is needed; the sensors do not see the frame's motion; there is no such channel.
    """
    motion = motion_of(recording, question, machine, mapping)
    if question.channel:
        motion = motion.only(question.channel)
    if question.speed is None and (question.view == "revolution" or question.axis == "order"):
        rule = "orders and revolutions need the drive speed: give speed, or name a diagnosis"
        raise MeasurementError(recording.name, rule=rule, field="speed")
    samples = math.inf if question.speed is None else 2.0 * math.pi * recording.sample_rate / abs(question.speed)
    if samples < FEWEST_SAMPLES:
        rule = f"speed: a revolution has {samples:.2g} samples; at least {FEWEST_SAMPLES:g} are needed"
        raise MeasurementError(recording.name, rule=rule, field="speed")
    views: Mapping[str, Callable[[Motion, SignalQuestion], ShownSignal]] = {
        "waveform": _waveform,
        "spectrum": _spectrum,
        "spectrogram": _spectrogram,
        "revolution": _revolution,
        "overall": _overall,
    }
    shown = views[question.view](motion, question)
    if not motion.integrates:
        return shown
    note = f"integrated above {motion.high_pass:.4g} Hz"
    return replace(shown, high_pass=motion.high_pass, notes=(*shown.notes, note))


def _waveform(motion: Motion, question: SignalQuestion) -> ShownSignal:
    """Samples over time; where there are more than points, the lowest and the highest of each place."""
    rate, count = motion.recording.sample_rate, len(motion.recording.signal)
    start = 0 if question.start is None else max(0, math.floor(question.start * rate))
    end = count if question.end is None else min(count, math.ceil(question.end * rate) + 1)
    if end - start < 2:
        rule = f"from {question.start} s to {question.end} s: no samples of {count / rate:.6g} s lie there"
        raise MeasurementError(motion.recording.name, rule=rule, field="from")
    values = motion.part(start, end)
    ends = (0.0, (count - 1) / rate)
    lines: list[ShownLine] = []
    if end - start <= 2 * question.points:
        at = np.asarray(np.arange(start, end) / rate)
        for name, unit, column in zip(motion.names, motion.units, values.T, strict=True):
            lines.append(ShownLine(name, "value", unit, column))
        return ShownSignal("time", "s", ends, at, tuple(lines))
    edges = np.linspace(0, end - start, question.points + 1).astype(np.intp)
    at = np.asarray((start + 0.5 * (edges[:-1] + edges[1:] - 1)) / rate)
    for name, unit, column in zip(motion.names, motion.units, values.T, strict=True):
        lines.append(ShownLine(name, "low", unit, np.minimum.reduceat(column, edges[:-1])))
        lines.append(ShownLine(name, "high", unit, np.maximum.reduceat(column, edges[:-1])))
    return ShownSignal("time", "s", ends, at, tuple(lines))


def _spectrum(motion: Motion, question: SignalQuestion) -> ShownSignal:
    """Welch spectrum; where there are more lines than points, the highest of each place, and where it is."""
    rate, count = motion.recording.sample_rate, len(motion.recording.signal)
    turn = None if question.speed is None else abs(question.speed) / (2.0 * math.pi)
    window = WINDOW_S if turn is None else WINDOW_REVOLUTIONS / turn
    longest = count / rate * 2.0 / (FEWEST_WINDOWS + 1)
    if window > longest:
        # Whole revolutions, where there is room for them, so that orders lie on lines.
        window = longest if turn is None or longest * turn < 1.0 else math.floor(longest * turn) / turn
    measured, quantity = motion.as_measured()
    times = DERIVATIVES[UNITS[question.unit].quantity] - DERIVATIVES[quantity]
    found = welch(
        measured.part(0, count), rate, drive_speed=question.speed, channels=motion.names,
        units=motion.units, window_length=max(8, min(count, round(window * rate))),
    )  # fmt: skip
    frequency, density = found.frequency[1:], found.values[1:]
    factor = (2.0 * math.pi * frequency) ** times
    if times < 0:
        factor = factor * pass_factor(frequency, motion.high_pass)
    density = density * (factor[:, None] * motion.factors) ** 2
    said = f"mean of {found.averages} Hann windows of {window:.4g} s that overlap by half"
    width = HANN_NOISE_LINES * found.resolution
    return replace(_lines(frequency, density, width, motion.names, motion.units, question), notes=(said,))


def show_spectrum(spectrum: MeasuredSpectrum, question: SignalQuestion) -> ShownSignal:
    """Show a measured spectrum, as :func:`show_signal` shows that of a recording.

    Raises
    ------
    MeasurementError
        Orders are asked for without a speed; there is no such channel.
    """
    names = spectrum.channel_names
    if question.channel and question.channel not in names:
        rule = f"channel {question.channel[:80]}: must be one of {', '.join(names)}"
        raise MeasurementError(spectrum.name, rule=rule, field="channel")
    if question.axis == "order" and question.speed is None:
        rule = "orders need the drive speed: give speed, or name a diagnosis"
        raise MeasurementError(spectrum.name, rule=rule, field="speed")
    wanted = [place for place, name in enumerate(names) if question.channel in ("", name)]
    unit, first = UNITS[question.unit], int(spectrum.frequency[0] == 0.0)
    frequency = spectrum.frequency[first:]
    times = np.array([DERIVATIVES[unit.quantity] - DERIVATIVES[spectrum.channels[each].quantity] for each in wanted])
    density = spectrum.density[first:, wanted] * (unit.factor * (2.0 * math.pi * frequency[:, None]) ** times) ** 2
    # Numbers of a file come back as they are there: what a line stands for is as wide as its window makes it.
    width = spectrum.resolution * np.array([spectrum.forms[each].line_widths or 1.0 for each in wanted])
    units = (question.unit,) * len(wanted)
    return _lines(frequency, density, width, tuple(names[each] for each in wanted), units, question)


def _lines(
    frequency: FloatArray,
    density: FloatArray,
    width: float | FloatArray,
    names: tuple[str, ...],
    units: tuple[str, ...],
    question: SignalQuestion,
) -> ShownSignal:
    """Lines of a spectrum (n, m), each of a stretch of `width` [Hz], in the part of the axis that is asked for."""
    values = scale_power(density * width, width, question.scaling)
    turn = None if question.speed is None else abs(question.speed) / (2.0 * math.pi)
    per = 1.0 if question.axis == "hz" or turn is None else turn
    axis = frequency / per
    ends = (float(axis[0]), float(axis[-1]))
    low, high = (
        (ends[0] if question.start is None else question.start),
        (ends[1] if question.end is None else question.end),
    )
    first, last = np.searchsorted(axis, [low, high])
    part = slice(max(0, int(first) - 1), min(len(axis), int(last) + 1))
    axis, values = _highest(axis[part], values[part], question.points)
    lines = zip(names, value_units(units, question.scaling), values.T, strict=True)
    return ShownSignal(
        "frequency" if per == 1.0 else "order",
        "Hz" if per == 1.0 else "",
        ends,
        axis,
        tuple(ShownLine(name, "value", unit, column) for name, unit, column in lines),
        resolution=float(frequency[1] - frequency[0]) / per,
    )


def _highest(axis: FloatArray, values: FloatArray, points: int) -> tuple[FloatArray, FloatArray]:
    """The highest of every place, (points, m), and where the line lies that stands out most there."""
    if len(axis) <= points:
        return axis, values
    edges = np.linspace(0, len(axis), points + 1).astype(np.intp)
    relative = (values / np.maximum(values.max(axis=0), 1e-300)).max(axis=1)
    places = [begin + int(np.argmax(relative[begin:end])) for begin, end in itertools.pairwise(edges)]
    return axis[places], np.maximum.reduceat(values, edges[:-1], axis=0)


def _spectrogram(motion: Motion, question: SignalQuestion) -> ShownSignal:
    """Levels by frequency over time, or by order over revolutions."""
    if len(motion.names) > 1:
        motion = motion.only(motion.names[0])
    rate, count = motion.recording.sample_rate, len(motion.recording.signal)
    turn = None if question.speed is None else abs(question.speed) / (2.0 * math.pi)
    by_order = question.axis == "order" and turn is not None
    per_second = turn if by_order and turn is not None else 1.0
    length = min(count, max(64, round((SHORT_S if turn is None else SHORT_REVOLUTIONS / turn) * rate)))
    start = 0 if question.start is None else max(0, round(question.start / per_second * rate) - length // 2)
    end = count if question.end is None else min(count, round(question.end / per_second * rate) + length // 2)
    if end - start < length:
        start = max(0, min(start, count - length))
        end = start + length
    columns = max(1, min(COLUMNS, question.points, 1 + 4 * (end - start - length) // length))
    begins = np.linspace(start, end - length, columns).astype(np.intp)
    values = motion.part(start, end)[:, 0]
    taper = np.hanning(length + 1)[:-1]
    frequency = scipy.fft.rfftfreq(length, 1.0 / rate)
    top = min(0.5 * rate, HIGHEST_ORDER * turn) if turn is not None else 0.5 * rate
    kept = int(np.searchsorted(frequency, top))
    edges = np.unique(np.linspace(1, max(2, kept), min(ROWS, max(1, kept - 1)) + 1).astype(np.intp))
    rows = 0.5 * (frequency[edges[:-1]] + frequency[edges[1:] - 1])
    levels = np.empty((len(edges) - 1, columns))
    for column, begin in enumerate(begins - start):
        stretch = values[begin : begin + length]
        power = np.abs(scipy.fft.rfft((stretch - stretch.mean()) * taper)[: edges[-1]]) ** 2
        levels[:, column] = np.add.reduceat(power, edges[:-1])
    levels *= 2.0 / (length * float(np.sum(taper**2)))
    decibels = 10.0 * np.log10(np.maximum(levels, 1e-300))
    middle = (begins + 0.5 * length) / rate * per_second
    half = 0.5 * length / rate * per_second
    return ShownSignal(
        "revolution" if by_order else "time",
        "" if by_order else "s",
        (half, max(half, (count - 0.5 * length) / rate * per_second)),
        np.asarray(middle),
        (ShownLine(motion.names[0], "value", motion.units[0], np.empty(0)),),
        rows=rows / (turn if by_order and turn is not None else 1.0),
        levels=np.maximum(decibels, decibels.max() - FLOOR_DB),
        notes=(f"Hann windows of {length / rate:.4g} s",),
    )


def _revolution(motion: Motion, question: SignalQuestion) -> ShownSignal:
    """Mean and rms by the angle of the drive: what repeats with it, and where it is loud."""
    recording = motion.recording
    rate, count = recording.sample_rate, len(recording.signal)
    angle, notes = _drive_angle(recording, motion.columns, question.speed or 0.0)
    values = motion.part(0, count)
    parts = int(min(ANGLES, question.points, max(FEWEST_ANGLES, rate * 2.0 * math.pi / abs(question.speed or 1.0))))
    known = np.isfinite(angle)
    values = values[known] - values[known].mean(axis=0)
    lines: list[ShownLine] = []
    for name, unit, mean, rms in zip(motion.names, motion.units, *by_angle(values, angle[known], parts), strict=True):
        lines += [ShownLine(name, "mean", unit, mean), ShownLine(name, "rms", unit, rms)]
    at = np.asarray((np.arange(parts) + 0.5) * (360.0 / parts))
    turns = float(np.ptp(angle[known])) / (2.0 * math.pi)
    return ShownSignal("angle", "deg", (0.0, 360.0), at, tuple(lines), notes=(f"{turns:.4g} revolutions", *notes))


def by_angle(values: FloatArray, angle: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
    """Mean and rms of channels (n, c) in equal parts of a revolution, (c, parts) each; `angle` (n,) in rad."""
    place = np.floor((angle % (2.0 * math.pi)) * (parts / (2.0 * math.pi))).astype(np.intp) % parts
    held = np.maximum(np.bincount(place, minlength=parts), 1)
    mean = np.array([np.bincount(place, column, parts) / held for column in values.T])
    square = np.array([np.bincount(place, column**2, parts) / held for column in values.T])
    return mean, np.sqrt(square)


def _drive_angle(recording: Recording, columns: tuple[int, ...], speed: float) -> tuple[FloatArray, tuple[str, ...]]:
    """Angle [rad] of the drive at every sample, (n,); not a number before the first and after the last pulse."""
    count, rate = len(recording.signal), recording.sample_rate
    if recording.turns is not None and len(recording.turns) > 1:
        turned = 2.0 * math.pi * np.arange(len(recording.turns))
        angle = np.interp(np.arange(count), recording.turns, turned, left=np.nan, right=np.nan)
        return angle, ("0 deg is the pulse of the tacho",)
    told = "0 deg is the beginning of the recording: without a tacho nothing says where the drive stands"
    signal = np.asarray(recording.signal[:, list(columns)], np.float64)
    try:
        track = track_speed(signal, rate, speed, recording.name)
    except MeasurementError:
        return np.asarray(np.arange(count) * (abs(speed) / rate)), (
            told,
            "turned evenly at the drive speed: no orders were found",
        )
    course = np.interp(np.arange(count) / rate, track.time, track.speed)
    angle = np.asarray(np.concatenate([[0.0], np.cumsum(0.5 * (course[1:] + course[:-1]))]) / rate)
    return _in_step(signal, angle), (told,)


def _in_step(signal: FloatArray, angle: FloatArray) -> FloatArray:
    """Angle [rad] corrected so that what repeats does so at one angle from beginning to end, (n,).

    A ten-thousandth of a wrong speed is a twentieth of a revolution after five hundred. Profiles of some revolutions
    each are laid over the one of all.
    """
    turns = angle / (2.0 * math.pi)
    blocks = int(turns[-1] / STEP_REVOLUTIONS)
    if blocks < 2:
        return angle
    block = np.minimum((turns / (turns[-1] / blocks)).astype(np.intp), blocks - 1)
    middle = (np.arange(blocks) + 0.5) * (turns[-1] / blocks)
    level = signal - signal.mean(axis=0)
    level /= np.maximum(np.sqrt(np.mean(level**2, axis=0)), 1e-300)
    shift = np.zeros(blocks)
    for _ in range(2):
        place = ((turns - np.interp(turns, middle, shift)) % 1.0 * ANGLES).astype(np.intp) % ANGLES + ANGLES * block
        held = np.maximum(np.bincount(place, minlength=blocks * ANGLES), 1)
        profiles = np.stack([np.bincount(place, each, blocks * ANGLES) / held for each in level.T])
        lines = scipy.fft.rfft(profiles.reshape(len(profiles), blocks, ANGLES), axis=-1)
        alike = scipy.fft.irfft((lines * lines.mean(axis=1, keepdims=True).conj()).sum(axis=0), ANGLES, axis=-1)
        near = np.arange(-MOST_SHIFTED, MOST_SHIFTED + 1)
        shift += near[np.argmax(alike[:, near], axis=1)] / ANGLES
    return np.asarray(angle - 2.0 * math.pi * np.interp(turns, middle, shift - shift[0]))


def _overall(motion: Motion, question: SignalQuestion) -> ShownSignal:
    """Rms and peak, and the rms velocity between 10 and 1000 Hz that plants go by."""
    rate, count = motion.recording.sample_rate, len(motion.recording.signal)
    band = (OVERALL_HZ[0], min(OVERALL_HZ[1], PASS * rate))
    measured, quantity = motion.as_measured()
    whole = measured.part(0, count)
    found = welch(
        whole, rate, drive_speed=None, channels=motion.names, units=motion.units,
        window_length=max(8, min(count, round(2.0 * rate))),
    )  # fmt: skip
    frequency, density = found.frequency[1:, None], found.values[1:]

    def rms_as(wanted: Quantity, weight: FloatArray) -> FloatArray:
        factor = (2.0 * math.pi * frequency) ** (DERIVATIVES[wanted] - DERIVATIVES[quantity]) * weight
        return np.asarray(np.sqrt((density * factor**2).sum(axis=0) * found.resolution))

    velocity = UNITS["mm/s"].factor * rms_as(
        "velocity", np.where((frequency >= band[0]) & (frequency <= band[1]), 1.0, 0.0)
    )
    values = whole * motion.factors if motion.derivatives == measured.derivatives else motion.part(0, count)
    if motion.integrates:
        # What lies beyond its ends is not known: there an integral is a guess.
        unsure = min(count // 4, continued_samples(rate, motion.high_pass))
        values = values[unsure : count - unsure]
        rms = motion.factors * rms_as(UNITS[question.unit].quantity, pass_factor(frequency, motion.high_pass))
    else:
        rms = values.std(axis=0)
    peak = np.abs(values - values.mean(axis=0)).max(axis=0)
    rows = tuple(
        OverallLevel(name, unit, *map(float, levels))
        for name, unit, *levels in zip(motion.names, motion.units, rms, peak, velocity, strict=True)
    )
    notes = () if band[1] == OVERALL_HZ[1] else (f"the sample rate bounds the band at {band[1]:.4g} Hz",)
    if band[1] <= band[0]:
        rows, notes = tuple(replace(row, velocity_rms=None) for row in rows), ("the sample rate is too low for it",)
    return ShownSignal("", "", (0.0, 0.0), np.empty(0), overall=rows, band=band, notes=notes)
