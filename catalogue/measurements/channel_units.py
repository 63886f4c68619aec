"""Units of recorded channels as people write them, and column labels that carry one.

``m/s2``, ``m/s²``, ``m/s^2``, ``m s-2`` and ``m/s/s`` are one unit; ``g`` is standard gravity here, never the gram.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

#: Standard acceleration of free fall [m/s2], exact by definition (3rd CGPM, 1901).
STANDARD_GRAVITY = 9.80665

ChannelQuantity = Literal["displacement", "velocity", "acceleration", "time", "frequency"]

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254, "inch": 0.0254, "ft": 0.3048}
_TIMES = {"s": 1.0, "sec": 1.0, "sek": 1.0, "second": 1.0, "seconds": 1.0, "sekunden": 1.0,
          "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "ns": 1e-9, "min": 60.0}  # fmt: skip


def _table() -> dict[str, tuple[ChannelQuantity, float]]:
    table: dict[str, tuple[ChannelQuantity, float]] = {}
    for name, factor in _LENGTHS.items():
        table[name] = ("displacement", factor)
        table[f"{name}/s"] = table[f"{name}/sec"] = ("velocity", factor)
        table[f"{name}/s2"] = table[f"{name}/sec2"] = ("acceleration", factor)
    table["mil"] = table["mils"] = ("displacement", 2.54e-5)
    table["ips"] = ("velocity", 0.0254)
    for name in ("g", "gn", "g0", "G"):
        table[name] = ("acceleration", STANDARD_GRAVITY)
    table["mg"] = ("acceleration", 1e-3 * STANDARD_GRAVITY)
    table["ug"] = ("acceleration", 1e-6 * STANDARD_GRAVITY)
    for name, factor in _TIMES.items():
        table[name] = ("time", factor)
    for name, factor in (
        ("Hz", 1.0),
        ("hz", 1.0),
        ("kHz", 1e3),
        ("S/s", 1.0),
        ("kS/s", 1e3),
        ("1/s", 1.0),
        ("sps", 1.0),
    ):
        table[name] = ("frequency", factor)
    return table


_UNITS = _table()
_VOLTS = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}


@dataclass(frozen=True)
class ChannelUnit:
    """A unit a channel was written in.

    Parameters
    ----------
    text : str
        As the file has it.
    quantity : str
        What it measures.
    factor : float
        SI units a unit: 9.80665 for g.
    """

    text: str
    quantity: ChannelQuantity
    factor: float


def parse_unit(text: str) -> ChannelUnit | None:
    """Unit from its text, or None when it is not one of length, speed, acceleration, time or frequency."""
    plain = _plain(text)
    found = _UNITS.get(plain)
    if found is None and (plain.isupper() or (len(plain) > 2 and plain.isalpha())):  # M/S2, Sec; but Mm is not mm
        found = _UNITS.get(plain.lower())
    return None if found is None else ChannelUnit(text.strip(), *found)


def parse_sensitivity(text: str) -> tuple[float, str] | None:
    """What a sensor gives a unit of motion, from "100 mV/g" or "10.2 mV/(m/s²)"; None when it is no such text.

    Returns
    -------
    tuple of float and str
        Volts a unit, > 0, and the unit of the motion.
    """
    found = re.fullmatch(r"\s*(\d[\d.eE+-]*)\s*([uµμm]?V)\s*(?:/|per\s)\s*(.+?)\s*", text)
    if not found:
        return None
    try:
        volts = float(found[1]) * _VOLTS[_plain(found[2])]
    except ValueError:
        return None
    unit = parse_unit(found[3])
    if unit is None or unit.quantity in ("time", "frequency") or not 0.0 < volts < math.inf:
        return None
    return volts, unit.text.strip("()")


def is_voltage(text: str | None) -> bool:
    """Whether a text is a unit of voltage: what a sensor's sensitivity turns into motion."""
    return text is not None and _plain(text) in _VOLTS


def volts_of(text: str) -> float:
    """Volts in a unit of voltage; see :func:`is_voltage`."""
    return _VOLTS[_plain(text)]


def split_label(label: str) -> tuple[str, str | None]:
    """Name and unit of a column label.

    Understood are ``s1-x [g]``, ``s1-x (g)``, ``s1-x/g``, ``s1-x/(m/s²)``, ``s1-x in g`` and ``s1-x, g``.

    Parameters
    ----------
    label : str

    Returns
    -------
    tuple of str and (str or None)
        The unit as written (known or not); None when the label has none.
    """
    label = " ".join(label.split())
    bracketed = re.fullmatch(r"(?P<name>.*?)\s*/?\s*(\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))", label)
    if bracketed:
        unit = bracketed["square"] if bracketed["square"] is not None else bracketed["round"]
        return bracketed["name"].strip(), unit.strip() or None
    # A slash is also part of units: take the first one that leaves a whole unit behind it.
    for mark in re.finditer(r"/|\s+in\s+|,", label):
        name, unit = label[: mark.start()].strip(), label[mark.end() :].strip()
        if name and parse_unit(unit) is not None:
            return name, unit
    return label, None


def _plain(text: str) -> str:
    plain = text.strip().strip("[]()").translate(str.maketrans("²¹µμ⁻·*", "21uu-  ")).replace("^", "")
    plain = re.sub(r"\s+2$", "2", plain)  # what is left of s**2
    plain = re.sub(r"/\s*s\s*/\s*s$", "/s2", plain)
    # m s-2, m.s-2, ms-2 and m s-1
    power = re.fullmatch(r"(\w+?)[ .]?\s*s-([12])", plain)
    if power:
        return f"{power[1]}/s{'' if power[2] == '1' else '2'}"
    return "".join(plain.split())
