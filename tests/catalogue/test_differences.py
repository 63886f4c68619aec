"""What machines of an evaluation differ by from their files: of which kind, and by how much."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jointplay.catalogue.diagnosing.cause_families import IdealFrame, families_of
from jointplay.catalogue.diagnosing.frame_forces import Revolution
from jointplay.catalogue.evaluation.differences import DIFFERENCES, with_differences
from jointplay.catalogue.evaluation.protocols import PROTOCOLS, draw_truth
from jointplay.catalogue.plans.driving import nominal_drive_speed
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.plans.variants import output_load
from jointplay.solver.machines.machine import shipped_machine

PROTOCOL = PROTOCOLS["matched"]
MACHINE = shipped_machine("slider-crank")


@pytest.mark.parametrize("name", DIFFERENCES)
@pytest.mark.parametrize("machine", ["slider-crank", "four-bar", "quick-return"])
def test_every_difference_changes_the_machine_and_nothing_else(name: str, machine: str) -> None:
    drawn = shipped_machine(machine)
    joint = drawn.turning_joints[0]
    plain = draw_truth(drawn, Hypothesis.of([joint]), PROTOCOL, 1, 0)
    truth = with_differences(plain, (name,), 1, 0)
    assert truth == with_differences(plain, (name,), 1, 0)
    assert truth.clearances == plain.clearances
    assert truth.parameters["drive.speed"] == plain.parameters["drive.speed"]
    changed = {
        field
        for field in ("machine", "parameters", "response", "gains")
        if getattr(truth, field) != getattr(plain, field)
    }
    expected = {
        "law": {"machine", "parameters"},
        "resonance": {"response"},
        "mode": {"response"},
        "frame": {"parameters"},
        "gain": {"gains"},
        "load": {"machine", "parameters"},
        "half-mount": {"parameters"},
        "loose-mount": {"parameters"},
        "soft-mounts": {"parameters"},
        "frame-mass": {"parameters"},
        "ripple": {"machine", "parameters"},
        "cyclic-load": {"machine", "parameters"},
        "motor-ripple": {"machine", "parameters"},
        "bent-rail": {"machine"},
        "unbalance": {"machine"},
    }
    assert changed == expected[name]


def test_sizes_of_differences() -> None:
    plain = draw_truth(MACHINE, Hypothesis.of(["A"]), PROTOCOL, 3, 0)
    frame = with_differences(plain, ("frame",), 1, 0).parameters
    assert 0.8 <= frame["links.frame.mass"] / MACHINE.links["frame"].mass <= 1.2  # type: ignore[operator]
    half = with_differences(plain, ("half-mount",), 1, 0).parameters
    stiffness = {path: value for path, value in half.items() if path.startswith("supports.")}
    assert len(stiffness) == 2
    for path, value in stiffness.items():
        _, index, _, axis = path.split(".")
        assert value == pytest.approx(0.5 * MACHINE.supports[int(index)].stiffness[int(axis)])  # type: ignore[union-attr, index]
    load = with_differences(plain, ("load",), 1, 0)
    force = math.hypot(*(load.parameters[f"loads.0.force.{axis}"] for axis in range(2)))
    assert 20.0 <= force <= 100.0
    assert load.machine.loads[0].force == (0.0, 0.0)


def test_other_causes_carry_the_names_that_answers_have_for_them() -> None:
    plain = draw_truth(MACHINE, Hypothesis.of(["A"]), PROTOCOL, 3, 0)
    families = {family.name for family in families_of(IdealFrame.of(MACHINE, nominal_drive_speed(MACHINE)))}
    named = {name: with_differences(plain, (name,), 1, 0).causes for name in DIFFERENCES}
    assert {name for name, causes in named.items() if not causes} == {
        *("law", "resonance", "mode", "frame", "gain", "bent-rail")
    }
    for causes in named.values():
        assert families.issuperset(causes)
    both = with_differences(plain, ("load", "unbalance"), 1, 0)
    assert both.causes == ("load", "unbalance")


def test_sizes_of_what_answers_have_a_name_for() -> None:
    plain = draw_truth(MACHINE, Hypothesis.of(["A"]), PROTOCOL, 3, 0)
    body = MACHINE.links["frame"]
    for number in range(8):
        loose = with_differences(plain, ("loose-mount",), 1, number)
        place = int(loose.causes[0].removeprefix("mount "))
        own = MACHINE.supports[place].stiffness  # type: ignore[union-attr]
        changed = [loose.parameters[f"supports.{place}.stiffness.{axis}"] for axis in range(2)]
        assert changed == pytest.approx([0.1 * each for each in own])  # type: ignore[union-attr]
        soft = with_differences(plain, ("soft-mounts",), 1, number).parameters
        factors = {
            soft[f"supports.{index}.stiffness.{axis}"] / support.stiffness[axis]  # type: ignore[union-attr, index]
            for index, support in enumerate(MACHINE.supports)
            for axis in range(2)
        }
        assert 0.4 <= min(factors)
        assert max(factors) == pytest.approx(min(factors))
        assert max(factors) <= 0.75
        frame = with_differences(plain, ("frame-mass",), 1, number).parameters
        factor = frame["links.frame.mass"] / body.mass  # type: ignore[operator]
        assert 0.2 <= abs(factor - 1.0) <= 0.4
        assert frame["links.frame.inertia"] / body.inertia == pytest.approx(factor)  # type: ignore[operator]
        rippled = with_differences(plain, ("ripple",), 1, number)
        order = int(rippled.causes[0].rpartition(" ")[2])
        sizes = [v for path, v in rippled.parameters.items() if path.startswith("drive.ripple")]
        assert 0.005 <= order * math.hypot(*sizes) <= 0.015


@pytest.mark.parametrize("machine", ["slider-crank", "four-bar"])
def test_a_cyclic_load_works_against_one_stroke_and_shares_its_model(machine: str) -> None:
    drawn = shipped_machine(machine)
    place = output_load(drawn)
    assert place is not None
    revolution = Revolution.of(drawn, nominal_drive_speed(drawn))
    velocity = revolution.velocity(place.link, place.direction)
    angle = 2.0 * math.pi * np.arange(len(velocity)) / len(velocity)
    weight = 9.81 * sum(link.mass or 0.0 for name, link in drawn.links.items() if name != drawn.frame)
    truths = [
        with_differences(draw_truth(drawn, Hypothesis.of(()), PROTOCOL, 1, 0), ("cyclic-load",), 1, n) for n in range(6)
    ]
    assert len({truth.machine for truth in truths}) == 1
    for truth in truths:
        force = np.zeros(len(angle))
        for index, load in enumerate(truth.machine.loads):
            numbers = (truth.parameters.get(f"loads.{index}.force.{axis}", 0.0) for axis in range(2))
            size = float(np.dot(list(numbers), place.direction)) + truth.parameters.get(f"loads.{index}.torque", 0.0)
            force += size * (1.0 if load.order is None else np.sin(load.order * angle + load.phase))
        force /= place.arm or 1.0
        power = force * velocity
        working = np.abs(force) > 0.5 * np.abs(force).max()
        assert (power[working] < 0.0).mean() > 0.95
        assert 0.9 * weight < np.abs(force).max() < 3.3 * weight
        # On the other stroke there is next to none.
        idle = np.sign(velocity) != np.sign(np.median(velocity[working]))
        assert np.abs(np.median(force[idle])) < 0.05 * np.abs(force).max()
