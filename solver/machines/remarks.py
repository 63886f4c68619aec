"""What a machine file may say and hardly means: one line each, with the part, the value and what is implausible."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping

from jointplay.solver.machines.content import MachineContent
from jointplay.solver.machines.fields import Point
from jointplay.solver.machines.film import SHORT
from jointplay.solver.machines.fits import in_um
from jointplay.solver.machines.joints import Contact, TurningJoint
from jointplay.solver.machines.restitution import remark

#: A centre of gravity is far outside from so many lengths of its link on. A counterweight brings it out by about one; a
#: number in mm, where metres are meant, by a thousand.
FAR_OUTSIDE = 3.0
#: A number without a unit that is so many rpm off a whole number of rpm was hardly meant in rad/s.
OFF_WHOLE = 0.01


def drawing_remarks(machine: MachineContent) -> Iterator[str]:
    """Yield a line for each link without length, pin larger than its link, and centre of gravity far outside its link.

    Notes
    -----
    The length of a link is the largest distance between its turning joints, supports and sensors, m; a sliding joint is
    anywhere on its line. That of a slider may be 0: it then says nothing of its pins, and its centre of gravity is
    compared with the length of the machine.
    """
    points = {name: list(_points_of(machine, name)) for name in machine.links}
    lengths = {name: _length(_points_of(machine, name, machine.turning_joints)) for name in machine.links}
    for name in machine.links:
        for line in _length_remarks(machine, name):
            lengths[name] = 0.0
            yield line
    for name, joint in machine.joints.items():
        if isinstance(joint, TurningJoint):
            length, of = min(((lengths[of], of) for of in joint.links if lengths[of]), default=(math.inf, ""))
            if joint.pin_radius > length:
                what = f"larger than link {of}, {length:g} m; is it in mm, or an eccentric?"
                yield f"joints.{name}.pin_radius: {joint.pin_radius:g} m: {what}"
    whole = _length(point for of in points.values() for point in of)
    for name, link in machine.links.items():
        length, compared = (lengths[name], "the link") if lengths[name] else (whole, "the machine")
        away = min((math.dist(link.cg, point) for point in points[name]), default=0.0)
        if not link.fixed and length and away > FAR_OUTSIDE * length:
            what = f"{away:.3g} m from its joints and supports, and {compared} is {length:.3g} m long; is it in mm?"
            yield f"links.{name}.cg: ({link.cg[0]:g}, {link.cg[1]:g}) m: {what}"


def speed_remarks(tree: Mapping[str, object]) -> Iterator[str]:
    """Yield a line where the file gives a turning drive a speed without a unit that may have been meant in rpm.

    Parameters
    ----------
    tree : Mapping
        The file as it was written: of its machine nobody sees any more how.
    """
    drive = tree.get("drive")
    if not isinstance(drive, Mapping) or drive.get("kind") != "rotation":
        return
    speed = str(drive.get("speed"))
    try:
        rpm = float(speed) * 30 / math.pi
    except ValueError:
        return
    if abs(rpm - round(rpm)) > OFF_WHOLE:
        yield f"drive.speed: {speed} is in rad/s: {rpm:.5g} rpm; write {speed}rpm if that was meant"


def _points_of(machine: MachineContent, link: str, joints: Collection[str] | None = None) -> Iterator[Point]:
    """Where a link is held, by all joints or by some of them, or looked at."""
    for name, joint in machine.joints.items():
        if link in joint.links and (joints is None or name in joints):
            yield joint.at
    yield from (support.at for support in machine.supports if support.link == link)
    yield from (getattr(support, "anchor", support.at) for support in machine.supports if support.to_link == link)
    if link == machine.frame:
        yield from (sensor.at for sensor in machine.sensors)


def _length(points: Iterable[Point]) -> float:
    points = list(points)
    return max((math.dist(p, q) for p in points for q in points), default=0.0)


def _length_remarks(machine: MachineContent, name: str) -> Iterator[str]:
    """Of a link that only turning joints hold, all at one place: whatever turns it, it moves nothing.

    A length that the play of the joints takes up is none.
    """
    joints = {of: joint for of, joint in machine.joints.items() if name in joint.links}
    turning = [joint for joint in joints.values() if isinstance(joint, TurningJoint)]
    if name == machine.frame or machine.links[name].fixed or len(joints) < 2 or len(turning) < len(joints):
        return
    length, play = _length(joint.at for joint in turning), max(joint.new_fit.high for joint in turning)
    if length <= play:
        what = f"{in_um(length)} long, no more than the radial play of its joints as new, {in_um(play)}"
        yield f"links.{name}: joints {' and '.join(joints)}: {what}; it moves nothing"


def film_remarks(machine: MachineContent, joints: Iterable[str]) -> list[str]:
    """One line for each of these joints whose film is longer than that of a short bearing."""
    lines = []
    for name in joints:
        joint = machine.joints[name]
        if isinstance(joint, TurningJoint) and joint.film and joint.film.length > SHORT * 2 * joint.pin_radius:
            what = f"{joint.film.length / (2 * joint.pin_radius):.3g} diameters long; it counts as short, which is good"
            lines.append(f"joint {name}: film: {what} to {SHORT:g}: a long one carries less than this says")
    return lines


def restitution_remarks(
    machine: MachineContent, joints: Iterable[str], values: Mapping[str, float] | None = None
) -> list[str]:
    """One line for each contact whose law returns a restitution far from the one it is asked for.

    Parameters
    ----------
    machine : MachineContent
    joints : iterable of str
        To look at.
    values : mapping of str to float, optional
        Numbers by path that differ from the machine file.
    """
    lines = []
    for joint in joints:
        contact = getattr(machine.joints[joint], "contact", None)
        if isinstance(contact, Contact) and contact.restitution is not None:
            asked = (values or {}).get(f"joints.{joint}.contact.restitution", contact.restitution)
            line = remark(contact.law, asked)
            lines += [f"joint {joint}: {line}"] if line else []
    return lines
