"""What a compiled model holds, and what it left out and why."""

from __future__ import annotations

from dataclasses import dataclass

from solver.drive import prescribes_motion
from solver.fault import FaultState, check_fault
from solver.kernel import kernel_code
from solver.machine import Machine, SlidingJoint, TurningJoint
from solver.model import Model, build_model


@dataclass(frozen=True)
class Account:
    """The size of a scene, before and after everything it does not have was removed.

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
    left_out : tuple of (str, str)
        What the scene does not have or the coordinates fulfil by themselves, and why it costs nothing.
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
    left_out: tuple[tuple[str, str], ...]


def account(machine: Machine, fault: FaultState) -> Account:
    """Take stock of a machine in a fault state.

    Parameters
    ----------
    machine : Machine
    fault : FaultState

    Raises
    ------
    MachineError
        As :func:`solver.model.build_model`.
    """
    check_fault(fault, machine)
    model = build_model(machine, fault.joints)
    links, joints = len(machine.links), len(machine.joints)
    driven = 1 if prescribes_motion(machine) else 0
    return Account(
        links, joints, 3 * links + 2 * joints, model.degrees_of_freedom + driven, model.degrees_of_freedom,
        model.kinematics.names, tuple(c.name for c in model.kinematics.closures), model.clearance_joints,
        kernel_code(model).operations, tuple(_left_out(machine, model)),
    )  # fmt: skip


def _left_out(machine: Machine, model: Model) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    frame = machine.links[machine.frame]
    if frame.fixed:
        rows.append((f"motion of {machine.frame}", "the frame is fixed"))
    rows += [(f"{motion}({machine.frame})", "this motion of the frame is locked") for motion in frame.locked]
    for name in model.kinematics.eliminated:
        kind = "turning" if isinstance(machine.joints[name], TurningJoint) else "sliding"
        rows.append((f"2 equations and 2 reactions of {name}", f"{kind} joint fulfilled by the choice of coordinates"))
    for closure in model.kinematics.closures:
        if closure.name.endswith(".normal"):
            rows.append(
                (f"couple of {closure.name.removesuffix('.normal')}", "both links of a sliding joint share one angle")
            )
    if prescribes_motion(machine) and machine.drive is not None:
        rows.append((f"motion of the drive joint {machine.drive.joint}", "prescribed: known at every instant"))
    for name in machine.turning_joints:
        if name not in model.clearance_joints:
            rows.append((f"contact of {name}", "no clearance in this fault state"))
    for name, joint in machine.joints.items():
        if isinstance(joint, SlidingJoint) and not joint.friction and not joint.viscous:
            rows.append((f"friction of {name}", "friction and viscous are 0"))
        elif isinstance(joint, TurningJoint) and not joint.viscous and name not in model.clearance_joints:
            rows.append((f"viscous torque of {name}", "viscous is 0"))
    if machine.gravity == 0:
        rows.append(("gravity", "0 m/s2"))
    if not machine.loads:
        rows.append(("external loads", "none given"))
    if not machine.supports:
        rows.append(("supports", "none given"))
    return rows
