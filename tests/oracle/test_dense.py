"""The oracle itself, against results that need no program."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from oracle.closures import lacking
from oracle.dense import JammedError, solve

from jointplay.solver.machines.machine import Machine, parse_machine

G = 9.81


def block(friction: float, force: list[float], slope: float = 0.0) -> Machine:
    """A block of 2 kg on a guide of the fixed frame."""
    guide = {
        "kind": "sliding",
        "links": ["block", "bed"],
        "at": [0, 0],
        "direction": [math.cos(slope), math.sin(slope)],
    }
    return parse_machine(
        {
            "name": "block",
            "links": {"bed": {"fixed": True}, "block": {"mass": 2.0, "inertia": 0.01, "cg": [0.1, 0.05]}},
            "joints": {"G": {**guide, "friction": friction, "friction_velocity": 1e-3}},
            "loads": [{"link": "block", "at": [0.1, 0.05], "force": force}],
        }
    )


def state(machine: Machine, speed: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The drawn pose; the last link moves along x."""
    positions = np.array([(*link.cg, 0.0) for link in machine.links.values()])
    velocities = np.zeros_like(positions)
    velocities[-1, 0] = speed
    return positions, velocities


def test_free_slide_down_a_slope() -> None:
    machine = block(0.0, [0.0, 0.0], slope=-0.3)
    solution = solve(machine, {}, 0.0, *state(machine))
    assert solution.accelerations[1] == pytest.approx(G * math.sin(0.3) * np.array([math.cos(0.3), -math.sin(0.3), 0]))
    # The normal force acts where the joint is drawn, the weight 0.1 m right of it and 0.05 m above.
    normal, couple = solution.reactions["G"]
    assert normal == pytest.approx(2 * G * math.cos(0.3))
    assert couple == pytest.approx(normal * (0.1 * math.cos(0.3) - 0.05 * math.sin(0.3)))


@pytest.mark.parametrize("pressing", [-30.0, 60.0])
@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_coulomb_friction_of_a_block(pressing: float, speed: float) -> None:
    """mu |Fn| against the motion, whether the guide pushes up or holds down."""
    machine = block(0.2, [10.0, pressing])
    solution = solve(machine, {}, 0.0, *state(machine, speed))
    normal = 2 * G - pressing
    assert solution.reactions["G"][0] == pytest.approx(normal)
    assert solution.accelerations[1, 0] == pytest.approx((10.0 - math.copysign(0.2 * abs(normal), speed)) / 2)


def strut(speed: float, friction: float) -> tuple[Machine, dict[str, float], float, np.ndarray, np.ndarray]:
    """A light shoe on a floor, a strut of 1 m on it at 60 degrees, a heavy block on top between smooth walls."""
    c, s = math.cos(math.pi / 3), math.sin(math.pi / 3)
    tree: dict[str, Any] = {
        "name": "strut",
        "links": {
            "bed": {"fixed": True},
            "shoe": {"mass": 0.1, "inertia": 1e-3, "cg": [c, 0]},
            "strut": {"mass": 1e-9, "inertia": 1e-9, "cg": [c / 2, s / 2]},
            "weight": {"mass": 10.0, "inertia": 1.0, "cg": [0, s]},
        },
        "joints": {
            "floor": {
                "kind": "sliding", "links": ["shoe", "bed"], "at": [c, 0], "direction": [1, 0],
                "friction": friction, "friction_velocity": 1e-3,
            },
            "foot": {"kind": "turning", "links": ["strut", "shoe"], "at": [c, 0]},
            "head": {"kind": "turning", "links": ["strut", "weight"], "at": [0, s]},
            "wall": {"kind": "sliding", "links": ["weight", "bed"], "at": [0, s], "direction": [0, 1]},
        },
    }  # fmt: skip
    machine = parse_machine(tree)
    positions, velocities = state(machine)
    # x c + y s stays: the head comes down with c / s of the foot's speed; the strut turns by speed / s.
    velocities[1, 0], velocities[3, 1] = speed, -speed * c / s
    velocities[2] = speed / 2, -speed * c / s / 2, speed / s
    assert lacking(machine, {}, 0.0, positions, velocities) < 1e-15
    return machine, {}, 0.0, positions, velocities


def test_self_locking_is_jamming() -> None:
    """mu tan 60 > 1: the strut cannot push the shoe. Slow, no sign of Fn is consistent; fast, both are (Painleve)."""
    with pytest.raises(JammedError, match=r"^no signs"):
        solve(*strut(0.1, friction=1.0))
    with pytest.raises(JammedError, match=r"^several signs"):
        solve(*strut(5.0, friction=1.0))
    # mu tan 60 < 1: it slides. The foot's force L from m x'' = L (c - mu s) - mu m g, M y'' = L s - M g.
    c, s, m, M, mu = 0.5, math.sqrt(0.75), 0.1, 10.0, 0.4
    push = (G * (s + mu * c) - 0.1**2 / s**2) / (c * (c - mu * s) / m + s * s / M)
    solution = solve(*strut(0.1, friction=mu))
    assert solution.reactions["floor"][0] == pytest.approx(push * s + m * G, rel=1e-6)
    assert solution.accelerations[1, 0] == pytest.approx((push * (c - mu * s) - mu * m * G) / m, rel=1e-6)


def test_physical_pendulum_on_a_pin() -> None:
    """theta'' = -m g l cos(theta) / (I + m l^2) from the horizontal; the pin carries the rest of the weight."""
    tree = {
        "name": "pendulum",
        "links": {"bed": {"fixed": True}, "bob": {"mass": 2.0, "inertia": 0.1, "cg": [0.5, 0.0]}},
        "joints": {"O": {"kind": "turning", "links": ["bob", "bed"], "at": [0, 0], "viscous": 0.3}},
    }
    machine = parse_machine(tree)
    positions, velocities = state(machine)
    velocities[1] = 0.0, 0.5 * 4.0, 4.0
    solution = solve(machine, {}, 0.0, positions, velocities)
    alpha = (-2.0 * G * 0.5 - 0.3 * 4.0) / (0.1 + 2.0 * 0.25)
    assert solution.accelerations[1] == pytest.approx([-0.5 * 16, 0.5 * alpha, alpha])
    assert solution.reactions["O"] == pytest.approx([-2.0 * 0.5 * 16, 2.0 * (0.5 * alpha + G)])


def test_pin_pressed_into_its_socket() -> None:
    """Normal force, friction at the common contact point, and their moments about both centres of gravity."""
    contact = {"stiffness": 1e6, "damping": 100.0, "friction": 0.3, "viscous": 5.0, "friction_velocity": 0.5}
    tree = {
        "name": "pair",
        "gravity": 0,
        "links": {
            "socket": {"mass": 1.0, "inertia": 1.0, "cg": [0, 0]},
            "pin": {"mass": 1.0, "inertia": 1.0, "cg": [0, 0]},
        },
        "joints": {
            "J": {"kind": "turning", "links": ["pin", "socket"], "at": [0, 0], "pin_radius": 0.01, "contact": contact}
        },
    }
    machine = parse_machine(tree)
    positions = np.array([[0.0, 0.0, 0.0], [0.003, 0.0, 0.0]])
    velocities = np.array([[0.0, 0.0, 2.0], [0.1, 0.2, 4.0]])
    solution = solve(machine, {"J": 0.002}, 0.0, positions, velocities)
    # The contact point is at (0.013, 0): 10 mm from the pin's centre, 13 mm from the socket's.
    normal, slip = 1e6 * 0.001 + 100 * 0.1, (0.2 + 4.0 * 0.01) - 2.0 * 0.013
    tangential = -(0.3 * normal * math.tanh(slip / 0.5) + 5.0 * slip)
    assert solution.reactions["J"] == pytest.approx([-normal, tangential])
    assert solution.accelerations[1] == pytest.approx([-normal, tangential, 0.01 * tangential])
    assert solution.accelerations[0] == pytest.approx([normal, -tangential, -0.013 * tangential])
    # It parts faster than the spring pushes: a pin cannot pull.
    velocities[1, 0] = -11.0
    assert not solve(machine, {"J": 0.002}, 0.0, positions, velocities).accelerations.any()
