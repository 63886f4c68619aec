"""Every number of a machine at the ends of its range: what comes out is checked against a law, or refused by name.

Each row is one extreme. `measure` runs it and returns how far it is from what must hold (relative, unless it says
otherwise); `limit` is about three times what was measured when the row was written, and mostly the tolerance's doing:
runs have rtol 1e-8. The table with the figures is in docs/measured/extremes.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from extremes.scenes import (
    RPM,
    at_speed,
    energy_less_work,
    framed,
    heavier,
    lossless,
    momenta,
    settled,
    similar,
)
from laws import Tree, tree_of

from jointplay.solver.machines.machine import shipped_machine

Fault = Mapping[str, float]
WORN: Fault = {"B": 2e-4}
TWO: Fault = {"A": 1e-4, "B": 2e-4}


# What must hold -------------------------------------------------------------------------------------------------------


def energy(tree: Tree, fault: Fault, **settings: Any) -> float:
    """Largest drift of energy less work over 0.05 s, as part of the larger of the two."""
    machine, _, motion = settled(tree, fault, **{"duration": 0.05, "sample_rate": 5000, "rtol": 1e-8, **settings})
    rest, scale = energy_less_work(machine, fault, motion)
    return float(np.ptp(rest)) / scale


def never_gained(tree: Tree, fault: Fault) -> float:
    """Largest gain of energy less work between two samples of a machine with losses; it must also lose some."""
    machine, _, motion = settled(tree, fault, duration=0.1, sample_rate=5000, rtol=1e-8)
    rest, scale = energy_less_work(machine, fault, motion)
    assert rest[-1] < rest[0] - 1e-3 * scale
    return float(np.diff(rest).max()) / scale


def _gains(tree: Tree, fault: Fault) -> list[float]:
    """The same for twelve torques of the drive that differ a little."""
    torque = tree["drive"]["torque"]
    drives = ({**tree["drive"], "torque": torque * (1 + 0.01 * k)} for k in range(12))
    return [never_gained({**tree, "drive": drive}, fault) for drive in drives]


def mostly_never_gained(tree: Tree, fault: Fault) -> float:
    """The largest but one of them."""
    return sorted(_gains(tree, fault))[-2]


def hardly_gained(tree: Tree, fault: Fault) -> float:
    """The largest of them. A step that ends just past a reversal of strong friction can have a small error estimate and
    a large error: of 200 torques this happened in 2 (8e-7 at most), and under another rule for steps in 5 (1.4e-6)."""
    return max(_gains(tree, fault))


def as_ideal(tree: Tree, fault: Fault) -> float:
    """Distance of the frame's motion from the ideal machine's, m."""
    settings = {"duration": 0.1, "sample_rate": 5000, "rtol": 1e-9}
    _, worn, _ = settled(tree, fault, **settings)
    _, ideal, _ = settled(tree, {}, **settings)
    return float(np.abs(worn.displacement - ideal.displacement).max())


def as_without(tree: Tree, fault: Fault) -> float:
    """Distance of all links from the machine whose worn joints were taken out altogether, m; nothing ever touches.

    The rod starts with the rotation that the ideal machine has as drawn.
    """
    settings = {"duration": 0.1, "sample_rate": 5000, "rtol": 1e-9}
    _, _, loose = settled(tree, fault, **settings)
    assert not any(loose.reactions[f"force_{joint}_on_pin"].any() for joint in fault)
    taken = {**tree, "joints": {name: joint for name, joint in tree["joints"].items() if name not in fault}}
    taken["initial"] = {"velocities": {"rod": {"omega": -tree["drive"]["speed"] * 0.05 / 0.15}}}
    _, _, without = settled(taken, {}, **settings)
    return float(np.abs(loose.displacement - without.displacement).max())


def as_slow_motion(tree: Tree, fault: Fault) -> float:
    """Distance of two revolutions from those of the similar machine at 600 rpm, frame, sample by sample, m."""
    factor = tree["drive"]["speed"] / (600 * RPM)
    duration = 2 * 2 * math.pi / tree["drive"]["speed"]
    _, fast, _ = settled(tree, fault, duration=duration, sample_rate=200 * factor, rtol=1e-9)
    _, slow, _ = settled(similar(tree, factor), fault, duration=duration * factor, sample_rate=200, rtol=1e-9)
    assert len(fast.t) == len(slow.t)
    return float(np.abs(fast.displacement - slow.displacement).max())


def sag(tree: Tree, fault: Fault) -> float:
    """Once the suspension has come to rest, the frame hangs lower by weight over stiffness."""
    machine, history, _ = settled(tree, fault, duration=4.0, sample_rate=100)
    weight = 9.81 * sum(link.mass or 0.0 for link in machine.links.values())
    resting = history.displacement[history.t > 3.0, 1]
    return float(np.abs(resting / (-weight / 8e5) - 1).max())


def free_flight(tree: Tree, fault: Fault) -> float:
    """Driven or not, the centre of gravity of all links falls (m), and they turn on as they did (relative)."""
    machine, history, motion = settled(tree, fault, duration=0.3, sample_rate=2000, rtol=1e-9)
    centre, linear, turning = momenta(machine, motion)
    mass = sum(link.mass or 0.0 for link in machine.links.values())
    t, g = history.t[:, None], np.array([0.0, -machine.gravity])
    fall = centre - centre[0] - linear[0] / mass * t - g * t**2 / 2
    return max(float(np.abs(fall).max()), float(np.ptp(turning)) / abs(float(turning[0])))


def closed_form(tree: Tree, fault: Fault) -> float:
    """Slider of the ideal machine on a fixed frame: r cos a + sqrt(l^2 - r^2 sin^2 a), m."""
    _, history, motion = settled(tree, fault, duration=0.3, sample_rate=1000)
    angle = tree["drive"]["speed"] * history.t
    place = 0.05 * np.cos(angle) + np.sqrt(0.15**2 - (0.05 * np.sin(angle)) ** 2)
    return float(np.abs(motion.displacement[:, motion.links.index("slider"), 0] - (place - 0.2)).max())


# The table ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """An extreme: what is extreme, the machine, its fault, and how far from the law it may be."""

    what: str
    measure: Callable[[Tree, Fault], float]
    limit: float
    tree: Tree
    fault: Fault = field(default_factory=dict)


def rubbing(friction: float) -> Tree:
    """The slider-crank turned by 2 N m, with damped contacts and a guide that rubs; no leverage locks it."""
    tree = lossless(damping=300.0)
    tree["joints"]["G1"]["friction"] = friction
    return tree


def _all_worn(name: str) -> Row:
    machine = shipped_machine(name)
    fault = dict.fromkeys(machine.turning_joints, 1e-4)
    return Row(f"all {len(fault)} joints of {name}", energy, 1e-8, lossless(name), fault)


def critical(stiffness: float) -> float:
    """Damping at which the rod on the slider would just not bounce; the mobility there is 12 1/kg."""
    return 2 * math.sqrt(stiffness / 12)


ROWS = [
    Row("clearance 0", as_ideal, 0.0, tree_of("slider-crank"), {"B": 0.0}),
    Row("clearance 1e-7 m: ideal", as_ideal, 5e-8, tree_of("slider-crank", stiffness=1e9, damping=3e3), {"B": 1e-7}),
    Row("clearance 1e-7 m: energy", energy, 1e-9, lossless(), {"B": 1e-7}),
    Row("clearance 1e-2 m", energy, 3e-8, lossless(), {"B": 1e-2}),
    Row("clearance 0.4 m, past the pin's travel", as_without, 1e-10, tree_of("slider-crank"), {"B": 0.4}),
    Row("contact stiffness 1e4 N/m", energy, 5e-9, lossless(stiffness=1e4), WORN),
    Row("contact stiffness 1e12 N/m", energy, 2e-8, lossless(stiffness=1e12), WORN),
    Row("contact damping 0", energy, 1e-8, lossless(), TWO),
    Row("contact damping 10 x critical", never_gained, 3e-11, lossless(damping=10 * critical(1e7)), WORN),
    Row("contact friction 0", never_gained, 3e-11, lossless(damping=300.0), TWO),
    Row("contact friction 1.0", never_gained, 1e-10, lossless(damping=300.0, friction=1.0), TWO),
    Row("contact friction 1.0, frame without springs", free_flight, 1e-10,
        framed({}, tree_of("slider-crank", friction=1.0), supports=[]), TWO),
    Row("sliding friction 1.0", mostly_never_gained, 3e-11, rubbing(1.0)),
    Row("sliding friction 1.0, any torque", hardly_gained, 3e-6, rubbing(1.0)),
    Row("sliding friction 1.0, worn", never_gained, 3e-11, rubbing(1.0), TWO),
    Row("drive at 1 rpm", as_slow_motion, 1e-15, at_speed(1 * RPM)),
    Row("drive at 1 rpm, worn", sag, 1e-6, at_speed(1 * RPM), WORN),
    Row("drive at 60 000 rpm", as_slow_motion, 1e-14, at_speed(60_000 * RPM)),
    Row("drive at 60 000 rpm, worn", as_slow_motion, 1e-9, at_speed(60_000 * RPM), WORN),
    Row("drive at 0", sag, 1e-6, at_speed(0.0)),
    Row("drive at 0, worn", sag, 1e-6, at_speed(0.0), WORN),
    *[
        Row(f"mass of the {link} x {factor:g}", energy, 1e-8, heavier(link, factor), WORN)
        for link in ("slider", "rod", "frame")
        for factor in (1e-6, 1e6)
    ],
    Row("frame fixed, dead centres", closed_form, 3e-12, framed({"fixed": True}, tree_of("slider-crank"), sensors=[])),
    Row("frame fixed, worn", energy, 1e-8, framed({"fixed": True}, sensors=[]), WORN),
    Row("frame without dampers", energy, 1e-8, lossless(), WORN),
    *[
        Row(f"frame's {motion} locked", energy, 1e-8, framed({"locked": [motion]}), WORN)
        for motion in ("x", "y", "theta")
    ],
    Row("frame without springs", free_flight, 1e-10, framed({}, tree_of("slider-crank"), supports=[]), TWO),
    *[_all_worn(name) for name in ("four-bar", "slider-crank", "quick-return")],
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.what)
def test_extreme(row: Row) -> None:
    measured = row.measure(row.tree, row.fault)
    print(f"{row.what}: {measured:.1e} ({row.measure.__name__}, limit {row.limit:.0e})")  # pytest -s shows it
    assert measured <= row.limit
