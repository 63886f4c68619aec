"""Coordinates of a machine and the pose of every link as a function of them.

Each link's orientation is an absolute angle; links that a sliding joint or a prescribed rotation ties together share
one. Positions follow from the frame outwards along a spanning tree of the ideal joints, turning joints first because
they cost no coordinate. What the tree leaves over closes a loop: one closure equation per sliding joint, two per
turning joint. A joint with clearance is in neither; its pin floats.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from jointplay.solver.equations.drive import PrescribedMotion
from jointplay.solver.equations.numbers import Number
from jointplay.solver.equations.poses import Closure, Kinematics, slide
from jointplay.solver.equations.tree import Tree
from jointplay.solver.equations.vectors import constant
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine


def _closures(tree: Tree) -> Iterator[Closure]:
    """Closure equations of the ideal joints that the tree did not use, of a locked link and of a driven slide."""
    for name, joint in tree.machine.joints.items():
        if name in tree.eliminated or name in tree.open:
            continue
        if isinstance(joint, TurningJoint):
            first, second = (tree.poses[link].point(joint.at) for link in joint.links)
            gap = tree.terms.value(first - second).column
            yield Closure(f"{name}.x", gap[0])
            yield Closure(f"{name}.y", gap[1])
        else:
            along, across = slide(joint, tree.poses, tree.terms)
            yield Closure(f"{name}.normal", across)
            driven = tree.drives(name, rotation=False)
            if driven:
                yield Closure(f"{name}.drive", along - driven.value)
    if tree.expanded:
        yield from _angle_closures(tree)
    for name, link in tree.machine.links.items():
        if name == tree.machine.frame:
            continue
        offset = tree.terms.value(tree.poses[name].centre - constant(link.cg), ground=True).column
        motions = {"x": offset[0], "y": offset[1], "theta": tree.poses[name].theta}
        for motion in motions if link.fixed else link.locked:
            yield Closure(f"{name}.locked.{motion}", motions[motion])


def _angle_closures(tree: Tree) -> Iterator[Closure]:
    """Closure equations of the angles that links share, and of the drive, where they were not built in."""
    for name, joint in tree.machine.joints.items():
        first, second = (tree.angles[link].theta for link in joint.links)
        driven = tree.drives(name, rotation=True)
        if isinstance(joint, SlidingJoint):
            yield Closure(f"{name}.couple", first - second)
        elif driven:
            yield Closure(f"{name}.drive", first - second - driven.value)


def kinematics(
    machine: Machine,
    open_joints: frozenset[str],
    motion: PrescribedMotion | None,
    gravity: Number,
    *,
    rubbing: frozenset[str] = frozenset(),
    expanded: bool = False,
) -> Kinematics:
    """Choose coordinates and write every pose and the remaining closures.

    Parameters
    ----------
    machine : Machine
    open_joints : frozenset of str
        Turning joints with clearance.
    motion : PrescribedMotion or None
        Motion of the drive joint, a function of the time symbol.
    gravity : symbol or float
        m/s2 along -y.
    rubbing : frozenset of str
        Sliding joints with Coulomb friction: they keep their closure, whose multiplier is the normal force.
    expanded : bool
        Coordinates of its own for every link and a closure for every joint and the drive: nothing is eliminated, and
        every reaction is a multiplier.

    Raises
    ------
    AssemblyError
        The drive contradicts a sliding joint.
    """
    tree = Tree(machine, open_joints, rubbing, motion, gravity, expanded)
    tree.assign_angles()
    for link in (machine.frame, *machine.links):
        if link not in tree.poses:
            tree.place_root(link)
            tree.grow(link)
    return Kinematics(
        tuple(tree.names), ca.vertcat(*tree.z), ca.vertcat(*tree.v), tree.terms, tree.axes(),
        tree.poses, tuple(_closures(tree)), tuple(tree.eliminated),
    )  # fmt: skip
