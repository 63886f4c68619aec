"""One case of a catalogue before it is computed: hypothesis, clearances, parameters, and how it is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal, Self

import solver
from catalogue.errors import CatalogueMismatchError
from catalogue.keys import entry_key
from solver.machines.fault import FaultState
from solver.machines.machine import Machine
from solver.spectra.bands import BandScheme

__all__ = ["AS_NEW", "HEALTHY", "Entry", "Recipe", "hypothesis_label"]

HEALTHY = "healthy"
"""Hypothesis of a machine whose joints all are ideal."""

AS_NEW = "as-new"
"""Hypothesis of a machine with the small play of new fits in every turning joint."""


def hypothesis_label(joints: tuple[str, ...]) -> str:
    """Name of the hypothesis that exactly `joints` are worn: ``healthy``, ``A``, ``A+F``, in alphabetical order."""
    return "+".join(sorted(joints)) if joints else HEALTHY


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
        for name, value in self.content.items():
            wanted = other.content[name]
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
    hypothesis : str
        Label of the hypothesis.
    joints : tuple of str
        Joints with clearance, in alphabetical order.
    clearances : tuple of float
        Their radial clearances [m].
    parameters : mapping of str to float
        Numbers of the machine that differ from its file, by path, SI.
    draw : int
        Number of the draw within its hypothesis, levels and speed, from 0.
    """

    key: str
    hypothesis: str
    joints: tuple[str, ...]
    clearances: tuple[float, ...]
    parameters: Mapping[str, float]
    draw: int

    @classmethod
    def of(
        cls,
        machine: Machine,
        recipe: Recipe,
        *,
        hypothesis: str,
        joints: tuple[str, ...],
        clearances: tuple[float, ...],
        parameters: Mapping[str, float],
        draw: int,
    ) -> Self:
        """Make an entry with its key."""
        fault = dict(zip(joints, clearances, strict=True))
        key = entry_key(machine.content_key, fault, parameters, recipe.content, solver.__version__)
        return cls(key, hypothesis, joints, clearances, dict(parameters), draw)

    @property
    def fault(self) -> FaultState:
        """Radial clearance [m] by joint."""
        return FaultState(dict(zip(self.joints, self.clearances, strict=True)))
