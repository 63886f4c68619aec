"""A machine's state of wear, from all that is known of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta

import numpy as np
from scipy.special import logit

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.following.causes import follow_causes
from jointplay.catalogue.following.evidence import error_of, read_answer, read_measured, weigh
from jointplay.catalogue.following.play import (
    REPAIRS,
    REPAIRS_OF_WORN,
    SOON,
    YEAR,
    JointBounds,
    gain_of,
    let_pass,
    median_rate,
    quantiles,
    reach,
)
from jointplay.catalogue.following.state import CoursePoint, JointFollowed, Repair, WearState
from jointplay.catalogue.following.teaching import Correction
from jointplay.catalogue.following.visits import Inspection, Visit, put_in_order
from jointplay.solver.arrays import FloatArray

SURE = 0.9
"""Probability of wear, by all recordings up to then, from which on it is sure."""

ALIKE, ALIKE_OF_ERROR = 0.15, 0.5
"""Standard deviation of ln(clearance) of what every recording of a machine has wrong alike; and the part of the error
that a recording gives its own clearance which all others share: docs/decisions/0208."""

UNWORN = 0.5
"""Probability of wear below which a joint that was surely worn has been repaired."""

_SHARES = np.array([0.05, 0.5, 0.95])


def follow(
    visits: Sequence[Visit],
    inspections: Sequence[Inspection] = (),
    *,
    bounds: Mapping[str, JointBounds],
    correction: Correction | None = None,
) -> WearState:
    """Return a machine's state of wear.

    Every joint's clearance grows at a rate of its own that changes now and then, and never falls, but by a repair. What
    comes late or twice leaves the same state.

    Parameters
    ----------
    visits : sequence of Visit
        At least one, all of one machine.
    inspections : sequence of Inspection
    bounds : mapping of str to JointBounds
        Of every joint that may wear.
    correction : Correction, optional
        What findings have taught about answers.

    Raises
    ------
    DiagnosisError
        There is no recording, a time has no zone, or something is said of a joint that is not known.
    """
    names, taught = list(bounds), correction or Correction()
    _check(visits, inspections, names)
    events = put_in_order(visits, inspections)
    belief = np.array([bounds[name].at_first() for name in names])
    is_worn = np.array([bounds[name].worn for name in names])
    courses: dict[str, list[CoursePoint]] = {name: [] for name in names}
    sure: dict[str, datetime | None] = dict.fromkeys(names)
    repairs: list[Repair] = []
    moved = np.zeros(len(names))
    alike = np.zeros(len(names))
    before: datetime | None = None
    for event in events:
        passed = (event.at - before).total_seconds() if before else 0.0
        before = event.at
        belief = let_pass(belief, passed)
        if isinstance(event, Inspection):
            for joint in sorted(event.joints.keys() | event.repaired):
                j = names.index(joint)
                if joint in event.joints:
                    without = belief[j].sum(axis=(0, 1))
                    belief[j] *= read_measured(event.joints[joint])
                    belief[j] /= belief[j].sum()
                    alike[j] *= 1.0 - gain_of(without, belief[j].sum(axis=(0, 1)))
                    if float(belief[j].sum(axis=(0, 1))[is_worn[j]].sum()) < UNWORN:
                        sure[joint] = None
                if joint in event.repaired:
                    belief[j], sure[joint], alike[j] = bounds[joint].mended(belief[j]), None, 0.0
                    repairs.append(Repair(at=event.at, joint=joint, probability=1.0))
            continue
        without = belief.sum(axis=(1, 2))
        foretold = [_three(row, own) for row, own in zip(without, alike, strict=True)]
        worn_before = (without * is_worn).sum(axis=1)
        known = np.array([bool(course) and course[-1].p_worn >= SURE for course in courses.values()])
        expected = REPAIRS * passed + known * (REPAIRS_OF_WORN - REPAIRS) * min(passed, SOON)
        share = -np.expm1(-expected)[:, None, None, None]
        mended = np.array([bounds[name].mended(belief[j]) for j, name in enumerate(names)])
        belief = (1.0 - share) * belief + share * mended
        answer = taught.apply(event.answer)
        belief = belief * weigh(belief, read_answer(answer, bounds))
        belief = belief / belief.sum(axis=(1, 2, 3), keepdims=True)
        marginal = belief.sum(axis=(1, 2))
        p_worn = np.minimum((marginal * is_worn).sum(axis=1), 1.0)
        moved = p_worn - worn_before
        shared = ALIKE_OF_ERROR * np.array([error_of(answer, name) for name in names])
        alike = alike + gain_of(without, marginal) * (shared - alike)
        for j, name in enumerate(names):
            low, median, high = _three(marginal[j], alike[j])
            ends = (foretold[j][0], foretold[j][2])
            point = CoursePoint(
                at=event.at, p_worn=float(p_worn[j]), clearance_um=median, interval_um=(low, high), foretold_um=ends
            )
            courses[name].append(point)
            if p_worn[j] >= SURE:
                sure[name] = sure[name] or event.at
            elif p_worn[j] < UNWORN:
                if sure[name]:
                    at = _greatest_fall(courses[name])
                    repairs.append(Repair(at=at, joint=name, probability=1.0 - float(p_worn[j])))
                sure[name] = None
    heard = [event for event in events if isinstance(event, Visit)]
    last = events[-1].at
    return WearState(
        at=last,
        visits=len(heard),
        joints=_tell(belief.sum(axis=1), alike, last, bounds, sure, moved, courses),
        causes=follow_causes([(visit.at, visit.answer) for visit in heard]),
        repairs=tuple(repairs),
    )


def _check(visits: Sequence[Visit], inspections: Sequence[Inspection], names: Sequence[str]) -> None:
    if not visits:
        raise DiagnosisError("visits: none: a state of wear needs at least one recording")
    for visit in visits:
        for joint in visit.answer.joints:
            if joint not in names:
                raise DiagnosisError(f"visits: joint {joint}: must be one of {', '.join(names)}")
    for found in inspections:
        for joint in sorted(found.joints.keys() | found.repaired):
            if joint not in names:
                raise DiagnosisError(f"inspection: joints.{joint}: must be one of {', '.join(names)}")


def _greatest_fall(course: Sequence[CoursePoint]) -> datetime:
    """Moment of the recording, after the last one that was sure of wear, that said most against it."""
    last = max(place for place, point in enumerate(course) if point.p_worn >= SURE)
    odds = logit(np.clip([point.p_worn for point in course[last:]], 1e-9, 1.0 - 1e-9))
    return course[last + 1 + int(np.diff(odds).argmin())].at


def _three(marginal: FloatArray, alike: float) -> tuple[float, float, float]:
    """Quantiles 0.05, 0.5 and 0.95 of a clearance, um, beside so much of its logarithm that recordings have wrong."""
    low, median, high = (1e6 * quantiles(marginal, _SHARES, math.hypot(ALIKE, alike))).tolist()
    return low, median, high


def _tell(
    belief: FloatArray,
    alike: FloatArray,
    last: datetime,
    bounds: Mapping[str, JointBounds],
    sure: Mapping[str, datetime | None],
    moved: FloatArray,
    courses: Mapping[str, Sequence[CoursePoint]],
) -> dict[str, JointFollowed]:
    """What is said of joints (J, S, X) at last."""
    limits = np.array([each.limit for each in bounds.values()])
    over, times = reach(belief, limits, np.hypot(ALIKE, alike), _SHARES)
    found = {}
    for j, (name, own) in enumerate(bounds.items()):
        marginal = belief[j].sum(axis=0)
        low, median, high = _three(marginal, alike[j])
        early, likely, late = (
            last + timedelta(seconds=seconds) if seconds < math.inf else None for seconds in times[j].tolist()
        )
        found[name] = JointFollowed(
            p_worn=min(1.0, float(marginal[own.worn].sum())),
            p_over_limit=float(over[j]),
            clearance_um=median,
            interval_um=(low, high),
            um_per_year=1e6 * YEAR * median_rate(belief[j]),
            limit_um=round(1e6 * own.limit, 6),
            limit_at=(early, likely, late),
            first_sure_at=sure[name],
            moved_by=float(moved[j]),
            course=tuple(courses[name]),
        )
    return found
