"""Coulomb friction of sliding joints: physics by hand, jamming, locking, and both methods against each other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import states, tree_of
from scipy.integrate import simpson

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import MachineError
from jointplay.solver.integrators import control
from jointplay.solver.integrators.kernel import kernel_code
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.runs import how_it_ended
from jointplay.solver.simulation.simulate import simulate, simulate_batch

G = 9.81
METHODS = ("adaptive", "gill")


def block(friction: float, slope: float, speed: float) -> Machine:
    """A block of 2 kg that starts up (+) or down (-) an incline of a fixed frame."""
    along = [math.cos(slope), math.sin(slope)]
    guide = {"kind": "sliding", "links": ["block", "bed"], "at": [0, 0], "direction": along}
    return parse_machine(
        {
            "name": "block",
            "links": {"bed": {"fixed": True}, "block": {"mass": 2.0, "inertia": 0.01, "cg": [0.1, 0.05]}},
            "joints": {"G": {**guide, "friction": friction, "friction_velocity": 1e-3}},
            "initial": {"velocities": {"block": {"velocity": [speed * along[0], speed * along[1]]}}},
        }
    )


def strut(speed: float, friction: float) -> Machine:
    """A light shoe on a floor, a strut on it at 60 degrees, a heavy block on top between smooth walls."""
    c, s = math.cos(math.pi / 3), math.sin(math.pi / 3)
    floor = {"kind": "sliding", "links": ["shoe", "bed"], "at": [c, 0], "direction": [1, 0], "friction_velocity": 1e-3}
    return parse_machine(
        {
            "name": "strut",
            "links": {
                "bed": {"fixed": True},
                "shoe": {"mass": 0.1, "inertia": 1e-3, "cg": [c, 0]},
                "strut": {"mass": 0.01, "inertia": 1e-3, "cg": [c / 2, s / 2]},
                "weight": {"mass": 10.0, "inertia": 1.0, "cg": [0, s]},
            },
            "joints": {
                "floor": {**floor, "friction": friction},
                "foot": {"kind": "turning", "links": ["strut", "shoe"], "at": [c, 0]},
                "head": {"kind": "turning", "links": ["strut", "weight"], "at": [0, s]},
                "wall": {"kind": "sliding", "links": ["weight", "bed"], "at": [0, s], "direction": [0, 1]},
            },
            "initial": {"velocities": {"shoe": {"velocity": [speed, 0]}}},
        }
    )


def crank(friction: float, **changes: Any) -> Machine:
    """The shipped slider-crank with friction in its guide."""
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json") | changes
    tree["joints"]["G1"] |= {"friction": friction, "friction_velocity": 0.05}
    return parse_machine(tree)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_block_on_an_incline(method: Any, speed: float) -> None:
    """It decelerates with g (sin +- mu cos) up and down; at 1 mm/s of friction velocity tanh is 1 to the last bit."""
    slope, mu = 0.3, 0.2
    history = simulate(block(mu, slope, speed), Case(), Settings(duration=0.1, links=True, method=method))
    assert history.status is Status.OK
    assert history.message == ""
    assert history.links is not None
    expected = -G * (math.sin(slope) + math.copysign(mu * math.cos(slope), speed))
    along = history.links.acceleration[:, 1, 0] / math.cos(slope)
    assert along == pytest.approx(np.full(len(along), expected), rel=1e-9)
    assert history.links.reactions["normal_G"] == pytest.approx(np.full(len(along), 2 * G * math.cos(slope)), rel=1e-9)
    travel = history.links.displacement[-1, 1, 0] / math.cos(slope)
    assert travel == pytest.approx(speed * 0.1 + 0.5 * expected * 0.1**2, rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_block_that_sticks_is_said_to_creep(method: Any) -> None:
    """mu > tan: it creeps at the speed where mu tanh(v / 1 mm/s) = tan, by the law, and the message says so."""
    history = simulate(block(0.5, 0.3, 0.0), Case(), Settings(duration=0.5, links=True, method=method))
    assert history.status is Status.OK
    assert history.links is not None
    creep = 1e-3 * math.atanh(math.tan(0.3) / 0.5)
    # The tolerance of `standard`, 1e-6, of the velocities' scale sqrt(g extent), extent 0.11 m.
    tolerance = 1e-6 * math.sqrt(G * 0.112)
    assert -history.links.velocity[-1, 1, 0] / math.cos(0.3) == pytest.approx(creep, abs=tolerance)
    assert (
        history.message
        == "sliding joint G sticks: what it moves is the creep of the friction law, 0.72 mm/s at the end"
    )


@pytest.mark.parametrize("speed", [0.1, 5.0])
@pytest.mark.parametrize("method", METHODS)
def test_jamming_is_named_with_joint_and_time(method: Any, speed: float) -> None:
    """mu tan 60 > 1: slow, no sign of the normal force is consistent; fast, both are (Painleve)."""
    history = simulate(strut(speed, 1.0), Case(), Settings(duration=0.01, method=method, links=True))
    assert history.status is Status.JAMMED
    assert history.message.startswith("sliding joint floor jammed at 0 s: friction x leverage is 1 x 1.68 at")
    assert len(history.t) == 0
    assert simulate(strut(speed, 0.4), Case(), Settings(duration=0.01, method=method)).status is Status.OK


@pytest.mark.parametrize("method", [*METHODS, "gill-variable", "full"])
def test_jamming_on_the_way(method: Any) -> None:
    """Driven by its crank at 600 rpm the slider starts at a dead centre and jams where the rod is steep enough.

    Fn = L sin(b) with L the rod's force, friction mu Fn against L cos(b): mu tan(b) = 1 with sin(b) = sin(a) / 3; the
    sprung frame gives way a little. The samples before are there, and the neighbour in the lanes runs on.
    """
    settings = Settings(duration=0.05, sample_rate=10_000, method=method)
    friction = "joints.G1.friction"
    fine, bad = simulate_batch(crank(0.1), [Case(parameters={friction: mu}) for mu in (0.1, 3.5)], settings)
    assert fine.status is Status.OK
    assert bad.status is Status.JAMMED
    assert bad.message.startswith("sliding joint G1 jammed at 0.01")
    angle = 20 * math.pi * float(bad.message.split()[5])
    assert math.tan(math.asin(math.sin(angle) / 3)) == pytest.approx(1 / 3.5, rel=0.05)
    assert 0 < len(bad.t) < len(fine.t)
    assert np.isfinite(bad.acceleration).all()
    assert np.array_equal(
        fine.displacement, simulate(crank(0.1), Case(parameters={friction: 0.1}), settings).displacement
    )


def test_a_self_locking_slider_creeps_and_is_named() -> None:
    """The same strut from rest: no force can push the shoe, and the law lets it creep; fixed steps overshoot that."""
    history = simulate(strut(0.0, 1.0), Case(), Settings(duration=0.05, links=True))
    assert history.status is Status.OK
    assert history.links is not None
    assert 0 < history.links.velocity[-1, 1, 0] < 1e-3
    figures = "friction x leverage is 1 x 1.68"
    assert history.message.startswith(f"sliding joint floor locks itself: {figures}; what it moves")
    fixed = simulate(strut(0.0, 1.0), Case(), Settings(duration=0.05, method="gill"))
    assert fixed.status is Status.JAMMED
    assert figures in fixed.message


def test_a_run_that_friction_stops_names_the_joint() -> None:
    """A slider wedged by a friction of 5 behind a worn pin: steps shrink without end, whatever the tolerance."""
    tree = tree_of("slider-crank")
    tree["joints"]["G1"]["friction"] = 5.0
    machine, case = parse_machine(tree), Case(Fault({"B": 2e-4}))
    group = next(groups(machine, [case], Settings()))
    model, ready = group.model, group.ready[0]
    wedged = simulate(machine, case, Settings(duration=0.02, accuracy="draft")).end
    assert wedged is not None
    final = np.concatenate([[wedged.t], wedged.z, wedged.v])
    for outcome, status in ((control.STALLED, Status.STEP_TOO_SMALL), (control.DIVERGING, Status.DIVERGED)):
        found, message = how_it_ended(model, ready, outcome, final, wedged.t)
        assert found is status
        assert "sliding joint G1 is held by a friction of 5: pressed by 7" in message
        assert message.endswith("lower the friction, or raise the friction velocity")
    final[-1] = np.nan  # nothing can be said of friction there
    assert "sliding joint" not in how_it_ended(model, ready, control.DIVERGING, final, wedged.t)[1]


def work_of_friction(machine: Machine, fault: Fault, method: Any) -> tuple[History, np.ndarray, np.ndarray]:
    """History, and the power of friction and of the drive at its samples, W."""
    settings = Settings(duration=0.2, sample_rate=40_000, method=method, accuracy="reference", links=True)
    history = simulate(machine, Case(fault), settings)
    assert history.status is Status.OK
    motion = history.links
    assert motion is not None
    frame, turning, slider = (motion.links.index(name) for name in ("frame", "crank", "slider"))
    theta = motion.displacement[:, frame, 2]
    along = np.column_stack([np.cos(theta), np.sin(theta)])
    gap = motion.displacement[:, slider, :2] - motion.displacement[:, frame, :2] + np.array([0.2, 0.05])
    drift = motion.velocity[:, slider, :2] - motion.velocity[:, frame, :2]
    omega = motion.velocity[:, frame, 2]
    rate = (along * drift).sum(axis=1) + omega * (along[:, 0] * gap[:, 1] - along[:, 1] * gap[:, 0])
    joint = machine.joints["G1"]
    friction = -joint.friction * np.abs(motion.reactions["normal_G1"]) * np.tanh(rate / joint.friction_velocity) * rate
    drive = motion.reactions["drive_effort"] * (motion.velocity[:, turning, 2] - omega)
    return history, friction, drive


@pytest.mark.parametrize("method", METHODS)
def test_energy_goes_where_friction_takes_it(method: Any) -> None:
    """Kinetic energy, weight and springs change by the work of drive and friction; the normal force changes sign."""
    machine = crank(0.3)
    bare = [{**support.model_dump(mode="json"), "damping": [0.0, 0.0]} for support in machine.supports]
    machine = crank(0.3, supports=bare)
    history, friction, drive = work_of_friction(machine, HEALTHY, method)
    assert history.links is not None
    normal = history.links.reactions["normal_G1"]
    assert normal.min() < 0 < normal.max()
    energy = np.array([state.energy({}) for state in states(machine, history.links)])
    # Measured: 9e-8 of the work of friction (dense output of the adaptive method), 5e-13 with fixed steps.
    work, lost = (float(simpson(power, x=history.t)) for power in (drive + friction, friction))
    assert lost < -1.0
    assert energy[-1] - energy[0] == pytest.approx(work, abs=1e-6 * abs(lost))


def test_both_methods_agree_beside_a_worn_joint() -> None:
    machine, fault = crank(0.3), Fault({"A": 1e-4})
    settings = {"duration": 0.05, "sample_rate": 20_000, "accuracy": "reference"}
    one, other = (simulate(machine, Case(fault), Settings(method=method, **settings)) for method in METHODS)  # type: ignore[arg-type]
    assert one.status is other.status is Status.OK
    # Measured 6e-5; 3e-5 without friction: what fixed steps make of the contact.
    gap = np.abs(one.velocity - other.velocity).max() / np.abs(one.velocity).max()
    assert gap < 2e-4


def test_friction_that_only_a_case_has() -> None:
    """A number that varies rubs as the same number in the file."""
    settings = Settings(duration=0.02, sample_rate=10_000, links=True)
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json")
    tree["joints"]["G1"]["friction_velocity"] = 0.05
    varied = simulate(parse_machine(tree), Case(parameters={"joints.G1.friction": 0.3}), settings)
    filed = simulate(crank(0.3), Case(), settings)
    assert varied.status is filed.status is Status.OK
    assert varied.acceleration == pytest.approx(filed.acceleration, rel=1e-6, abs=1e-9)
    assert varied.links is not None
    assert filed.links is not None
    assert varied.links.reactions["normal_G1"] == pytest.approx(filed.links.reactions["normal_G1"], rel=1e-6, abs=1e-6)


def test_no_friction_costs_nothing() -> None:
    plain = build_model(crank(0.0))
    assert plain.rubbing is None
    assert kernel_code(plain).text == kernel_code(build_model(shipped_machine("slider-crank"))).text
    assert "friction of G1" in [out.what for out in account(crank(0.0), HEALTHY).left_out]
    rubbing = account(crank(0.3), HEALTHY)
    assert "G1.normal" in rubbing.closures
    assert "friction of G1" not in [out.what for out in rubbing.left_out]


def test_equilibrium_knows_no_friction() -> None:
    settings = Settings(duration=0.001)
    start = {"pose": "equilibrium"}
    smooth, rough = (simulate(crank(mu, initial=start), Case(), settings) for mu in (0.0, 0.5))
    assert rough.displacement[0] == pytest.approx(smooth.displacement[0], abs=1e-12)


def test_too_many_rubbing_joints_are_refused() -> None:
    names = [f"b{i}" for i in range(7)]
    guide = {"kind": "sliding", "at": [0, 0], "direction": [1, 0], "friction": 0.1}
    tree = {
        "name": "stack",
        "links": {"bed": {"fixed": True}} | {name: {"mass": 1, "inertia": 1, "cg": [0, 0]} for name in names},
        "joints": {f"G{i}": {**guide, "links": [name, "bed"]} for i, name in enumerate(names)},
    }
    with pytest.raises(MachineError, match=r"joints\.G6\.friction: at most 6 sliding joints"):
        simulate(parse_machine(tree))
