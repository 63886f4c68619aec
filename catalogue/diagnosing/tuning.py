"""Numbers of a machine that a baseline recording can correct: those of its frame and its supports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Mount


@dataclass(frozen=True)
class Quantity:
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


def quantities(machine: Machine) -> tuple[Quantity, ...]:
    """What can be corrected in a machine; supports have one common factor each for stiffness in x, in y, and damping.

    A common factor, not one for each mount: a single loose mount is a fault, and a baseline must not hide it.
    """
    numbers = MachineNumbers(machine).by_path
    found = []
    for name in ("mass", "inertia"):
        path = f"links.{machine.frame}.{name}"
        if numbers.get(path):
            found.append(Quantity(f"frame.{name}", {path: numbers[path]}, MASS_SCATTER))
    mounts = [index for index, support in enumerate(machine.supports) if isinstance(support, Mount)]
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
            found.append(Quantity(name, there, scatter))
    return tuple(found)
