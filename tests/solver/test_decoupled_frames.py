"""Machines on a frame at rest, which moves by what they do to it: closed forms, balances, the limit, refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.decoupling import decoupling_of
from jointplay.solver.cases.preparation import model_of
from jointplay.solver.cases.steps import suspension_of
from jointplay.solver.equations.decoupled import hold_frame
from jointplay.solver.equations.links import LinkMotion, link_motion
from jointplay.solver.equations.model import build_model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.integrators.kernel import kernel_code
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.machines.parts import Damper, Mount, RotationDrive, Spring
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.ensemble import Ensemble, simulate_ensemble
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.simulation.tradeoff import measure

SPEED = 100.0
ROTOR: dict[str, Any] = {
    "name": "rotor",
    "frame": "bed",
    "links": {
        "bed": {"mass": 12.0, "inertia": 0.4, "cg": [0.02, -0.03]},
        "rotor": {"mass": 1.5, "inertia": 2e-3, "cg": [0.11, 0.04]},
    },
    "joints": {"O": {"kind": "turning", "links": ["rotor", "bed"], "at": [0.1, 0.04], "pin_radius": 0.01}},
    "drive": {"kind": "rotation", "joint": "O", "speed": SPEED},
    "supports": [
        {"kind": "mount", "link": "bed", "at": [-0.2, -0.1], "stiffness": [8e4, 1.2e5], "damping": [300, 500]},
        {"kind": "mount", "link": "bed", "at": [0.25, -0.1], "stiffness": [9e4, 1.4e5], "damping": [350, 400]},
    ],
    "sensors": [{"name": "s", "at": [0.2, 0], "direction": [0, 1]}],
}


def decoupled(machine: Machine) -> Machine:
    return machine.model_copy(update={"decoupled": True})


def heavier(machine: Machine, factor: float) -> Machine:
    """The same machine with a frame so many times as heavy on supports so many times as stiff."""
    frame = machine.links[machine.frame]
    assert frame.mass is not None and frame.inertia is not None
    frame = frame.model_copy(update={"mass": factor * frame.mass, "inertia": factor * frame.inertia})
    supports = []
    for support in machine.supports:
        numbers = {key: getattr(support, key) for key in ("stiffness", "damping") if hasattr(support, key)}
        scaled = {key: tuple(factor * np.array(value)) for key, value in numbers.items()}
        supports.append(support.model_copy(update=scaled))
    return machine.model_copy(update={"links": {**machine.links, machine.frame: frame}, "supports": tuple(supports)})


def crowded() -> Machine:
    """The slider-crank with everything that is external: springs and mounts of moving links, loads of all kinds."""
    tree: Any = shipped_machine("slider-crank").model_dump()
    tree["supports"] = [
        *tree["supports"],
        {"kind": "spring", "link": "slider", "at": [0.22, 0.05], "anchor": [0.5, 0.1], "stiffness": 900.0},
        {"kind": "damper", "link": "rod", "at": [0.1, 0.05], "anchor": [0.1, 0.4], "damping": 4.0},
        {"kind": "mount", "link": "rod", "at": [0.1, 0.05], "stiffness": [50.0, 70.0], "damping": [1.0, 2.0]},
        {"kind": "spring", "link": "slider", "at": [0.2, 0.05], "anchor": [0.0, 0.1], "stiffness": 400.0,
         "to_link": "frame"},
    ]  # fmt: skip
    tree["loads"] = [
        {"link": "slider", "at": [0.2, 0.06], "over_angle": [[0, 0, 0, 0], [1, -80, 5, 0.3], [3, 0, 0, 0]]},
        {"link": "frame", "at": [0.1, 0.1], "force": [3, -7], "torque": 0.4},
        {"link": "rod", "at": [0.1, 0.07], "over_time": [[0, 0, 0, 0], [0.1, 4, -3, 0.2]]},
    ]
    tree["joints"]["G1"]["friction"] = 0.1
    return parse_machine(tree)


def test_a_rotor_drives_an_oscillator() -> None:
    """w = m r W^2 at the rotor's angle through three coupled oscillators, weightless: measured 3e-8 beside it."""
    machine = parse_machine(ROTOR | {"decoupled": True, "gravity": 0.0})
    history = simulate(machine, HEALTHY, Settings(duration=2.0, rtol=1e-10))
    links = machine.links
    arm = complex(0.1 - 0.02, 0.04 + 0.03)  # from the frame's centre of gravity to the bearing
    mass, inertia, own = links["rotor"].mass, links["rotor"].inertia, 0.01
    assert mass is not None and inertia is not None
    centre = arm + own
    rigid = np.array([[1, 0, -centre.imag], [0, 1, centre.real]])
    total = mass * rigid.T @ rigid + np.diag([12.0, 12.0, 0.4 + inertia])
    stiffness, damping = np.zeros((3, 3)), np.zeros((3, 3))
    for support in ROTOR["supports"]:
        x, y = np.array(support["at"]) - [0.02, -0.03]
        rows = np.array([[1, 0, -y], [0, 1, x]])
        stiffness += rows.T @ np.diag(support["stiffness"]) @ rows
        damping += rows.T @ np.diag(support["damping"]) @ rows
    # exp(i W t) times these: the centrifugal force at the bearing.
    force = mass * own * SPEED**2
    phasor = np.array([force, -1j * force, 0], dtype=complex)
    phasor[2] = arm.real * phasor[1] - arm.imag * phasor[0]
    answer = np.linalg.solve(stiffness + 1j * SPEED * damping - SPEED**2 * total, phasor)
    steady = history.t > 1.5
    wave = np.exp(1j * SPEED * history.t[steady])
    wanted = (-(SPEED**2) * answer[None, :] * wave[:, None]).real
    assert np.abs(history.acceleration[steady] - wanted).max() < 1e-7 * np.abs(wanted).max()
    assert "frame decoupled" in history.message


@pytest.mark.parametrize(
    ("name", "worn"),
    [("crowded", {}), ("crowded", {"A": 1e-4, "B": 2e-4}), ("four-bar", {"A": 1e-4}), ("quick-return", {"F": 2e-4})],
)
def test_the_frame_feels_the_rate_of_momentum(name: str, worn: dict[str, float]) -> None:
    """M a + C v + K d is what the links' accelerations leave of the external forces; measured 4e-14 of the largest."""
    machine = decoupled(crowded() if name == "crowded" else shipped_machine(name))
    model = build_model(machine, worn)
    p = model.vector({f"joints.{joint}.clearance": clearance for joint, clearance in worn.items()})
    rng = np.random.default_rng(11)
    t = rng.uniform(0, 0.1, 30)
    z, v = rng.normal(size=(2, len(t), model.size)) * np.array([[[0.02]], [[1.0]]])
    motion = link_motion(model, p, t, z, v)
    found = suspension_of(model, p)
    places = [model.kinematics.names.index(f"{motion}({machine.frame})") for motion in found.motions]
    a = np.array([evaluate(model.right_hand_side, *state, p)[0][:, 0] for state in zip(t, z, v, strict=True)])
    wrench = a[:, places] @ found.mass.T
    for part, gradient in zip((z, v), found.gradients, strict=True):
        wrench -= part[:, places] @ gradient.T
    centre, expected = np.array(machine.links[machine.frame].cg), np.zeros_like(wrench)
    placed = {name: k for k, name in enumerate(motion.links)}
    at = {name: np.array(link.cg) + motion.displacement[:, placed[name], :2]
          for name, link in machine.links.items()}  # fmt: skip
    at[machine.frame] = np.tile(centre, (len(t), 1))  # it is at rest for all others

    def cross(point: Any, force: Any) -> Any:
        arm = point - centre
        return arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]

    for link, k in placed.items():
        mass, inertia = machine.links[link].mass, machine.links[link].inertia
        assert mass is not None and inertia is not None
        acceleration = motion.acceleration[:, k] * (link != machine.frame)
        push = mass * (np.array([0, -machine.gravity]) - acceleration[:, :2])
        expected[:, :2] += push
        expected[:, 2] += cross(at[link], push) - inertia * acceleration[:, 2]
    for point, force, torque in external(machine, motion, t, placed, at):
        expected[:, :2] += force
        expected[:, 2] += cross(point, force) + torque
    # But for a constant: supports are linearised where the machine stands, not as drawn.
    assert np.ptp(wrench - expected, axis=0) == pytest.approx(0, abs=1e-11 * np.abs(expected).max())


def external(machine: Machine, motion: LinkMotion, t: Any, placed: dict[str, int], at: dict[str, Any]) -> Any:
    """Forces of loads and of supports of moving links: point, force, torque over time."""

    def point(link: str, drawn: Any) -> tuple[Any, Any]:
        angle = motion.displacement[:, placed[link], 2] * (link != machine.frame)
        omega = motion.velocity[:, placed[link], 2] * (link != machine.frame)
        x, y = np.array(drawn) - machine.links[link].cg
        arm = np.column_stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)])
        rate = motion.velocity[:, placed[link], :2] * (link != machine.frame)
        return at[link] + arm, rate + omega[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]])

    assert isinstance(machine.drive, RotationDrive)
    turned = machine.drive.speed * t
    for load in machine.loads:
        there, _ = point(load.link, load.at)
        given = np.tile([*load.force, load.torque], (len(t), 1))
        if load.over_time is not None:
            table = np.array(load.over_time)
            given = np.column_stack([np.interp(t, table[:, 0], table[:, k]) for k in (1, 2, 3)])
        if load.over_angle is not None:
            table = np.array(load.over_angle)
            given = np.column_stack([np.interp(turned, table[:, 0], table[:, k], period=2 * np.pi) for k in (1, 2, 3)])
        yield there, given[:, :2], given[:, 2]
    for support in machine.supports:
        if support.link == machine.frame or support.to_link is not None:
            continue
        there, rate = point(support.link, support.at)
        if isinstance(support, Mount):
            yield there, -(there - support.at) * support.stiffness - rate * support.damping, 0.0
            continue
        line = there - support.anchor
        length = np.linalg.norm(line, axis=1, keepdims=True)
        if isinstance(support, Spring):
            assert support.free_length is not None
            tension = support.stiffness * (length - support.free_length)
        else:
            assert isinstance(support, Damper)
            tension = support.damping * (line * rate).sum(axis=1, keepdims=True) / length
        yield there, -tension * line / length, 0.0


def test_other_coordinates_are_those_on_a_frame_at_rest() -> None:
    machine = crowded()
    whole, alone = build_model(machine, ("B",)), build_model(decoupled(machine), ("B",))
    held = build_model(hold_frame(machine), ("B",))
    assert alone.kinematics.names == whole.kinematics.names  # so that starts and ends of runs fit both
    rng = np.random.default_rng(3)
    z, v = rng.normal(scale=0.01, size=(2, alone.size))
    places = [alone.kinematics.names.index(name) for name in held.kinematics.names]
    p = alone.vector({"joints.B.clearance": 1e-4})
    (ours,) = evaluate(alone.right_hand_side, 0.02, z, v, p)
    (theirs,) = evaluate(held.right_hand_side, 0.02, z[places], v[places], p)
    assert ours[places] == pytest.approx(theirs, rel=1e-12)
    # measured 179 against 308, 258 against 414
    for worn, most in ((), 0.6), (("B",), 0.65):
        codes = [kernel_code(build_model(m, worn)) for m in (decoupled(shipped_machine("slider-crank")), machine)]
        assert codes[0].operations < codes[1].operations
        plain = kernel_code(build_model(shipped_machine("slider-crank"), worn))
        assert codes[0].operations < most * plain.operations


@pytest.mark.parametrize("worn", [{}, {"B": 2e-4}])
def test_it_becomes_the_whole_machine_as_the_frame_grows(worn: dict[str, float]) -> None:
    """What is left out falls with the mass ratio; measured 10.03 and 10.29 times less a decade."""
    errors, estimates = [], []
    for factor in (100.0, 1000.0):
        machine = heavier(shipped_machine("slider-crank"), factor)
        settings = Settings(duration=1.5, rtol=1e-10)
        whole, alone = (simulate(m, worn, settings) for m in (machine, decoupled(machine)))
        late = whole.t > 1.0
        a, b = (history.band_limited_acceleration[late] for history in (whole, alone))
        errors.append(np.sqrt(np.mean((b - a) ** 2, axis=0) / np.mean(a**2, axis=0)).max())
        estimates.append(decoupling_of(machine).amplified)
    assert 9 < errors[0] / errors[1] < 11
    assert estimates[0] / estimates[1] == pytest.approx(10, rel=0.02)


def test_methods_agree() -> None:
    machine = decoupled(shipped_machine("four-bar"))
    settings = Settings(duration=0.02)
    runs = [
        simulate(machine, {"A": 1e-4}, replace(settings, **more))
        for more in ({"rtol": 1e-10}, {"method": "gill", "step": 1e-6}, {"method": "full", "step": 1e-6})
    ]
    for other in runs[1:]:
        assert other.displacement == pytest.approx(runs[0].displacement, abs=1e-4 * np.abs(runs[0].displacement).max())


def test_a_frame_without_end_is_decoupled_by_itself() -> None:
    heavy = heavier(shipped_machine("slider-crank"), 1e8)
    fault, settings = {"B": 2e-4}, Settings(revolutions=1, rtol=1e-11)
    found, whole = simulate(heavy, fault, settings), simulate(heavy, fault, replace(settings, whole=True))
    assert "frame decoupled" in found.message and not whole.message
    late = whole.t >= whole.transient
    scale = np.abs(whole.displacement[late]).max(axis=0)
    assert np.abs(found.displacement - whole.displacement)[late].max() < 1e-4 * scale.max()
    assert not simulate(heavy, fault, Settings(duration=0.01)).message  # the fall onto its springs is part of it
    assert account(heavy, Fault(fault)).decoupled and not account(shipped_machine("slider-crank"), HEALTHY).decoupled
    # What a case changes may not be so heavy; without worn joints nothing more is to be said. Links feel the frame.
    assert not simulate(heavy, Case(parameters={"links.frame.mass": 1e9}), settings).message
    assert not simulate(heavy, Case(parameters={"supports.0.stiffness.0": 1e13}), settings).message
    assert "decoupled" not in simulate(heavy, fault, replace(settings, links=True)).message


@pytest.mark.parametrize("scene", ["two guides", "oil", "locked", "floor"])
def test_scenes_on_a_heavy_frame(scene: str) -> None:
    """After its fall onto the springs, links 1e-5 of it; measured 4.4e-4 of the whole machine's at most."""
    tree: Any = shipped_machine("slider-crank").model_dump()
    if scene == "two guides":
        tree["joints"]["G2"] = {**tree["joints"]["G1"], "at": [0.24, 0.05]}
    elif scene == "oil":
        tree["joints"]["A"] |= {"film": {"viscosity": 0.05, "length": 0.02}}
    elif scene == "floor":
        tree["supports"][0]["motion"] = [{"displacement": [1e-7, 3e-7], "order": 2}]
    else:
        tree["links"]["frame"]["locked"] = ["x"]
    machine = heavier(parse_machine(tree), 1e4)
    settings = Settings(duration=1.5, rtol=1e-9)
    whole, alone = (simulate(m, {"A": 1e-4}, settings).band_limited_acceleration for m in (machine, decoupled(machine)))
    late = slice(len(whole) * 4 // 5, None)
    size = np.sqrt(np.mean(whole[late] ** 2, axis=0))
    assert (np.sqrt(np.mean((alone - whole)[late] ** 2, axis=0)) <= 1e-3 * size).all()


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"links": {**ROTOR["links"], "bed": {"fixed": True}}, "sensors": []}, "bed does not move"),
        ({"links": {**ROTOR["links"], "wall": {"fixed": True}},
          "joints": {**ROTOR["joints"], "W": {"kind": "turning", "links": ["rotor", "wall"], "at": [0.1, 0.04]}}},
         "wall, fixed or locked, holds"),
        ({"supports": ROTOR["supports"][:0]}, "bed is not held by springs in all"),
        ({"modes": [{"frequency": 100, "damping": 0.01, "shape": [
            {"at": at, "displacement": [0, 1]} for at in ([0.1, 0.04], [-0.2, -0.1], [0.25, -0.1], [0.2, 0])]}]},
         "bed has modes"),
        ({"drive": {"kind": "position", "link": "rotor", "direction": [1, 0]}}, "rotor is driven in space"),
    ],
)  # fmt: skip
def test_refused(change: dict[str, Any], rule: str) -> None:
    with pytest.raises(MachineError, match=rf"rotor.*decoupled.*cannot be: {rule}"):
        simulate(parse_machine(ROTOR | change | {"decoupled": True}))


def test_runs_that_differ_by_their_frame_are_refused() -> None:
    machine = decoupled(shipped_machine("slider-crank"))
    with pytest.raises(SettingsError, match=r"kind: perturbation: .* take phase"):
        simulate_ensemble(machine)
    assert simulate_ensemble(machine, ensemble=Ensemble(2, "phase", None), settings=Settings(revolutions=8)).members
    with pytest.raises(SettingsError, match="slider-crank: decoupled: "):
        measure(machine)
    with pytest.raises(SettingsError, match="whole: "):
        simulate(machine, {}, Settings(whole=True, decoupled=True))


def test_a_file_that_says_nothing_of_it_keeps_its_key() -> None:
    machine = shipped_machine("slider-crank")
    assert "decoupled" not in machine.canonical_json()
    assert parse_machine(machine.model_dump() | {"decoupled": False}).content_key == machine.content_key
    assert decoupled(machine).content_key != machine.content_key
    assert model_of(machine, (), ()).kinematics.apart == {}
