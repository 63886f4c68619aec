"""The sizes of models are those of the paper, and what is missing is said."""

from __future__ import annotations

from typing import Any

import pytest
from laws import tree_of
from oracle.sketch import sketch

from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.account import Account, account


def balance(sizes: Account) -> int:
    """Unknowns of the paper's system, and those added, that are neither kept nor said to be left out."""
    kept = len(sizes.coordinates) + len(sizes.closures)
    return sizes.full_unknowns + len(sizes.added) - kept - sum(out.unknowns for out in sizes.left_out)


@pytest.mark.parametrize("worn", [(), ("A",), ("A", "F"), ("O", "A", "C", "E", "F")])
def test_freedoms_of_a_mechanism_on_a_free_frame(worn: tuple[str, ...]) -> None:
    sizes = account(shipped_machine("quick-return"), Fault(dict.fromkeys(worn, 1e-4)))
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
    left = {out.what: out.why for out in sizes.left_out}
    assert left["motion of wall"] == "the frame is fixed"
    assert left["contact of P"] == "no clearance in this fault state"
    assert {"gravity", "external loads", "supports", "viscous torque of P"} <= set(left)


@pytest.mark.parametrize("name", ["four-bar", "quick-return", "slider-crank"])
@pytest.mark.parametrize("count", [0, 1, 4])
def test_every_unknown_of_a_shipped_machine_is_accounted_for(name: str, count: int) -> None:
    machine = shipped_machine(name)
    worn = machine.turning_joints[:count]
    sizes = account(machine, Fault(dict.fromkeys(worn, 1e-4)))
    assert balance(sizes) == 0
    assert sizes.freedoms == 4 + 2 * len(worn)


@pytest.mark.long
def test_every_unknown_of_any_machine_is_accounted_for() -> None:
    """With fixed and locked links, drives of every kind, open chains and loops, joints that repeat an angle."""
    done = 0
    for scene in map(sketch, range(70)):
        try:
            sizes = account(scene.machine, Fault(scene.clearances))
        except AssemblyError:  # the drive turns what sliding pairs hold parallel
            continue
        assert balance(sizes) == 0, scene.seed
        assert sizes.integrated == len(sizes.coordinates) - len(sizes.closures), scene.seed
        done += 1
    assert done >= 60


@pytest.mark.parametrize(
    ("change", "freedoms", "integrated", "left", "added"),
    [
        ({}, 4, 3, "motion of the drive joint O", ()),
        ({"drive": None}, 4, 4, "drive", ()),
        ({"drive": {"kind": "torque", "joint": "O", "torque": 1.0}}, 4, 4, "external loads", ()),
        # The guide closes the loop: its drive stays as a closure beside it.
        ({"drive": {"kind": "translation", "joint": "G1"}}, 4, 3, "angle and couple of G1", ("G1.drive",)),
        ({"links": {"frame": {"fixed": True}}}, 1, 0, "supports.0", ()),
        ({"links": {"frame": {"mass": 20, "inertia": 0.5, "cg": [0, 0], "locked": ["x", "theta"]}}}, 2, 1,
         "theta(frame)", ()),
        ({"links": {"slider": {"mass": 1, "inertia": 1, "cg": [0.2, 0.05], "locked": ["y"]}}}, 3, 2,
         "motion of the drive joint O", ("slider.locked.y",)),
    ],
)  # fmt: skip
def test_freedoms_of_the_slider_crank(
    change: dict[str, Any], freedoms: int, integrated: int, left: str, added: tuple[str, ...]
) -> None:
    tree = tree_of("slider-crank")
    tree |= {**change, "links": tree["links"] | change.get("links", {}), "sensors": []}
    sizes = account(parse_machine(tree), HEALTHY)
    assert (sizes.freedoms, sizes.integrated, sizes.full_unknowns) == (freedoms, integrated, 20)
    assert any(left in out.what for out in sizes.left_out)
    assert sizes.added == added
    assert balance(sizes) == 0


def test_links_held_parallel_twice() -> None:
    """Three wedges that slide on each other: the third sliding joint has no angle left to fulfil."""
    tree = {
        "name": "wedges",
        "links": {"base": {"fixed": True}, **{name: {"mass": 1, "inertia": 1, "cg": [0, 0]} for name in ("a", "b")}},
        "joints": {
            "P": {"kind": "sliding", "links": ["a", "base"], "at": [0, 0], "direction": [1, 0]},
            "Q": {"kind": "sliding", "links": ["b", "base"], "at": [0, 0], "direction": [0, 1]},
            "R": {"kind": "sliding", "links": ["b", "a"], "at": [0, 0], "direction": [1, 1]},
        },
    }
    sizes = account(parse_machine(tree), HEALTHY)
    assert (sizes.freedoms, sizes.closures) == (1, ("R.normal",))
    assert "couple of R" in [out.what for out in sizes.left_out]
    assert balance(sizes) == 0


def test_viscous_torque_of_a_worn_joint_is_said_to_be_left_out() -> None:
    tree = tree_of("slider-crank")
    tree["joints"]["B"]["viscous"] = 0.1
    left = {out.what: out.why for out in account(parse_machine(tree), Fault({"B": 1e-4})).left_out}
    assert left["viscous torque of B"] == "only while the joint has no clearance"
