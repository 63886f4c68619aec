"""The motion of a drawing: links stay joined, and go the way that geometry says."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from jointplay.solver.machines.course import POSITIONS, course_of
from jointplay.solver.machines.drawing import machine_svg
from jointplay.solver.machines.drawing_motion import moving_drawing
from jointplay.solver.machines.machine import Machine, shipped_machine, shipped_machine_names


def place(machine: Machine, link: str, pose: np.ndarray, point: tuple[float, float]) -> complex:
    cg = machine.links[link].cg
    return complex(pose[0], pose[1]) + np.exp(1j * pose[2]) * complex(point[0] - cg[0], point[1] - cg[1])


@pytest.mark.parametrize("name", shipped_machine_names())
def test_turning_joints_stay_together(name: str) -> None:
    machine = shipped_machine(name)
    motion = course_of(machine).links
    for joint in machine.turning_joints:
        first, second = machine.joints[joint].links
        at = machine.joints[joint].at
        for one, other in zip(motion[first], motion[second], strict=True):
            assert abs(place(machine, first, one, at) - place(machine, second, other, at)) < 1e-9
    np.testing.assert_allclose(motion[machine.frame][:, :2], [machine.links[machine.frame].cg] * POSITIONS, atol=1e-12)


def test_a_crank_turns_evenly_and_the_slider_follows() -> None:
    machine = shipped_machine("slider-crank")
    motion = course_of(machine).links
    np.testing.assert_allclose(motion["crank"][:, 2], np.arange(POSITIONS) * 2 * np.pi / POSITIONS, atol=1e-9)
    o, a, b = (complex(*machine.joints[name].at) for name in ("O", "A", "B"))
    crank, rod = abs(a - o), abs(b - a)
    angle = np.angle(a - o) + motion["crank"][:, 2]
    expected = o.real + crank * np.cos(angle) + np.sqrt(rod**2 - (crank * np.sin(angle) + o.imag - b.imag) ** 2)
    found = b.real + motion["slider"][:, 0] - machine.links["slider"].cg[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("name", shipped_machine_names())
def test_what_moves_is_in_the_drawing_and_what_stands_does_not(name: str) -> None:
    machine = shipped_machine(name)
    moving = moving_drawing(machine)
    drawing = ET.fromstring(machine_svg(machine))
    classes = {part for element in drawing.iter() for part in element.get("class", "").split()}
    assert set(moving.transforms) <= classes
    assert f"link-{machine.frame}" not in moving.transforms
    driven = machine.joints[machine.driven_joint]
    assert (f"joint-{machine.driven_joint}" in moving.transforms) == (machine.frame not in driven.links)
    for load in machine.loads:  # what pushes goes with what it pushes
        assert f"load-{load.link}" in moving.transforms
    number = r"-?\d+\.\d+"
    for steps in moving.transforms.values():
        assert len(steps) == POSITIONS
        for step in steps:
            shape = rf"translate\({number} {number}\)( rotate\({number} {number} {number}\))?"
            assert re.fullmatch(shape, step)
        assert steps[0].startswith("translate(0.0 0.0)")
