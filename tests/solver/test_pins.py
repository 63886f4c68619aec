"""Worn pins in their sockets: where what they carry hangs, and never far through the wall."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.pins import ORBIT, pin_orbits

CLEARANCE = 2e-4


@pytest.mark.parametrize(("pin", "upward"), [("beam", 1.0), ("hanger", -1.0)])
def test_a_pin_is_where_its_load_hangs(pin: str, upward: float) -> None:
    """Hanger and plunger always pull the beam's pin E down: it lies on top of it in the socket, or below in its own."""
    tree = shipped_machine("walking-beam").model_dump(mode="json")
    tree["joints"]["E"]["pin"] = pin
    orbit = pin_orbits(parse_machine(tree), Fault({"E": CLEARANCE}))["E"] / CLEARANCE
    assert orbit.shape == (ORBIT, 2)
    assert (upward * orbit[:, 1] > 0.9).all()
    deep = np.hypot(*orbit.T) - 1
    # 600 N of fluid and 15 kg hang on a contact of 30 kN/mm: 25 um, an eighth of the clearance.
    assert 0.08 < deep.max() < 0.2
    assert deep.min() > -0.01  # it never lets go


def test_only_worn_pins_of_a_machine_at_a_constant_speed() -> None:
    machine = shipped_machine("slider-crank")
    assert pin_orbits(machine, HEALTHY) == {}
    found = pin_orbits(machine, Fault({"A": CLEARANCE, "B": CLEARANCE}))
    assert list(found) == ["A", "B"]
    tree = machine.model_dump(mode="json")
    for drive in ({"kind": "torque", "joint": "O", "torque": 2.0}, {"kind": "rotation", "joint": "O", "speed": 0.0}):
        assert pin_orbits(parse_machine({**tree, "drive": drive}), Fault({"A": CLEARANCE})) == {}
