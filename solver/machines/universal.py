"""Universal files: their data sets, and what sets 58 (as text), 58b (in binary) and 164 (units) hold.

The layout is that published by SDRC and the University of Cincinnati's SDRL. Numbers are told apart by the blanks
between them, not by columns: writers keep the order of the layout, not always its widths.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from jointplay.solver.arrays import FloatArray

Refusal: TypeAlias = Callable[[int, object, str], Exception]
"""Makes the error of a line, from 1, the value that stands there or None, and the rule it breaks."""

#: Data set 58, record 8 to 10: what numbers measure.
DISPLACEMENT, VELOCITY, ACCELERATION, EXCITATION, TIME, FREQUENCY = 8, 11, 12, 13, 17, 18
#: Lines before the numbers of a set 58.
_HEAD = 11
#: Widths of the fields of records 6, 7 and 8 to 11.
_DEGREES, _FORM, _AXIS = (5, 10, 5, 10, 11, 10, 4, 11, 10, 4), (10, 10, 10, 13, 13), (10, 5, 5, 5, 21, 21)
#: Record 7, field 1: bytes of a number, and numbers of an ordinate.
_ORDINATES = {2: (4, 1), 4: (8, 1), 5: (4, 2), 6: (8, 2)}


@dataclass(frozen=True)
class DataSet:
    """A data set of a file.

    Attributes
    ----------
    kind : str
        Its number as written, ``58b``.
    line : int
        That of this number.
    head : list of str
        Words of that line.
    content : bytes
        What follows, up to its end.
    """

    kind: str
    line: int
    head: list[str]
    content: bytes


@dataclass(frozen=True)
class Axis:
    """What an axis measures: the number of its kind, and its unit as written, empty where there is none."""

    kind: int
    unit: str


@dataclass(frozen=True)
class Function:
    """What a data set 58 holds.

    Attributes
    ----------
    line : int
        Where it begins.
    texts : list of str
        Its five lines of text.
    kind, number : int
        Of the function: type and identification.
    response, reference : (int, int)
        Node and direction.
    is_even : bool
        Whether the abscissa is.
    step : float
        Of an even abscissa.
    x, values : (n,) arrays
        In the units of the file; complex values where the ordinate is complex.
    abscissa, ordinate, denominator : Axis
    """

    line: int
    texts: list[str]
    kind: int
    number: int
    response: tuple[int, int]
    reference: tuple[int, int]
    is_even: bool
    step: float
    x: FloatArray
    values: npt.NDArray[np.float64] | npt.NDArray[np.complex128]
    abscissa: Axis
    ordinate: Axis
    denominator: Axis


def find_sets(data: bytes, wrong: Refusal) -> list[DataSet]:
    """Data sets of a universal file; a last one without its closing -1 makes the file a truncated one.

    Raises
    ------
    Exception
        As `wrong` makes it: the file ends in the middle of a data set, or is no universal file.
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

    def cut() -> Exception:
        return wrong(begun, None, f"is truncated: data set {len(found) + 1}, which begins here, has no end")

    while (text := next_line()) is not None:
        if not text.strip():
            continue
        if text.strip() == b"-" and place >= len(data):
            raise wrong(line, None, "is truncated: it ends where a data set begins")
        if text.strip() != b"-1":
            raise wrong(line, text[:40].decode("latin-1"), "a data set must begin with -1")
        words = (next_line() or b"").decode("latin-1").split()
        if not words:
            raise wrong(line, None, "is truncated: it ends where a data set begins")
        kind, begun, start = words[0].lower(), line, place
        binary = kind == "58b"
        if binary:
            if len(words) < 5 or not all(re.fullmatch("[0-9]{1,18}", word) for word in words[3:5]):
                raise wrong(line, " ".join(words)[:60], "a binary record without its size")
            for _ in range(int(words[3])):
                if next_line() is None:
                    break
            place += int(words[4])
            if place > len(data):
                raise cut()
            if data[place : place + 1] in (b"\n", b"\r"):
                next_line()
        # Writers are known to declare half of the bytes; the end stands right behind the last of them.
        end = place
        while (text := next_line()) is not None and text.strip() != b"-1":
            if binary and text.rstrip().endswith(b"    -1"):
                end += len(text.rstrip()) - 6
                break
            end = place
        if text is None:
            raise cut()
        found.append(DataSet(kind, begun, words, data[start:end]))
    return found


def read_functions(sets: list[DataSet], wrong: Refusal) -> Iterator[Function]:
    """What each data set 58 or 58b among `sets` holds, in turn.

    Raises
    ------
    Exception
        As `wrong` makes it: what is there is not what the layout says, or is more or less than it declares.
    """
    for each in sets:
        if each.kind in ("58", "58b"):
            yield _read_function(each, wrong)


def read_units(each: DataSet, wrong: Refusal) -> tuple[float, float]:
    """Metres and newtons to a unit of length and of force, as a data set 164 has them.

    Raises
    ------
    Exception
        As `wrong` makes it.
    """
    try:
        factors = [float(word) for word in each.content.upper().replace(b"D", b"E").split(b"\n", 1)[1].split()[:2]]
        length, force = (1.0 / factor if 0.0 < factor < np.inf else 0.0 for factor in factors)
    except (IndexError, ValueError):
        length = force = 0.0
    if not (length and force):
        raise wrong(each.line, None, "data set 164 must have factors of length and force, greater than 0")
    return length, force


def _read_function(each: DataSet, wrong: Refusal) -> Function:
    lines = each.content.split(b"\n", _HEAD)
    if len(lines) <= _HEAD:
        raise wrong(each.line, None, f"is truncated: a data set 58 has {_HEAD} lines before its numbers")
    head = [line.rstrip(b"\r").decode("latin-1") for line in lines[:_HEAD]]

    def fields(index: int, widths: tuple[int, ...]) -> list[str]:
        ends = np.cumsum(widths)
        return [head[index][end - width : end].strip() for end, width in zip(ends, widths, strict=True)]

    def number(text: str, index: int) -> float:
        try:
            found = float(text.upper().replace("D", "E") or 0)
        except ValueError:
            found = math.nan
        if not math.isfinite(found):
            raise wrong(each.line + 1 + index, text, "must be a finite number, in the columns of data set 58")
        return found

    def whole(text: str, index: int) -> int:
        found = number(text, index)
        if not found.is_integer():
            raise wrong(each.line + 1 + index, text, "must be a whole number, in the columns of data set 58")
        return int(found)

    def axis(index: int) -> Axis:
        kind, *_, unit = fields(index, _AXIS)
        return Axis(whole(kind, index), "" if unit.upper() == "NONE" else unit)

    degrees = fields(5, _DEGREES)
    kind, label, node, way, other, back = (whole(degrees[k], 5) for k in (0, 1, 5, 6, 8, 9))
    form = fields(6, _FORM)
    ordinate, count, even = (whole(text, 6) for text in form[:3])
    first, step = (number(text, 6) for text in form[3:])
    if ordinate not in _ORDINATES:
        raise wrong(each.line + 7, ordinate, f"ordinate data type must be one of {', '.join(map(str, _ORDINATES))}")
    if count < 1:
        raise wrong(each.line + 7, count, "must be a number of samples, greater than 0")
    size, parts = _ORDINATES[ordinate]
    rows = _read_rows(each, lines[_HEAD], count, size, parts, bool(even), wrong)
    with np.errstate(over="ignore"):
        x = np.asarray(first + step * np.arange(count) if even else rows[:, 0], dtype=np.float64)
    if not np.isfinite(x).all():
        raise wrong(each.line, None, "data set 58: its abscissa must be of finite numbers")
    values = rows[:, -1] if parts == 1 else rows[:, -2] + 1j * rows[:, -1]
    texts = [text.strip() for text in head[:5]]
    return Function(
        each.line, texts, kind, label, (node, way), (other, back), bool(even), step, x, values,
        axis(7), axis(8), axis(9),
    )  # fmt: skip


def _read_rows(each: DataSet, data: bytes, count: int, size: int, parts: int, even: bool, wrong: Refusal) -> FloatArray:
    """Numbers (count, columns) of a data set 58: what is missing is refused, and what is more, but for padding."""
    columns = parts if even else parts + 1
    if each.kind == "58":
        try:
            found = np.array(data.upper().replace(b"D", b"E").split(), dtype=np.float64)
        except ValueError:
            raise wrong(each.line, None, "data set 58 must hold numbers with blanks between them") from None
        spare = found[count * columns :]
        if len(spare) < 6 and not spare.any():  # a last line filled up
            found = found[: count * columns]
        there = len(found) / columns
        rows = found.reshape(-1, columns) if there == count else found[:0]
    else:
        order, coding = each.head[1:3]
        if order not in ("1", "2") or coding in ("1", "3"):
            rule = "must be of byte ordering 1 or 2 and floating point format 2 (IEEE 754)"
            raise wrong(each.line, f"{order} {coding}", rule)
        place = "<" if order == "1" else ">"
        # The layout has an uneven abscissa in single precision always; writers have it as they have ordinates.
        shape = [f"{place}f{size}"] * columns
        if not even and len(data) < size * columns * count:
            shape[0] = f"{place}f4"
        form = np.dtype([(f"{k}", part) for k, part in enumerate(shape)])
        spare_bytes = len(data) - form.itemsize * count
        there = count if 0 <= spare_bytes < 8 else len(data) / form.itemsize  # a line's end behind the numbers
        taken = np.frombuffer(data[: form.itemsize * count], form) if there == count else np.zeros(0, form)
        rows = np.column_stack([taken[name].astype(np.float64) for name in form.names or ()])
    if there != count:
        raise wrong(each.line, None, f"is truncated: it declares {count} samples, {there:g} are there")
    return rows
