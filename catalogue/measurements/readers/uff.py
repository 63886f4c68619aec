"""Universal files, data set 58 as text and 58b in binary, one record a channel.

The library reads a file without its end as an empty one. The records are therefore counted here first, and what it
returns is compared with what they declare.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import parse_unit
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording, SpectrumForm

#: Data set 58, record 8: what the numbers of a channel measure.
_QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration"}
#: Record 6: kind of function. General and time response are recordings; the others are spectra of one kind each.
_TIME, _SPECTRA = (0, 1), {2: "power", 9: "psd", 12: "amplitude"}
_ABSCISSA_TIME, _ABSCISSA_FREQUENCY = 17, 18
#: "channel 3 of 4", in a record's lines of text.
_OF = re.compile(r"\b(\d{1,4})\s+of\s+(\d{1,4})\b", re.IGNORECASE)
#: Function numbers up to here are taken for numbers of records.
_HIGHEST = 256
_UNKNOWN = frozenset({"", "none", "unknown"})


@dataclass(frozen=True)
class DataSet:
    """A data set of a file: its number as written, and the line it begins in."""

    kind: str
    line: int


def read_uff(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read all records 58 of a universal file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    blocks = blocks_of(data, source)
    wanted = [index for index, block in enumerate(blocks) if block.kind in ("58", "58b")]
    facts = [
        f"data set {block.kind}, line {block.line}: not used" for block in blocks if block.kind not in ("58", "58b")
    ]
    if not wanted:
        raise MeasurementError(source, rule="holds no data set 58")
    if len(wanted) > limits.columns:
        raise MeasurementError(source, rule=f"{len(wanted)} records; at most {limits.columns} are read")
    import pyuff

    with tempfile.NamedTemporaryFile(suffix=".uff") as file:
        file.write(data)
        file.flush()
        opened = pyuff.UFF(file.name)
        found = list(opened.get_set_types())
        if len(found) != len(blocks):
            raise MeasurementError(source, rule=f"{len(blocks)} data sets are in it, {len(found)} can be read")
        records = [_record(opened, index, source, blocks[index].line) for index in wanted]
    facts.append(f"records by name: {', '.join(str(record['id1']).strip() for record in records)[:400]}")
    missing = missing_records(records)
    if not missing:
        facts.append("the file does not say how many records there should be: one that ends between two looks whole")
    first = records[0]
    for place, record in enumerate(records[1:], start=2):
        for field, what in (("num_pts", "samples"), ("abscissa_inc", "step"), ("func_type", "kind of function")):
            if not np.isclose(record[field], first[field], rtol=1e-6, atol=0.0):
                rule = f"{what} {record[field]:g}, but {first[field]:g} in record 1"
                raise MeasurementError(source, None, f"record {place}", rule=rule)
    names = _names([str(record["id1"]).strip() for record in records], facts)
    columns = [
        RawColumn(str(record["id1"]).strip(), name, _unit(record, place, source), f"record {place}")
        for place, (record, name) in enumerate(zip(records, names, strict=True), start=1)
    ]
    values = [np.asarray(record["data"], dtype=np.float64) for record in records]
    form, rate = None, None
    kind = int(first["func_type"])
    if kind in _TIME and int(first["abscissa_spec_data_type"]) in (0, _ABSCISSA_TIME):
        if int(first["abscissa_spacing"]) == 1:
            rate = _rate(float(first["abscissa_inc"]), source)
            facts.append(f"records state an interval of {float(first['abscissa_inc']):g} s")
        else:
            values.insert(0, np.asarray(first["x"], dtype=np.float64))
            columns.insert(
                0, RawColumn("time", "time", "s", "abscissa")
            )  # times are in seconds in all systems of units
    elif kind in _SPECTRA and int(first["abscissa_spec_data_type"]) in (0, _ABSCISSA_FREQUENCY):
        form = SpectrumForm(scaling=_SPECTRA[kind])  # type: ignore[arg-type]
        values.insert(0, np.asarray(first["x"], dtype=np.float64))
        columns.insert(0, RawColumn("frequency", "frequency", "Hz", "abscissa"))
    else:
        rule = "is neither a recording over time nor a spectrum"
        raise MeasurementError(source, None, "record 1", f"function type {kind}", rule)
    return RawRecording(
        source,
        tuple(columns),
        np.column_stack(values),
        rate,
        (f"universal file, {len(records)} records 58", *facts),
        warnings=missing,
        declared=int(first["num_pts"]),
        form=form,
    )


def missing_records(records: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """Warnings of records that the ones that are there speak of, or number; somebody may have left them out on purpose.

    Parameters
    ----------
    records : sequence of dict
        As the library gives them: ``id1`` to ``id5`` are lines of text, ``func_id`` is a number.
    """
    texts = [" ".join(str(record.get(f"id{line}", "")) for line in range(1, 6)) for record in records]
    counted = [_OF.search(text) for text in texts]
    totals = {int(found[2]) for found in counted if found}
    if all(counted) and len(totals) == 1 and len(records) < (total := totals.pop()):
        cut = "the file was perhaps cut between two of them"
        return (f"the records say that they are {total}, {len(records)} are there: {cut}",)
    numbers = [int(record.get("func_id") or 0) for record in records]
    if min(numbers) < 1 or len(set(numbers)) < len(numbers) or max(numbers) > _HIGHEST:
        return ()  # not numbered
    gaps = sorted(set(range(1, max(numbers))) - set(numbers))
    if not gaps:
        return ()
    shown = ", ".join(map(str, gaps[:8])) + (" ..." if len(gaps) > 8 else "")
    return (f"{len(records)} records, but by their function numbers {shown} of {max(numbers)} are not in the file",)


def blocks_of(data: bytes, source: str) -> list[DataSet]:
    """Data sets of a universal file; a last one without its closing -1 makes the file a truncated one.

    Raises
    ------
    MeasurementError
        The file ends in the middle of a data set, or is no universal file.
    """
    found: list[DataSet] = []
    place, line = 0, 0

    def next_line() -> bytes | None:
        nonlocal place, line
        if place >= len(data):
            return None
        end = data.find(b"\n", place)
        end = len(data) if end < 0 else end
        text = data[place:end].rstrip(b"\r")
        place, line = end + 1, line + 1
        return text

    while (text := next_line()) is not None:
        if not text.strip():
            continue
        if text.strip() == b"-" and place >= len(data):
            raise MeasurementError(source, line, rule="is truncated: it ends where a data set begins")
        if text.strip() != b"-1":
            raise MeasurementError(
                source, line, value=text[:40].decode("latin-1"), rule="a data set must begin with -1"
            )
        head = next_line()
        words = (head or b"").decode("latin-1").split()
        if not words:
            raise MeasurementError(source, line, rule="is truncated: it ends where a data set begins")
        found.append(DataSet(words[0].lower(), line))
        if words[0].lower() == "58b":
            if len(words) < 5 or not (words[3].isdigit() and words[4].isdigit()):
                raise MeasurementError(
                    source, line, value=" ".join(words)[:60], rule="a binary record without its size"
                )
            for _ in range(int(words[3])):
                if next_line() is None:
                    break
            place += int(words[4])
            if place > len(data):
                raise _cut(source, len(found), found[-1].line)
            if data[place : place + 1] in (b"\n", b"\r"):
                next_line()
        # Writers are known to declare half of the bytes; the end stands right behind the last of them.
        while (text := next_line()) is not None and not text.endswith(b"    -1") and text.strip() != b"-1":
            pass
        if text is None:
            raise _cut(source, len(found), found[-1].line)
    return found


def _cut(source: str, number: int, line: int) -> MeasurementError:
    return MeasurementError(source, line, rule=f"is truncated: data set {number}, which begins here, has no end")


def _record(opened: Any, index: int, source: str, line: int) -> dict[str, Any]:
    record: dict[str, Any] = opened.read_sets(index)
    data, declared = np.asarray(record["data"]), int(record["num_pts"])
    if data.ndim != 1 or len(data) != declared:
        rule = f"is truncated: it declares {declared} samples, {data.size} are there"
        raise MeasurementError(source, line, rule=rule)
    if data.dtype.kind == "c":
        raise MeasurementError(
            source, line, rule="a record of complex numbers: neither a recording nor a spectrum of power"
        )
    return record


def _unit(record: dict[str, Any], place: int, source: str) -> str | None:
    """Unit as the record names it; one that contradicts the record's quantity is refused."""
    text = str(record["ordinate_axis_units_lab"]).strip()
    if text.lower() in _UNKNOWN:
        return None
    quantity, unit = _QUANTITIES.get(int(record["ordinate_spec_data_type"])), parse_unit(text)
    if quantity is not None and unit is not None and unit.quantity != quantity:
        rule = f"is a unit of {unit.quantity}, but the record says it is {quantity}"
        raise MeasurementError(source, None, f"record {place}", text, rule)
    return text


def _names(names: Sequence[str], facts: list[str]) -> list[str]:
    """Names of the records without the words that all of them begin with: "shaper s1-x", "shaper s1-y"."""
    words = [name.split() for name in names]
    common = 0
    while (
        len(words) > 1 and all(len(each) > common + 1 for each in words) and len({each[common] for each in words}) == 1
    ):
        common += 1
    if common:
        facts.append(f"records are named after their last words; all begin with {' '.join(words[0][:common])!r}")
    found = [" ".join(each[common:]) for each in words]
    return [
        name if name and found.count(name) == 1 else f"{name or 'record'} {place}"
        for place, name in enumerate(found, start=1)
    ]


def _rate(step: float, source: str) -> float:
    if not (np.isfinite(step) and step > 0):
        raise MeasurementError(source, None, "abscissa increment", step, "must be positive and finite")
    rate = 1.0 / step
    return float(round(rate)) if round(rate) and abs(rate - round(rate)) < 1e-5 * rate else rate
