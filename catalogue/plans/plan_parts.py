"""Parts of a plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from catalogue.plans.draws import Distribution
from solver.machines.fields import Quantity, RuleError
from solver.machines.parts import Part
from solver.machines.units import FREQUENCY, LENGTH

__all__ = ["Auto", "Bands", "ClearanceRange", "Draws", "Fits", "Wide"]

Auto = BeforeValidator(lambda value: None if isinstance(value, str) and value == "auto" else value)
"""Lets a file say ``auto`` for what follows from the machine: None."""
Clearance = Annotated[float, Quantity(LENGTH, above=0.0)]
Count = Annotated[int, Field(ge=1, le=100_000, strict=True)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class ClearanceRange(Part):
    """Radial clearance of worn joints: log-uniform from ``low`` to ``high`` [m]."""

    low: Clearance = 3e-5
    high: Clearance = 1e-3

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.high > 0.1:
            raise RuleError("must not be larger than 0.1 m", ("high",), self.high)
        if not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class Fits(Part):
    """Play of new fits: log-uniform from ``low`` to ``high`` [m].

    ``in_faulty`` asks for more draws of faulty machines, this part of their number, whose other joints have it, too.
    """

    low: Clearance = 3e-6
    high: Clearance = 2e-5
    in_faulty: Share = 0.0

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class Draws(Part):
    """Number of draws of each hypothesis, by kind: healthy, as-new, one worn joint, two, a chosen set of more."""

    healthy: Count = 192
    as_new: Count = 192
    single: Count = 192
    pair: Count = 192
    larger: Count = 192

    def of(self, worn: int) -> int:
        """The number for a hypothesis of so many worn joints, 1 at least."""
        return (self.single, self.pair, self.larger)[min(worn, 3) - 1]


class Wide(Part):
    """Further draws in which the machine's own data are uncertain, too: ``draws`` of them for each of the others.

    ``uncertain`` is what is uncertain besides, by path; None (``auto`` in a file) is
    :func:`~catalogue.plans.ranges.default_wide`.
    """

    draws: Share = 0.0
    uncertain: Annotated[Mapping[str, Distribution] | None, Auto] = None

    def count(self, draws: int) -> int:
        """How many wide draws go with `draws` others."""
        return math.ceil(self.draws * draws - 1e-9)


class Bands(Part):
    """Bands of the stored spectra: on each of the first ``orders``, then ``per_octave``, up to ``f_max`` [Hz]."""

    orders: Annotated[int, Field(ge=1, le=1000, strict=True)] = 100
    per_octave: Annotated[int, Field(ge=1, le=96, strict=True)] = 12
    f_max: Annotated[float, Quantity(FREQUENCY, above=0.0)] = 4000.0
