"""Variants of a machine: what differs between cases, but is no number that a case could change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

from jointplay.solver.machines.equal_contact import equal_contact
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.machines.parts import Load, Ripple, RotationDrive

LawChoice = Literal["own", "linear", "hertz"]
"""Contact law of the joints that can wear: as the machine file has it, or another one fitted to it."""

_PHASES = (0.0, math.pi / 2)
"""Of the sine and the cosine of an order."""


@dataclass(frozen=True)
class Variant:
    """How the machine of a case differs in kind from the machine file.

    Parameters
    ----------
    law : {"own", "linear", "hertz"}
        Contact law of the joints that can wear.
    ripple : tuple of int
        Orders of additional ripple of the drive, each a sine and a cosine of amplitude 0, so that a case can give them
        any amplitude and phase.
    load : str
        Link that carries an additional load of size 0, see :func:`output_load`; empty for none.
    load_orders : tuple of int
        Orders of further such loads, each a sine and a cosine over the angle of the drive.
    """

    law: LawChoice = "own"
    ripple: tuple[int, ...] = ()
    load: str = ""
    load_orders: tuple[int, ...] = ()

    @property
    def content(self) -> dict[str, Any]:
        """What differs from the machine file, as plain data; empty if nothing does. :meth:`from_content` reads it."""
        law = {} if self.law == "own" else {"law": self.law}
        ripple = {"ripple": list(self.ripple)} if self.ripple else {}
        orders = {"load_orders": list(self.load_orders)} if self.load_orders else {}
        return {**law, **ripple, **({"load": self.load} if self.load else {}), **orders}

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Self:
        """Read what :attr:`content` wrote.

        Raises
        ------
        TypeError
            There is more than that in it.
        ValueError
            A law that is not known.
        """
        listed = {name: tuple(map(int, content.get(name, ()))) for name in ("ripple", "load_orders")}
        variant = cls(**{**content, **listed})
        if variant.law not in get_args(LawChoice):
            raise ValueError(f"law {variant.law!r} is not known")
        return variant

    def machine(self, base: Machine) -> Machine:
        """The machine of this variant; kept, so that asking again costs nothing."""
        return _machine(base, self)


AS_FILED = Variant()
"""The machine as its file has it."""


@dataclass(frozen=True)
class ProcessLoad:
    """Where a load of the process acts on a machine.

    Parameters
    ----------
    link : str
        The link that does the work.
    at : (float, float)
        Point of it [m], in the drawing.
    direction : (float, float)
        Unit vector of the force; (0, 0) for a torque.
    arm : float
        Length [m] that makes a torque of a force; 0 for a force.
    """

    link: str
    at: tuple[float, float]
    direction: tuple[float, float]
    arm: float = 0.0


def output_load(machine: Machine) -> ProcessLoad | None:
    """Where the process loads a machine: along a slide on the frame, else as a torque on a link that turns on it.

    Returns
    -------
    ProcessLoad or None
        None if nothing but the driven link moves on the frame.
    """
    driven = getattr(machine.drive, "joint", "")
    turning: list[ProcessLoad] = []
    for name, joint in machine.joints.items():
        if machine.frame not in joint.links or name == driven:
            continue
        link = next(link for link in joint.links if link != machine.frame)
        if not isinstance(joint, TurningJoint):
            return ProcessLoad(link, joint.at, joint.direction)
        arm = max(math.dist(joint.at, other.at) for other in machine.joints.values() if link in other.links)
        turning.append(ProcessLoad(link, joint.at, (0.0, 0.0), arm or 1.0))
    return turning[0] if turning else None


@keep_by_machine(64)
def _machine(base: Machine, variant: Variant) -> Machine:
    changes: dict[str, Any] = {}
    if variant.law != "own":
        changes["joints"] = {
            name: joint.model_copy(update={"contact": equal_contact(base, joint, variant.law)})
            if name in base.wearing_joints
            else joint
            for name, joint in base.joints.items()
        }
    if variant.ripple and isinstance(base.drive, RotationDrive):
        terms = [Ripple(order=o, amplitude=0.0, phase=p) for o in variant.ripple for p in _PHASES]
        changes["drive"] = base.drive.model_copy(update={"ripple": (*base.drive.ripple, *terms)})
    load = output_load(base) if variant.load else None
    if load is not None:
        waves = [Load(link=variant.load, at=load.at, order=o, phase=p) for o in variant.load_orders for p in _PHASES]
        changes["loads"] = (*base.loads, Load(link=variant.load, at=load.at), *waves)
    return base.model_copy(update=changes) if changes else base
