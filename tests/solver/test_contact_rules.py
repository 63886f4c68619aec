"""Contact laws in the machine file: what belongs to which law, what a joint takes over, what a case may vary."""

from __future__ import annotations

from typing import Any

import pytest

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.joints import Contact, TurningJoint
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

Tree = dict[str, Any]
FLORES = {"law": "flores", "stiffness": 1e10, "restitution": 0.9}
HERTZ = {"law": "hertz", "stiffness": 1e9, "hysteresis": "0.3 s/m"}


def machine(default: Tree, joint: Tree | None = None) -> Machine:
    """The slider-crank with this contact everywhere, and this one in joint A."""
    tree: Tree = shipped_machine("slider-crank").model_dump(mode="json")
    for name in "OAB":
        del tree["joints"][name]["contact"]
    tree["defaults"] = {"contact": default}
    if joint is not None:
        tree["joints"]["A"]["contact"] = joint
    return parse_machine(tree, "my.yaml")


def contact(default: Tree, joint: Tree | None = None) -> Contact:
    found = machine(default, joint).joints["A"]
    assert isinstance(found, TurningJoint)
    return found.contact


def test_what_a_law_is_completed_with() -> None:
    found = contact(FLORES)
    assert (found.law, found.exponent, found.restitution, found.damping, found.hysteresis) == (
        "flores", 1.5, 0.9, 0.0, None,
    )  # fmt: skip
    assert contact({}).exponent is None
    assert contact(HERTZ | {"exponent": 1.1}).exponent == 1.1


def test_numbers_of_a_law_do_not_pass_to_another_law() -> None:
    default = FLORES | {"friction": 0.2}
    same = contact(default, {"stiffness": 2e10})
    assert (same.law, same.stiffness, same.restitution, same.friction) == ("flores", 2e10, 0.9, 0.2)
    linear = contact(default, {"law": "linear"})
    assert (linear.stiffness, linear.damping, linear.restitution, linear.friction) == (1e7, 300.0, None, 0.2)
    assert contact(default, HERTZ).restitution is None


@pytest.mark.parametrize("law", [FLORES, HERTZ, HERTZ | {"hysteresis": 0}, {"damping": 0}])
def test_a_machine_is_read_again_as_it_was_written(law: Tree) -> None:
    written = machine(law, {"friction": 0.3})
    assert parse_machine(written.canonical_json()) == written


@pytest.mark.parametrize(
    ("default", "joint", "line"),
    [
        ({"law": "flors"}, None,
         "defaults.contact.law: flors: must be linear, hertz, hunt-crossley, flores, gonthier or lankarani-nikravesh"),
        ({"law": 5}, None,
         "defaults.contact.law: 5: must be linear, hertz, hunt-crossley, flores, gonthier or lankarani-nikravesh"),
        ({"restitution": 0.9}, None,
         "defaults.contact.restitution: 0.9: law linear has no restitution, it has stiffness and damping"),
        ({}, {"exponent": 1.5},
         "joints.A.contact.exponent: 1.5: law linear has no exponent, it has stiffness and damping"),
        (FLORES | {"damping": 10}, None, "defaults.contact.damping: 10: law flores has no damping, "
         "it has stiffness, exponent and restitution"),
        (FLORES, {"hysteresis": 1}, "joints.A.contact.hysteresis: 1: law flores has no hysteresis, "
         "it has stiffness, exponent and restitution"),
        (FLORES | {"restitution": 1.1}, None, "defaults.contact.restitution: 1.1: must not be greater than 1"),
        (FLORES | {"restitution": 0}, None, "defaults.contact.restitution: 0: must not be less than 0.01"),
        (FLORES | {"exponent": 0.5}, None, "defaults.contact.exponent: 0.5: must not be less than 1"),
        (HERTZ | {"hysteresis": "2 m/s"}, None, 'defaults.contact.hysteresis: 2 m/s: "m/s" is a speed, '
         'must be a hysteresis factor, for example "0.3 s/m"'),
        (HERTZ | {"hysteresis": -1}, None, "defaults.contact.hysteresis: -1: must not be less than 0"),
        ({"law": "gonthier", "restitution": 0.9}, None,
         "defaults.contact.stiffness: is missing; law gonthier needs it, and joints.O has none"),
        ({"law": "hertz", "stiffness": 1e9}, {"friction": 0.1},
         "defaults.contact.hysteresis: is missing; law hertz needs it, and joints.O has none"),
        (FLORES, {"law": "hertz", "stiffness": 1e9},
         "joints.A.contact.hysteresis: is missing; law hertz needs it"),
        ({}, {"law": "hertz", "stiffness": 1e9}, "joints.A.contact.hysteresis: is missing; law hertz needs it"),
        (FLORES | {"stiffness": "10 kN/mm"}, None, "defaults.contact.stiffness: 10 kN/mm: must be a plain number: "
         "with this law it is in N/m^n, n the exponent"),
        (FLORES, {"stiffness": "10 kN/mm"}, "joints.A.contact.stiffness: 10 kN/mm: must be a plain number: "
         "with this law it is in N/m^n, n the exponent"),
    ],
)  # fmt: skip
def test_refused(default: Tree, joint: Tree | None, line: str) -> None:
    with pytest.raises(MachineError) as refusal:
        machine(default, joint)
    assert str(refusal.value) == f"my.yaml: {line}"


def test_a_linear_contact_may_have_units_beside_another_law() -> None:
    assert contact(FLORES, {"law": "linear", "stiffness": "20 kN/mm"}).stiffness == 2e7
    assert contact(FLORES | {"stiffness": "1e10"}).stiffness == 1e10


def simulated(found: Machine, parameters: dict[str, float]) -> str:
    return simulate(found, Case(Fault({"A": 1e-4}), parameters), Settings(duration=1e-3)).message


def test_numbers_that_a_case_varies() -> None:
    found = machine(FLORES | {"restitution": 0.95})
    assert simulated(found, {}) == ""
    assert simulated(found, {"contact.restitution": 0.5}) == (
        "joint A: contact law flores asked for a restitution of 0.5 returns 0.47"
    )
    assert simulated(found, {"joints.A.contact.restitution": 0.5, "contact.restitution": 0.95}) != ""
    # A catalogue varies the damping of whatever machine: nothing times a factor is nothing.
    assert simulated(found, {"contact.damping": 0.0, "joints.A.contact.damping": 0.0}) == ""
    assert simulated(machine(HERTZ), {"contact.hysteresis": 0.1}) == ""


@pytest.mark.parametrize(
    ("law", "path", "value", "rule"),
    [
        (FLORES, "contact.damping", 10.0, "no contact law of this machine has a damping"),
        (FLORES, "joints.A.contact.hysteresis", 0.1, "the contact law of this joint has no hysteresis"),
        (FLORES, "contact.restitution", 0.0, "must be between 0.01 and 1"),
        (FLORES, "joints.A.contact.restitution", 1.5, "must be between 0.01 and 1"),
        (HERTZ, "contact.hysteresis", -1.0, "must not be negative"),
        ({}, "contact.restitution", 0.9, "no contact law of this machine has a restitution"),
    ],
)
def test_numbers_that_a_case_cannot_have(law: Tree, path: str, value: float, rule: str) -> None:
    with pytest.raises(MachineError, match=rule):
        simulated(machine(law), {path: value})
