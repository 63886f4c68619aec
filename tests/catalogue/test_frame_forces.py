"""What ideal links do to their frame, against the closed-form kinematics of a slider-crank."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from jointplay.catalogue.diagnosing.frame_forces import SAMPLES, Revolution, family_wrenches, wrench_orders
from jointplay.catalogue.errors import DiagnosisError
from jointplay.solver.machines.machine import Machine, shipped_machine

FloatArray = NDArray[np.float64]

SPEED = 65.0
R, L, HEIGHT = 0.05, 0.15, 0.05  # crank, rod, and height of crank shaft and guide above the frame's centre of gravity
G = 9.81
CRANK, ROD, SLIDER = 0.3, 0.25, 0.5
ROD_INERTIA = 6e-4
RATIO = R / L
EVEN = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES


@pytest.fixture(scope="module")
def revolution() -> Revolution:
    return Revolution.of(shipped_machine("slider-crank"), SPEED)


def crank_angle(revolution: Revolution) -> FloatArray:
    """Crank angle from the drawn pose: even in time."""
    found: FloatArray = float(revolution.angle[0, revolution.links.index("crank")]) + EVEN
    return found


@dataclass(frozen=True)
class Body:
    """Mass, centre of gravity and angle with their accelerations."""

    mass: float
    inertia: float
    x: FloatArray
    y: FloatArray
    ax: FloatArray
    ay: FloatArray
    turning: FloatArray


def bodies(angle: FloatArray, rate: FloatArray, change: FloatArray) -> dict[str, Body]:
    """Links of a slider-crank whose crank has an angle with these derivatives."""
    sine, cosine = np.sin(angle), np.cos(angle)
    # The rod leans down where the crank pin is up: sin(lean) = RATIO sin(angle).
    lean = -np.arcsin(RATIO * sine)
    lean_rate = -RATIO * cosine * rate / np.cos(lean)
    lean_change = (RATIO * (sine * rate**2 - cosine * change) + np.sin(lean) * lean_rate**2) / np.cos(lean)

    def crank(part: float) -> list[FloatArray]:
        return [
            part * R * cosine,
            part * R * sine,
            part * R * (-sine * change - cosine * rate**2),
            part * R * (cosine * change - sine * rate**2),
        ]

    def rod(part: float) -> list[FloatArray]:
        own = [
            part * L * np.cos(lean),
            part * L * np.sin(lean),
            part * L * (-np.sin(lean) * lean_change - np.cos(lean) * lean_rate**2),
            part * L * (np.cos(lean) * lean_change - np.sin(lean) * lean_rate**2),
        ]
        return [first + second for first, second in zip(crank(1.0), own, strict=True)]

    return {
        "crank": Body(CRANK, 1e-4, *crank(0.5), change),
        "rod": Body(ROD, ROD_INERTIA, *rod(0.5), lean_change),
        "slider": Body(SLIDER, 1e-4, *rod(1.0), 0.0 * lean),
    }


def wrench(parts: dict[str, Body]) -> FloatArray:
    """Inertia and weight of links as a wrench at the frame's centre of gravity."""
    total = np.zeros((SAMPLES, 3))
    for body in parts.values():
        fx, fy = -body.mass * body.ax, -body.mass * (body.ay + G)
        moment = body.x * fy - (body.y + HEIGHT) * fx - body.inertia * body.turning
        total += np.column_stack([fx, fy, moment])
    return total


def even_wrench(revolution: Revolution) -> FloatArray:
    angle = crank_angle(revolution)
    return wrench(bodies(angle, np.full(SAMPLES, SPEED), np.zeros(SAMPLES)))


def test_poses_are_those_of_a_slider_crank(revolution: Revolution) -> None:
    parts = bodies(crank_angle(revolution), np.full(SAMPLES, SPEED), np.zeros(SAMPLES))
    assert sorted(revolution.links) == ["crank", "rod", "slider"]
    assert dict(zip(revolution.links, revolution.turns.tolist(), strict=True)) == {"crank": 1, "rod": 0, "slider": 0}
    for name, body in parts.items():
        place = revolution.place[:, revolution.links.index(name)]
        assert np.allclose(place, np.column_stack([body.x, body.y + HEIGHT]), atol=1e-8)
    velocity = revolution.velocity("slider", (1.0, 0.0))
    slider = parts["slider"].x
    assert np.allclose(np.sum(velocity), 0.0, atol=1e-6)
    assert np.allclose(np.gradient(slider, 2.0 * math.pi / SPEED / SAMPLES)[2:-2], velocity[2:-2], atol=2e-3)
    assert np.allclose(revolution.velocity("crank", (0.0, 0.0)), SPEED, rtol=1e-6)


def test_wrench_of_inertia_and_weight(revolution: Revolution) -> None:
    found, expected = revolution.inertial(), even_wrench(revolution)
    assert np.allclose(found, expected, atol=1e-5 * np.abs(expected).max(axis=0))


def test_orders_1_and_2_are_those_of_the_textbook(revolution: Revolution) -> None:
    start = float(crank_angle(revolution)[0])
    turned = np.exp(1j * np.arange(1, 5) * start)
    found = wrench_orders(revolution.inertial(), 4)
    # Half of the crank and of the rod's cross motion; the series of the slider's stroke in the crank's angle.
    second = RATIO + RATIO**3 / 4 + 15 * RATIO**5 / 128
    rotating, swinging = R * SPEED**2 * (0.5 * CRANK + ROD + SLIDER), R * SPEED**2 * (0.5 * ROD + SLIDER)
    assert found[0, 0] == pytest.approx(0.5 * rotating * turned[0], rel=1e-4)
    # The series ends here: the next term of it is a thousandth.
    assert found[1, 0] == pytest.approx(0.5 * second * swinging * turned[1], rel=2e-3)
    assert abs(found[2, 0]) < 1e-5 * rotating
    across = 0.5 * R * SPEED**2 * (CRANK + ROD)
    assert found[0, 1] == pytest.approx(0.5 * across * turned[0] / 1j, rel=1e-4)
    assert np.abs(found[1:, 1]).max() < 1e-5 * rotating


def test_masses_have_factors(revolution: Revolution) -> None:
    own = revolution.inertial()
    parts = bodies(crank_angle(revolution), np.full(SAMPLES, SPEED), np.zeros(SAMPLES))
    for name, body in parts.items():
        once = wrench({name: body})
        more = revolution.inertial({name: 1.5}) - own
        assert np.allclose(more, 0.5 * once, atol=1e-5 * np.abs(once).max())


@pytest.mark.parametrize(("order", "sine", "cosine"), [(1, 0.01, 0.0), (3, 0.0, -0.004), (6, 0.002, 0.003)])
def test_ripple_of_the_drive(revolution: Revolution, order: int, sine: float, cosine: float) -> None:
    at = order * EVEN
    turn = order * SPEED
    angle = crank_angle(revolution) + sine * np.sin(at) + cosine * np.cos(at)
    rate = SPEED + turn * (sine * np.cos(at) - cosine * np.sin(at))
    change = turn**2 * (-sine * np.sin(at) - cosine * np.cos(at))
    expected = wrench(bodies(angle, rate, change))
    assert np.allclose(revolution.with_ripple(order, sine, cosine), expected, atol=1e-5 * np.abs(expected).max(axis=0))


def test_unbalance_is_order_1_of_mass_radius_and_speed_squared(revolution: Revolution) -> None:
    product = 0.012
    found = wrench_orders(revolution.rotating((0.0, HEIGHT), product, 0.7), 6)
    assert 2.0 * np.abs(found[0, :2]) == pytest.approx([product * SPEED**2] * 2)
    assert found[0, 1] / found[0, 0] == pytest.approx(-1j)
    assert np.abs(found[1:]).max() < 1e-9
    # About the frame's centre of gravity, which the shaft is above: of the pull in x, and of the weight.
    assert found[0, 2] == pytest.approx(-HEIGHT * found[0, 0] - 0.5 * product * G * np.exp(0.7j))


def test_unbalance_is_a_crank_whose_mass_lies_further_out(revolution: Revolution) -> None:
    machine = shipped_machine("slider-crank")
    further = 0.01
    crank = machine.links["crank"].model_copy(update={"cg": (0.5 * R + further, HEIGHT)})
    heavier = Revolution.of(machine.model_copy(update={"links": {**machine.links, "crank": crank}}), SPEED)
    phase = float(crank_angle(revolution)[0])
    added = revolution.rotating((0.0, HEIGHT), CRANK * further, phase)
    difference = heavier.inertial() - revolution.inertial()
    assert np.allclose(difference, added, atol=1e-4 * np.abs(added).max(axis=0))


def test_a_constant_force_along_the_guide_has_no_orders(revolution: Revolution) -> None:
    push = np.broadcast_to([100.0, 0.0], (SAMPLES, 2))
    found = revolution.force("slider", (0.2, HEIGHT), push)
    assert found == pytest.approx(np.broadcast_to([100.0, 0.0, -100.0 * HEIGHT], (SAMPLES, 3)), rel=1e-6)
    assert np.abs(wrench_orders(found, 20)).max() < 1e-6
    # Nor has a torque on any link; but across the guide the point where it acts goes to and fro.
    still = np.zeros((SAMPLES, 2))
    for link in revolution.links:
        assert np.abs(wrench_orders(revolution.force(link, (0.0, 0.0), still, 3.0), 20)).max() < 1e-12
    across = wrench_orders(revolution.force("slider", (0.2, HEIGHT), push[:, ::-1]), 2)
    assert 2.0 * abs(across[0, 2]) == pytest.approx(100.0 * R, rel=1e-4)


def test_a_force_across_an_arm_is_a_constant_torque_about_its_shaft(revolution: Revolution) -> None:
    shaft, pin = (0.0, HEIGHT), (R, HEIGHT)
    across = revolution.across("crank", shaft, pin)
    angle = crank_angle(revolution)
    assert across == pytest.approx(np.column_stack([-np.sin(angle), np.cos(angle)]), abs=1e-6)
    found = revolution.force("crank", pin, 40.0 * across)
    assert found[:, :2] == pytest.approx(40.0 * across)
    about_shaft = found[:, 2] + HEIGHT * found[:, 0]
    assert about_shaft == pytest.approx(np.full(SAMPLES, 40.0 * R), rel=1e-6)


@pytest.mark.parametrize("name", ["four-bar", "quick-return"])
def test_a_force_across_the_arm_of_a_rocker_is_a_constant_torque(name: str) -> None:
    machine = shipped_machine(name)
    found = Revolution.of(machine, float(getattr(machine.drive, "speed")))  # noqa: B009
    rockers = [
        (next(link for link in machine.joints[joint].links if link != machine.frame), machine.joints[joint].at)
        for joint in machine.turning_joints
        if machine.frame in machine.joints[joint].links
    ]
    assert rockers
    for link, shaft in rockers:
        ends = [joint.at for joint in machine.joints.values() if link in joint.links and joint.at != shaft]
        end = max(ends, key=lambda at: math.dist(at, shaft))
        wrenches = found.force(link, end, found.across(link, shaft, end))
        arm = np.array(shaft) - np.array(machine.links[machine.frame].cg)
        about = wrenches[:, 2] - (arm[0] * wrenches[:, 1] - arm[1] * wrenches[:, 0])
        assert np.abs(about) == pytest.approx(np.full(SAMPLES, math.dist(shaft, end)), rel=1e-4)


def test_turns_the_other_way_round() -> None:
    machine = shipped_machine("slider-crank")
    back = Revolution.of(machine, -SPEED)
    angle = float(back.angle[0, back.links.index("crank")]) - EVEN
    expected = wrench(bodies(angle, np.full(SAMPLES, -SPEED), np.zeros(SAMPLES)))
    assert np.allclose(back.inertial(), expected, atol=1e-5 * np.abs(expected).max(axis=0))
    # A ripple is added to the drive angle, whichever way that goes.
    rate = -SPEED + 0.02 * SPEED * np.cos(2.0 * EVEN)
    change = -0.04 * SPEED**2 * np.sin(2.0 * EVEN)
    expected = wrench(bodies(angle + 0.01 * np.sin(2.0 * EVEN), rate, change))
    assert np.allclose(back.with_ripple(2, 0.01, 0.0), expected, atol=1e-5 * np.abs(expected).max(axis=0))


def test_wrenches_at_any_speed_follow_from_those_at_one() -> None:
    machine = shipped_machine("slider-crank")
    for speed in (0.6 * SPEED, -1.3 * SPEED):
        own, families = family_wrenches(machine, speed)
        simulated = Revolution.of(machine, speed)
        assert own.at(speed)[0] == pytest.approx(wrench_orders(simulated.inertial(), 20), abs=1e-9)
        (unbalance,) = (family.wrench for family in families if family.name == "unbalance")
        expected = wrench_orders(simulated.rotating((0.0, HEIGHT), 1.0, 0.0), 20)
        assert unbalance.at(speed)[0] == pytest.approx(expected, abs=1e-6)


def test_poses_are_simulated_once_for_each_way_round() -> None:
    machine = shipped_machine("slider-crank")
    slow, fast, back = (Revolution.of(machine, speed) for speed in (20.0, 70.0, -70.0))
    assert slow.place is fast.place
    assert back.place is not fast.place
    assert (slow.speed, fast.speed) == (20.0, 70.0)


def stuck(machine: Machine) -> Machine:
    """The crank longer than the rod and the way to the guide allow: it comes to a dead centre half way."""
    joints = dict(machine.joints)
    joints["A"] = joints["A"].model_copy(update={"at": (0.15, HEIGHT)})
    joints["B"] = joints["B"].model_copy(update={"at": (0.2, HEIGHT)})
    return machine.model_copy(update={"joints": joints})


def test_refuses_a_machine_that_does_not_come_round() -> None:
    with pytest.raises(DiagnosisError, match="slider-crank with its frame held: "):
        Revolution.of(stuck(shipped_machine("slider-crank")), SPEED)
