"""Rules between the parts of a machine: names that must exist, kinds and numbers that fit, links to be connected."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.content import MachineContent
from jointplay.solver.machines.fields import RuleError, nearest
from jointplay.solver.machines.friction import FRICTION_NUMBERS, DryFriction
from jointplay.solver.machines.joints import LAW_NUMBERS, NORMAL_NUMBERS, Contact, SlidingJoint, TurningJoint
from jointplay.solver.machines.modes import MOST_MODES
from jointplay.solver.machines.parts import AnchorMotion, ForceDrive, PositionDrive, RotationDrive, Support, TorqueDrive
from jointplay.solver.machines.refusals import show_value
from jointplay.solver.machines.response import FORCES, MOST_NUMBERS

_Breach = tuple[str, object, str]


def contact_breaches(defaults: Contact, contacts: Mapping[str, Contact]) -> Iterator[_Breach]:
    """Broken rules as (path, value, rule).

    Parameters
    ----------
    defaults : Contact
        May be incomplete: what it leaves out, every joint can say itself.
    contacts : mapping of str to Contact
        Of the joints, over the defaults, by path.
    """
    yield from _foreign("defaults.contact", defaults)
    for path, contact in contacts.items():
        yield from _foreign(path, contact)
        if contact.law == "linear":
            continue
        for name in LAW_NUMBERS[contact.law]:
            said = name == "exponent" or name in contact.model_fields_set
            if not said or getattr(contact, name) is None:
                rule = f"is missing; law {contact.law} needs it"
                if defaults.law == contact.law and "law" in defaults.model_fields_set:
                    # The law was written there, perhaps nowhere else; a joint may still complete it.
                    yield f"defaults.contact.{name}", None, f"{rule}, and {path.removesuffix('.contact')} has none"
                yield f"{path}.{name}", None, rule


def _foreign(path: str, contact: Contact) -> Iterator[_Breach]:
    for name in NORMAL_NUMBERS:
        value = getattr(contact, name)
        # A damping of 0 says nothing: it is what a contact of another law is written with.
        if value and not contact.has(name) and name in contact.model_fields_set:
            rule = f"law {contact.law} has no {name}, it has {_join_names(LAW_NUMBERS[contact.law])}"
            yield f"{path}.{name}", value, rule
    yield from friction_breaches(path, contact)


def friction_breaches(path: str, said: DryFriction) -> Iterator[_Breach]:
    """Numbers of another law of friction than the one in use, as (path, value, rule)."""
    for name in ("friction_velocity", "presliding"):
        own = FRICTION_NUMBERS[said.friction_law]
        if name not in own and name in said.model_fields_set:
            rule = f"friction law {said.friction_law} has no {name}, it has {_join_names(own)}"
            yield f"{path}.{name}", getattr(said, name), rule


def _join_names(names: tuple[str, ...]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]])


def refuse_units_of_another_law(tree: object) -> None:
    """Refuse a stiffness with a unit of force over length where the law makes it N/m^n.

    Parameters
    ----------
    tree : object
        A machine as it was read, of any shape.

    Raises
    ------
    RuleError
        Points at the stiffness.
    """
    default = _law(_at(tree, "defaults", "contact"))
    places: list[tuple[str, ...]] = [("defaults", "contact")]
    joints = _at(tree, "joints")
    places += [("joints", str(name), "contact") for name in joints] if isinstance(joints, Mapping) else []
    for place in places:
        contact = _at(tree, *place)
        if (_law(contact) or default or "linear") == "linear":
            continue
        stiffness = _at(contact, "stiffness")
        if isinstance(stiffness, str) and not _is_number(stiffness):
            rule = "must be a plain number: with this law it is in N/m^n, n the exponent"
            raise RuleError(rule, (*place, "stiffness"), stiffness)


def _at(tree: object, *keys: str) -> object:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def _law(contact: object) -> object:
    return _at(contact, "law")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


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
    for rules in (
        _links,
        _joints,
        _contacts,
        _drive,
        _initial,
        _supports,
        _loads,
        _sensors,
        _modes,
        _response,
        _connections,
    ):
        for breach in rules(machine):
            raise MachineError(source, breach.path, show_value(breach.value), breach.rule)


def _check_known(path: str, name: str, names: Iterable[str], noun: str) -> Iterator[Breach]:
    names = list(names)
    if name not in names:
        yield Breach(path, name, f"is not a {noun} of this machine{nearest(name, names)}")


def _links(machine: MachineContent) -> Iterator[Breach]:
    if not machine.links:
        yield Breach("links", None, "a machine needs at least one link, the frame")
    yield from _check_known("frame", machine.frame, machine.links, "link")
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
            yield from _check_known(f"{path}.links.{index}", link, machine.links, "link")
        if joint.links[0] == joint.links[1]:
            yield Breach(f"{path}.links", ", ".join(joint.links), "must be two different links")
        if isinstance(joint, TurningJoint) and joint.pin not in joint.links:
            yield Breach(f"{path}.pin", joint.pin, f"must be one of the joint's links, {' or '.join(joint.links)}")
        if isinstance(joint, TurningJoint) and joint.journal_friction and not joint.pin_radius:
            yield Breach(
                f"{path}.journal_friction", joint.journal_friction, "needs a pin_radius, the arm of its torque"
            )
        if isinstance(joint, TurningJoint) and joint.film is not None and not joint.pin_radius:
            yield Breach(f"{path}.pin_radius", None, "is missing: film is the oil around a journal of this radius")
        if isinstance(joint, SlidingJoint):
            yield from (Breach(*breach) for breach in friction_breaches(path, joint))
            said = [key for key in ("clearance", "height", "contact", "fit", "limit") if key in joint.model_fields_set]
            if joint.length is None and said:
                yield Breach(f"{path}.length", None, f"is missing: {said[0]} is that of a block of this length")


def _contacts(machine: MachineContent) -> Iterator[Breach]:
    contacts = {f"joints.{name}.contact": machine.joints[name].contact for name in machine.wearing_joints}
    for path, value, rule in contact_breaches(machine.defaults.contact, contacts):
        yield Breach(path, value, rule)


def _drive(machine: MachineContent) -> Iterator[Breach]:
    drive = machine.drive
    if drive is None:
        return
    if isinstance(drive, PositionDrive):
        yield from _driven_link(machine, drive)
        return
    yield from _check_known("drive.joint", drive.joint, machine.joints, "joint")
    wanted = "turning" if isinstance(drive, (RotationDrive, TorqueDrive)) else "sliding"
    found = machine.joints[drive.joint].kind
    if found != wanted:
        yield Breach("drive.joint", drive.joint, f"is a {found} joint; a {drive.kind} drive needs a {wanted} joint")
    if isinstance(drive, (TorqueDrive, ForceDrive)):
        given = drive.torque if isinstance(drive, TorqueDrive) else drive.force
        yield from _one_of("drive", {drive.kind: given, "curve": drive.curve})
        if drive.speed_factor != 1.0 and not drive.curve:
            yield Breach("drive.speed_factor", drive.speed_factor, "is of the speeds of a curve, and there is none")


def _driven_link(machine: MachineContent, drive: PositionDrive) -> Iterator[Breach]:
    yield from _check_known("drive.link", drive.link, machine.links, "link")
    link = machine.links[drive.link]
    if link.fixed:
        yield Breach("drive.link", drive.link, "is fixed and cannot be driven")
    if not any(part for part, axis in zip(drive.direction, "xy", strict=True) if axis not in link.locked):
        rule = f"is a direction in which {drive.link} is locked"
        yield Breach("drive.direction", list(drive.direction), rule)


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
        yield from _check_known(f"{path}.link", support.link, machine.links, "link")
        if support.to_link is not None:
            yield from _check_known(f"{path}.to_link", support.to_link, machine.links, "link")
            if support.to_link == support.link:
                yield Breach(f"{path}.to_link", support.to_link, "must be another link than link")
        for place, motion in enumerate(support.motion):
            yield from _anchor_motion(machine, f"{path}.motion.{place}", support, motion)


def _anchor_motion(machine: MachineContent, path: str, support: Support, motion: AnchorMotion) -> Iterator[Breach]:
    if support.to_link is not None:
        yield Breach(path, None, f"is of an end on the ground, and this one is on {support.to_link}")
    table = motion.over_time
    yield from _one_of(path, {"frequency": motion.frequency, "order": motion.order, "over_time": table})
    if table is None and "displacement" not in motion.model_fields_set:
        yield Breach(f"{path}.displacement", None, "is missing")
    if table is not None and any(motion.displacement):
        yield Breach(f"{path}.displacement", list(motion.displacement), "is of a sine, and there is a table")
    if table is not None and motion.phase:
        yield Breach(f"{path}.phase", motion.phase, "is of a sine, and there is a table")
    if motion.order is not None and not _has_drive_angle(machine):
        yield Breach(f"{path}.order", motion.order, _NO_ANGLE)


#: What says so where something goes by the drive angle.
_NO_ANGLE = "needs a rotation or torque drive: there is no drive angle"


def _has_drive_angle(machine: MachineContent) -> bool:
    return isinstance(machine.drive, (RotationDrive, TorqueDrive))


def _loads(machine: MachineContent) -> Iterator[Breach]:
    for index, load in enumerate(machine.loads):
        path = f"loads.{index}"
        yield from _check_known(f"{path}.link", load.link, machine.links, "link")
        table = load.over_time or load.over_angle
        said = not table and load.model_fields_set & {"force", "torque"}
        constant = True if said or any(load.force) or load.torque else None  # a zero beside a table is no load
        choices = {"force or torque": constant, "over_time": load.over_time, "over_angle": load.over_angle}
        yield from _one_of(path, choices)
        if table and load.order is not None:
            yield Breach(f"{path}.order", load.order, "is of a force or torque, and there is a table")
        if load.phase and load.order is None:
            yield Breach(f"{path}.phase", load.phase, "needs an order")
        if not _has_drive_angle(machine):
            for name in ("over_angle", "order"):
                if getattr(load, name) is not None:
                    yield Breach(f"{path}.{name}", None, _NO_ANGLE)


def _sensors(machine: MachineContent) -> Iterator[Breach]:
    seen: set[str] = set()
    for index, sensor in enumerate(machine.sensors):
        if sensor.name in seen:
            yield Breach(f"sensors.{index}.name", sensor.name, "must be the only sensor of this name")
        seen.add(sensor.name)


def _modes(machine: MachineContent) -> Iterator[Breach]:
    if len(machine.modes) > MOST_MODES:
        yield Breach("modes", len(machine.modes), f"must be at most {MOST_MODES} modes of the frame")
    for index, mode in enumerate(machine.modes):
        path = f"modes.{index}.shape"
        for place, point in enumerate(mode.shape):
            if mode.find(point.at) is not point:
                yield Breach(f"{path}.{place}.at", list(point.at), "must be the only point of the shape there")
        # Nothing is guessed between points: a shape that turns its sign between them would be anything.
        for what, at in machine.frame_points:
            if mode.find(at) is None:
                yield Breach(path, None, f"needs the point {show_value(list(at))}: there is {what} of {machine.frame}")


def _response(machine: MachineContent) -> Iterator[Breach]:
    found = machine.response
    if found is None:
        return
    if machine.modes:
        yield Breach("response", None, "has the modes of the frame in it: give either it or modes")
    lines, numbers = len(found.frequency), 6 * len(found.frequency) * len(found.sensors)
    if numbers > MOST_NUMBERS:
        yield Breach("response", f"{numbers} numbers", f"must not be more than {MOST_NUMBERS}: leave lines out")
    names = [sensor.name for sensor in machine.sensors]
    for name in names:
        if name not in found.sensors:
            yield Breach("response.sensors", None, f"misses {name}, a sensor of this machine")
    for name, answers in found.sensors.items():
        yield from _check_known(f"response.sensors.{name}", name, names, "sensor")
        for force in FORCES:
            count = len(getattr(answers, force))
            if count != lines:
                rule = f"must be as many as frequencies, {lines}"
                yield Breach(f"response.sensors.{name}.{force}", f"{count} numbers", rule)


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
