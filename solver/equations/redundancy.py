"""Closures that follow from others wherever the machine goes: what the frame does not feel, and who carries it.

Closures are redundant where their Jacobian lacks rank at every position, not at a change point alone. Those that are
the same sum of others everywhere, a second guide along the first, are left out. Where what follows from what turns with
the machine, three parallel cranks, no choice of closures serves all positions: they stay, and share their load by least
squares. Without redundancy nothing is changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.equations.geometry import Closure, Kinematics
from jointplay.solver.equations.numbers import Numbers, evaluate
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine

#: A closure of which less than this part is not in those before it follows from them.
_INDEPENDENT = 1e-9
#: A closure has no part in another, or in reactions without effect, below this.
_SHARE = 1e-6
#: Positions that are looked at: what holds at a few that have nothing to do with each other holds at all.
_POSITIONS = 8
#: Between them, rad or parts of the machine's size: too far for what holds to second order only.
_STRIDE = 0.1
#: Closures are closed below this, parts of the machine's size or rad.
_CLOSED = 1e-11
_NEWTON_STEPS = 30


@dataclass(frozen=True)
class Repeat:
    """A closure that was left out.

    Attributes
    ----------
    closure : Closure
    of : tuple of str
        Names of those that it follows from.
    """

    closure: Closure
    of: tuple[str, ...]


@dataclass(frozen=True)
class Repeats:
    """What of a machine's closures follows from others at every position.

    Attributes
    ----------
    all : tuple of str
        Names of the closures, left out or not.
    left_out : tuple of Repeat
    shared : int
        How many of the closures that stay follow from others of them.
    open : tuple of str
        Names of all closures whose reactions have no value of their own, left out or not.
    """

    all: tuple[str, ...]
    left_out: tuple[Repeat, ...] = ()
    shared: int = 0
    open: tuple[str, ...] = ()

    @property
    def joints(self) -> frozenset[str]:
        """Joints and locked links of which a closure was left out."""
        return frozenset(_owner(repeat.closure.name) for repeat in self.left_out)


def independent_rows(rows: FloatArray) -> list[int]:
    """Rows that do not follow from those before them.

    Parameters
    ----------
    rows : (m, n) array

    Returns
    -------
    list of int
        Places; their number is the rank.
    """
    scale = float(np.abs(rows).max(initial=0.0))
    basis: list[FloatArray] = []
    kept = []
    for place, row in enumerate(rows):
        size = float(np.linalg.norm(row))
        left = row.copy()
        for _ in range(2):  # once more, or rounding would stay in
            for other in basis:
                left -= (other @ left) * other
        if size > _INDEPENDENT * scale and np.linalg.norm(left) > _INDEPENDENT * size:
            basis.append(left / np.linalg.norm(left))
            kept.append(place)
    return kept


def without_repeats(
    machine: Machine, kin: Kinematics, t: ca.SX, number: Numbers, undriven: Callable[[], Kinematics],
    rubbing: frozenset[str],
) -> tuple[Kinematics, Repeats]:  # fmt: skip
    """Leave out closures that are the same sum of others at every position.

    Parameters
    ----------
    machine : Machine
    kin : Kinematics
    t : casadi.SX
    number : Numbers
        What the closures depend on beside the coordinates.
    undriven : callable
        Makes the kinematics of the same coordinates without the drive's motion: its positions are all that can be.
    rubbing : frozenset of str
        Joints with Coulomb friction.

    Returns
    -------
    (Kinematics, Repeats)
        The same one where nothing repeats, or where the rank is lacking in the drawn pose only.
    """
    everything = tuple(closure.name for closure in kin.closures)
    if not everything:
        return kin, Repeats(())
    rigid = [i for i in range(kin.z.numel()) if i not in kin.modes]
    closing = ca.jacobian(ca.vertcat(*(c.phi for c in kin.closures)), kin.z)[:, rigid]
    drawn = ca.Function("drawn", [kin.z, t, number.vector], [ca.densify(closing)])
    values = [number.nominal.get(path, 0.0) for path in number.paths]
    if len(independent_rows(evaluate(drawn, np.zeros(kin.z.numel()), 0.0, values)[0])) == len(kin.closures):
        return kin, Repeats(everything)
    free = undriven()
    names = [closure.name for closure in free.closures]
    positions = _positions(machine, free)
    rank = max((len(independent_rows(rows)) for rows in positions), default=len(names))
    if rank == len(names):
        return kin, Repeats(everything)
    parts = [*machine.joints, *machine.links]
    order = sorted(range(len(names)), key=lambda place: parts.index(_owner(names[place])))
    together = np.hstack(positions)[order]
    chosen = independent_rows(together)
    repeats: dict[str, tuple[str, ...]] = {}
    for place in sorted(set(range(len(names))) - set(chosen)):
        share = np.linalg.lstsq(together[chosen].T, together[place], rcond=None)[0]
        repeats[names[order[place]]] = tuple(names[order[i]] for i in np.array(chosen)[np.abs(share) > _SHARE])
    kept = [place for place, name in enumerate(names) if name not in repeats]
    shared = {names[kept[i]] for i in _idle([rows[kept] for rows in positions])}
    _check_friction(machine, rubbing, repeats, shared)
    if shared and machine.modes:
        among = ", ".join(sorted(map(_owner, shared)))
        rule = f"how {among} share the load of a rigid frame is open; a frame that bends is not modelled with them"
        raise AssemblyError(machine.name, "modes", len(machine.modes), rule)
    return replace(kin, closures=tuple(c for c in kin.closures if c.name not in repeats)), Repeats(
        everything,
        tuple(Repeat(c, repeats[c.name]) for c in kin.closures if c.name in repeats),
        len(kept) - rank,
        tuple(names[i] for i in _idle(positions)),
    )


def _owner(closure: str) -> str:
    """Joint or locked link that a closure is of."""
    return closure.partition(".")[0]


def _idle(positions: list[FloatArray]) -> list[int]:
    """Closures that take part in reactions without any effect, at some position."""
    largest = np.zeros(len(positions[0]))
    for rows in positions:
        left, sizes, _ = np.linalg.svd(rows)
        without_effect = left[:, int((sizes > _INDEPENDENT * sizes.max(initial=0.0)).sum()) :]
        largest = np.maximum(largest, np.abs(without_effect).max(axis=1, initial=0.0))
    return [i for i, part in enumerate(largest) if part > _SHARE]


def _check_friction(
    machine: Machine, rubbing: frozenset[str], repeats: dict[str, tuple[str, ...]], shared: set[str]
) -> None:
    """Refuse friction where the normal force is open. Parallel guides of two links rub as one, by the resultant.

    Couples of guides do not rub, so that who carries them may stay open.
    """

    def rub(closures: Iterable[str]) -> set[str]:
        return {_owner(name) for name in closures if not name.endswith(".couple")} & rubbing

    for name, of in repeats.items():
        first, *others = dict.fromkeys(map(_owner, (*of, name)))
        for other in others if rub((*of, name)) else ():
            joint, same = machine.joints.get(other), machine.joints.get(first)
            if not isinstance(joint, SlidingJoint) or not isinstance(same, SlidingJoint):
                shared.update((*of, name))
            elif set(joint.links) != set(same.links) or joint.own_friction != same.own_friction:
                rule = f"must be the friction of {first}, {same.friction:g}: both guide the same links, and rub as one"
                raise AssemblyError(machine.name, f"joints.{other}.friction", joint.friction, rule)
    for name in sorted(rub(shared)):
        joint = machine.joints[name]
        number = "friction" if isinstance(joint, SlidingJoint) else "journal_friction"
        among = ", ".join(sorted({_owner(closure) for closure in shared}))
        rule = f"no force to rub by: how {among} share the load is open; leave one of them out"
        raise AssemblyError(machine.name, f"joints.{name}.{number}", getattr(joint, number), rule)


def _positions(machine: Machine, kin: Kinematics) -> list[FloatArray]:
    """Jacobians (m, n) of the closures where the machine can go from its drawn pose; none where it should, but cannot.

    Columns are for angles, and distances in parts of the machine's size. A machine that holds to first order only, with
    a third crank of another length, does not arrive.
    """
    points = [joint.at for joint in machine.joints.values()]
    extent = max((math.dist(p, q) for p in points for q in points), default=0.0) or 1.0
    # The frame stays rigid: what its modes open a little is no place to go to.
    rigid = [i for i in range(len(kin.names)) if i not in kin.modes]
    scale = np.array([1.0 if kin.names[i].startswith("theta(") else extent for i in rigid])
    inner = np.array([i not in kin.indices_of(machine.frame) for i in rigid])
    phi = ca.vertcat(*(c.phi for c in kin.closures))
    phi = ca.substitute(phi, kin.z[kin.modes], ca.SX.zeros(len(kin.modes))) if kin.modes else phi
    z = kin.z[rigid]
    function = ca.Function("closures", [z], [ca.densify(phi), ca.densify(ca.jacobian(phi, z))])

    def at(place: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, rows = evaluate(function, scale * place)
        return value[:, 0] / extent, rows * scale / extent

    place = np.zeros(len(scale))
    found = [at(place)[1]]
    heading = np.random.default_rng(0).standard_normal(len(scale))
    while len(found) < _POSITIONS:
        _, sizes, directions = np.linalg.svd(found[-1])
        ways = directions[int((sizes > _INDEPENDENT * sizes[:1]).sum()) :]
        if not len(ways):  # on the ground, and nothing moves: one position is all there is
            return found
        heading = ways.T @ (ways @ heading)
        heading /= np.linalg.norm(heading)
        there = place + _STRIDE * heading
        for _ in range(_NEWTON_STEPS):
            value, rows = at(there)
            if np.abs(value).max() < _CLOSED:
                break
            there = there - np.linalg.lstsq(rows, value, rcond=_INDEPENDENT)[0]
        gone = float(np.linalg.norm((there - place)[inner]))
        if np.abs(value).max() >= _CLOSED or gone < 0.5 * _STRIDE * float(np.linalg.norm(heading[inner])):
            return []
        place = there
        found.append(rows)
    return found
