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
from jointplay.catalogue.following.evidence import Evidence, read_answer, read_measured, weigh
from jointplay.catalogue.following.play import YEAR, JointBounds, let_pass, quantiles, reach
from jointplay.catalogue.following.state import CoursePoint, JointFollowed, Repair, WearState
from jointplay.catalogue.following.teaching import Correction
from jointplay.catalogue.following.visits import Inspection, Visit, put_in_order
from jointplay.solver.arrays import BoolArray, FloatArray

SURE = 0.9
"""Probability of wear, by all recordings up to then, from which on it is sure."""

ALIKE = 0.15
"""Standard deviation of ln(clearance) of what every recording of a machine has wrong alike."""

WHETHER, HOW_MUCH = 0.2, 0.7
"""Powers of what recordings before have said when another one speaks, of whether a joint is worn and of its clearance
if it is: most of what one has wrong others have wrong, too. docs/decisions/0212."""

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
        There is no recording, or no joint that may wear; a time has no zone; or something is said of a joint that is
        not known.
    """
    _check(visits, inspections, list(bounds))
    taught = correction or Correction()
    events = put_in_order(visits, inspections)
    following = _Following.begin(bounds)
    for event in events:
        following.pass_until(event.at)
        if isinstance(event, Inspection):
            following.inspect(event)
        else:
            following.hear(taught.apply(event.answer))
    heard = [event for event in events if isinstance(event, Visit)]
    return WearState(
        at=events[-1].at,
        visits=len(heard),
        joints=following.tell(),
        causes=follow_causes([(visit.at, visit.answer) for visit in heard]),
        repairs=tuple(sorted(following.repairs, key=lambda repair: repair.at)),
    )


def _check(visits: Sequence[Visit], inspections: Sequence[Inspection], names: Sequence[str]) -> None:
    if not visits:
        raise DiagnosisError("visits: none: a state of wear needs at least one recording")
    if not names:
        raise DiagnosisError("joints: none: a state of wear needs at least one that may wear")
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
    found : bool
        Whether somebody has measured or mended it.
    moved : float
        By how much the last recording has changed P(worn).
    sure_since : datetime or None
    course : list of CoursePoint
    acquitted : list of bool
        Whether each recording of the course has spoken against its wear.
    """

    bounds: JointBounds
    found: bool = False
    moved: float = 0.0
    sure_since: datetime | None = None
    course: list[CoursePoint] = field(default_factory=list)
    acquitted: list[bool] = field(default_factory=list)

    def p_worn(self, marginal: FloatArray) -> float:
        """Probability of wear by that of clearances (X,)."""
        return min(1.0, float(marginal[self.bounds.worn].sum()))

    def three(self, marginal: FloatArray) -> tuple[float, float, float]:
        """Quantiles 0.05, 0.5 and 0.95 of the clearance, um, by its probability (X,)."""
        low, median, high = (1e6 * quantiles(marginal, _SHARES, ALIKE)).tolist()
        return low, median, high

    def when_mended(self) -> datetime:
        """Moment of the recording that said most against wear, after the last one that was sure of it."""
        last = max(place for place, point in enumerate(self.course) if point.p_worn >= SURE)
        odds = logit(np.clip([point.p_worn for point in self.course[last:]], 1e-9, 1.0 - 1e-9))
        against = np.where(self.acquitted[last + 1 :], np.diff(odds), math.inf)
        return self.course[last + 1 + int(against.argmin())].at


@dataclass(eq=False)
class _Following:
    """A machine, while what happened to it is gone through in the order of time.

    Parameters
    ----------
    joints : mapping of str to _Joint
    belief : ndarray, shape (J, S, X)
        What is believed of all joints.
    unheard : ndarray, shape (J, S, X)
        The same without recordings: as of any machine, or what has become of what somebody has found, or made.
    at : datetime or None
        Of what happened last.
    repairs : list of Repair
    """

    joints: Mapping[str, _Joint]
    belief: FloatArray
    unheard: FloatArray
    at: datetime | None = None
    repairs: list[Repair] = field(default_factory=list)

    @classmethod
    def begin(cls, bounds: Mapping[str, JointBounds]) -> _Following:
        """A machine of which nothing is known."""
        belief = np.array([own.at_first() for own in bounds.values()])
        return cls({name: _Joint(own) for name, own in bounds.items()}, belief, belief.copy())

    def pass_until(self, at: datetime) -> None:
        """Let joints wear until a moment, and some have been mended without a word."""
        passed = (at - self.at).total_seconds() if self.at else 0.0
        mended = np.array([joint.bounds.as_new() for joint in self.joints.values()])
        found = [joint.found for joint in self.joints.values()]
        self.belief, self.at = let_pass(self.belief, passed, mended), at
        if any(found):
            self.unheard[found] = let_pass(self.unheard[found], passed, mended[found])

    def inspect(self, found: Inspection) -> None:
        """Hear what somebody has measured, and mended."""
        each = zip(self.joints.items(), self.belief, self.unheard, strict=True)
        for (name, joint), belief, unheard in each:
            if name in found.joints:
                for known in (belief, unheard):
                    known *= read_measured(found.joints[name])
                    known /= known.sum()
                joint.found = True
                if joint.p_worn(_marginal(belief)) < UNWORN:
                    joint.sure_since = None
            if name in found.repaired:
                belief[:] = unheard[:] = joint.bounds.as_new()
                joint.found, joint.sure_since = True, None
                self.repairs.append(Repair(at=found.at, joint=name, probability=1.0))

    def hear(self, answer: Answer) -> None:
        """Hear an answer to a recording of now."""
        assert self.at is not None
        without = _marginal(self.belief)
        said = read_answer(answer, self.bounds)
        self.belief *= (self._beside(without, said) / np.maximum(without, 1e-300))[:, None]
        self.belief /= self.belief.sum(axis=(1, 2), keepdims=True)
        marginal = _marginal(self.belief)
        for j, (name, joint) in enumerate(self.joints.items()):
            p_worn, foretold = joint.p_worn(marginal[j]), joint.three(without[j])
            joint.moved = p_worn - joint.p_worn(without[j])
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
            joint.acquitted.append(bool(said.acquits[j]))
            if p_worn >= SURE:
                joint.sure_since = joint.sure_since or self.at
            elif p_worn < UNWORN and said.acquits[j]:  # what is only forgotten was not mended
                if joint.sure_since:
                    self.repairs.append(Repair(at=joint.when_mended(), joint=name, probability=1.0 - p_worn))
                joint.sure_since = None

    def _beside(self, before: FloatArray, evidence: Evidence) -> FloatArray:
        """Return the probability of clearances (J, X) by a recording, beside what others have said (J, X)."""
        worn = np.array([joint.bounds.worn for joint in self.joints.values()])
        unheard = _marginal(self.unheard)
        # Where it tells nothing of any joint, nothing is forgotten.
        whether, how_much = ((1.0 - power) * evidence.tells[:, None] for power in (WHETHER, HOW_MUCH))
        clearances = before ** (1.0 - how_much) * unheard**how_much
        likely = _share(before, worn) ** (1.0 - whether) * _share(unheard, worn) ** whether
        likely = likely / (likely + _share(before, ~worn) ** (1.0 - whether) * _share(unheard, ~worn) ** whether)
        # How likely clearances are made that agree with others says nothing of whether: all err alike.
        said = []
        for shape in (unheard, clearances):
            remembered = _with_share(shape, worn, likely)
            factor, silent = weigh(remembered, evidence)
            said.append((1.0 - silent) * factor * remembered + silent * before)
        return _with_share(said[1], worn, _share(said[0], worn))

    @property
    def bounds(self) -> dict[str, JointBounds]:
        """Of all joints."""
        return {name: joint.bounds for name, joint in self.joints.items()}

    def tell(self) -> dict[str, JointFollowed]:
        """What is said of all joints at last."""
        assert self.at is not None
        limits = np.array([joint.bounds.limit for joint in self.joints.values()])
        over, times = reach(self.belief, limits, ALIKE, _SHARES)
        in_a_year = _marginal(let_pass(self.belief, YEAR))
        found = {}
        for j, (name, joint) in enumerate(self.joints.items()):
            marginal = _marginal(self.belief[j])
            low, median, high = joint.three(marginal)
            early, likely, late = (
                self.at + timedelta(seconds=seconds) if seconds < math.inf else None for seconds in times[j].tolist()
            )
            found[name] = JointFollowed(
                p_worn=joint.p_worn(marginal),
                p_over_limit=float(over[j]),
                clearance_um=median,
                interval_um=(low, high),
                um_per_year=joint.three(in_a_year[j])[1] - median,
                limit_um=round(1e6 * joint.bounds.limit, 6),
                limit_at=(early, likely, late),
                first_sure_at=joint.sure_since if joint.p_worn(marginal) >= UNWORN else None,
                moved_by=joint.moved,
                course=tuple(joint.course),
            )
        return found


def _share(marginal: FloatArray, which: BoolArray) -> FloatArray:
    """Part (J, 1) of the probability of clearances (J, X) that is of those (J, X)."""
    return np.asarray(np.sum(marginal * which, axis=1, keepdims=True))


def _with_share(marginal: FloatArray, which: BoolArray, share: FloatArray) -> FloatArray:
    """Probability of clearances (J, X) of which so much (J, 1) is of those (J, X), else as it was."""
    inside, outside = (np.maximum(_share(marginal, each), 1e-300) for each in (which, ~which))
    return np.where(which, marginal / inside * share, marginal / outside * (1.0 - share))


def _marginal(belief: FloatArray) -> FloatArray:
    """Probability (..., X) of clearances by what is believed of them (..., S, X)."""
    return np.asarray(belief.sum(axis=-2))
