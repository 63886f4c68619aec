"""One case of a catalogue before it is computed: hypothesis, clearances, parameters, how it is computed, and its key.

Keys are addresses by content: what goes into a simulated case, written in one canonical way and hashed. Two cases have
the same key exactly if machine, fault, parameters, settings and the version of numbers are the same, on every computer
and in every process; so a key finds a stored entry, tells a repeated case, and serves as an HTTP entity tag.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np

from jointplay import solver
from jointplay.catalogue.errors import CatalogueMismatchError, KeyContentError
from jointplay.catalogue.plans.variants import AS_FILED, Variant
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.bands import BandScheme


def _plain(value: object, where: str) -> object:
    """`value` with NumPy scalars, tuples and mappings turned into what JSON knows; everything else is refused."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise KeyContentError(where, value, "must be a finite number")
        return value + 0.0  # -0.0 and 0.0 are one number and must have one key
    if isinstance(value, Mapping):
        plain: dict[str, object] = {}
        for name, item in value.items():
            if not isinstance(name, str):
                raise KeyContentError(where, name, "must be a string to be a key of a mapping")
            if type(item) is float and math.isfinite(item):  # what most of a case is made of
                plain[name] = item + 0.0
            else:
                plain[name] = _plain(item, f"{where}.{name}" if where else name)
        return plain
    if isinstance(value, (list, tuple)):
        return [_plain(item, f"{where}.{index}") for index, item in enumerate(value)]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist(), where)
    raise KeyContentError(where, value, "has no canonical JSON form")


def canonical_json(value: object) -> str:
    """One spelling of a value: mapping keys sorted, no blanks, floats by ``repr`` (shortest form that reads back).

    Parameters
    ----------
    value : object
        Mappings with string keys, sequences, strings, finite numbers, booleans, ``None``, NumPy scalars and arrays.

    Returns
    -------
    str
        ASCII JSON. An integer and a float of equal value are spelt differently; whoever makes a key decides the type.

    Raises
    ------
    KeyContentError
        A number that is not finite, or something that is not data.
    """
    return json.dumps(_plain(value, ""), sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_digest(value: object) -> str:
    """SHA-256 of the canonical JSON of `value`, 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def entry_key(
    machine_key: str,
    clearances: Mapping[str, float],
    parameters: Mapping[str, float],
    settings: Mapping[str, object],
    numbers_version: int,
    variant: Mapping[str, object] | None = None,
) -> str:
    """Key of one simulated case.

    Parameters
    ----------
    machine_key : str
        Content key of the machine.
    clearances : mapping of str to float
        Fault: radial clearance in m by joint.
    parameters : mapping of str to float
        Numbers of the machine that differ from its file, by dotted path, SI.
    settings : mapping
        Settings of the simulation and of the estimate made from it: accuracy, sample rate, revolutions, bands.
    numbers_version : int
        :data:`jointplay.solver.NUMBERS_VERSION`: of what the same case gives.
    variant : mapping, optional
        How the machine differs in kind from its file; nothing by default.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    content: dict[str, object] = {
        "machine": machine_key,
        "fault": {joint: float(clearance) for joint, clearance in clearances.items()},
        "parameters": {path: float(number) for path, number in parameters.items()},
        "settings": settings,
        "numbers": numbers_version,
    }
    if variant:
        content["variant"] = variant
    return content_digest(content)


def seed_from(*parts: object) -> int:
    """A 64-bit seed that is a pure function of `parts`, the same in every process and on every computer."""
    return int(content_digest(list(parts))[:16], 16)


DRAWS_VERSION = 2
"""Of what a plan draws. It changes when, and only when, the same plan may ask for other cases: since 2 a draw is the
same machine in order and worn.
"""


HEALTHY = "healthy"
"""Hypothesis of a machine in order: every joint that can wear has the small play of its fit, and none is worn."""


Stratum = Literal["trusted", "wide"]
"""How much of the machine is uncertain in a case: what always is, or the machine's own data, too."""


@dataclass(frozen=True)
class Hypothesis:
    """What a case is a case of.

    Parameters
    ----------
    label : str
        Its name: ``healthy``, or the worn joints with ``+`` between them. For people; a joint's name may hold a ``+``
        itself, so nothing is read from it.
    joints : tuple of str
        The worn joints, in alphabetical order; none for the healthy machine. All others have the play of their fits.
    """

    label: str
    joints: tuple[str, ...] = ()

    @classmethod
    def of(cls, joints: Iterable[str]) -> Self:
        """The hypothesis that exactly `joints` are worn; of none, the healthy machine."""
        joints = tuple(sorted(joints))
        return cls("+".join(joints) if joints else HEALTHY, joints)

    @property
    def is_faulty(self) -> bool:
        """Whether a joint is worn."""
        return bool(self.joints)


@dataclass(frozen=True)
class Recipe:
    """How every entry of a catalogue is simulated and estimated; one catalogue has one recipe.

    Parameters
    ----------
    accuracy : {"draft", "standard", "reference"}
        Accuracy of the simulation.
    sample_rate : float
        Of the simulated acceleration [Hz].
    revolutions : float
        Drive revolutions after the transient.
    orders, per_octave : int
        One-order bands, and bands an octave above them.
    f_max : float
        Upper end of the bands at the nominal speed [Hz].
    nominal_drive_speed : float
        The machine's drive speed [rad/s].
    """

    accuracy: Literal["draft", "standard", "reference"]
    sample_rate: float
    revolutions: float
    orders: int
    per_octave: int
    f_max: float
    nominal_drive_speed: float

    @cached_property
    def scheme(self) -> BandScheme:
        """Bands of the stored spectra."""
        return BandScheme.for_drive(self.nominal_drive_speed, self.f_max, self.orders, self.per_octave)

    @cached_property
    def content(self) -> dict[str, Any]:
        """As plain data; :meth:`from_content` reads it back."""
        return asdict(self)

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Self:
        """Read what :attr:`content` wrote.

        Raises
        ------
        TypeError
            Something is missing or there is more than that.
        """
        return cls(**content)

    def check_same(self, other: Recipe, where: str) -> None:
        """Refuse to mix two recipes in one catalogue.

        Raises
        ------
        CatalogueMismatchError
            Names the first setting that differs.
        """
        theirs = asdict(other)
        for name, value in asdict(self).items():
            wanted = theirs[name]
            same = math.isclose(value, wanted, rel_tol=1e-12) if isinstance(value, float) else value == wanted
            if not same:
                rule = f"was built with {name} {value}, not {wanted}: build into another folder"
                raise CatalogueMismatchError(where, rule)


@dataclass(frozen=True)
class Entry:
    """One case to simulate; made by :meth:`of`.

    Parameters
    ----------
    key : str
        SHA-256 of everything that determines the result.
    hypothesis : Hypothesis
        What it is a case of.
    joints : tuple of str
        Joints with clearance, in alphabetical order: all that can wear of a catalogue's cases.
    clearances : tuple of float
        Their radial clearances [m].
    parameters : mapping of str to float
        Numbers of the machine that differ from its file, by path, SI.
    draw : int
        Number of the draw within its hypothesis, stratum, joints and speed, from 0.
    stratum : {"trusted", "wide"}
        How much of the machine is uncertain.
    variant : Variant
        How the machine differs in kind from its file.
    speed : float
        Factor on the drive speed of the machine file that the plan asked for, without the scatter of the draws.
    guarded : bool
        Whether the case is computed again more finely, for comparison; two entries that differ in this are equal.
    """

    key: str
    hypothesis: Hypothesis
    joints: tuple[str, ...]
    clearances: tuple[float, ...]
    parameters: Mapping[str, float]
    draw: int
    stratum: Stratum = "trusted"
    variant: Variant = AS_FILED
    speed: float = 1.0
    guarded: bool = field(default=False, compare=False)

    @classmethod
    def of(
        cls,
        machine: Machine,
        recipe: Recipe,
        *,
        hypothesis: Hypothesis,
        joints: tuple[str, ...],
        clearances: tuple[float, ...],
        parameters: Mapping[str, float],
        draw: int,
        stratum: Stratum = "trusted",
        variant: Variant = AS_FILED,
        speed: float = 1.0,
        guarded: bool = False,
    ) -> Self:
        """Make an entry with its key."""
        fault = dict(zip(joints, clearances, strict=True))
        key = entry_key(machine.content_key, fault, parameters, recipe.content, solver.NUMBERS_VERSION, variant.content)
        return cls(key, hypothesis, joints, clearances, dict(parameters), draw, stratum, variant, speed, guarded)

    @property
    def worn(self) -> tuple[str, ...]:
        """The worn joints, in alphabetical order."""
        return self.hypothesis.joints

    @property
    def fault(self) -> Fault:
        """Radial clearance [m] by joint."""
        return Fault(dict(zip(self.joints, self.clearances, strict=True)))
