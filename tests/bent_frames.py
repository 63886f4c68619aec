"""The slider-crank with modes of its frame, as its file could give them."""

from __future__ import annotations

from typing import Any

from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine

HALF = 0.25


def bending_mode(machine: Machine, frequency: float = 180.0, **more: Any) -> dict[str, Any]:
    """A bed that bends about its middle: w = 2 (x / l)^2 - 0.7, l half its length, a quarter of its mass moving."""
    points = dict.fromkeys(at for _, at in machine.frame_points)
    shape = [
        {"at": at, "displacement": [0, 2 * (at[0] / HALF) ** 2 - 0.7], "rotation": 4 * at[0] / HALF**2} for at in points
    ]
    mass = (machine.links[machine.frame].mass or 0.0) / 4
    return {"frequency": frequency, "damping": 0.02, "mass": mass, "shape": shape, **more}


def bent(*frequencies: float, name: str = "slider-crank", **more: Any) -> Machine:
    """A shipped machine with such modes, of 180 Hz unless said."""
    machine = shipped_machine(name)
    modes = [bending_mode(machine, frequency, **more) for frequency in frequencies or (180.0,)]
    return parse_machine(machine.model_dump() | {"modes": modes})
