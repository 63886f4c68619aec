"""Compiled kernels: eight lanes of different states and numbers, against symbols, oracle and Gill's paper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from oracle.closures import lacking
from oracle.dense import solve
from oracle.motion import LinkMotion
from oracle.sketch import random_state

from jointplay.solver.compiler.ir import LANES
from jointplay.solver.equations.model import Model, build_model
from jointplay.solver.integrators.gill import integrate, repeat
from jointplay.solver.integrators.kernel import compile_adaptive, compile_model
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine

#: Vector code and symbols round differently (order of sums, its own sine); as part of the largest acceleration.
#: Measured: 3e-13 to 1.1e-12, most where every contact follows another law; five times that for other processors.
ROUNDING = 5e-12


def loaded(name: str, **more: Any) -> Machine:
    return parse_machine({**shipped_machine(name).model_dump(mode="json"), **more})


#: Contacts that remember, one of each law with a restitution, and exponents with and without a root.
LAWS = {
    "O": {"law": "lankarani-nikravesh", "stiffness": 5e8, "restitution": 0.6},
    "A": {"law": "flores", "stiffness": 1e7, "restitution": 0.5, "exponent": 1.1, "presliding": 1e-5},
    "B": {"law": "hunt-crossley", "stiffness": 2e10, "restitution": 0.7, "exponent": 2, "presliding": 1e-5},
    "D": {"law": "gonthier", "stiffness": 5e8, "restitution": 0.4, "friction_law": "threshold", "friction_velocity": 1},
}


def laws_machine() -> Machine:
    joints: Any = shipped_machine("four-bar").model_dump(mode="json")["joints"]
    for joint, contact in LAWS.items():
        joints[joint]["contact"] = contact
    return loaded("four-bar", joints=joints)


def rubbing_guides() -> Machine:
    joints = shipped_machine("quick-return").model_dump(mode="json")["joints"]
    for name, friction in (("G1", 0.3), ("G2", 0.1)):
        joints[name] |= {"friction": friction, "friction_velocity": 0.05}
    return loaded("quick-return", joints=joints)


def sticking_guides() -> Machine:
    joints: Any = rubbing_guides().model_dump(mode="json")["joints"]
    for name, law in (("G1", {"presliding": 1e-5}), ("G2", {"friction_law": "threshold", "friction_velocity": 1.0})):
        del joints[name]["friction_velocity"]
        joints[name] |= law
    return loaded("quick-return", joints=joints)


def worn_guides(**contact: Any) -> Machine:
    joints: Any = shipped_machine("quick-return").model_dump(mode="json")["joints"]
    joints["G1"] |= {"length": 0.04, "height": 0.03, "friction": 0.3}
    joints["G2"] |= {"length": 0.1, "contact": {**LAWS["B"], **contact}}
    return loaded("quick-return", joints=joints)


def dry_journals(machine: Machine, **friction: float) -> Machine:
    joints: Any = machine.model_dump(mode="json")["joints"]
    for name, value in friction.items():
        joints[name]["journal_friction"] = value
    return loaded(machine.name, joints=joints)


def oiled() -> Machine:
    """Fast and slow films, among them one that is held, with the pin on either link."""
    joints: Any = shipped_machine("four-bar").model_dump(mode="json")["joints"]
    for name, viscosity in (("A", 1e-3), ("B", 0.05), ("D", 10.0)):
        joints[name] |= {"pin_radius": 0.01, "film": {"viscosity": viscosity, "length": 0.02, "roughness": 5e-5}}
    return loaded("four-bar", joints=joints)


SWING = {"frequency": 4.0, "amplitude": -0.02}
SHAKEN = [
    {"displacement": [1e-4, 2e-4], "frequency": 12.0, "phase": 0.4},
    {"over_time": [[0.0, 0, 0], [0.011, 1e-3, 0], [0.02, 0, 2e-3]]},
]
CUTTING = [[0.0, 0.0, 0.0, 0.0], [1.2, -800.0, 20.0, 3.0], [3.1, 0.0, 0.0, 0.0]]
SCENES = {
    "quick-return, two worn joints, ripple, cutting force": (
        loaded(
            "quick-return",
            drive={"kind": "rotation", "joint": "O", "speed": 12.6, "ripple": [{"order": 2, "amplitude": 0.01}]},
            loads=[{"link": "ram", "at": [0.1, 0.28], "over_angle": CUTTING}],
        ),
        ("A", "F"),
        ("links.ram.mass", "supports.1.stiffness.1", "gravity", "drive.ripple.0.amplitude"),
    ),
    "slider-crank under a motor's torque": (
        loaded("slider-crank", drive={"kind": "torque", "joint": "O", "curve": [[0.0, 5.0], [20.0, -5.0]]}),
        ("A",),
        ("links.crank.inertia",),
    ),
    "quick-return driven by its ram": (
        loaded(
            "quick-return",
            drive={"kind": "translation", "joint": "G2", "harmonics": [{"frequency": 4.0, "amplitude": -0.02}]},
        ),
        ("E",),
        ("links.frame.mass",),
    ),
    "quick-return run up, with ripple": (
        loaded(
            "quick-return",
            drive={
                "kind": "rotation",
                "joint": "O",
                "speed": [[0.005, 2.0], [0.012, 14.0], [0.02, 9.0]],
                "ripple": [{"order": 2, "amplitude": 0.01}],
            },
            loads=[{"link": "ram", "at": [0.1, 0.28], "over_time": CUTTING}],
        ),
        ("C",),
        (),
    ),
    "four-bar, every contact law": (laws_machine(), tuple(LAWS), ()),
    "quick-return, both guides rub": (
        rubbing_guides(),
        ("A",),
        ("joints.G1.friction", "joints.G2.friction_velocity"),
    ),
    "four-bar, dry journals": (
        dry_journals(shipped_machine("four-bar"), O=0.3, B=0.1, D=1.0),
        ("A",),
        ("joints.B.journal_friction",),
    ),
    "quick-return, a dry journal and guides": (
        dry_journals(rubbing_guides(), C=0.2),
        ("A",),
        ("joints.G1.friction",),
    ),
    "quick-return, a guide sticks": (sticking_guides(), ("A",), ("joints.G1.presliding",)),
    "quick-return, both guides worn": (worn_guides(), ("G1", "G2", "A"), ("links.ram.mass",)),
    "quick-return, a worn guide driven": (
        loaded(
            "quick-return",
            joints=worn_guides().model_dump(mode="json")["joints"],
            drive={"kind": "translation", "joint": "G2", "harmonics": [{"frequency": 4.0, "amplitude": -0.02}]},
        ),
        ("G2",),
        (),
    ),
    "quick-return, its ram driven in space, on ground that moves": (
        loaded(
            "quick-return",
            drive={"kind": "position", "link": "ram", "direction": [1, 0.1], "harmonics": [SWING]},
            supports=[
                {**shipped_machine("quick-return").supports[0].model_dump(), "motion": SHAKEN},
                *shipped_machine("quick-return").supports[1:],
            ],
        ),
        ("C",),
        ("supports.0.motion.0.displacement.1", "drive.harmonics.0.amplitude"),
    ),
    "four-bar, oil": (oiled(), ("A", "B", "D"), ()),
    "four-bar, every joint worn": (shipped_machine("four-bar"), tuple(shipped_machine("four-bar").turning_joints), ()),
}


@pytest.fixture(params=SCENES, ids=lambda name: name.replace(" ", "-"))
def scene(request: pytest.FixtureRequest) -> tuple[Machine, Model]:
    machine, worn, varying = SCENES[request.param]
    return machine, build_model(machine, worn, varying)


def lanes(model: Model) -> list[tuple[dict[str, float], float, np.ndarray, np.ndarray]]:
    """Eight sets of numbers around the file's and eight states."""
    rng = np.random.default_rng(7)
    drawn = []
    for lane in range(LANES):
        values = {path: model.nominal[path] * rng.uniform(0.7, 1.4) for path in model.parameters}
        values |= {path: float(rng.uniform(2e-5, 1e-3)) for path in values if path.endswith(".clearance")}
        state = random_state(model, model.vector(values), lane)
        assert state is not None
        drawn.append((values, *state))
    return drawn


def changed(machine: Machine, values: dict[str, float]) -> tuple[Machine, dict[str, float]]:
    """The machine file with these numbers, and its clearances."""
    tree: Any = machine.model_dump(mode="json")
    clearances = {}
    for path, value in values.items():
        *steps, last = path.split(".")
        if last == "clearance":
            clearances[steps[-1]] = value
            continue
        place = tree
        for step in steps:
            place = place[int(step)] if isinstance(place, list) else place[step]
        place[int(last) if isinstance(place, list) else last] = value
    return parse_machine(tree), clearances


def filled(kernel: Any, model: Model, drawn: list[Any], *, t: float | None = None) -> np.ndarray:
    work, rows = kernel.work_array(), kernel.rows
    for lane, (values, time, z, v) in enumerate(drawn):
        work[rows.time, lane] = time if t is None else t
        for place, column in ((rows.z, z), (rows.v, v), (rows.parameters, model.vector(values))):
            work[place, lane] = column
    return work


def gill(kernel: Any, work: np.ndarray, start: float, h: float, substeps: int, samples: int) -> np.ndarray:
    """Coordinates and velocities, (LANES, 2 n, samples)."""
    record = np.array([*kernel.rows.z, *kernel.rows.v])
    out, finals = np.zeros((LANES, record.size, samples)), np.zeros((LANES, 2 + record.size))
    broken, counts, begins = np.zeros(LANES, dtype=np.int64), np.full(LANES, samples), np.full(LANES, start)
    integrate(kernel.functions, work, kernel.first, begins, h, substeps, record, out, broken, counts, finals)
    return out


def test_lanes(scene: tuple[Machine, Model]) -> None:
    machine, model = scene
    drawn = lanes(model)
    kernel = compile_model(model)
    work = filled(kernel, model, drawn)
    repeat(kernel.functions, work, 1)
    motion = LinkMotion(model)
    for (values, t, z, v), compiled in zip(drawn, work[kernel.rows.a].T, strict=True):
        p = model.vector(values)
        symbols = np.asarray(model.right_hand_side(t, z, v, p)).ravel()
        assert np.abs(compiled - symbols).max() < ROUNDING * np.abs(symbols).max()
        positions, velocities, accelerations = motion(t, z, v, compiled, p)
        other, clearances = changed(machine, values)
        assert lacking(other, clearances, t, positions, velocities) < 1e-12
        solution = solve(other, clearances, t, positions, velocities)
        gap = np.abs(accelerations - solution.accelerations)
        assert gap[:, :2].max() < 1e-10 * solution.scale[0]
        assert gap[:, 2].max() < 1e-10 * solution.scale[1]


def test_memories() -> None:
    """Contacts that began at some velocity, on all lanes; the other half begins now. Bristles are bent, or slip."""
    machine, model = laws_machine(), build_model(laws_machine(), LAWS)
    assert [model.clearance_joints[i] for i in model.remembering] == list(LAWS)
    assert [model.clearance_joints[i] for i in model.bristles.contacts] == ["A", "B"]
    kernel, drawn, rng = compile_model(model), lanes(model), np.random.default_rng(9)
    began = np.exp(rng.uniform(-5, 1, (LANES, len(LAWS))))
    began[::2, ::2], began[1::2, 1::2] = 0.0, 0.0
    bent, slips = rng.uniform(-1, 1, (LANES, 2)), rng.choice([-1.0, 0.0, 0.0, 1.0], (LANES, 2))
    work = filled(kernel, model, drawn)
    work[kernel.rows.memory], work[kernel.rows.bristles], work[kernel.rows.slips] = began.T, bent.T, slips.T
    repeat(kernel.functions, work, 1)
    motion, pressed, sticking = LinkMotion(model), 0, 0
    for lane, (values, t, z, v) in enumerate(drawn):
        compiled = work[kernel.rows.a, lane]
        positions, velocities, accelerations = motion(t, z, v, compiled, model.vector(values))
        other, clearances = changed(machine, values)
        then = dict(zip(LAWS, began[lane], strict=True))
        held = dict(zip("AB", zip(bent[lane], slips[lane], strict=True), strict=True))
        solution = solve(other, clearances, t, positions, velocities, then, held)
        gap = np.abs(accelerations - solution.accelerations)
        assert gap[:, :2].max() < 1e-10 * solution.scale[0]
        assert gap[:, 2].max() < 1e-10 * solution.scale[1]
        pressed += sum(then[joint] > 0 and solution.reactions[joint].any() for joint in LAWS)
        sticking += sum(slips[lane, k] == 0 and solution.reactions["AB"[k]].any() for k in range(2))
    assert pressed >= 5
    assert sticking >= 3


def test_memories_of_corners() -> None:
    """As :func:`test_memories`, of a block that may touch with four corners beside a pin that touches with one."""
    machine, worn = worn_guides(), ("A", "G2")
    model = build_model(machine, worn)
    assert (len(model.contacts), model.remembering, model.bristles.contacts) == (5, (1, 2, 3, 4), [1, 2, 3, 4])
    corners = [f"G2.{k}" for k in range(4)]
    kernel, drawn, rng = compile_model(model), lanes(model), np.random.default_rng(9)
    began = np.exp(rng.uniform(-5, 1, (LANES, 4))) * rng.choice([0.0, 1.0], (LANES, 4))
    bent, slips = rng.uniform(-1, 1, (LANES, 4)), rng.choice([-1.0, 0.0, 0.0, 1.0], (LANES, 4))
    work = filled(kernel, model, drawn)
    work[kernel.rows.memory], work[kernel.rows.bristles], work[kernel.rows.slips] = began.T, bent.T, slips.T
    repeat(kernel.functions, work, 1)
    motion, pressed = LinkMotion(model), 0
    for lane, (values, t, z, v) in enumerate(drawn):
        compiled = work[kernel.rows.a, lane]
        positions, velocities, accelerations = motion(t, z, v, compiled, model.vector(values))
        other, clearances = changed(machine, values)
        then = dict(zip(corners, began[lane], strict=True))
        held = dict(zip(corners, zip(bent[lane], slips[lane], strict=True), strict=True))
        solution = solve(other, clearances, t, positions, velocities, then, held)
        gap = np.abs(accelerations - solution.accelerations)
        assert gap[:, :2].max() < 1e-10 * solution.scale[0]
        assert gap[:, 2].max() < 1e-10 * solution.scale[1]
        pressed += solution.reactions["G2"].any()
    assert pressed >= 4


def test_error_controlled_steps(scene: tuple[Machine, Model]) -> None:
    """Their right-hand side, told which contacts push, and restored closures."""
    machine, model = scene
    kernel, gills = compile_adaptive(model, [1.0] * model.size, ()), compile_model(model)
    rows = kernel.rows
    drawn = lanes(model)
    expected = filled(gills, model, drawn)
    repeat(gills.functions, expected, 1)
    work = filled(kernel, model, drawn)
    repeat(kernel.functions, work, 1)
    work[rows.touching] = work[rows.switch] > 0
    repeat(kernel.functions, work, 1)
    found = work[rows.a].T
    work[rows.z] += 1e-6
    moved = work[rows.z].T
    prepare, _, _, project, *_ = kernel.functions
    if project:
        repeat((prepare, project, 0, 0), work, 1)
    corrected = work[rows.z].T
    motion = LinkMotion(model)
    for lane, ((values, t, z, v), compiled) in enumerate(zip(drawn, expected[gills.rows.a].T, strict=True)):
        p, a = model.vector(values), found[lane]
        assert np.abs(a - compiled).max() < ROUNDING * np.abs(compiled).max()
        positions, velocities, accelerations = motion(t, z, v, a, p)
        other, clearances = changed(machine, values)
        solution = solve(other, clearances, t, positions, velocities)
        gap = np.abs(accelerations - solution.accelerations)
        assert gap[:, :2].max() < 1e-10 * solution.scale[0]
        assert gap[:, 2].max() < 1e-10 * solution.scale[1]
        if project:
            correction = model.projection(t, moved[lane], v, p)[0].full().ravel()
            assert np.abs(corrected[lane] - moved[lane] - correction).max() < 1e-12


def test_restoring_the_closures() -> None:
    """Pushed 1e-5 out of its closures, a lane comes back by Newton steps; lanes keep to themselves."""
    model = build_model(shipped_machine("quick-return"), ("A",))
    kernel = compile_model(model)
    drawn = lanes(model)
    rng = np.random.default_rng(3)
    moved = [(p, t, z + rng.uniform(-1e-5, 1e-5, z.size), v + rng.uniform(-1e-5, 1e-5, v.size)) for p, t, z, v in drawn]
    work = filled(kernel, model, moved, t=0.01)
    out = gill(kernel, work, 0.01, 1e-12, 1, 3)
    closures = model.function("closures", model.phi, model.phi_rate)
    gaps = np.array(  # lane, sample, (places, rates)
        [
            [
                [np.abs(part.full()).max() for part in closures(0.01, *np.split(row, 2), model.vector(values))]
                for row in out[lane].T
            ]
            for lane, (values, _, _, _) in enumerate(moved)
        ]
    )
    assert gaps[:, 0].min() > 1e-9
    assert gaps[:, 0].max() > 1e-6
    assert gaps[:, 1, 0].max() < 1e-9
    # Rates are corrected at the pose before it was corrected itself: the second time settles them too.
    assert gaps[:, 2].max() < 1e-12


def plain_gill(function: Any, y: np.ndarray, t: float, h: float, steps: int) -> np.ndarray:
    """Runge-Kutta-Gill as published: y and q of each stage from k = h f and the q before."""
    r = math.sqrt(0.5)
    q = np.zeros_like(y)
    for step in range(steps):
        start = t + step * h
        k = h * function(start, y)
        y, q = y + 0.5 * (k - 2 * q), q + 1.5 * (k - 2 * q) - 0.5 * k
        k = h * function(start + h / 2, y)
        y, q = y + (1 - r) * (k - q), q + 3 * (1 - r) * (k - q) - (1 - r) * k
        k = h * function(start + h / 2, y)
        y, q = y + (1 + r) * (k - q), q + 3 * (1 + r) * (k - q) - (1 + r) * k
        k = h * function(start + h, y)
        y, q = y + (k - 2 * q) / 6, q + 0.5 * (k - 2 * q) - 0.5 * k
    return y


def test_steps_are_gills() -> None:
    """Ten steps through contact, Gill's correction carried from step to step, as his formulas say in plain NumPy."""
    model = build_model(shipped_machine("four-bar"), tuple(shipped_machine("four-bar").turning_joints))
    assert not model.kinematics.closures  # nothing is projected: the method alone is seen
    kernel = compile_model(model)
    drawn = lanes(model)
    h, steps, start = 1e-5, 10, 0.004
    work = filled(kernel, model, drawn)
    out = gill(kernel, work, start, h, steps, 2)
    for lane, (values, _, z, v) in enumerate(drawn):
        p = model.vector(values)

        def rate(t: float, y: np.ndarray, p: list[float] = p) -> np.ndarray:
            z, v = np.split(y, 2)
            return np.concatenate([v, np.asarray(model.right_hand_side(t, z, v, p)).ravel()])

        expected = plain_gill(rate, np.concatenate([z, v]), start, h, steps)
        moved = np.abs(expected - np.concatenate([z, v])).max()
        assert np.abs(out[lane, :, 1] - expected).max() < 1e-11 * moved
