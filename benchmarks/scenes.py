"""P1 and QR: the two machines on which programs are compared, and their reference responses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, load_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.harmonics import harmonic_error

Array = NDArray[np.float64]

#: Samples per second of a record of instantaneous values.
RATE = 20_000
#: Samples per second of what the product makes spectra of: free of aliases, flat to four tenths of it.
LIMITED_RATE = 10_000
_DATA = Path(__file__).parents[1] / "tests/data/reference"


@dataclass(frozen=True)
class Scene:
    """A machine with one worn joint.

    Attributes
    ----------
    name : str
    machine : Machine
    fault : Fault
    drive_hz : float
    duration, after : float
        Simulated time, and the transient in it, s.
    """

    name: str
    machine: Machine
    fault: Fault
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
        return self.converged[0]

    @cached_property
    def converged(self) -> tuple[Array, Array]:
        """Our own run at a tolerance of 1e-11: instantaneous values, and band-limited ones at their rate."""
        exact = Settings(duration=self.duration, rtol=1e-11)
        instantaneous = simulate(self.machine, self.case, exact).acceleration[:, 1]
        limited = simulate(self.machine, self.case, replace(exact, sample_rate=LIMITED_RATE, motion=False))
        return instantaneous, limited.band_limited_acceleration[:, 1]

    def error(self, acceleration: Array, rate: int = RATE) -> float:
        """Harmonic error, dB, against the reference, or of band-limited values against the converged run's."""
        first, exact = round(self.after * rate), self.reference if rate == RATE else self.converged[1]
        return harmonic_error(acceleration[first:-1], exact[first:-1], rate, self.drive_hz)


def p1() -> Scene:
    """Slider-crank, 0.2 mm between rod and slider, 600 rpm."""
    return Scene("P1", load_machine(_DATA / "p1.yaml"), Fault({"B": 2e-4}), 10.0, 2.0, 0.5)


def quick_return() -> Scene:
    """Shipped quick-return, 0.2 mm at the rocker's pivot, 120 rpm; its response repeats (at O and A it is chaotic)."""
    return Scene("QR", shipped_machine("quick-return"), Fault({"C": 2e-4}), 2.0, 4.0, 2.0)
