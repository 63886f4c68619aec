"""Units of recorded channels as people write them, and column labels that carry one.

``m/s2``, ``m/s²``, ``m/s^2``, ``m s-2`` and ``m/s/s`` are one unit; the table is that of machine files.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from jointplay.solver.machines import units

ChannelQuantity = Literal["displacement", "velocity", "acceleration", "time", "frequency"]

_DIMENSIONS: dict[units.Dimension, ChannelQuantity] = {
    units.LENGTH: "displacement",
    units.SPEED: "velocity",
    units.ACCELERATION: "acceleration",
    units.TIME: "time",
    units.FREQUENCY: "frequency",
}
#: Nobody's machine shakes by kilometres: Mm was meant to be something else.
_LARGEST = {units.LENGTH: 1.0, units.SPEED: 1.0, units.ACCELERATION: 9.80665, units.TIME: 3600.0, units.FREQUENCY: 1e9}
#: mm, mm/s, mm/s2, mm/s/s, 1/s; not all that has the right dimension.
_FORM = re.compile(r"([A-Za-z]{1,12}|g0)(/(s|sec|min|h))?|[A-Za-z]{1,12}/(s|sec)(2|/(s|sec))|1/s")
#: As loggers write them.
_ALIASES = {
    "G": "g", "M": "m", "S": "s",
    "sek": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms", "usec": "us", "hz": "Hz",
    "S/s": "Hz", "kS/s": "kHz", "sps": "Hz",
}  # fmt: skip
#: What a column of times is called, small and with underscores.
TIME_NAMES = frozenset({
    "time", "t", "zeit", "temps", "tempo", "tiempo", "tijd", "tid", "czas", "timestamp", "time_stamp", "datetime",
    "zeitstempel", "epoch", "epoch_time", "unix", "unix_time", "unixtime", "elapsed", "elapsed_time", "x_value",
})  # fmt: skip
#: Units of what is no motion, small, that might be words of a name: their columns are left out, not asked about.
_OTHER_UNITS = frozenset({
    "a", "ma", "amp", "amps", "ampere", "amperes", "volt", "volts", "millivolt", "millivolts", "w", "kw", "watt",
    "watts", "va", "kva", "ohm", "kohm", "pf", "nf", "uf", "pc", "c", "f", "k", "degc", "degf", "celsius",
    "fahrenheit", "kelvin", "deg", "degree", "degrees", "grad", "rad", "rpm", "upm", "n", "kn", "mn", "newton",
    "newtons", "nm", "knm", "kg", "lb", "lbs", "pa", "kpa", "mpa", "bar", "mbar", "psi", "pascal", "percent", "pct",
    "prozent", "db", "dba", "count", "counts", "digits", "bit", "bits", "lsb",
})  # fmt: skip
#: What a column is called that counts rows, small and letters alone; and what a line of units begins with.
_COUNTER = re.compile(
    r"(sample|samples|unnamed|index|idx|no|nr|num|number|nummer|row|rows|zeile|point|points|scan|messwert|count|counter|record"
    r"|kanal(name)?|channel(name)?|name)?(no|nr|num|number|nummer|index|id)?"
)
UNIT_WORDS = frozenset(
    {"y_unit_label", "unit", "units", "einheit", "einheiten", "dimension", "unité", "unidad", "unità"}
)
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
    found = _find_known(plain)
    if found is None and len(plain) > 1 and (plain.isupper() or (len(plain) > 2 and plain.isalpha())):  # not Mm
        found = _find_known(plain.lower())
    return None if found is None else ChannelUnit(text.strip(), _DIMENSIONS[found[0]], found[1])


def _find_known(plain: str) -> tuple[units.Dimension, float] | None:
    plain = _ALIASES.get(plain, plain)
    found = units.factor_of(plain, tuple(_DIMENSIONS)) if _FORM.fullmatch(plain) else None
    return found if found is not None and found[1] <= _LARGEST[found[0]] else None


def time_unit_in(name: str) -> str | None:
    """Unit in the name of a column of times, "ms" of "timestamp_ms"; empty without one, None for other columns."""
    plain = re.sub(r"[\s_-]+", "_", name.strip().lower())
    if plain in TIME_NAMES:
        return ""
    base, _, unit = plain.rpartition("_")
    found = parse_unit(unit)
    return unit if base in TIME_NAMES and found is not None and found.quantity == "time" else None


def is_counter_name(name: str) -> bool:
    """Whether a column of this name may count its rows: "Sample", "Index", "No."."""
    return _COUNTER.fullmatch("".join(each for each in name.lower() if each.isalpha())) is not None


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
        The unit as written, known or not; None when the label has none. Words in round brackets that are no known
        unit, ``Untitled (Filtered)``, are part of the name.
    """
    label = " ".join(label.split())
    bracketed = re.fullmatch(r"(?P<name>.*?)\s*/?\s*(\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))", label)
    if bracketed and (bracketed["square"] is not None or _may_be_unit(bracketed["round"])):
        unit = bracketed["square"] if bracketed["square"] is not None else bracketed["round"]
        return bracketed["name"].strip(), unit.strip() or None
    # A slash is also part of units: take the first one that leaves a whole unit behind it.
    for mark in re.finditer(r"/|\s+in\s+|,", label):
        name, unit = label[: mark.start()].strip(), label[mark.end() :].strip()
        if name and parse_unit(unit) is not None:
            return name, unit
    return label, None


def _may_be_unit(text: str) -> bool:
    """Whether what stands in round brackets may be a unit: it begins with a known one, or is no word."""
    first = next(iter(text.split()), "")
    known = first.lower() in _OTHER_UNITS or is_voltage(first) or parse_unit(first) is not None
    return known or not first.isalpha() or (len(first) <= 3 and not first.isascii())


def _plain(text: str) -> str:
    plain = text.strip().strip("[]()").translate(str.maketrans("²¹µμ⁻·*", "21uu-  ")).replace("^", "")
    plain = re.sub(r"\s+2$", "2", plain)  # what is left of s**2
    # m s-2, m.s-2, ms-2 and m s-1
    power = re.fullmatch(r"(\w+?)[ .]?\s*s-([12])", plain)
    if power:
        return f"{power[1]}/s{'' if power[2] == '1' else '2'}"
    return "".join(plain.split())
