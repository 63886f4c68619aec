"""P1 and QR: the two machines on which programs are compared, and their reference responses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solver.fault import FaultState
from solver.harmonics import harmonic_error
from solver.history import Case, Settings
from solver.machine import Machine, load_machine, shipped_machine
from solver.simulate import simulate

Array = NDArray[np.float64]

#: Samples per second of every record.
RATE = 20_000
_DATA = Path(__file__).parents[1] / "tests/data/reference"


@dataclass(frozen=True)
class Scene:
    """A machine with one worn joint.

    Attributes
    ----------
    name : str
    machine : Machine
    fault : FaultState
    drive_hz : float
    duration, after : float
        Simulated time, and the transient in it, s.
    """

    name: str
    machine: Machine
    fault: FaultState
    drive_hz: float
    duration: float
    after: float

    @property
    def case(self) -> Case:
        """For the product."""
        return Case(self.fault)

    @cached_property
    def reference(self) -> Array:
        """Frame's y acceleration: of P1 by an independent program, else our own at a tolerance of 1e-11."""
        if self.name == "P1":
            return np.asarray(np.load(_DATA / "p1.npz")["acc_y"])
        return simulate(self.machine, self.case, Settings(duration=self.duration, rtol=1e-11)).acceleration[:, 1]

    def error(self, acceleration: Array) -> float:
        """Harmonic error, dB."""
        first = round(self.after * RATE)
        return harmonic_error(acceleration[first:-1], self.reference[first:-1], RATE, self.drive_hz)


def p1() -> Scene:
    """Slider-crank, 0.2 mm between rod and slider, 600 rpm."""
    return Scene("P1", load_machine(_DATA / "p1.yaml"), FaultState({"B": 2e-4}), 10.0, 2.0, 0.5)


def quick_return() -> Scene:
    """Shipped quick-return, 0.2 mm at the rocker's pivot, 120 rpm; its response repeats (at O and A it is chaotic)."""
    return Scene("QR", shipped_machine("quick-return"), FaultState({"C": 2e-4}), 2.0, 4.0, 2.0)
