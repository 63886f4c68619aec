"""Implicit steps: order, agreement with explicit ones, limits of what is stiff, and when they are taken."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from fuzz.scalar_block import HEAD, ScalarBlock
from fuzz.uncompiled import uncompiled
from laws import Array, Tree, run, tree_of

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.remarks import find_remarks
from jointplay.solver.integrators import rosenbrock
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate


def rubbing(law: dict[str, Any]) -> Machine:
    """The slider-crank, pins and guide with friction of a law."""
    tree = tree_of("slider-crank")
    for joint in tree["joints"].values():
        if joint["kind"] == "turning":
            joint["contact"] = {"stiffness": 1e7, "damping": 300.0, "friction": 0.1} | law
        else:
            joint.pop("friction_velocity")
            joint |= {"friction": 0.1} | law
    return parse_machine(tree)


def guided() -> Machine:
    tree = tree_of("slider-crank")
    tree["joints"]["G1"] |= {"length": 0.06, "height": 0.03, "contact": tree["joints"]["B"]["contact"]}
    return parse_machine(tree)


def hertzian() -> Machine:
    tree = tree_of("slider-crank")
    for name in ("O", "A", "B"):
        law = {"law": "lankarani-nikravesh", "restitution": 0.8, "exponent": 1.5, "stiffness": 1e9, "friction": 0.05}
        tree["joints"][name]["contact"] = law
    return parse_machine(tree)


# Order ----------------------------------------------------------------------------------------------------------------


def test_the_method_is_of_fourth_order() -> None:
    """Slope of the error over the mean step: 4; over the tolerance: 1. Smooth motion."""
    machine = shipped_machine("quick-return")
    exact, _ = run(machine, {}, duration=0.2, sample_rate=100, step=1e-5)
    steps, errors = [], []
    tolerances = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
    for rtol in tolerances:
        history, _ = run(machine, {}, duration=0.2, sample_rate=100, rtol=rtol, method="rosenbrock")
        steps.append(history.step)
        errors.append(np.abs(history.displacement - exact.displacement).max())
    # Measured: 3.96 to 4.11, and 0.98 to 1.01.
    assert np.diff(np.log(errors)) / np.diff(np.log(steps)) == pytest.approx([4.0] * 4, abs=0.3)
    assert np.diff(np.log(errors)) / np.diff(np.log(tolerances)) == pytest.approx([1.0] * 4, abs=0.1)


def test_the_method_is_l_stable() -> None:
    """On y' = s y a step multiplies by R(s h), of which neither it nor the embedded one leaves anything for large s."""

    def factor(z: float, stages: int) -> float:
        found: list[float] = []
        for i in range(stages):
            here = 1 + sum(a * k for a, k in zip(rosenbrock._STAGES[i], found, strict=False))
            back = sum(c * k for c, k in zip(rosenbrock._COUPLING[i], found, strict=False))
            found.append((z * here + back) / (1 / rosenbrock._GAMMA - z))
        return 1 + sum(a * k for a, k in zip((*rosenbrock._STAGES[stages - 1], 1.0), found, strict=True))

    for stages, order in ((6, 4), (5, 3)):
        # The residue of exp(z) falls with z^(order + 1); 1e-3 times its coefficient is far above rounding.
        residues = [abs(factor(-z, stages) - np.exp(-z)) for z in (0.04, 0.02)]
        assert np.log2(residues[0] / residues[1]) == pytest.approx(order + 1, abs=0.15)
        assert abs(factor(-1e8, stages)) < 1e-6
        assert max(abs(factor(-z, stages)) for z in np.logspace(-3, 6, 200)) < 1


def test_pivots_are_chosen() -> None:
    """Matrices that elimination in their own order would spoil: zeros and next to nothing on the diagonal."""
    generator = np.random.default_rng(3)
    for size in (2, 3, 5, 8):
        for _ in range(20):
            matrix = generator.normal(size=(size, size))
            matrix[range(size), range(size)] *= generator.choice([0.0, 1e-14, 1.0], size)
            right = generator.normal(size=size)
            block = ScalarBlock()
            factors = rosenbrock._Factors(block, [[block.constant(x) for x in row] for row in matrix])
            for i, name in enumerate(factors.solve([block.constant(x) for x in right])):
                block.store(i, name)
            space: dict[str, Any] = {}
            exec(HEAD + block.function("solve"), space)
            found = [0.0] * size
            space["solve"](found)
            residue = np.abs(matrix @ found - right).max()
            assert residue < 1e-13 * np.linalg.cond(matrix) * (1 + np.abs(found).max())


# Agreement with explicit steps ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    # What is measured at 1e-9, m/s, of 0.1 m/s and less: `rosenbrock` and, beside it, `adaptive`.
    ("machine", "fault", "limit"), [
        (shipped_machine("slider-crank"), {}, 3e-9),
        (shipped_machine("slider-crank"), {"B": 2e-4}, 1e-8),  # 1.0e-9; 1.4e-8
        (shipped_machine("quick-return"), {"F": 2e-4}, 2e-8),  # 4.8e-9; 3.9e-9
        (shipped_machine("four-bar"), {"A": 1e-4}, 1e-8),  # 1.4e-9; 6e-10
        (guided(), {"G1": 1e-4, "B": 1e-4}, 3e-7),  # 6e-8; 8e-8
        (hertzian(), {"B": 2e-4}, 3e-8),  # 4e-9; 2e-8
        (rubbing({"friction_velocity": 0.001}), {"B": 2e-4}, 1e-6),
        # Bristles hold and slip at instants that are met to a hundredth of their strength, whatever the tolerance.
        (rubbing({"presliding": 3e-8}), {}, 1e-6),
        (rubbing({"presliding": 3e-8}), {"B": 2e-4}, 1e-5),  # 4e-7; 5e-7
    ],
)  # fmt: skip
def test_ordinary_scenes_move_as_with_explicit_steps(machine: Machine, fault: dict[str, float], limit: float) -> None:
    settings = {"duration": 0.03, "sample_rate": 5000}
    exact, _ = run(machine, fault, rtol=1e-11, **settings)
    implicit, _ = run(machine, fault, rtol=1e-9, method="rosenbrock", **settings)
    assert np.abs(implicit.velocity - exact.velocity).max() < limit
    assert implicit.message == exact.message


def test_the_printed_step_is_that_of_plain_python() -> None:
    machine = shipped_machine("slider-crank")
    case = Case(Fault({"B": 2e-4}))
    settings = Settings(duration=0.005, sample_rate=5000, method="rosenbrock")
    compiled = simulate(machine, case, settings)
    with uncompiled(100_000):
        plain = simulate(machine, case, settings)
    # Rounding, which impacts enlarge: measured 1.2e-12 with AVX2, of 0.08 m/s.
    assert np.abs(compiled.velocity - plain.velocity).max() < 1e-10
    assert compiled.step == pytest.approx(plain.step, rel=0.02)


# What is stiff --------------------------------------------------------------------------------------------------------


def held(stiffness: float, *motions: str) -> Array:
    """Motion of a frame that may not turn, on a mount of this stiffness in y; x is sprung."""
    tree = tree_of("slider-crank")
    tree["links"]["frame"]["locked"] = ["theta", *motions]
    mount = {"kind": "mount", "link": "frame", "at": [0, 0], "stiffness": [4e5, stiffness], "damping": [400, 0]}
    tree["supports"] = [mount]
    history = simulate(parse_machine(tree), Case(Fault({"B": 2e-4})), Settings(duration=0.05, sample_rate=5000))
    assert history.status is Status.OK
    assert ("rosenbrock" in history.message) == (stiffness > 1e13)
    return history.displacement


def test_a_stiff_mount_tends_to_a_lock() -> None:
    """The motion goes with one over the stiffness, across the choice of steps; along it the locked frame's."""
    locked = held(0.0, "y")
    sags = []
    for stiffness in (1e11, 1e13, 1e15):
        moved = held(stiffness)
        sags.append(np.abs(moved[:, 1]).max() * stiffness)
        assert np.abs(moved[:, 0] - locked[:, 0]).max() < 2e-8  # measured: 4.5e-9, then 1.3e-9; of 1.4e-3 m
    # Measured: 445 N, 492 N, 313 N. What rings moves up to twice as far as what follows at once.
    assert max(sags) < 2 * min(sags)


def test_an_over_damped_frame_creeps_as_its_forces_want() -> None:
    """A rotor out of balance, 1 kg at 10 mm and 30 Hz, on a frame that only a damper of 1e9 N s/m holds: c y' = F."""
    c, speed = 1e9, 60 * np.pi
    tree: Tree = {
        "name": "unbalance", "gravity": 0.0,
        "links": {
            "bed": {"mass": 40.0, "inertia": 1.0, "cg": [0, 0], "locked": ["x", "theta"]},
            "rotor": {"mass": 1.0, "inertia": 1e-3, "cg": [0.01, 0]},
        },
        "joints": {"O": {"kind": "turning", "links": ["rotor", "bed"], "at": [0, 0]}},
        "drive": {"kind": "rotation", "joint": "O", "speed": speed},
        "supports": [{"kind": "damper", "link": "bed", "at": [0, 0], "anchor": [0, -1], "damping": c}],
    }  # fmt: skip
    history = simulate(parse_machine(tree), None, Settings(duration=0.2, sample_rate=5000))
    assert history.message.endswith(
        "implicit steps (rosenbrock), because of supports.0.damping: 1e+09: a motion that it holds decays at "
        "2.44e+07 1/s"
    )
    force = 0.01 * speed**2 * np.sin(speed * history.t)
    later = history.t > 0.01
    # The frame lags by (M + m) / c = 41 ns: 8e-6 of a radian.
    assert np.abs(history.velocity[later, 1] * c - force[later]).max() < 3e-5 * np.abs(force).max()


def light(factor: float, fault: dict[str, float], **settings: Any) -> History:
    """The slider-crank, without friction, with a rod that is so many times as heavy."""
    tree = tree_of("slider-crank", friction=0.0)
    tree["links"]["rod"]["mass"] *= factor
    tree["links"]["rod"]["inertia"] *= factor
    wanted = Settings(**{"duration": 0.1, "sample_rate": 5000, "links": True} | settings)
    history = simulate(parse_machine(tree), Case(Fault(fault)), wanted)
    assert history.status is Status.OK
    return history


def test_a_link_without_mass_only_pulls_and_pushes() -> None:
    """What presses on its worn end goes through its other pin, and comes out there."""
    history = light(1e-9, {"B": 2e-4})
    assert "links.rod.mass: 2.5e-10" in history.message
    assert history.links is not None
    at_b, at_a = (history.links.reactions[f"force_{name}"] for name in ("B_on_pin", "A"))
    pressed = np.hypot(*at_b.T) > 1.0
    assert np.count_nonzero(pressed) > 100
    angle = history.links.displacement[:, history.links.links.index("rod"), 2]
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    crosswise = np.abs(along[:, 0] * at_b[:, 1] - along[:, 1] * at_b[:, 0]) / np.maximum(np.hypot(*at_b.T), 1.0)
    # Measured: 2.9e-5 (the angle of an eccentricity of 0.2 mm that is known to 6 nm), and 1.6e-6.
    assert np.median(crosswise[pressed]) < 3e-4
    assert np.median(np.abs(at_a + at_b)[pressed]) < 1e-5 * np.abs(at_b).max()


def test_ever_lighter_links_tend_to_one_without_mass() -> None:
    """Distance of the frame's motion from that with the lightest falls with the mass, across the choice of steps.

    Measured: 3.2, 0.55, 0.14, 0.034 um, with its root or faster.
    """
    lightest = light(1e-9, {"B": 2e-4})
    distances, told = [], []
    for factor in (1e-2, 1e-3, 1e-4, 1e-5):
        history = light(factor, {"B": 2e-4}, rtol=1e-8)
        distances.append(np.abs(history.displacement - lightest.displacement).max())
        told.append("rosenbrock" in history.message)
    assert told == [False, False, True, True]
    assert all(fine < 0.5 * coarse for coarse, fine in itertools.pairwise(distances))


# When they are taken --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["four-bar", "quick-return", "slider-crank"])
def test_machines_that_ship_keep_explicit_steps(name: str) -> None:
    machine = shipped_machine(name)
    faults = [{}, *({joint: 2e-4} for joint in machine.turning_joints)]
    for group in groups(machine, [Case(Fault(fault)) for fault in faults], Settings()):
        assert [case.implicit for case in group.ready] == [None] * len(group.ready)


def test_who_asks_for_a_method_gets_it() -> None:
    machine = parse_machine(tree_of("slider-crank", damping=1e6))
    case, settings = Case(Fault({"B": 2e-4})), {"duration": 0.01, "sample_rate": 5000}
    told = [simulate(machine, case, Settings(method=m, **settings)).message for m in (None, "adaptive", "rosenbrock")]
    assert told[1:] == ["", ""]
    assert told[0] == (
        "implicit steps (rosenbrock), because of joints.B.contact.damping: 1e+06: damps an effective mass of "
        "0.0863 kg at 1.16e+07 1/s"
    )


def test_a_run_that_fails_names_the_part() -> None:
    tree = tree_of("slider-crank")
    mount = {"kind": "mount", "link": "slider", "at": [0.2, 0.05], "stiffness": [1e22, 0]}
    tree["supports"].append(mount)
    history = simulate(parse_machine(tree), {"B": 2e-4}, Settings(duration=0.3, most_trials=20_000))
    assert history.status is Status.STEP_TOO_SMALL
    assert "s with implicit steps (rosenbrock), because of supports.2.stiffness.0: 1e+22: a motion" in history.message


def test_check_says_beforehand_that_steps_are_implicit() -> None:
    machine = parse_machine(tree_of("slider-crank", damping=1e6))
    assert not any("implicit" in line for line in find_remarks(machine))
    told = [line for line in find_remarks(machine, Fault({"B": 2e-4})) if "implicit" in line]
    assert told == [
        "joints.B.contact.damping: 1e+06: damps an effective mass of 0.0863 kg at 1.16e+07 1/s: steps are implicit: "
        "the model stays whole, their error is the tolerance's (less than 0.1 dB of a harmonic, as measured where "
        "motions repeat); `--method adaptive` keeps explicit ones"
    ]
