"""Parts of a plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from jointplay.catalogue.plans.draws import Distribution, log_uniform
from jointplay.solver.machines.fields import QuantityField, RuleError
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.parts import Part
from jointplay.solver.machines.units import FREQUENCY, LENGTH

Auto = BeforeValidator(lambda value: None if isinstance(value, str) and value == "auto" else value)
"""Lets a file say ``auto`` for what follows from the machine: None."""
Clearance = Annotated[float, QuantityField(LENGTH, above=0.0)]
Count = Annotated[int, Field(ge=1, le=100_000, strict=True)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
NEXT_TO_NONE = 30.0
"""Part of the least play of a fit that a tight one has at least: below, the contact is a stiff spring all the time."""


class ClearanceRange(Part):
    """Radial clearance of worn joints: log-uniform from ``low`` to ``high`` [m], of one alone to ``beyond`` times that.

    It begins later where a joint's fit is wider: wear is what goes beyond it, by a quarter at least. Answers tell
    clearances up to ``high``, and "at least" from there on: what is larger has to be known to be told from two joints.
    """

    low: Clearance = 2.5e-5
    high: Clearance = 2e-3
    beyond: Annotated[float, Field(ge=1.0, le=100.0)] = 2.0

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.high > 0.1:
            raise RuleError("must not be larger than 0.1 m", ("high",), self.high)
        if not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class Fits(Part):
    """Play of the fits of joints that are not worn: log-uniform from ``low`` to ``high`` [m].

    Without them every joint has the range that the machine file says, its ``fit``. In ``tight`` of all joints there is
    next to none (log-uniform down to a thirtieth of the least play), as in a joint that is preloaded or greased. Of all
    machines the ``silent`` have none where they are not worn: ideal joints, as preloaded rolling bearings nearly are.
    """

    low: Clearance | None = None
    high: Clearance | None = None
    tight: Share = 0.1
    silent: Share = 0.25

    def bounds(self, joint: TurningJoint) -> tuple[float, float]:
        """Least and greatest play of a joint [m], tight ones aside."""
        return joint.play_as_new if self.low is None or self.high is None else (self.low, self.high)

    def quantile(self, u: float, joint: TurningJoint) -> float:
        """Play [m] below which the fraction `u` of all fits of a joint lies, in a machine that is not silent."""
        low, high = self.bounds(joint)
        if u < self.tight:
            return log_uniform(low / NEXT_TO_NONE, low, u / self.tight)
        return log_uniform(low, high, (u - self.tight) / max(1.0 - self.tight, 1e-12))

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if (self.low is None) != (self.high is None):
            missing = "low" if self.low is None else "high"
            raise RuleError("must be given with the other bound, or neither (fits are then the machine's)", (missing,))
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class Draws(Part):
    """Number of draws of each hypothesis, by kind: healthy, one worn joint, two, a set of more."""

    healthy: Count = 192
    single: Count = 192
    pair: Count = 192
    larger: Count = 192

    def of(self, worn: int) -> int:
        """The number for a hypothesis of so many worn joints, 1 at least."""
        return (self.single, self.pair, self.larger)[min(worn, 3) - 1]


class Wide(Part):
    """Further draws in which the machine's own data are uncertain, too: ``draws`` of them for each of the others.

    ``uncertain`` is what is uncertain besides, by path; None (``auto`` in a file) is
    :func:`~jointplay.catalogue.plans.ranges.default_wide`.
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
    f_max: Annotated[float, QuantityField(FREQUENCY, above=0.0)] = 4000.0
