"""A machine's state of wear from all its recordings and inspections."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest
from lives import AS_NEW, BEGIN, BOUNDS, JOINTS, NONE, answer, course_of_wear, followed, wears

from jointplay.catalogue.diagnosing.answer import Cause
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.following.follow import follow
from jointplay.catalogue.following.play import (
    YEAR,
)
from jointplay.catalogue.following.visits import Inspection, Visit


def test_wear_is_followed() -> None:
    true = wears(30)
    state = followed(course_of_wear(true, 1))
    found = state.joints["B"]
    assert found.p_worn > 0.99
    assert found.interval_um[0] < 1e6 * true[-1]["B"] < found.interval_um[1]
    # 15 um in 30 days: measured 0.76 to 0.94.
    assert 0.5 < found.um_per_year / (15.0 * YEAR / (30 * 86400.0)) < 2.0
    assert all(state.joints[name].p_worn < 0.5 for name in "AO")
    assert state.visits == 30 and not state.repairs
    since = (found.first_sure_at or BEGIN) - BEGIN
    assert 9 * 30 <= since.days <= 12 * 30


def test_intervals_hold() -> None:
    """Of clearances of a worn joint, and of the next visit's before it is heard: measured 1.00, as these
    answers err each by itself.
    """
    held = foretold = count = 0
    for seed in range(8):
        true = wears(30, um_a_visit=4.0 + 3.0 * seed)
        course = followed(course_of_wear(true, seed)).joints["B"].course
        for point, clearances in list(zip(course, true, strict=True))[14:]:
            held += point.interval_um[0] < 1e6 * clearances["B"] < point.interval_um[1]
            foretold += point.foretold_um[0] < 1e6 * clearances["B"] < point.foretold_um[1]
            count += 1
    assert held > 0.85 * count
    assert foretold > 0.85 * count


def test_a_hundred_recordings_take_less_than_a_second() -> None:
    """Of a processor, so that it does not matter what else runs: 0.3 s on a busy computer."""
    visits = course_of_wear(wears(100), 1)
    took = []
    for _ in range(3):
        began = time.process_time()
        followed(visits)
        took.append(time.process_time() - began)
    assert min(took) < 1.0


@pytest.mark.parametrize("seed", range(3))
def test_what_comes_late_or_twice_changes_nothing(seed: int) -> None:
    visits = course_of_wear(wears(12, 3), seed)
    found = Inspection(visits[5].at, {"B": 40e-6})
    draw = np.random.default_rng(seed)
    mixed = [visits[place] for place in draw.permutation(12)] + [visits[4], visits[7]]
    assert followed(mixed, [found, found]) == followed(visits, [found])


def test_a_zone_does_not_matter_but_none_is_refused() -> None:
    visits = course_of_wear(wears(4), 0)
    with pytest.raises(DiagnosisError, match="at: 2025-03-01T09:30:00: must have a time zone"):
        followed([replace(visits[0], at=visits[0].at.replace(tzinfo=None)), *visits[1:]])
    with pytest.raises(DiagnosisError, match=r"at: .*: must have a time zone"):
        followed(visits, [Inspection(datetime(2025, 1, 1), {"B": 1e-5})])


def test_what_others_were_sure_of_is_taken_back_by_what_is_as_sure() -> None:
    """A recording that tells nothing of any joint leaves what is known; a clear one counts more than those before."""
    visits = course_of_wear(wears(20), 2)
    known = followed(visits).joints["B"]
    found = []
    for a, b in ((0.0, 0.0), (-6.0, -1.0), (-6.0, -3.0)):
        told = answer({"A": a, "B": b, "O": a}, {**AS_NEW, "B": 1e-6 * known.clearance_um})
        state = followed([*visits, Visit(visits[-1].at + timedelta(days=30), "q", told)])
        found.append(state.joints["B"].p_worn)
        assert state.joints["B"].moved_by == pytest.approx(found[-1] - known.p_worn, abs=0.05)
    assert found[0] > 0.95 and 0.2 < found[1] < 0.5 and found[2] < 0.15  # measured 0.98, 0.27, 0.06


def test_a_recording_that_the_machine_does_not_explain_says_little() -> None:
    visits = course_of_wear(wears(6), 6)
    odd = {"evidence": {"A": 6.0, "B": -6.0, "O": -6.0}, "clearances": {**AS_NEW, "A": 3e-4}}
    later = visits[-1].at + timedelta(days=30)
    worn, changed, beside_itself = (
        followed([*visits, Visit(later, "o", answer(**odd, verdict=verdict, heard=heard))]).joints["A"].p_worn
        for verdict, heard in (("worn", False), ("changed", False), ("changed", True))
    )
    assert beside_itself == worn
    assert 1.0 - changed > 2.0 * (1.0 - worn)  # measured 0.90 and 0.96


def test_an_answer_and_the_state_agree_on_a_machine_that_is_new_to_both() -> None:
    """Of a joint, worn or not: by the evidence of the answer, and what is believed of any joint."""
    for evidence in (-3.0, 0.0, 3.0):
        told = answer({**NONE, "B": evidence}, {**AS_NEW, "B": 80e-6})
        found = followed([Visit(BEGIN, "1", told)]).joints["B"].p_worn
        worn = BOUNDS["B"].at_first().sum(axis=0)[BOUNDS["B"].worn].sum()
        # What an answer takes for likely beforehand is that of sets, not of joints; 3 % of recordings say nothing.
        odds = math.exp(evidence) * worn / (1.0 - worn)
        assert found == pytest.approx(odds / (1.0 + odds), abs=0.03)


def test_recordings_that_say_the_same_do_not_count_each_anew() -> None:
    """They err alike. As independent ones a hundred with an evidence of 2 would have ln(odds) of 200 and more."""

    def odds(count: int, evidence: float) -> float:
        told = answer({**NONE, "B": evidence}, {**AS_NEW, "B": 80e-6}, width=1.0)
        visits = [Visit(BEGIN + timedelta(seconds=number), str(number), told) for number in range(count)]
        found = followed(visits).joints["B"].p_worn
        return math.log(found / (1.0 - found))

    for evidence in (-1.0, 0.0, 2.0):
        # A quarter more at last; 3 % of recordings that say nothing take some of it away.
        assert odds(100, evidence) - odds(1, evidence) == pytest.approx(0.25 * evidence, abs=0.1)


def test_a_mount_that_loosens_is_followed() -> None:
    visits = []
    for number in range(12):
        size = 1.0 - 0.04 * max(0, number - 3)
        cause = Cause(name="mount 1", size=size, unit="x stiffness", probability=0.97, since=True)
        causes = (cause,) if number > 4 else ()
        told = answer(NONE, AS_NEW, verdict="changed" if causes else "in_order", causes=causes)
        visits.append(Visit(BEGIN + timedelta(days=30 * number), str(number), told))
    found = followed(visits).causes["mount 1"]
    assert found.probability > 0.95
    assert found.since == visits[6].at
    assert found.since_baseline
    assert found.size == pytest.approx(0.68)
    assert found.per_year == pytest.approx(-0.04 * YEAR / (30 * 86400.0))


def test_a_cause_does_not_come_by_time_alone() -> None:
    named = answer(NONE, AS_NEW, causes=(Cause(name="mount 1", size=0.8, unit="x stiffness", probability=0.5),))
    years_later = BEGIN + timedelta(days=26 * 365)
    visits = [Visit(BEGIN, "1", named), Visit(years_later, "2", answer(NONE, AS_NEW, verdict="in_order"))]
    found = followed(visits).causes["mount 1"]
    assert found.probability < 0.5
    assert found.since is None and found.per_year == 0.0
    assert not found.since_baseline


def test_a_course_within_seconds_has_no_rate() -> None:
    causes = [Cause(name="mount 1", size=size, unit="x stiffness", probability=0.9) for size in (0.8, 0.82, 0.81)]
    told = [answer(NONE, AS_NEW, verdict="changed", causes=(cause,)) for cause in causes]
    visits = [Visit(BEGIN + timedelta(seconds=place), str(place), each) for place, each in enumerate(told)]
    assert followed(visits).causes["mount 1"].per_year == 0.0


@pytest.mark.parametrize("kept", [("B", "O"), ("O",), ()])
def test_an_answer_that_does_not_know_a_joint_says_nothing_of_it(kept: tuple[str, ...]) -> None:
    """As of a catalogue in which it is never worn."""
    known = course_of_wear(wears(12, 2), 7)[0].answer
    only = tuple(each for each in known.hypotheses if set(each.joints) <= set(kept))
    told = known.model_copy(update={"joints": {name: known.joints[name] for name in kept}, "hypotheses": only})
    state = followed([Visit(BEGIN, "1", told)])
    for name in set(JOINTS) - set(kept):
        worn = BOUNDS[name].at_first().sum(axis=0)[BOUNDS[name].worn].sum()
        assert state.joints[name].p_worn == pytest.approx(worn)
        assert math.isfinite(state.joints[name].clearance_um)
    assert "O" not in kept or state.joints["O"].p_worn < 0.05
    # Nor does it take back what others have said.
    visits = course_of_wear([each | {"A": each["B"]} for each in wears(20)], 2)
    later = [Visit(visits[-1].at + timedelta(days=n), f"{100 + n:064d}", told) for n in range(1, 4)]
    after = followed([*visits, *later])
    assert after.joints["A"].p_worn > 0.95
    assert not [repair for repair in after.repairs if repair.joint == "A"]


@pytest.mark.parametrize(("clearance", "least", "most"), [(1e-9, 25.0, 50.0), (12e-6, 25.0, 50.0), (0.08, 4e3, 6e3)])
def test_clearances_beyond_the_grid_are_those_of_its_end(clearance: float, least: float, most: float) -> None:
    """So is wear below the least that counts as such."""
    told = answer({"A": -6.0, "B": 9.0, "O": -6.0}, {**AS_NEW, "B": clearance}, width=0.01)
    found = followed([Visit(BEGIN, "b", told)]).joints["B"]
    assert least < found.clearance_um < most and found.p_worn > 0.9


def test_one_recording_of_two_times_is_of_the_earlier() -> None:
    visits = course_of_wear(wears(12), 2)
    late = replace(visits[4], at=visits[4].at + timedelta(days=200))
    assert followed([*visits, late]) == followed([late, *visits]) == followed(visits)


def test_what_answers_have_wrong_alike_many_of_them_do_not_cure() -> None:
    """All of a machine's answers may put a joint at half its clearance, if they say that they err by that."""
    said = [answer({"A": -6.0, "B": 6.0, "O": -6.0}, {**AS_NEW, "B": 150e-6}, width=w) for w in (0.15, 1.5)]
    sharp, wide = (
        followed([Visit(BEGIN + timedelta(days=n), f"{n:064d}", each) for n in range(20)]).joints["B"] for each in said
    )
    assert math.log(sharp.interval_um[1] / sharp.interval_um[0]) < 0.6
    assert wide.interval_um[0] < 150.0 * math.exp(-0.5 * 1.5) and wide.interval_um[1] > 150.0 * math.exp(0.5 * 1.5)
    visits = [Visit(BEGIN + timedelta(days=n), f"{n:064d}", said[1]) for n in range(20)]
    found = Inspection(visits[-1].at + timedelta(minutes=1), {"B": 250e-6})
    measured = followed(visits, [found]).joints["B"]
    assert measured.interval_um[0] > 0.7 * 250.0 and measured.interval_um[1] < 1.4 * 250.0
    # Nor does what comes after it make less known than that, for as long as it cannot have worn much.
    later = [Visit(found.at + timedelta(hours=n), f"{99 + n:064d}", said[1]) for n in range(1, 9)]
    after = followed([*visits, *later], [found]).joints["B"]
    assert after.interval_um[0] > 0.7 * 250.0 and after.interval_um[1] < 1.4 * 250.0


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"visits": []}, "visits: none"),
        ({"inspections": [Inspection(BEGIN, {"Q": 1e-5})]}, r"inspection: joints\.Q: must be one of A, B, O"),
        ({"inspections": [Inspection(BEGIN, repaired=frozenset("Q"))]}, r"inspection: joints\.Q: must be one of"),
    ],
)
def test_what_cannot_be_followed_is_refused(asked: dict[str, list[Inspection]], said: str) -> None:
    with pytest.raises(DiagnosisError, match=said):
        followed(**({"visits": course_of_wear(wears(2), 0)} | asked))
    with pytest.raises(DiagnosisError, match="joints: none: a state of wear needs at least one"):
        follow(course_of_wear(wears(2), 0), bounds={})
    with pytest.raises(DiagnosisError, match=r"inspection: joints\.B: nan"):
        Inspection(BEGIN, {"B": math.nan})
