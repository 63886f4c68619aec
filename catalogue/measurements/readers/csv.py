"""Tables of numbers as text: CSV and its relatives, as loggers and spreadsheets write them.

Delimiter, decimal sign and encoding are found out; what was found is reported. The numbers are read by numpy's C
parser; only when that fails is the file read again line by line, to name what is wrong and where.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import UNIT_WORDS, parse_unit, split_label, time_unit_in
from jointplay.catalogue.measurements.readers.dialect import (
    Dialect,
    TableLayout,
    dialects_of,
    find_layout,
    header_fields,
    header_line,
    is_comment,
)
from jointplay.catalogue.measurements.readers.moments import RawMoment, find_in_lines
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording
from jointplay.catalogue.measurements.readers.rows import read_rows, without_footer
from jointplay.catalogue.measurements.readers.stamps import replace_stamps

#: What `jointplay simulate` calls a sensor.
SENSOR = "sensor_"
#: Columns of a header that rows leave out.
COMMENTS = frozenset({"comment", "comments", "kommentar", "remark", "remarks", "bemerkung", "note", "notes"})
#: Lines, and characters, looked at for the header and the dialect.
HEAD_LINES, HEAD_LENGTH = 400, 262_144

_RATE = re.compile(r"sampl\w*[ _-]*(rate|freq)|abtast(rate|freq)|\bfs\b|scan[ _-]*rate", re.IGNORECASE)
_INTERVAL = re.compile(
    r"sampl\w*[ _-]*(interval|period|time)|abtast(intervall|periode|zeit)|time[ _-]*step|\bdt\b|delta[ _-]*t\b",
    re.IGNORECASE,
)
_VALUE = re.compile(r"(?<![\w.,])(\d+(?:[.,]\d+)*(?:[eE][+-]?\d+)?)\W{0,3}([A-Za-zµμ/]*)")


def read_csv(
    data: bytes,
    source: str,
    limits: Limits,
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    skipped: int = 0,
    names: Sequence[str] | None = None,
    ignored: Collection[str] = (),
) -> RawRecording:
    """Read a table of numbers.

    Parameters
    ----------
    data : bytes
        The file, decompressed.
    source : str
        What messages call it.
    limits : Limits
    delimiter, decimal : str, optional
        Found out unless given.
    skipped : int
        First lines that are not looked at.
    names : sequence of str, optional
        Of all columns: the file needs no header then.
    ignored : collection of str
        Names of columns that may hold whatever they like.

    Returns
    -------
    RawRecording

    Raises
    ------
    MeasurementError
        Naming file, line and column: no table, no header, a cell that is no finite number and does not say that it has
        none, rows of different length.
    """
    text, encoding = _decode(data, source)
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    head = _head(text)
    stamps = replace_stamps(text, head)
    if stamps is not None:
        text = stamps.text
        head = _head(text)
    layout = find_layout(head, dialects_of(delimiter, decimal), skipped, lambda label: split_label(label)[0] in ignored)
    if layout is None:
        raise _no_table(head, source)
    if layout.columns > limits.columns:
        rule = f"{layout.columns} columns; at most {limits.columns} are read"
        raise MeasurementError(source, layout.first + 1, rule=rule)
    looked_at = ["\n"] * min(skipped, len(head)) + head[skipped:]
    if names is not None and header_line(looked_at, layout) is None:
        labels = [(name, *split_label(name)) for name in names]
        columns = tuple(RawColumn(*label, f"column {number}") for number, label in enumerate(labels, start=1))
        header: set[int] = set()
        if len(columns) != layout.columns:
            rule = f"the profile names {len(columns)} channels, the file has {layout.columns}"
            raise MeasurementError(source, layout.first + 1, rule=rule)
    else:
        columns, header = _columns(looked_at, layout, source)
    facts = [f"text in {encoding}, {layout.dialect.words}"]
    surplus = [] if not header else _surplus(looked_at[max(header)], layout)
    facts += [f"columns without a cell: {', '.join(surplus)}"] if surplus else []
    rate, rate_facts, used = _read_rate(looked_at[: layout.first], layout.dialect, source)
    facts += rate_facts
    above = [(number, line) for number, line in enumerate(looked_at[: layout.first]) if number not in header]
    # A time of day goes with a date above the table.
    clock = [] if stamps is None or stamps.dated else [(layout.first, f"time: {stamps.first}")]
    moment, dated = find_in_lines([*above, *clock])
    if stamps is not None:
        place = len(layout.dialect.split(f"{stamps.before}0")) - 1
        columns = (*columns[:place], replace(columns[place], unit="s"), *columns[place + 1 :])
        moment = moment or (RawMoment(stamps.first, columns[place].position) if stamps.dated else None)
        said = "dates and times" if stamps.dated else "times of day"
        facts.append(f"{columns[place].position} {columns[place].label!r}: {said}; seconds since the first")
    columns = tuple(replace(column, is_text=place in layout.texts) for place, column in enumerate(columns))
    texts = [column for column in columns if column.is_text]
    if all(column.is_text for column in columns if time_unit_in(column.name) is not None):
        for column in texts:
            if time_unit_in(column.name) is not None and column.name not in ignored:
                rule = "is no time that is known, such as 14:05:06.0002: leave it out by ignore in a profile"
                shown = layout.dialect.split(head[layout.first])[columns.index(column)]
                raise MeasurementError(source, layout.first + 1, column.name, shown, rule, field="profile")
    facts += [f"{column.position} {column.label!r}: text, no signal: left out" for column in texts]
    facts += [
        f"line {number + 1}: {' '.join(line.split())[:80]!r}: not used"
        for number, line in above
        if line.strip() and number not in used | dated
    ]
    text, after = without_footer(text, layout)
    facts += after
    values, lines = read_rows(text, head, layout, columns, ignored, source)
    names_there = {column.name for column in columns}
    if "frame_acceleration_x" in names_there and any(name.startswith(SENSOR) for name in names_there):
        facts.append("what was simulated: its sensors are taken")
        ours = [i for i, each in enumerate(columns) if each.name == "t" or each.name.startswith(SENSOR)]
        columns = tuple(replace(columns[index], name=columns[index].name.removeprefix(SENSOR)) for index in ours)
        values = values[:, ours]

    # What should be a signal and holds text is no remark.
    warnings = [f"column {column.label!r} left out: it holds text, no numbers" for column in texts if column.unit]
    absent = bool(np.isnan(values).any())
    return RawRecording(
        source, columns, values, rate, tuple(facts), lines, warnings=tuple(warnings), moment=moment, absent=absent
    )


def _head(text: str) -> list[str]:
    """First lines of a text, whole ones."""
    lines = text[:HEAD_LENGTH].split("\n")
    if (len(text) > HEAD_LENGTH and len(lines) > 1) or not lines[-1]:
        lines.pop()
    return [f"{line}\n" for line in lines[:HEAD_LINES]]


def _decode(data: bytes, source: str) -> tuple[str, str]:
    for mark, encoding, name in ((b"\xef\xbb\xbf", "utf-8-sig", "UTF-8"), (b"\xff\xfe", "utf-16", "UTF-16"),
                                 (b"\xfe\xff", "utf-16", "UTF-16")):  # fmt: skip
        if data.startswith(mark):
            try:
                return data.decode(encoding), f"{name} with byte order mark"
            except UnicodeDecodeError:
                raise MeasurementError(source, rule=f"says it is {name} but is not") from None
    if b"\x00" in data[:65536]:
        raise MeasurementError(source, rule="is not a text file: holds bytes of value zero")
    try:
        return data.decode("utf-8"), "UTF-8"
    except UnicodeDecodeError:
        return data.decode("latin-1"), "Latin-1"


def _no_table(head: Sequence[str], source: str) -> MeasurementError:
    lines = [line for line in head if line.strip()]
    if not lines:
        return MeasurementError(source, rule="is empty")
    for index, line in enumerate(head):
        cells = [cell for cell in re.split(r"[;\t|\s]+", line.strip()) if cell]
        if not is_comment(line) and len(cells) > 1 and sum(cell[:1].isdigit() for cell in cells) > len(cells) // 2:
            shown = " ".join(line.split())[:60]
            return MeasurementError(source, index + 1, value=shown, rule="no table of numbers begins here or elsewhere")
    return MeasurementError(source, rule=f"holds no table of numbers in its first {len(head)} lines")


def _columns(head: Sequence[str], layout: TableLayout, source: str) -> tuple[tuple[RawColumn, ...], set[int]]:
    """Columns from the header, and which lines it is."""
    index = header_line(head, layout)
    above = _line_above(head, layout.first)
    if index is None and above is not None and _surplus(head[above], layout):
        index = above
    if index is None:
        if above is not None and not is_comment(head[above]):
            count = len(header_fields(head[above], layout))
            raise MeasurementError(
                source,
                above + 1,
                rule=f"the line above the numbers has {count} fields, the numbers {layout.columns}",
                field="profile",
            )
        rule = "the numbers have no header line with names and units above them"
        raise MeasurementError(source, layout.first + 1, rule=rule, field="profile")
    labels = header_fields(head[index], layout)[: layout.columns]
    dialect = layout.dialect
    numeric = [label for label in labels if dialect.is_cell(label)]
    if 2 * len(numeric) >= len(labels) and layout.columns > 1:
        # A line of numbers with one bad cell is no header.
        position = next((i for i, label in enumerate(labels) if not dialect.is_cell(label)), 0)
        above = _line_above(head, index)
        while above is not None and any(map(dialect.is_cell, header_fields(head[above], layout))):
            above = _line_above(head, above)
        names = [] if above is None else header_fields(head[above], layout)
        name = split_label(names[position])[0] if len(names) == len(labels) else str(position + 1)
        raise MeasurementError(source, index + 1, name, labels[position] or None, dialect.rule_of(labels[position]))
    used = {index}
    named = labels[0].strip(":").lower() in UNIT_WORDS and len(labels) > 1
    if all(parse_unit(label) is not None for label in labels[named:]):
        # A line of units below a line of names.
        above = _line_above(head, index)
        names = header_fields(head[above], layout) if above is not None else []
        if above is None or len(names) != len(labels):
            raise MeasurementError(source, index + 1, rule="a line of units without a line of names above it")
        used.add(above)
        # The line of units may be called so, in a column that has none.
        pairs: list[tuple[str, str | None]] = [(names[0], None)] if named else []
        pairs += zip(names[named:], labels[named:], strict=True)
        labels = [name if unit is None else f"{name} [{unit}]" for name, unit in pairs]
    else:
        pairs = [split_label(label) for label in labels]
        of_units, units = _units_above(head, index, layout)
        if of_units is not None:
            used.add(of_units)
            pairs[1:] = [(name, own or unit) for (name, own), unit in zip(pairs[1:], units, strict=True)]
    columns = tuple(
        RawColumn(label, name, unit, f"column {number}")
        for number, (label, (name, unit)) in enumerate(zip(labels, pairs, strict=True), start=1)
    )
    for column, _ in itertools.groupby(sorted(columns, key=lambda c: c.name), key=lambda c: c.name):
        same = [c for c in columns if c.name == column]
        if len(same) > 1:
            raise MeasurementError(source, index + 1, column, rule=f"name stands over {len(same)} columns")
    return columns, used


def _units_above(head: Sequence[str], index: int, layout: TableLayout) -> tuple[int | None, list[str]]:
    """Line of units somewhere above the names, called so in its first field, and those of all columns but the first."""
    for number in range(index - 1, -1, -1):
        name, *units = layout.dialect.split(head[number])
        if name.strip(":").lower() in UNIT_WORDS and len(units) == layout.columns - 1 and all(map(parse_unit, units)):
            return number, units
    return None, []


def _surplus(header: str, layout: TableLayout) -> list[str]:
    """Labels at the end of a header that no row has a cell for: a comment, or what is left empty in every row."""
    labels = header_fields(header, layout)[layout.columns :]
    return labels if all(label.lower() in COMMENTS for label in labels) or layout.surplus >= len(labels) else []


def _line_above(head: Sequence[str], index: int) -> int | None:
    return next((i for i in range(index - 1, -1, -1) if head[i].strip()), None)


def _read_rate(block: Sequence[str], dialect: Dialect, source: str) -> tuple[float | None, list[str], set[int]]:
    """Sample rate from the lines above the table: "Abtastrate;10000;Hz", "# dt = 0.1 ms"."""
    rates: dict[int, float] = {}
    for number, line in enumerate(block):
        for pattern, inverse in ((_RATE, False), (_INTERVAL, True)):
            said = pattern.search(line)
            value = _VALUE.search(line, said.end()) if said else None
            if value is None:
                continue
            plain = _read_number(value[1], dialect)
            # A rate without a unit is in Hz wherever people write one; an interval could be anything.
            unit = parse_unit(value[2] or ("" if inverse else "Hz"))
            if plain is None or plain <= 0 or unit is None or unit.quantity != ("time" if inverse else "frequency"):
                continue
            rates[number] = 1.0 / (plain * unit.factor) if inverse else plain * unit.factor
    distinct = set(rates.values())
    if len(distinct) > 1 and max(distinct) > 1.001 * min(distinct):
        first, second = sorted(rates)[:2]
        rule = f"sample rate {rates[second]:g} Hz, but {rates[first]:g} Hz in line {first + 1}"
        raise MeasurementError(source, second + 1, rule=rule)
    facts = [f"line {number + 1}: sample rate {rate:g} Hz" for number, rate in sorted(rates.items())]
    return (next(iter(rates.values())) if rates else None), facts, set(rates)


def _read_number(text: str, dialect: Dialect) -> float | None:
    """Number of a header line, where 10,000 and 10.000 may be ten thousand or ten: the table's decimal sign decides."""
    thousands = "." if dialect.decimal == "," else ","
    return Dialect(";", ".").number(re.sub(rf"{re.escape(thousands)}(?=\d{{3}}(\D|$))", "", text).replace(",", "."))
