"""Universal files, data set 58 as text and 58b in binary, one record a channel."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import parse_unit
from jointplay.catalogue.measurements.readers.moments import RawMoment
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording, SpectrumForm
from jointplay.solver.machines import universal
from jointplay.solver.machines.universal import Function, find_sets, read_functions

_QUANTITIES = {
    universal.DISPLACEMENT: "displacement", universal.VELOCITY: "velocity", universal.ACCELERATION: "acceleration",
}  # fmt: skip
#: Record 6: kind of function. General and time response are recordings; the others are spectra of one kind each.
_TIME, _SPECTRA = (0, 1), {2: "power", 9: "psd", 12: "amplitude"}
#: "channel 3 of 4", in a record's lines of text.
_OF = re.compile(r"\b(\d{1,4})\s+of\s+(\d{1,4})\b", re.IGNORECASE)
_DATE = re.compile(r"\s*(\d{1,2}-[a-z]{3}-)(\d{4}|\d\d)(?!\d)\s*(.*)", re.IGNORECASE)
#: Function numbers up to here are taken for numbers of records.
_HIGHEST = 256
_UNKNOWN = frozenset({"", "unknown"})


def read_uff(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read all records 58 of a universal file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""

    def wrong(line: int, value: object, rule: str) -> MeasurementError:
        return MeasurementError(source, line, value=value, rule=rule)

    sets = find_sets(data, wrong)
    others = [each for each in sets if each.kind not in ("58", "58b")]
    facts = [f"data set {each.kind}, line {each.line}: not used" for each in others]
    if not (wanted := len(sets) - len(others)):
        raise MeasurementError(source, rule="holds no data set 58")
    if wanted > limits.columns:
        raise MeasurementError(source, rule=f"{wanted} records; at most {limits.columns} are read")
    records = list(read_functions(sets, wrong))
    for each in records:
        if each.values.dtype.kind == "c":
            raise wrong(each.line, None, "a record of complex numbers: neither a recording nor a spectrum of power")
    facts.append(f"records by name: {', '.join(record.texts[0] for record in records)[:400]}")
    missing = missing_records(records)
    if not missing:
        facts.append("the file does not say how many records there should be: one that ends between two looks whole")
    first = records[0]
    for place, record in enumerate(records[1:], start=2):
        for mine, other, what in (
            (len(record.values), len(first.values), "samples"),
            (record.step, first.step, "step"),
            (record.kind, first.kind, "kind of function"),
        ):
            if not np.isclose(mine, other, rtol=1e-6, atol=0.0):
                rule = f"{what} {mine:g}, but {other:g} in record 1"
                raise MeasurementError(source, None, f"record {place}", rule=rule)
    names = _names([record.texts[0] for record in records], facts)
    columns = [
        RawColumn(record.texts[0], name, _unit(record, place, source), f"record {place}")
        for place, (record, name) in enumerate(zip(records, names, strict=True), start=1)
    ]
    values = [record.values.real for record in records]
    form, rate = None, None
    kind = first.kind
    if kind in _TIME and first.abscissa.kind in (0, universal.TIME):
        if first.is_even:
            rate = _rate(first.step, source)
            facts.append(f"records state an interval of {first.step:g} s")
        else:
            values.insert(0, first.x)
            # Times are in seconds in all systems of units.
            columns.insert(0, RawColumn("time", "time", "s", "abscissa"))
    elif kind in _SPECTRA and first.abscissa.kind in (0, universal.FREQUENCY):
        form = SpectrumForm(scaling=_SPECTRA[kind])  # type: ignore[arg-type]
        values.insert(0, first.x)
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
        declared=len(first.values),
        form=form,
        moment=_moment(first.texts[2]),
    )


def _moment(text: str) -> RawMoment | None:
    """Moment of the third line of text, DD-MMM-YY HH:MM:SS, whose years of two digits begin with 1970."""
    date = _DATE.match(text)
    if date is None:
        return None
    century = "" if len(date[2]) == 4 else "19" if date[2] >= "70" else "20"
    return RawMoment(f"{date[1]}{century}{date[2]} {date[3]}", "third line of record 1")


def missing_records(records: Sequence[Function]) -> tuple[str, ...]:
    """Warnings of records that those that are there speak of, or number; they may have been left out on purpose."""
    texts = [" ".join(record.texts) for record in records]
    counted = [_OF.search(text) for text in texts]
    totals = {int(found[2]) for found in counted if found}
    if all(counted) and len(totals) == 1 and len(records) < (total := totals.pop()):
        cut = "the file was perhaps cut between two of them"
        return (f"the records say that they are {total}, {len(records)} are there: {cut}",)
    numbers = [record.number for record in records]
    if min(numbers) < 1 or len(set(numbers)) < len(numbers) or max(numbers) > _HIGHEST:
        return ()  # not numbered
    gaps = sorted(set(range(1, max(numbers))) - set(numbers))
    if not gaps:
        return ()
    shown = ", ".join(map(str, gaps[:8])) + (" ..." if len(gaps) > 8 else "")
    return (f"{len(records)} records, but by their function numbers {shown} of {max(numbers)} are not in the file",)


def _unit(record: Function, place: int, source: str) -> str | None:
    """Unit as the record names it; one that contradicts the record's quantity is refused."""
    text = record.ordinate.unit
    if text.lower() in _UNKNOWN:
        return None
    quantity, unit = _QUANTITIES.get(record.ordinate.kind), parse_unit(text)
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
    if step <= 0:
        raise MeasurementError(source, None, "abscissa increment", step, "must be greater than 0")
    rate = 1.0 / step
    return float(round(rate)) if round(rate) and abs(rate - round(rate)) < 1e-5 * rate else rate
