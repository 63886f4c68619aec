"""Rows of a table of text: their numbers, the cells that have none, and the lines of words that follow them."""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.decimal_table import plain_table
from jointplay.catalogue.measurements.readers.dialect import FOOTER, MISSING, TableLayout, is_comment
from jointplay.catalogue.measurements.readers.raw import RawColumn
from jointplay.solver.arrays import FloatArray

#: A comment begins, and not what spreadsheets put into cells.
_COMMENT = re.compile(r"#(?!N/?A\b|NUM!|DIV/0!|VALUE!)")


def read_rows(
    text: str,
    head: Sequence[str],
    layout: TableLayout,
    columns: Sequence[RawColumn],
    ignored: Collection[str],
    source: str,
) -> tuple[FloatArray, range | FloatArray]:
    """Numbers of a table, and the lines that they stand in.

    Parameters
    ----------
    text : str
        The file; nothing follows its table.
    head : sequence of str
        Its first lines.
    layout : TableLayout
    columns : sequence of RawColumn
    ignored : collection of str
        Names of columns that may hold whatever they like.
    source : str
        What messages call the file.

    Returns
    -------
    (n, c) array
        NaN for a cell without a number: it is empty, says so, or its column holds text or is ignored.
    range or (n,) array

    Raises
    ------
    MeasurementError
        Naming the line and the column: a cell that is not a number, rows of different length.
    """
    body = text[sum(len(line) for line in head[: layout.first]) :]
    delimiter = None if layout.dialect.delimiter == " " else layout.dialect.delimiter
    if layout.texts:
        body = "\n".join(_without_texts(line, layout) for line in body.split("\n"))
    if layout.surplus and delimiter is not None:
        body = re.sub(rf"{re.escape(delimiter)}+ *$", "", body, flags=re.MULTILINE)
    plain = body.replace(",", ".") if layout.dialect.decimal == "," else body
    quick = None if delimiter is None or len(delimiter) > 1 else plain_table(plain, delimiter, layout.columns)
    if quick is not None:
        quick[:, sorted(layout.texts)] = np.nan
        return quick, range(layout.first + 1, layout.first + 1 + len(quick))
    values = _load(plain, delimiter)
    if values is None and delimiter is not None:
        mark = re.escape(delimiter)
        missing = rf"(?<={mark})[ \r]*(?:(?:{MISSING})[ \r]*)?(?={mark}|$)"
        values = _load(re.sub(missing, "nan", plain, flags=re.MULTILINE | re.IGNORECASE), delimiter)
    if values is None or values.shape[1] != layout.columns or np.any(np.isinf(values)):
        values = _read_line_by_line(text, layout, columns, ignored, source)
    values[:, sorted(layout.texts)] = np.nan
    return values, np.array([number for number, _line in _rows(text, layout)], np.float64)


def _load(text: str, delimiter: str | None) -> FloatArray | None:
    """Numbers of a text, by numpy; None where that cannot read all of it."""
    try:
        # Of a text itself, numpy would read a copy of four bytes a character.
        lines = io.TextIOWrapper(io.BytesIO(text.encode()), encoding="utf-8")
        return np.loadtxt(lines, delimiter=delimiter, comments="#", dtype=np.float64, ndmin=2)
    except ValueError:
        return None


def without_footer(text: str, layout: TableLayout) -> tuple[str, list[str]]:
    """Return a text up to the last row of its table, and what is said of the lines of words after it.

    Parameters
    ----------
    text : str
    layout : TableLayout
    """
    end, kept = len(text), len(text)
    notes: list[str] = []
    for _ in range(FOOTER):
        begin = text.rfind("\n", 0, max(0, end - 1)) + 1
        line = text[begin:end]
        if line.strip() and not is_comment(line):
            if _begins_a_row(line, layout):
                return text[:kept], notes[::-1]
            number = text.count("\n", 0, begin) + 1
            notes.append(f"line {number}: {' '.join(line.split())[:80]!r}: after the table: not used")
            kept = begin
        end = begin
    return text, []


def _begins_a_row(line: str, layout: TableLayout) -> bool:
    fields = _fields(line, layout)
    first = next((field for place, field in enumerate(fields) if place not in layout.texts), "word")
    return any(fields) and (layout.dialect.is_cell(first) or layout.dialect.is_missing(first))


def _without_texts(line: str, layout: TableLayout) -> str:
    """Return a row with zeros in place of its texts."""
    fields = _fields(line, layout)
    if len(fields) != layout.columns:
        return line
    return layout.dialect.delimiter.join("0" if place in layout.texts else field for place, field in enumerate(fields))


def _read_line_by_line(
    text: str, layout: TableLayout, columns: Sequence[RawColumn], ignored: Collection[str], source: str
) -> FloatArray:
    numbers = array("d")
    free = [place in layout.texts or column.name in ignored for place, column in enumerate(columns)]
    for number, line in _rows(text, layout):
        fields = _fields(line, layout)
        if len(fields) != layout.columns:
            raise MeasurementError(source, number, rule=f"{len(fields)} fields, expected {layout.columns}")
        for field, column, is_free in zip(fields, columns, free, strict=True):
            value = layout.dialect.number(field)
            if value is not None and np.isfinite(value):
                numbers.append(value)
            elif is_free or layout.dialect.is_missing(field):
                numbers.append(np.nan)
            else:
                rule = f"{layout.dialect.rule_of(field)}, or leave out the column by ignore in a profile"
                raise MeasurementError(source, number, column.name, field, rule)  # the file is at fault
    return np.frombuffer(numbers, np.float64).reshape(-1, layout.columns).copy()


def _rows(text: str, layout: TableLayout) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(_lines(text), start=1):
        if number > layout.first and line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _lines(text: str) -> Iterator[str]:
    """Lines of a text one after the other, without a copy of it."""
    begin = 0
    while begin < len(text):
        end = text.find("\n", begin) + 1 or len(text)
        yield text[begin:end]
        begin = end


def _fields(line: str, layout: TableLayout) -> list[str]:
    return layout.dialect.split_row(_COMMENT.split(line, maxsplit=1)[0].strip("\r\n"), layout.columns)
