"""A recording that can be trusted: evenly sampled, in SI, every column named, and a list of what was understood."""

from __future__ import annotations

import gzip
import hashlib
import io
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from catalogue.channel_units import ChannelUnit, parse_unit
from catalogue.errors import MeasurementError
from catalogue.readers import Limits, RawColumn, RawRecording, reader_for
from catalogue.time_base import TimeBase, even_time_base
from catalogue.waveform import Flaw, inspect_waveform
from solver.spectra.spectrum import Quantity

TIME_NAMES = frozenset({"time", "t", "zeit", "temps", "tempo", "tiempo", "tijd", "tid", "czas"})
FREQUENCY_NAMES = frozenset({"frequency", "freq", "f", "frequenz", "fréquence", "frecuencia", "frequenza"})
SI_UNITS: dict[Quantity, str] = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}


@dataclass(frozen=True)
class Channel:
    """A channel of a measurement.

    Parameters
    ----------
    name : str
        Without its unit.
    unit : str
        As the file has it; the signal itself is in SI.
    quantity : {"displacement", "velocity", "acceleration"}
    """

    name: str
    unit: str
    quantity: Quantity


@dataclass(frozen=True, eq=False)
class Measurement:
    """A recording in SI units.

    Parameters
    ----------
    name : str
        File name, or what the sender called it.
    sample_rate : float
        Hz.
    signal : (n, c) array
        SI, read-only.
    channels : tuple of Channel, (c,)
    warnings : tuple of str
        What a diagnosis should mention, one line each.
    import_report : tuple of str
        Everything that was understood, one line each.
    sha256 : str
        Of the bytes as they came, hexadecimal.
    flaws : tuple of Flaw
        Clipping, dropouts and offsets that the warnings speak of.
    """

    name: str
    sample_rate: float
    signal: npt.NDArray[np.float64]
    channels: tuple[Channel, ...]
    warnings: tuple[str, ...]
    import_report: tuple[str, ...]
    sha256: str
    flaws: tuple[Flaw, ...] = ()

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self.signal) / self.sample_rate

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels, (c,)."""
        return tuple(channel.name for channel in self.channels)


def read_measurement(
    source: str | Path | bytes,
    *,
    name: str | None = None,
    sample_rate: float | None = None,
    units: Mapping[str, str] | None = None,
    limits: Limits | None = None,
) -> Measurement:
    """Read a recording from a file or from bytes.

    Parameters
    ----------
    source : path or bytes
        CSV, TSV or TXT, plain or gzipped.
    name : str, optional
        What to call it; its suffix says what kind of file it is. Needed with bytes.
    sample_rate : float, optional
        Hz, for files that neither state it nor have a time column.
    units : mapping of column name to unit, optional
        For columns whose label has none.
    limits : Limits, optional
        How much is read.

    Returns
    -------
    Measurement

    Raises
    ------
    MeasurementError
        One line: file, line, column, value, rule.
    """
    limits = limits or Limits()
    if isinstance(source, bytes):
        title = name or "recording.csv"
        data = source
    else:
        title = name or Path(source).name
        data = _read_file(Path(source), title, limits)
    reader = reader_for(title)
    if len(data) > limits.file_bytes:
        raise MeasurementError(title, rule=f"is larger than {limits.file_bytes / 1e6:g} MB, the most that is read")
    raw = reader(_decompressed(data, title, limits), title, limits)
    return measurement_of(
        raw, sample_rate=sample_rate, units=units, limits=limits, sha256=hashlib.sha256(data).hexdigest()
    )


def measurement_of(
    raw: RawRecording,
    *,
    sample_rate: float | None = None,
    units: Mapping[str, str] | None = None,
    limits: Limits | None = None,
    sha256: str = "",
) -> Measurement:
    """Judge what a reader (or a caller with arrays) has: units, time base, waveforms.

    Parameters
    ----------
    raw : RawRecording
    sample_rate, units, limits
        As for :func:`read_measurement`.
    sha256 : str
        Of the bytes the recording came from; of its numbers when empty.

    Returns
    -------
    Measurement

    Raises
    ------
    MeasurementError
        As :func:`read_measurement`.
    """
    limits = limits or Limits()
    if not np.all(np.isfinite(raw.values)):
        row, column = np.argwhere(~np.isfinite(raw.values))[0]
        where, value = raw.line_of(int(row)), raw.values[row, column]
        raise MeasurementError(raw.source, where, raw.columns[column].name, value, "is not finite")
    if len(raw.values) < limits.min_samples:
        rule = f"{len(raw.values)} samples; at least {limits.min_samples} are needed"
        raise MeasurementError(raw.source, rule=rule)
    understood = _understood_columns(raw, dict(units or {}))
    facts = list(raw.facts)
    base = _time_base(raw, understood, sample_rate)
    facts += base.facts
    warnings = list(base.warnings)
    channels, signals = [], []
    flaws: list[Flaw] = []
    for index, (column, unit) in enumerate(zip(raw.columns, understood, strict=True)):
        label = f"{column.position} {column.label!r}"
        if unit is None:
            facts.append(f"{label}: left out")
            warnings.append(
                f"column {column.label!r} left out: its unit is not one of displacement, velocity or acceleration"
            )
        elif unit.quantity == "time":
            facts.append(f"{label}: time in {unit.text}")
        else:
            quantity = cast(Quantity, unit.quantity)
            signal = raw.values[:, index] * unit.factor
            found = inspect_waveform(signal, raw.source, column.name, SI_UNITS[quantity], base.sample_rate)
            facts.append(f"{label}: {quantity} in {unit.text} = {unit.factor:g} {SI_UNITS[quantity]}; {found.fact}")
            warnings += found.warnings
            flaws += found.flaws
            channels.append(Channel(column.name, unit.text, quantity))
            signals.append(signal)
    table = np.column_stack(signals)
    table.flags.writeable = False
    return Measurement(
        name=raw.source,
        sample_rate=base.sample_rate,
        signal=table,
        channels=tuple(channels),
        warnings=tuple(warnings),
        import_report=tuple(facts),
        sha256=sha256 or hashlib.sha256(np.ascontiguousarray(raw.values).tobytes()).hexdigest(),
        flaws=tuple(flaws),
    )


def _read_file(path: Path, title: str, limits: Limits) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(limits.file_bytes + 1)
    except OSError as error:
        raise MeasurementError(str(path), rule=f"cannot be read: {error.strerror or error}") from None


def _decompressed(data: bytes, title: str, limits: Limits) -> bytes:
    if not data.startswith(b"\x1f\x8b"):
        if title.lower().endswith(".gz"):
            raise MeasurementError(title, rule="is not a gzip file")
        decoded = data
    else:
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
                decoded = packed.read(limits.decoded_bytes + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise MeasurementError(title, rule=f"is a damaged gzip file: {error}") from None
    if len(decoded) > limits.decoded_bytes:
        raise MeasurementError(title, rule=f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read")
    return decoded


def _understood_columns(raw: RawRecording, given: dict[str, str]) -> list[ChannelUnit | None]:
    """Unit of each column; None for a column that is left out."""
    unknown = sorted(set(given) - {column.name for column in raw.columns})
    if unknown:
        names = ", ".join(column.name for column in raw.columns)
        raise MeasurementError(
            raw.source, None, unknown[0], rule=f"a unit is given for it, but the columns are {names}"
        )
    first = raw.columns[0]
    first_unit = parse_unit(given.get(first.name) or first.unit or "")
    if first.name.lower() in FREQUENCY_NAMES or (first_unit is not None and first_unit.quantity == "frequency"):
        raise MeasurementError(
            raw.source, None, first.label, rule="the file holds a spectrum, not a recording over time"
        )
    understood = [_unit_of(column, given, raw.source) for column in raw.columns]
    if not any(unit is not None and unit.quantity != "time" for unit in understood):
        column = raw.columns[-1]
        rule = "no column is a displacement, velocity or acceleration"
        raise MeasurementError(raw.source, None, column.name, column.unit, rule)
    return understood


def _unit_of(column: RawColumn, given: dict[str, str], source: str) -> ChannelUnit | None:
    text = given.get(column.name) or column.unit
    if text is None:
        rule = "has no unit: write it in the header, as in 's1-x [m/s2]', or give it"
        raise MeasurementError(source, None, column.name, rule=rule)
    unit = parse_unit(text)
    if column.name in given and unit is None:
        raise MeasurementError(
            source, None, column.name, text, "is not a unit of displacement, velocity, acceleration or time"
        )
    named_time = column.name.lower() in TIME_NAMES
    if named_time and (unit is None or unit.quantity != "time"):
        raise MeasurementError(source, None, column.name, text, "is not a unit of time")
    return None if unit is not None and unit.quantity == "frequency" else unit


def _time_base(raw: RawRecording, units: list[ChannelUnit | None], given: float | None) -> TimeBase:
    if given is not None and not (given > 0 and math.isfinite(given)):
        raise MeasurementError(raw.source, value=given, rule="sample rate must be positive and finite")
    times = [i for i, unit in enumerate(units) if unit is not None and unit.quantity == "time"]
    if len(times) > 1:
        raise MeasurementError(raw.source, None, raw.columns[times[1]].name, rule="a second time column")
    stated = {"given": given, "stated in the file": raw.sample_rate}
    if times:
        column, unit = raw.columns[times[0]], units[times[0]]
        assert unit is not None
        base = even_time_base(raw.values[:, times[0]], unit.factor, raw.source, column.name, raw.line_of)
        for whose, rate in stated.items():
            if rate is not None and abs(rate / base.sample_rate - 1.0) > 0.01:
                rule = f"the time column has {base.sample_rate:.6g} Hz, but the sample rate {whose} is {rate:g} Hz"
                raise MeasurementError(raw.source, None, column.name, rule=rule)
        return base
    if given is not None and raw.sample_rate is not None and abs(given / raw.sample_rate - 1.0) > 0.01:
        rule = f"the sample rate given is {given:g} Hz, the one stated in the file {raw.sample_rate:g} Hz"
        raise MeasurementError(raw.source, rule=rule)
    rate = given if given is not None else raw.sample_rate
    if rate is None:
        raise MeasurementError(raw.source, rule="has no time column and states no sample rate: give the sample rate")
    whose = "given" if given is not None else "stated in the file"
    return TimeBase(rate, (f"{len(raw.values)} samples at {rate:g} Hz ({whose}), {len(raw.values) / rate:.4g} s",), ())
