"""What is uncertain unless a plan says otherwise: from the machine's own numbers."""

from __future__ import annotations

from typing import Any

import pytest

from jointplay.catalogue.building.chunk import cut_chunks, simulate_chunk
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.parameters import MachineNumbers, Scatter
from jointplay.catalogue.plans.plan import parse_plan, preset
from jointplay.catalogue.plans.plan_parts import Distribution, default_laws, default_uncertain, default_wide
from jointplay.catalogue.plans.variants import Variant, output_load
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine

SLIDER_CRANK = shipped_machine("slider-crank")


def changed(**parts: Any) -> Machine:
    tree: dict[str, Any] = SLIDER_CRANK.model_dump(mode="json")
    tree.update(parts)
    return parse_machine(tree)


def test_load_acts_on_what_does_the_work() -> None:
    slide = output_load(SLIDER_CRANK)
    assert slide is not None
    assert (slide.link, slide.direction, slide.arm) == ("slider", (1.0, 0.0), 0.0)
    rocker = output_load(shipped_machine("four-bar"))
    assert rocker is not None
    assert rocker.link not in ("crank", "frame")
    assert rocker.direction == (0.0, 0.0)
    # A torque is the force times the length of the link.
    bar = shipped_machine("four-bar")
    weight = 9.81 * sum(link.mass or 0.0 for name, link in bar.links.items() if name != bar.frame)
    bounds = default_wide(bar)["load"].either_loguniform
    assert bounds is not None
    inertia = weight / 9.81 * 0.06 * 31.416**2  # the crank's length, and its speed
    assert bounds[1] == pytest.approx((weight + inertia) * rocker.arm, rel=0.005)
    assert bounds[0] == pytest.approx(0.01 * bounds[1], rel=0.005)


def test_a_machine_without_an_output_link_has_no_load() -> None:
    tree: dict[str, Any] = SLIDER_CRANK.model_dump(mode="json")
    links = {name: link for name, link in tree["links"].items() if name in ("frame", "crank")}
    alone = parse_machine({**tree, "links": links, "joints": {"O": tree["joints"]["O"]}})
    assert output_load(alone) is None
    assert "load" not in default_wide(alone)


def test_a_motor_that_bears_no_load_has_none() -> None:
    """Its torque is the same at any speed, so that nothing makes up for a load."""
    for curve, has_load in (([[0, 5], [400, 5]], False), ([[0, 6], [400, -6]], True)):
        machine = changed(drive={"kind": "torque", "joint": "O", "curve": curve})
        assert ("load" in default_wide(machine)) is has_load
        assert preset("standard").resolve(machine).wide.draws == 1.0


def test_springs_and_dampers_have_one_factor_each() -> None:
    at = {"link": "frame", "at": [0.0, -0.1], "anchor": [0.0, -0.2]}
    springs = [{**at, "kind": "spring", "stiffness": 1e5}, {**at, "kind": "damper", "damping": 100.0}]
    machine = changed(supports=springs)
    wide = default_wide(machine)
    assert {path for path in wide if path.startswith("supports")} == {"supports.stiffness", "supports.damping"}
    targets = MachineNumbers(machine).targets("supports.stiffness")
    assert [(target.path, target.nominal) for target in targets] == [("supports.0.stiffness", 1e5)]
    assert {path for path in default_wide(SLIDER_CRANK) if path.startswith("supports")} == {
        *(f"supports.{name}.{axis}" for name in ("stiffness", "damping") for axis in "xy"),
        *(f"supports.{mount}.{name}" for name in ("stiffness", "damping") for mount in (0, 1)),
    }


def test_factors_of_one_number_multiply() -> None:
    spread = {
        "supports.stiffness.x": Distribution(factor_uniform=(2.0, 2.0 + 1e-12)),
        "supports.1.stiffness": Distribution(factor_uniform=(3.0, 3.0 + 1e-12)),
    }
    numbers = MachineNumbers(SLIDER_CRANK)
    found = Scatter(numbers, spread).parameters([0.5, 0.5], 1.0)
    factors = {path: value / numbers.by_path[path] for path, value in found.items()}
    expected = {"supports.0.stiffness.0": 2.0, "supports.1.stiffness.0": 6.0, "supports.1.stiffness.1": 3.0}
    assert factors == {path: pytest.approx(factor) for path, factor in expected.items()}


def test_numbers_of_contacts_follow_the_laws() -> None:
    assert default_laws(SLIDER_CRANK) == {"own": 1.0, "hertz": 1.0}
    linear = set(default_uncertain(SLIDER_CRANK, {"own": 1.0}))
    both = set(default_uncertain(SLIDER_CRANK, default_laws(SLIDER_CRANK)))
    assert both - linear == {"contact.hysteresis"}
    joints = SLIDER_CRANK.model_dump(mode="json")["joints"]
    for joint in joints.values():
        if joint["kind"] == "turning":
            joint["contact"] = {"law": "flores", "stiffness": 1e9, "restitution": 0.8}
    flores = changed(joints=joints)
    assert default_laws(flores) == {"own": 1.0, "linear": 1.0}
    found = default_uncertain(flores, {"own": 1.0})
    assert found["contact.restitution"].uniform == pytest.approx((0.55, 1.0))
    assert "contact.damping" not in found
    contact = Variant("linear").machine(flores).joints["A"].contact  # type: ignore[union-attr]
    assert (contact.law, contact.stiffness) == ("linear", pytest.approx(1e9 * 40e-6**0.5))
    assert contact.damping > 0


def test_where_surfaces_stick_by_how_much_they_give_way_is_drawn() -> None:
    joints = SLIDER_CRANK.model_dump(mode="json")["joints"]
    for joint in joints.values():
        if joint["kind"] == "turning":
            joint["contact"] = {"stiffness": 1e7, "damping": 300.0, "friction": 0.05, "friction_law": "bristle"}
    sticking = changed(joints=joints)
    plan = parse_plan({"draws": {"healthy": 8, "single": 8}, "fits": {"silent": 0}, "guard": 0, "seconds": 0})
    entries = [entry for entry in entries_of(plan, sticking) if entry.worn == ("B",)]
    drawn = [entry.parameters[f"joints.{joint}.contact.presliding"] for entry in entries for joint in "ABO"]
    assert 3e-9 <= min(drawn) < 3e-8 and 1e-7 < max(drawn) <= 1e-6
    assert {entry.variant.law for entry in entries} == {"own", "hertz"}
    assert all("presliding" not in path for path in default_uncertain(SLIDER_CRANK, {"own": 1.0}))
    for chunk in cut_chunks(sticking, plan.recipe(sticking), entries, 8):
        assert {outcome.status for outcome in simulate_chunk(chunk)} == {"ok"}


def test_machines_without_a_pin_radius_draw_none() -> None:
    joints = SLIDER_CRANK.model_dump(mode="json")["joints"]
    for joint in joints.values():
        joint.pop("pin_radius", None)
    assert "pin_radius" in default_uncertain(SLIDER_CRANK, {"own": 1.0})
    assert "pin_radius" not in default_uncertain(changed(joints=joints), {"own": 1.0})
