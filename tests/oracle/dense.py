"""The paper's equations [A]{B} = {C}, written out in full, dense and slow: the judge of the fast solver.

For N links and J joints there are 3N + 2J unknowns: x'', y'', theta'' of every link's centre of gravity, and two for
every joint (turning pair: the force on its first link; sliding pair: the normal force and the couple on its first link;
pair with clearance: the force on its pin, or the normal force and the couple of a block's corners, which are functions
of the state). A prescribed drive adds its effort as one more unknown, and its motion as one more row. Nothing here
comes from the solver's equations; the numbers of a machine file and the positions and velocities of all links are the
only input. Every mode of the frame adds its acceleration and the equation m q'' + 2 z m w q' + m w^2 q = Q, where Q is
the work of all forces on the frame for a unit of q.

Links are numbered in the order of the file. A state is two arrays (N, 3): x, y of the centre of gravity in global
coordinates (m) and the angle since the drawing (rad), and their rates.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from oracle.closures import blocked_motions
from oracle.oil import OilState
from oracle.state import Array, ContactState, CornerState, Held, Point, Slide, State, across, cross, sliding_sign
from oracle.tables import periodic_row, prescribed, table, time_row

from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Damper, ForceDrive, MotionDrive, Mount, PositionDrive, Spring, TorqueDrive


class JammedError(Exception):
    """No signs of the sliding pairs' normal forces fit the motion, or several with different forces."""


@dataclass(frozen=True)
class Solution:
    """Accelerations (N, 3), reactions by joint, accelerations of the frame's modes (m,), the drive's effort (0 unless
    prescribed), and [A] itself.

    A reaction is (Fx, Fy) on links[0] of a turning joint, on the pin where it has clearance, and (normal force, couple)
    on links[0] of a sliding joint, with clearance of all forces of its corners. What rounding of a solution is to be
    measured by: `scale` are the largest terms of the equations as accelerations, m/s2 and rad/s2; `effort_scale` the
    same as they stand, N and N m.
    """

    accelerations: Array
    reactions: dict[str, Array]
    modes: Array
    effort: float
    scale: tuple[float, float]
    mode_scale: float
    effort_scale: tuple[float, float]
    matrix: Array

    @property
    def condition(self) -> float:
        """Condition number of [A] after every row, then every column, was divided by its largest entry."""
        scaled = self.matrix / np.abs(self.matrix).max(axis=1)[:, None]
        return float(np.linalg.cond(scaled / np.abs(scaled).max(axis=0)))


def solve(
    machine: Machine, clearances: Mapping[str, float], t: float, positions: Array, velocities: Array,
    began: Mapping[str, float] | None = None, held: Held | None = None, bent: Array | None = None, *,
    redundant: bool = False,
) -> Solution:  # fmt: skip
    """Write the equations at one state and solve them; contacts began with these velocities, or begin now; surfaces
    with bristles are as `held` has them, or have not been bent.

    Of a `redundant` machine the accelerations are determined, reactions are the least squares.

    Raises
    ------
    JammedError
        With Coulomb friction in sliding pairs: see there.
    numpy.linalg.LinAlgError
        A machine whose reactions are not determined.
    """
    system = _System(State(machine, positions, velocities, held, bent), clearances, t, began or {})
    found: list[tuple[Solution, Array]] = []
    for signs in itertools.product((1.0, -1.0), repeat=len(system.rubbing)):
        solution = system.solve(signs, redundant)
        normal = np.array([solution.reactions[name][0] for name in system.rubbing])
        if (normal * signs >= 0).all():
            found.append((solution, normal))
    if not found:
        raise JammedError("no signs of the normal forces are consistent with the motion")
    solution, first = found[0]
    # Also where all move alike: a pair whose sliding is prescribed has forces that nothing determines then.
    if any(np.abs(other - first).max() > 1e-9 * np.abs(first).max() for _, other in found[1:]):
        raise JammedError("several signs of the normal forces are consistent with different forces")
    return solution


class _System:
    """[A] and {C}: Newton-Euler rows first, then two rows a joint, then the drive's."""

    def __init__(self, state: State, clearances: Mapping[str, float], t: float, began: Mapping[str, float]) -> None:
        self.state, self.machine, self.clearances, self.t, self.began = state, state.machine, clearances, t, began
        n, j = len(self.machine.links), len(self.machine.joints)
        known_motion = isinstance(self.machine.drive, MotionDrive)
        self.effort = 3 * n + 2 * j
        size = self.effort + known_motion + len(self.machine.modes)
        self.modes = slice(self.effort + known_motion, size)
        self.a, self.c = np.zeros((size, size)), np.zeros(size)
        self.columns = {name: 3 * n + 2 * k for k, name in enumerate(self.machine.joints)}
        self.rubbing: dict[str, Array] = {}  # friction of a sliding pair for a normal force of +1, as forces on links
        self.newton_euler()
        self.supports()
        self.loads()
        for name, joint in self.machine.joints.items():
            if isinstance(joint, SlidingJoint) and name in clearances:
                self.corners(name, joint)
            elif isinstance(joint, SlidingJoint):
                self.sliding(joint, self.columns[name])
                if joint.friction:
                    self.rubbing[name] = self.friction(name, joint)
            elif name in clearances:
                self.clearance(name)
            else:
                self.turning(joint, self.columns[name])
        self.journals = [
            name
            for name, joint in self.machine.joints.items()
            if isinstance(joint, TurningJoint) and joint.journal_friction and name not in clearances
        ]
        self.drive()

    def newton_euler(self) -> None:
        """M x'' = F, M y'' = F - M g, I theta'' = T."""
        for i, link in enumerate(self.machine.links.values()):
            if link.mass is not None and link.inertia is not None:
                for k, inertia in enumerate((link.mass, link.mass, link.inertia)):
                    self.a[3 * i + k, 3 * i + k] = inertia
                self.c[3 * i + 1] -= link.mass * self.machine.gravity
        for k, mode in enumerate(self.machine.modes, start=self.modes.start):
            q, rate = self.state.bent[k - self.modes.start]
            w = 2 * math.pi * mode.frequency
            self.a[k, k] = mode.mass
            self.c[k] -= mode.mass * (w * w * q + 2 * mode.damping * w * rate)

    def put(self, share: Array, column: int | None) -> None:
        """Forces on everything: known ones, or those of a unit of the unknown in `column`."""
        if column is None:
            self.c += share
        else:
            self.a[:, column] -= share

    def force(self, i: int, point: Array, force: Array, at: Point, column: int | None = None) -> None:
        """A force on link i at a point in space, near where `at` was drawn."""
        self.put(self.share(i, point, force, at), column)

    def share(self, i: int, point: Array, force: Array, at: Point) -> Array:
        """Fx, Fy, moment about the centre of gravity of link i, and work for a unit of each mode, of a force."""
        found = np.zeros(len(self.c))
        found[3 * i : 3 * i + 3] = *force, cross(point - self.state.positions[i, :2], force)
        moved, turned = self.state.shapes(i, at)
        found[self.modes] = moved @ force + turned * cross(point - self.state.point(i, at), force)
        return found

    def pair(self, i: int, j: int, point: Array, force: Array, at: Point, column: int | None = None) -> None:
        """A force on link i and its opposite on link j at the same point."""
        self.force(i, point, force, at, column)
        self.force(j, point, -force, at, column)

    def torque(self, i: int, torque: float, at: Point) -> Array:
        """A torque on link i, there where `at` was drawn."""
        found = np.zeros(len(self.c))
        found[3 * i + 2] = torque
        found[self.modes] = torque * self.state.shapes(i, at)[1]
        return found

    def couple(self, i: int, j: int, torque: float, at: Point, column: int | None = None) -> None:
        """A torque on link i and its opposite on link j."""
        self.put(self.torque(i, torque, at) + self.torque(j, -torque, at), column)

    def supports(self) -> None:
        state = self.state
        for support in self.machine.supports:
            i = state.index(support.link)
            j = None if support.to_link is None else state.index(support.to_link)
            anchor = support.at if isinstance(support, Mount) else support.anchor
            point = state.point(i, support.at)
            base = np.array(anchor) if j is None else state.point(j, anchor)
            relative = state.velocity(i, support.at) - (np.zeros(2) if j is None else state.velocity(j, anchor))
            shift, rate = state.shift(support, self.t)
            base, relative = base + shift, relative - rate
            gap = point - base
            along = gap / math.hypot(*gap) if gap.any() else gap  # away from the anchor
            if isinstance(support, Mount):
                force = -np.array(support.stiffness) * gap - np.array(support.damping) * relative
            elif isinstance(support, Spring):
                force = -support.stiffness * (math.hypot(*gap) - float(support.free_length or 0.0)) * along
            elif isinstance(support, Damper):
                force = -support.damping * (along @ relative) * along
            self.force(i, point, force, support.at)
            if j is not None:
                self.force(j, base, -force, anchor)

    def loads(self) -> None:
        for load in self.machine.loads:
            i = self.state.index(load.link)
            row = np.array([*load.force, load.torque])
            if load.over_time is not None:
                row = time_row(load.over_time, self.t)
            elif load.over_angle is not None:
                row = periodic_row(load.over_angle, self.state.drive_motion()[0])
            elif load.order is not None:
                row = row * math.sin(load.order * self.state.drive_motion()[0] + load.phase)
            self.force(i, self.state.point(i, load.at), row[:2], load.at)
            self.c += self.torque(i, row[2], load.at)

    def acceleration_row(self, row: int, direction: Array, i: int, at: Point, sign: float) -> None:
        """Add sign * direction . (acceleration of the point of link i that was drawn at `at`).

        r'' + theta'' k x a - w^2 a, a the arm, and by the modes u'' + 2 w k x u', u seen from the frame.
        """
        arm, w = self.state.point(i, at) - self.state.positions[i, :2], self.state.velocities[i, 2]
        moved = self.state.shapes(i, at)[0]
        self.a[row, 3 * i : 3 * i + 2] += sign * direction
        self.a[row, 3 * i + 2] += sign * (direction @ across(arm))
        self.a[row, self.modes] += sign * (moved @ direction)
        self.c[row] += sign * w**2 * (direction @ arm)
        self.c[row] -= sign * 2 * w * (direction @ across(self.state.bent[:, 1] @ moved))

    def angle_row(self, row: int, i: int, at: Point, factor: float) -> None:
        """Add factor times the angular acceleration of link i, there where `at` was drawn."""
        self.a[row, 3 * i + 2] += factor
        self.a[row, self.modes] += factor * self.state.shapes(i, at)[1]

    def turning(self, joint: TurningJoint, column: int) -> None:
        """The force (Fx, Fy) on links[0]; both points have the same acceleration. Viscous resistance CT."""
        i, j = (self.state.index(link) for link in joint.links)
        for k, unit in enumerate(np.eye(2)):
            for link, sign in ((i, 1.0), (j, -1.0)):
                point = self.state.point(link, joint.at)
                self.force(link, point, sign * unit, joint.at, column + k)
                self.acceleration_row(column + k, unit, link, joint.at, sign)
        relative = self.state.omega(j, joint.at) - self.state.omega(i, joint.at)
        self.couple(i, j, joint.viscous * relative, joint.at)

    def gap_row(self, row: int, slide: Slide, direction: Array, at: Point) -> None:
        """direction . d'' of a sliding pair: the slider's point against the guide's point drawn there."""
        self.acceleration_row(row, direction, slide.slider, at, 1.0)
        self.acceleration_row(row, direction, slide.guide, at, -1.0)

    def sliding(self, joint: SlidingJoint, column: int) -> None:
        """Normal force and couple on links[0]; n . d and the relative angle stay.

        With u along and n = k x u across the line, both fixed in the guide: u' = w n, n' = -w u, and
        (n . d)'' = n . d'' - 2 w u . d' - theta'' u . d - w^2 n . d = 0.
        """
        slide = self.state.slide(joint)
        i, j, w = slide.slider, slide.guide, slide.omega
        self.pair(i, j, slide.point, slide.normal, joint.at, column)
        self.couple(i, j, 1.0, joint.at, column + 1)
        self.gap_row(column, slide, slide.normal, joint.at)
        self.angle_row(column, j, joint.at, -(slide.along @ slide.gap))
        self.c[column] += 2 * w * (slide.along @ slide.gap_rate) + w * w * (slide.normal @ slide.gap)
        self.angle_row(column + 1, i, joint.at, 1.0)
        self.angle_row(column + 1, j, joint.at, -1.0)
        self.pair(i, j, slide.point, -joint.viscous * slide.rate * slide.along, joint.at)

    def friction(self, name: str, joint: SlidingJoint) -> Array:
        """Ft = -mu |Fn| y along the line, y for the sign of v, for Fn = 1, as forces on everything."""
        slide = self.state.slide(joint)
        force = -joint.friction * sliding_sign(joint, slide.rate, self.state.held.get(name)) * slide.along
        pair = ((slide.slider, force), (slide.guide, -force))
        return np.sum([self.share(link, slide.point, each, joint.at) for link, each in pair], axis=0)

    def corners(self, name: str, joint: SlidingJoint) -> None:
        """Known forces of the corners, each at its own; rows that say what they come to at the joint's point."""
        slide, column = self.state.slide(joint), self.columns[name]
        self.a[column, column] = self.a[column + 1, column + 1] = 1.0
        for corner in CornerState.all(self.state, name, self.clearances[name], self.began):
            self.pair(corner.block, corner.guide, corner.point, corner.force, joint.at)
            self.c[column] += slide.normal @ corner.force
            self.c[column + 1] += cross(corner.point - slide.point, corner.force)

    def clearance(self, name: str) -> None:
        """Rows that say the force on the pin is what the state makes it: at one common point; oil's at the centres."""
        contact = ContactState.of(self.state, name, self.clearances[name], self.began.get(name, 0.0))
        for k, unit in enumerate(np.eye(2)):
            column = self.columns[name] + k
            self.pair(contact.pin, contact.socket, contact.point, unit, self.machine.joints[name].at, column)
            self.a[column, column] = 1.0
            self.c[column] = contact.force[k]
        oil = OilState.of(self.state, name, self.clearances[name])
        if oil is None:
            return
        self.c[self.columns[name] : self.columns[name] + 2] += oil.force
        for link, centre, sign, torque in zip((oil.pin, oil.socket), oil.centres, (1, -1), oil.torques, strict=True):
            whole = sign * cross(centre - contact.point, oil.force) + torque
            self.c += self.torque(link, whole, self.machine.joints[name].at)

    def drive(self) -> None:
        drive = self.machine.drive
        if isinstance(drive, TorqueDrive | ForceDrive):
            given = drive.torque if isinstance(drive, TorqueDrive) else drive.force
            rate = self.state.drive_motion()[1] / drive.speed_factor
            self.known_effort(drive.effort_factor * (table(drive.curve, rate) if drive.curve else float(given or 0.0)))
        elif drive is not None:
            self.known_motion(drive)

    def known_effort(self, effort: float) -> None:
        joint = self.machine.joints[self.machine.driven_joint]
        i, j = (self.state.index(link) for link in joint.links)
        if isinstance(joint, SlidingJoint):
            slide = self.state.slide(joint)
            self.pair(i, j, slide.point, effort * slide.along, joint.at)
        else:
            self.couple(i, j, effort, joint.at)

    def known_motion(self, drive: MotionDrive) -> None:
        """The last row and column. (u . d)'' = u . d'' + 2 w n . d' + theta'' n . d - w^2 u . d is prescribed, or that
        of a centre of gravity along a direction that stays.
        """
        column = self.effort
        self.c[column] = prescribed(drive, self.t)[2]
        if isinstance(drive, PositionDrive):
            i, cg, along = self.state.index(drive.link), self.machine.links[drive.link].cg, np.array(drive.direction)
            self.force(i, self.state.point(i, cg), along, cg, column)
            self.acceleration_row(column, along, i, cg, 1.0)
            return
        joint = self.machine.joints[drive.joint]
        i, j = (self.state.index(link) for link in joint.links)
        if isinstance(joint, SlidingJoint):
            slide = self.state.slide(joint)
            self.pair(i, j, slide.point, slide.along, joint.at, column)
            self.gap_row(column, slide, slide.along, joint.at)
            self.angle_row(column, j, joint.at, slide.normal @ slide.gap)
            self.c[column] -= 2 * slide.omega * (slide.normal @ slide.gap_rate)
            self.c[column] += slide.omega**2 * (slide.along @ slide.gap)
        else:
            self.couple(i, j, 1.0, joint.at, column)
            self.angle_row(column, i, joint.at, 1.0)
            self.angle_row(column, j, joint.at, -1.0)

    def solve(self, signs: Sequence[float], redundant: bool = False) -> Solution:
        """With the torques of journals, mu r |F| y, found by repeating until they stay."""
        solution, before = self._solve(signs, {}, redundant), math.inf
        for _ in range(100 if self.journals else 0):
            torques = {}
            for name in self.journals:
                joint = self.machine.joints[name]
                assert isinstance(joint, TurningJoint)
                i, j = (self.state.index(link) for link in joint.links)
                rate = self.state.omega(i, joint.at) - self.state.omega(j, joint.at)
                y = sliding_sign(joint.contact, rate * joint.pin_radius, self.state.held.get(name))
                force = math.hypot(*solution.reactions[name])
                torques[name] = -joint.journal_friction * joint.pin_radius * force * y
            total = sum(torques.values())
            if abs(total - before) <= 1e-15 * abs(total):
                break
            solution, before = self._solve(signs, torques, redundant), total
        return solution

    def _solve(self, signs: Sequence[float], torques: Mapping[str, float], redundant: bool) -> Solution:
        """With the given signs of the normal forces of the pairs that rub; rows of blocked motions say so instead."""
        n = len(self.machine.links)
        a, c = self.a.copy(), self.c.copy()
        for name, torque in torques.items():
            joint = self.machine.joints[name]
            i, j = (self.state.index(link) for link in joint.links)
            c += self.torque(i, torque, joint.at) + self.torque(j, -torque, joint.at)
        for (name, share), sign in zip(self.rubbing.items(), signs, strict=True):
            a[:, self.columns[name]] -= sign * share
        for i, k in blocked_motions(self.machine):
            row = 3 * i + k
            a[row], c[row], a[row, row] = 0.0, 0.0, 1.0
        if redundant:  # rows and columns of like size, or a force of 1 N would be as nothing beside 1e5 rad/s2
            size = np.abs(a).max(axis=1)
            x = np.linalg.lstsq(a / size[:, None], c / size, rcond=1e-10)[0]
        else:
            x = np.linalg.solve(a, c)
        reactions = {name: x[column : column + 2] for name, column in self.columns.items()}
        effort = float(x[self.effort]) if self.modes.start > self.effort else 0.0
        linear, force = self.scales(x)
        terms = np.abs(np.hstack([self.a[self.modes] * x, self.c[self.modes, None]])).max(axis=1)
        modal = max((term / mode.mass for term, mode in zip(terms, self.machine.modes, strict=True)), default=0.0)
        return Solution(x[: 3 * n].reshape(n, 3), reactions, x[self.modes], effort, linear, modal, force, a)

    def scales(self, x: Array) -> tuple[tuple[float, float], tuple[float, float]]:
        """Largest term of any link: over its inertia, and as it stands; moments count at the radius of gyration too."""
        linear = angular = force = moment = 0.0
        for i, link in enumerate(self.machine.links.values()):
            rows = slice(3 * i, 3 * i + 3)
            linear, angular = max(linear, *np.abs(x[rows][:2])), max(angular, abs(x[rows][2]))
            terms = np.abs(np.hstack([self.a[rows] * x, self.c[rows, None]])).max(axis=1)
            radius = math.sqrt(link.inertia / link.mass) if link.mass and link.inertia else 1.0
            largest = float(max(*terms[:2], terms[2] / radius))
            force, moment = max(force, largest), max(moment, largest * radius)
            if link.mass:
                linear, angular = max(linear, largest / link.mass), max(angular, largest / link.mass / radius)
        return (linear, angular), (force, moment)
