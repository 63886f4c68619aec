"""Figures of merit of diagnoses whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from jointplay.catalogue.diagnosing.answer import Diagnosis, Verdict
from jointplay.catalogue.evaluation.joint_figures import (
    JointAnswer,
    JointFigures,
    credibility_of,
    joint_answers,
    joint_figures,
)
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.catalogue.matching.calibration import calibration_error, log_loss
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.solver.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Answered:
    """What was true of one recording, and what was answered.

    Parameters
    ----------
    label : str
        The true hypothesis.
    worn : frozenset of str
        Joints that are worn.
    clearances_um : mapping of str to float
    probabilities : mapping of str to float
        Of every hypothesis in the catalogue.
    joint_probabilities : mapping of str to float
    found : mapping of str to (float, float, float)
        Clearance, and its interval's ends, of the joints of the most probable hypothesis, um.
    candidates : tuple of str
    verdict : {"worn", "in_order", "changed", "unknown"}
    p_value : float
        Of the explanation that the verdict rests on: in the mode that answered.
    trusted_p_value : float or None
        Of the explanation by the trusted model; None where it was not asked.
    seconds : float
        Of the answer.
    simulations : int
        Cases simulated for it.
    hidden : bool
        The recording cannot be told from one of the same machine in order, see
        :mod:`jointplay.catalogue.evaluation.recordings`.
    joints : tuple of JointAnswer
        Every joint by itself.
    credibility : float or None
        Of all clearances at once, see :func:`jointplay.catalogue.evaluation.joint_figures.credibility_of`.
    causes : tuple of str
        Causes other than play that are true, in the words of answers.
    cause : str
        The first one that was told; empty for none.
    flawed, accused : frozenset of str
        Sensors that are flawed; those the answer names.
    """

    label: str
    worn: frozenset[str]
    clearances_um: Mapping[str, float]
    probabilities: Mapping[str, float]
    joint_probabilities: Mapping[str, float]
    found: Mapping[str, tuple[float, float, float]]
    candidates: tuple[str, ...]
    verdict: Verdict
    p_value: float
    trusted_p_value: float | None
    seconds: float
    simulations: int
    hidden: bool = False
    joints: tuple[JointAnswer, ...] = ()
    credibility: float | None = None
    causes: tuple[str, ...] = ()
    cause: str = ""
    flawed: frozenset[str] = frozenset()
    accused: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, truth: Truth, answer: Diagnosis, result: MatchResult, fits: Mapping[str, FloatArray], seconds: float
    ) -> Self:
        """Keep of an answer, and of the posterior behind it, what figures are made of.

        Parameters
        ----------
        truth : Truth
        answer : Diagnosis
        result : MatchResult
            The posterior.
        fits : mapping of str to ndarray
            Plays [m] that each joint has where it is not worn.
        seconds : float
            Of the answer.
        """
        best = answer.hypotheses[0]
        return cls(
            label=truth.hypothesis.label,
            worn=frozenset(truth.hypothesis.joints),
            clearances_um={joint: 1e6 * value for joint, value in truth.clearances.items()},
            probabilities={each.label: each.probability for each in answer.hypotheses},
            joint_probabilities=dict(answer.joint_probabilities),
            found={joint: (each.clearance_um, *each.interval_um) for joint, each in best.joints.items()},
            candidates=answer.candidate_set,
            verdict=answer.verdict,
            p_value=answer.goodness_of_fit.p_value,
            trusted_p_value=answer.mode.trusted_p_value,
            seconds=seconds,
            simulations=answer.effort_spent.simulations,
            joints=joint_answers(truth, answer, result),
            credibility=credibility_of(truth, result, fits),
            causes=truth.causes,
            cause=answer.causes[0].name if answer.causes else "",
            flawed=frozenset(truth.flaw.sensors if truth.flaw else ()),
            accused=frozenset(sensor for flaw in answer.sensors for sensor in flaw.sensors),
        )

    @property
    def first(self) -> str:
        """The most probable hypothesis."""
        return max(self.probabilities, key=lambda label: self.probabilities[label])


@dataclass(frozen=True)
class ReliabilityBin:
    """Answers whose first probability lies between `low` and `high`: how many, how sure, and how often right."""

    low: float
    high: float
    count: int
    confidence: float | None
    right: float | None


@dataclass(frozen=True)
class JointScore:
    """One joint called worn where its probability is above one half: precision, recall and their harmonic mean."""

    joint: str
    precision: float | None
    recall: float | None
    f1: float | None


@dataclass(frozen=True)
class FiguresOfMerit:
    """Figures of merit over a set of recordings; None where there is nothing to count.

    Parameters
    ----------
    count : int
    top1, top2 : float or None
        Share with the true hypothesis first; among the first two. None where no truth is in the catalogue.
    joints_in_top2 : float or None
        Share with every worn joint in one of the first two hypotheses.
    exact_set : float or None
        Share whose first hypothesis has exactly the worn joints.
    log_loss, calibration_error : float or None
        Mean of -ln p(truth); expected error of the first probability, ten bins.
    reliability : tuple of ReliabilityBin
    clearance_median, clearance_p90 : float or None
        |estimate / truth - 1| over all worn joints where the true hypothesis came first: median and 90 % quantile.
    interval_coverage : float or None
        Share of those with the truth inside the 90 % interval.
    set_coverage, set_size : float or None
        Share with the truth in the candidate set; its mean size.
    unknown, changed, in_order : float or None
        Share with these verdicts.
    wrong_verdict : float or None
        Share called in order that is worn, or called worn that is not.
    auroc_deciding, auroc_trusted : float or None
        Probability that a recording of this set has a smaller p-value than a listed one: of the mode that answered, of
        the trusted model.
    rejected : float or None
        Share with a deciding p-value below a limit that at most 5 % of the listed ones are below.
    joints : tuple of JointScore
    labels, columns : tuple of str
        Rows and columns of `confusion`: truths, and first hypotheses.
    confusion : tuple of tuple of int
    seconds_median, seconds_worst : float or None
        Of one answer, preparation of the recording left out; the worst includes learning for a new noise level.
    simulations : float or None
        Cases simulated for one answer, mean.
    hidden : int
        Recordings of worn machines that cannot be told from the same machines in order.
    exact_of_seen : float or None
        As `exact_set`, without those.
    joint_posterior : JointFigures
        Of every joint by itself.
    at_least : float or None
        Share of worn joints beyond the largest clearance that the catalogue tells that are told "at least".
    cause_right : float or None
        Share of recordings with a cause other than play whose first cause is a true one.
    cause_wrong : float or None
        Share of all recordings whose first cause is not a true one.
    sensors_right : float or None
        Share of recordings of flawed sensors whose answer names all of them.
    sensors_wrong : float or None
        Share of all recordings whose answer names sensors that are in order.
    """

    count: int
    top1: float | None
    top2: float | None
    joints_in_top2: float | None
    exact_set: float | None
    log_loss: float | None
    calibration_error: float | None
    reliability: tuple[ReliabilityBin, ...]
    clearance_median: float | None
    clearance_p90: float | None
    interval_coverage: float | None
    set_coverage: float | None
    set_size: float | None
    unknown: float | None
    changed: float | None
    in_order: float | None
    wrong_verdict: float | None
    auroc_deciding: float | None
    auroc_trusted: float | None
    rejected: float | None
    joints: tuple[JointScore, ...]
    labels: tuple[str, ...]
    columns: tuple[str, ...]
    confusion: tuple[tuple[int, ...], ...]
    seconds_median: float | None
    seconds_worst: float | None
    simulations: float | None
    hidden: int
    exact_of_seen: float | None
    joint_posterior: JointFigures
    at_least: float | None
    cause_right: float | None
    cause_wrong: float | None
    sensors_right: float | None
    sensors_wrong: float | None


def figures(
    answers: Sequence[Answered],
    joints_of: Mapping[str, frozenset[str]],
    listed: Sequence[Answered] = (),
    largest_um: float = math.inf,
) -> FiguresOfMerit:
    """Return the figures of some answers.

    Parameters
    ----------
    answers : sequence of Answered
        All of one catalogue.
    joints_of : mapping of str to frozenset of str
        Worn joints of every hypothesis that was compared, in the order of the columns of the confusion matrix.
    listed : sequence of Answered
        Recordings that a hypothesis of the catalogue explains: what p-values are told apart from.
    largest_um : float
        Largest clearance that the catalogue tells.
    """
    columns = tuple(joints_of)
    labels = tuple(dict.fromkeys([*(label for label in columns if any(a.label == label for a in answers))]))
    labels += tuple(dict.fromkeys(answer.label for answer in answers if answer.label not in columns))
    confusion = np.zeros((len(labels), len(columns)), dtype=np.int64)
    for answer in answers:
        confusion[labels.index(answer.label), columns.index(answer.first)] += 1
    known = [answer for answer in answers if answer.label in joints_of]
    truth = np.array([columns.index(answer.label) for answer in known], dtype=np.int64)
    posterior = np.array([[answer.probabilities[label] for label in columns] for answer in known])
    posterior = posterior.reshape(len(known), len(columns))
    rank = np.argsort(np.argsort(-posterior, axis=1, kind="stable"), axis=1, kind="stable")
    place = rank[np.arange(len(truth)), truth]
    errors, inside = clearance_errors(answers)
    seconds = [answer.seconds for answer in answers]
    beyond = [joint for answer in answers for joint in answer.joints if joint.worn and joint.clearance_um > largest_um]
    return FiguresOfMerit(
        count=len(answers),
        top1=_mean(place == 0),
        top2=_mean(place <= 1),
        joints_in_top2=_mean([answer.worn <= _first_two(answer, joints_of) for answer in answers]),
        exact_set=_mean([joints_of[answer.first] == answer.worn for answer in answers]),
        log_loss=log_loss(posterior, truth) if known else None,
        calibration_error=calibration_error(posterior, truth) if known else None,
        reliability=reliability(posterior.max(axis=1), posterior.argmax(axis=1) == truth) if known else (),
        clearance_median=float(np.median(errors)) if errors else None,
        clearance_p90=float(np.quantile(errors, 0.9)) if errors else None,
        interval_coverage=_mean(inside),
        set_coverage=_mean([answer.label in answer.candidates for answer in known]),
        set_size=_mean([len(answer.candidates) for answer in answers]),
        unknown=_mean([answer.verdict == "unknown" for answer in answers]),
        changed=_mean([answer.verdict == "changed" for answer in answers]),
        in_order=_mean([answer.verdict == "in_order" for answer in answers]),
        wrong_verdict=_mean([answer.verdict == ("in_order" if answer.worn else "worn") for answer in answers]),
        auroc_deciding=auroc([-answer.p_value for answer in answers], [-answer.p_value for answer in listed]),
        auroc_trusted=auroc(_select_trusted(answers), _select_trusted(listed)),
        rejected=count_rejected([answer.p_value for answer in answers], [answer.p_value for answer in listed]),
        joints=joint_scores(answers),
        labels=labels,
        columns=columns,
        confusion=tuple(tuple(int(n) for n in row) for row in confusion),
        seconds_median=float(np.median(seconds)) if seconds else None,
        seconds_worst=float(np.max(seconds)) if seconds else None,
        simulations=_mean([answer.simulations for answer in answers]),
        hidden=sum(answer.hidden for answer in answers),
        exact_of_seen=_mean([joints_of[answer.first] == answer.worn for answer in answers if not answer.hidden]),
        joint_posterior=joint_figures(
            [answer.joints for answer in answers], [answer.credibility for answer in answers]
        ),
        at_least=_mean([joint.bound == "at_least" for joint in beyond]),
        cause_right=_mean([answer.cause in answer.causes for answer in answers if answer.causes]),
        cause_wrong=_mean([bool(answer.cause) and answer.cause not in answer.causes for answer in answers]),
        sensors_right=_mean([answer.flawed <= answer.accused for answer in answers if answer.flawed]),
        sensors_wrong=_mean([bool(answer.accused - answer.flawed) for answer in answers]),
    )


def clearance_errors(answers: Sequence[Answered]) -> tuple[list[float], list[bool]]:
    """Return |estimate / truth - 1|, and whether the interval holds the truth, where the true hypothesis came first."""
    errors: list[float] = []
    inside: list[bool] = []
    for answer in answers:
        if answer.first == answer.label:
            for joint, (value, low, high) in answer.found.items():
                true = answer.clearances_um[joint]
                errors.append(abs(value / true - 1.0))
                inside.append(low <= true <= high)
    return errors, inside


def reliability(confidence: FloatArray, right: BoolArray, bins: int = 10) -> tuple[ReliabilityBin, ...]:
    """Return how sure and how often right answers are, in equally wide bins of their first probability."""
    index = np.minimum((confidence * bins).astype(np.int64), bins - 1)
    return tuple(
        ReliabilityBin(
            k / bins, (k + 1) / bins, int(np.sum(index == k)), _mean(confidence[index == k]), _mean(right[index == k])
        )
        for k in range(bins)
    )


def joint_scores(answers: Sequence[Answered]) -> tuple[JointScore, ...]:
    """Return precision, recall and F1 of every joint."""
    scores = []
    for joint in sorted({joint for answer in answers for joint in answer.joint_probabilities}):
        called = np.array([answer.joint_probabilities.get(joint, 0.0) > 0.5 for answer in answers], dtype=bool)
        worn = np.array([joint in answer.worn for answer in answers], dtype=bool)
        hits = float(np.sum(called & worn))
        total = float(called.sum() + worn.sum())
        f1 = 2.0 * hits / total if total else None
        scores.append(JointScore(joint, _mean(worn[called]), _mean(called[worn]), f1))
    return tuple(scores)


def _select_trusted(answers: Sequence[Answered]) -> list[float]:
    return [-answer.trusted_p_value for answer in answers if answer.trusted_p_value is not None]


def _first_two(answer: Answered, joints_of: Mapping[str, frozenset[str]]) -> frozenset[str]:
    ranked = sorted(answer.probabilities, key=lambda label: -answer.probabilities[label])
    return frozenset().union(*(joints_of[label] for label in ranked[:2]))


def _mean(values: Sequence[float] | Sequence[bool] | NDArray[np.generic]) -> float | None:
    return float(np.mean(np.asarray(values, dtype=np.float64))) if len(values) else None


def auroc(positive: Sequence[float], negative: Sequence[float]) -> float | None:
    """Return the probability that a positive scores higher than a negative, ties counting one half; None without any.

    Area under the receiver operating characteristic, by ranks (Hanley and McNeil, Radiology 143 (1982) 29).
    """
    if not len(positive) or not len(negative):
        return None
    ranks = rankdata(np.concatenate([positive, negative]))
    n = len(positive)
    return float((ranks[:n].sum() - 0.5 * n * (n + 1)) / (n * len(negative)))


def count_rejected(foreign: Sequence[float], listed: Sequence[float], false_alarms: float = 0.05) -> float | None:
    """Return the share of p-values below the highest limit that at most the share `false_alarms` of `listed` is below.

    None without any. Values that are tied at the limit are not below it.
    """
    if not len(foreign) or not len(listed):
        return None
    limit = np.sort(listed)[int(false_alarms * len(listed) + 1e-9)]
    return float(np.mean(np.asarray(foreign) < limit))
