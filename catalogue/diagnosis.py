"""From a recording and a catalogue to ranked hypotheses, with how sure, how well they fit, and why."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import solver
from catalogue.answer import (
    Diagnosis,
    Effort,
    EffortSpent,
    GoodnessOfFit,
    MatcherIdentity,
    ModeUsed,
    Provenance,
)
from catalogue.comparison import NOISE_STEP_DB, canonical_sensing, measured_levels, watched
from catalogue.errors import DiagnosisError
from catalogue.evidence import edge_warnings, evidence, hypothesis_shown, speed_warnings
from catalogue.features import PreparedMeasurement, prepare
from catalogue.gaussian import GaussianAlongClearance
from catalogue.learning import Learning, MatcherCache
from catalogue.matching import Matcher, MatchResult
from catalogue.measurement import Measurement
from catalogue.modes import Mode, ModeAsked, chosen, judged
from catalogue.nearest import NearestEntry
from catalogue.store import Catalogue

__all__ = ["Question", "answer", "diagnose"]

_CACHE = MatcherCache()


@dataclass(frozen=True)
class Question:
    """How a recording is to be diagnosed.

    Parameters
    ----------
    effort : {"fast", "standard", "thorough"}
        ``fast`` compares with the nearest entries, ``standard`` is the full method, ``thorough`` simulates anew around
        the most probable hypotheses where that can change the answer.
    mode : {"auto", "trusted", "robust"}
        Whether the machine is taken to be as simulated, or to differ from it in whatever the catalogue varies;
        ``auto`` trusts the model unless it does not explain the recording.
    coverage : float
        Probability the candidate set is to hold, in (0, 1).
    budget : float
        Seconds that ``thorough`` may simulate, > 0.

    Raises
    ------
    DiagnosisError
        A setting breaks a rule.
    """

    effort: Effort = "standard"
    mode: ModeAsked = "auto"
    coverage: float = 0.95
    budget: float = 3.5

    def __post_init__(self) -> None:
        if not 0.0 < self.coverage < 1.0:
            raise DiagnosisError(f"coverage: {self.coverage}: must be between 0 and 1")
        if not 0.0 < self.budget < math.inf:
            raise DiagnosisError(f"budget: {self.budget}: must be a finite number of seconds greater than 0")
        for name, known in (("effort", get_args(Effort)), ("mode", get_args(ModeAsked))):
            if getattr(self, name) not in known:
                *first, last = known
                raise DiagnosisError(f"{name}: {getattr(self, name)}: must be {', '.join(first)} or {last}")


def diagnose(
    measurement: Measurement,
    catalogue: Catalogue,
    *,
    speed: float | None = None,
    effort: Effort = "standard",
    mode: ModeAsked = "auto",
    mapping: Mapping[str, str] | None = None,
    coverage: float = 0.95,
    budget: float = 3.5,
    matcher: Matcher | None = None,
    cache: MatcherCache = _CACHE,
) -> Diagnosis:
    """Say which joints are worn, by how much, and how sure that is.

    Parameters
    ----------
    measurement : Measurement
        Recording of sensors on the frame.
    catalogue : Catalogue
        Of the same machine.
    speed : float, optional
        Drive speed, rad/s; estimated from the recording where it is not given.
    effort, mode, coverage, budget
        See :class:`Question`.
    mapping : mapping of str to str, optional
        Sensor of each column, for columns not named like their sensor.
    matcher : Matcher, optional
        In place of the one that `effort` stands for.
    cache : MatcherCache, optional
        Keeps what was learned for the next recording.

    Returns
    -------
    Diagnosis

    Raises
    ------
    MeasurementError
        The recording cannot be compared: no column is a sensor, too short, no drive speed to be found.
    DiagnosisError
        A setting breaks a rule, or the catalogue holds too little.
    """
    question = Question(effort, mode, coverage, budget)
    prepared = prepare(measurement, catalogue.machine, mapping, speed, catalogue.scheme)
    return answer(prepared, measurement.sha256, catalogue, question, mapping=mapping, matcher=matcher, cache=cache)


def answer(
    prepared: PreparedMeasurement,
    sha256: str,
    catalogue: Catalogue,
    question: Question,
    *,
    mapping: Mapping[str, str] | None = None,
    matcher: Matcher | None = None,
    learning: Learning | None = None,
    cache: MatcherCache = _CACHE,
) -> Diagnosis:
    """Diagnose a recording that has been prepared.

    Parameters
    ----------
    prepared : PreparedMeasurement
    sha256 : str
        Of the recording.
    catalogue : Catalogue
        The one it was prepared for.
    question : Question
    mapping, matcher, cache
        As for :func:`diagnose`.
    learning : Learning, optional
        What is learned from.

    Raises
    ------
    DiagnosisError
        The catalogue holds too little.
    """
    method = matcher or (NearestEntry() if question.effort == "fast" else GaussianAlongClearance())
    sensing = canonical_sensing(prepared, catalogue)
    feature = measured_levels(prepared, sensing)

    def match(mode: Mode) -> MatchResult:
        return cache.fitted(catalogue, sensing, watched(prepared), method, learning or Learning()).match(feature)

    choice = chosen(match, question.mode, question.coverage)
    result = choice.result
    warnings = [*prepared.warnings, *speed_warnings(prepared, catalogue), *edge_warnings(result, catalogue)]
    used: Effort = "standard" if question.effort == "thorough" else question.effort
    if used != question.effort:
        warnings.append(f"effort {question.effort} does no more than {used} yet: {used} was used")
    spent = EffortSpent(simulations=0, generations=0, note="")
    p_value, verdict = judged(result, question.coverage)
    provenance = Provenance(
        measurement=prepared.name,
        measurement_sha256=sha256,
        catalogue_sha256=catalogue.id,
        machine_sha256=catalogue.machine.content_key,
        solver_version=solver.__version__,
        catalogue_solver_version=catalogue.manifest.solver_version,
        matcher=MatcherIdentity(name=method.name, version=method.version),
        recipes=_recipes(prepared),
    )
    asked = [question.effort, question.mode, question.coverage, *([question.budget] * (question.effort == "thorough"))]
    content = {
        "id": _digest([provenance.model_dump(mode="json"), prepared.drive_speed, dict(mapping or {}), asked])[:32],
        "machine": catalogue.machine.name,
        "catalogue": catalogue.path.name,
        "drive_speed_rpm": prepared.drive_speed * 30.0 / math.pi,
        "effort": used,
        "effort_spent": spent,
        "mode": ModeUsed(asked=question.mode, used=choice.used, trusted_p_value=choice.trusted_p_value),
        "verdict": verdict,
        "hypotheses": tuple(hypothesis_shown(match) for match in result.hypotheses),
        "joint_probabilities": result.joint_probabilities(),
        "candidate_set": result.candidate_set(question.coverage),
        "coverage": question.coverage,
        "goodness_of_fit": GoodnessOfFit(p_value=p_value),
        "evidence": evidence(prepared, result.best, feature),
        "warnings": tuple(dict.fromkeys(warnings)),
        "provenance": provenance,
    }
    unsigned = Diagnosis.model_validate({**content, "hash": ""})
    return unsigned.model_copy(update={"hash": _digest(unsigned.model_dump(mode="json", exclude={"hash"}))})


def _recipes(prepared: PreparedMeasurement) -> tuple[str, ...]:
    rounding = f"rounded up to steps of {NOISE_STEP_DB:g} dB"
    return (*(str(step) for step in prepared.steps), f"noise put on the catalogue: {rounding}")


def _digest(content: object) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
