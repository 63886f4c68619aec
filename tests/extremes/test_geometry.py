"""Change points, dead centres and machines that cannot turn; what is refused and with which words.

The angle at which a four-bar stops to close is compared with the law of cosines in tests/solver/test_pose.py.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from extremes.scenes import equal_legs, four_bar
from laws import run, tree_of

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.simulation.simulate import simulate

Method = Literal["adaptive", "gill"]
WORN = {"A": 1e-4}
METHODS = pytest.mark.parametrize("method", ["adaptive", "gill"])


@pytest.mark.long
@METHODS
def test_a_parallelogram_stays_one_through_its_change_points(method: Method) -> None:
    """Twice a turn all links lie on one line, where it could go on as a crossed four-bar: it does not for ten turns."""
    machine = four_bar(0.06, 0.20, 0.06, 0.20, 1.0)
    history, motion = run(machine, {}, duration=2.1, sample_rate=2000, method=method)
    bed, crank, coupler, rocker = motion.displacement[:, :, 2].T
    assert crank[-1] > 62
    # Closures hold to 1e-11 m; near the line an angle follows them a thousand times as much.
    assert np.abs(coupler - bed).max() < 1e-8
    assert np.abs(rocker - crank).max() < 1e-8
    assert np.abs(history.acceleration).max() < 20


@pytest.mark.long
def test_a_slider_passes_its_shaft() -> None:
    """Equal crank and rod: the slider could stay on the shaft for good; it goes on, the rod mirrors the crank."""
    tree = equal_legs()
    tree["drive"]["speed"] = 61.7
    _, motion = run(parse_machine(tree), {}, duration=1.0, sample_rate=2000)
    bed, crank, rod, _ = motion.displacement[:, :, 2].T
    assert crank[-1] > 61
    assert np.abs((rod - bed) + (crank - bed)).max() < 1e-8


@pytest.mark.long
def test_fixed_steps_that_meet_a_change_point_exactly_say_so() -> None:
    """At 600 rpm samples hit 90 and 270 degrees to the last bits, and the equations have no solution there.

    Rounding decides at which: moved by 1 to 20 units in its last place, the speed ends all runs at 90 degrees.
    """
    history = simulate(parse_machine(equal_legs()), Case(), Settings(duration=0.2, sample_rate=2000, method="gill"))
    assert history.status in (Status.OK, Status.DIVERGED)
    assert np.isfinite(history.acceleration).all()
    if history.status is Status.DIVERGED:
        met = next(moment for moment in (0.025, 0.075, 0.125, 0.175) if moment > history.t[-1])
        assert history.t[-1] == pytest.approx(met, abs=1e-3)
        assert f"left all bounds at {met} s" in history.message


def driven_slide() -> Machine:
    tree = tree_of("slider-crank")
    tree["drive"] = {"kind": "translation", "joint": "G1", "speed": 0.1}
    return parse_machine(tree)


@METHODS
@pytest.mark.parametrize(
    ("machine", "fault", "line"),
    [
        (four_bar(0.06, 0.10, 0.08, 0.20, 0.5), {}, "joints.B: cannot be assembled at a drive angle of 33.5 deg"),
        # Also where a joint has clearance: what cannot be assembled with closed joints is no machine.
        (four_bar(0.06, 0.10, 0.08, 0.20, 0.5), WORN, "joints.A: cannot be assembled at a drive angle of 33.5 deg"),
        (four_bar(0.06, 0.20, 0.06, 0.20, 0.0), {}, "joints.B: holds as drawn only what other joints hold already"),
        (driven_slide(), {}, "joints.G1: cannot be driven from the drawn pose, a dead centre"),
        (driven_slide(), WORN, "drive: velocities contradict the joints and the drive by 0.1"),
    ],
)
def test_geometry_that_is_refused(machine: Machine, fault: dict[str, float], line: str, method: Method) -> None:
    history = simulate(machine, Case(Fault(fault)), Settings(duration=0.1, method=method))
    assert history.status is Status.CANNOT_ASSEMBLE
    assert history.message.startswith(f"{machine.name}: {line}")
    assert len(history.t) == 0


@pytest.mark.parametrize(
    ("path", "value", "rule"),
    [
        ("links.slider.mass", 0, "must be greater than 0"),
        ("links.slider.mass", -1, "must be greater than 0"),
        ("links.rod.inertia", 0, "must be greater than 0"),
        ("links.rod.mass", float("nan"), "must be finite"),
        ("joints.B.contact.stiffness", 0, "must be greater than 0"),
        ("joints.B.contact.damping", -1, "must not be less than 0"),
        ("joints.B.contact.friction", -0.1, "must not be less than 0"),
        ("joints.B.contact.friction_velocity", 0, "must be greater than 0"),
        ("drive.speed", float("inf"), "must be finite"),
    ],
)
def test_numbers_that_are_refused(path: str, value: float, rule: str) -> None:
    tree: Any = tree_of("slider-crank")
    *parents, last = path.split(".")
    part = tree
    for key in parents:
        part = part[key]
    part[last] = value
    with pytest.raises(MachineError) as refusal:
        parse_machine(tree, "m.yaml")
    assert str(refusal.value) == f"m.yaml: {path}: {value:g}: {rule}"


@pytest.mark.long
def test_a_worn_machine_starts_from_a_change_point() -> None:
    """Nothing is redundant once a pin has clearance: the reactions there follow from where it is."""
    run(four_bar(0.06, 0.20, 0.06, 0.20, 0.0), WORN, duration=0.5, sample_rate=2000)
