"""The sizes of models are those of the paper, and what is missing is said."""

from __future__ import annotations

import pytest

from solver.account import account
from solver.fault import HEALTHY, FaultState
from solver.machine import parse_machine, shipped_machine


@pytest.mark.parametrize("worn", [(), ("A",), ("A", "F"), ("O", "A", "C", "E", "F")])
def test_freedoms_of_a_mechanism_on_a_free_frame(worn: tuple[str, ...]) -> None:
    sizes = account(shipped_machine("quick-return"), FaultState(dict.fromkeys(worn, 1e-4)))
    assert (sizes.links, sizes.joints, sizes.full_unknowns) == (6, 7, 32)
    assert sizes.freedoms == 4 + 2 * len(worn)
    assert sizes.integrated == sizes.freedoms - 1
    assert len(sizes.coordinates) - len(sizes.closures) == sizes.integrated
    assert set(sizes.clearance_joints) == set(worn)


def test_what_is_left_out_is_named() -> None:
    machine = parse_machine(
        {
            "name": "pendulum",
            "gravity": 0,
            "links": {"wall": {"fixed": True}, "bob": {"mass": 1, "inertia": 0.01, "cg": [0, -1]}},
            "joints": {"P": {"kind": "turning", "links": ["bob", "wall"], "at": [0, 0]}},
        }
    )
    sizes = account(machine, HEALTHY)
    assert sizes.freedoms == sizes.integrated == 1
    left = dict(sizes.left_out)
    assert left["motion of wall"] == "the frame is fixed"
    assert left["contact of P"] == "no clearance in this fault state"
    assert {"gravity", "external loads", "supports", "viscous torque of P"} <= set(left)
