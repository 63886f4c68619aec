"""Kinds of fields in a machine file: numbers with units, points, directions, tables, names.

Each is a marker for ``typing.Annotated`` that pydantic asks how to validate and how to describe itself in JSON Schema.
A value is refused with a :class:`RuleError`, which can point at a place below the field (row 2, column 0).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from jointplay.solver.errors import UnitError
from jointplay.solver.machines import units
from jointplay.solver.machines.units import Dimension

MISSING = object()
"""Stands for a value that is not there, so that a message shows none."""

#: Largest radial clearance that is believed without a unit, m.
LARGEST_BARE_CLEARANCE = 0.02


class RuleError(PydanticCustomError):
    """A broken rule, at ``at`` below the field that is being validated."""

    def __new__(cls, rule: str, at: tuple[int | str, ...] = (), value: object = MISSING) -> RuleError:
        """Make it; `value` is what stands at `at`."""
        # The rule is passed as context: pydantic would take braces in it for placeholders.
        return super().__new__(cls, "rule", "{rule}", {"rule": rule, "at": at, "value": value})


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a phrase that names the nearest of `known`, or lists a few of them: ``; did you mean "mass"?``."""
    known = list(known)
    folded = {other.casefold(): other for other in known}
    near = difflib.get_close_matches(name.casefold(), folded, 1, 0.5)
    if near:
        return f'; did you mean "{folded[near[0]]}"?'
    return f"; known: {', '.join(known[:12])}{', ...' if len(known) > 12 else ''}" if known else ""


class Marker:
    """Glue between a kind of field, its own ``validate`` and ``json_schema``, and pydantic."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return self.json_schema()

    def validate(self, value: Any) -> Any:
        """Return what `value` stands for or raise :class:`RuleError`."""
        raise RuleError("cannot be given")

    def json_schema(self) -> dict[str, Any]:
        """Describe what may be given."""
        return {}


@dataclass(frozen=True)
class QuantityField(Marker):
    """A number of one dimension, with bounds in SI.

    Parameters
    ----------
    dimension : Dimension
        What it measures; strings with units are read accordingly.
    above, at_least : float or None
        Exclusive and inclusive lower bound.
    at_most : float or None
        Inclusive upper bound.
    """

    dimension: Dimension
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def validate(self, value: Any) -> float:
        """Return the SI number or raise :class:`RuleError`."""
        try:
            number = units.to_si(value, self.dimension)
        except UnitError as error:
            raise RuleError(str(error)) from None
        if self.above is not None and not number > self.above:
            raise RuleError(f"must be greater than {self.above:g}")
        if self.at_least is not None and not number >= self.at_least:
            raise RuleError(f"must not be less than {self.at_least:g}")
        if self.at_most is not None and not number <= self.at_most:
            raise RuleError(f"must not be greater than {self.at_most:g}")
        return number

    def json_schema(self) -> dict[str, Any]:
        """Describe it: a number in SI, or a string with a unit."""
        number: dict[str, Any] = {"type": "number"}
        if self.above is not None:
            number["exclusiveMinimum"] = self.above
        if self.at_least is not None:
            number["minimum"] = self.at_least
        if self.at_most is not None:
            number["maximum"] = self.at_most
        text = {"type": "string", "pattern": r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"}
        about = f"{self.dimension.name} in {self.dimension.unit}, or a string with a unit"
        return {"anyOf": [number, text], "description": about, "examples": [self.dimension.example]}


@dataclass(frozen=True)
class ClearanceField(QuantityField):
    """A radial clearance; a bare number is metres, and refused where it can only be forgotten millimetres."""

    dimension: Dimension = units.LENGTH

    def validate(self, value: Any) -> float:
        """Return it in m or raise :class:`RuleError`."""
        number = super().validate(value)
        if number > LARGEST_BARE_CLEARANCE and str(value).replace(".", "").isdigit():
            raise RuleError(f"is {number * 1e3:g} mm without a unit; write {value}mm if that is meant, or the unit")
        return number


@dataclass(frozen=True)
class VectorField(Marker):
    """A fixed number of components, each with its own kind."""

    columns: tuple[QuantityField, ...]

    def validate(self, value: Any) -> tuple[float, ...]:
        """Return the components in SI or raise :class:`RuleError`."""
        return _row(value, self.columns, ())

    def json_schema(self) -> dict[str, Any]:
        """Describe it as an array of fixed length."""
        return _row_schema(self.columns)


@dataclass(frozen=True)
class UnitVector(Marker):
    """Two components that are not both zero; comes out with length 1."""

    def validate(self, value: Any) -> tuple[float, float]:
        """Return the unit vector or raise :class:`RuleError`."""
        x, y = _row(value, (QuantityField(units.RATIO),) * 2, ())
        largest = max(abs(x), abs(y))
        if largest == 0:
            raise RuleError("must not be the zero vector")
        if x == 0 or y == 0:
            return x / largest, y / largest  # exactly along an axis
        if abs(math.hypot(x, y) - 1) < 4e-16:
            return x, y  # of length 1 to rounding: reading what was written changes nothing
        length = math.hypot(x / largest, y / largest)  # scaled first, so that no component over- or underflows
        # What is too small to be a number beside the other is 0, never -0: that would be written as another content.
        return x / largest / length + 0.0, y / largest / length + 0.0

    def json_schema(self) -> dict[str, Any]:
        """Describe it as an array of two numbers."""
        return _row_schema((QuantityField(units.RATIO),) * 2)


@dataclass(frozen=True)
class Table(Marker):
    """Rows of numbers, the first column strictly increasing.

    Parameters
    ----------
    columns : tuple of Dimension
        One a column.
    period : float or None
        The first column must span less than this (the table repeats).
    """

    columns: tuple[Dimension, ...]
    period: float | None = None

    def validate(self, value: Any) -> tuple[tuple[float, ...], ...]:
        """Return the rows in SI or raise :class:`RuleError` that points at the row."""
        if not isinstance(value, (list, tuple)) or not value:
            raise RuleError(f"must be a list of rows [{', '.join(d.unit for d in self.columns)}]")
        kinds = tuple(QuantityField(dimension) for dimension in self.columns)
        rows = tuple(_row(row, kinds, (index,)) for index, row in enumerate(value))
        for index in range(1, len(rows)):
            if not rows[index][0] > rows[index - 1][0]:
                raise RuleError(f"must be greater than in the row before ({rows[index - 1][0]:g})", (index, 0))
        if self.period is not None and not rows[-1][0] - rows[0][0] < self.period * (1 - 1e-9):
            raise RuleError(
                "must be less than one turn after the first row: the table repeats by itself", (len(rows) - 1, 0)
            )
        return rows

    def json_schema(self) -> dict[str, Any]:
        """Describe it as an array of rows."""
        rows = _row_schema(tuple(QuantityField(dimension) for dimension in self.columns))
        return {"type": "array", "minItems": 1, "items": rows}


@dataclass(frozen=True)
class NumberOrTable(Marker):
    """One number for all time, or a table of it."""

    number: QuantityField
    table: Table

    def validate(self, value: Any) -> float | tuple[tuple[float, ...], ...]:
        """Return the number or the rows or raise :class:`RuleError`."""
        return self.table.validate(value) if isinstance(value, (list, tuple)) else self.number.validate(value)

    def json_schema(self) -> dict[str, Any]:
        """Describe it as either."""
        return {"anyOf": [self.number.json_schema(), self.table.json_schema()]}


@dataclass(frozen=True)
class Text(Marker):
    """One line of text that matches a pattern; whole numbers are taken for their digits."""

    pattern: str
    rule: str

    def validate(self, value: Any) -> str:
        """Return the text or raise :class:`RuleError`."""
        if isinstance(value, int) and not isinstance(value, bool):
            value = str(value)
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            raise RuleError(self.rule)
        return value

    def json_schema(self) -> dict[str, Any]:
        """Describe it as a string or a whole number."""
        return {"type": ["string", "integer"], "pattern": f"^{self.pattern}$"}


def _row(value: Any, columns: tuple[QuantityField, ...], at: tuple[int | str, ...]) -> tuple[float, ...]:
    if not isinstance(value, (list, tuple)) or len(value) != len(columns):
        shown = value if at else MISSING
        raise RuleError(f"must be a list of {len(columns)} numbers", at, shown)
    numbers = []
    for index, (item, column) in enumerate(zip(value, columns, strict=True)):
        try:
            numbers.append(column.validate(item))
        except RuleError as error:
            raise RuleError(error.message(), (*at, index), item) from None
    return tuple(numbers)


def _row_schema(columns: tuple[QuantityField, ...]) -> dict[str, Any]:
    items = [column.json_schema() for column in columns]
    return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}


def no_default(schema: dict[str, Any]) -> None:
    """Leave a default out of JSON Schema: the empty text stands for "follows from the rest"."""
    schema.pop("default")


Name = Annotated[str, Text(r"\w(?:[\w +-]{0,62}[\w+-])?", "a name must be letters, digits, spaces, -, + or _")]
"""Name of a link, a joint or a sensor: it stands in dotted paths and in ``A=0.2mm,F=50um``."""

Title = Annotated[str, Text(r"[^\x00-\x1f\x7f]{1,200}", "must be one line of text")]

Point = Annotated[tuple[float, float], VectorField((QuantityField(units.LENGTH),) * 2)]
Direction = Annotated[tuple[float, float], UnitVector()]
