"""Slider-crank with a loose gudgeon pin: crank 50 mm, rod 120 mm, 5000 rpm, radial clearance 0.5 mm.

The parameter set is the one usually quoted with this benchmark family (Ravn; Schwab, Meijaard and Meijers; Flores and
co-workers): Lankarani-Nikravesh contact with K = 6.610198e10 N/m^1.5 (Hertz's formula for steel, radii 10 and 10.5 mm)
and a restitution of 0.9, no gravity, no friction. Published tables of impacts were not at hand. What is compared is
an independent solution in minimal coordinates: DOP853 with contact events, rtol 1e-11 and 1e-13 agree to the digits
given.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from laws import drawn
from numpy.typing import NDArray

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.simulation.simulate import simulate

Array = NDArray[np.float64]

CLEARANCE = 0.5e-3
SPEED = 5000 * 2 * math.pi / 60
#: Start (s), velocity of approach (m/s), duration (s), largest force (N), impulse (N s) of the first contacts.
CONTACTS = np.array(
    [
        (2.2728603e-4, 4.3857832, 5.343723e-5, 45872.28, 1.3093655),
        (6.3705643e-4, 2.7569492, 5.383416e-5, 20869.93, 0.5846364),
        (7.4970028e-4, 1.8266991, 6.545016e-5, 25926.15, 0.8697396),
        (1.08594703e-3, 1.1018512, 6.075807e-5, 6557.87, 0.2069387),
        (1.20581613e-3, 0.8238005, 2.850705e-4, 12915.66, 1.3260353),
        (1.55148600e-3, 0.2709394, 7.627137e-5, 1672.21, 0.0644635),
        (1.71508179e-3, 0.2572771, 5.776258e-4, 4943.07, 0.9558193),
        (2.87249529e-3, 3.7802489, 3.959673e-5, 22693.03, 0.4822371),
    ]
)


def slider_crank() -> Machine:
    contact = {"law": "lankarani-nikravesh", "stiffness": 6.610198e10, "restitution": 0.9, "friction": 0}
    return parse_machine(
        {
            "name": "fast",
            "gravity": 0,
            "links": {
                "bed": {"fixed": True},
                "crank": {"mass": 0.3, "inertia": 1e-4, "cg": [0, 0]},
                "rod": {"mass": 0.21, "inertia": 2.5e-4, "cg": [0.11, 0]},
                "slider": {"mass": 0.14, "inertia": 1e-5, "cg": [0.17, 0]},
            },
            "joints": {
                "O": {"kind": "turning", "links": ["crank", "bed"], "at": [0, 0]},
                "A": {"kind": "turning", "links": ["rod", "crank"], "at": [0.05, 0]},
                "B": {"kind": "turning", "links": ["rod", "slider"], "at": [0.17, 0], "contact": contact},
                "G": {"kind": "sliding", "links": ["slider", "bed"], "at": [0.17, 0], "direction": [1, 0]},
            },
            "drive": {"kind": "rotation", "joint": "O", "speed": SPEED},
        }
    )


def root(t: Array, gap: Array, rate: Array, i: int) -> tuple[float, float]:
    """When the gap vanishes between two samples, and its rate then: cubic through both, by Newton's method."""
    h = t[i + 1] - t[i]
    p0, p1, r0, r1 = gap[i], gap[i + 1], h * rate[i], h * rate[i + 1]
    a, b = 2 * p0 - 2 * p1 + r0 + r1, -3 * p0 + 3 * p1 - 2 * r0 - r1
    s = p0 / (p0 - p1)
    for _ in range(20):
        s -= (p0 + s * (r0 + s * (b + s * a))) / (r0 + s * (2 * b + 3 * s * a))
    return float(t[i] + s * h), float((r0 + s * (2 * b + 3 * s * a)) / h)


def contacts(settings: Settings) -> Array:
    """The columns of the table; the largest force is that of a sample."""
    machine = slider_crank()
    history = simulate(machine, Case(Fault({"B": CLEARANCE})), settings)
    assert history.status is Status.OK
    assert history.links is not None
    place, rate = history.links.displacement + drawn(machine), history.links.velocity
    angle, arm = place[:, 2, 2], 0.06  # from the rod's centre of gravity to its pin
    along = arm * np.column_stack([np.cos(angle), np.sin(angle)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    e = place[:, 2, :2] + along - place[:, 3, :2]
    e_rate = rate[:, 2, :2] + rate[:, 2, 2:] * across - rate[:, 3, :2]
    size = np.hypot(*e.T)
    gap, approach = size - CLEARANCE, np.sum(e * e_rate, axis=1) / size
    force = np.hypot(*history.links.reactions["force_B_on_pin"].T)
    inside = (gap > 0).astype(int)
    rows = []
    for first, last in zip(np.flatnonzero(np.diff(inside) > 0), np.flatnonzero(np.diff(inside) < 0), strict=False):
        began, velocity = root(history.t, gap, approach, first)
        span = slice(first, last + 2)
        impulse = np.trapezoid(force[span], history.t[span])
        rows.append((began, velocity, root(history.t, gap, approach, last)[0] - began, force[span].max(), impulse))
    return np.array(rows)


@pytest.mark.parametrize(
    # A perturbation grows from contact to contact. Measured at worst over all rows with rtol 1e-12: 1e-11 s (the last
    # digit given), 4e-7, 1.3e-7, 2e-6 (the peak between samples of 50 ns), 1e-7; with rtol 1e-9 8e-10 s, 8e-6, 3e-6,
    # 3e-6, 2e-6; at `standard` 2.3e-7 s and 2e-3, fixed steps at `standard` 8e-8 s and 3e-4.
    ("settings", "start", "relative"),
    [
        ({"rtol": 1e-12}, 2e-11, (1e-6, 5e-7, 4e-6, 5e-7)),
        ({"accuracy": "reference"}, 2e-9, (2e-5, 1e-5, 1e-5, 1e-5)),
        ({"accuracy": "standard"}, 5e-7, (5e-3, 2e-3, 2e-3, 2e-3)),
        ({"method": "gill", "accuracy": "standard"}, 2e-7, (1e-3, 1e-4, 1e-3, 1e-3)),
    ],
    ids=["rtol 1e-12", "reference", "standard", "gill"],
)
def test_the_first_eight_contacts(settings: dict[str, float], start: float, relative: tuple[float, ...]) -> None:
    found = contacts(Settings(duration=3e-3, sample_rate=2e7, links=True, **settings))  # type: ignore[arg-type]
    assert len(found) >= len(CONTACTS)
    gap = np.abs(found[: len(CONTACTS)] - CONTACTS)
    assert gap[:, 0].max() < start
    assert (gap[:, 1:] < CONTACTS[:, 1:] * relative).all()
