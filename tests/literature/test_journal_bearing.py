"""A rotor in a short journal bearing: published coefficients, and where oil whirl begins.

Stiffness and damping of the film about the place of a steady load are those of M. I. Friswell, J. E. T. Penny, S. D.
Garvey and A. W. Lees, Dynamics of Rotating Machines (2010), p. 177, as class CylindricalBearing of ROSS (github.com,
petrobras/ross) has them, with the numbers of its example. A rigid rotor on such a film whirls from a mass on that
follows from them; the whirl is known to go round at about half the speed (B. L. Newkirk and H. D. Taylor, 1925).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from trajectory import trajectories

from jointplay.solver.equations.model import build_model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.machines.machine import Machine, parse_machine

RADIUS, LENGTH, CLEARANCE, VISCOSITY = 0.05, 0.03, 1e-4, 0.1
SPEED, WEIGHT = 1500 * math.pi / 30, 525.0
#: mu R L^3 w / c^2, N.
SCALE = VISCOSITY * RADIUS * LENGTH**3 * SPEED / CLEARANCE**2


def load_of(ratio: float) -> float:
    """Of a journal at this eccentricity ratio, in parts of SCALE (F. W. Ocvirk)."""
    rest = 1 - ratio**2
    return ratio / (4 * rest**2) * math.sqrt(16 * ratio**2 + math.pi**2 * rest)


def coefficients(e: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness in W / c and damping in W / (c w), x across the load and y against it."""
    q, rest = math.pi**2, 1 - e**2
    h = (q * rest + 16 * e**2) ** -1.5
    root = e * math.sqrt(rest)
    stiffness = [
        [4 * (q * (2 - e**2) + 16 * e**2), math.pi * (q * rest**2 - 16 * e**4) / root],
        [
            -math.pi * (q * rest * (1 + 2 * e**2) + 32 * e**2 * (1 + e**2)) / root,
            4 * (q * (1 + 2 * e**2) + 32 * e**2 * (1 + e**2) / rest),
        ],
    ]
    cross = -8 * (q * (1 + 2 * e**2) - 16 * e**2)
    damping = [
        [2 * math.pi * math.sqrt(rest) * (q * (1 + 2 * e**2) - 16 * e**2) / e, cross],
        [cross, 2 * math.pi * (q * rest**2 + 48 * e**2) / root],
    ]
    return h * np.array(stiffness), h * np.array(damping)


def rotor(weight: float, mass: float) -> Machine:
    """Without weight of its own: a force carries it."""
    joint: dict[str, Any] = {
        "kind": "turning", "links": ["rotor", "bed"], "at": [0, 0], "pin_radius": RADIUS,
        "film": {"viscosity": VISCOSITY, "length": LENGTH}, "contact": {"friction": 0},
    }  # fmt: skip
    return parse_machine(
        {
            "name": "rotor",
            "gravity": 0,
            "links": {"bed": {"fixed": True}, "rotor": {"mass": mass, "inertia": 1, "cg": [0, 0]}},
            "joints": {"B": joint},
            "drive": {"kind": "rotation", "joint": "B", "speed": SPEED},
            "loads": [{"link": "rotor", "at": [0, 0], "force": [0, -weight]}],
        }
    )


def place(ratio: float) -> np.ndarray:
    """Where the load holds the journal, m: off its own line by the attitude angle, in the sense of the rotation."""
    angle = math.atan2(math.pi * math.sqrt(1 - ratio**2), 4 * ratio)
    return ratio * CLEARANCE * np.array([math.sin(angle), -math.cos(angle)])


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.3, 0.6, 0.9])  # 0: that of the published example
def test_coefficients_of_the_film(ratio: float) -> None:
    published = ratio or brentq(lambda e: SCALE * load_of(e) - WEIGHT, 0.01, 0.99)
    weight, mass = SCALE * load_of(published), 10.0
    model = build_model(rotor(weight, mass), ["B"])
    assert model.kinematics.names == ("x(rotor)", "y(rotor)")
    p = model.vector({"joints.B.clearance": CLEARANCE})
    at, rest = place(published), np.zeros(2)
    assert np.abs(evaluate(model.right_hand_side, 0.0, at, rest, p)[0]).max() < 1e-9 * weight / mass
    found = [-mass * part for part in evaluate(model.linearised, 0.0, at, rest, p)]
    stiffness, damping = coefficients(published)
    assert found[0] * CLEARANCE / weight == pytest.approx(stiffness, rel=1e-8)
    assert found[1] * CLEARANCE * SPEED / weight == pytest.approx(damping, rel=1e-8)
    if not ratio:
        example = [[12807959, 16393593], [-25060393, 8815302]]
        assert found[0] == pytest.approx(np.array(example), rel=1e-7)


@pytest.mark.parametrize("ratio", [0.1, 0.3, 0.6])
def test_where_oil_whirl_begins(ratio: float) -> None:
    """Of a push by a hundredth of the clearance nothing is left 5 % below the critical mass, 5 % above it grows."""
    k, c = coefficients(ratio)
    effective = (k[0, 0] * c[1, 1] + k[1, 1] * c[0, 0] - c[1, 0] * k[0, 1] - c[0, 1] * k[1, 0]) / np.trace(c)
    whirl = (effective - k[0, 0]) * (effective - k[1, 1]) - k[0, 1] * k[1, 0]
    whirl = math.sqrt(whirl / np.linalg.det(c))  # in parts of the speed
    weight = SCALE * load_of(ratio)
    critical = effective * weight / (CLEARANCE * (whirl * SPEED) ** 2)
    masses = critical * np.array([0.95, 1.0, 1.05])
    x, y = place(ratio)
    period = 2 * math.pi / (whirl * SPEED)
    runs = trajectories(
        rotor(weight, critical),
        [{"B": CLEARANCE}],
        [{"x(rotor)": (x + 0.01 * CLEARANCE, 0.0), "y(rotor)": (y, 0.0)}] * 3,
        step=period / 1000,
        steps_a_sample=10,
        samples=3001,
        parameters=[{"links.rotor.mass": mass} for mass in masses],
    )
    sizes = [np.hypot(run.z[:, 0] - x, run.z[:, 1] - y) for run in runs]
    first, last = (np.array([size[part].max() for size in sizes]) for part in (slice(200, 300), slice(2900, 3000)))
    below, at, above = last / first
    assert below < 0.9 < 1.1 < above
    assert at == pytest.approx(1.0, abs=0.02)
    angle = np.unwrap(np.angle(runs[1].z[:, 0] - x + 1j * (runs[1].z[:, 1] - y)))
    turns = (angle[2900] - angle[200]) / (2 * math.pi)
    assert turns * period / (runs[1].t[2900] - runs[1].t[200]) == pytest.approx(1.0, abs=2e-3)
    assert 0.45 < whirl < 0.53


def test_beyond_an_eccentricity_of_three_quarters_nothing_whirls() -> None:
    """The whirl's frequency falls to nothing at 0.756, the figure usually given for short bearings."""

    def square(ratio: float) -> float:
        k, c = coefficients(ratio)
        effective = (k[0, 0] * c[1, 1] + k[1, 1] * c[0, 0] - c[1, 0] * k[0, 1] - c[0, 1] * k[1, 0]) / np.trace(c)
        return float((effective - k[0, 0]) * (effective - k[1, 1]) - k[0, 1] * k[1, 0])

    assert brentq(square, 0.7, 0.8) == pytest.approx(0.756, abs=1e-3)
    model = build_model(rotor(SCALE * load_of(0.78), 1e4), ["B"])
    p = model.vector({"joints.B.clearance": CLEARANCE})
    parts = evaluate(model.linearised, 0.0, place(0.78), np.zeros(2), p)
    assert np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], parts])).real.max() < 0
