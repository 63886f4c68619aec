"""A recording that can be trusted: evenly sampled, in SI, every column named, and a list of what was understood."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import ChannelUnit
from jointplay.catalogue.measurements.import_profile import ImportProfile, profile_beside
from jointplay.catalogue.measurements.measured_columns import EPOCH_FROM, EPOCH_TO, is_counter, understood_columns
from jointplay.catalogue.measurements.missing_cells import fill_cells
from jointplay.catalogue.measurements.moments import place_moment, spell
from jointplay.catalogue.measurements.readers import Limits, RawColumn, RawRecording, read_raw
from jointplay.catalogue.measurements.time_base import TimeBase, TimeColumn, even_time_base
from jointplay.catalogue.measurements.waveform import ChannelFlaw, inspect_waveform
from jointplay.solver.arrays import FloatArray
from jointplay.solver.spectra.spectrum import Quantity


def file_bytes(path: Path, limits: Limits) -> bytes:
    """Bytes of a file, at most one more than the limit.

    Raises
    ------
    MeasurementError
        It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(limits.file_bytes + 1)
    except OSError as error:
        raise MeasurementError(str(path), rule=f"cannot be read: {error.strerror or error}") from None


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


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
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
    flaws : tuple of ChannelFlaw
        Clipping, dropouts and offsets that the warnings speak of.
    turns : (k,) array or None
        Ends of revolutions of the drive in samples, where a tacho says them.
    measured_at : datetime or None
        When it was made, in UTC, where its sender or the file says so.
    """

    name: str
    sample_rate: float
    signal: FloatArray
    channels: tuple[Channel, ...]
    warnings: tuple[str, ...]
    import_report: tuple[str, ...]
    sha256: str
    flaws: tuple[ChannelFlaw, ...] = ()
    turns: FloatArray | None = None
    measured_at: datetime | None = None

    @classmethod
    def from_arrays(
        cls, signal: npt.ArrayLike, sample_rate: float, channels: Sequence[str], *, unit: str = "m/s2",
        name: str = "recording", measured_at: datetime | None = None,
    ) -> Recording:  # fmt: skip
        """Make a recording of numbers that are there already.

        Parameters
        ----------
        signal : (n, c) array
        sample_rate : float
            Hz.
        channels : sequence of str, (c,)
            Their names: those of the machine's sensors, so that they need not be mapped.
        unit : str
            Of all channels: "m/s2", "g", "mm/s" ...
        name : str
            What to call it.
        measured_at : datetime, optional
            When it was made; without a zone in UTC.

        Raises
        ------
        MeasurementError
            As :func:`read_measurement`.
        """
        values = np.array(signal, np.float64)
        if values.ndim != 2 or values.shape[1] != len(channels):
            raise MeasurementError(name, rule=f"an array of shape {values.shape}: must be (samples, {len(channels)})")
        columns = tuple(RawColumn(each, each, unit, f"column {place}") for place, each in enumerate(channels, start=1))
        try:
            moment = None if measured_at is None else place_moment(measured_at, None)
        except ValueError as error:
            said = str(measured_at)
            raise MeasurementError(name, None, "measured_at", said, str(error), field="measured_at") from None
        return measurement_of(RawRecording(name, columns, values, measured_at=moment), sample_rate=sample_rate)

    def __repr__(self) -> str:
        told = f"{', '.join(self.channel_names)}, {self.duration:.4g} s at {self.sample_rate:g} Hz"
        return f"<Recording {self.name}: {told}>"

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
    profile: ImportProfile | None = None,
) -> Recording:
    """Read a recording from a file or from bytes.

    Parameters
    ----------
    source : path or bytes
        CSV, TSV or TXT, UFF 58 or 58b, WAV, MAT, TDMS, HDF5, NPZ, JSON, XLSX or Parquet,
        plain or gzipped.
    name : str, optional
        What to call it; its suffix says what kind of file it is. Needed with bytes.
    sample_rate : float, optional
        Hz, for files that neither state it nor have a time column.
    units : mapping of column name to unit, optional
        For columns whose label has none; ``*`` for all of them.
    limits : Limits, optional
        How much is read.
    profile : ImportProfile, optional
        What the file does not say; of a path, the profile that lies beside it unless one is given.

    Returns
    -------
    Recording

    Raises
    ------
    MeasurementError
        One line: file, line, column, value, rule.
    """
    limits, profile = limits or Limits(), profile or profile_beside(source)
    raw, sha256 = raw_of(source, name, limits, profile)
    rate = sample_rate or profile.sample_rate_hz
    return measurement_of(raw, sample_rate=rate, units=units, limits=limits, sha256=sha256)


def raw_of(
    source: str | Path | bytes, name: str | None, limits: Limits, profile: ImportProfile
) -> tuple[RawRecording, str]:
    """Read a file as it is, with what the profile says, and the SHA-256 of its bytes; nothing is judged yet.

    Parameters
    ----------
    source, name, limits, profile
        As for :func:`read_measurement`.

    Raises
    ------
    MeasurementError
    """
    title = name or ("recording.csv" if isinstance(source, bytes) else Path(source).name)
    data = source if isinstance(source, bytes) else file_bytes(Path(source), limits)
    if len(data) > limits.file_bytes:
        raise MeasurementError(title, rule=f"is larger than {limits.file_bytes / 1e6:g} MB, the most that is read")
    raw = profile.apply(read_raw(data, title, limits, **profile.table))
    return raw, hashlib.sha256(data).hexdigest()


def measurement_of(
    raw: RawRecording,
    *,
    sample_rate: float | None = None,
    units: Mapping[str, str] | None = None,
    limits: Limits | None = None,
    sha256: str = "",
) -> Recording:
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
    Recording

    Raises
    ------
    MeasurementError
        As :func:`read_measurement`.
    """
    limits = limits or Limits()
    finite = np.isfinite(raw.values) | (raw.absent & np.isnan(raw.values))
    if not np.all(finite):
        row, column = np.argwhere(~finite)[0]
        where, value = raw.line_of(int(row)), raw.values[row, column]
        raise MeasurementError(raw.source, where, raw.columns[column].name, value, "is not finite")
    if len(raw.values) < limits.min_samples:
        rule = f"{len(raw.values)} samples; at least {limits.min_samples} are needed"
        raise MeasurementError(raw.source, rule=rule)
    if raw.relative:
        rule = 'holds fractions of a full scale and does not say which: give full_scale, such as "5 g"'
        raise MeasurementError(raw.source, None, "full_scale", rule=rule, field="full_scale")
    understood = understood_columns(raw, dict(units or {}))
    facts = list(raw.facts)
    motions = [index for index, unit in enumerate(understood) if unit is not None and unit.quantity != "time"]
    filled = {index: fill_cells(raw.values[:, index], raw.source, raw.columns[index].name) for index in motions}
    if raw.absent:
        values = raw.values.copy()
        for index, each in filled.items():
            values[:, index] = each.signal
        raw = replace(raw, values=values)
    base = _time_base(raw, understood, sample_rate)
    facts += base.facts
    measured_at = raw.measured_at or _epoch_of(raw, understood, facts)
    warnings = [*raw.warnings, *base.warnings]
    channels, signals = [], []
    flaws: list[ChannelFlaw] = []
    for index, (column, unit) in enumerate(zip(raw.columns, understood, strict=True)):
        label = f"{column.position} {column.label!r}"
        if unit is None and is_counter(raw, index, units or {}):
            facts.append(f"{label}: counts the rows, no signal: left out")
        elif unit is None:
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
            facts += filled[index].warnings
            warnings += [*filled[index].warnings, *found.warnings]
            flaws += found.flaws
            flaws += [ChannelFlaw(column.name, "dropout", *gap) for gap in filled[index].dropouts]
            channels.append(Channel(column.name, unit.text, quantity))
            signals.append(signal)
    table = base.even(np.column_stack(signals))
    table.flags.writeable = False
    flaws = [replace(each, first=base.sample(each.first), last=base.sample(each.last)) for each in flaws]
    flaws += [ChannelFlaw(each.name, "dropout", *gap) for gap in base.gaps for each in channels]
    return Recording(
        name=raw.source,
        sample_rate=base.sample_rate,
        signal=table,
        channels=tuple(channels),
        warnings=tuple(warnings),
        import_report=tuple(facts),
        sha256=sha256 or hashlib.sha256(np.ascontiguousarray(raw.values).tobytes()).hexdigest(),
        flaws=tuple(flaws),
        turns=None if raw.turns is None else base.place(raw.turns),
        measured_at=measured_at,
    )


def _epoch_of(raw: RawRecording, units: list[ChannelUnit | None], facts: list[str]) -> datetime | None:
    """Beginning of a time column that counts from 1970; one of a recording never gets that far."""
    times = [(index, unit) for index, unit in enumerate(units) if unit is not None and unit.quantity == "time"]
    if raw.moment is not None or not times:
        return None
    (index, unit), *_ = times
    seconds = float(raw.values[0, index]) * unit.factor
    if not EPOCH_FROM <= seconds <= EPOCH_TO:
        return None
    try:
        measured_at = place_moment(datetime.fromtimestamp(seconds, UTC), None)
    except ValueError:
        return None
    facts.append(f"{raw.columns[index].position}: times count from 1970: measured at {spell(measured_at)}")
    return measured_at


def _time_base(raw: RawRecording, units: list[ChannelUnit | None], given: float | None) -> TimeBase:
    if given is not None and not (given > 0 and math.isfinite(given)):
        raise MeasurementError(
            raw.source, value=given, rule="sample rate must be positive and finite", field="sample_rate"
        )
    times = [i for i, unit in enumerate(units) if unit is not None and unit.quantity == "time"]
    if len(times) > 1:
        raise MeasurementError(raw.source, None, raw.columns[times[1]].name, rule="a second time column")
    stated = {"given": given, "stated in the file": raw.sample_rate}
    if times:
        column, unit = raw.columns[times[0]], units[times[0]]
        assert unit is not None

        def refusal(channel: str | None, row: int | None, rule: str) -> MeasurementError:
            line, value = (None, None) if row is None else (raw.line_of(row), float(raw.values[row, times[0]]))
            return MeasurementError(raw.source, line, channel or column.name, value, rule, field="sample_rate")

        motions = [index for index, each in enumerate(units) if each is not None and each.quantity != "time"]
        names = tuple(raw.columns[index].name for index in motions)
        clock = TimeColumn.of(raw.values[:, times[0]], unit.factor)
        base = even_time_base(clock, raw.values[:, motions], names, refusal, given)
        for whose, rate in stated.items():
            if rate is not None and abs(rate / base.sample_rate - 1.0) > 0.01:
                rule = f"the time column has {base.sample_rate:.6g} Hz, but the sample rate {whose} is {rate:g} Hz"
                raise MeasurementError(raw.source, None, column.name, rule=rule, field="sample_rate")
        return base
    if given is not None and raw.sample_rate is not None and abs(given / raw.sample_rate - 1.0) > 0.01:
        rule = f"the sample rate given is {given:g} Hz, the one stated in the file {raw.sample_rate:g} Hz"
        raise MeasurementError(raw.source, rule=rule, field="sample_rate")
    rate = given if given is not None else raw.sample_rate
    if rate is None:
        rule = "has no time column and states no sample rate: give the sample rate"
        raise MeasurementError(raw.source, rule=rule, field="sample_rate")
    whose = "given" if given is not None else "stated in the file"
    return TimeBase(rate, (f"{len(raw.values)} samples at {rate:g} Hz ({whose}), {len(raw.values) / rate:.4g} s",), ())
