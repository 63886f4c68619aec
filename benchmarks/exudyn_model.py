"""A machine in Exudyn: planar rigid bodies, its own joints, and the product's contact law as a user function."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import RATE
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Mount, RotationDrive
from jointplay.solver.simulation.simulate import simulate

Array = NDArray[np.float64]


def _contact(clearance: float, law: Any, pin_radius: float, symbolic: Any) -> Any:
    """Force and torque of a connector on its first marker's body, from the second marker's motion relative to it.

    `symbolic` is Exudyn's module of functions on expression trees, which it evaluates without Python. The torques on
    pin and socket are opposite here: the friction's arm about the socket is short of the eccentricity.
    """
    k, c, mu, v0 = law.stiffness, law.damping, law.friction, law.friction_velocity

    def force(
        mbs: Any, t: Any, item: Any, e: Any, turn: Any, rate: Any, omega: Any, stiffness: Any, damping: Any,
        rotation0: Any, rotation1: Any, offset: Any,
    ) -> Any:  # fmt: skip
        eccentricity = symbolic.sqrt(symbolic.max(e[0] * e[0] + e[1] * e[1], 1e-60))
        nx, ny = e[0] / eccentricity, e[1] / eccentricity
        penetration = eccentricity - clearance
        elastic = symbolic.max(k * penetration + c * (nx * rate[0] + ny * rate[1]), 0.0)
        normal = symbolic.IfThenElse(penetration > 0.0, elastic, symbolic.Real(0.0))
        slip = nx * rate[1] - ny * rate[0] + pin_radius * omega[2]
        rubbing = mu * normal * symbolic.tanh(slip / v0)
        return symbolic.Vector([
            nx * normal - ny * rubbing, ny * normal + nx * rubbing, 0.0, 0.0, 0.0, pin_radius * rubbing
        ])  # fmt: skip

    return force


def _link_velocities(machine: Machine) -> dict[str, list[float]]:
    """At the start: those of the ideal machine."""
    start = simulate(machine, Case(), Settings(duration=1e-3, links=True)).links
    assert start is not None
    return {name: list(rate) for name, rate in zip(start.links, start.velocity[0], strict=True)}


def build(machine: Machine, fault: Fault) -> tuple[Any, int]:
    """The machine as a system of Exudyn, assembled, and its sensor of the frame's acceleration.

    Only what P1 and QR have: mounts, ideal joints, a rotation drive of constant speed, the linear contact law.
    """
    import exudyn as exu
    import exudyn.itemInterface as items  # noqa: N813
    from exudyn.advancedUtilities import CreateSymbolicUserFunction

    mbs = exu.SystemContainer().AddSystem()
    ground = mbs.AddObject(items.ObjectGround())
    velocities = _link_velocities(machine)
    nodes, bodies, kept = {}, {}, []
    for name, link in machine.links.items():
        nodes[name] = mbs.AddNode(
            items.NodeRigidBody2D(referenceCoordinates=[*link.cg, 0.0], initialVelocities=velocities[name])
        )
        bodies[name] = mbs.AddObject(
            items.ObjectRigidBody2D(mass=link.mass, inertia=link.inertia, nodeNumber=nodes[name])
        )
        weight = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=bodies[name]))
        mbs.AddLoad(items.LoadMassProportional(markerNumber=weight, loadVector=[0.0, -machine.gravity, 0.0]))

    def place(link: str, at: tuple[float, float], kind: Any) -> int:
        cg = machine.links[link].cg
        local = [at[0] - cg[0], at[1] - cg[1], 0.0]
        return int(mbs.AddMarker(kind(bodyNumber=bodies[link], localPosition=local)))

    for name, joint in machine.joints.items():
        first, second = joint.links
        if isinstance(joint, SlidingJoint):
            x, y = joint.direction
            length = math.hypot(x, y)
            markers = [place(second, joint.at, items.MarkerBodyRigid), place(first, joint.at, items.MarkerBodyRigid)]
            mbs.AddObject(
                items.ObjectJointPrismatic2D(
                    markerNumbers=markers, axisMarker0=[x / length, y / length, 0.0],
                    normalMarker1=[-y / length, x / length, 0.0], constrainRotation=True,
                )
            )  # fmt: skip
        elif name in fault.joints:
            pin = joint.pin or first
            socket = second if pin == first else first
            markers = [place(link, joint.at, items.MarkerBodyRigid) for link in (socket, pin)]
            law = joint.contact or machine.defaults.contact
            assert law is not None
            number = mbs.AddObject(
                items.ObjectConnectorRigidBodySpringDamper(markerNumbers=markers, springForceTorqueUserFunction=0)
            )
            force = _contact(fault[name], law, joint.pin_radius, exu.symbolic)
            compiled = CreateSymbolicUserFunction(mbs, force, "springForceTorqueUserFunction", number)
            mbs.SetObjectParameter(number, "springForceTorqueUserFunction", compiled)
            kept.append(compiled)
        else:
            markers = [place(link, joint.at, items.MarkerBodyPosition) for link in (first, second)]
            mbs.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers))
    for support in machine.supports:
        assert isinstance(support, Mount)
        anchor = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=ground, localPosition=[*support.at, 0.0]))
        mbs.AddObject(
            items.ObjectConnectorCartesianSpringDamper(
                markerNumbers=[anchor, place(support.link, support.at, items.MarkerBodyPosition)],
                stiffness=[*support.stiffness, 0.0], damping=[*support.damping, 0.0],
            )
        )  # fmt: skip
    drive = machine.drive
    assert isinstance(drive, RotationDrive) and isinstance(drive.speed, float)
    driven, carrier = machine.joints[drive.joint].links
    turns = [
        mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[link], coordinate=2)) for link in (carrier, driven)
    ]
    mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=turns, velocityLevel=True, offset=drive.speed))
    sensor = mbs.AddSensor(
        items.SensorNode(
            nodeNumber=nodes[machine.frame], outputVariableType=exu.OutputVariableType.Acceleration, storeInternal=True,
            writeToFile=False,
        )
    )  # fmt: skip
    mbs.variables["functions"] = kept  # Exudyn does not keep them alive
    mbs.Assemble()
    return mbs, int(sensor)


def run(machine: Machine, fault: Fault, duration: float, step: float) -> tuple[Array, float]:
    """Frame's y acceleration at 20 kHz by the trapezoidal rule (index 2), and processor seconds without the set-up."""
    import exudyn as exu

    mbs, sensor = build(machine, fault)
    settings = exu.SimulationSettings()
    settings.timeIntegration.endTime = duration
    settings.timeIntegration.numberOfSteps = round(duration / step)
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.verboseMode = 0
    settings.linearSolverType = exu.LinearSolverType.EXUdense
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = 1 / RATE
    began = time.process_time()
    mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
    spent = time.process_time() - began
    return np.asarray(mbs.GetSensorStoredData(sensor))[:, 2], spent
