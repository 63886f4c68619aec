"""One case of a catalogue before it is computed: hypothesis, clearances, parameters, and how it is computed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

from jointplay import solver
from jointplay.catalogue.errors import CatalogueMismatchError
from jointplay.catalogue.plans.keys import entry_key
from jointplay.catalogue.plans.variants import AS_FILED, Variant
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.bands import BandScheme

HEALTHY = "healthy"
"""Hypothesis of a machine in order: every turning joint has the small play of its fit, and none is worn."""


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
        Joints with clearance, in alphabetical order: all turning joints of a catalogue's cases.
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
