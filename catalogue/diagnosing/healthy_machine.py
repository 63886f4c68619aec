"""The machine without play, and the numbers of its frame and supports that may differ from its file.

It is simulated at one speed, with derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.cause_families import mounts_of
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.driving import at_speed
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.band_power import WINDOW_REVOLUTIONS, band_matrix


@dataclass(frozen=True)
class TunedQuantity:
    """One number that may be off, or several that are off together.

    Parameters
    ----------
    name : str
        Path as in a plan: "frame.mass", "supports.stiffness.x".
    paths : mapping of str to float
        Numbers of the machine file it stands for, as they are there.
    scatter : float
        Standard deviation of the logarithm of the factor on them, before anything was measured.
    """

    name: str
    paths: Mapping[str, float]
    scatter: float

    def parameters(self, log_factor: float) -> dict[str, float]:
        """Parameters of a case in which the number is off by this much."""
        factor = math.exp(log_factor)
        return {path: value * factor for path, value in self.paths.items()}


#: Standard deviations, ln: what is weighed or drawn is known better than what is rubber.
MASS_SCATTER = 0.2
STIFFNESS_SCATTER = 0.3
DAMPING_SCATTER = 0.5


def quantities(machine: Machine) -> tuple[TunedQuantity, ...]:
    """What can be corrected in a machine; supports have one common factor each for stiffness in x, in y, and damping.

    A common factor, not one for each mount: a single loose mount is a fault, and a baseline must not hide it.
    """
    numbers = MachineNumbers(machine).by_path
    found = []
    for name in ("mass", "inertia"):
        path = f"links.{machine.frame}.{name}"
        if numbers.get(path):
            found.append(TunedQuantity(f"frame.{name}", {path: numbers[path]}, MASS_SCATTER))
    mounts = mounts_of(machine)
    others = [index for index in range(len(machine.supports)) if index not in mounts]
    groups = {
        "supports.stiffness.x": ([f"supports.{index}.stiffness.0" for index in mounts], STIFFNESS_SCATTER),
        "supports.stiffness.y": ([f"supports.{index}.stiffness.1" for index in mounts], STIFFNESS_SCATTER),
        "supports.stiffness": ([f"supports.{index}.stiffness" for index in others], STIFFNESS_SCATTER),
        "supports.damping": (
            [f"supports.{index}.damping{axis}" for index in range(len(machine.supports)) for axis in ("", ".0", ".1")],
            DAMPING_SCATTER,
        ),
    }
    for name, (paths, scatter) in groups.items():
        there = {path: numbers[path] for path in paths if numbers.get(path)}
        if there:
            found.append(TunedQuantity(name, there, scatter))
    return tuple(found)


#: Step of the differences, ln: levels are good to a hundredth of a decibel, and next to a resonance they bend.
STEP = 0.02
#: A machine without play repeats itself: windows enough for one estimate.
REVOLUTIONS = WINDOW_REVOLUTIONS + 0.05


@dataclass(frozen=True, eq=False)
class Motion:
    """Cross-powers of the frame's motion.

    Parameters
    ----------
    power : (B, 3, 3) array
        [(m/s2)^2] and [(rad/s2)^2], at the numbers that were asked for.
    shifted : (k, B, 3, 3) array
        With each number larger by :data:`STEP`.
    """

    power: ComplexArray
    shifted: ComplexArray


class HealthyMachine:
    """Simulations of a catalogue's machine without play.

    Parameters
    ----------
    catalogue : Catalogue
        Gives machine, bands, accuracy and sample rate.
    quantities : sequence of Quantity
        Numbers that may be off.
    drive_speed : float
        rad/s; its sign is that of the machine file.
    """

    def __init__(self, catalogue: Catalogue, quantities: Sequence[TunedQuantity], drive_speed: float) -> None:
        self.quantities = tuple(quantities)
        self.simulations = 0
        self._catalogue = catalogue
        self._speed = math.copysign(drive_speed, catalogue.recipe.nominal_drive_speed)

    def parameters(self, log_factors: Sequence[float] | FloatArray) -> dict[str, float]:
        """Parameters of a case whose numbers are off by these factors."""
        found: dict[str, float] = {}
        for quantity, value in zip(self.quantities, log_factors, strict=True):
            found |= quantity.parameters(float(value))
        return found

    def at(self, log_factors: FloatArray) -> Motion:
        """Simulate the machine with numbers off by these factors, and with each of them off by a little more.

        Raises
        ------
        DiagnosisError
            A case does not come to a steady end.
        """
        found = self.powers([log_factors, *(log_factors + STEP * row for row in np.eye(len(self.quantities)))])
        return Motion(found[0], found[1:])

    def powers(self, points: Sequence[FloatArray]) -> ComplexArray:
        """Cross-powers (n, B, 3, 3) with numbers off by each of n sets of factors; errors as for :meth:`at`."""
        cases = [
            Case(parameters={**self.parameters(point), **at_speed(self._catalogue.machine, self._speed)})
            for point in points
        ]
        recipe = self._catalogue.recipe
        settings = Settings(
            sample_rate=recipe.sample_rate, accuracy=recipe.accuracy, revolutions=REVOLUTIONS, motion=False
        )
        powers = []
        for history in simulate_batch(self._catalogue.machine, cases, settings):
            if history.status is not Status.OK or not history.drive_speed:
                raise DiagnosisError(
                    f"healthy {self._catalogue.machine.name} at {self._speed * 30 / math.pi:.4g} rpm cannot be"
                    f" simulated: {history.status.value} {history.message}"
                )
            signal, rate, _ = history.by_revolutions(history.as_rigid(self._catalogue.machine))
            powers.append(band_matrix(signal, rate, history.drive_speed, recipe.scheme).power)
        self.simulations += len(cases)
        return np.array(powers)
