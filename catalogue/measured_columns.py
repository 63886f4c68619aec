"""What the columns of a file measure."""

from __future__ import annotations

from catalogue.channel_units import ChannelUnit, parse_unit
from catalogue.errors import MeasurementError
from catalogue.readers.raw import RawColumn, RawRecording

TIME_NAMES = frozenset({"time", "t", "zeit", "temps", "tempo", "tiempo", "tijd", "tid", "czas"})
FREQUENCY_NAMES = frozenset({"frequency", "freq", "f", "frequenz", "fréquence", "frecuencia", "frequenza"})


def understood_columns(raw: RawRecording, given: dict[str, str]) -> list[ChannelUnit | None]:
    """Unit of each column of a recording over time.

    Parameters
    ----------
    raw : RawRecording
    given : mapping of column to unit
        In place of what the file says.

    Returns
    -------
    list of ChannelUnit or None
        None for a column that is left out.

    Raises
    ------
    MeasurementError
        A column without a unit, none that is a motion, or a spectrum.
    """
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
