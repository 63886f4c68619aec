"""The machine without play, simulated at one speed for numbers that differ from its file, with derivatives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.tuning import Quantity
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.parameters import DRIVE_SPEED
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.history import Case, Settings, Status
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.band_power import WINDOW_REVOLUTIONS, band_matrix

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

    def __init__(self, catalogue: Catalogue, quantities: Sequence[Quantity], drive_speed: float) -> None:
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
        cases = [Case(parameters={**self.parameters(point), DRIVE_SPEED: self._speed}) for point in points]
        recipe = self._catalogue.recipe
        settings = Settings(
            sample_rate=recipe.sample_rate, accuracy=recipe.accuracy, revolutions=REVOLUTIONS, motion=False
        )
        powers = []
        for history in simulate_batch(self._catalogue.machine, cases, settings):
            if history.status is not Status.OK:
                raise DiagnosisError(
                    f"healthy {self._catalogue.machine.name} at {self._speed * 30 / math.pi:.4g} rpm cannot be"
                    f" simulated: {history.status.value} {history.message}"
                )
            signal = history.band_limited_acceleration[history.t >= history.transient]
            powers.append(band_matrix(signal, history.sample_rate, history.drive_speed, recipe.scheme).power)
        self.simulations += len(cases)
        return np.array(powers)
