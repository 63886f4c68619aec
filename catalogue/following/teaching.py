"""What inspections of machines of one kind teach about answers: how sure they may be, and how wide intervals must be.

Catalogues promise what holds for machines as they were drawn. Where real ones differ, findings say by how much answers
are too sure: few of them correct little, none nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, JointClearance, RankedHypothesis
from jointplay.catalogue.following.evidence import HALF_90, MEASURED
from jointplay.catalogue.matching.prior import Prior
from jointplay.solver.arrays import FloatArray

COOLER = 0.7
"""Scale of ln(temperature), at least 0, before any finding."""

SHIFT = 0.1
"""Standard deviation of what ln(clearance) is off by in all answers, before any finding."""

BELIEVED = 2.0
"""Findings that the width of intervals as answered counts as."""

WRONG, WRONG_SCATTER = 0.03, 1.5
"""Share of findings that are wrong - another joint, another unit -, and how far off ln(clearance) then is."""

WIDE_FIRST = 3.0
"""Width from which the search begins: from a narrow one, all that is off would count as wrong."""

NOTICED = 0.9
"""Probability from which on a finding is said to be wrong."""

# Never surer than the catalogue says.
_TEMPERATURES: FloatArray = np.exp(np.linspace(0.0, 3.0 * COOLER, 141))


@dataclass(frozen=True)
class Lesson:
    """An answer, and what was then found at a joint.

    Parameters
    ----------
    answer : Answer
    joint : str
    clearance : float
        Radial, m.
    worn : bool
        Whether that is more than a fit.
    """

    answer: Answer
    joint: str
    clearance: float
    worn: bool


@dataclass(frozen=True)
class Correction:
    """What is done to answers.

    Parameters
    ----------
    temperature : float
        What the evidence for and against wear is divided by, as a logarithm.
    shift, widening : float
        What is added to ln(clearance), and what its standard deviation multiplies by.
    lessons : int
        Findings that taught it.
    wrong : tuple of int
        Places of those that no answer can have meant.
    """

    temperature: float = 1.0
    shift: float = 0.0
    widening: float = 1.0
    lessons: int = 0
    wrong: tuple[int, ...] = ()

    def apply(self, answer: Answer) -> Answer:
        """Return an answer with hypotheses as sure, and clearances as uncertain, as findings allow."""
        if not self.lessons:
            return answer
        shares = _tempered(answer, np.array([self.temperature]))[0].tolist()
        ranked = [
            RankedHypothesis(
                label=match.label,
                joints={name: self._moved(found) for name, found in match.joints.items()},
                probability=min(1.0, share),
                distance_db=match.distance_db,
            )
            for match, share in zip(answer.hypotheses, shares, strict=True)
        ]
        return answer.model_copy(update={"hypotheses": tuple(ranked)})

    def _moved(self, found: JointClearance) -> JointClearance:
        middle = found.clearance_um * math.exp(self.shift)
        low, high = (middle * (end / found.clearance_um) ** self.widening for end in found.interval_um)
        return JointClearance(clearance_um=middle, interval_um=(low, high))


def learn_from(lessons: Sequence[Lesson]) -> Correction:
    """Return what findings teach.

    A temperature of evidence and one shift and width of all clearances, each with what is believed of it beforehand; a
    finding counts as far as it is likelier to be right than wrong.

    Parameters
    ----------
    lessons : sequence of Lesson
        Of machines of one kind, answered by catalogues of one kind.
    """
    if not lessons:
        return Correction()
    away, scatter = np.array([_misses(lesson) for lesson in lessons]).T
    says = np.array([_probability_of_truth(lesson) for lesson in lessons])
    shift, width = 0.0, WIDE_FIRST
    right = np.ones(len(lessons))
    share = np.exp(-0.5 * (np.log(_TEMPERATURES) / COOLER) ** 2)
    share /= share.sum()
    for _ in range(30):
        spread = np.where(np.isfinite(away), width * scatter, 1.0)
        fits = np.where(np.isfinite(away), _normal(away - shift, spread), 1.0)
        strays = np.where(np.isfinite(away), _normal(away, np.hypot(spread, WRONG_SCATTER)), 1.0)
        true = np.exp(np.log(says) @ share)
        right = (1.0 - WRONG) * fits * true / ((1.0 - WRONG) * fits * true + WRONG * strays * 0.5)
        known = np.isfinite(away)
        weight = right[known] / (width * scatter[known]) ** 2
        shift = float(weight @ away[known] / (weight.sum() + SHIFT**-2))
        squares = right[known] * ((away[known] - shift) / scatter[known]) ** 2
        count = float(right[known].sum())
        # Widened by what so few findings leave open of it.
        width = math.sqrt(
            (BELIEVED + squares.sum()) / (BELIEVED + count) * (1.0 + 2.0 * count / (BELIEVED + count) ** 2)
        )
        cost = -right @ np.log(says) + 0.5 * (np.log(_TEMPERATURES) / COOLER) ** 2
        share = np.exp(cost.min() - cost)
        share /= share.sum()
    temperature = float(np.exp(share @ np.log(_TEMPERATURES)))
    wrong = tuple(int(place) for place in np.flatnonzero(right < 1.0 - NOTICED))
    return Correction(temperature, shift, max(1.0, width), len(lessons), wrong)


def _normal(away: FloatArray, scatter: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (away / scatter) ** 2) / scatter)


def _tempered(answer: Answer, temperatures: FloatArray) -> FloatArray:
    """Probabilities (t, H) of all hypotheses where the evidence is divided by temperatures (t,)."""
    prior = Prior(answer.prior.worn, answer.prior.another, answer.prior.joints)
    most = max(len(match.joints) for match in answer.hypotheses)
    before = np.log([prior.weight(match.joints, len(answer.joints), most) for match in answer.hypotheses])
    found = np.log(np.maximum([match.probability for match in answer.hypotheses], 1e-12))
    weights = before + (found - before) / temperatures[:, None]
    shares = np.exp(weights - weights.max(axis=1, keepdims=True))
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


def _probability_of_truth(lesson: Lesson) -> FloatArray:
    """Probability (t,) that an answer has of what was found, worn or not, at each temperature of the grid."""
    names_it = np.array([lesson.joint in match.joints for match in lesson.answer.hypotheses])
    worn = _tempered(lesson.answer, _TEMPERATURES)[:, names_it].sum(axis=1)
    return np.asarray(np.clip(worn if lesson.worn else 1.0 - worn, 1e-9, 1.0))


def _misses(lesson: Lesson) -> tuple[float, float]:
    """How far ln(clearance) as found is from that of the answer, and its scatter; nan where the joint is not worn."""
    estimates = [match.joints[lesson.joint] for match in lesson.answer.hypotheses if lesson.joint in match.joints]
    if not lesson.worn or not estimates:
        return math.nan, math.nan
    told = estimates[0]  # of the most probable hypothesis in which it is worn
    low, high = told.interval_um
    away = math.log(1e6 * lesson.clearance / told.clearance_um)
    end = high / told.clearance_um if away > 0.0 else told.clearance_um / low
    part, size = MEASURED
    return away, math.hypot(math.log(end) / HALF_90, part, size / lesson.clearance)
