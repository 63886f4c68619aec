"""Change points: positions of the drive where a machine could go on in two ways, and how near it comes to one.

There the Jacobian of the closures by time and coordinates lacks rank. Where the lengths of links miss one by a
micrometre, the machine does not close over a fraction of a degree, or its links change their speeds within one: both
fit between two positions of a walk, and are found from the nearest one as the saddle that they go round.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.rates import extent_of
from jointplay.solver.equations.geometry import travel
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.fits import in_um
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import MotionDrive, PositionDrive

#: A change point farther away than this part of the machine's extent is none: parts are made to some 1e-4 of their
#: size, and positions a few degrees apart see one that is farther.
_NEAR = 1e-4
#: One that is nearer, m, is passed exactly: a run, which holds closures to 1e-11 m, does not see the difference.
_EXACT = 1e-12
#: A motion has no part in a saddle with less than this part of its largest curvature.
_NO_PART = 1e-6
#: The drive stands on a way on which it moves by less than this part of what it does on the other.
_STANDS = 1e-6
#: How far ahead one is looked for, in steps of the walk: what falls so fast that it is seen from farther is none.
AHEAD = 3.0
_NEWTON_STEPS = 20


@dataclass(frozen=True, eq=False)
class ChangePoint:
    """A change point, or how near one the machine comes.

    Attributes
    ----------
    t : float
        Time of the drive, s.
    z : (n,) array
        Coordinates; the closures are open there by `distance`.
    distance : float
        By how much the lengths miss it, m: as far one joint must open, or may; 0 where it is passed exactly.
    width : float
        Time of the drive before and after it within which links change their speeds, or the machine stays open, s.
    closes : bool
        Whether the machine passes.
    closure : str
        Name of the closure that opens most.
    ways : (2, n + 1) array
        Directions in time and coordinates in which it could pass, were the distance 0; first the one that it came in.
    """

    t: float
    z: FloatArray
    distance: float
    width: float
    closes: bool
    closure: str
    ways: FloatArray

    def guess(self, t: float) -> FloatArray:
        """Coordinates a little further on the way that it came, (n,)."""
        return np.asarray(self.z + self.ways[0, 1:] * ((t - self.t) / self.ways[0, 0]))

    def times(self, reach: float) -> list[float]:
        """Times up to `reach` before and after it, s, dense enough to stay on the way that the machine takes."""
        if not self.width:
            return []
        steps = [self.width * 2.0**k for k in range(max(0, math.ceil(math.log2(reach / self.width))))]
        return [self.t, *(self.t + sign * step for step in steps for sign in (-1.0, 1.0))]


def find_change_point(model: Model, p: Sequence[float], t: float, z: FloatArray, step: float) -> ChangePoint | None:
    """The change point that a machine comes to within the next positions of its walk.

    Parameters
    ----------
    model : Model
    p : sequence of float
        Lane parameters.
    t : float
        Time of the drive, s.
    z : (n,) array
        Coordinates that close there.
    step : float
        Time between positions of the walk, s.

    Notes
    -----
    With u of norm 1, f the closures and F their Jacobian, it solves f = d u, F'u = 0. Near it the machine goes along
    q'Qq = -2 d, Q the second derivatives of u'f in the two directions q that F does not hold: a hyperbola, which leaves
    out some times where the machine does not pass.
    """
    places = [0, *(i + 1 for i in model.inner_indices)]
    scale = np.array([step, *np.ones(len(places) - 1)])  # time counts in steps of the walk
    at, still = np.array([t, *z]), np.zeros(model.size)
    u, d = np.zeros(0), 0.0
    for _ in range(_NEWTON_STEPS):
        value, by_z, by_t = evaluate(model.constraint, at[0], at[1:], still, p)
        rows = np.hstack([by_t, by_z])[:, places] * scale
        rank = min(len(rows) - model.repeats.shared, len(places) - 1)
        if not u.size:
            u = np.linalg.svd(rows)[0][:, rank - 1]
        (second,) = evaluate(model.constraint_curvature, at[0], at[1:], p, u)
        second = second[np.ix_(places, places)] * np.outer(scale, scale)
        m, n = rows.shape
        gradient = np.block([
            [rows, -d * np.eye(m), -u[:, None]], [second, rows.T, np.zeros((n, 1))], [np.zeros(n), u, 0.0],
        ])  # fmt: skip
        residual = np.concatenate([value[:, 0] - d * u, rows.T @ u, [0.5 * (u @ u - 1)]])
        change = -np.linalg.lstsq(gradient, residual, rcond=1e-12)[0]
        at[places] += scale * change[:n]
        u, d = u + change[n:-1], d + change[-1]
        if not np.abs(change).max() < 2 * AHEAD:
            return None
        if np.abs(change).max() < 1e-8:  # the next is its square
            break
    else:
        return None
    if not t < at[0] <= t + AHEAD * step or abs(d) > _NEAR * extent_of(model.machine):
        return None
    null = np.linalg.svd(rows)[2][rank - 1 :].T
    sizes, axes = np.linalg.eigh(null.T @ second @ null)
    # A saddle; motions that nothing drives take part in it nowhere, or it says nothing.
    others, least = np.abs(sizes[1:-1]).max(initial=0.0), _NO_PART * np.abs(second).max()
    if not sizes[0] < -least <= least < sizes[-1] or others > _NO_PART * np.abs(sizes).max():
        return None
    first, last = (null @ axes[:, [0, -1]] / np.sqrt(np.abs(sizes[[0, -1]]))).T
    open_times = -2 * d * (last[0] ** 2 - first[0] ** 2)  # their half width squared
    ways = np.zeros((2, len(at)))
    came = (at - [t, *z])[places] / scale
    ways[:, places] = scale * np.array(sorted((last + first, last - first), key=lambda way: _slant(way, came)))
    names = [c.name for c in model.kinematics.closures] + [j for j in model.clearance_joints for _ in range(2)]
    share = {name: float(np.linalg.norm(u[[_owner(other) == name for other in names]])) for name in map(_owner, names)}
    distance, width = abs(float(d)) / max(share.values()), step * math.sqrt(abs(open_times))
    if abs(d) < _EXACT:
        distance = width = open_times = 0.0
    return ChangePoint(
        float(at[0]), at[1:], distance, width, bool(open_times <= 0), names[int(np.abs(u).argmax())], ways
    )


def _owner(closure: str) -> str:
    """Joint or locked link that a closure is of."""
    return closure.partition(".")[0]


def _slant(way: FloatArray, other: FloatArray) -> float:
    """How far two directions, forwards or backwards, are from each other: 0 to 1."""
    return 1.0 - abs(float(way @ other)) / float(np.linalg.norm(way) * np.linalg.norm(other))


def position_of_drive(model: Model, p: Sequence[float], t: float, z: FloatArray) -> str:
    """Where its drive is, for the user; of a drive whose motion is prescribed."""
    if not isinstance(model.machine.drive, MotionDrive):
        return "as drawn"
    moved, rotates = _position(model)
    now = float(evaluate(model.function("position", moved), t, z, np.zeros(model.size), p)[0][0, 0])
    if rotates:
        return f"at a drive angle of {math.degrees(now):.1f} deg"
    return f"at a drive travel of {now * 1e3:.3g} mm"


def _position(model: Model) -> tuple[ca.SX, bool]:
    """Position of a drive that prescribes a motion since drawn, rad or m; whether it rotates."""
    drive, kin = model.machine.drive, model.kinematics
    assert isinstance(drive, MotionDrive)
    if isinstance(drive, PositionDrive):
        return travel(drive.link, drive.direction, kin.poses, kin.terms), False
    joint = model.machine.joints[drive.joint]
    return kin.position(joint), isinstance(joint, TurningJoint)


def place_of(machine: Machine, closure: str) -> str:
    """Path in the machine file of what a closure stands for."""
    owner, _, kind = closure.partition(".")
    if kind == "drive" and machine.driven_link:
        return "drive.link"
    return f"links.{owner}.locked" if kind.startswith("locked") else f"joints.{owner}"


def cannot_assemble(model: Model, p: Sequence[float], t: float, z: FloatArray, gap: float, name: str) -> AssemblyError:
    """Refusal after the last pose `z` that closes, at time `t`; `gap` is what stays open at the next of the walk."""
    owner, _, kind = name.partition(".")
    what = f"link {owner}, locked," if kind.startswith("locked") else f"joint {owner}"
    if kind == "drive" and model.machine.driven_link:
        what = f"link {owner}, driven,"
    where = position_of_drive(model, p, t, z)
    far = f"{gap * 1e3:.3g} mm" if gap >= 1e-4 else in_um(gap)
    rule = f"cannot be assembled {where}: a little further {what} stays {far} open"
    return AssemblyError(model.machine.name, place_of(model.machine, name), None, rule)


def describe_change_point(model: Model, p: Sequence[float], point: ChangePoint) -> str:
    """One line for the user: where it is, and which way the machine goes on or by how much it misses it."""
    where = position_of_drive(model, p, point.t, point.z)
    if point.distance:
        miss = in_um(point.distance)
        return f"comes within {miss} of a change point {where}: links that are off by as much may not let it pass"
    told = f"passes a change point {where}"
    position, rotates = _position(model)
    rate = model.function("drive_rate", ca.jacobian(position, model.z), ca.jacobian(position, model.t))
    at = (point.t, point.z, np.zeros(model.size), p)
    by_z, by_t = (np.vstack(pair) for pair in zip(evaluate(model.link_rates, *at), evaluate(rate, *at), strict=True))
    *motions, driven = np.hstack([by_t, by_z]) @ point.ways.T
    if np.abs(driven).min() < _STANDS * np.abs(driven).max():
        return f"{told}: it goes on as it came, not on the branch on which the drive stands"
    turns = np.round(motions[2::3] / driven, 6) + 0.0  # no -0
    most = int(np.abs(turns[:, 0] - turns[:, 1]).argmax())
    unit = "times as fast as the drive" if rotates else "rad for each metre of the drive"
    own, other = turns[most]
    told = f"{told}: {list(model.machine.links)[most]} turns {own:.3g} {unit} if it goes on as it came, {other:.3g}"
    return f"{told} on the other branch, onto which errors of a run can bring it"
