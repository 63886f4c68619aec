"""Link motions and reactions fulfil Newton and Euler, link by link, and the joints."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.history import History
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate


def run(name: str, fault: dict[str, float]) -> tuple[Machine, History]:
    machine = shipped_machine(name)
    return machine, simulate(
        machine, Case(Fault(fault)), Settings(duration=0.2, sample_rate=2000, method="gill", links=True)
    )


@pytest.mark.parametrize(
    ("name", "fault"),
    [("quick-return", {}), ("quick-return", {"A": 2e-4}), ("quick-return", {"O": 2e-4, "F": 1e-4}),
     ("slider-crank", {"B": 2e-4}), ("four-bar", {"D": 1e-4})],
)  # fmt: skip
def test_newton_and_euler_of_every_moving_link(name: str, fault: dict[str, float]) -> None:
    machine, history = run(name, fault)
    assert history.links is not None
    motion, reactions = history.links, history.links.reactions
    total = np.zeros((len(history.t), len(motion.links), 3))

    def apply(link: str, force: np.ndarray, arm: np.ndarray) -> None:
        column = motion.links.index(link)
        total[:, column, :2] += force
        total[:, column, 2] += arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]

    def turned(link: str, vector: tuple[float, float]) -> np.ndarray:
        theta = motion.displacement[:, motion.links.index(link), 2]
        c, s = np.cos(theta), np.sin(theta)
        return np.column_stack([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])

    def arm(link: str, at: tuple[float, float]) -> np.ndarray:
        cg = machine.links[link].cg
        return turned(link, (at[0] - cg[0], at[1] - cg[1]))

    for joint_name, joint in machine.joints.items():
        first, second = joint.links
        if isinstance(joint, SlidingJoint):
            along = turned(second, joint.direction)
            force = np.column_stack([-along[:, 1], along[:, 0]]) * reactions[f"normal_{joint_name}"][:, None]
            where = arm(first, joint.at)
            apply(first, force, where)
            at = [
                np.array([*machine.links[k].cg]) + motion.displacement[:, motion.links.index(k), :2]
                for k in joint.links
            ]
            apply(second, -force, where + at[0] - at[1])
            total[:, motion.links.index(first), 2] += reactions[f"couple_{joint_name}"]
            total[:, motion.links.index(second), 2] -= reactions[f"couple_{joint_name}"]
        elif joint_name in fault:
            # Force at the common contact point: moments about the pin centre follow from force and normal.
            force = reactions[f"force_{joint_name}_on_pin"]
            socket = second if joint.pin == first else first
            centre = [
                np.array([*machine.links[k].cg]) + motion.displacement[:, motion.links.index(k), :2] + arm(k, joint.at)
                for k in (joint.pin, socket)
            ]
            e = centre[0] - centre[1]
            normal = e / np.maximum(np.linalg.norm(e, axis=1), 1e-30)[:, None]
            apply(joint.pin, force, arm(joint.pin, joint.at) + joint.pin_radius * normal)
            apply(socket, -force, arm(socket, joint.at) + e + joint.pin_radius * normal)
        else:
            force = reactions[f"force_{joint_name}"]
            apply(first, force, arm(first, joint.at))
            apply(second, -force, arm(second, joint.at))
    first, second = machine.joints[machine.drive.joint].links  # type: ignore[union-attr]
    total[:, motion.links.index(first), 2] += reactions["drive_effort"]
    total[:, motion.links.index(second), 2] -= reactions["drive_effort"]
    for column, link_name in enumerate(motion.links):
        if link_name == machine.frame:
            continue  # it also feels its mounts
        link = machine.links[link_name]
        total[:, column, 1] -= link.mass * machine.gravity
        inertia = np.array([link.mass, link.mass, link.inertia])
        gap = total[:, column] - inertia * motion.acceleration[:, column]
        assert np.abs(gap).max() < 1e-8 * max(1.0, np.abs(total[:, column]).max()), link_name


def test_the_frame_is_the_same_twice() -> None:
    machine, history = run("quick-return", {"A": 2e-4})
    assert history.links is not None
    column = history.links.links.index(machine.frame)
    assert history.links.displacement[:, column] == pytest.approx(history.displacement, abs=1e-15)
    assert history.links.velocity[:, column] == pytest.approx(history.velocity, abs=1e-13)
    scale = np.abs(history.acceleration).max()
    assert np.abs(history.links.acceleration[:, column] - history.acceleration).max() < 1e-11 * scale


def test_reactions_are_named_after_joints() -> None:
    _, history = run("quick-return", {"A": 2e-4})
    assert history.links is not None
    names = {name: value.shape[1:] for name, value in history.links.reactions.items()}
    assert names == {
        **{f"force_{joint}": (2,) for joint in ("O", "C", "E", "F")},
        "force_A_on_pin": (2,),
        **{f"{kind}_{joint}": () for joint in ("G1", "G2") for kind in ("normal", "couple")},
        "drive_effort": (),
    }


def test_numbers_that_only_a_case_has_reach_the_reactions() -> None:
    machine = shipped_machine("quick-return")
    case = Case(Fault({"A": 2e-4}), {"joints.A.contact.viscous": 50.0, "links.ram.mass": 2.5})
    history = simulate(machine, case, Settings(duration=0.05, sample_rate=2000, method="gill", links=True))
    assert history.links is not None
    column = history.links.links.index(machine.frame)
    scale = np.abs(history.acceleration).max()
    assert np.abs(history.links.acceleration[:, column] - history.acceleration).max() < 1e-11 * scale
