"""A machine's state of wear, from all that is known of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np
from scipy.special import logit

from jointplay.catalogue.diagnosing.answer import Answer
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

ALIKE, ALIKE_OF_ERROR = 0.15, 0.85
"""Standard deviation of ln(clearance) of what every recording of a machine has wrong alike; and the part of the error
that a recording gives its own clearance which all others share: docs/decisions/0210."""

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
    _check(visits, inspections, list(bounds))
    taught = correction or Correction()
    events = put_in_order(visits, inspections)
    following = _Following.begin(bounds)
    for event in events:
        passed = following.pass_until(event.at)
        if isinstance(event, Inspection):
            following.inspect(event)
        else:
            following.hear(taught.apply(event.answer), passed)
    heard = [event for event in events if isinstance(event, Visit)]
    return WearState(
        at=events[-1].at,
        visits=len(heard),
        joints=following.tell(),
        causes=follow_causes([(visit.at, visit.answer) for visit in heard]),
        repairs=tuple(following.repairs),
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


@dataclass(eq=False)
class _Joint:
    """What is kept of a joint besides what is believed of its clearance.

    Parameters
    ----------
    bounds : JointBounds
    alike : float
        Standard deviation of ln(clearance) of what its recordings have wrong by a share of their own errors.
    moved : float
        By how much the last recording has changed P(worn).
    sure_since : datetime or None
    course : list of CoursePoint
    """

    bounds: JointBounds
    alike: float = 0.0
    moved: float = 0.0
    sure_since: datetime | None = None
    course: list[CoursePoint] = field(default_factory=list)

    @property
    def error(self) -> float:
        """Standard deviation of ln(clearance) of all that its recordings have wrong alike."""
        return math.hypot(ALIKE, self.alike)

    @property
    def is_sure(self) -> bool:
        """Whether the last recording was sure of wear."""
        return bool(self.course) and self.course[-1].p_worn >= SURE

    def p_worn(self, marginal: FloatArray) -> float:
        """Probability of wear by that of clearances (X,)."""
        return min(1.0, float(marginal[self.bounds.worn].sum()))

    def three(self, marginal: FloatArray) -> tuple[float, float, float]:
        """Quantiles 0.05, 0.5 and 0.95 of the clearance, um, by its probability (X,)."""
        low, median, high = (1e6 * quantiles(marginal, _SHARES, self.error)).tolist()
        return low, median, high

    def when_mended(self) -> datetime:
        """Moment of the recording, after the last one that was sure of wear, that said most against it."""
        last = max(place for place, point in enumerate(self.course) if point.p_worn >= SURE)
        odds = logit(np.clip([point.p_worn for point in self.course[last:]], 1e-9, 1.0 - 1e-9))
        return self.course[last + 1 + int(np.diff(odds).argmin())].at


@dataclass(eq=False)
class _Following:
    """A machine, while what happened to it is gone through in the order of time.

    Parameters
    ----------
    joints : mapping of str to _Joint
    belief : ndarray, shape (J, D, S, X)
        What is believed of all joints.
    at : datetime or None
        Of what happened last.
    repairs : list of Repair
    """

    joints: Mapping[str, _Joint]
    belief: FloatArray
    at: datetime | None = None
    repairs: list[Repair] = field(default_factory=list)

    @classmethod
    def begin(cls, bounds: Mapping[str, JointBounds]) -> _Following:
        """A machine of which nothing is known."""
        belief = np.array([own.at_first() for own in bounds.values()])
        return cls({name: _Joint(own) for name, own in bounds.items()}, belief)

    def pass_until(self, at: datetime) -> float:
        """Let joints wear until a moment, and return the time that has passed, s."""
        passed = (at - self.at).total_seconds() if self.at else 0.0
        worn = np.array([joint.bounds.worn for joint in self.joints.values()])
        self.belief, self.at = let_pass(self.belief, passed, worn[:, None, None]), at
        return passed

    def inspect(self, found: Inspection) -> None:
        """Hear what somebody has measured, and mended."""
        for (name, joint), belief in zip(self.joints.items(), self.belief, strict=True):
            if name in found.joints:
                without = _marginal(belief)
                belief *= read_measured(found.joints[name])
                belief /= belief.sum()
                joint.alike *= 1.0 - float(gain_of(without, _marginal(belief)))
                if joint.p_worn(_marginal(belief)) < UNWORN:
                    joint.sure_since = None
            if name in found.repaired:
                belief[:] = joint.bounds.mended(belief)
                joint.alike, joint.sure_since = 0.0, None
                self.repairs.append(Repair(at=found.at, joint=name, probability=1.0))

    def hear(self, answer: Answer, passed: float) -> None:
        """Hear an answer to a recording, so many seconds after what happened before."""
        assert self.at is not None
        without = _marginal(self.belief)
        self._let_mend(passed)
        self.belief = self.belief * weigh(self.belief, read_answer(answer, self.bounds))
        self.belief = self.belief / self.belief.sum(axis=(1, 2, 3), keepdims=True)
        marginal = _marginal(self.belief)
        gains = gain_of(without, marginal)
        for j, (name, joint) in enumerate(self.joints.items()):
            p_worn, foretold = joint.p_worn(marginal[j]), joint.three(without[j])
            joint.moved = p_worn - joint.p_worn(without[j])
            joint.alike += float(gains[j]) * (ALIKE_OF_ERROR * error_of(answer, name) - joint.alike)
            low, median, high = joint.three(marginal[j])
            joint.course.append(
                CoursePoint(
                    at=self.at,
                    p_worn=p_worn,
                    clearance_um=median,
                    interval_um=(low, high),
                    foretold_um=(foretold[0], foretold[2]),
                )
            )
            if p_worn >= SURE:
                joint.sure_since = joint.sure_since or self.at
            elif p_worn < UNWORN:
                if joint.sure_since:
                    self.repairs.append(Repair(at=joint.when_mended(), joint=name, probability=1.0 - p_worn))
                joint.sure_since = None

    @property
    def bounds(self) -> dict[str, JointBounds]:
        """Of all joints."""
        return {name: joint.bounds for name, joint in self.joints.items()}

    def _let_mend(self, passed: float) -> None:
        """Let joints have been mended without a word in a time, s."""
        known = np.array([joint.is_sure for joint in self.joints.values()])
        expected = REPAIRS * passed + known * (REPAIRS_OF_WORN - REPAIRS) * min(passed, SOON)
        share = -np.expm1(-expected)[:, None, None, None]
        each = zip(self.joints.values(), self.belief, strict=True)
        mended = np.array([joint.bounds.mended(belief) for joint, belief in each])
        self.belief = (1.0 - share) * self.belief + share * mended

    def tell(self) -> dict[str, JointFollowed]:
        """What is said of all joints at last."""
        assert self.at is not None
        belief = self.belief.sum(axis=1)
        errors = np.array([joint.error for joint in self.joints.values()])
        over, times = reach(belief, list(self.bounds.values()), errors, _SHARES)
        found = {}
        for j, (name, joint) in enumerate(self.joints.items()):
            marginal = belief[j].sum(axis=0)
            low, median, high = joint.three(marginal)
            early, likely, late = (
                self.at + timedelta(seconds=seconds) if seconds < math.inf else None for seconds in times[j].tolist()
            )
            found[name] = JointFollowed(
                p_worn=joint.p_worn(marginal),
                p_over_limit=float(over[j]),
                clearance_um=median,
                interval_um=(low, high),
                um_per_year=1e6 * YEAR * median_rate(belief[j]),
                limit_um=round(1e6 * joint.bounds.limit, 6),
                limit_at=(early, likely, late),
                first_sure_at=joint.sure_since,
                moved_by=joint.moved,
                course=tuple(joint.course),
            )
        return found


def _marginal(belief: FloatArray) -> FloatArray:
    """Probability (..., X) of clearances by what is believed of them (..., D, S, X)."""
    return np.asarray(belief.sum(axis=(-3, -2)))
