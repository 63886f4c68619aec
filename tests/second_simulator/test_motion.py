"""The march against what is known: conserved quantities, a pendulum, closed-form kinematics, its own smaller steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from second_simulator.elements import elements
from second_simulator.ideal import Ideal
from second_simulator.machine import Array, Body, Contact, Guide, Machine, Mount, Pin
from second_simulator.machine_file import read
from second_simulator.march import march
from second_simulator.turning import Ripple, angle, turning

STILL = Body(math.inf, math.inf, (0.0, 0.0))
STIFF = Contact("linear", 1e9, 0.0, friction=0.0)
NOTHING = np.zeros((0, 3))


def marched(
    machine: Machine, clearance: float, q: Array, v: Array, seconds: float, h: float, watched: str = "", rows: int = 200
) -> Array:
    """Rows (n, 6) of one body; `q` and `v` end at the end."""
    parts = elements(machine, dict.fromkeys(machine.pins, clearance))
    out = np.empty((rows, 6))
    speed = machine.drive.speed if machine.drive else 0.0
    steps = round(seconds / rows / h)
    march(parts, turning(speed), q, v, 0.0, h, steps, NOTHING, out, machine.names.index(watched or machine.frame))
    return out


@pytest.mark.long
def test_pendulum_swings_with_its_period() -> None:
    bodies = {"ground": STILL, "bob": Body(0.5, 2e-3, (0.0, -0.2))}
    pins = {"P": Pin("bob", "ground", (0.0, 0.0), 0.0)}
    pendulum = Machine("pendulum", "ground", bodies, pins, {}, {"P": replace(STIFF, damping=200.0)})
    period = 2 * math.pi * math.sqrt((2e-3 + 0.5 * 0.2**2) / (0.5 * 9.81 * 0.2))
    largest = 0.05
    q = np.array([[0.0, 0.0, 0.0], [0.2 * math.sin(largest), -0.2 * math.cos(largest), largest]])
    out = marched(pendulum, 1e-9, q, np.zeros((2, 3)), 1.2, 2e-6, "bob", 1200)
    down = np.flatnonzero((out[:-1, 2] > 0) & (out[1:, 2] <= 0))
    zeros = down + out[down, 2] / (out[down, 2] - out[down + 1, 2])
    assert np.diff(zeros)[0] * 1e-3 == pytest.approx(period * (1 + largest**2 / 16), rel=1e-4)


def free_machine() -> Machine:
    """Three bodies that nothing holds: a pin with play between two of them, a guide between two."""
    bodies = {
        "one": Body(2.0, 0.02, (0.0, 0.0)),
        "two": Body(0.5, 0.002, (0.1, 0.05)),
        "three": Body(0.3, 0.001, (0.2, 0.0)),
    }
    pins = {"P": Pin("two", "one", (0.05, 0.02), 0.008)}
    guides = {"G": Guide("three", "two", (0.18, 0.01), (0.8, 0.6), friction=0.1)}
    return Machine("free", "one", bodies, pins, guides, {"P": Contact(friction=0.1)}, gravity=0.0)


@pytest.mark.long
def test_momenta_of_a_free_machine_stay() -> None:
    machine = free_machine()
    q = np.array([(*body.at, 0.0) for body in machine.bodies.values()])
    v = np.array([[0.1, 0.0, 3.0], [-0.3, 0.4, 3.0], [0.2, 0.5, 3.0]])

    def momenta() -> Array:
        mass = np.array([body.mass for body in machine.bodies.values()])
        inertia = np.array([body.inertia for body in machine.bodies.values()])
        spin = mass * (q[:, 0] * v[:, 1] - q[:, 1] * v[:, 0]) + inertia * v[:, 2]
        return np.array([mass @ v[:, 0], mass @ v[:, 1], spin.sum()])

    before, speed = momenta(), v.copy()
    marched(machine, 2e-4, q, v, 0.4, 1e-6)
    assert np.abs(v - speed).max() > 0.1
    assert momenta()[:2] == pytest.approx(before[:2], abs=1e-12)
    assert momenta()[2] == pytest.approx(before[2], rel=1e-4)


def energy(machine: Machine, clearance: float, q: Array, v: Array) -> float:
    """Of motion, height, mounts and linear contacts; of turning joints only the centres count."""
    parts = elements(machine, dict.fromkeys(machine.pins, clearance))
    total = 0.0
    for k, body in enumerate(machine.bodies.values()):
        total += 0.5 * body.mass * (v[k, 0] ** 2 + v[k, 1] ** 2) + 0.5 * body.inertia * v[k, 2] ** 2
        total += body.mass * machine.gravity * q[k, 1]

    def at(k: int, x: float, y: float) -> Array:
        c, s = math.cos(q[k, 2]), math.sin(q[k, 2])
        return np.array([q[k, 0] + c * x - s * y, q[k, 1] + s * x + c * y])

    for (i, j), point, number in zip(parts.pin_bodies, parts.pin_points, parts.pin_numbers, strict=True):
        depth = float(np.hypot(*(at(i, *point[:2]) - at(j, *point[2:])))) - clearance
        total += 0.5 * number[3] * max(depth, 0.0) ** 2
    for (i, _), point, number in zip(parts.mount_bodies, parts.mount_points, parts.mount_numbers, strict=True):
        total += 0.5 * float(number[:2] @ (at(i, *point[:2]) - point[2:]) ** 2)
    return total


@pytest.mark.long
def test_energy_stays_without_damping_and_friction() -> None:
    bodies = {
        "frame": Body(10.0, 0.3, (0.0, 0.0)),
        "arm": Body(1.0, 0.01, (0.1, 0.0)),
        "end": Body(0.5, 0.004, (0.3, 0.0)),
    }
    pins = {"P": Pin("arm", "frame", (0.0, 0.0), 0.008), "Q": Pin("end", "arm", (0.2, 0.0), 0.008)}
    contact = Contact("linear", 1e7, 0.0, friction=0.0)
    feet = tuple(Mount("frame", (x, -0.1), (2e5, 4e5), (0.0, 0.0)) for x in (-0.25, 0.25))
    machine = Machine("double", "frame", bodies, pins, {}, dict.fromkeys(pins, contact), feet)
    q, v = np.array([(*body.at, 0.0) for body in bodies.values()]), np.zeros((3, 3))
    before = energy(machine, 1e-3, q, v)
    marched(machine, 1e-3, q, v, 0.5, 1e-6)
    assert np.abs(v).max() > 0.5
    assert energy(machine, 1e-3, q, v) == pytest.approx(before, abs=2e-4)


def closed_form(theta: Array, r: float = 0.05, length: float = 0.15) -> Array:
    """Slide of the shipped slider-crank from its crank's shaft."""
    return r * np.cos(theta) + np.sqrt(length**2 - (r * np.sin(theta)) ** 2)


@pytest.mark.long
def test_without_play_the_slider_moves_as_kinematics_say() -> None:
    machine = read("slider-crank").with_body("frame", mass=math.inf, inertia=math.inf)
    machine = machine.with_contact(Contact("linear", 3e8, 3e3, friction=0.0))
    assert machine.drive is not None
    ideal = Ideal(machine)
    q, turn = ideal.drawn.copy(), 2 * math.pi / machine.drive.speed
    v = ideal.velocities(q, 0.0, machine.drive.speed)
    out = marched(machine, 1e-7, q, v, 2 * turn, turn / 100_000, "slider")
    theta = 4 * math.pi * np.arange(1, 201) / 200
    assert np.abs(out[:, 0] - closed_form(theta)).max() < 5e-6


def test_ideal_machine_moves_as_kinematics_say() -> None:
    places, rates = Ideal(read("slider-crank")).revolution(360)
    theta, small = 2 * math.pi * np.arange(360) / 360, 1e-6
    assert np.abs(places[:, 3, 0] - closed_form(theta)).max() < 1e-12
    slope = (closed_form(theta + small) - closed_form(theta - small)) / (2 * small)
    assert np.abs(rates[:, 3, 0] - slope).max() < 1e-8


@pytest.mark.parametrize("name", ["four-bar", "quick-return"])
def test_ideal_rates_are_those_of_the_places(name: str) -> None:
    places, rates = Ideal(read(name)).revolution(720)
    slope = (np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)) / (2 * 2 * math.pi / 720)
    assert np.abs((rates - slope)[2:-2, :, :2]).max() < 1e-5


@pytest.mark.long
def test_error_falls_with_the_square_of_the_step() -> None:
    mount = Mount("body", (0.0, 0.0), (4e5, 4e5), (50.0, 50.0))
    machine = Machine("mass", "body", {"body": Body(10.0, 1.0, (0.0, 0.0))}, {}, {}, {}, (mount,), gravity=0.0)
    rate, omega = 50 / 20, math.sqrt(4e4 - 2.5**2)
    exact = 1e-3 * math.exp(-rate * 0.2) * (math.cos(0.2 * omega) + rate / omega * math.sin(0.2 * omega))
    errors = []
    for h in (4e-5, 2e-5, 1e-5):
        q, v = np.array([[1e-3, 0.0, 0.0]]), np.zeros((1, 3))
        marched(machine, 0.0, q, v, 0.2, h, rows=10)
        errors.append(abs(q[0, 0] - exact))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_rates_of_the_drive_are_those_of_its_angle() -> None:
    wander = np.array([[0.002, 1.3, 0.4], [0.001, 0.5, 2.0]])
    course = turning(60.0, wander, [Ripple(6, 1e-3, 0.7), Ripple(2, 2e-3, 1.9)])
    small = 1e-5
    for t in (0.0, 0.37, 2.1):
        before, here, after = angle(course, t - small), angle(course, t), angle(course, t + small)
        assert here[1] == pytest.approx((after[0] - before[0]) / (2 * small), rel=1e-6)
        assert here[2] == pytest.approx((after[1] - before[1]) / (2 * small), rel=1e-4, abs=1e-3)
    assert angle(course, 0.0)[0] == 0.0


def test_the_angle_of_a_speed_that_changes() -> None:
    """Half of 10 rad/s until 1 s, to one and a half times that in 2 s, held; with a ripple on it."""
    for ripple in ([], [Ripple(3, 0.01, 0.4)]):
        course = turning(10.0, None, ripple, [(0.0, 0.5), (2.0, 1.5), (3.0, 1.5)], begin=1.0)
        times = np.array([0.3, 1.0, 1.5, 2.0, 2.7, 3.0, 3.5, 6.0])
        factor = np.interp(times, [1.0, 3.0], [0.5, 1.5])
        covered = [
            5 * t if t < 1 else 5 + 5 * (t - 1) + 2.5 * (t - 1) ** 2 if t < 3 else 25 + 15 * (t - 3) for t in times
        ]
        found = np.array([angle(course, t) for t in times])
        assert found[:, 3] == pytest.approx(np.array(covered))
        if not ripple:
            assert found[:, 1] == pytest.approx(10 * factor)
        for t in (0.5, 2.2, 4.0):
            before, now, after = (np.array(angle(course, t + by)) for by in (-1e-4, 0.0, 1e-4))
            assert now[1:3] == pytest.approx((after[:2] - before[:2]) / 2e-4, rel=1e-5)
