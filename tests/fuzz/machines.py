"""Random machines of all joints, supports, loads and drives, with numbers as odd as a file may hold.

Half of the machines are as :mod:`oracle.sketch` draws them; the others have one to four extremes: contacts from soft to
hard, clearances from nothing to a centimetre, friction of 1, speeds from 0 to 60 000 rpm, masses a million apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from oracle.sketch import sketch

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine

Tree = dict[str, Any]


@dataclass(frozen=True)
class Scene:
    """A machine with a fault, what is odd about it, and for how long it is watched, s."""

    seed: int
    machine: Machine
    fault: Fault
    odd: tuple[str, ...]
    duration: float


def _contact(number: str, *options: float) -> Callable[[Tree, np.random.Generator], None]:
    def change(tree: Tree, rng: np.random.Generator) -> None:
        for joint in tree["joints"].values():
            if joint["kind"] == "turning" and joint["contact"]["law"] == "linear":
                joint["contact"][number] = float(rng.choice(options))

    return change


def _overdamped(tree: Tree, rng: np.random.Generator) -> None:
    """Ten times the critical damping of a body of 1 kg."""
    for joint in tree["joints"].values():
        if joint["kind"] == "turning" and joint["contact"]["law"] == "linear":
            joint["contact"]["damping"] = 20 * joint["contact"]["stiffness"] ** 0.5


def _guides(number: str, *options: float) -> Callable[[Tree, np.random.Generator], None]:
    def change(tree: Tree, rng: np.random.Generator) -> None:
        for joint in tree["joints"].values():
            if joint["kind"] == "sliding" and (number != "friction_velocity" or joint["friction"]):
                joint[number] = float(rng.choice(options)) if number == "friction_velocity" or joint[number] else 0.0

    return change


def _speed(tree: Tree, rng: np.random.Generator) -> None:
    drive = tree["drive"]
    if drive is not None and drive["kind"] == "rotation":
        drive["speed"], drive["ripple"] = float(rng.choice([0.0, 0.105, 300.0, 6283.0])), []


def _mass(tree: Tree, rng: np.random.Generator) -> None:
    link = tree["links"][str(rng.choice(list(tree["links"])))]
    if link["mass"] is not None:
        factor = float(rng.choice([1e-6, 1e-3, 1e3, 1e6]))
        link["mass"], link["inertia"] = link["mass"] * factor, link["inertia"] * factor


def _bare(tree: Tree, rng: np.random.Generator) -> None:
    springs = [s for s in tree["supports"] if s["kind"] == "spring"]
    tree["supports"] = springs if rng.random() < 0.5 else []


def _loads(tree: Tree, rng: np.random.Generator) -> None:
    for load in tree["loads"]:
        if load["over_time"] is None and load["over_angle"] is None:
            load["force"] = [1e3 * part for part in load["force"]]


def _equilibrium(tree: Tree, rng: np.random.Generator) -> None:
    tree["initial"]["pose"] = "equilibrium"


def _thrown(tree: Tree, rng: np.random.Generator) -> None:
    link = str(rng.choice(list(tree["links"])))
    tree["initial"]["velocities"] = {link: {"omega": float(rng.uniform(-20, 20))}}


EXTREMES: dict[str, Callable[[Tree, np.random.Generator], None]] = {
    "soft or hard contact": _contact("stiffness", 1e4, 1e10, 1e12),
    "undamped contact": _contact("damping", 0.0),
    "overdamped contact": _overdamped,
    "contact friction": _contact("friction", 0.0, 1.0),
    "contact friction velocity": _contact("friction_velocity", 1e-4, 1.0),
    "guide friction": _guides("friction", 1.0),
    "guide friction velocity": _guides("friction_velocity", 1e-4, 1.0),
    "speed": _speed,
    "mass": _mass,
    "bare supports": _bare,
    "heavy loads": _loads,
    "equilibrium": _equilibrium,
    "thrown": _thrown,
}  # fmt: skip


def scene(seed: int) -> Scene:
    """The machine of a seed."""
    drawn = sketch(seed)
    rng = np.random.default_rng([seed, 2])
    tree: Tree = drawn.machine.model_dump(mode="json")
    odd: list[str] = []
    clearances = dict(drawn.clearances)
    if rng.random() < 0.5:
        odd = [str(name) for name in rng.choice(list(EXTREMES), int(rng.integers(1, 5)), replace=False)]
        for name in odd:
            EXTREMES[name](tree, rng)
        if rng.random() < 0.4:
            odd.append("clearance")
            clearances = {joint: float(rng.choice([1e-7, 1e-5, 1e-2])) for joint in clearances}
    speed = (tree["drive"] or {}).get("speed")
    fast = abs(speed) if isinstance(speed, float) and tree["drive"]["kind"] == "rotation" else 0.0
    duration = min(0.003, 0.3 / max(fast, 1e-9))
    try:
        machine = parse_machine(tree)
    except MachineError:  # a body that only a support held, a velocity of what is fixed
        whole = drawn.machine.model_dump(mode="json")
        machine = parse_machine({**tree, "supports": whole["supports"], "initial": whole["initial"]})
    return Scene(seed, machine, Fault(clearances), tuple(odd), duration)
