"""What choices of the model change and cost."""

from __future__ import annotations

import math

import pytest

from jointplay.solver.cases.case import Case, Status
from jointplay.solver.machines.equal_contact import EQUAL_PENETRATION, equal_contact
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.choices import ModelChoices, measure_choices


@pytest.fixture(scope="module")
def choices() -> ModelChoices:
    found = measure_choices(shipped_machine("slider-crank"), Case(Fault({"B": 2e-4})))
    assert isinstance(found, ModelChoices)
    return found


def test_friction_is_what_matters_where_sliding_turns_round(choices: ModelChoices) -> None:
    """Laws near Coulomb's agree with each other to a tenth of what the file's 10 mm/s is away from them."""
    changed = {each.name: each.difference_db for each in choices.choices if each.kind == "friction"}
    assert "{friction_law: tanh, friction_velocity: 0.01}" not in changed  # the file's own
    laws = ("bristle, presliding: 3e-09", "tanh, friction_velocity: 0.0001")
    near = [changed[f"{{friction_law: {law}}}"] for law in laws]
    assert near[0] == pytest.approx(near[1], abs=0.03)
    assert 0.6 < near[0] < 1.1
    assert changed["{friction: 0}"] > 3


def test_records_and_rates(choices: ModelChoices) -> None:
    changed = {each.name: each.difference_db for each in choices.choices}
    assert changed["2 revolutions"] > changed["5 revolutions"] > choices.floor_db
    assert changed["--sample-rate 10000Hz"] < 0.02
    assert changed["{law: hertz}, as stiff at 40 um"] > 1


def test_every_choice_is_measured_and_costs_something(choices: ModelChoices) -> None:
    assert not choices.chaotic
    assert 0 < choices.floor_db < 1e-5
    for each in choices.choices:
        assert each.status is Status.OK
        assert each.seconds > 0
        assert math.isfinite(each.difference_db)


def test_equal_contacts_are_as_stiff_at_their_penetration() -> None:
    machine = shipped_machine("four-bar")
    joint = machine.joints["A"]
    assert isinstance(joint, TurningJoint)
    hertz = equal_contact(machine, joint, "hertz")
    assert hertz.stiffness * EQUAL_PENETRATION**1.5 == pytest.approx(joint.contact.stiffness * EQUAL_PENETRATION)
    assert (hertz.friction_law, hertz.friction_velocity) == (
        joint.contact.friction_law,
        joint.contact.friction_velocity,
    )
    assert equal_contact(machine, joint, "linear") is joint.contact
