"""Tolerance classes and clearance fits of ISO 286 for pins and holes up to 500 mm.

Source: ISO 286-1:2010, table 1 (standard tolerances IT5 to IT11) and tables 2 and 4 (fundamental deviations; those of
the shafts d to h are those of the holes D to H with the opposite sign). Whole micrometres, as there.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from jointplay.solver.machines.fields import RuleError

__all__ = ["FitClass", "ToleranceClass"]

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
