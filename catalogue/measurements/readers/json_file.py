"""JSON: ``{"sample_rate_hz": 10000, "channels": [{"name": "s1-x", "unit": "m/s2", "values": [...]}]}``.

A spectrum has ``frequency_hz`` instead of the sample rate; a profile says what its numbers are. ``measured_at`` says
when it was made.
"""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.moments import RawMoment
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording

_MEMBERS = ("sample_rate_hz", "channels", "time_s", "frequency_hz", "measured_at")


def read_json(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read a recording or a spectrum from JSON; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    try:
        held = json.loads(data.decode("utf-8-sig"), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise MeasurementError(source, rule=f"is not JSON: {error}") from None
    if not isinstance(held, dict) or not isinstance(held.get("channels"), list) or not held["channels"]:
        raise MeasurementError(source, None, "channels", rule="must be a list of {name, unit, values}")
    unknown = sorted(set(held) - set(_MEMBERS))
    if unknown:
        raise MeasurementError(source, None, unknown[0], rule=f"is not known; known are {', '.join(_MEMBERS)}")
    if len(held["channels"]) > limits.columns:
        raise MeasurementError(source, rule=f"{len(held['channels'])} channels; at most {limits.columns} are read")
    rate = held.get("sample_rate_hz")
    if rate is not None and (type(rate) not in (int, float) or not math.isfinite(rate) or rate <= 0):
        raise MeasurementError(source, None, "sample_rate_hz", rate, "must be a number greater than 0")
    columns: list[RawColumn] = []
    values: list[Any] = []
    for member, axis, of in (("time_s", "time", "s"), ("frequency_hz", "frequency", "Hz")):
        if member in held:
            columns.append(RawColumn(member, axis, of, member))
            values.append(_numbers(held[member], member, source))
    for place, channel in enumerate(held["channels"], start=1):
        if not isinstance(channel, dict) or not isinstance(channel.get("name"), str) or not channel["name"].strip():
            raise MeasurementError(source, None, f"channels.{place}.name", rule="must be a text")
        name, unit = channel["name"].strip(), channel.get("unit")
        if unit is not None and not isinstance(unit, str):
            raise MeasurementError(source, None, f"channels.{place}.unit", unit, "must be a text")
        columns.append(RawColumn(name, name, unit, f"channel {place}"))
        values.append(_numbers(channel.get("values"), name, source))
    lengths = {len(each) for each in values}
    if len(lengths) > 1:
        shown = ", ".join(f"{column.name} {len(each)}" for column, each in zip(columns, values, strict=True))
        raise MeasurementError(source, value=shown, rule="channels of different length")
    if len({column.name for column in columns}) < len(columns):
        raise MeasurementError(source, rule="two channels have the same name")
    said = held.get("measured_at")
    if said is not None and not isinstance(said, str):
        raise MeasurementError(source, None, "measured_at", said, "must be a text")
    return RawRecording(
        source,
        tuple(columns),
        np.column_stack(values),
        rate,
        ("JSON",),
        declared=lengths.pop(),
        moment=None if said is None else RawMoment(said, "measured_at"),
    )


def _numbers(values: Any, name: str, source: str) -> Any:
    if not isinstance(values, list) or not values:
        raise MeasurementError(source, None, name, rule="values must be a list of numbers")
    wrong = next((i for i, value in enumerate(values) if type(value) not in (int, float)), None)
    if wrong is not None:
        raise MeasurementError(source, None, name, values[wrong], f"value {wrong + 1} is not a number")
    try:
        return np.array(values, dtype=np.float64)
    except OverflowError:
        raise MeasurementError(source, None, name, rule="holds a number beyond all limits") from None


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")
