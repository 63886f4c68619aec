"""What the columns of a file measure."""

from __future__ import annotations

from collections.abc import Mapping

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import ChannelUnit, is_voltage, parse_unit
from jointplay.catalogue.measurements.readers.raw import RawColumn, RawRecording

TIME_NAMES = frozenset({"time", "t", "zeit", "temps", "tempo", "tiempo", "tijd", "tid", "czas"})
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
    understood = [_unit_of(column, given, raw.source) for column in raw.columns]
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
    axis = column.name.lower() in TIME_NAMES | FREQUENCY_NAMES
    return given.get(column.name) or column.unit or (None if axis else given.get(ALL_OTHERS))


def _unit_of(column: RawColumn, given: Mapping[str, str], source: str) -> ChannelUnit | None:
    text = find_unit(column, given)
    if text is None:
        rule = "has no unit: write it in the header, as in 's1-x [m/s2]', or give it"
        raise MeasurementError(source, None, column.name, rule=rule, field="units")
    unit = parse_unit(text)
    if text != column.unit and unit is None:
        rule = "is not a unit of displacement, velocity, acceleration or time"
        raise MeasurementError(source, None, column.name, text, rule, field="units")
    named_time = column.name.lower() in TIME_NAMES
    if named_time and (unit is None or unit.quantity != "time"):
        raise MeasurementError(source, None, column.name, text, "is not a unit of time", field="units")
    return None if unit is not None and unit.quantity == "frequency" else unit
