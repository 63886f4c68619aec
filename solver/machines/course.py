"""How the links of a machine go through one period of its drive, by least squares: drawings ask for no more.

A machine that cannot be assembled has a course, too, with the joint that stays open and how far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import AnyComplexArray, FloatArray
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.machines.parts import ForceDrive, PositionDrive, RotationDrive, TorqueDrive

#: Evenly over the period, the drawn one first.
POSITIONS = 72
#: Machines of more links are drawn as they stand: a drawing is made while somebody waits.
MOST_LINKS = 60
#: Joints count as closed below this part of the machine's size.
CLOSED = 1e-6
#: How much more the other joints count than the one that is to stay open.
_HELD = 1e3
_STEPS = 40
#: Residual, as part of the size, at which there is nothing to improve.
_EXACT = 1e-12


@dataclass(frozen=True, eq=False)
class Course:
    """Positions of all links, seen from the frame.

    Attributes
    ----------
    links : mapping of str to (n, 3) array
        By link: x, y of its centre of gravity [m] and the angle it has turned by since it was drawn [rad]. n is 1 for a
        machine whose drive has no period.
    drive : (n,) array
        How far the drive has gone, rad or m.
    gaps : mapping of str to (n,) array
        By joint: how far it is open, m.
    travels : mapping of str to (n,) array
        By sliding joint: how far its block has gone along its line, m.
    size : float
        Largest distance between joints as drawn, m.
    """

    links: Mapping[str, FloatArray]
    drive: FloatArray
    gaps: Mapping[str, FloatArray]
    travels: Mapping[str, FloatArray]
    size: float

    @property
    def widest(self) -> tuple[str, int]:
        """The joint that is open widest, and at which position; the drawn position and no joint where all close."""
        if not self.gaps:
            return "", 0
        name = max(self.gaps, key=lambda joint: float(self.gaps[joint].max()))
        at = int(self.gaps[name].argmax())
        return (name, at) if self.gaps[name][at] > CLOSED * self.size else ("", 0)

    def reach(self, joint: str) -> tuple[float, float]:
        """Least and greatest travel of a sliding joint where the machine is closed, m."""
        closed = np.all([gap <= CLOSED * self.size for gap in self.gaps.values()], axis=0)
        travel = self.travels[joint][closed]
        return float(travel.min(initial=0.0)), float(travel.max(initial=0.0))


@keep_by_machine(64)
def course_of(machine: Machine, open_joint: str = "") -> Course:
    """Follow a machine from the drawn pose through one period of its drive.

    Parameters
    ----------
    machine : Machine
    open_joint : str
        The joint that stays open where not all can be closed; without it, all share.
    """
    closures = _Closures(machine, open_joint)
    drive = _drive_positions(machine)[: POSITIONS if len(machine.links) <= MOST_LINKS else 1]
    poses: list[FloatArray] = []
    last = previous = np.zeros(closures.count)
    for position in drive:
        # Extrapolated: at a change point the machine goes on as it came.
        found = closures.settle(2 * last - previous, position)
        previous, last = (last if poses else found), found
        poses.append(found)
    table = np.array(poses).reshape(len(drive), -1, 3)
    gaps, travels = closures.judge(table)
    links = {name: table[:, place] * [closures.size, closures.size, 1.0] for place, name in enumerate(machine.links)}
    for name, motion in links.items():
        motion[:, :2] += machine.links[name].cg
    return Course(links, drive, gaps, travels, closures.size)


def _drive_positions(machine: Machine) -> FloatArray:
    """How far the drive has gone at each position, rad or m; a motor is followed through its turn, too."""
    drive = machine.drive
    if isinstance(drive, RotationDrive | TorqueDrive):
        return np.asarray(np.arange(POSITIONS) * (sense_of_drive(machine) * 2 * math.pi / POSITIONS), np.float64)
    if drive is None or isinstance(drive, ForceDrive) or not drive.harmonics:
        return np.zeros(1)
    slowest = min((each.frequency for each in drive.harmonics if each.frequency > 0), default=1.0)
    t = np.arange(POSITIONS) / (POSITIONS * slowest)
    way = np.zeros(POSITIONS)
    for each in drive.harmonics:
        way += each.amplitude * (np.sin(2 * math.pi * each.frequency * t + each.phase) - math.sin(each.phase))
    return way


def sense_of_drive(machine: Machine) -> int:
    """Sense in which links[0] of the driven joint goes: 1 or -1; 1 for what stands."""
    drive = machine.drive
    if drive is None:
        return 1
    if isinstance(drive, TorqueDrive | ForceDrive):
        effort = drive.torque if isinstance(drive, TorqueDrive) else drive.force
        effort = effort if effort is not None else max((row[1] for row in drive.curve or ()), key=abs, default=1.0)
        return -1 if effort < 0 else 1
    speed = drive.speed
    top = max((row[1] for row in speed), key=abs) if isinstance(speed, tuple) else speed
    return -1 if top < 0 else 1


class _Closures:
    """What joints and drive demand of the links: residuals in parts of the machine's size, and their Jacobian."""

    def __init__(self, machine: Machine, open_joint: str) -> None:
        names, joints = list(machine.links), list(machine.joints.values())
        points = [complex(*joint.at) for joint in joints] + [complex(*link.cg) for link in machine.links.values()]
        joint_points = points[: len(joints)]
        self.size = max((abs(a - b) for a in joint_points for b in joint_points), default=0.0) or max(
            (abs(a - b) for a in points for b in points), default=0.0
        ) or 1.0  # fmt: skip
        centres = np.array([complex(*machine.links[name].cg) for name in names])
        self.names = list(machine.joints)
        self.ends = np.array([[names.index(link) for link in joint.links] for joint in joints], int).reshape(-1, 2)
        at = np.array(joint_points, complex)
        self.arms = (at[:, None] - centres[self.ends]) / self.size
        self.at = at / self.size
        self.sliding = np.array([isinstance(joint, SlidingJoint) for joint in joints], bool)
        self.along = np.array([complex(*getattr(joint, "direction", (1.0, 0.0))) for joint in joints], complex)
        self.weights = np.where([open_joint in ("", name) for name in self.names], 1.0, _HELD)
        self.held = _HELD if open_joint else 1.0
        self.count = 3 * len(names)
        self.free = [
            3 * place + k
            for place, (name, link) in enumerate(machine.links.items())
            for k, motion in enumerate(("x", "y", "theta"))
            if name != machine.frame and not link.fixed and motion not in link.locked
        ]
        self.driven: tuple[int, int] | None = None
        if isinstance(machine.drive, RotationDrive | TorqueDrive):
            self.driven = (*self.ends[self.names.index(machine.drive.joint)],)
        self.slid = -1
        if machine.drive is not None and self.driven is None and machine.driven_joint:
            self.slid = self.names.index(machine.driven_joint)
        self.moved: tuple[int, complex] | None = None
        if isinstance(machine.drive, PositionDrive) and machine.drive.link != machine.frame:
            self.moved = names.index(machine.drive.link), complex(*machine.drive.direction)

    def open(self, x: FloatArray) -> tuple[AnyComplexArray, AnyComplexArray, FloatArray]:
        """Way from second to first link at each joint; directions of their lines; what their angles differ by."""
        poses = x.reshape(-1, 3)
        shifts, turns = (poses[:, 0] + 1j * poses[:, 1])[self.ends], np.exp(1j * poses[:, 2])[self.ends]
        # Both began in the same point: differences of small numbers.
        away = shifts + self.arms * (turns - 1)
        angles = poses[:, 2][self.ends]
        return away[:, 0] - away[:, 1], self.along * turns[:, 1], angles[:, 0] - angles[:, 1]

    def residual(self, x: FloatArray, position: float) -> tuple[FloatArray, FloatArray]:
        """Residuals and their Jacobian by all coordinates."""
        away, along, turned = self.open(x)
        count, rows = len(away), np.arange(len(away))
        turns = np.exp(1j * x.reshape(-1, 3)[:, 2])[self.ends]
        moves = np.zeros((count, self.count), complex)
        angle = np.zeros((count, self.count))
        for side, sign in ((0, 1.0), (1, -1.0)):
            first = 3 * self.ends[:, side]
            moves[rows, first] += sign
            moves[rows, first + 1] += 1j * sign
            moves[rows, first + 2] += 1j * sign * self.arms[:, side] * turns[:, side]
            angle[rows, first + 2] += sign
        second = 3 * self.ends[:, 1] + 2
        lines = np.conj(along)[:, None] * moves  # real: along the line, imaginary: across it
        lines[rows, second] += np.conj(1j * along) * away
        ways = np.conj(along) * away
        pin, slide = ~self.sliding, self.sliding
        weights = self.weights
        parts = [
            (weights[pin] * away[pin].real, weights[pin, None] * moves[pin].real),
            (weights[pin] * away[pin].imag, weights[pin, None] * moves[pin].imag),
            (weights[slide] * ways[slide].imag, weights[slide, None] * lines[slide].imag),
            (weights[slide] * turned[slide], weights[slide, None] * angle[slide]),
        ]
        if self.driven is not None:
            row = np.zeros((1, self.count))
            row[0, 3 * self.driven[0] + 2] += 1.0
            row[0, 3 * self.driven[1] + 2] -= 1.0
            parts.append((self.held * (row @ x - position), self.held * row))
        if self.slid >= 0:
            at = [self.slid]
            parts.append((self.held * (ways[at].real - position / self.size), self.held * lines[at].real))
        if self.moved is not None:
            link, direction = self.moved
            row = np.zeros((1, self.count))
            row[0, 3 * link : 3 * link + 2] = direction.real, direction.imag
            parts.append((self.held * (row @ x - position / self.size), self.held * row))
        return np.concatenate([part[0] for part in parts]), np.vstack([part[1] for part in parts])[:, self.free]

    def settle(self, x: FloatArray, position: float) -> FloatArray:
        """Levenberg and Marquardt's method from a guess."""
        x, damping = x.copy(), 1e-8
        residual, rows = self.residual(x, position)
        for _ in range(_STEPS):
            worth = float(residual @ residual)
            if worth < _EXACT**2 or not self.free or damping > 1e9:
                break
            step = -np.linalg.solve(rows.T @ rows + damping * np.eye(len(self.free)), rows.T @ residual)
            trial = x.copy()
            trial[self.free] += step
            tried, rows_there = self.residual(trial, position)
            if tried @ tried < worth:
                x, residual, rows, damping = trial, tried, rows_there, max(0.1 * damping, 1e-12)
                if np.abs(step).max() < 1e-10:
                    break
            else:
                damping = max(10 * damping, 1e-8)
        return x

    def judge(self, table: FloatArray) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Gap of each joint and travel of each sliding one at all positions, m."""
        found = [self.open(pose.ravel()) for pose in table]
        gaps, travels = {}, {}
        for place, name in enumerate(self.names):
            ways = np.array([np.conj(along[place]) * away[place] for away, along, _ in found]) * self.size
            turned = np.array([turned[place] for _, _, turned in found])
            if self.sliding[place]:
                travels[name] = ways.real
                gaps[name] = np.maximum(np.abs(ways.imag), np.abs(turned) * self.size)
            else:
                gaps[name] = np.abs(ways)
        return gaps, travels
