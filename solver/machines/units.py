"""Numbers with units: ``"0.2 mm"``, ``"600 rpm"``, ``"4 N/mm"`` to SI, by the dimension that is expected.

Machine files and recordings have one table. ``g``, and ``mg`` and ``ug`` with it, is standard gravity (exact, 3rd CGPM,
1901) where an acceleration may stand, else the gram.

Angles count as a dimension of their own here, so that ``"30 deg"`` is refused where a length or a plain ratio belongs
and ``"10 Hz"`` is not silently taken for 10 rad/s.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

from jointplay.solver.errors import UnitError

LONGEST = 100
"""Characters of a number with its unit."""

LONGEST_UNIT = 24
"""Characters of a unit by itself."""


@dataclass(frozen=True)
class Dimension:
    """What a number measures.

    Parameters
    ----------
    name : str
        As it stands in messages: "a length".
    exponents : tuple of int
        Powers of metre, kilogram and second.
    unit : str
        The SI unit as it is written in messages.
    example : str
        A value a user could have meant.
    angles : tuple of int
        Accepted powers of the radian.
    """

    name: str
    exponents: tuple[int, int, int]
    unit: str
    example: str
    angles: tuple[int, ...] = (0,)


RATIO = Dimension("a plain number", (0, 0, 0), "1", "0.05")
LENGTH = Dimension("a length", (1, 0, 0), "m", "0.2 mm")
MASS = Dimension("a mass", (0, 1, 0), "kg", "80 g")
TIME = Dimension("a time", (0, 0, 1), "s", "20 ms")
ANGLE = Dimension("an angle", (0, 0, 0), "rad", "30 deg", (1,))
FREQUENCY = Dimension("a frequency", (0, 0, -1), "Hz", "1.5 Hz")
SPEED = Dimension("a speed", (1, 0, -1), "m/s", "10 mm/s")
ANGULAR_SPEED = Dimension("a speed of rotation", (0, 0, -1), "rad/s", "600 rpm", (1,))
ACCELERATION = Dimension("an acceleration", (1, 0, -2), "m/s2", "9.81 m/s2")
FORCE = Dimension("a force", (1, 1, -2), "N", "0.5 kN")
TORQUE = Dimension("a torque", (2, 1, -2), "N m", "5 N m")
INERTIA = Dimension("a moment of inertia", (2, 1, 0), "kg m2", "600 kg mm2")
STIFFNESS = Dimension("a stiffness", (0, 1, -2), "N/m", "4 N/mm")
DAMPING = Dimension("a damping coefficient", (0, 1, -1), "N s/m", "300 N s/m")
HYSTERESIS = Dimension("a hysteresis factor", (-1, 0, 1), "s/m", "0.3 s/m")
VISCOSITY = Dimension("a dynamic viscosity", (-1, 1, -1), "Pa s", "0.1 Pa s")
SLOPE = Dimension("a rotation by displacement", (-1, 0, 0), "1/m", "2 rad/m", (0, 1))
ROTARY_DAMPING = Dimension("a rotary damping coefficient", (2, 1, -1), "N m s/rad", "0.01 N m s/rad", (0, -1))

DIMENSIONS: tuple[Dimension, ...] = (
    LENGTH, MASS, TIME, ANGLE, FREQUENCY, SPEED, ANGULAR_SPEED, ACCELERATION, FORCE, TORQUE, INERTIA, STIFFNESS,
    DAMPING, ROTARY_DAMPING, HYSTERESIS, VISCOSITY, SLOPE, RATIO,
)  # fmt: skip
"""Every dimension a machine file knows, in the order in which a unit is named after them."""


@dataclass(frozen=True)
class _Unit:
    # The factor is exact, so that "100 kg mm2" is 1e-4 and not its neighbour: equal machines get equal keys.
    factor: Fraction
    powers: tuple[int, ...]  # metre, kilogram, second, radian; last, the power of pi in the factor

    def times(self, other: _Unit, power: int = 1) -> _Unit:
        powers = tuple(a + b * power for a, b in zip(self.powers, other.powers, strict=True))
        return _Unit(self.factor * other.factor**power, powers)


def _unit(factor: str, metre: int = 0, kilogram: int = 0, second: int = 0, radian: int = 0, pi: int = 0) -> _Unit:
    return _Unit(Fraction(factor), (metre, kilogram, second, radian, pi))


_ONE = _unit("1")
_PREFIXES = {
    "n": "1e-9",
    "u": "1e-6",
    "µ": "1e-6",  # micro sign
    "μ": "1e-6",  # Greek mu
    "m": "1e-3",
    "c": "1e-2",
    "d": "1e-1",
    "k": "1e3",
    "M": "1e6",
    "G": "1e9",
}
_PREFIXED = {
    "m": _unit("1", 1),
    "g": _unit("1e-3", 0, 1),
    "s": _unit("1", 0, 0, 1),
    "rad": _unit("1", 0, 0, 0, 1),
    "N": _unit("1", 1, 1, -2),
    "J": _unit("1", 2, 1, -2),
    "Hz": _unit("1", 0, 0, -1),
    "Pa": _unit("1", -1, 1, -2),
}
_PLAIN = {
    "1": _ONE,
    "%": _unit("0.01"),
    "micron": _unit("1e-6", 1),
    "mil": _unit("2.54e-5", 1),
    "mils": _unit("2.54e-5", 1),
    "ips": _unit("0.0254", 1, 0, -1),
    "in": _unit("0.0254", 1),
    "inch": _unit("0.0254", 1),
    "ft": _unit("0.3048", 1),
    "t": _unit("1e3", 0, 1),
    "lb": _unit("0.45359237", 0, 1),
    "lbf": _unit("4.4482216152605", 1, 1, -2),
    "kgf": _unit("9.80665", 1, 1, -2),
    "gn": _unit("9.80665", 1, 0, -2),
    "sec": _unit("1", 0, 0, 1),
    "min": _unit("60", 0, 0, 1),
    "h": _unit("3600", 0, 0, 1),
    "deg": _unit("1/180", 0, 0, 0, 1, pi=1),
    "°": _unit("1/180", 0, 0, 0, 1, pi=1),
    "rev": _unit("2", 0, 0, 0, 1, pi=1),
    "rpm": _unit("1/30", 0, 0, -1, 1, pi=1),
    "cP": _unit("1e-3", -1, 1, -1),
}
_GRAVITY = {"g": "1", "g0": "1", "mg": "1e-3", "ug": "1e-6", "µg": "1e-6", "μg": "1e-6"}
_UNITS = {
    **{p + name: _unit(scale).times(unit) for name, unit in _PREFIXED.items() for p, scale in _PREFIXES.items()},
    **_PREFIXED,
    **_PLAIN,
}

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
_TOKEN = re.compile(r"\s*(?:(?P<name>[A-Za-zµμ]+|[%°1])(?P<power>(?:\^|\*\*)?[+-]?\d(?!\d)|[²³])?|(?P<sign>[*·⋅/()]))")
_SUPERSCRIPTS = {"²": 2, "³": 3}


def to_si(value: object, dimension: Dimension) -> float:
    """Turn a number, or a string with a unit, into SI.

    Parameters
    ----------
    value : float, int or str
        A number is SI already; a string is a number followed by a unit ("0.2 mm"), or a bare number (SI).
    dimension : Dimension
        What is expected; it also decides what ``g`` means.

    Returns
    -------
    float
        The finite SI value; ``-0.0`` comes back as ``0.0``.

    Raises
    ------
    UnitError
        If the value is no number, is not finite, or has an unknown unit or one of another dimension.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise UnitError(f'must be a number in {dimension.unit} or a string with a unit ("{dimension.example}")')
    number = _from_text(value, dimension) if isinstance(value, str) else _from_number(value)
    if not math.isfinite(number):
        raise UnitError("must be finite")
    return number + 0.0


def speed_to_si(value: object, dimension: Dimension = ANGULAR_SPEED) -> float:
    """Turn a speed that somebody types into SI; one without a unit is refused, as rpm and rad/s are both usual.

    Parameters
    ----------
    value : str
        "600 rpm", "62.8 rad/s"; where a sliding drive is meant, "0.1 m/s".
    dimension : Dimension
        :data:`ANGULAR_SPEED` or :data:`SPEED`.

    Raises
    ------
    UnitError
        As :func:`to_si`, and for a bare number.
    """
    number = to_si(value, dimension)
    if isinstance(value, str) and (written := _NUMBER.fullmatch(value)) and written[2]:
        return number
    turning = dimension is ANGULAR_SPEED
    other = f"{number * math.pi / 30.0:.3g}rad/s" if turning else f"{1000.0 * number:.6g}mm/s"
    raise UnitError(f"give a unit: {number:.6g}{'rpm' if turning else 'm/s'} or {other}?")


def _from_number(value: float) -> float:
    try:
        return float(value)
    except OverflowError:  # an integer of more than 308 digits
        return math.inf


def _from_text(text: str, dimension: Dimension) -> float:
    match = _NUMBER.fullmatch(text) if len(text) <= LONGEST else None
    if match is None:
        raise UnitError(f'must be {dimension.name}: a number, or a number with a unit ("{dimension.example}")')
    number, unit_text = float(match[1]), match[2]
    if not unit_text:
        return number
    if re.match(r",\d", unit_text):
        raise UnitError("must use a point, not a comma, for decimals")
    unit = _unit_where(unit_text, (dimension,))
    if not _is_of(unit, dimension):
        found = _name_of(unit)
        is_found = f"is {found}, " if found else ""
        raise UnitError(f'"{unit_text}" {is_found}must be {dimension.name}, for example "{dimension.example}"')
    if number == 0 or math.isinf(number):  # also 1e-999999999, whose fraction would fill the memory
        return number
    try:
        return float(Fraction(match[1]) * unit.factor) * math.pi ** unit.powers[4]
    except OverflowError:
        return math.inf


def factor_of(text: str, dimensions: Sequence[Dimension]) -> tuple[Dimension, float] | None:
    """Return which of some dimensions a unit has, and how many SI units it is; None where it has none of them.

    Parameters
    ----------
    text : str
        "mm/s", "g", "m/s^2" ...
    dimensions : sequence of Dimension
    """
    if len(text) > LONGEST_UNIT:
        return None
    try:
        unit = _unit_where(text, dimensions)
        factor = float(unit.factor) * math.pi ** unit.powers[4]
    except (UnitError, OverflowError):
        return None
    found = next((dimension for dimension in dimensions if _is_of(unit, dimension)), None)
    return None if found is None or not factor > 0.0 else (found, factor)


def _unit_where(text: str, dimensions: Sequence[Dimension]) -> _Unit:
    """Read a unit where some dimensions may stand."""
    if text in _GRAVITY and ACCELERATION in dimensions:
        return _unit(_GRAVITY[text]).times(_UNITS["gn"])
    return _parse_unit(text)


def _is_of(unit: _Unit, dimension: Dimension) -> bool:
    return unit.powers[:3] == dimension.exponents and unit.powers[3] in dimension.angles


def _name_of(unit: _Unit) -> str:
    return next((dimension.name for dimension in DIMENSIONS if _is_of(unit, dimension)), "")


@lru_cache(maxsize=256)
def _parse_unit(text: str) -> _Unit:
    """Read ``N s/m``, ``kg*m^2``, ``m/s²`` or ``N/(m/s)``: factors left to right, ``/`` divides by the next one."""
    stack: list[tuple[_Unit, int]] = []
    unit, power, position = _ONE, 1, 0
    expects_factor = True
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise UnitError(f'"{text}" is not a unit')
        position = match.end()
        if match["name"]:
            unit = unit.times(_named(match["name"], text), power * _exponent(match["power"]))
            power, expects_factor = 1, False
        elif match["sign"] == "(":
            stack.append((unit, power))
            unit, power, expects_factor = _ONE, 1, True
        elif match["sign"] == ")" and stack and not expects_factor:
            outer, outer_power = stack.pop()
            unit = outer.times(unit, outer_power)
        elif match["sign"] in "*·⋅/" and not expects_factor:
            power, expects_factor = (-1 if match["sign"] == "/" else 1), True
        else:
            raise UnitError(f'"{text}" is not a unit')
    if stack or expects_factor:
        raise UnitError(f'"{text}" is not a unit')
    return unit


def _exponent(text: str | None) -> int:
    if not text:
        return 1
    return _SUPERSCRIPTS.get(text) or int(text.lstrip("^*"))


def _named(name: str, text: str) -> _Unit:
    if name in _UNITS:
        return _UNITS[name]
    folded = {known.casefold(): known for known in reversed(_UNITS) if known[0].casefold() == name[0].casefold()}
    near = difflib.get_close_matches(name.casefold(), folded, 1, 0.5)
    hint = f'; did you mean "{folded[near[0]]}"?' if near else ""
    place = "" if name == text else f' in "{text}"'
    raise UnitError(f'"{name}"{place} is not a known unit{hint}')
