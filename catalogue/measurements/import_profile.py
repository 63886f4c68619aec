"""Mapping profiles: what a file does not say of itself, and the program must not guess, in YAML or JSON.

A profile beside a recording, ``shaper.wav.json`` for ``shaper.wav``, is found by itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import (
    is_voltage,
    parse_sensitivity,
    parse_unit,
    split_label,
    volts_of,
)
from jointplay.catalogue.measurements.measured_columns import ALL_OTHERS, find_unit, is_spectrum
from jointplay.catalogue.measurements.moments import check_zone, parse_said, place_moment, understand_moment
from jointplay.catalogue.measurements.readers.raw import RawColumn, RawRecording, SpectrumForm
from jointplay.catalogue.measurements.tacho import turns_of
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.yamlfile import read_tree

#: Endings of a profile that lies beside its recording.
BESIDE = (".json", ".yaml", ".yml")

#: Equivalent noise bandwidth of windows, lines (Harris 1978, table I).
WINDOWS = {"rectangular": 1.0, "hann": 1.5, "hamming": 1.36, "blackman": 1.73, "flattop": 3.77}

Text = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x08\x0b\x0c\x0e-\x1f]*$")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _ProfilePart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SpectrumSaid(_ProfilePart):
    """What the numbers of a spectrum are, in a profile."""

    scaling: Literal["psd", "power", "amplitude"] | None = None
    detector: Literal["rms", "peak", "peak-to-peak"] | None = None
    decibel: bool | None = None
    reference: Positive | None = None
    window: Literal["rectangular", "hann", "hamming", "blackman", "flattop"] | None = None


class Tacho(_ProfilePart):
    """A column with pulses of the drive's shaft.

    Parameters
    ----------
    column : str
        Any unit will do.
    pulses_per_revolution : int
    threshold : float, optional
        Level that a pulse crosses, as the file has it; half way between the channel's ends unless given.
    edge : {"rising", "falling"}
    """

    column: Text
    pulses_per_revolution: Annotated[int, Field(ge=1, le=10_000)] = 1
    threshold: Annotated[float, Field(allow_inf_nan=False)] | None = None
    edge: Literal["rising", "falling"] = "rising"


class ImportProfile(_ProfilePart):
    """How to read files of one origin.

    Parameters
    ----------
    delimiter, decimal : str, optional
        Of a table of text; found out unless given. ``tab`` and ``blank`` stand for themselves.
    skip_lines : int
        First lines of a table of text that are not looked at.
    channels : list of str, optional
        Names of all columns or channels, in the file's order; in place of those of the file.
    units : mapping of column to unit
        In place of the file's; ``*`` for columns of which it says nothing.
    sensitivity : mapping of column to text
        What a sensor gives, "100 mV/g", for columns that are in volts; ``*`` for all of them.
    sensors : mapping of column to sensor
        Of the machine.
    ignore : list of str
        Columns that are left out.
    time_column : str, optional
    sample_rate_hz : float, optional
        Of a file without times.
    full_scale_m_s2 : float or list of float, optional
        Acceleration that a WAV file's full scale stands for, of all channels or of each.
    full_scale : str, optional
        The same as number and unit: "5 g", "25 mm/s"; "1 V" where there is a sensitivity.
    spectrum : SpectrumSaid, optional
    tacho : Tacho, optional
    measured_at : datetime, optional
        When it was measured, "2024-11-21T10:03:00+01:00", in place of what the file says; kept in UTC.
    time_zone : str, optional
        Of times that name none, here and in the file: "Europe/Berlin", "+01:00"; UTC unless given.
    """

    delimiter: Literal[",", ";", "|", "tab", "blank"] | None = None
    decimal: Literal[".", ","] | None = None
    skip_lines: Annotated[int, Field(ge=0, le=10_000)] = 0
    channels: Annotated[tuple[Text, ...], Field(max_length=256)] | None = None
    units: Annotated[dict[Text, Text], Field(max_length=256)] = {}
    sensitivity: Annotated[dict[Text, Text], Field(max_length=256)] = {}
    sensors: Annotated[dict[Text, Text], Field(max_length=256)] = {}
    ignore: Annotated[tuple[Text, ...], Field(max_length=256)] = ()
    time_column: Text | None = None
    sample_rate_hz: Positive | None = None
    full_scale_m_s2: Positive | Annotated[tuple[Positive, ...], Field(min_length=1, max_length=256)] | None = None
    full_scale: Text | None = None
    spectrum: SpectrumSaid | None = None
    tacho: Tacho | None = None
    time_zone: Annotated[Text, AfterValidator(check_zone)] | None = None
    measured_at: Annotated[datetime, BeforeValidator(parse_said)] | None = None

    @field_validator("measured_at")
    @classmethod
    def _placed(cls, moment: datetime | None, info: ValidationInfo) -> datetime | None:
        return None if moment is None else place_moment(moment, info.data.get("time_zone"))

    @property
    def table(self) -> dict[str, Any]:
        """What the reader of text needs to know."""
        delimiter = {"tab": "\t", "blank": " "}.get(self.delimiter or "", self.delimiter)
        return {
            "delimiter": delimiter,
            "decimal": self.decimal,
            "skipped": self.skip_lines,
            "names": self.channels,
            "ignored": self.ignore,
        }

    def apply(self, raw: RawRecording) -> RawRecording:
        """Return what a reader found with what the profile says of it.

        Parameters
        ----------
        raw : RawRecording

        Raises
        ------
        MeasurementError
            The profile does not fit the file.
        """
        raw = self._scale(self._name_columns(raw))
        names = [column.name for column in raw.columns]
        told = list(raw.facts)
        for field in ("units", "sensitivity", "sensors", "ignore"):
            known = (*names, ALL_OTHERS) if field in ("units", "sensitivity") else names
            unknown = next((name for name in getattr(self, field) if name not in known), None)
            if unknown is not None:
                rule = f"the profile's {field} names it; columns are {', '.join(names)}"
                at = field if field == "sensitivity" else "profile"
                raise MeasurementError(raw.source, None, unknown, rule=rule, field=at)
        if self.time_column is not None and self.time_column not in names:
            rule = f"is the profile's time_column; columns are {', '.join(names)}"
            raise MeasurementError(raw.source, None, self.time_column, rule=rule, field="profile")
        turns = None
        if self.tacho is not None:
            if self.tacho.column not in names:
                rule = f"is to be the tacho; columns are {', '.join(names)}"
                raise MeasurementError(raw.source, None, self.tacho.column, rule=rule, field="tacho")
            if is_spectrum(raw, self.units):
                rule = "is to be the tacho, but the file holds a spectrum"
                raise MeasurementError(raw.source, None, self.tacho.column, rule=rule, field="tacho")
            pulsing = raw.values[:, names.index(self.tacho.column)]
            if np.isnan(pulsing).any():
                rule = f"is to be the tacho, but has no number in {np.isnan(pulsing).sum()} of its cells"
                raise MeasurementError(raw.source, None, self.tacho.column, rule=rule, field="tacho")
            each, falling = self.tacho.pulses_per_revolution, self.tacho.edge == "falling"
            turns = turns_of(pulsing, each, self.tacho.threshold, falling, raw.source, self.tacho.column)
            told.append(f"tacho {self.tacho.column!r}: {len(turns) - 1} revolutions, {each} pulses each")
        columns, kept, factors = [], [], []
        for index, column in enumerate(raw.columns):
            is_tacho = self.tacho is not None and column.name == self.tacho.column
            if column.is_text or column.name in self.ignore or is_tacho:
                continue
            name = "time" if column.name == self.time_column else self.sensors.get(column.name, column.name)
            unit = find_unit(column, self.units)
            if (name, unit) != (column.name, column.unit):
                told.append(f"{column.position} {column.label!r}: {name} in {unit or 'no unit'}, as the profile says")
            factor, unit = self._scale_sensor(column, unit, raw, told)
            factors.append(factor)
            columns.append(RawColumn(column.label, name, unit, column.position))
            kept.append(index)
        if not kept:
            raise MeasurementError(raw.source, rule="no column is left: all are ignored or text", field="profile")
        if ALL_OTHERS in self.sensitivity and not any(is_voltage(find_unit(each, self.units)) for each in raw.columns):
            rule = "is said of columns in volts, but no column is in V, mV or uV"
            raise MeasurementError(raw.source, None, "sensitivity", rule=rule, field="sensitivity")
        values = raw.values[:, kept]
        measured_at, warnings = self._find_moment(raw, told)
        return dataclasses.replace(
            raw,
            columns=tuple(columns),
            values=values * np.array(factors) if self.sensitivity else values,
            facts=tuple(told),
            form=self._form(raw),
            turns=turns,
            measured_at=measured_at,
            warnings=warnings,
        )

    def _find_moment(self, raw: RawRecording, told: list[str]) -> tuple[datetime | None, tuple[str, ...]]:
        """When the file was measured, and its warnings: with one more where what it says is not sure."""
        if self.measured_at is not None and raw.moment is not None:
            told.append(f"{raw.moment.where}: not used: its sender says when it was measured")
        if self.measured_at is not None or raw.moment is None:
            return self.measured_at, raw.warnings
        measured_at, said = understand_moment(raw.moment, self.time_zone)
        if measured_at is None:
            return None, (*raw.warnings, said)
        told.append(said)
        return measured_at, raw.warnings

    def _scale_sensor(
        self, column: RawColumn, unit: str | None, raw: RawRecording, told: list[str]
    ) -> tuple[float, str | None]:
        """Factor and unit of the motion that the voltage of a column stands for."""
        said = self.sensitivity.get(column.name)
        if said is None and is_voltage(unit):
            said = self.sensitivity.get(ALL_OTHERS)
        if said is None:
            return 1.0, unit
        found = parse_sensitivity(said)
        if found is None:
            rule = 'must be a voltage a unit of motion, such as "100 mV/g"'
            raise MeasurementError(raw.source, None, column.name, said, rule, field="sensitivity")
        if unit is None or not is_voltage(unit):
            rule = f"has a sensitivity, but is in {unit or 'no unit'}: it must be in V, mV or uV"
            raise MeasurementError(raw.source, None, column.name, said, rule, field="sensitivity")
        if is_spectrum(raw):
            rule = "a sensitivity can be given for recordings over time: the file holds a spectrum"
            raise MeasurementError(raw.source, None, column.name, said, rule, field="sensitivity")
        told.append(f"{column.position} {column.label!r}: {unit} by a sensor of {said}")
        return volts_of(unit) / found[0], found[1]

    def _name_columns(self, raw: RawRecording) -> RawRecording:
        if self.channels is None:
            return raw
        if len(self.channels) != len(raw.columns):
            rule = f"the profile names {len(self.channels)} channels, the file has {len(raw.columns)}"
            raise MeasurementError(raw.source, rule=rule, field="profile")
        labels = [split_label(name) for name in self.channels]
        columns = tuple(
            dataclasses.replace(column, name=name, unit=unit or column.unit)
            for column, (name, unit) in zip(raw.columns, labels, strict=True)
        )
        return dataclasses.replace(raw, columns=columns)

    def _scale(self, raw: RawRecording) -> RawRecording:
        """Turn fractions of a full scale into what they stand for."""
        if self.full_scale_m_s2 is None and self.full_scale is None:
            return raw
        if not raw.relative:
            rule = "is given, but the file does not hold fractions of one"
            raise MeasurementError(raw.source, None, "full_scale", rule=rule, field="full_scale")
        if self.full_scale is not None and self.full_scale_m_s2 is not None:
            rule = "is given beside full_scale_m_s2: give one of them"
            raise MeasurementError(raw.source, None, "full_scale", self.full_scale, rule, field="full_scale")
        if self.full_scale is not None:
            value, unit = full_scale_of(self.full_scale, raw.source)
            factors = np.full(len(raw.columns), value)
        else:
            given = self.full_scale_m_s2
            factors = np.atleast_1d(np.array(given, dtype=np.float64))
            unit = "m/s2"
            if len(factors) not in (1, len(raw.columns)):
                rule = f"{len(factors)} values for {len(raw.columns)} channels"
                raise MeasurementError(raw.source, None, "full_scale_m_s2", rule=rule, field="profile")
            factors = np.broadcast_to(factors, len(raw.columns))
        columns = tuple(dataclasses.replace(column, unit=unit) for column in raw.columns)
        fact = f"full scale {', '.join(f'{factor:.6g}' for factor in np.unique(factors))} {unit}, as the profile says"
        return dataclasses.replace(
            raw, columns=columns, values=raw.values * factors, relative=False, facts=(*raw.facts, fact)
        )

    def _form(self, raw: RawRecording) -> SpectrumForm | None:
        said = self.spectrum
        if said is None:
            return raw.form
        if not is_spectrum(raw, self.units):
            first = next(iter(said.model_dump(exclude_none=True)), "profile")
            rule = "is said of a spectrum, but the file holds a recording over time"
            raise MeasurementError(raw.source, None, f"spectrum.{first}", rule=rule, field=first)
        form = raw.form or SpectrumForm()
        widths = None if said.window is None else WINDOWS[said.window]
        for field, ours, files in (
            ("scaling", said.scaling, form.scaling),
            ("detector", said.detector, form.detector),
            ("window", widths, form.line_widths),
        ):
            if ours is not None and files is not None and ours != files:
                rule = f"the profile says {ours}, the file {files}"
                raise MeasurementError(raw.source, None, f"spectrum.{field}", rule=rule, field=field)
        return SpectrumForm(
            scaling=said.scaling or form.scaling,
            detector=said.detector or form.detector,
            decibel=form.decibel if said.decibel is None else said.decibel,
            reference=said.reference or form.reference,
            line_widths=widths or form.line_widths,
        )


def full_scale_of(text: str, source: str) -> tuple[float, str]:
    """Number and unit of "5 g".

    Raises
    ------
    MeasurementError
    """
    number, _, unit = text.strip().partition(" ")
    try:
        value = float(number)
    except ValueError:
        value = float("nan")
    parsed = parse_unit(unit)
    motion = parsed is not None and parsed.quantity not in ("time", "frequency")
    if not (np.isfinite(value) and value > 0) or not (motion or is_voltage(unit)):
        rule = 'must be a number and a unit, such as "5 g"'
        raise MeasurementError(source, None, "full_scale", text, rule, field="full_scale")
    return value, unit.strip()


def parse_profile(text: str, source: str) -> ImportProfile:
    """Profile of a YAML or JSON text.

    Raises
    ------
    MeasurementError
        Naming the path, the value and the rule.
    """
    try:
        return ImportProfile.model_validate(read_tree(text, source))
    except MachineError as error:
        raise MeasurementError(source, None, error.path or None, error.value, error.rule) from None
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(map(str, first["loc"]))
        shown = None if first["type"] == "missing" else str(first["input"])[:80]
        raise MeasurementError(source, None, path or None, shown, rule_of(first)) from None


def rule_of(error: Mapping[str, Any]) -> str:
    """Return the rule that a member of a profile breaks, as pydantic has it or as we do."""
    return str(error["msg"]).removeprefix("Value error, ") if error["type"] == "value_error" else error["msg"].lower()


def load_profile(path: str | Path) -> ImportProfile:
    """Profile of a file.

    Raises
    ------
    MeasurementError
        It cannot be read, or as :func:`parse_profile`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise MeasurementError(str(path), rule=f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise MeasurementError(str(path), rule="is not a text file in UTF-8") from None
    return parse_profile(text, str(path))


def profile_beside(source: str | Path | bytes) -> ImportProfile:
    """Profile that lies beside a recording, an empty one without: its name (less .gz) and .json, .yaml or .yml."""
    if isinstance(source, bytes):
        return ImportProfile()
    path = Path(source)
    name = path.name.removesuffix(".gz")
    found = next((path.with_name(name + each) for each in BESIDE if path.with_name(name + each).is_file()), None)
    return ImportProfile() if found is None else load_profile(found)
