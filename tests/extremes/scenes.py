"""Machines at the ends of what their numbers may be, and the laws that judge them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from laws import Array, Tree, drawn, run, states, tree_of

from jointplay.solver.cases.history import History
from jointplay.solver.equations.links import LinkMotion
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.machines.parts import TorqueDrive

RPM = 2 * math.pi / 60
TORQUE: Tree = {"kind": "torque", "joint": "O", "torque": 2.0}


def lossless(name: str = "slider-crank", **contact: float) -> Tree:
    """A shipped machine turned by 2 N m, without dampers, contact damping or friction."""
    tree = tree_of(name, **{"damping": 0.0, "friction": 0.0, **contact})
    tree["drive"] = TORQUE
    for support in tree["supports"]:
        support["damping"] = [0.0, 0.0]
    return tree


def heavier(link: str, factor: float) -> Tree:
    """The lossless slider-crank with one link so many times as heavy."""
    tree = lossless()
    tree["links"][link]["mass"] *= factor
    tree["links"][link]["inertia"] *= factor
    return tree


def framed(change: Tree, base: Tree | None = None, **other: Any) -> Tree:
    """The lossless slider-crank with another frame."""
    tree = base or lossless()
    tree["links"]["frame"] |= change
    return tree | other


def similar(tree: Tree, factor: float) -> Tree:
    """The same machine in slow motion: all speeds divided by `factor`, every path exactly as before.

    Forces go with the square of the speed; gravity, stiffness, damping and the velocity of the friction law with them.
    """
    tree["gravity"] /= factor**2
    tree["drive"]["speed"] /= factor
    for support in tree["supports"]:
        support["stiffness"] = [k / factor**2 for k in support["stiffness"]]
        support["damping"] = [c / factor for c in support["damping"]]
    for joint in tree["joints"].values():
        if joint["kind"] == "turning":
            law = joint["contact"]
            law["stiffness"] /= factor**2
            law["damping"] /= factor
            law["viscous"] /= factor
            law["friction_velocity"] /= factor
    return tree


def at_speed(speed: object, name: str = "slider-crank") -> Tree:
    """A shipped machine with another drive speed, rad/s."""
    tree = tree_of(name)
    tree["drive"]["speed"] = speed
    return tree


def four_bar(crank: float, coupler: float, rocker: float, base: float, angle: float) -> Machine:
    """A four-bar on a sprung bed, driven at 30 rad/s, drawn at a crank angle; lengths in m."""
    ax, ay = crank * math.cos(angle), crank * math.sin(angle)
    gap = math.hypot(base - ax, ay)
    along = (coupler**2 - rocker**2 + gap**2) / (2 * gap)
    across = math.sqrt(max(0.0, coupler**2 - along**2))
    bx = ax + (along * (base - ax) + across * ay) / gap
    by = ay + (-along * ay + across * (base - ax)) / gap
    links = {
        "bed": {"mass": 20, "inertia": 0.5, "cg": [0, 0]},
        "crank": {"mass": 0.3, "inertia": 1e-4, "cg": [ax / 2, ay / 2]},
        "coupler": {"mass": 0.4, "inertia": 1e-3, "cg": [(ax + bx) / 2, (ay + by) / 2]},
        "rocker": {"mass": 0.5, "inertia": 1e-3, "cg": [(base + bx) / 2, by / 2]},
    }
    ends = {"O": ("crank", "bed", 0, 0), "A": ("coupler", "crank", ax, ay), "B": ("coupler", "rocker", bx, by)}
    joints = {
        name: {"kind": "turning", "links": [one, other], "at": [x, y]}
        for name, (one, other, x, y) in {**ends, "D": ("rocker", "bed", base, 0)}.items()
    }
    supports = [
        {"kind": "mount", "link": "bed", "at": [x, -0.1], "stiffness": [2e5, 4e5], "damping": [200, 300]}
        for x in (-0.2, 0.2)
    ]
    drive = {"kind": "rotation", "joint": "O", "speed": 30}
    return parse_machine({"name": "four-bar", "links": links, "joints": joints, "drive": drive, "supports": supports})


def equal_legs() -> Tree:
    """A slider-crank with a rod of the crank's length: with the crank upright the slider is on its shaft."""
    tree = tree_of("slider-crank")
    tree["joints"]["B"]["at"] = tree["joints"]["G1"]["at"] = tree["links"]["slider"]["cg"] = [0.1, 0.05]
    tree["links"]["rod"]["cg"] = [0.075, 0.05]
    return tree


def energy_less_work(machine: Machine, fault: Mapping[str, float], motion: LinkMotion) -> tuple[Array, float]:
    """Energy less the work of a constant torque (n,), J, and the largest of either, which its drift is measured by."""
    assert isinstance(machine.drive, TorqueDrive)
    first, second = (motion.links.index(link) for link in machine.joints[machine.drive.joint].links)
    turn = motion.displacement[:, first, 2] - motion.displacement[:, second, 2]
    work = (machine.drive.torque or 0.0) * turn
    clearances = {joint: clearance for joint, clearance in fault.items() if clearance}
    energy = np.array([state.energy(clearances) for state in states(machine, motion)])
    return energy - work, float(max(np.abs(energy).max(), np.ptp(work)))


def momenta(machine: Machine, motion: LinkMotion) -> tuple[Array, Array, Array]:
    """Centre of gravity (n, 2), m, momentum (n, 2), and angular momentum about that centre (n,) of all links."""
    mass, inertia = (np.array([getattr(link, key) for link in machine.links.values()]) for key in ("mass", "inertia"))
    x, v = motion.displacement + drawn(machine), motion.velocity
    linear = np.einsum("i,tik->tk", mass, v[:, :, :2])
    centre = np.einsum("i,tik->tk", mass, x[:, :, :2]) / mass.sum()
    arm = x[:, :, :2] - centre[:, None]
    turning = (arm[:, :, 0] * v[:, :, 1] - arm[:, :, 1] * v[:, :, 0]) @ mass + v[:, :, 2] @ inertia
    return centre, linear, turning


def settled(tree: Tree, fault: Mapping[str, float], **settings: Any) -> tuple[Machine, History, LinkMotion]:
    """A run of a machine given as a tree."""
    machine = parse_machine(tree)
    history, motion = run(machine, dict(fault), **settings)
    return machine, history, motion
