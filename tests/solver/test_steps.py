"""The step and the transient follow from the scene by stated rules."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from test_simulate import crank_at

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.positions import mobility_of
from jointplay.solver.cases.rates import ContactRates, contact_rates, friction_rate
from jointplay.solver.cases.start import walk
from jointplay.solver.cases.steps import (
    LEAST_RESPONSE,
    RESIDUE,
    STEP_RULES,
    contact_mobility,
    largest_step,
    response,
    suspension_modes,
    suspension_of,
    transient_time,
)
from jointplay.solver.equations.model import build_model
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate


def test_mobility_of_a_free_pin_is_the_sum_of_both_bodies() -> None:
    """Slider-crank with the rod-slider joint open: from the slider's side 1/m at least, along the line."""
    model = build_model(shipped_machine("slider-crank"), ["B"])
    p = model.vector({})
    mobility = contact_mobility(model, walk(model, p, 60.0, steps=12), p)
    # The slider alone gives 1 / 0.5 kg along its guide; the rod's end adds its own.
    assert mobility["B"] > 1 / 0.5
    assert mobility["B"] < 1 / 0.5 + 1 / 0.05


def test_stiffer_contacts_take_smaller_steps() -> None:
    rule, machine = STEP_RULES["standard"], shipped_machine("slider-crank")

    def step(stiffness: float, damping: float) -> float:
        values = {"joints.B.contact.stiffness": stiffness, "joints.B.contact.damping": damping}
        rates = contact_rates(machine, {"B": 4.0}, values, 0.0)
        return largest_step(rule, rates.values(), np.zeros(0), 0.0)

    assert step(1e7, 0.0) == pytest.approx(rule.contact / math.sqrt(4e7))
    assert step(1e9, 0.0) == pytest.approx(step(1e7, 0.0) / 10)
    assert step(1e7, 1e6) == pytest.approx(rule.decay / 4e6)


@pytest.mark.parametrize("law", [{}, {"law": "hertz", "hysteresis": 0.5}, {"law": "flores", "restitution": 0.8}])
def test_bodies_that_cannot_move_do_not_swing(law: dict[str, Any]) -> None:
    tree = shipped_machine("slider-crank").model_dump(mode="json", exclude_unset=True)
    tree["joints"]["B"]["contact"] = {"stiffness": 1e9, **law}
    values = {"joints.B.contact.stiffness": 1e9, "joints.B.clearance": 1e-4, "joints.B.contact.restitution": 0.8}
    assert contact_rates(parse_machine(tree), {"B": 0.0}, values, 60.0)["B"] == ContactRates(0.0, 0.0)


def test_friction_settles_a_block_at_its_rate() -> None:
    """mu N / (m v0) on a floor; a pin of the same weight hits with what it gathers across its play as well."""
    guide = {"kind": "sliding", "links": ["block", "bed"], "at": [0, 0], "direction": [1, 0]}
    tree = {
        "name": "block",
        "links": {"bed": {"fixed": True}, "block": {"mass": 2.0, "inertia": 0.01, "cg": [0, 0]}},
        "joints": {"G": {**guide, "friction": 0.3, "friction_velocity": 0.02}},
    }
    model = build_model(parse_machine(tree))
    rate = friction_rate(model, [(0.0, np.zeros(model.size))], model.vector({}), {}, {})
    assert rate == pytest.approx(0.3 * 9.81 / 0.02)
    contact = {"stiffness": 1e6, "damping": 0, "friction": 0.3, "friction_velocity": 0.02}
    pin = {"kind": "turning", "links": ["block", "bed"], "at": [0, 0], "contact": contact}
    model = build_model(parse_machine({**tree, "joints": {"P": pin}}), ["P"])
    values = {**model.nominal, "joints.P.clearance": 1e-4}
    rate = friction_rate(model, [(0.0, np.zeros(model.size))], model.vector(values), values, {"P": 1 / 2.0})
    assert rate == pytest.approx(0.3 * (2 * 9.81 + math.sqrt(1e6 * 4e-4 * 2 * 9.81)) / 2.0 / 0.02)


def test_fixed_steps_resolve_strong_friction() -> None:
    """A contact friction of 1: with steps of the contact's frequency alone peaks came out three times too high."""
    case = Case(Fault({"B": 2e-4}), {"contact.friction": 1.0})
    machine = shipped_machine("slider-crank")
    fixed, controlled = (
        simulate(machine, case, Settings(duration=0.2, method=method, accuracy=accuracy))  # type: ignore[arg-type]
        for method, accuracy in (("gill", "standard"), ("adaptive", "reference"))
    )
    assert fixed.status is controlled.status is Status.OK
    peaks = [np.abs(history.acceleration).max(axis=0) for history in (fixed, controlled)]
    # Measured: 0.1 % in x and y, 12 % in theta, which is chaotic here.
    assert peaks[0] == pytest.approx(peaks[1], rel=0.3)


def step_of(machine: Machine, parameters: dict[str, float] | None = None) -> float:
    """Longest step of `gill` with a worn B, s."""
    case = Case(Fault({"B": 2e-4}), parameters or {})
    return next(groups(machine, [case], Settings(method="gill", duration=0.1))).ready[0].longest_step


def test_steps_follow_the_masses_of_a_case() -> None:
    """A case's light slider is as fast as a light slider in the file."""
    machine = shipped_machine("slider-crank")
    light = machine.links["slider"].model_copy(update={"mass": 1e-3})
    filed = machine.model_copy(update={"links": {**machine.links, "slider": light}})
    assert step_of(machine, {"links.slider.mass": 1e-3}) == step_of(filed)
    assert step_of(filed) < 0.1 * step_of(machine)


def test_mobility_is_the_largest_of_the_poses() -> None:
    """All poses together give what each gives alone."""
    model = build_model(shipped_machine("quick-return"), ("A", "F"))
    p = model.vector({})
    poses = walk(model, p, 12.0)[::17]
    alone = [contact_mobility(model, [pose], p) for pose in poses]
    together = contact_mobility(model, poses, p)
    assert together == {joint: max(one[joint] for one in alone) for joint in ("A", "F")}
    assert len({one["F"] for one in alone}) == len(poses)


def test_mobility_knows_no_contact_ripple_or_load() -> None:
    """What variants share is what the model of the variant itself gives."""
    machine = shipped_machine("quick-return")
    tree = machine.model_dump()
    tree["joints"]["F"]["contact"] = {"law": "hertz", "stiffness": 1e9, "hysteresis": 1.0}
    tree["drive"]["ripple"] = [{"order": 2, "amplitude": 0.05, "phase": 0.0}]
    tree["loads"] = [{"link": "ram", "at": [0.0, 0.0], "force": [100.0, 0.0]}]
    variant = parse_machine(tree)
    masses = {"links.ram.mass": 5.0}
    drive = variant.drive.model_copy(update={"speed": 1.0, "ripple": ()})
    model = build_model(variant.model_copy(update={"drive": drive}), ("A", "F"), tuple(masses))
    p = model.vector(masses)
    poses = walk(model, p, 1.0)
    own = contact_mobility(model, poses[:: len(poses) // 12], p)
    assert mobility_of(variant, ("A", "F"), masses) == pytest.approx(own, rel=1e-12)
    assert mobility_of(machine, ("A", "F"), masses) == mobility_of(variant, ("A", "F"), masses)
    assert mobility_of(variant, ("A", "F"), {}) != mobility_of(variant, ("A", "F"), masses)


@pytest.mark.parametrize("name", ["quick-return", "four-bar"])
def test_cases_share_the_functions_of_their_model(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another mass, another mount: no expression is derived again, or a case would cost several times its run."""
    machine = shipped_machine(name)
    link = f"links.{machine.frame}.mass"

    def case(factor: float) -> Case:
        numbers = {link: 50.0 * factor, "supports.0.stiffness.0": 1e5 * factor, "drive.speed": 10 * factor}
        return Case(Fault({"A": 1e-4}), numbers)

    first = next(groups(machine, [case(1.0)], Settings())).ready[0]
    for made in ("Function", "jacobian", "jtimes"):
        monkeypatch.delattr(f"casadi.{made}")
    second = next(groups(machine, [case(1.1)], Settings())).ready[0]
    assert second.longest_step != first.longest_step


def test_steps_of_a_ram_that_only_swings() -> None:
    """A travel speed of 0 is one: at 1 m/s friction would ask for steps a thousand times shorter."""
    drive = {"kind": "translation", "joint": "G", "harmonics": [{"frequency": 5, "amplitude": 0.003, "phase": 1}]}
    step = step_of(parse_machine(crank_at(1.0, drive=drive)))
    # Of its contact, 1.3e-5 s; friction settles in some 0.01 s.
    assert 1e-6 < step < 1e-4


def test_levels_of_accuracy_are_ordered() -> None:
    steps = [
        largest_step(STEP_RULES[level], [ContactRates(math.sqrt(4e7), 1200.0)], np.array([100j]), 60.0)
        for level in ("draft", "standard", "reference")
    ]
    assert steps == sorted(steps, reverse=True)
    assert len(set(steps)) == 3


def test_suspension_of_a_rigid_machine() -> None:
    """Modes of the quick-return on its mounts, drive standing: x and y from mass, stiffness and damping by hand."""
    machine = shipped_machine("quick-return")
    still = machine.model_copy(update={"drive": machine.drive.model_copy(update={"speed": 0.0})})
    model = build_model(still)
    modes = suspension_modes(suspension_of(model, model.vector({})))
    assert len(modes) == 3
    mass = sum(link.mass for link in machine.links.values())
    # Rotation couples a little: 1 %.
    vertical = min(modes, key=lambda s: abs(abs(s) - math.sqrt(8e5 / mass)))
    assert abs(vertical) == pytest.approx(math.sqrt(8e5 / mass), rel=0.01)
    assert -vertical.real == pytest.approx(600 / (2 * mass), rel=0.02)


def test_transient_is_whole_revolutions_of_the_slowest_decay() -> None:
    modes = [complex(-3, 60), complex(-8, 110)]
    time, remark = transient_time(modes, 4 * math.pi)
    assert remark == ""
    assert time == pytest.approx(math.ceil(math.log(1 / RESIDUE) / 3 / 0.5) * 0.5)
    assert math.exp(-3 * time) <= RESIDUE
    assert transient_time([], 4 * math.pi) == (1.0, "")
    assert transient_time(modes, 0.0)[0] == pytest.approx(math.log(1 / RESIDUE) / 3)


def test_an_undamped_suspension_is_said() -> None:
    time, remark = transient_time([complex(0, 62.83), complex(-5, 100)], 4 * math.pi)
    assert "undamped suspension mode at 10 Hz" in remark
    assert time == pytest.approx(1.0)
    _, remark = transient_time([complex(0, 62.83), complex(0, 6.283e6)], 4 * math.pi, 1e4)
    stays, damped = remark.split("; ")
    assert stays == "undamped suspension mode at 10 Hz: its start-up transient stays in the spectra"
    assert damped == "undamped suspension mode at 1e+06 Hz: implicit steps do not follow how it rings, and damp it"


def test_a_slow_machine_is_held_to_what_its_frame_answers() -> None:
    modes = [complex(-2.0, 60.0), complex(-3.0, 100.0)]
    assert response(modes, 600.0) == response(modes, 0.0) == response([], 5.0) == 1.0
    assert response(modes, -6.0) == pytest.approx(0.01, rel=2e-3)
    assert response(modes, 0.1) == LEAST_RESPONSE
