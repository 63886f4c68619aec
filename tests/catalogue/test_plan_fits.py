"""Play of fits and of wear in the cases of a plan: ranges, tight joints, silent machines, the machine file."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from small_plans import QUICK_RETURN, draws, keys, plan_of, sizes_of

from jointplay.catalogue.plans.cases import entries_of, travel
from jointplay.catalogue.plans.plan_check import plan_lines
from jointplay.catalogue.plans.plan_parts import NEXT_TO_NONE
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine


def test_every_joint_has_play_and_worn_ones_more_than_their_fit() -> None:
    entries = entries_of(plan_of(hypotheses=["healthy", "singles", "pairs", "triples"]), QUICK_RETURN)
    for entry in entries:
        sizes = sizes_of(entry)
        assert sorted(sizes) == sorted(QUICK_RETURN.turning_joints)
        worn = [sizes.pop(joint) for joint in entry.worn]
        assert all(2.5e-5 <= size <= 4e-3 for size in worn)
        assert all(3e-6 / NEXT_TO_NONE <= size <= 2e-5 for size in sizes.values())
        assert entry.fault == Fault(dict(zip(entry.joints, entry.clearances, strict=True)))


def test_fits_fill_their_range_and_one_in_ten_is_tight() -> None:
    entries = entries_of(plan_of(draws=draws(healthy=1024), hypotheses=["healthy"], fits={"silent": 0}), QUICK_RETURN)
    fits = np.array([entry.clearances for entry in entries])
    assert fits.shape == (1024, 5)
    tight = fits < 3e-6
    assert np.abs(tight.mean(axis=0) - 0.1).max() < 2 / 1024
    assert fits.min() >= 1e-7
    assert fits.max() <= 2e-5
    for joint in range(5):
        counts = np.histogram(np.log(fits[~tight[:, joint], joint]), 9, (math.log(3e-6), math.log(2e-5)))[0]
        assert np.ptp(counts) <= 2  # log-uniform, and a Sobol sequence
    assert np.abs(np.corrcoef(np.log(fits).T) - np.eye(5)).max() < 0.1
    loose = entries_of(
        plan_of(draws=draws(healthy=64), hypotheses=["healthy"], fits={"tight": 0, "silent": 0}), QUICK_RETURN
    )
    assert min(min(entry.clearances) for entry in loose) >= 3e-6


def test_one_machine_in_four_has_ideal_joints_where_it_is_not_worn() -> None:
    entries = entries_of(plan_of(draws=draws(healthy=1024, single=256), fits={"silent": 0.25}), QUICK_RETURN)
    for worn, count in (((), 1024), (("A",), 256)):
        found = [entry for entry in entries if entry.worn == worn]
        silent = [entry for entry in found if entry.joints == worn]
        assert len(silent) / len(found) == pytest.approx(0.25, abs=2 / count)
        others = {entry.joints for entry in found if entry.joints != worn}
        assert others == {tuple(sorted(QUICK_RETURN.turning_joints))}
        for entry in silent:
            # Nothing is drawn of contacts that are not there.
            contacts = {path.split(".")[1] for path in entry.parameters if path.startswith("joints.")}
            assert contacts == set(worn)
            assert entry.fault == Fault(dict(zip(entry.joints, entry.clearances, strict=True)))
            assert all(size >= 2.5e-5 for size in entry.clearances)


def test_draws_of_machines_that_are_not_silent_do_not_depend_on_those_that_are() -> None:
    some, none = (set(keys(plan_of(draws=draws(single=64), fits={"silent": share}))) for share in (0.25, 0))
    assert 0.6 < len(some & none) / len(none) < 0.9


def machine_with_fits(**said: Any) -> Machine:
    tree: dict[str, Any] = QUICK_RETURN.model_dump(mode="json")
    for joint, fit in said.items():
        tree["joints"][joint]["fit"] = fit
    return parse_machine(tree)


def test_fits_are_those_of_the_machine_file_unless_a_plan_says_otherwise() -> None:
    machine = machine_with_fits(A=[10e-6, 60e-6])
    asked = plan_of(draws=draws(healthy=256, single=64), fits={"tight": 0, "silent": 0})
    entries = entries_of(asked, machine)
    fits = {joint: [sizes_of(e)[joint] for e in entries if joint not in e.worn] for joint in machine.turning_joints}
    assert 10e-6 <= min(fits["A"]) < 10.2e-6 and 59e-6 < max(fits["A"]) <= 60e-6
    assert 3e-6 <= min(fits["F"]) < 3.1e-6 and 19.5e-6 < max(fits["F"]) <= 20e-6
    # Wear is what goes beyond the fit, by a quarter at least.
    worn = {joint: [sizes_of(e)[joint] for e in entries if e.worn == (joint,)] for joint in machine.turning_joints}
    assert 75e-6 <= min(worn["A"]) < 80e-6
    assert 25e-6 <= min(worn["F"]) < 27e-6
    own = entries_of(
        plan_of(fits={"low": "1 um", "high": "2 um", "tight": 0, "silent": 0}, hypotheses=["healthy"]), machine
    )
    assert all(1e-6 <= size <= 2e-6 for entry in own for size in entry.clearances)
    assert "fits A 10-60 um, C 3-20 um, E 3-20 um, F 3-20 um, O 3-20 um" in plan_lines(asked, machine)[3]


def test_wear_ends_where_a_pin_would_leave_its_socket() -> None:
    tree: dict[str, Any] = QUICK_RETURN.model_dump(mode="json")
    wide = entries_of(plan_of(clearance={"low": "25 um", "high": "40 mm"}, draws=draws(single=64)), parse_machine(tree))
    for joint, largest in {"O": 8e-3, "A": 8e-3, "C": 25e-3, "E": 12e-3, "F": 12e-3}.items():
        assert travel(QUICK_RETURN, joint) == pytest.approx(largest)  # a tenth of the shortest link it is a joint of
        drawn = [sizes_of(entry)[joint] for entry in wide if entry.worn == (joint,)]
        assert 0.85 * largest < max(drawn) <= largest * (1 + 1e-6)
    # A fit that leaves no room is followed by a range of a factor of two: there is nothing better to say.
    coarse = entries_of(plan_of(fits={"low": "5 mm", "high": "7 mm"}, draws=draws(single=64)), QUICK_RETURN)
    drawn = [sizes_of(entry)["O"] for entry in coarse if entry.worn == ("O",)]
    assert 8.75e-3 <= min(drawn) < max(drawn) <= 17.5e-3


def test_oil_is_drawn_beside_the_play_of_every_joint() -> None:
    """Each joint its own, 0.3 to 3 of the file's or none in a fifth; a dry machine draws what it drew before."""
    tree: dict[str, Any] = QUICK_RETURN.model_dump(mode="json")
    for joint in ("A", "F"):
        tree["joints"][joint]["film"] = {"viscosity": 0.1, "length": "15 mm"}
    oiled, asked = parse_machine(tree), {"hypotheses": ["healthy", "singles"], "draws": draws(healthy=64, single=64)}
    plan, found = plan_of(**asked), {"A": [], "F": []}
    for entry in entries_of(plan, oiled):
        sizes = sizes_of(entry)
        for joint in ("A", "F"):
            path = f"joints.{joint}.film.viscosity"
            assert sizes[joint] > (25e-6 if joint in entry.worn else 0.0)
            found[joint].append(entry.parameters[path])
    for values in found.values():
        wet = [value for value in values if value]
        assert 0.03 <= min(wet) < 0.032 < 0.28 < max(wet) <= 0.3
        assert 0.18 < 1 - len(wet) / len(values) < 0.22
    assert not any("film" in path for entry in entries_of(plan, QUICK_RETURN) for path in entry.parameters)
