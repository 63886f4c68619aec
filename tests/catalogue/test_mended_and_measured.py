"""Joints that were mended, as told or as seen, and what somebody has measured, in a machine's state of wear."""

from __future__ import annotations

import math
from datetime import datetime, timedelta

from lives import AS_NEW, BEGIN, BOUNDS, answer, course_of_wear, followed, wears

from jointplay.catalogue.diagnosing.answer import SensorFlaw
from jointplay.catalogue.following import follow as following
from jointplay.catalogue.following.state import CoursePoint
from jointplay.catalogue.following.visits import Inspection, Visit


def test_silence_is_no_repair() -> None:
    """A recording that says nothing, however late, leaves a joint that was surely worn rather worn than not."""
    visits = course_of_wear(wears(20), 2)
    flaw = SensorFlaw(kind="dead", sensors=("s1-x",), said="s1-x says nothing")
    silent = visits[-1].answer.model_copy(update={"sensors": (flaw,)})
    late = Visit(visits[-1].at + timedelta(days=700), "late", silent)
    often = [Visit(visits[-1].at + timedelta(days=30 * number), str(number), silent) for number in range(1, 13)]
    for quiet in ([late], often):
        state = followed([*visits, *quiet])
        assert state.joints["B"].p_worn > 0.8 and not state.repairs  # measured 0.87 and 0.90


def test_a_repair_was_where_wear_fell_most() -> None:
    """In odds: from nearly sure to sure it may have fallen before, too."""
    course = [
        CoursePoint(at=BEGIN + timedelta(days=day), p_worn=p, clearance_um=1, interval_um=(1, 1), foretold_um=(1, 1))
        for day, p in enumerate((0.2, 0.95, 0.97, 0.88, 0.22, 0.3))
    ]

    def mended(course: list[CoursePoint]) -> datetime:
        joint = following._Joint(BOUNDS["B"], course=course, acquitted=[True] * len(course))
        return joint.when_mended()

    assert mended(course) == BEGIN + timedelta(days=4)
    assert mended([*course[:3], course[4]]) == BEGIN + timedelta(days=4)
    assert mended([*course[:3], course[0], course[4]]) == BEGIN


def test_a_repair_is_seen() -> None:
    true = wears(20) + [{"A": 8e-6, "B": 9e-6, "O": 12e-6}] * 3
    state = followed(course_of_wear(true, 3))
    (repair,) = state.repairs
    assert repair.joint == "B" and repair.probability > 0.5
    assert repair.at == BEGIN + timedelta(days=30 * 20)
    assert state.joints["B"].first_sure_at is None
    assert state.joints["B"].clearance_um < 25.0


def test_a_repair_that_is_known_counts_at_once() -> None:
    visits = course_of_wear(wears(20), 4)
    moment = visits[-1].at + timedelta(days=1)
    state = followed(visits, [Inspection(moment, repaired=frozenset("B"))])
    assert state.at == moment
    assert state.joints["B"].p_worn < 0.01
    assert [(repair.at, repair.joint, repair.probability) for repair in state.repairs] == [(moment, "B", 1.0)]


def test_a_joint_that_was_measured_may_be_mended_without_a_word() -> None:
    visits = course_of_wear(wears(20) + [{"A": 8e-6, "B": 9e-6, "O": 12e-6}] * 6, 3)
    found = Inspection(visits[19].at + timedelta(days=1), {"B": 190e-6})
    known, last = (followed(visits[:count], [found]).joints["B"] for count in (20, 26))
    assert known.p_worn > 0.99
    assert last.p_worn < 0.1


def test_what_is_measured_by_hand_is_a_measurement_with_an_error() -> None:
    visits = course_of_wear(wears(20), 5)
    before = followed(visits).joints["B"]
    measured = 0.9 * before.clearance_um
    after = followed(visits, [Inspection(visits[-1].at, {"B": 1e-6 * measured})]).joints["B"]
    assert measured < after.clearance_um < before.clearance_um
    assert math.log(after.interval_um[1] / after.interval_um[0]) < math.log(
        before.interval_um[1] / before.interval_um[0]
    )


def test_what_is_measured_beyond_the_grid_is_its_end() -> None:
    found = followed(course_of_wear(wears(12), 8), [Inspection(BEGIN + timedelta(days=340), {"B": 20e-3})]).joints["B"]
    assert found.clearance_um > 4e3 and found.p_over_limit > 0.99


def test_what_is_forgotten_was_not_mended() -> None:
    """An answer sure of two joints and silent of the third lets this one's wear be forgotten; a repair is none."""
    visits = course_of_wear(wears(20), 2)
    silent = answer({"A": -6.0, "B": 0.0, "O": -6.0}, {**AS_NEW, "B": 150e-6})
    later = [Visit(visits[-1].at + timedelta(days=30 * n), f"silent {n}", silent) for n in range(1, 5)]
    state = followed([*visits, *later])
    assert state.joints["B"].p_worn < 0.5 and not state.repairs
    against = answer({"A": -6.0, "B": -6.0, "O": -6.0}, {**AS_NEW, "B": 150e-6})
    at = visits[-1].at + timedelta(days=200)
    mended = followed([*visits, *later, Visit(at, "against", against)])
    assert [(repair.joint, repair.at) for repair in mended.repairs] == [("B", at)]
    flaw = SensorFlaw(kind="dead", sensors=("s1-x",), said="s1-x says nothing")
    silent = against.model_copy(update={"sensors": (flaw,)})
    assert not followed([*visits, *later, Visit(at, "against", silent)]).repairs


def test_what_is_found_at_one_moment_was_measured_before_it_was_mended() -> None:
    visits, at = course_of_wear(wears(20), 2), BEGIN + timedelta(days=700)
    apart = [Inspection(at, {"B": 30e-6}), Inspection(at, repaired=frozenset("B"))]
    whole = followed(visits, [Inspection(at, {"B": 30e-6}, frozenset("B"))])
    for found in (apart, apart[::-1]):
        assert followed(visits, found).joints == whole.joints


def test_repairs_are_in_the_order_of_time() -> None:
    """One that is seen late is dated back, before one of which was told meanwhile."""
    visits = course_of_wear(wears(20), 2)
    weak = [answer({"A": sure, "B": -0.75, "O": sure}, {**AS_NEW, "B": 150e-6}) for sure in (0.0, -6.0)]
    later = [Visit(visits[-1].at + timedelta(days=30 * n), f"weak {n}", each) for n, each in enumerate(weak, 1)]
    told = Inspection(later[0].at + timedelta(days=1), repaired=frozenset("A"))
    repairs = followed([*visits, *later], [told]).repairs
    assert [(repair.joint, repair.at) for repair in repairs] == [("B", later[0].at), ("A", told.at)]


def test_a_joint_found_sound_is_not_surely_worn() -> None:
    visits = course_of_wear(wears(20), 8)
    assert followed(visits).joints["B"].first_sure_at is not None
    found = followed(visits, [Inspection(visits[-1].at + timedelta(days=1), {"B": 8e-6})]).joints["B"]
    assert found.p_worn < 0.5 and found.first_sure_at is None
