"""What the columns of a file measure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import (
    ChannelUnit,
    is_counter_name,
    is_voltage,
    parse_unit,
    time_unit_in,
)
from jointplay.catalogue.measurements.missing_cells import refuse_missing
from jointplay.catalogue.measurements.readers.raw import RawColumn, RawRecording

#: Seconds since 1970 of 2001 to 2096: a time column that begins there is not one of seconds since a start.
EPOCH_FROM, EPOCH_TO = 1e9, 4e9
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Sample rates [Hz], and the shortest recording [s] but for times in seconds, by which units of times are told.
USUAL_RATES, SHORTEST = (20.0, 250e3), 0.1
#: Stands for all columns that name no unit, and are neither time nor frequency.
ALL_OTHERS = "*"
FREQUENCY_NAMES = frozenset({"frequency", "freq", "f", "frequenz", "fréquence", "frecuencia", "frequenza"})


def is_spectrum(raw: RawRecording, given: Mapping[str, str] | None = None) -> bool:
    """Whether a file holds a spectrum: its first column is a frequency, by its name or by its unit."""
    first = raw.columns[0]
    unit = parse_unit((given or {}).get(first.name) or first.unit or "")
    return first.name.lower() in FREQUENCY_NAMES or (unit is not None and unit.quantity == "frequency")


def understood_columns(raw: RawRecording, given: Mapping[str, str]) -> list[ChannelUnit | None]:
    """Unit of each column of a recording over time.

    Parameters
    ----------
    raw : RawRecording
    given : mapping of column to unit
        In place of what the file says; ``*`` for columns of which it says nothing.

    Returns
    -------
    list of ChannelUnit or None
        None for a column that is left out.

    Raises
    ------
    MeasurementError
        A column without a unit, none that is a motion, or a spectrum.
    """
    check_given(raw, given)
    if is_spectrum(raw, given):
        rule = "the file holds a spectrum, not a recording over time"
        raise MeasurementError(raw.source, None, raw.columns[0].label, rule=rule)
    for index, column in enumerate(raw.columns):
        unit = parse_unit(find_unit(column, given) or "")
        if time_unit_in(column.name) is not None or (unit is not None and unit.quantity == "time"):
            refuse_missing(raw, index, "take the row out, or leave out the column by ignore in a profile")
    understood = [_unit_of(column, given, raw, index) for index, column in enumerate(raw.columns)]
    if not any(unit is not None and unit.quantity != "time" for unit in understood):
        column = raw.columns[-1]
        rule = "no column is a displacement, velocity or acceleration"
        volts = any(is_voltage(each.unit) for each in raw.columns)
        if volts:
            rule += ': say what a volt stands for by the sensor\'s sensitivity, such as "100 mV/g"'
        field = "sensitivity" if volts else "units"
        raise MeasurementError(raw.source, None, column.name, column.unit, rule, field=field)
    return understood


def check_given(raw: RawRecording, given: Mapping[str, str]) -> None:
    """Refuse units for columns that are not there.

    Raises
    ------
    MeasurementError
    """
    unknown = sorted(set(given) - {column.name for column in raw.columns} - {ALL_OTHERS})
    if unknown:
        rule = f"a unit is given for it, but the columns are {', '.join(column.name for column in raw.columns)}"
        raise MeasurementError(raw.source, None, unknown[0], rule=rule, field="units")


def find_unit(column: RawColumn, given: Mapping[str, str]) -> str | None:
    """Unit of a column as somebody gives it, as the file has it, or as it is given for all others."""
    axis = time_unit_in(column.name) is not None or column.name.lower() in FREQUENCY_NAMES
    return given.get(column.name) or column.unit or (None if axis else given.get(ALL_OTHERS))


def _unit_of(column: RawColumn, given: Mapping[str, str], raw: RawRecording, index: int) -> ChannelUnit | None:
    text, source, own = find_unit(column, given), raw.source, time_unit_in(column.name)
    if text is None and own is not None:
        text = own or _time_unit(raw, index)
    if own is None and is_counter(raw, index, given):
        return None
    if text is None:
        rule = f"has no unit: write it in the header, as in '{column.name} [m/s2]', or give it: {column.name}=g;"
        rule += " if it is no signal, leave it out by ignore in a profile"
        raise MeasurementError(source, None, column.name, rule=rule, field="units")
    unit = parse_unit(text)
    if own is None and text != column.unit and unit is None:
        rule = "is not a unit of displacement, velocity, acceleration or time"
        raise MeasurementError(source, None, column.name, text, rule, field="units")
    if own is not None and (unit is None or unit.quantity != "time"):
        raise MeasurementError(source, None, column.name, text, "is not a unit of time", field="units")
    return None if unit is not None and unit.quantity == "frequency" else unit


def is_counter(raw: RawRecording, index: int, given: Mapping[str, str]) -> bool:
    """Whether a column counts the rows: it is called so, nobody names its unit, and it goes up by one."""
    column = raw.columns[index]
    if column.unit is not None or column.name in given or not is_counter_name(column.name):
        return False
    return bool(np.all(np.diff(raw.values[:, index]) == 1.0))


def _time_unit(raw: RawRecording, index: int) -> str:
    """Unit of times that name none: of times since 1970, else seconds where these alone give a usual recording."""
    times = raw.values[:, index]
    step, length = float(np.median(np.diff(times))), float(times[-1] - times[0])
    usual = []
    for unit, factor in TIME_UNITS.items():
        rate, seconds = 1.0 / max(step * factor, 1e-30), length * factor
        if USUAL_RATES[0] <= rate <= USUAL_RATES[1]:
            if EPOCH_FROM <= times[0] * factor <= EPOCH_TO:
                return unit
            if unit == "s" or seconds >= SHORTEST:
                usual.append(unit)
    if usual == ["s"]:
        return "s"
    name = raw.columns[index].name
    rule = f"has no unit, and {' as well as '.join(usual)} would do" if usual else "has no unit, and none is plain"
    rule += f": write it in the header, as in '{name} [s]', or give it: {name}={(usual or ['s'])[-1]}"
    raise MeasurementError(raw.source, None, name, rule=rule, field="units")
