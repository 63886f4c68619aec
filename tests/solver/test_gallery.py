"""The machines that ship beside the first three: they move, healthy and worn, on mounts as real ones have."""

from __future__ import annotations

import math

import pytest

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.preparation import modes_of_suspension
from jointplay.solver.cases.remarks import find_remarks
from jointplay.solver.machines.course import course_of
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import shipped_machine, shipped_machine_names
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.simulate import simulate

GALLERY = sorted({*shipped_machine_names()} - {"four-bar", "quick-return", "slider-crank"})


@pytest.mark.parametrize("name", GALLERY)
def test_it_turns_all_the_way_and_runs_healthy_and_worn(name: str) -> None:
    machine = shipped_machine(name)
    assert find_remarks(machine) == []  # which follows it all the way round
    assert course_of(machine).widest == ("", 0)
    sizes = account(machine, HEALTHY)
    assert (sizes.freedoms, sizes.integrated) == (4, 3)  # the frame's, and the drive
    worn = machine.turning_joints[-1]
    for fault in ({}, {worn: 1e-4}):
        history = simulate(machine, Case(Fault(fault)), Settings(duration=0.1, sample_rate=5000))
        assert history.status is Status.OK, history.message


@pytest.mark.parametrize("name", GALLERY)
def test_it_stands_on_mounts_as_real_ones_do(name: str) -> None:
    frequencies = [abs(mode) / (2 * math.pi) for mode in modes_of_suspension(shipped_machine(name))]
    assert len(frequencies) == 3
    assert all(4.0 <= frequency <= 20.0 for frequency in frequencies), frequencies


def test_what_goes_round_and_what_swings() -> None:
    """Kinematics that everybody knows: what the names of the machines say."""
    table = course_of(shipped_machine("parallel-cranks")).links["table"]
    assert abs(table[:, 2]).max() < 1e-9  # it goes round without turning
    bar = course_of(shipped_machine("elliptic-trammel"))
    machine = shipped_machine("elliptic-trammel")
    long = math.dist(machine.joints["P"].at, machine.joints["Q"].at)
    for guide in ("G1", "G2"):
        low, high = bar.reach(guide)
        assert high - low == pytest.approx(2 * long, rel=2e-3)  # to 2.5 deg of the extremes
    yoke = course_of(shipped_machine("scotch-yoke"))
    rod = yoke.links["yoke"][:, 0] - yoke.links["yoke"][0, 0]
    expected = [0.04 * (math.cos(math.pi / 4 + angle) - math.cos(math.pi / 4)) for angle in yoke.drive]
    assert rod == pytest.approx(expected, abs=1e-8)
    pistons = course_of(shipped_machine("v-twin"))
    for guide in ("G1", "G2"):
        low, high = pistons.reach(guide)
        assert high - low == pytest.approx(0.06, rel=2e-3)  # twice the crank
