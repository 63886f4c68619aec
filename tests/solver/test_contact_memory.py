"""The velocity that a contact remembers: when it is set, kept and forgotten."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trajectory import Trajectory, trajectories

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.cases.start import Start
from jointplay.solver.equations.contact import SLOWEST_APPROACH
from jointplay.solver.errors import MachineError
from jointplay.solver.integrators.control import remember
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate, simulate_batch

CLEARANCE = 1e-4
#: Pressed in, pulled so fast that the force vanishes (beyond v0 / c = 16 mm/s), pressed in again before the surfaces
#: have parted, then across the clearance to the other side: s and N.
PUSHES = np.array(
    [(0, 12.5), (2e-4, 12.5), (5e-4, 2e3), (1.5e-3, 2e3), (1.51e-3, -2e4), (1.56e-3, -2e4), (1.57e-3, 4e4),
     (1.59e-3, 4e4), (1.6e-3, 2e3), (3e-3, 2e3), (3.1e-3, -2e3), (5e-3, -2e3)]
)  # fmt: skip


def body(pushes: np.ndarray | None = None) -> Machine:
    """1 kg between stops; c of its law is 3.03."""
    contact = {"law": "gonthier", "stiffness": 1e8, "restitution": 0.3, "friction": 0}
    rows = [] if pushes is None else [[float(t), float(force), 0.0, 0.0] for t, force in pushes]
    loads = [{"link": "body", "at": [0, 0], "over_time": rows}] if rows else []
    return parse_machine(
        {
            "name": "body",
            "gravity": 0,
            "links": {"base": {"fixed": True}, "body": {"mass": 1.0, "inertia": 1.0, "cg": [0, 0]}},
            "joints": {"stop": {"kind": "turning", "links": ["body", "base"], "at": [0, 0], "contact": contact}},
            "loads": loads,
        }
    )


def started(machine: Machine, *starts: tuple[float, float], samples: int = 2) -> list[Trajectory]:
    """From places and velocities, steps and samples of 1 us."""
    return trajectories(
        machine, [{"stop": CLEARANCE}], [{"x(body)": start} for start in starts], step=1e-6, samples=samples
    )


def test_it_is_set_once_and_forgotten_when_the_surfaces_part() -> None:
    w = np.array([[0.0], [-1e-6], [0.3]])  # memory, penetration, approach

    def after(penetration: float, approach: float) -> float:
        w[1:, 0] = penetration, approach
        remember(w, 0, 1, 2, 0)
        return float(w[0, 0])

    assert after(-1e-6, 0.3) == 0
    assert after(1e-9, 0.3) == 0.3
    assert after(1e-6, 0.2) == 0.3
    assert after(1e-7, -0.25) == 0.3
    assert after(0.0, -0.25) == 0
    assert after(1e-9, 1e-5) == SLOWEST_APPROACH


def test_a_contact_at_the_start_begins_there() -> None:
    fast, slow, apart = started(body(), (CLEARANCE + 1e-6, 0.2), (CLEARANCE + 1e-6, 0.0), (CLEARANCE / 2, 0.2))
    assert fast.memory[0, 0] == 0.2
    assert slow.memory[0, 0] == SLOWEST_APPROACH
    assert apart.memory[0, 0] == 0


def test_it_stays_where_the_force_vanishes_inside() -> None:
    (run,) = started(body(PUSHES), (CLEARANCE, 0.05), samples=5000)
    x, _ = run.coordinate("x(body)")
    inside, force = np.abs(x) > CLEARANCE, run.motion.reactions["force_stop_on_pin"][:, 0]
    memory = run.memory[:, 0]
    first = slice(1, int(np.flatnonzero(~inside[1:])[0]))
    pressing = np.diff((force[first] < 0).astype(int))
    assert (force[first] == 0).sum() >= 10
    assert np.count_nonzero(pressing > 0) == 1  # pressed in again, before the surfaces have parted
    assert np.ptp(memory[first]) == 0
    assert memory[1] == pytest.approx(0.05, rel=1e-3)
    other = np.flatnonzero(x < -CLEARANCE)
    assert other.size > 10
    assert np.ptp(memory[other[:10]]) == 0
    assert memory[other[0]] > 1
    assert (memory[~inside] == 0).all()


def pushed(**settings: Any) -> History:
    """The same from rest in the middle: 12.5 N make 50 mm/s in 4 ms."""
    start = np.array([(0.0, 12.5)])
    machine = body(np.vstack([start, PUSHES + np.array([4e-3, 0.0])]))
    history = simulate(
        machine, Case(Fault({"stop": CLEARANCE})),
        Settings(duration=8.5e-3, sample_rate=2e5, links=True, **settings),
    )  # fmt: skip
    assert history.status is Status.OK
    assert history.links is not None
    return history


def test_both_methods_remember_alike() -> None:
    """Fixed steps meet the switches to first order: measured 8e-9 m and 1.6e-5 of the largest force at 0.08 us.

    The other method is within 2e-12 m and 4e-8 of its own limit.
    """
    fixed, controlled = pushed(step=1e-7), pushed(rtol=1e-10)
    assert fixed.links is not None
    assert controlled.links is not None
    gap = fixed.links.displacement[:, 1, 0] - controlled.links.displacement[:, 1, 0]
    assert np.abs(gap).max() < 3e-8
    forces = [links.reactions["force_stop_on_pin"][:, 0] for links in (fixed.links, controlled.links)]
    assert np.abs(forces[0] - forces[1]).max() < 1e-4 * np.abs(forces[0]).max()


@pytest.mark.parametrize("settings", [{"rtol": 1e-10}, {"step": 1e-7}], ids=["adaptive", "gill"])
def test_a_run_that_goes_on_in_a_contact_remembers(settings: dict[str, Any]) -> None:
    """Left while pressed in, taken up again: forces as of one run; begun anew they are 67 % off."""
    machine = body(np.vstack([[(0.0, 12.5)], PUSHES + np.array([4e-3, 0.0])]))
    case = Case(Fault({"stop": CLEARANCE}))

    def part(duration: float, start: Start | None) -> History:
        chosen = Settings(duration=duration, sample_rate=2e5, links=True, **settings)
        return simulate_batch(machine, [case], chosen, starts=[start])[0]

    first, whole = part(4.5e-3, None), part(5.5e-3, None)
    assert first.end is not None
    assert first.end.memory == pytest.approx([0.05], rel=1e-3)
    forgetful = replace(first.end, memory=np.zeros(0))
    second, anew = part(8e-4, first.end), part(8e-4, forgetful)
    at = round(first.end.t * 2e5)
    forces = []
    for history in (second, anew, whole):
        assert history.links is not None
        forces.append(history.links.reactions["force_stop_on_pin"][:, 0])
    expected = forces[2][at : at + len(forces[0])]
    gap, lost = (np.abs(force[: len(expected)] - expected).max() / np.abs(expected).max() for force in forces[:2])
    # Measured: error control 1.5e-8, fixed steps nothing.
    assert gap < 2e-7
    assert lost > 0.1


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_lanes_remember_for_themselves(method: Any) -> None:
    """Nine cases, so that one lane is taken by a second case, each as if it were alone."""
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json")
    contact = {"law": "flores", "stiffness": 2e9, "restitution": 0.7}
    for name in "AB":
        tree["joints"][name]["contact"] = contact
    machine, settings = parse_machine(tree), Settings(duration=0.02, method=method, accuracy="draft")
    cases = [
        Case(Fault({"A": 1e-4, "B": 2e-4}), {"contact.restitution": 0.5 + 0.05 * i, "drive.speed": 60.0 + 3 * i})
        for i in range(9)
    ]
    together = simulate_batch(machine, cases, settings)
    for case, history in zip(cases, together, strict=True):
        assert np.array_equal(simulate(machine, case, settings).acceleration, history.acceleration)
    assert len({history.acceleration.tobytes() for history in together}) == 9


def test_exponents_do_not_vary_from_case_to_case() -> None:
    with pytest.raises(MachineError, match="no such number"):
        simulate(body(), Case(Fault({"stop": 1e-4}), {"joints.stop.contact.exponent": 2.0}))
