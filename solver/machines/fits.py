"""Play of turning joints as new: a range of radial clearance, or a clearance fit of ISO 286 on the pin's diameter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import MISSING, Marker, Quantity, RuleError, Vector, nearest
from jointplay.solver.machines.iso286 import FitClass

__all__ = ["DEFAULT_PLAY", "LIMIT_FACTOR", "ClassFit", "Fit", "FitMarker", "FitSaid", "in_um", "new_fit"]

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
_BOTH_ENDS = Vector((Quantity(units.LENGTH, at_least=0),) * 2)
_DIAMETER = Quantity(units.LENGTH, above=0)
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


def new_fit(said: FitSaid | None, pin_radius: float) -> Fit:
    """What a joint's fit amounts to.

    Parameters
    ----------
    said : FitSaid or None
        What the file says; None for nothing.
    pin_radius : float
        m; 0 where the file gives none.

    Raises
    ------
    RuleError
        A class for a pin whose diameter is not known, or not in the tables of ISO 286.
    """
    if said is None:
        return Fit(*DEFAULT_PLAY, "default")
    if not isinstance(said, ClassFit):
        return Fit(said[0] or LEAST_PART * said[1], said[1], "given")
    diameter = said.diameter or 2 * pin_radius
    if not diameter:
        rule = f"needs the pin's diameter: give pin_radius, or {{class: {said.fit_class}, diameter: 16 mm}}"
        raise RuleError(rule)
    least, greatest = said.fit_class.clearance(diameter)
    high = greatest / 2e6
    return Fit(least / 2e6 or LEAST_PART * high, high, f"{said.fit_class} at {diameter * 1e3:.6g} mm")


class FitMarker(Marker):
    """The field ``fit`` of a turning joint."""

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
