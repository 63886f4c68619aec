"""Play of joints as new: a range of radial clearance (of guides: half the play), or a clearance fit of ISO 286.

Source: ISO 286-1:2010, table 1 (standard tolerances IT5 to IT11) and tables 2 and 4 (fundamental deviations; those of
the shafts d to h are those of the holes D to H with the opposite sign), up to 500 mm. Whole micrometres, as there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import MISSING, Marker, QuantityField, RuleError, VectorField, nearest

_STEPS = (3, 6, 10, 18, 30, 50, 80, 120, 180, 250, 315, 400, 500)
"""Nominal sizes, mm: over the one before, up to and including this one."""

_TOLERANCES = {
    5: (4, 5, 6, 8, 9, 11, 13, 15, 18, 20, 23, 25, 27),
    6: (6, 8, 9, 11, 13, 16, 19, 22, 25, 29, 32, 36, 40),
    7: (10, 12, 15, 18, 21, 25, 30, 35, 40, 46, 52, 57, 63),
    8: (14, 18, 22, 27, 33, 39, 46, 54, 63, 72, 81, 89, 97),
    9: (25, 30, 36, 43, 52, 62, 74, 87, 100, 115, 130, 140, 155),
    10: (40, 48, 58, 70, 84, 100, 120, 140, 160, 185, 210, 230, 250),
    11: (60, 75, 90, 110, 130, 160, 190, 220, 250, 290, 320, 360, 400),
}
"""Width of the tolerance, um, by grade."""

_DEVIATIONS = {
    "d": (20, 30, 40, 50, 65, 80, 100, 120, 145, 170, 190, 210, 230),
    "e": (14, 20, 25, 32, 40, 50, 60, 72, 85, 100, 110, 125, 135),
    "f": (6, 10, 13, 16, 20, 25, 30, 36, 43, 50, 56, 62, 68),
    "g": (2, 4, 5, 6, 7, 9, 10, 12, 14, 15, 17, 18, 20),
    "h": (0,) * len(_STEPS),
}
"""How far the nearer limit is from the nominal size, um: a shaft is smaller by this, a hole larger."""

_LOOSER = ("a", "b", "c", "cd", "ef", "fg")
_TIGHTER = ("j", "js", "k", "m", "n", "p", "r", "s", "t", "u", "v", "x", "y", "z", "za", "zb", "zc")
"""Letters of the standard that are not in the tables above."""

_CLASS = re.compile(r"\s*([A-Za-z]{1,2})(\d{1,2})\s*/\s*([A-Za-z]{1,2})(\d{1,2})\s*")
_INSTEAD = "give the range [low, high] of radial clearance"


@dataclass(frozen=True)
class ToleranceClass:
    """A letter, large for a hole and small for a shaft, and a grade: ``H7``, ``g6``."""

    letter: str
    grade: int

    def __str__(self) -> str:
        """As it is written on drawings."""
        return f"{self.letter}{self.grade}"

    def deviations(self, diameter: float) -> tuple[int, int]:
        """Lower and upper limit deviation from the nominal size, um.

        Parameters
        ----------
        diameter : float
            Nominal size, m.

        Raises
        ------
        RuleError
            The tables do not hold this size.
        """
        step = _step(diameter)
        near, width = _DEVIATIONS[self.letter.lower()][step], _TOLERANCES[self.grade][step]
        return (near, near + width) if self.letter.isupper() else (-near - width, -near)


@dataclass(frozen=True)
class FitClass:
    """A clearance fit: a hole and a shaft of the same nominal size, ``H7/g6``."""

    hole: ToleranceClass
    shaft: ToleranceClass

    @classmethod
    def parse(cls, text: str) -> FitClass:
        """Read ``H7/g6``.

        Raises
        ------
        RuleError
            It is no fit class, no clearance fit, or not in the tables.
        """
        match = _CLASS.fullmatch(text)
        if match is None:
            raise RuleError('is no fit class of ISO 286; write hole/shaft, as in "H7/g6"')
        hole, hole_grade, shaft, shaft_grade = match.groups()
        if not hole.isupper() or not shaft.islower():
            raise RuleError('must have the hole first, in capitals, then the shaft, in small letters, as in "H7/g6"')
        _check_letters(hole, shaft)
        for grade in (int(hole_grade), int(shaft_grade)):
            if grade not in _TOLERANCES:
                raise RuleError(f"grade {grade} is not known here, only {min(_TOLERANCES)} to {max(_TOLERANCES)}; "
                                f"{_INSTEAD}")  # fmt: skip
        return cls(ToleranceClass(hole, int(hole_grade)), ToleranceClass(shaft, int(shaft_grade)))

    def __str__(self) -> str:
        """As it is written on drawings."""
        return f"{self.hole}/{self.shaft}"

    def clearance(self, diameter: float) -> tuple[int, int]:
        """Least and greatest clearance on the diameter, um.

        Parameters
        ----------
        diameter : float
            Nominal size, m.

        Raises
        ------
        RuleError
            The tables do not hold this size.
        """
        (hole_low, hole_high), (shaft_low, shaft_high) = self.hole.deviations(diameter), self.shaft.deviations(diameter)
        return hole_low - shaft_high, hole_high - shaft_low


def _check_letters(hole: str, shaft: str) -> None:
    for letter in (hole, shaft):
        if letter.lower() not in (*_DEVIATIONS, *_LOOSER, *_TIGHTER):
            raise RuleError(f"{letter} is no letter of ISO 286")
    tight = [letter.lower() in _TIGHTER for letter in (hole, shaft)]
    # Beyond h (H) pins reach above (holes below) the nominal size: with H (h) or one of their kind they can touch.
    if all(tight) or (tight[0] and shaft == "h") or (tight[1] and hole == "H"):
        raise RuleError("is no clearance fit: the pin can be larger than its hole, and the joint would not turn")
    for letter, first, last in ((hole, "D", "H"), (shaft, "d", "h")):
        if letter.lower() not in _DEVIATIONS:
            raise RuleError(f"{letter} is not known here, only {first} to {last}; {_INSTEAD}")


def _step(diameter: float) -> int:
    """Row of the tables for a nominal size in m."""
    size = round(diameter * 1e3, 9)  # 18 mm is in the row up to 18, however it was rounded on its way to metres
    for step, largest in enumerate(_STEPS):
        if 0.0 < size <= largest:
            return step
    raise RuleError(f"ISO 286 is known here for pins of up to {_STEPS[-1]} mm, this one has {size:g} mm; {_INSTEAD}")


DEFAULT_PLAY = (3e-6, 20e-6)
"""Radial clearance as new of a joint that gives none, m: about H7/g6 on pins of 18 to 30 mm (3.5 to 20.5 um)."""

LIMIT_FACTOR = 10.0
"""A joint that gives no limit counts as worn out from this many times its largest play as new."""

LEAST_PART = 0.1
"""Part of the largest play that stands for a least play of 0.

Draws are log-uniform, which needs more than 0. Where hole and pin come from anywhere within equal tolerances (H/h), two
joints of a hundred have less than a tenth of the largest play, so little is cut off; one fixed small length would make
half of the draws of a coarse fit smaller than what that fit gives but for two joints of a hundred.
"""

_LARGEST_PLAY = 0.01  # m, radial: a bare number in micrometres or millimetres is beyond it
_BOTH_ENDS = VectorField((QuantityField(units.LENGTH, at_least=0),) * 2)
_DIAMETER = QuantityField(units.LENGTH, above=0)
_KEYS = ("class", "diameter")


@dataclass(frozen=True)
class Fit:
    """Radial clearance of a joint as new.

    Attributes
    ----------
    low, high : float
        m, 0 < low < high.
    text : str
        Where it comes from: ``default``, ``given``, ``H7/g6 at 16 mm``.
    """

    low: float
    high: float
    text: str

    def __str__(self) -> str:
        """In words: ``3 to 17.5 um (H7/g6 at 16 mm)``."""
        return f"{self.low * 1e6:.4g} to {in_um(self.high)} ({self.text})"


@dataclass(frozen=True)
class ClassFit:
    """A fit class as a file says it, with the diameter [m] that it is for; None: that of the joint's pin."""

    fit_class: FitClass
    diameter: float | None = None

    def plain(self) -> str | dict[str, object]:
        """As it stands in a file."""
        text = str(self.fit_class)
        return text if self.diameter is None else {"class": text, "diameter": self.diameter}


FitSaid: TypeAlias = tuple[float, float] | ClassFit
"""What a file says of a joint's fit: a range of radial clearance [m], or a class."""


def in_um(length: float) -> str:
    """A length as it is shown: ``17.5 um``."""
    return f"{length * 1e6:.4g} um"


def new_fit(said: FitSaid | None, size: float, needs: str) -> Fit:
    """What a joint's fit amounts to.

    Parameters
    ----------
    said : FitSaid or None
        What the file says; None for nothing.
    size : float
        m, nominal: the pin's diameter, or of a guide from wall to wall; 0 where the file gives none.
    needs : str
        What a class needs and how the file gives it.

    Raises
    ------
    RuleError
        A class for a size that is not known, or not in the tables of ISO 286.
    """
    if said is None:
        return Fit(*DEFAULT_PLAY, "default")
    if not isinstance(said, ClassFit):
        return Fit(said[0] or LEAST_PART * said[1], said[1], "given")
    diameter = said.diameter or size
    if not diameter:
        raise RuleError(f"needs {needs}, or {{class: {said.fit_class}, diameter: 16 mm}}")
    least, greatest = said.fit_class.clearance(diameter)
    high = greatest / 2e6
    return Fit(least / 2e6 or LEAST_PART * high, high, f"{said.fit_class} at {diameter * 1e3:.6g} mm")


class FitMarker(Marker):
    """The field ``fit`` of a joint."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self.validate, serialization=core_schema.plain_serializer_function_ser_schema(_plain)
        )

    def validate(self, value: Any) -> FitSaid:
        """Return what is said or raise :class:`RuleError`."""
        if isinstance(value, ClassFit):
            return value
        if isinstance(value, str) and value.strip()[:1].isalpha():
            return ClassFit(FitClass.parse(value))
        if isinstance(value, Mapping):
            return _class_of(value)
        if isinstance(value, (list, tuple)):
            return _range_of(value)
        raise RuleError('must be a range [low, high] of radial clearance or a class of ISO 286, as in "H7/g6"')

    def json_schema(self) -> dict[str, Any]:
        """Describe it: a range, a class, or a class with its diameter."""
        name = {"type": "string", "pattern": r"^\s*[A-Z]{1,2}\d{1,2}\s*/\s*[a-z]{1,2}\d{1,2}\s*$"}
        by_class = {
            "type": "object",
            "properties": {"class": name, "diameter": _DIAMETER.json_schema()},
            "required": ["class"],
            "additionalProperties": False,
        }
        about = "radial clearance as new: a range [low, high], or a clearance fit of ISO 286 on the pin's diameter"
        examples = [["3 um", "12 um"], "H7/g6", {"class": "H7/g6", "diameter": "16 mm"}]
        return {"anyOf": [_BOTH_ENDS.json_schema(), name, by_class], "description": about, "examples": examples}


def _plain(said: object) -> object:
    return said.plain() if isinstance(said, ClassFit) else said


def _range_of(value: list[Any] | tuple[Any, ...]) -> tuple[float, float]:
    low, high = _BOTH_ENDS.validate(value)
    if high > _LARGEST_PLAY:
        rule = f"must not be greater than {_LARGEST_PLAY * 1e3:g} mm; a number without a unit is in m"
        raise RuleError(rule, (1,), value[1])
    if not low < high:
        raise RuleError("must be greater than the lower end", (1,), value[1])
    return low, high


def _class_of(value: Mapping[str, Any]) -> ClassFit:
    for key in value:
        if key not in _KEYS:
            raise RuleError(f"unknown key{nearest(str(key), _KEYS)}", (key,), value[key])
    name = value.get("class", MISSING)
    if not isinstance(name, str):
        missing = name is MISSING
        raise RuleError("is missing" if missing else 'must be a class of ISO 286, as in "H7/g6"', ("class",), name)
    try:
        fit_class = FitClass.parse(name)
    except RuleError as error:
        raise RuleError(error.message(), ("class",), name) from None
    if value.get("diameter") is None:
        return ClassFit(fit_class)
    given = value["diameter"]
    try:
        diameter = _DIAMETER.validate(given)
        fit_class.clearance(diameter)
    except RuleError as error:
        raise RuleError(error.message(), ("diameter",), given) from None
    return ClassFit(fit_class, diameter)
