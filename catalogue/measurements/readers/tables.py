"""Tables of other programs, extra ``jointplay[tables]``: workbooks (XLSX), Parquet, and Arrow's files (Feather)."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from importlib import import_module
from typing import Any

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import split_label
from jointplay.catalogue.measurements.readers.csv import read_csv
from jointplay.catalogue.measurements.readers.moments import RawMoment, find_in_members
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording
from jointplay.solver.arrays import FloatArray

EXTRA = "pip install 'jointplay[tables]'"


def import_extra(name: str, source: str) -> Any:
    """Return a module of the extra.

    Raises
    ------
    MeasurementError
        It is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        rule = f"reading it needs {name.partition('.')[0].replace('_', '-')}, which is not installed: {EXTRA}"
        raise MeasurementError(source, rule=rule) from None


def read_xlsx(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the first sheet of a workbook that holds a table; see `readers.raw.Reader`.

    A sheet is read as the text that a spreadsheet would write of it, so all that holds of tables of text holds here.
    """
    calamine = import_extra("python_calamine", source)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            unpacked = sum(member.file_size for member in packed.infolist())
    except zipfile.BadZipFile as error:
        raise MeasurementError(source, rule=f"is a damaged workbook: {error}") from None
    if unpacked > limits.decoded_bytes:
        raise MeasurementError(source, rule=f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read")
    try:
        book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = {name: "\n".join(_lines(book.get_sheet_by_name(name))) for name in book.sheet_names}
    except calamine.CalamineError as error:
        raise MeasurementError(source, rule=f"is a damaged workbook: {error}") from None
    refusal = MeasurementError(source, rule="is empty")
    for name, text in sheets.items():
        try:
            found = read_csv(text.encode(), source, limits, delimiter="\t", decimal=".")
        except MeasurementError as error:
            refusal = refusal if text.count("\n") <= limits.min_samples else error
            continue
        told = (f"workbook, sheet {name!r}", *found.facts[1:])
        return replace(found, facts=told, lines=None)
    raise refusal


def _lines(sheet: Any) -> Iterator[str]:
    """Rows of a sheet as text."""
    for row in sheet.iter_rows():
        yield "\t".join(map(_cell, row))


def _cell(value: object) -> str:
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, datetime):
        return value.isoformat(timespec="microseconds")
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    if isinstance(value, time | date):
        return value.isoformat()
    return " ".join(str(value).split())


def read_parquet(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the numbers and times of a Parquet file; see `readers.raw.Reader`."""
    arrow, parquet = import_extra("pyarrow", source), import_extra("pyarrow.parquet", source)
    try:
        file = parquet.ParquetFile(arrow.BufferReader(data))
        _check_size(file.metadata.num_rows * file.metadata.num_columns, source, limits)
        return _recording_of(arrow, file.read(use_threads=False), "Parquet file", source)
    except (arrow.ArrowException, OSError) as error:
        raise MeasurementError(source, rule=f"is a damaged Parquet file: {error}") from None


def read_arrow(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the numbers and times of an Arrow file (Feather, version 2); see `readers.raw.Reader`."""
    arrow = import_extra("pyarrow", source)
    try:
        with arrow.ipc.open_file(arrow.BufferReader(data)) as file:
            table = arrow.Table.from_batches(
                [file.get_batch(index) for index in range(file.num_record_batches)], file.schema
            )
        _check_size(table.num_rows * table.num_columns, source, limits)
        return _recording_of(arrow, table, "Arrow file", source)
    except (arrow.ArrowException, OSError) as error:
        raise MeasurementError(source, rule=f"is a damaged Arrow file: {error}") from None


def _check_size(numbers: int, source: str, limits: Limits) -> None:
    if 8 * numbers > limits.decoded_bytes:
        raise MeasurementError(source, rule=f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read")


def _recording_of(arrow: Any, table: Any, kind: str, source: str) -> RawRecording:
    """Return the columns of a table that are numbers, times or durations."""
    columns: list[RawColumn] = []
    values: list[FloatArray] = []
    facts = [kind]
    moment, _ = find_in_members(_texts(table.schema.metadata))
    for place, field in enumerate(table.schema, start=1):
        name, unit = split_label(field.name)
        position, held = f"column {place}", table.column(place - 1)
        unit = unit or _texts(field.metadata).get("unit") or _texts(field.metadata).get("units")
        if arrow.types.is_timestamp(field.type) or arrow.types.is_duration(field.type):
            is_moment = arrow.types.is_timestamp(field.type)
            counts = held.cast(arrow.int64()).to_numpy()
            factor = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[field.type.unit]
            if is_moment and len(counts) and moment is None:
                first = datetime(1970, 1, 1) + timedelta(microseconds=int(counts[0]) * round(factor * 1e9) / 1e3)
                moment = RawMoment(f"{first.isoformat()}{'Z' if field.type.tz else ''}", position)
            numbers, unit = (counts - counts[:1]) * factor, "s"
            facts.append(
                f"{position} {field.name!r}: {'dates and times; ' if is_moment else ''}seconds since the first"
            )
        elif arrow.types.is_floating(field.type) or arrow.types.is_integer(field.type):
            numbers = held.to_numpy()
        elif arrow.types.is_decimal(field.type):
            numbers = held.cast(arrow.float64()).to_numpy()
        else:
            facts.append(f"{position} {field.name!r}: {field.type}: not used")
            continue
        columns.append(RawColumn(field.name, name, unit, position))
        values.append(np.asarray(numbers, dtype=np.float64))
    if not columns:
        raise MeasurementError(source, rule="holds no column of numbers")
    numbers = np.column_stack(values)
    absent = bool(np.isnan(numbers).any())
    return RawRecording(
        source, tuple(columns), numbers, None, tuple(facts), declared=table.num_rows, moment=moment, absent=absent
    )


def _texts(metadata: Any) -> dict[str, str]:
    """Members of a table's or a column's metadata, which are bytes."""
    return {key.decode("utf-8", "replace"): value.decode("utf-8", "replace") for key, value in (metadata or {}).items()}
