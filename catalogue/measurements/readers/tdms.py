"""TDMS files, as LabVIEW writes them: groups of channels with properties."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.moments import RawMoment, find_in_members
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording

_START = "wf_start_time"
#: Where these files begin to count: a start there was never set.
_UNSET = "1904-01-01T00:00:00"


def read_tdms(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the waveform channels of a TDMS file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    check_segments(data, source)
    import nptdms

    with nptdms.TdmsFile.open(io.BytesIO(data)) as file:
        groups = [group.name for group in file.groups()]
        channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
        facts = [f"TDMS, groups {', '.join(groups) or 'none'}"]
        moment, dated = find_in_members({name: _dated(value) for name, value in file.properties.items()})
        facts += [
            f"{name}: {str(value)[:80]!r}: not used" for name, value in file.properties.items() if name not in dated
        ]
        if not channels:
            raise MeasurementError(source, rule="holds no channel with samples")
        if len(channels) > limits.columns:
            raise MeasurementError(source, rule=f"{len(channels)} channels; at most {limits.columns} are read")
        lengths = {len(channel) for channel in channels}
        if len(lengths) > 1:
            shown = ", ".join(f"{channel.name} {len(channel)}" for channel in channels)
            raise MeasurementError(source, value=shown, rule="channels of different length")
        length = lengths.pop()
        if 8 * length * len(channels) > limits.decoded_bytes:
            rule = f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
            raise MeasurementError(source, rule=rule)
        several = len({channel.name for channel in channels}) < len(channels)
        columns, values, rates = [], [], {}
        for place, channel in enumerate(channels, start=1):
            name = f"{channel.group_name} {channel.name}" if several else channel.name
            array = channel[:]
            if np.asarray(array).dtype.kind not in "iuf":
                raise MeasurementError(source, None, name, str(channel.dtype), "are no numbers")
            step = channel.properties.get("wf_increment")
            if step is not None:
                rates[name] = _rate(step, name, source)
            began = _dated(channel.properties.get("wf_start_time", ""))
            if began and not began.startswith(_UNSET) and (moment is None or moment.where != _START):
                moment = RawMoment(began, _START)
            columns.append(RawColumn(name, name, _unit(channel.properties), f"channel {place}"))
            values.append(np.asarray(array, dtype=np.float64))
    distinct = set(rates.values())
    if len(distinct) > 1:
        shown = ", ".join(f"{name} {rate:g} Hz" for name, rate in rates.items())
        raise MeasurementError(source, value=shown, rule="channels of different sample rate")
    rate = distinct.pop() if distinct else None
    table = np.column_stack(values)
    return RawRecording(source, tuple(columns), table, rate, tuple(facts), declared=length, moment=moment)


def _dated(value: Any) -> str:
    """Text of a property; times in these files are of UTC."""
    return f"{value}Z" if isinstance(value, np.datetime64) else str(value)


def check_segments(data: bytes, source: str) -> None:
    """Refuse a file that ends within a segment; the library reads what is left in silence.

    Raises
    ------
    MeasurementError
    """
    place, number = 0, 0
    while place < len(data):
        number += 1
        if len(data) - place < 28 or data[place : place + 4] != b"TDSm":
            raise MeasurementError(source, rule=f"is truncated or damaged: segment {number} has no head")
        following, _ = struct.unpack_from("<QQ", data, place + 12)
        # All ones: the writer was cut off before it closed the segment.
        if following == 0xFFFFFFFFFFFFFFFF or place + 28 + following > len(data):
            raise MeasurementError(source, rule=f"is truncated: segment {number} has no end")
        place += 28 + following


def _unit(properties: Any) -> str | None:
    text = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "").strip()
    return text or None


def _rate(step: Any, name: str, source: str) -> float:
    try:
        value = float(step)
    except (TypeError, ValueError):
        value = float("nan")
    if not (np.isfinite(value) and value > 0):
        raise MeasurementError(source, None, name, step, "wf_increment must be positive and finite")
    rate = 1.0 / value
    return float(round(rate)) if round(rate) and abs(rate - round(rate)) < 1e-5 * rate else rate
