"""Rules between the parts of a machine: names that must exist, kinds that must fit, links that must be connected."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.contact_rules import contact_breaches
from jointplay.solver.machines.content import MachineContent
from jointplay.solver.machines.drives import ForceDrive, RotationDrive, TorqueDrive
from jointplay.solver.machines.fields import nearest
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.parts import Damper, Spring
from jointplay.solver.machines.refusals import shown

__all__ = ["check"]


@dataclass(frozen=True)
class Breach:
    """One broken rule: where, what stands there, what must hold."""

    path: str
    value: object
    rule: str


def check(machine: MachineContent, source: str) -> None:
    """Check everything that a single part cannot know about the others.

    Raises
    ------
    MachineError
        For the first rule that is broken, in the order in which a user would repair them.
    """
    for rules in (_links, _joints, _contacts, _drive, _initial, _supports, _loads, _sensors, _connections):
        for breach in rules(machine):
            raise MachineError(source, breach.path, shown(breach.value), breach.rule)


def _known(path: str, name: str, names: Iterable[str], noun: str) -> Iterator[Breach]:
    names = list(names)
    if name not in names:
        yield Breach(path, name, f"is not a {noun} of this machine{nearest(name, names)}")


def _links(machine: MachineContent) -> Iterator[Breach]:
    if not machine.links:
        yield Breach("links", None, "a machine needs at least one link, the frame")
    yield from _known("frame", machine.frame, machine.links, "link")
    for name, link in machine.links.items():
        path = f"links.{name}"
        if not link.fixed:
            for field in ("mass", "inertia", "cg"):
                if field not in link.model_fields_set or getattr(link, field) is None:
                    yield Breach(f"{path}.{field}", None, "is missing; only a fixed link needs none")
        if len(set(link.locked)) != len(link.locked):
            yield Breach(f"{path}.locked", ", ".join(link.locked), "must name each motion once")


def _joints(machine: MachineContent) -> Iterator[Breach]:
    for name, joint in machine.joints.items():
        path = f"joints.{name}"
        for index, link in enumerate(joint.links):
            yield from _known(f"{path}.links.{index}", link, machine.links, "link")
        if joint.links[0] == joint.links[1]:
            yield Breach(f"{path}.links", ", ".join(joint.links), "must be two different links")
        if isinstance(joint, TurningJoint) and joint.pin not in joint.links:
            yield Breach(f"{path}.pin", joint.pin, f"must be one of the joint's links, {' or '.join(joint.links)}")


def _contacts(machine: MachineContent) -> Iterator[Breach]:
    turning = {name: joint for name, joint in machine.joints.items() if isinstance(joint, TurningJoint)}
    contacts = {f"joints.{name}.contact": joint.contact for name, joint in turning.items()}
    for path, value, rule in contact_breaches(machine.defaults.contact, contacts):
        yield Breach(path, value, rule)


def _drive(machine: MachineContent) -> Iterator[Breach]:
    drive = machine.drive
    if drive is None:
        return
    yield from _known("drive.joint", drive.joint, machine.joints, "joint")
    wanted = "turning" if isinstance(drive, (RotationDrive, TorqueDrive)) else "sliding"
    found = machine.joints[drive.joint].kind
    if found != wanted:
        yield Breach("drive.joint", drive.joint, f"is a {found} joint; a {drive.kind} drive needs a {wanted} joint")
    if isinstance(drive, (TorqueDrive, ForceDrive)):
        given = drive.torque if isinstance(drive, TorqueDrive) else drive.force
        yield from _one_of("drive", {drive.kind: given, "curve": drive.curve})


def _one_of(path: str, choices: Mapping[str, object]) -> Iterator[Breach]:
    given = [name for name, value in choices.items() if value is not None]
    if len(given) != 1:
        rule = f"give one of {', '.join(choices)}" if not given else f"give only one of {', '.join(given)}"
        yield Breach(path, None, rule)


def _initial(machine: MachineContent) -> Iterator[Breach]:
    for name in machine.initial.velocities:
        if name not in machine.links:
            rule = f"is not a link of this machine{nearest(name, machine.links)}"
            yield Breach(f"initial.velocities.{name}", None, rule)
        elif machine.links[name].fixed:
            yield Breach(f"initial.velocities.{name}", None, "is fixed and cannot have a velocity")


def _supports(machine: MachineContent) -> Iterator[Breach]:
    for index, support in enumerate(machine.supports):
        path = f"supports.{index}"
        yield from _known(f"{path}.link", support.link, machine.links, "link")
        if support.to_link is not None:
            yield from _known(f"{path}.to_link", support.to_link, machine.links, "link")
            if support.to_link == support.link:
                yield Breach(f"{path}.to_link", support.to_link, "must be another link than link")
        if isinstance(support, (Spring, Damper)) and math.dist(support.at, support.anchor) == 0:
            yield Breach(f"{path}.anchor", list(support.anchor), "must not be the point at; a mount needs no anchor")
        if isinstance(support, Spring) and support.static_deflection is not None:
            if support.free_length is not None:
                yield Breach(path, None, "give only one of free_length, static_deflection")
            if math.dist(support.at, support.anchor) + support.static_deflection < 0:
                yield Breach(f"{path}.static_deflection", support.static_deflection,
                             "would make the free length negative")  # fmt: skip


def _loads(machine: MachineContent) -> Iterator[Breach]:
    for index, load in enumerate(machine.loads):
        path = f"loads.{index}"
        yield from _known(f"{path}.link", load.link, machine.links, "link")
        table = load.over_time or load.over_angle
        said = not table and load.model_fields_set & {"force", "torque"}
        constant = True if said or any(load.force) or load.torque else None  # a zero beside a table is no load
        choices = {"force or torque": constant, "over_time": load.over_time, "over_angle": load.over_angle}
        yield from _one_of(path, choices)
        if table and load.order is not None:
            yield Breach(f"{path}.order", load.order, "is of a force or torque, and there is a table")
        if load.phase and load.order is None:
            yield Breach(f"{path}.phase", load.phase, "needs an order")
        if not isinstance(machine.drive, (RotationDrive, TorqueDrive)):
            for name in ("over_angle", "order"):
                if getattr(load, name) is not None:
                    yield Breach(f"{path}.{name}", None, "needs a rotation or torque drive: there is no drive angle")


def _sensors(machine: MachineContent) -> Iterator[Breach]:
    seen: set[str] = set()
    for index, sensor in enumerate(machine.sensors):
        if sensor.name in seen:
            yield Breach(f"sensors.{index}.name", sensor.name, "must be the only sensor of this name")
        seen.add(sensor.name)


def _connections(machine: MachineContent) -> Iterator[Breach]:
    ground = object()  # a support without to_link holds a link on the ground, where the frame stands or floats
    neighbours: dict[object, set[object]] = {name: set() for name in (*machine.links, ground)}
    pairs: list[tuple[object, object]] = [joint.links for joint in machine.joints.values()]
    pairs += [(support.link, support.to_link or ground) for support in machine.supports]
    pairs += [(name, ground) for name, link in machine.links.items() if link.fixed or name == machine.frame]
    for one, other in pairs:
        neighbours[one].add(other)
        neighbours[other].add(one)
    reached: set[object] = set()
    ahead: list[object] = [ground]
    while ahead:
        at = ahead.pop()
        if at not in reached:
            reached.add(at)
            ahead.extend(neighbours[at])
    for name in machine.links:
        if name not in reached:
            yield Breach(f"links.{name}", None, "is not connected to the frame by any joint or support")
