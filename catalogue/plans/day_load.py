"""Loads of the process that a plan asks for, as conditions of the day."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import model_validator

from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.fields import QuantityField, RuleError
from jointplay.solver.machines.parts import Part
from jointplay.solver.machines.units import FORCE, TORQUE

#: Factors on the loads that a plan asks for: what a process needs is known so well.
DAY_LOAD = (0.8, 1.2)


class DayLoad(Part):
    """A constant load of the process on the output link, of one day: what is given of both is drawn within a fifth.

    Parameters
    ----------
    force : float, optional
        Along the slide of the output on the frame, in the direction that the machine file gives that joint [N].
    torque : float, optional
        On an output that turns on the frame, counterclockwise [N m].
    """

    force: Annotated[float, QuantityField(FORCE)] | None = None
    torque: Annotated[float, QuantityField(TORQUE)] | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.force is None) == (self.torque is None):
            raise RuleError("must give exactly one of force, torque")
        return self

    @property
    def size(self) -> float:
        """Of the load, N or N m."""
        return self.force or self.torque or 0.0

    def __str__(self) -> str:
        """In words: ``-300 N``."""
        return f"{self.size:g} {'N' if self.torque is None else 'N m'}"


def loads_held(loads: Sequence[DayLoad], drawn: FloatArray) -> IntArray:
    """Say which of some loads each of what was drawn (n,), N or N m, is of; -1 where it is of none."""
    ratio = np.empty((len(drawn), len(loads)))
    for column, load in enumerate(loads):
        ratio[:, column] = drawn / load.size if load.size else np.where(drawn == 0.0, 1.0, np.inf)
    nearest = np.argmin(np.abs(ratio - 1.0), axis=1)
    low, high = DAY_LOAD
    share = ratio[np.arange(len(drawn)), nearest]
    return np.asarray(np.where((share > low - 1e-9) & (share < high + 1e-9), nearest, -1))
