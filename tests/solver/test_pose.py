"""Assembly, equilibrium and start velocities; what cannot be is refused by name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.start import start_pose, start_velocity, walk
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import check_assembly, simulate

G = 9.81


def four_bar(coupler: float, rocker: float, **changes: Any) -> Machine:
    """Crank of 60 mm on the origin, rocker on (200, 0) mm, coupler between them; drawn with the crank along x."""
    # Tip of the rocker: the upper point at `coupler` from the crank's tip and `rocker` from its own bearing.
    base = 0.14
    x = 0.06 + (coupler**2 - rocker**2 + base**2) / (2 * base)
    y = math.sqrt(coupler**2 - (x - 0.06) ** 2)
    tree: dict[str, Any] = {
        "name": "four-bar",
        "links": {
            "bed": {"mass": 20, "inertia": 0.5, "cg": [0, 0]},
            "crank": {"mass": 0.3, "inertia": 1e-4, "cg": [0.03, 0]},
            "coupler": {"mass": 0.4, "inertia": 1e-3, "cg": [(0.06 + x) / 2, y / 2]},
            "rocker": {"mass": 0.5, "inertia": 1e-3, "cg": [(0.2 + x) / 2, y / 2]},
        },
        "joints": {
            "O": {"kind": "turning", "links": ["crank", "bed"], "at": [0, 0]},
            "A": {"kind": "turning", "links": ["coupler", "crank"], "at": [0.06, 0]},
            "B": {"kind": "turning", "links": ["coupler", "rocker"], "at": [x, y]},
            "D": {"kind": "turning", "links": ["rocker", "bed"], "at": [0.2, 0]},
        },
        "drive": {"kind": "rotation", "joint": "O", "speed": 30},
        "supports": [
            {"kind": "mount", "link": "bed", "at": [s * 0.2, -0.1], "stiffness": [2e5, 4e5], "damping": [200, 300]}
            for s in (-1, 1)
        ],
    }
    return parse_machine({**tree, **changes}, "four-bar")


@pytest.mark.parametrize("name", ["four-bar", "quick-return", "slider-crank"])
def test_shipped_machines_assemble_all_the_way_round(name: str) -> None:
    check_assembly(shipped_machine(name))


def test_a_machine_that_cannot_turn_is_refused_with_the_angle() -> None:
    """Coupler and rocker reach 0.18 m together; the crank's tip is 0.2 - 0.06 cos to 0.26 m away from D."""
    machine = four_bar(0.10, 0.08)
    with pytest.raises(AssemblyError) as refusal:
        check_assembly(machine)
    # They are stretched where 0.06^2 + 0.2^2 - 2 0.06 0.2 cos a = 0.18^2.
    angle = math.degrees(math.acos((0.06**2 + 0.2**2 - 0.18**2) / (2 * 0.06 * 0.2)))
    line = str(refusal.value)
    assert "\n" not in line
    assert line.startswith("four-bar: joints.")
    assert "cannot be assembled at a drive angle of" in line
    assert float(line.split("angle of ")[1].split(" deg")[0]) == pytest.approx(angle, abs=0.1)


def test_a_case_of_such_a_machine_has_a_status() -> None:
    history = simulate(four_bar(0.10, 0.08), Case(), Settings(duration=0.01))
    assert history.status is Status.CANNOT_ASSEMBLE
    assert "drive angle" in history.message
    assert len(history.t) == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_the_angle_is_that_of_the_drive(direction: int) -> None:
    """Turned backwards, the four-bar of the test above stops at the same angle below zero."""
    with pytest.raises(AssemblyError) as refusal:
        check_assembly(four_bar(0.10, 0.08, drive={"kind": "rotation", "joint": "O", "speed": 30 * direction}))
    angle = float(str(refusal.value).split("angle of ")[1].split(" deg")[0])
    assert angle == pytest.approx(direction * 62.2, abs=0.1)
    # The gap is what stays open a few degrees on, not the tolerance.
    assert float(str(refusal.value).split("stays ")[1].split(" mm")[0]) > 0.1


def test_a_drive_that_slides_too_far_is_refused_with_its_travel() -> None:
    """The rod and the crank reach 200 mm; the slider starts at 120 mm and is to go 120 mm."""
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json")
    height = math.sqrt(0.05**2 - ((0.05**2 - 0.15**2 + 0.12**2) / 0.24) ** 2)
    along = (0.05**2 - 0.15**2 + 0.12**2) / 0.24
    tree["joints"]["A"]["at"] = [along, 0.05 + height]
    tree["joints"]["B"]["at"] = tree["joints"]["G1"]["at"] = [0.12, 0.05]
    tree["drive"] = {
        "kind": "translation", "joint": "G1", "speed": 0.0,
        "harmonics": [{"frequency": 2.0, "amplitude": 0.06, "phase": "-90 deg"}],
    }  # fmt: skip
    model = build_model(parse_machine(tree))
    with pytest.raises(AssemblyError, match="cannot be assembled at a drive travel of") as refusal:
        walk(model, model.vector({}), 0.0)
    assert float(str(refusal.value).split("travel of ")[1].split(" mm")[0]) == pytest.approx(80, abs=0.1)


def test_a_locked_link_is_named_as_such() -> None:
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json")
    tree["links"]["slider"]["locked"] = ["x"]
    with pytest.raises(
        AssemblyError, match=r"^slider-crank: links\.slider\.locked: cannot be assembled at a drive angle"
    ):
        check_assembly(parse_machine(tree))


def test_poses_of_the_walk_close() -> None:
    model = build_model(four_bar(0.2, 0.15), ["B"])
    p = model.vector({})
    for t, z in walk(model, p, 30.0, steps=24):
        gaps = np.asarray(model.constraint(t, z, np.zeros(model.size), p)[0].full())
        assert np.abs(gaps).max() < 1e-11


def test_static_equilibrium_of_the_suspension() -> None:
    """A frame that carries the weight of everything on two equal mounts sinks by weight over stiffness."""
    machine = four_bar(0.2, 0.15, initial={"pose": "equilibrium"}, drive=None)
    machine = machine.model_copy(update={"joints": {}, "links": {"bed": machine.links["bed"]}})
    model = build_model(machine)
    z = start_pose(model, model.vector({}))
    assert z[model.frame_indices[1]] == pytest.approx(-20 * G / 8e5, rel=1e-12)
    assert z[model.frame_indices[0]] == pytest.approx(0, abs=1e-15)


def test_equilibrium_keeps_still() -> None:
    """Started there with the drive standing, nothing moves for a second."""
    machine = four_bar(0.2, 0.15, initial={"pose": "equilibrium"})
    history = simulate(machine, Case(parameters={"drive.speed": 0.0}), Settings(duration=1.0, sample_rate=1000))
    assert history.status is Status.OK
    assert np.abs(history.velocity).max() < 1e-12
    assert np.ptp(history.displacement, axis=0).max() < 1e-12


def test_a_machine_that_cannot_move_is_in_equilibrium() -> None:
    wall = {"name": "wall", "links": {"wall": {"fixed": True}}, "initial": {"pose": "equilibrium"}}
    assert simulate(parse_machine(wall), Case(), Settings(duration=0.01)).status is Status.OK


def test_no_equilibrium_without_supports() -> None:
    machine = four_bar(0.2, 0.15, initial={"pose": "equilibrium"}, supports=[])
    model = build_model(machine)
    with pytest.raises(AssemblyError, match=r"^four-bar: initial\.pose: equilibrium: no static equilibrium"):
        start_pose(model, model.vector({}))


def test_start_velocities_fulfil_drive_and_joints() -> None:
    machine = four_bar(0.2, 0.15)
    model = build_model(machine, ["A"])
    p, z = model.vector({}), np.zeros(model.size)
    v = start_velocity(model, p, z)
    jacobian, drift = (np.asarray(part.full()) for part in model.constraint(0.0, z, v, p)[1:])
    assert np.abs(jacobian @ v + drift[:, 0]).max() < 1e-12
    assert [v[i] for i in model.frame_indices if i is not None] == pytest.approx([0, 0, 0], abs=1e-14)
    link_jacobian, link_drift = (np.asarray(part.full()) for part in model.link_rates(0.0, z, v, p))
    rates = (link_jacobian @ v + link_drift[:, 0]).reshape(-1, 3)
    assert rates[1, 2] == pytest.approx(30.0)  # the crank turns at the drive's speed
    assert rates[1, :2] == pytest.approx([0, 0.9])  # and its centre of gravity is 30 mm out


def test_given_velocities_are_kept() -> None:
    machine = four_bar(0.2, 0.15, drive=None, initial={"velocities": {"crank": {"omega": -1}, "bed": {"omega": 0.5}}})
    model = build_model(machine)
    z = np.zeros(model.size)
    v = start_velocity(model, model.vector({}), z)
    jacobian, drift = (np.asarray(part.full()) for part in model.link_rates(0.0, z, v, model.vector({})))
    rates = (jacobian @ v + drift[:, 0]).reshape(-1, 3)
    assert rates[1, 2] == pytest.approx(-1)
    assert rates[0, 2] == pytest.approx(0.5)


def five_bar() -> Machine:
    """Two cranks on the bed, the left one driven; what the right one does is left open."""
    links = {
        "bed": ([0, 0], 20.0, 0.5), "crank": ([0.02, 0.03], 0.3, 1e-4), "left": ([0.08, 0.12], 0.6, 2e-3),
        "right": ([0.18, 0.12], 0.8, 3e-3), "rocker": ([0.22, 0.04], 0.5, 1e-3),
    }  # fmt: skip
    joints = {
        "O": (["crank", "bed"], [0, 0]), "A": (["left", "crank"], [0.03, 0.05]), "B": (["left", "right"], [0.13, 0.18]),
        "C": (["right", "rocker"], [0.24, 0.08]), "D": (["rocker", "bed"], [0.2, 0]),
    }  # fmt: skip
    return parse_machine(
        {
            "name": "five-bar",
            "links": {name: {"cg": cg, "mass": m, "inertia": i} for name, (cg, m, i) in links.items()},
            "joints": {name: {"kind": "turning", "links": pair, "at": at} for name, (pair, at) in joints.items()},
            "drive": {"kind": "rotation", "joint": "O", "speed": 30},
        },
        "five-bar",
    )


@pytest.mark.parametrize("worn", [[], ["C"], ["O", "A"]])
def test_what_a_drive_leaves_open_starts_with_the_least_motion(worn: list[str]) -> None:
    """Against velocities of all links, with rows for joints, drive and the frame at rest, minimised densely."""
    machine = five_bar()
    names = list(machine.links)
    rows, right = [np.eye(15)[k] for k in range(3)], [0.0, 0.0, 0.0]
    for joint in machine.joints.values():
        for axis in (0, 1):
            row = np.zeros((5, 3))
            for sign, link in zip((1, -1), joint.links, strict=True):
                arm = np.subtract(joint.at, machine.links[link].cg)
                row[names.index(link), axis] = sign
                row[names.index(link), 2] = sign * (-arm[1], arm[0])[axis]
            rows.append(row.ravel())
            right.append(0.0)
    rows.append(np.eye(15)[5] - np.eye(15)[2])
    right.append(30.0)
    inertia = np.ravel([[link.mass or 0, link.mass or 0, link.inertia or 0] for link in machine.links.values()])
    held = np.array(rows)
    system = np.block([[np.diag(inertia), held.T], [held, np.zeros((len(rows), len(rows)))]])
    least = np.linalg.solve(system, np.concatenate([np.zeros(15), right]))[:15]
    model = build_model(machine, worn)
    z = np.zeros(model.size)
    v = start_velocity(model, model.vector({}), z)
    jacobian, drift = (np.asarray(part.full()) for part in model.link_rates(0.0, z, v, model.vector({})))
    rates = jacobian @ v + drift[:, 0]
    assert 0.5 * rates @ (inertia * rates) == pytest.approx(0.5 * least @ (inertia * least), rel=1e-12)
    assert rates == pytest.approx(least, abs=1e-10)  # rad/s and m/s; rounding of a system of condition 1e4 or so


def test_contradicting_velocities_are_refused() -> None:
    machine = four_bar(0.2, 0.15, initial={"velocities": {"crank": {"omega": 31}, "bed": {"omega": 0}}})
    model = build_model(machine)
    with pytest.raises(AssemblyError, match=r"^four-bar: initial: velocities contradict the joints and the drive by"):
        start_velocity(model, model.vector({}), np.zeros(model.size))


@pytest.mark.parametrize("name", ["four-bar", "quick-return", "slider-crank"])
def test_equilibrium_is_that_of_a_machine_whose_drive_stands(name: str) -> None:
    """What turns shakes the frame; where it begins is where it hangs still: measured to the last bit."""
    tree: Any = shipped_machine(name).model_dump() | {"initial": {"pose": "equilibrium"}}
    machine = parse_machine(tree)
    settings = Settings(duration=2e-3, sample_rate=20_000)
    running, standing = (
        simulate(machine, Case(parameters={"drive.speed": speed}), settings).displacement[0] for speed in (60.0, 0.0)
    )
    assert np.abs(running - standing).max() <= 1e-12 * np.abs(standing).max()
