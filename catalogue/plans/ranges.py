"""What is uncertain about a machine unless a plan says otherwise; ranges follow from the machine's own numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping

from jointplay.catalogue.plans.draws import Distribution
from jointplay.catalogue.plans.variants import LawChoice, output_load
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Damper, Mount, RotationDrive, Spring

#: Standard deviation of the logarithm of contact stiffness and damping. The contact law is drawn, so they need not
#: stand for it; docs/measured/catalogues.md says what was compared.
STIFFNESS_SCATTER = 0.4
DAMPING_SCATTER = 0.4

#: Standard deviations of the logarithm of what every file says a little wrong: mass and inertia of a frame with all
#: that is bolted to it, and each mount: nineteen of twenty pieces of the same rubber lie within 10 % of stiffness.
TOLERANCE = {"mass": 0.025, "inertia": 0.03, "stiffness": 0.05, "damping": 0.15}

#: Hysteresis [s/m] of Hertzian contacts: from nearly elastic to a restitution of about a tenth at 0.1 m/s.
HYSTERESIS = (0.3, 30.0)

#: Speed ripple of an order, relative; the low orders of drives that are too weak, 6 and 12 of motors with three phases.
RIPPLE = (1e-4, 1e-2)
RIPPLE_ORDERS = (1, 2, 3, 4, 6, 12)

#: Process load, as a part of the weight and the inertia of the moving links; and orders of what comes and goes with a
#: turn, each as a part of that: a force on one of two strokes is 1/2, 0.64, 0 and 0.21 of itself in orders 0 to 3.
LOAD = (0.01, 1.0)
LOAD_ORDERS = {1: 0.6, 2: 0.3, 3: 0.2}
#: Acceleration of gravity [m/s2] that weights are meant with, also where a machine lies flat.
WEIGHT = 9.81


def default_laws(machine: Machine) -> dict[LawChoice, float]:
    """Contact laws that are drawn, with their weights: the machine's own, and the other one of linear and Hertzian."""
    contacts = [joint.contact.law for joint in machine.joints.values() if isinstance(joint, TurningJoint)]
    return {"own": 1.0, "hertz" if "linear" in contacts else "linear": 1.0}


def default_uncertain(machine: Machine, laws: Mapping[LawChoice, float]) -> dict[str, Distribution]:
    """What is not known even of a machine whose data can be trusted: speed, tolerances, and everything about contacts.

    Parameters
    ----------
    machine : Machine
    laws : mapping of str to float
        Contact laws that are drawn.

    Returns
    -------
    dict of str to Distribution
        By path, see :class:`~jointplay.catalogue.plans.parameters.MachineNumbers`.
    """
    turning = [joint.contact for joint in machine.joints.values() if isinstance(joint, TurningJoint)]
    contacts = turning if "own" in laws else []  # any other law takes the place of the file's in every joint
    known = {contact.law for contact in contacts} | set(laws)
    found = {
        "drive.speed": Distribution(factor_uniform=(0.97, 1.03)),
        "contact.friction": Distribution(uniform=(0.01, 0.15)),
        "contact.stiffness": Distribution(lognormal=STIFFNESS_SCATTER),
    }
    if any(getattr(joint, "pin_radius", 0.0) > 0 for joint in machine.joints.values()):
        found["pin_radius"] = Distribution(factor_uniform=(0.9, 1.1))
    if "linear" in known:
        found["contact.damping"] = Distribution(lognormal=DAMPING_SCATTER)
    if "hertz" in known:
        found["contact.hysteresis"] = Distribution(loguniform=HYSTERESIS)
    asked = [contact.restitution for contact in contacts if contact.restitution is not None]
    if asked:
        low, high = max(0.05, min(asked) - 0.25), min(1.0, max(asked) + 0.25)
        found["contact.restitution"] = Distribution(uniform=(low, high))
    return found | {
        path: Distribution(lognormal=TOLERANCE[path.rpartition(".")[2]]) for path in _frame_and_mounts(machine)
    }


def default_wide(machine: Machine) -> dict[str, Distribution]:
    """What else is not known of a machine whose data cannot be trusted: frame, supports, load, ripple of the drive.

    Supports have one common factor each for x and y, and each mount a smaller one of its own: a single loose mount
    stays outside of all draws.

    Returns
    -------
    dict of str to Distribution
        By path, see :class:`~jointplay.catalogue.plans.parameters.MachineNumbers`.
    """
    factors = {
        "frame.mass": Distribution(factor_uniform=(0.8, 1.2)),
        "frame.inertia": Distribution(factor_uniform=(0.8, 1.2)),
        "supports.stiffness": Distribution(factor_uniform=(0.7, 1.3)),
        "supports.damping": Distribution(factor_loguniform=(0.5, 2.0)),
    }
    own = {"stiffness": Distribution(factor_uniform=(0.85, 1.15)), "damping": Distribution(factor_uniform=(0.8, 1.25))}
    found = {path: factors.get(path) or own[path.rpartition(".")[2]] for path in _frame_and_mounts(machine)}
    if any(path[9:10].isdigit() for path in found):
        found |= {f"supports.{name}.{axis}": factors[f"supports.{name}"] for name in own for axis in "xy"}
    load = output_load(machine)
    if load is not None:
        scale = _weight_and_inertia(machine) * (load.arm or 1.0)
        found["load"] = _either(LOAD, scale)
        for order, share in LOAD_ORDERS.items():
            spread = _either(LOAD, share * scale)
            found |= {f"load.{order}.sin": spread, f"load.{order}.cos": spread}
    for order in RIPPLE_ORDERS:
        spread = _either(RIPPLE, 1.0 / order)
        found |= {f"ripple.{order}.sin": spread, f"ripple.{order}.cos": spread}
    return found


def _frame_and_mounts(machine: Machine) -> list[str]:
    """Short paths of the frame's numbers, as far as it moves, of mounts, and of springs and dampers by themselves."""
    frame = machine.links[machine.frame]
    if frame.fixed:
        return []
    free = {"x", "y", "theta"}.difference(frame.locked)
    moved = {"frame.mass": frame.mass and free & {"x", "y"}, "frame.inertia": frame.inertia and free & {"theta"}}
    paths = [path for path, is_held in moved.items() if is_held]
    own = [(place, each) for place, each in enumerate(machine.supports) if each.link == machine.frame]
    for name, single in (("stiffness", Spring), ("damping", Damper)):
        paths += [f"supports.{place}.{name}" for place, support in own if isinstance(support, Mount)]
        if any(isinstance(support, single) for _, support in own):
            paths.append(f"supports.{name}")
    return paths


def _either(bounds: tuple[float, float], scale: float) -> Distribution:
    low, high = (float(f"{scale * bound:.3g}") for bound in bounds)
    return Distribution(either_loguniform=(low, high))


def _weight_and_inertia(machine: Machine) -> float:
    """Force [N] of the moving links' weight, and of their mass on the way of the driven link's end."""
    moving = sum(link.mass or 0.0 for name, link in machine.links.items() if name != machine.frame)
    drive = machine.drive
    joint = machine.joints.get(str(getattr(drive, "joint", "")))
    speed = drive.speed if isinstance(drive, RotationDrive) and isinstance(drive.speed, float) else 0.0
    driven = [name for name in joint.links if name != machine.frame] if joint else []
    ends = [math.dist(joint.at, end.at) for end in machine.joints.values() if joint and {*driven} & {*end.links}]
    return moving * (WEIGHT + max(ends, default=0.0) * speed**2)
