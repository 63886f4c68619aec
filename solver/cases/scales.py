"""What errors of steps are compared with."""

from __future__ import annotations

import math
from collections.abc import Mapping

from jointplay.solver.cases.contact_rates import extent_of
from jointplay.solver.equations.model import Model
from jointplay.solver.machines.drives import RotationDrive, TranslationDrive
from jointplay.solver.machines.machine import Machine


def error_scales(machine: Machine, model: Model) -> list[float]:
    """Sizes of the coordinates: the machine's extent, a radian."""
    extent = extent_of(machine)
    return [1.0 if name.startswith("theta(") else extent for name in model.kinematics.names]


def pace_of(machine: Machine, values: Mapping[str, float]) -> float:
    """Time in which the machine moves by its own size, s: by its drive, or by falling; a second at most."""
    extent = extent_of(machine)
    drive, rate = machine.drive, 0.0
    if isinstance(drive, RotationDrive | TranslationDrive):
        speeds = [speed for _, speed in drive.speed] if isinstance(drive.speed, tuple) else [drive.speed]
        fastest = abs(values.get("drive.speed", max(speeds, key=abs)))
        rate = fastest / (1.0 if isinstance(drive, RotationDrive) else extent)
        if isinstance(drive, TranslationDrive):
            rate = max(rate, *(2 * math.pi * h.frequency for h in drive.harmonics), 0.0)
    return 1.0 / max(rate, math.sqrt(abs(values.get("gravity", machine.gravity)) / extent), 1.0)
