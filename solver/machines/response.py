"""A measured frequency response of the frame, as it stands in a machine file or in a file beside it.

It says what each sensor answers to a unit force along x and y and to a unit moment, all at the frame's centre of
gravity, of the frame as it stands: on its supports, with its links. Complex numbers at increasing frequencies; between
them it is linear in the complex plane, beyond them nothing is known.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.errors import MachineError
from jointplay.solver.machines import units
from jointplay.solver.machines.fields import Marker, Name, QuantityField, RuleError
from jointplay.solver.machines.parts import Part, Sensor
from jointplay.solver.machines.tap_test import is_universal, read_tap_test
from jointplay.solver.machines.yamlfile import Tree

Quantity: TypeAlias = Literal["accelerance", "mobility", "receptance"]

#: Forces of unit size, in the order of the frame's motions.
FORCES = ("fx", "fy", "moment")
#: Times (i w) that an answer has to be taken to be an acceleration.
_ORDER: dict[Quantity, int] = {"accelerance": 0, "mobility": 1, "receptance": 2}
#: Units of a table's columns, without spaces and brackets.
_UNITS: dict[Quantity, str] = {"accelerance": "m/s2", "mobility": "m/s", "receptance": "m"}
#: Numbers of a response, so that a machine stays a text of some 100 pages.
MOST_NUMBERS = 60_000
_FREQUENCY = QuantityField(units.FREQUENCY, at_least=0)
_HEAD = re.compile(r"(?P<sensor>.+?)\s+(?P<force>fx|fy|moment)\s+(?P<part>re|im)\s*\[(?P<unit>[^]]*)\]")


@dataclass(frozen=True)
class Frequencies(Marker):
    """A list of frequencies, increasing, two at least."""

    def validate(self, value: Any) -> tuple[float, ...]:
        """Return them in Hz or raise :class:`RuleError` that points at the one that is wrong."""
        if not isinstance(value, (list, tuple)) or len(value) < 2:
            raise RuleError("must be a list of two frequencies at least")
        found = tuple(_FREQUENCY.validate(each) for each in value)
        for index, (before, after) in enumerate(pairwise(found), start=1):
            if not after > before:
                raise RuleError(f"must be greater than the one before ({before:g})", (index,), value[index])
        return found

    def json_schema(self) -> dict[str, Any]:
        """Describe it as an array."""
        return {"type": "array", "minItems": 2, "items": _FREQUENCY.json_schema()}


@dataclass(frozen=True)
class ComplexNumbers(Marker):
    """A list of complex numbers, each [real, imaginary part]."""

    def validate(self, value: Any) -> tuple[tuple[float, float], ...]:
        """Return them or raise :class:`RuleError` that points at the one that is wrong."""
        if not isinstance(value, (list, tuple)):
            raise RuleError("must be a list of complex numbers [real, imaginary]")
        for index, pair in enumerate(value):
            numbers = pair if isinstance(pair, (list, tuple)) else ()
            plain = all(isinstance(part, (int, float)) and not isinstance(part, bool) for part in numbers)
            if len(numbers) != 2 or not plain or not all(map(math.isfinite, numbers)):
                raise RuleError("must be [real, imaginary], two finite numbers", (index,), pair)
        return tuple((float(re), float(im)) for re, im in value)

    def json_schema(self) -> dict[str, Any]:
        """Describe it as an array of pairs."""
        pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        return {"type": "array", "minItems": 2, "items": pair}


Answer: TypeAlias = Annotated[tuple[tuple[float, float], ...], ComplexNumbers()]


class SensorResponse(Part):
    """What a sensor answers along its direction to a unit of each force, at every frequency."""

    fx: Answer
    fy: Answer
    moment: Answer


class FrequencyResponse(Part):
    """A measured frequency response of the frame, by sensor.

    ``quantity``: accelerance [m/s2/N, m/s2/(N m)], mobility [m/s/N ...] or receptance [m/N ...]. ``frequency`` [Hz]. In
    place of the numbers a file may give ``file``, a table or a universal file beside it.
    """

    quantity: Quantity = "accelerance"
    frequency: Annotated[tuple[float, ...], Frequencies()]
    sensors: Mapping[Name, SensorResponse]

    def accelerances(self, names: tuple[str, ...], frequency: FloatArray) -> ComplexArray:
        """Accelerations per unit of fx, fy and moment, (f, sensors, 3); 0 outside the band."""
        given = np.array([[getattr(self.sensors[name], force) for force in FORCES] for name in names])
        known = np.array(self.frequency)
        parts = np.array([np.interp(frequency, known, row, 0.0, 0.0) for row in given.reshape(-1, len(known), 2)
                          .swapaxes(1, 2).reshape(-1, len(known))])  # fmt: skip
        found = (parts[0::2] + 1j * parts[1::2]).T.reshape(len(frequency), len(names), len(FORCES))
        return np.asarray(found * (2j * np.pi * frequency[:, None, None]) ** _ORDER[self.quantity])


def read_response(path: Path, source: str) -> Tree:
    """Read a table of a frequency response: one line of heads with units, then numbers.

    Heads are ``frequency [Hz]`` and, of each sensor, ``NAME fx re [m/s2/N]``, ``NAME fx im [m/s2/N]``, and so on for
    fy and moment.

    Raises
    ------
    MachineError
        The first thing that is wrong, by line and column.
    """

    def wrong(where: str, value: object, rule: str) -> MachineError:
        return MachineError(source, f"response.file, {path.name}{where}", value, rule)

    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except OSError as error:
        raise wrong("", None, f"cannot be read: {error.strerror or error}") from None
    except (UnicodeDecodeError, csv.Error):
        raise wrong("", None, "is not a table of text in UTF-8") from None
    if len(rows) < 3:
        raise wrong("", None, "must have a line of heads and two of numbers at least")
    heads = [cell.strip() for cell in rows[0]]
    if heads[0].replace(" ", "") != "frequency[Hz]":
        raise wrong(", line 1", heads[0], "must be frequency [Hz]")
    if len(rows) * len(heads) > MOST_NUMBERS:
        raise wrong("", f"{len(rows) * len(heads)} numbers", f"must not be more than {MOST_NUMBERS}: leave lines out")
    numbers = np.empty((len(rows) - 1, len(heads)))
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(heads):
            raise wrong(f", line {line}", f"{len(row)} cells", f"must have {len(heads)}, as the heads")
        for column, cell in enumerate(row):
            try:
                numbers[line - 2, column] = float(cell)
            except ValueError:
                raise wrong(f", line {line}, {heads[column]}", cell.strip(), "must be a number") from None
    quantities: set[Quantity] = set()
    parts: dict[tuple[str, str, str], FloatArray] = {}
    for column, head in enumerate(heads[1:], start=1):
        match = _HEAD.fullmatch(head)
        quantity = match and _quantity(match["force"], match["unit"])
        if match is None or not quantity:
            raise wrong(", line 1", head, "must be like s1-x fx re [m/s2/N], of a moment [m/s2/(N m)]; or m/s, or m")
        quantities.add(quantity)
        parts[match["sensor"], match["force"], match["part"]] = numbers[:, column]
    if len(quantities) != 1:
        raise wrong(", line 1", ", ".join(sorted(quantities)), "must be one quantity in all columns")
    sensors: dict[str, object] = {}
    for name in dict.fromkeys(name for name, _, _ in parts):
        for force in FORCES:
            for part in ("re", "im"):
                if (name, force, part) not in parts:
                    raise wrong(", line 1", None, f"misses the column {name} {force} {part}")
        sensors[name] = {
            force: np.column_stack([parts[name, force, "re"], parts[name, force, "im"]]).tolist() for force in FORCES
        }
    return {"quantity": quantities.pop(), "frequency": numbers[:, 0].tolist(), "sensors": sensors}


def _quantity(force: str, unit: str) -> Quantity | None:
    """What a column with such a unit holds; None of another unit."""
    plain = re.sub(r"[\s()*]", "", unit.replace("^", ""))
    per = "/Nm" if force == "moment" else "/N"
    return next((name for name, answer in _UNITS.items() if plain == answer + per), None)


def with_response(
    tree: Tree,
    source: str,
    folder: Path | None,
    placed: Callable[[Tree], tuple[tuple[Sensor, ...], tuple[float, float]]],
) -> Tree:
    """The tree of a machine with the numbers of its response in place of the file that has them.

    Parameters
    ----------
    tree : Tree
    source : str
        Name of the machine file, for messages.
    folder : Path or None
        Where the machine file lies; None where it is no file.
    placed : callable
        Tree of a machine without a response -> its sensors, and its frame's centre of gravity.
    """
    given = tree.get("response")
    if not isinstance(given, dict) or "file" not in given:
        return tree
    name = given["file"]
    if given.keys() - {"file", "nodes"}:
        raise MachineError(source, "response", None, "give either file or the numbers")
    if folder is None:
        raise MachineError(source, "response.file", name, "cannot be found from here: give the numbers in its place")
    if not isinstance(name, str) or not name or "\0" in name:
        raise MachineError(source, "response.file", name, "must be the name of a file beside the machine file")
    path = folder / name
    if not is_universal(path):
        if "nodes" in given:
            raise MachineError(source, "response.nodes", None, f"is for universal files, and {name} is none")
        return {**tree, "response": read_response(path, source)}
    sensors, centre = placed({key: part for key, part in tree.items() if key != "response"})
    return {**tree, "response": read_tap_test(path, given.get("nodes"), sensors, centre, source)}
