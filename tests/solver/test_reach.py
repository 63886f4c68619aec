"""Subchains that a moving frame cannot feel are left out, and nothing that it feels changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from laws import Tree, tree_of

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.reach import reach_of
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.simulate import simulate, start_of

WORN = Case(Fault({"B": 2e-4}))
SHORT = Settings(duration=0.1)


def two_machines(**change: Any) -> Machine:
    """A slider-crank, and another that stands on the ground, whose parts come first in the file."""
    tree = tree_of("slider-crank") | change
    other: Tree = tree_of("slider-crank")
    names = {"frame": "floor", "crank": "crank-2", "rod": "rod-2", "slider": "slider-2"}
    links = {names[name]: link for name, link in other["links"].items()} | {"floor": {"fixed": True}}
    joints = {}
    for name, joint in other["joints"].items():
        joint |= {"links": [names[link] for link in joint["links"]]}
        joints[f"{name}-2"] = joint | ({"pin": names[joint["pin"]]} if "pin" in joint else {})
    swing = {"kind": "mount", "link": "rod-2", "at": [0.1, 0.05], "stiffness": [1e4, 1e4], "damping": [10, 10]}
    push = {"link": "slider-2", "at": [0.2, 0.05], "force": [5.0, 0.0]}
    tree["links"] = links | tree["links"]
    tree["joints"] = joints | tree["joints"]
    tree["supports"] = [swing, *tree["supports"]]
    tree["loads"] = [push, {"link": "slider", "at": [0.2, 0.05], "force": [3.0, 0.0]}]
    return parse_machine(tree)


def alone() -> Machine:
    load = {"link": "slider", "at": [0.2, 0.05], "force": [3.0, 0.0]}
    return parse_machine(tree_of("slider-crank") | {"loads": [load]})


@pytest.mark.parametrize("name", ["slider-crank", "four-bar", "quick-return"])
def test_shipped_machines_are_all_within_reach(name: str) -> None:
    machine = shipped_machine(name)
    assert reach_of(machine).machine == machine  # perhaps another one of the same content, that was asked for before


def test_a_machine_beside_it_changes_no_digit() -> None:
    found, expected = simulate(two_machines(), WORN, SHORT), simulate(alone(), WORN, SHORT)
    assert (found.status, found.message) == (Status.OK, "")
    assert np.array_equal(found.displacement, expected.displacement)
    assert np.array_equal(found.band_limited_acceleration, expected.band_limited_acceleration)


def test_what_is_left_out_would_not_have_been_felt() -> None:
    found, whole = (simulate(two_machines(), WORN, Settings(duration=0.1, rtol=1e-10, whole=w)) for w in (False, True))
    # Both are within their tolerance of the motion: 3e-13 m of 1.1e-3 m was seen.
    assert np.abs(found.displacement - whole.displacement).max() < 1e-10


def test_the_account_says_what_is_out_of_reach() -> None:
    both, one = account(two_machines(), WORN.fault), account(alone(), WORN.fault)
    assert both.operations == one.operations
    left = next(out for out in both.left_out if "crank-2" in out.what)
    assert left.what == "floor, crank-2, rod-2, slider-2, O-2, A-2, B-2, G1-2"
    assert left.unknowns == 3 * 4 + 2 * 4
    assert "through fixed links alone" in left.why


def test_numbers_of_supports_and_loads_keep_their_places() -> None:
    """The first support and load of the file are out of reach: the others are numbered from 1 by the cases."""
    numbers = {"supports.1.stiffness.1": 5e5, "loads.1.force.0": 7.0, "links.rod.mass": 0.3}
    theirs = {"supports.0.damping.0": 20.0, "loads.0.force.0": 1.0, "joints.A-2.contact.friction": 0.2}
    found = simulate(two_machines(), Case(WORN.fault, numbers | theirs), SHORT)
    shifted = {"supports.0.stiffness.1": 5e5, "loads.0.force.0": 7.0, "links.rod.mass": 0.3}
    assert np.array_equal(found.displacement, simulate(alone(), Case(WORN.fault, shifted), SHORT).displacement)


def test_play_out_of_reach_is_named() -> None:
    case = Case(Fault({"B": 2e-4, "A-2": 1e-4}))
    found = simulate(two_machines(), case, SHORT)
    assert found.case is case
    assert found.message == "clearance of A-2 is without effect: nothing of it reaches frame"
    assert np.array_equal(found.displacement, simulate(alone(), WORN, SHORT).displacement)


@pytest.mark.parametrize("path", ["links.rod-2.masss", "supports.0.stiffness.2", "supports.9.stiffness.0"])
def test_numbers_that_nothing_has_are_still_refused(path: str) -> None:
    with pytest.raises(MachineError, match=r"such (a )?number"):
        simulate(two_machines(), Case(parameters={path: 1.0}), SHORT)


def test_links_and_the_switch_keep_everything() -> None:
    machine = two_machines()
    assert start_of(machine, WORN).z.size < start_of(machine, WORN, Settings(whole=True)).z.size
    history = simulate(machine, WORN, Settings(duration=0.01, links=True))
    assert history.links is not None
    assert history.links.links == tuple(machine.links)


def test_the_chain_of_the_drive_stays() -> None:
    machine = two_machines(drive={"kind": "rotation", "joint": "O-2", "speed": 10.0})
    assert reach_of(machine).machine is machine


def test_of_a_fixed_frame_everything_is_wanted() -> None:
    tree = tree_of("slider-crank") | {"supports": [], "sensors": []}
    tree["links"]["frame"] = {"fixed": True}
    tree["links"]["bob"] = {"mass": 1.0, "inertia": 1.0, "cg": [0, -1]}
    tree["joints"]["P"] = {"kind": "turning", "links": ["bob", "frame"], "at": [0, 0]}
    machine = parse_machine(tree)
    assert reach_of(machine).machine is machine
