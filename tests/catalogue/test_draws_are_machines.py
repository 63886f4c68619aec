"""Draws of a plan are machines: the same in order and worn, at every speed and load, but for what is of the day."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from small_plans import QUICK_RETURN, draws, keys, plan_of, sizes_of

from jointplay.catalogue.plans.cases import entries_of


def test_a_draw_is_one_machine_at_every_speed() -> None:
    """Clearances and what belongs to the machine are the same; load, speed and oil are of the day."""
    uncertain = {
        "drive.speed": {"factor_uniform": [0.97, 1.03]},
        "contact.damping": {"lognormal": 0.4},
        "frame.mass": {"lognormal": 0.1},
        "load": {"uniform": [-10, 10]},
    }
    plan = plan_of(uncertain=uncertain, speeds=[1.0, 0.5], hypotheses=["singles"], wide={"draws": 0})
    entries = entries_of(plan, QUICK_RETURN)
    by_draw = {(e.hypothesis.label, e.draw, e.speed): e for e in entries}
    others = [(e, by_draw[e.hypothesis.label, e.draw, 0.5]) for e in entries if e.speed == 1.0]
    assert len(others) == len(entries) / 2
    for one, other in others:
        assert (one.joints, one.clearances, one.variant) == (other.joints, other.clearances, other.variant)
        assert one.parameters.keys() == other.parameters.keys()
        differ = {path for path, value in one.parameters.items() if other.parameters[path] != value}
        assert differ == {path for path in one.parameters if path.startswith(("drive.speed", "loads"))}
        assert "drive.speed" in differ
        ratio = other.parameters["drive.speed"] / one.parameters["drive.speed"]
        assert 0.5 * 0.97 / 1.03 < ratio < 0.5 * 1.03 / 0.97


def test_a_draw_is_one_machine_in_order_and_worn() -> None:
    """All that is not of the day is the same, but the clearance of what wears; and in order it is there twice."""
    counts = {**draws(pair=8), "healthy": 8, "single": 8, "again": 3}
    plan = plan_of(hypotheses=["healthy", "singles"], draws=counts, fits={"silent": 0}, wide={"draws": 1})
    entries = entries_of(plan, QUICK_RETURN)
    sound = {(e.stratum, e.draw): e for e in reversed(entries) if not e.worn}
    again = [e for e in entries if not e.worn and e is not sound[e.stratum, e.draw]]
    assert Counter(e.stratum for e in again) == {"trusted": 3, "wide": 3}
    assert {(e.stratum, e.draw) for e in again} == {
        *itertools.product(["trusted"], (0, 1, 2)),
        *itertools.product(["wide"], (0, 2, 4)),
    }
    # Every other wide draw is of a machine by itself.
    others = [e for e in entries if e.stratum == "wide" and e.draw % 2]
    assert len({e.parameters["links.frame.mass"] for e in others}) == len(others) == 4 * 6
    worn = [e for e in entries if e.worn and e not in others]
    assert len(worn) == 5 * (8 + 4)
    of_the_day = ("drive.speed", "loads.")
    for entry in [*again, *worn]:
        before = sound[entry.stratum, entry.draw]
        assert entry.variant == before.variant
        play, its_play = sizes_of(before), sizes_of(entry)
        assert {joint for joint in play if its_play[joint] != play[joint]} == set(entry.worn)
        assert entry.parameters.keys() == before.parameters.keys()
        differ = {path for path, value in entry.parameters.items() if before.parameters[path] != value}
        assert differ == {p for p in entry.parameters if p.startswith(of_the_day) or p.endswith("contact.friction")}
        oil = [entry.parameters[p] / before.parameters[p] for p in differ if p.endswith("friction")]
        assert 0.5 < min(oil) < 2.0 and max(oil) == pytest.approx(min(oil))
    # The wear of a machine says nothing of its play as new.
    for joint in "ACEFO":
        pairs = [(sizes_of(e)[joint], sizes_of(sound[e.stratum, e.draw])[joint]) for e in worn if e.worn == (joint,)]
        assert abs(np.corrcoef(np.log(pairs).T)[0, 1]) < 0.8  # of twelve; the same ranks: 1


def test_what_no_day_changes_is_not_there_again() -> None:
    counts = {**draws(pair=8), "healthy": 8, "again": 4}
    still, moves = ({"frame.mass": {"lognormal": 0.1}}, {"drive.speed": {"factor_uniform": [0.97, 1.03]}})
    for uncertain, again in ((still, 0), (moves, 4)):
        plan = plan_of(hypotheses=["healthy"], draws=counts, uncertain=uncertain, wide={"draws": 0})
        assert len(set(keys(plan))) == 8 + again


def test_a_draw_is_one_machine_under_every_load() -> None:
    """What belongs to the machine is the same; the load is about what the plan says, besides what is drawn of it."""
    uncertain = {
        "drive.speed": {"factor_uniform": [0.97, 1.03]},
        "contact.friction": {"uniform": [0.01, 0.15]},
        "frame.mass": {"lognormal": 0.1},
    }
    wide = {"draws": 1, "uncertain": {"load": {"uniform": [-1, 1]}}}
    loads = [{"force": 0}, {"force": "-50 N"}]
    plan = plan_of(uncertain=uncertain, loads=loads, hypotheses=["healthy", "pairs"], wide=wide)
    entries = entries_of(plan, QUICK_RETURN)
    half = {(e.hypothesis.label, e.stratum, e.draw): e for e in entries if "loads.0.force.0" not in e.parameters}
    force: dict[str, list[float]] = {"trusted": [], "wide": []}
    for loaded in entries:
        free = half.get((loaded.hypothesis.label, loaded.stratum, loaded.draw))
        if free is loaded or loaded.stratum == "wide":
            force["wide"] += [loaded.parameters["loads.0.force.0"]] if loaded.stratum == "wide" else []
            continue
        assert free is not None
        assert (loaded.joints, loaded.clearances, loaded.variant.law) == (
            free.joints,
            free.clearances,
            free.variant.law,
        )
        differ = {path for path, value in loaded.parameters.items() if free.parameters.get(path) != value}
        assert differ == {"drive.speed", "loads.0.force.0"}
        force["trusted"].append(loaded.parameters["loads.0.force.0"])
    assert len(force["trusted"]) == sum(e.stratum == "trusted" for e in entries) / 2
    assert -60.0 <= min(force["trusted"]) < -58.0 and -42.0 < max(force["trusted"]) <= -40.0
    under = np.array(force["wide"])
    assert np.sum(np.abs(under) <= 1.0) == np.sum((under >= -61.0) & (under <= -39.0)) == len(under) / 2


def test_joints_of_one_machine_may_be_alike() -> None:
    """In contacts, whatever is worn; each is as likely as before, and all else is as it was."""
    uncertain = {
        "contact.friction": {"uniform": [0.01, 0.15]},
        "contact.stiffness": {"lognormal": 0.4},
        "pin_radius": {"factor_uniform": [0.9, 1.1]},
    }
    plan = plan_of(uncertain=uncertain, draws=draws(single=512), hypotheses=["singles"], wide={"draws": 0})
    usual, alike = (entries_of(plan, QUICK_RETURN, alike=each) for each in (0.0, 0.8))
    assert usual == entries_of(plan, QUICK_RETURN)
    for path, correlated in (("contact.stiffness", True), ("contact.friction", True), ("pin_radius", False)):
        before, after = (
            np.array([[each.parameters[f"joints.{joint}.{path}"] for joint in "ACEFO"] for each in some[:512]])
            for some in (usual, alike)
        )
        found = np.corrcoef(np.log(after).T if path.endswith("stiffness") else after.T)[np.triu_indices(5, 1)]
        if not correlated:
            np.testing.assert_array_equal(after, before)
            continue
        assert found == pytest.approx(0.8, abs=0.05)  # of ranks 0.79
        np.testing.assert_allclose(np.sort(after, axis=0)[50:-50], np.sort(before, axis=0)[50:-50], rtol=0.2)
        assert after.min() >= before.min() * 0.9 and after.max() <= 1.6 * before.max()
    for one, other in zip(alike[:512], alike[512:1024], strict=True):
        assert one.parameters == other.parameters
