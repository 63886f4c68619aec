"""A spectrum of somebody else's analyser: one-sided density of power in SI, and what had to be known for that.

A file may hold a recording over time, or such a spectrum: :func:`read_recording` tells which.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal, cast

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import parse_unit
from jointplay.catalogue.measurements.import_profile import WINDOWS, ImportProfile, profile_beside
from jointplay.catalogue.measurements.measured_columns import check_given, find_unit, is_spectrum
from jointplay.catalogue.measurements.measurement import SI_UNITS, Channel, Recording, measurement_of, raw_of
from jointplay.catalogue.measurements.missing_cells import refuse_missing
from jointplay.catalogue.measurements.readers import Limits, RawColumn, RawRecording, SpectrumForm
from jointplay.catalogue.measurements.readers.raw import LARGEST
from jointplay.solver.arrays import FloatArray
from jointplay.solver.spectra.spectrum import Quantity

_DETECTORS: dict[str, Literal["rms", "peak", "peak-to-peak"]] = {
    "rms": "rms",
    "eff": "rms",
    "peak": "peak",
    "pk": "peak",
    "0-pk": "peak",
    "pp": "peak-to-peak",
    "pk-pk": "peak-to-peak",
    "p-p": "peak-to-peak",
}
#: Factor from the square of an amplitude to power.
_POWER = {"rms": 1.0, "peak": 0.5, "peak-to-peak": 0.125}
_LEVEL = re.compile(r"dB\b\s*(?:\(?re\b:?\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)?)?\s*(.*?)\)?")
_WINDOW = re.compile(r"\b(rectangular|hann|hamming|blackman|flat[ -]?top)(?:ing)?\b", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class MeasuredSpectrum:
    """Spectra of sensors, without phases.

    Parameters
    ----------
    name : str
    frequency : (n,) array
        Hz, even steps.
    density : (n, c) array
        One-sided, rms, SI squared / Hz.
    channels : tuple of Channel, (c,)
    warnings, import_report : tuple of str
    sha256 : str
    forms : tuple of SpectrumForm, (c,)
        What the numbers of each channel are in the file.
    measured_at : datetime or None
        When it was measured, in UTC, where its sender or the file says so.
    """

    name: str
    frequency: FloatArray
    density: FloatArray
    channels: tuple[Channel, ...]
    warnings: tuple[str, ...]
    import_report: tuple[str, ...]
    sha256: str
    forms: tuple[SpectrumForm, ...]
    measured_at: datetime | None = None

    @property
    def resolution(self) -> float:
        """Distance of lines [Hz]."""
        return float(self.frequency[1] - self.frequency[0])

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels, (c,)."""
        return tuple(channel.name for channel in self.channels)


def spectrum_of(raw: RawRecording, units: Mapping[str, str], limits: Limits, sha256: str) -> MeasuredSpectrum:
    """Judge what a reader has as a spectrum.

    Parameters
    ----------
    raw : RawRecording
        Its first column is the frequency.
    units : mapping of column to unit
        In place of the file's; ``*`` for columns of which it says nothing.
    limits : Limits
    sha256 : str

    Returns
    -------
    MeasuredSpectrum

    Raises
    ------
    MeasurementError
        Something that is needed is not said: scaling, rms or peak, window, unit; or frequencies are not even.
    """
    if len(raw.values) < limits.min_samples:
        raise MeasurementError(raw.source, rule=f"{len(raw.values)} lines; at least {limits.min_samples} are needed")
    for index in range(len(raw.columns)):
        refuse_missing(raw, index, "lines of a spectrum are not filled: leave out the column by ignore in a profile")
    frequency = _frequencies(raw, units)
    step = float(frequency[1] - frequency[0])
    facts, warnings = list(raw.facts), list(raw.warnings)
    facts.append(f"spectrum of {len(frequency)} lines, {step:.6g} Hz apart, to {frequency[-1]:.6g} Hz")
    form = _name_window(raw, facts)
    check_given(raw, units)
    channels: list[Channel] = []
    forms: list[SpectrumForm] = []
    densities: list[FloatArray] = []
    for column, values in zip(raw.columns[1:], raw.values.T[1:], strict=True):
        text, own = _form_of(column, find_unit(column, units), form, raw.source)
        unit = parse_unit(text)
        if unit is None or unit.quantity in ("time", "frequency"):
            warnings.append(f"column {column.label!r} left out: {text!r} is no unit of a motion")
            continue
        density = _density(values, own, unit.factor, step, column, raw.source)
        quantity = cast(Quantity, unit.quantity)
        channels.append(Channel(column.name, text, quantity))
        densities.append(density)
        forms.append(own)
        rms = float(np.sqrt(density.sum() * step))
        told = f"{own.scaling}, {own.detector}" + (", dB" if own.decibel else "")
        facts.append(f"{column.position} {column.label!r}: {quantity}, {told}; rms {rms:.4g} {SI_UNITS[quantity]}")
    if not channels:
        rule = "no column is a displacement, velocity or acceleration"
        raise MeasurementError(raw.source, rule=rule, field="units")
    warnings.append(
        "a spectrum has no phases and no course in time: sensors are compared one by one; noise, wander, mains hum,"
        " clipping and unsteady parts cannot be told from the machine"
    )
    table = np.column_stack(densities)
    table.flags.writeable = False
    said = (tuple(channels), tuple(warnings), tuple(facts), sha256, tuple(forms), raw.measured_at)
    return MeasuredSpectrum(raw.source, frequency, table, *said)


def _frequencies(raw: RawRecording, given: Mapping[str, str]) -> FloatArray:
    column = raw.columns[0]
    text = given.get(column.name) or column.unit
    unit = parse_unit(text or "")
    if unit is None or unit.quantity != "frequency":
        rule = "is not a unit of frequency: Hz, kHz"
        raise MeasurementError(raw.source, None, column.name, text, rule, field="units")
    frequency = raw.values[:, 0] * unit.factor
    steps = np.diff(frequency)
    mean = float(frequency[-1] - frequency[0]) / len(steps)
    if frequency[0] < 0 or not mean > 0:
        raise MeasurementError(raw.source, None, column.name, rule="frequencies must rise from zero on")
    # Printed frequencies are rounded: 0.1 % of a step adds up to nothing, for each is compared with its place.
    place = frequency[0] + mean * np.arange(len(frequency))
    off = np.abs(frequency - place)
    if float(off.max()) > 0.05 * mean:
        at = int(np.argmax(off > 0.05 * mean))
        rule = "lines are not evenly spaced"
        raise MeasurementError(raw.source, raw.line_of(at), column.name, float(raw.values[at, 0]), rule)
    return np.asarray(place, dtype=np.float64)


def _name_window(raw: RawRecording, facts: list[str]) -> SpectrumForm:
    """Form of the file, with the window that its header names."""
    form = raw.form or SpectrumForm()
    if form.line_widths is None:
        named = {re.sub(r"[ -]", "", found.lower()) for fact in raw.facts for found in _WINDOW.findall(fact)}
        if len(named) == 1:
            window = named.pop()
            facts.append(f"window {window}, as the header says")
            form = dataclasses.replace(form, line_widths=WINDOWS[window])
    return form


def _form_of(column: RawColumn, text: str | None, form: SpectrumForm, source: str) -> tuple[str, SpectrumForm]:
    """Unit of the motion and form of a column, from "g rms", "(m/s2)^2/Hz", "dB re 1 m/s2 peak" and the profile."""
    if text is None:
        rule = "has no unit: write it in the header, as in 's1-x [g rms]', or give it"
        raise MeasurementError(source, None, column.name, rule=rule, field="units")
    plain = text.strip()
    level = _LEVEL.fullmatch(plain)
    if level:
        reference = float(level[1]) if level[1] else None
        if None not in (reference, form.reference) and reference != form.reference:
            rule = f"the profile says re {form.reference:g}"
            raise MeasurementError(source, None, column.name, text, rule, field="reference")
        form = dataclasses.replace(form, decibel=True, reference=form.reference if reference is None else reference)
        plain = (level[2] or "").strip()
    detector = next(
        (word for word in _DETECTORS if re.search(rf"(^|[\s,(]){re.escape(word)}\)?$", plain.lower())), None
    )
    if detector is not None:
        if form.detector not in (None, _DETECTORS[detector]):
            rule = f"the profile says {form.detector}"
            raise MeasurementError(source, None, column.name, text, rule, field="detector")
        form = dataclasses.replace(form, detector=_DETECTORS[detector])
        plain = plain[: plain.lower().rindex(detector)].rstrip(" ,(")
    density = re.fullmatch(r"\(?(.*?)\)?\s*(?:\^?2|²)\s*/\s*Hz", plain)
    squares = re.fullmatch(r"\((.*)\)\s*(?:\^?2|²)|(g)(?:\^2|²)", plain)
    said: Literal["psd", "power"] | None = "psd" if density else "power" if squares else None
    if density:
        plain = density[1]
    elif squares:
        plain = squares[1] or squares[2]
    if said is not None and form.scaling not in (None, said):
        rule = f"is a unit of {said}, not of {form.scaling}"
        raise MeasurementError(source, None, column.name, text, rule, field="scaling")
    scaling = form.scaling or said or ("amplitude" if form.detector else None)
    if scaling is None:
        rule = "does not say what it is: give its scaling: psd, power or amplitude"
        raise MeasurementError(source, None, column.name, text, rule, field="scaling")
    if scaling == "psd":
        form = dataclasses.replace(form, detector=form.detector or "rms")
    if form.detector is None:
        rule = "does not say whether it is rms or peak: give its detector"
        raise MeasurementError(source, None, column.name, text, rule, field="detector")
    if scaling != "psd" and form.line_widths is None:
        rule = "the window is needed to compare amplitudes: give its window"
        raise MeasurementError(source, None, column.name, text, rule, field="window")
    if form.decibel and form.reference is None:
        rule = "levels without a reference: give their reference"
        raise MeasurementError(source, None, column.name, text, rule, field="reference")
    if form.decibel and not 0 < (form.reference or 0) < LARGEST:
        rule = f"its reference must lie between 0 and {LARGEST:g}"
        raise MeasurementError(source, None, column.name, text, rule, field="reference")
    return plain, dataclasses.replace(form, scaling=scaling)


def _density(
    values: FloatArray, form: SpectrumForm, factor: float, step: float, column: RawColumn, source: str
) -> FloatArray:
    if form.decibel:
        if float(np.max(np.abs(values))) > 400.0:
            raise MeasurementError(source, None, column.name, float(np.max(np.abs(values))), "is no level in dB")
        assert form.reference is not None
        power = (form.reference * factor) ** 2 * 10.0 ** (0.1 * values)
    else:
        if float(values.min()) < 0:
            raise MeasurementError(source, None, column.name, float(values.min()), "must not be negative in a spectrum")
        power = (values * factor) ** 2 if form.scaling == "amplitude" else values * factor**2
    if not float(power.max()) > 0:
        raise MeasurementError(source, None, column.name, 0.0, "the channel is zero throughout")
    power = power * _POWER[form.detector or "rms"]
    return power if form.scaling == "psd" else power / (step * (form.line_widths or 1.0))


def read_recording(
    source: str | Path | bytes,
    *,
    name: str | None = None,
    sample_rate: float | None = None,
    units: Mapping[str, str] | None = None,
    limits: Limits | None = None,
    profile: ImportProfile | None = None,
) -> Recording | MeasuredSpectrum:
    """Read a recording or a spectrum.

    Parameters and errors are those of :func:`jointplay.catalogue.measurements.measurement.read_measurement`.

    Returns
    -------
    Recording or MeasuredSpectrum
        A spectrum where the first column is a frequency.
    """
    limits, profile = limits or Limits(), profile or profile_beside(source)
    raw, sha256 = raw_of(source, name, limits, profile)
    if is_spectrum(raw, units):
        if sample_rate is not None:
            rule = "is given, but the file holds a spectrum"
            raise MeasurementError(raw.source, None, "sample_rate", sample_rate, rule, field="sample_rate")
        return spectrum_of(raw, dict(units or {}), limits, sha256)
    rate = sample_rate or profile.sample_rate_hz
    return measurement_of(raw, sample_rate=rate, units=units, limits=limits, sha256=sha256)
