"""Joints with clearance: a pin in its socket, which touches it at one place, and a block between the walls of a guide,
which touches them with its four corners.

What a joint is held by is a state of its surfaces (:mod:`jointplay.solver.equations.contact`); here is where they are,
how they move, and where their forces act: both at one common point, so that the angular momentum of a free machine is
kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca

from jointplay.solver.equations.contact import (
    ContactForce,
    NormalForce,
    NormalLaw,
    Surfaces,
    hertzian_force,
    impact_hysteresis,
    linear_force,
)
from jointplay.solver.equations.film import Film, most_damping
from jointplay.solver.equations.forces import Scene
from jointplay.solver.equations.friction import sliding_sign
from jointplay.solver.equations.geometry import Complex, I
from jointplay.solver.equations.numbers import Number, contact_numbers, contact_path
from jointplay.solver.machines.friction import FRICTION_NUMBERS
from jointplay.solver.machines.joints import Contact, SlidingJoint, TurningJoint
from jointplay.solver.machines.restitution import HYSTERESIS

#: Clearance (m) of a film in place of none, which a start with concentric pins is looked for with.
LEAST_FILM = 1e-9
#: Squared eccentricity (m2) below which the contact normal has no meaning; there is no force there anyway (e <= c).
TINY = 1e-60


@dataclass(frozen=True)
class WornJoint:
    """A joint with clearance.

    Attributes
    ----------
    eccentricity : casadi.SX
        (2, 1), m: vector from socket to pin centre, or how far the ends of a block are off the guide's line; 0 where
        the joint is as drawn.
    push : casadi.SX
        (2, 1) force on the pin, N, in the axes of the frame; or on links[0] of a guide the force along its normal, N,
        and the moment of all its forces about the joint's point, N m.
    contacts : tuple of ContactForce
    """

    eccentricity: ca.SX
    push: ca.SX
    contacts: tuple[ContactForce, ...]


@dataclass(frozen=True)
class Play:
    """All joints with clearance.

    Attributes
    ----------
    joints : dict of str to WornJoint
    contacts : tuple of ContactForce
        Of one joint after the other.
    touching : casadi.SX
        (k, 1) symbols: whether the surfaces of each contact push.
    remembering : tuple of int
        Contacts whose law remembers, see :mod:`jointplay.solver.equations.contact`.
    memory : casadi.SX
        Symbols of what these remember.
    """

    joints: dict[str, WornJoint]
    contacts: tuple[ContactForce, ...]
    touching: ca.SX
    remembering: tuple[int, ...]
    memory: ca.SX

    @property
    def eccentricity(self) -> ca.SX:
        """Of all joints, stacked."""
        return ca.vertcat(*(joint.eccentricity for joint in self.joints.values())) if self.joints else ca.SX(0, 1)

    @property
    def switch(self) -> ca.SX:
        """Switch functions of all contacts, (k, 1)."""
        return ca.vertcat(*(contact.switch for contact in self.contacts))


def wear(scene: Scene, names: Sequence[str]) -> Play:
    """Write the forces of all joints with clearance."""
    joints = {name: scene.machine.joints[name] for name in names}
    owners = [joint for joint in joints.values() for _ in range(4 if isinstance(joint, SlidingJoint) else 1)]
    touching = ca.SX.sym("touching", len(owners))
    remembering = tuple(i for i, joint in enumerate(owners) if joint.contact.law in HYSTERESIS)
    memory = ca.SX.sym("memory", len(remembering))
    memories = dict(zip(remembering, ca.vertsplit(memory), strict=True)) if remembering else {}
    found: dict[str, WornJoint] = {}
    place = 0
    for name, joint in joints.items():
        nominal = contact_numbers(joint)
        numbers = {key: scene.number(contact_path(name, key), value) for key, value in nominal.items()}
        surfaces = _surfaces(scene, name, joint.contact, numbers, place, touching, memories)
        found[name] = (
            _block_between_walls(scene, joint, numbers, surfaces)
            if isinstance(joint, SlidingJoint)
            else _pin_in_socket(scene, joint, numbers, surfaces)
        )
        place += len(found[name].contacts)
    contacts = tuple(contact for joint in found.values() for contact in joint.contacts)
    return Play(found, contacts, touching, remembering, memory)


def _surfaces(
    scene: Scene, name: str, contact: Contact, numbers: dict[str, Number], place: int, touching: ca.SX,
    memories: dict[int, ca.SX],
) -> Iterator[Surfaces]:  # fmt: skip
    """Pairs of surfaces of a joint, `place` and following among all contacts, as many as are asked for."""
    rubs = contact.friction or scene.number.varies(contact_path(name, "friction"))
    kind = contact.friction_law
    while True:

        def sign(slip: ca.SX, place: int = place) -> ca.SX:
            if not rubs:
                return ca.SX(0)
            return sliding_sign(kind, slip, numbers[FRICTION_NUMBERS[kind][0]], place, scene.bristles)

        law = _normal_law(contact, numbers, memories.get(place, ca.SX(0)))
        yield Surfaces(law, sign, numbers["friction"], numbers["viscous"], touching[place])
        place += 1


def _normal_law(contact: Contact, numbers: dict[str, Number], memory: ca.SX) -> NormalLaw:
    """The law of the machine file with its numbers, as a function of penetration and approach."""

    def law(penetration: ca.SX, approach: ca.SX) -> NormalForce:
        stiffness = numbers["stiffness"]
        if contact.exponent is None:
            return linear_force(stiffness, numbers["damping"], penetration, approach)
        if contact.restitution is None:
            hysteresis = numbers["hysteresis"]
        else:
            hysteresis = impact_hysteresis(contact.law, numbers["restitution"], approach, memory)
        return hertzian_force(stiffness, contact.exponent, hysteresis, penetration, approach)

    return law


def _pin_in_socket(
    scene: Scene, joint: TurningJoint, numbers: dict[str, Number], surfaces: Iterator[Surfaces]
) -> WornJoint:
    """Contact at e > c, strictly, e the distance of the centres.

    Both forces act on the pin's surface, at pin centre + r_pin n; their arm about the socket centre is (e + r_pin) n.
    """
    terms, links = scene.kinematics.terms, joint.links if joint.pin == joint.links[0] else joint.links[::-1]
    pin, socket = (scene.kinematics.poses.at(link, joint.at) for link in links)
    vector = pin.point(joint.at) - socket.point(joint.at)
    e, e_rate = terms.value(vector), terms.rate(vector)
    eccentricity = ca.sqrt(ca.fmax(e.dot(e), TINY))
    normal = Complex(e.re / eccentricity, e.im / eccentricity)
    penetration = eccentricity - numbers["clearance"]
    approach = normal.dot(e_rate)
    arm_socket = eccentricity + numbers["pin_radius"]
    # Velocity of the pin's body relative to the socket's at the common contact point, along the tangent (-n_y, n_x).
    slip = normal.cross(e_rate) + pin.omega * numbers["pin_radius"] - socket.omega * arm_socket
    force = next(surfaces).force(penetration, approach, slip)
    on_pin = normal * Complex(-force.pushing, -force.rubbing)
    # The force moves the centres apart; off the centres, at the common contact point, it also turns both links.
    scene.push(vector, on_pin)
    scene.twist(pin, -force.rubbing * numbers["pin_radius"])
    scene.twist(socket, force.rubbing * arm_socket)
    if joint.film is not None:
        film = Film(
            numbers["viscosity"], numbers["pin_radius"], joint.film.length, ca.fmax(numbers["clearance"], LEAST_FILM),
            joint.film.roughness, most_damping(scene.machine, joint),
        )  # fmt: skip
        pushed, shear = film.force(e, eccentricity, e_rate, (pin.omega, socket.omega))
        half = e.cross(pushed) / 2
        scene.push(vector, pushed)
        scene.twist(pin, shear - half)
        scene.twist(socket, -shear - half)
        on_pin += pushed
    return WornJoint(e.column, on_pin.column, (force,))


def _block_between_walls(
    scene: Scene, joint: SlidingJoint, numbers: dict[str, Number], surfaces: Iterator[Surfaces]
) -> WornJoint:
    """Corners of a block at s = -l/2, l/2 along its line, a half height to either side of it, between two walls.

    Everything is in the axes of the guide, x along its line and y across: rates there are those against its walls. The
    forces act at the corner.
    """
    terms = scene.kinematics.terms
    block, guide = (scene.kinematics.poses.at(link, joint.at) for link in joint.links)
    vector = block.point(joint.at) - guide.point(joint.at)
    along = terms.value(guide.rotate(joint.direction))
    back = along.conjugate
    gap, turning = back * terms.value(vector), block.omega - guide.omega
    gap_rate = back * terms.rate(vector) + Complex(guide.omega * gap.im, -(guide.omega * gap.re))
    lean = terms.rotation[guide.turn].conjugate * terms.rotation[block.turn]
    assert joint.length is not None  # or it could have no clearance
    ends, contacts = [], []
    total, moment = Complex(0.0, 0.0), ca.SX(0)
    for s in (-joint.length / 2, joint.length / 2):
        ends.append(gap.im + s * lean.im)
        for side in (-1.0, 1.0):
            arm = lean * complex(s, side * joint.height / 2)
            rate = gap_rate + arm * I * Complex(turning, 0.0)
            penetration = side * (gap.im + arm.im) - joint.height / 2 - numbers["clearance"]
            force = next(surfaces).force(ca.SX(penetration), ca.SX(side * rate.im), ca.SX(rate.re))
            on_block = Complex(-force.rubbing, -side * force.pushing)
            total, moment = total + on_block, moment + arm.cross(on_block)
            contacts.append(force)
    scene.push(vector, along * total)
    scene.twist(block, moment)
    scene.twist(guide, -(moment + gap.cross(total)))
    return WornJoint(ca.vertcat(*ends), ca.vertcat(total.im, moment), tuple(contacts))
