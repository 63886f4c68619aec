"""Every element of a machine file alone against a closed form: what it does, in the direction and with the sign it has.

All of them together are compared with the dense oracle; here nobody shares an equation with the solver. Runs have a
tolerance of 1e-10 a step, and a few hundred steps: answers agree to 1e-8 of their size.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import Array, Tree, run
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_simpson, solve_ivp

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.equations.links import LinkMotion
from jointplay.solver.machines.machine import parse_machine
from jointplay.solver.simulation.simulate import simulate

BODY: Tree = {"mass": 2.0, "inertia": 0.3, "cg": [0.0, 0.0]}
WALL: Tree = {"fixed": True}


def moved(
    joints: Tree | None = None, wall: Tree = WALL, body: Tree = BODY, gravity: float = 0.0, duration: float = 1.0,
    start: Tree | None = None, rate: float = 200.0, worn: dict[str, float] | None = None, **more: Any,
) -> tuple[Array, LinkMotion]:  # fmt: skip
    """Times and motion of a body on a wall, or on another body, and what is between them."""
    tree = {"name": "m", "gravity": gravity, "links": {"wall": wall, "body": body}, "joints": joints or {}, **more}
    if not joints and "supports" not in more:  # a spring of nothing: every link must hang on something
        mount = {"kind": "mount", "link": "body", "at": [0, 0], "stiffness": [0, 0]}
        tree["supports"] = [mount]
    machine = parse_machine(tree | {"initial": {"velocities": start or {}}})
    history, motion = run(machine, worn or {}, duration=duration, sample_rate=rate, rtol=1e-10)
    return history.t, motion


def close(found: Array, expected: Array, part: float = 1e-8) -> None:
    assert_allclose(found, expected, rtol=0, atol=part * float(np.abs(expected).max()))


def slide(direction: list[float], **more: float) -> Tree:
    return {"G": {"kind": "sliding", "links": ["body", "wall"], "at": [0, 0], "direction": direction, **more}}


def turn(**more: Any) -> Tree:
    return {"O": {"kind": "turning", "links": ["body", "wall"], "at": [0, 0], **more}}


# Joints ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0, 37, 90, 143, 180, 270])
def test_viscous_slide_in_any_direction(degrees: int) -> None:
    """Gravity pulls along the line, the resistance grows with speed: v tends to m g u / c. Also along a vertical."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    t, motion = moved(
        slide([c, s], viscous=6.0), gravity=9.81, start={"body": {"velocity": [1.5 * c, 1.5 * s]}}
    )  # fmt: skip
    end, rate = -2 * 9.81 * s / 6.0, 6.0 / 2
    expected = end + (1.5 - end) * np.exp(-rate * t)
    close(motion.velocity[:, 1, :2], np.outer(expected, [c, s]))


def test_viscous_turning_joint_between_two_free_bodies() -> None:
    """The difference of speeds decays with CT (1 / I1 + 1 / I2); the angular momentum stays."""
    t, motion = moved(
        turn(viscous=0.2), wall={**BODY, "inertia": 0.5}, start={"body": {"omega": 7}, "wall": {"omega": -3}}
    )
    first, second = motion.velocity[:, 0, 2], motion.velocity[:, 1, 2]
    close(second - first, 10 * np.exp(-0.2 * (1 / 0.5 + 1 / 0.3) * t))
    close(0.5 * first + 0.3 * second, np.full(t.shape, 0.5 * -3 + 0.3 * 7))


def journal(friction: float, viscous: float) -> tuple[Array, Array]:
    """Times and speed of a shaft of 20 mm, 2 kg, that rests in a worn bearing and runs down from 50 rad/s.

    A damper at its centre takes the swinging in the socket, and does nothing once it lies still.
    """
    rest = {"kind": "mount", "link": "body", "at": [0, 0], "stiffness": [0, 0], "damping": [1000, 1000]}
    law = {"stiffness": 1e8, "damping": 2e4, "friction": friction, "viscous": viscous, "friction_velocity": 1e-3}
    t, motion = moved(
        turn(pin_radius=0.01, contact=law), gravity=9.81, duration=0.4, start={"body": {"omega": 50}},
        body={**BODY, "inertia": 1e-3}, worn={"O": 1e-5}, supports=[rest],
    )  # fmt: skip
    assert np.abs(motion.displacement[:, 1, :2]).max() < 1.2e-5  # it lies in its socket
    settled = t > 0.2
    return t[settled], motion.velocity[settled, 1, 2]


def test_friction_of_a_shaft_in_a_worn_bearing() -> None:
    """The circle of friction: the shaft climbs until the reaction is vertical, its moment is m g r sin(atan mu)."""
    t, omega = journal(friction=0.3, viscous=0.0)
    assert omega[-1] > 10  # still slipping
    slope = np.polyfit(t, omega, 1)[0]
    assert slope == pytest.approx(-2 * 9.81 * 0.01 * math.sin(math.atan(0.3)) / 1e-3, rel=1e-5)


def test_viscous_resistance_of_a_shaft_in_a_worn_bearing() -> None:
    """Moment Ct r^2 omega about its centre."""
    t, omega = journal(friction=0.0, viscous=5.0)
    slope = np.polyfit(t, np.log(omega), 1)[0]
    assert slope == pytest.approx(-5.0 * 0.01**2 / 1e-3, rel=1e-4)


# Supports -------------------------------------------------------------------------------------------------------------


def spring(**more: Any) -> Tree:
    return {"kind": "spring", "link": "body", "at": [0, 0], "anchor": [0, -0.5], "stiffness": 800.0, **more}


@pytest.mark.parametrize("more", [{"free_length": 0.53}, {"static_deflection": 0.03}])
def test_spring_longer_than_drawn(more: Tree) -> None:
    """It pushes from the start and swings the body about its free length."""
    t, motion = moved(supports=[spring(**more)])
    close(motion.displacement[:, 1, 1], 0.03 * (1 - np.cos(20 * t)))


def test_static_deflection_carries_the_weight_as_drawn() -> None:
    """Compressed by m g / k in the drawing: nothing moves."""
    _, motion = moved(supports=[spring(static_deflection=2 * 9.81 / 800)], gravity=9.81)
    assert np.abs(motion.displacement).max() < 1e-14


def test_damper_acts_along_its_line() -> None:
    """Thrown across the line of a damper: energy goes with c (d length / dt)^2, only as it stretches."""
    damper = {"kind": "damper", "link": "body", "at": [0, 0], "anchor": [0, -0.5], "damping": 9.0}
    t, motion = moved(supports=[damper], start={"body": {"velocity": [2, 0], "omega": 0}}, rate=2000)
    place, rate = motion.displacement[:, 1, :2] + [0, 0.5], motion.velocity[:, 1, :2]
    stretching = (place * rate).sum(axis=1) / np.hypot(*place.T)
    lost = cumulative_simpson(9.0 * stretching**2, x=t, initial=0)
    close((rate**2).sum(axis=1), 4.0 - lost)
    assert motion.acceleration[0, 1, :2] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("wall", [WALL, {"mass": 3.0, "inertia": 1.0, "cg": [0, 0]}], ids=["ground", "link"])
def test_mount_to_ground_and_between_links(wall: Tree) -> None:
    """Different in x and y; two bodies swing against each other with their reduced mass."""
    to = None if wall is WALL else "wall"
    mount = {"kind": "mount", "link": "body", "to_link": to, "at": [0, 0], "stiffness": [800, 300], "damping": [4, 1]}
    t, motion = moved(wall=wall, supports=[mount], start={"body": {"velocity": [1, 2]}, "wall": {"velocity": [0, 0]}}
                         if to else {"body": {"velocity": [1, 2]}})  # fmt: skip
    mass = 2.0 if to is None else 2.0 * 3.0 / 5.0
    offset = motion.displacement[:, 1] - motion.displacement[:, 0]
    for axis, (k, c, v) in enumerate([(800, 4, 1), (300, 1, 2)]):
        decay = c / (2 * mass)
        swing = math.sqrt(k / mass - decay**2)
        close(offset[:, axis], v / swing * np.exp(-decay * t) * np.sin(swing * t))


# Loads ----------------------------------------------------------------------------------------------------------------


def test_point_of_a_load_moves_with_its_link_and_its_force_does_not() -> None:
    """A constant force on an arm of a free body swings it like a pendulum in a field; its centre goes straight."""
    load = {"link": "body", "at": [0.2, 0], "force": [0, 5], "torque": 0.1}
    t, motion = moved(loads=[load])
    close(motion.displacement[:, 1, 1], 5 / 2 * t**2 / 2)
    exact = solve_ivp(lambda _, y: [y[1], (5 * 0.2 * math.cos(y[0]) + 0.1) / 0.3], (0, 1), [0, 0], "DOP853", t,
                      rtol=1e-12, atol=1e-14)  # fmt: skip
    close(motion.displacement[:, 1, 2], exact.y[0])


def test_load_over_time_is_an_impulse() -> None:
    """Momentum and spin are the integral of the table; before its first and after its last row it is held."""
    table = [[0.2, 4, -2, 0.3], [0.5, -6, 2, 0.3], [0.7, 1, 0, -0.9]]
    t, motion = moved(loads=[{"link": "body", "at": [0, 0], "over_time": table}])
    fine = np.linspace(0, 1, 10 * (len(t) - 1) + 1)  # the table's corners are among these: the trapezium is exact
    columns = np.array([np.interp(fine, *zip(*[(row[0], row[k]) for row in table], strict=True)) for k in (1, 2, 3)])
    steps = (columns[:, 1:] + columns[:, :-1]) / 2 * np.diff(fine)
    impulse = np.column_stack([np.zeros(3), np.cumsum(steps, axis=1)])[:, ::10].T
    close(motion.velocity[:, 1], impulse / [2.0, 2.0, 0.3])


def test_load_over_angle_does_the_work_of_its_table() -> None:
    """A rotor under a torque over its angle, five turns: energy by angle; every turn the same, linear over the seam."""
    table = [[0.5, 0, 0, -1.0], [2.0, 0, 0, 3.0], [5.0, 0, 0, 0.5]]
    drive = {"kind": "torque", "joint": "O", "torque": 1.0}
    _, motion = moved(
        turn(), drive=drive, loads=[{"link": "body", "at": [0, 0], "over_angle": table}], start={"body": {"omega": 5}},
        duration=3.0,
    )  # fmt: skip
    angle, omega = motion.displacement[:, 1, 2], motion.velocity[:, 1, 2]
    assert angle[-1] > 5 * 2 * math.pi
    grid = np.linspace(0, angle[-1], 400_001)
    torque = 1.0 + np.interp(grid, [row[0] for row in table], [row[3] for row in table], period=2 * math.pi)
    work = np.concatenate([[0], np.cumsum((torque[1:] + torque[:-1]) / 2 * np.diff(grid))])
    # The grid misses the table's corners by up to a step, 1e-4 rad: 1e-8 J at each of twenty corners.
    close(0.15 * (omega**2 - 25), np.interp(angle, grid, work), part=1e-7)


def test_size_of_a_load_over_angle_may_differ_from_case_to_case() -> None:
    """What a case says of the table as a whole is a factor on all of it."""
    table = [[0.5, 0, 0, -1.0], [2.0, 0, 0, 3.0], [5.0, 0, 0, 0.5]]
    tree: Tree = {
        "name": "m", "gravity": 0.0, "links": {"wall": WALL, "body": BODY}, "joints": turn(),
        "drive": {"kind": "torque", "joint": "O", "torque": 1.0}, "initial": {"velocities": {"body": {"omega": 5}}},
    }  # fmt: skip
    settings = Settings(links=True, duration=1.0, sample_rate=200.0, rtol=1e-10)
    found = []
    for factor, parameters in ((2.0, {}), (1.0, {"loads.0.over_angle": 2.0})):
        rows = [[angle, *(factor * value for value in rest)] for angle, *rest in table]
        machine = parse_machine(tree | {"loads": [{"link": "body", "at": [0, 0], "over_angle": rows}]})
        history = simulate(machine, Case(parameters=parameters), settings)
        assert history.links is not None
        found.append(history.links.displacement)
    close(found[1], found[0])


# Drives ---------------------------------------------------------------------------------------------------------------

RAMP = [[0.1, 5.0], [0.4, -10.0], [0.8, 20.0]]


def ramped(t: Array) -> Array:
    """Integral of the ramp from 0, by parts."""
    grid = np.linspace(0, 1, 1_000_001)
    speed = np.interp(grid, *zip(*RAMP, strict=True))
    return np.interp(t, grid, np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(grid))]))


@pytest.mark.parametrize("speed", [12.0, -12.0, RAMP], ids=["constant", "backwards", "run-up"])
def test_rotation_drive(speed: Any) -> None:
    """f = w t + sum a [sin(k w t + p) - sin p]; of a ramp, w t is its integral."""
    ripple = [{"order": 2, "amplitude": 0.03, "phase": 0.7}, {"order": 0.5, "amplitude": -0.1}]
    t, motion = moved(turn(), drive={"kind": "rotation", "joint": "O", "speed": speed, "ripple": ripple})
    base = ramped(t) if isinstance(speed, list) else speed * t
    ripples = 0.03 * (np.sin(2 * base + 0.7) - math.sin(0.7)) - 0.1 * np.sin(0.5 * base)
    close(motion.displacement[:, 1, 2], base + ripples)


@pytest.mark.parametrize("speed", [0.4, RAMP], ids=["constant", "run-up"])
def test_translation_drive(speed: Any) -> None:
    """s = v t + sum A [sin(2 pi f t + p) - sin p] along the direction, which need not be of unit length."""
    harmonics = [{"frequency": 3, "amplitude": 0.02, "phase": -1.0}, {"frequency": 7, "amplitude": 0.01}]
    drive = {"kind": "translation", "joint": "G", "speed": speed, "harmonics": harmonics}
    t, motion = moved(slide([-6, 8]), drive=drive)
    travel = ramped(t) if isinstance(speed, list) else speed * t
    travel = travel + 0.02 * (np.sin(6 * math.pi * t - 1) - math.sin(-1)) + 0.01 * np.sin(14 * math.pi * t)
    close(motion.displacement[:, 1, :2], np.outer(travel, [-0.6, 0.8]))


@pytest.mark.parametrize("kind", ["torque", "force"])
def test_known_effort_acts_on_both_links(kind: str) -> None:
    """Two free bodies pushed apart by a constant: each goes with its own inertia."""
    joint = turn() if kind == "torque" else slide([0, 1])
    drive = {"kind": kind, "joint": next(iter(joint)), kind: 1.5}
    t, motion = moved(joint, wall={"mass": 5.0, "inertia": 0.7, "cg": [0, 0]}, drive=drive)
    axis, first, second = (2, 0.7, 0.3) if kind == "torque" else (1, 5.0, 2.0)
    close(motion.displacement[:, 0, axis], -1.5 / first * t**2 / 2)
    close(motion.displacement[:, 1, axis], 1.5 / second * t**2 / 2)


@pytest.mark.parametrize("kind", ["torque", "force"])
def test_motor_curve(kind: str) -> None:
    """Falling linearly with speed, held beyond its ends: an exponential towards no load, from standstill.

    Started beyond the last point the effort is that of the end, and the speed a straight line.
    """
    joint, inertia = (turn(), 0.3) if kind == "torque" else (slide([1, 0]), 2.0)
    drive = {"kind": kind, "joint": next(iter(joint)), "curve": [[0, 6], [12, -2]]}
    axis = 2 if kind == "torque" else 0
    t, motion = moved(joint, drive=drive, duration=0.5)
    close(motion.velocity[:, 1, axis], 9 * (1 - np.exp(-6 / 9 / inertia * t)))
    start = {"omega": 20} if kind == "torque" else {"velocity": [20, 0]}
    t, motion = moved(joint, drive=drive, duration=0.5, start={"body": start})
    above = motion.velocity[:, 1, axis] > 12
    close(motion.velocity[above, 1, axis], 20 - 2 / inertia * t[above])


# Gravity, locks -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gravity", [9.81, 0.0, 1.62, -3.0])
def test_gravity(gravity: float) -> None:
    t, motion = moved(gravity=gravity, start={"body": {"velocity": [1, 2]}})
    close(motion.displacement[:, 1, :2], np.column_stack([t, 2 * t - gravity * t**2 / 2]))


@pytest.mark.parametrize("locked", [["x"], ["y"], ["theta"], ["x", "theta"], ["x", "y"]])
def test_locked_motions_of_a_link(locked: list[str]) -> None:
    """Any link may be locked, not the frame alone: the other motions do not notice."""
    load = {"link": "body", "at": [0, 0], "force": [3, 4], "torque": 0.6}
    t, motion = moved(body=BODY | {"locked": locked}, loads=[load])
    for axis, (name, acceleration) in enumerate({"x": 1.5, "y": 2.0, "theta": 2.0}.items()):
        if name in locked:
            assert np.abs(motion.displacement[:, 1, axis]).max() < 1e-12
        else:
            close(motion.displacement[:, 1, axis], acceleration * t**2 / 2)


def test_a_second_fixed_link_is_ground() -> None:
    """A slider-crank whose guide is a link of its own, nailed down: as if it were the wall."""
    joints = turn() | {
        "A": {"kind": "turning", "links": ["rod", "body"], "at": [0.05, 0]},
        "B": {"kind": "turning", "links": ["rod", "slider"], "at": [0.2, 0]},
        "G": {"kind": "sliding", "links": ["slider", "guide"], "at": [0.2, 0], "direction": [1, 0]},
    }
    links = {"wall": WALL, "body": BODY, "rod": BODY, "slider": BODY, "guide": WALL}
    drive = {"kind": "rotation", "joint": "O", "speed": 10.0}
    machine = parse_machine({"name": "m", "links": links, "joints": joints, "drive": drive})
    history, motion = run(machine, {}, duration=1.0, sample_rate=200, rtol=1e-10)
    angle = 10 * history.t
    place = 0.05 * np.cos(angle) + np.sqrt(0.15**2 - (0.05 * np.sin(angle)) ** 2) - 0.2
    close(motion.displacement[:, motion.links.index("slider"), 0], place)
