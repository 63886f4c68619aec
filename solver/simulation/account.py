"""What a compiled model holds, and what it left out and why."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.decoupling import Decoupling, can_be_decoupled, decouple, decoupling_of
from jointplay.solver.cases.reach import Reach, reach_of
from jointplay.solver.equations.drive import prescribes_motion
from jointplay.solver.equations.model import Model, build_model
from jointplay.solver.integrators.kernel import kernel_code
from jointplay.solver.machines.fault import Fault, check_fault
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import TranslationDrive

_SHARED = "how they share the load is open, the frame does not feel it"


@dataclass(frozen=True)
class LeftOut:
    """Something a model does without.

    Attributes
    ----------
    what, why : str
        What the scene does not have or the coordinates fulfil by themselves, and why it costs nothing.
    unknowns : int
        Unknowns of the paper's system that it takes along; 0 for a term of the forces.
    """

    what: str
    why: str
    unknowns: int = 0


@dataclass(frozen=True)
class Account:
    """The size of a scene, before and after everything it does not have was removed.

    The 3N + 2J unknowns and those of `added` are the coordinates, the closures and the unknowns left out.

    Attributes
    ----------
    links, joints : int
        N and J.
    full_unknowns : int
        3N + 2J of the paper's system: three per link, two per joint.
    freedoms : int
        F, degrees of freedom when the input motion is unknown.
    integrated : int
        Degrees of freedom to integrate: one less where the drive prescribes its motion.
    coordinates : tuple of str
        Coordinates of the model.
    closures : tuple of str
        Closure equations left to solve.
    clearance_joints : tuple of str
    operations : int
        Vector operations of one right-hand side.
    added : tuple of str
        What the paper's system does not have: closures of links locked to the ground, and of a drive that moves a
        closed loop by its sliding joint; modes of the frame.
    left_out : tuple of LeftOut
    open_reactions : tuple of str
        Joints that hold together more than there is to hold: how they share the load is open.
    decoupling : Decoupling or None
        What is left out where the frame is decoupled, or would be; None where it cannot be.
    decoupled : bool
        Whether it is.
    """

    links: int
    joints: int
    full_unknowns: int
    freedoms: int
    integrated: int
    coordinates: tuple[str, ...]
    closures: tuple[str, ...]
    clearance_joints: tuple[str, ...]
    operations: int
    added: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    open_reactions: tuple[str, ...] = ()
    decoupling: Decoupling | None = None
    decoupled: bool = False


def account(machine: Machine, fault: Fault) -> Account:
    """Take stock of a machine in a fault state.

    Parameters
    ----------
    machine : Machine
    fault : Fault

    Raises
    ------
    MachineError
        As :func:`jointplay.solver.equations.model.build_model`.
    """
    check_fault(fault, machine)
    links, joints = len(machine.links), len(machine.joints)
    reach = reach_of(machine)
    case = reach.case(Case(fault))
    machine, fault = decouple(reach.machine, Settings(), [case])[0], case.fault
    model = build_model(machine, fault.joints)
    driven = 1 if prescribes_motion(machine) else 0
    closures = tuple(closure.name for closure in model.kinematics.closures)
    repeated, unsettled = _repeats_left_out(machine, model)
    return Account(
        links, joints, 3 * links + 2 * joints, model.degrees_of_freedom + driven, model.degrees_of_freedom,
        model.kinematics.names, closures, model.clearance_joints, kernel_code(model).operations,
        (
            *(name for name in closures if name.split(".")[1] in ("locked", "drive")),
            *(model.kinematics.names[i] for i in model.kinematics.modes),
        ),
        (*_out_of_reach(reach), *_unknowns_left_out(machine, model), *repeated, *_terms_left_out(machine, model)),
        unsettled, decoupling_of(machine) if can_be_decoupled(machine) else None, machine.decoupled,
    )  # fmt: skip


def _out_of_reach(reach: Reach) -> Iterator[LeftOut]:
    """Links that the frame cannot feel."""
    if reach.links:
        what = ", ".join([*reach.links, *reach.joints])
        unknowns = 3 * len(reach.links) + 2 * len(reach.joints)
        why = f"connected to {reach.whole.frame} through fixed links alone: it cannot feel them (--whole keeps them)"
        yield LeftOut(what, why, unknowns)


def _repeats_left_out(machine: Machine, model: Model) -> tuple[list[LeftOut], tuple[str, ...]]:
    """Closures that follow from others, and the joints whose reactions are open with them."""
    if not model.repeats.open:
        return [], ()
    # The joints that the choice of coordinates fulfils take part as well; here they are closures, too.
    full = build_model(machine, model.clearance_joints, expanded=True).repeats
    unsettled = tuple(dict.fromkeys(name.partition(".")[0] for name in full.open))
    sums = {repeat.closure.name: repeat.of for repeat in full.left_out}
    found = []
    for repeat in model.repeats.left_out:
        name, _, kind = repeat.closure.name.partition(".")
        held = {other.partition(".")[0] for other in sums.get(repeat.closure.name, unsettled)} - {name}
        why = f"{name} repeats {', '.join(sorted(held))}: {_SHARED}"
        found.append(
            LeftOut(
                f"{'normal force' if kind == 'normal' else kind} of {name}", why, 0 if kind.startswith("locked") else 1
            )
        )
    if model.repeats.shared:
        loops = ", ".join(dict.fromkeys(name.partition(".")[0] for name in model.repeats.open))
        what = f"reactions of {loops} for themselves"
        found.append(LeftOut(what, f"{model.repeats.shared} of their equations follow from the others: {_SHARED}"))
    return found, unsettled


def _unknowns_left_out(machine: Machine, model: Model) -> Iterator[LeftOut]:
    """Accelerations and reactions that are no unknowns of this model."""
    name, frame = machine.frame, machine.links[machine.frame]
    if frame.fixed:
        yield LeftOut(f"motion of {name}", "the frame is fixed", 3)
    else:
        for motion in dict.fromkeys(frame.locked):
            yield LeftOut(f"{motion}({name})", "this motion of the frame is locked", 1)
    share = {link: link for link in machine.links}  # links whose angles are tied together so far, by one of them

    def tie(links: tuple[str, str]) -> bool:
        """Tie two links' angles; false where others have tied them already."""
        first, second = (share[link] for link in links)
        share.update({link: first for link, of in share.items() if of == second})
        return first != second

    for joint_name, joint in machine.joints.items():
        eliminated = joint_name in model.kinematics.eliminated
        driven = machine.driven_joint == joint_name and prescribes_motion(machine)
        if joint_name in model.clearance_joints:
            yield LeftOut(f"2 reactions of {joint_name}", "clearance: its force follows from the motion", 2)
        elif isinstance(joint, SlidingJoint):
            tied = 1 if tie(joint.links) else 0
            if eliminated:
                why = "sliding joint fulfilled by the choice of coordinates"
                yield LeftOut(f"{1 + tied} equations and 2 reactions of {joint_name}", why, 3 + tied)
            elif tied:
                yield LeftOut(f"angle and couple of {joint_name}", "both links of a sliding joint share one angle", 2)
            else:
                yield LeftOut(f"couple of {joint_name}", "other sliding joints hold these links parallel already", 1)
        elif eliminated:
            why = "turning joint fulfilled by the choice of coordinates"
            yield LeftOut(f"2 equations and 2 reactions of {joint_name}", why, 4)
        # The drive of a slide that closes a loop stays, as a closure.
        if driven and (eliminated or not isinstance(machine.drive, TranslationDrive)):
            if isinstance(joint, TurningJoint):
                tie(joint.links)
            yield LeftOut(f"motion of the drive joint {joint_name}", "prescribed: known at every instant", 1)


def _terms_left_out(machine: Machine, model: Model) -> Iterator[LeftOut]:
    """Forces that this scene does not have."""
    for name, joint in machine.joints.items():
        guide = isinstance(joint, SlidingJoint)
        drag = "viscous resistance of" if guide else "viscous torque of"
        rubs = "friction of" if guide else "friction of the journal"
        rubbing = joint.friction if isinstance(joint, SlidingJoint) else joint.journal_friction
        if name in model.clearance_joints:
            if joint.viscous:
                yield LeftOut(f"{drag} {name}", "only while the joint has no clearance")
            if rubbing:
                yield LeftOut(f"{rubs} {name}", "only while the joint has no clearance")
            continue
        if name in machine.wearing_joints:
            yield LeftOut(f"contact of {name}", "no clearance in this fault state")
        if isinstance(joint, TurningJoint) and joint.film:
            yield LeftOut(f"film of {name}", "no clearance in this fault state")
        if guide and not rubbing:
            yield LeftOut(f"{rubs} {name}", "friction is 0")
        if not joint.viscous:
            yield LeftOut(f"{drag} {name}", "viscous is 0")
    standing = {name for name, link in machine.links.items() if link.fixed}
    for i, support in enumerate(machine.supports):
        if support.link in standing and (support.to_link is None or support.to_link in standing):
            yield LeftOut(f"supports.{i}", "both its ends are fixed")
    for i, load in enumerate(machine.loads):
        if load.link in standing:
            yield LeftOut(f"loads.{i}", f"{load.link} is fixed")
    if machine.drive is None:
        yield LeftOut("drive", "none given")
    if machine.gravity == 0:
        yield LeftOut("gravity", "0 m/s2")
    if not machine.loads:
        yield LeftOut("external loads", "none given")
    if not machine.supports:
        yield LeftOut("supports", "none given")
