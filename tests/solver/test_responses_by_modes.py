"""Frequency responses that modes make of a frame, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from bent_frames import bent
from frame_responses import LINES, accelerances, transform_of, tree_of

from jointplay.solver.cases.responses import find_response
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.machines.modes import shapes_at, swing


def test_a_mode_that_carries_a_link_swings_as_one_degree_of_freedom() -> None:
    mass, small, share, damping, own = 12.0, 0.5, 0.6, 0.03, 40.0
    tree: dict[str, Any] = {
        "name": "carried", "links": {"bed": {"fixed": True}, "disc": {"mass": small, "inertia": 1e-4, "cg": [0, 0]}},
        "joints": {"O": {"kind": "turning", "links": ["disc", "bed"], "at": [0, 0]}},
        "drive": {"kind": "rotation", "joint": "O", "speed": 100.0},
        "sensors": [{"name": "y", "at": [0.3, 0], "direction": [0, 1]}],
        "modes": [{"frequency": own, "damping": damping, "mass": mass, "shape": [
            {"at": [0, 0], "displacement": [0, 1], "rotation": 2}, {"at": [0.3, 0], "displacement": [0, share]}]}],
    }  # fmt: skip
    found = find_response(parse_machine(tree))
    # Of the mode with the disc on it, which it lifts and turns: frequency and damping by the mass that both have.
    whole = mass + small + 2**2 * 1e-4
    both = math.sqrt(mass / whole)
    expected = -share / whole * swing(found.frequency / (own * both), damping * both)
    assert found.point == "joint O"
    np.testing.assert_allclose(found.accelerances[:, 0, 1], expected, rtol=1e-9)
    # The mode turns the joint by 2 rad for a metre; nothing of it goes along x.
    np.testing.assert_allclose(found.accelerances[:, 0, 2], 2 * expected, rtol=1e-9)
    assert not found.accelerances[:, 0, 0].any()
    # Closest lines of a peak are within 2 % of it, and the drive's frequency lies in the band.
    assert np.abs(expected).max() > 0.98 * share / whole / (2 * damping * both)
    assert found.frequency[0] < 100.0 / (2 * math.pi) < found.frequency[-1]


def test_a_frame_that_floats_is_rigid_plus_its_modes() -> None:
    """Its links have a millionth of their mass; measured 1.9e-6 of the largest."""
    tree = bent(180.0, 500.0).model_dump() | {"supports": ()}
    tree["links"] = {
        name: link if name == "frame" else {**link, "mass": 1e-6 * link["mass"], "inertia": 1e-6 * link["inertia"]}
        for name, link in tree["links"].items()
    }
    machine = parse_machine(tree)
    found = find_response(machine)
    frame, at = machine.links["frame"], machine.joints[found.point.removeprefix("joint ")].at
    x, y = at[0] - frame.cg[0], at[1] - frame.cg[1]
    mobility = np.diag([1 / frame.mass, 1 / frame.mass, 1 / frame.inertia])  # type: ignore[operator]
    forces = np.array([[1, 0, 0], [0, 1, 0], [-y, x, 1]])  # columns: what fx, fy and a moment there are at the centre
    expected = np.broadcast_to(transform_of(machine) @ mobility @ forces, found.accelerances.shape).astype(complex)
    points, directions = zip(*((sensor.at, sensor.direction) for sensor in machine.sensors), strict=True)
    seen = np.einsum("smk,sk->sm", shapes_at(machine.modes, points), directions)
    for k, mode in enumerate(machine.modes):
        moved = np.array([*mode.displacement_at(at), mode.rotation_at(at)])
        swung = swing(found.frequency / mode.frequency, mode.damping)
        expected = expected - swung[:, None, None] * np.outer(seen[:, k], moved) / mode.mass
    assert np.abs(found.accelerances - expected).max() < 1e-5 * np.abs(expected).max()


def test_stiff_modes_leave_the_response_of_a_rigid_frame() -> None:
    machine = bent(1e5)
    found = find_response(machine)
    low = found.frequency < 200.0
    # Forces at the joint, of which fx and fy have a moment about the centre of gravity.
    at, cg = machine.joints[found.point.removeprefix("joint ")].at, machine.links["frame"].cg
    forces = np.array([[1, 0, 0], [0, 1, 0], [cg[1] - at[1], at[0] - cg[0], 1]])
    expected = accelerances(shipped_machine("slider-crank"), found.frequency[low]) @ forces
    # Measured 1.4e-3: links are held by the drive here, and all of them to the frame where it is decoupled.
    assert np.abs(found.accelerances[low] - expected).max() < 5e-3 * np.abs(expected).max()


def test_undamped_and_overdamped_modes_can_be_drawn() -> None:
    for damping in (0.0, 1.0):
        found = find_response(bent(180.0, damping=damping))
        assert np.isfinite(found.accelerances).all()


def with_response(machine: Machine, lines: Any) -> Machine:
    answers = accelerances(machine, np.maximum(lines, 1.0))
    return parse_machine(machine.model_dump() | {"response": tree_of(machine, lines, answers)})


@pytest.mark.parametrize("first", [0.0, 2.0])
def test_a_measured_response_is_as_in_the_file(first: float) -> None:
    machine = with_response(shipped_machine("slider-crank"), np.array([first, *LINES[1:]]))
    found = find_response(machine)
    assert found.frequency[0] == (first or LINES[1])
    assert found.point == "the centre of gravity of frame"
    np.testing.assert_allclose(found.accelerances, accelerances(machine, found.frequency), rtol=1e-12)


def test_what_has_a_response() -> None:
    rigid, bending = shipped_machine("slider-crank"), bent(180.0)
    assert not rigid.has_response
    assert bending.has_response and with_response(rigid, LINES).has_response
    assert not bending.model_copy(update={"sensors": ()}).has_response
    driven = {"kind": "position", "link": "frame", "direction": [0, 1], "speed": 0.1}
    tree = bending.model_dump() | {"drive": driven, "supports": ()}
    tree["modes"][0]["shape"] = (*tree["modes"][0]["shape"], {"at": bending.links["frame"].cg, "displacement": [0, 1]})
    assert not parse_machine(tree).has_response
