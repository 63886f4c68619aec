"""From a recording and a catalogue to ranked hypotheses, with how sure, how well they fit, and why."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import get_args

from jointplay.catalogue.diagnosing.answer import (
    Cause,
    Diagnosis,
    EffortSpent,
    GoodnessOfFit,
    MatcherIdentity,
    ModeUsed,
    PriorUsed,
    Provenance,
    SensorFlaw,
)
from jointplay.catalogue.diagnosing.as_found import refine
from jointplay.catalogue.diagnosing.baseline import KnownMachine, fit_baseline
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of, watched_levels
from jointplay.catalogue.diagnosing.joint_states import edge_warnings, joint_states
from jointplay.catalogue.diagnosing.separation import suggest
from jointplay.catalogue.diagnosing.verdict import (
    SURE_ABOVE,
    evidence,
    find_causes,
    hypothesis_shown,
    judge,
    needs_cause,
    number_warnings,
    rival_of,
    speed_warnings,
)
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import DOUBTED_BELOW, ModelLibrary, Observed, library_of, one_thread
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import with_filed_suspension
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.version import __version__

MOST_CASES = 100_000
"""Cases that an effort of thorough may ask for, at most: some hours."""

CLEAR = 0.99
"""Probability of the first hypothesis from which on nothing more is suggested."""


@dataclass(frozen=True)
class Question:
    """How a recording is to be diagnosed.

    Parameters
    ----------
    effort : {"fast", "standard", "thorough"}
        ``fast`` looks the answer up in a model for about this noise, ``standard`` refits what that leaves open to the
        noise of the recording where no network knows it, and looks for causes other than play where none is needed,
        too; ``thorough`` also simulates the machine as found where that can change the answer.
    mode : {"auto", "trusted", "robust"}
        Whether the machine is taken to be as simulated, or to differ from it in whatever the catalogue varies;
        ``auto`` trusts the model unless it does not explain the recording.
    coverage : float
        Probability the candidate set is to hold, in (0, 1).
    cases : int
        Cases that ``thorough`` may simulate, > 0.
    prior : Prior
        Which joints are likely to wear, and how many at once.

    Raises
    ------
    DiagnosisError
        A setting breaks a rule.
    """

    effort: Effort = "standard"
    mode: ModeAsked = "auto"
    coverage: float = 0.95
    cases: int = 2304
    prior: Prior = field(default_factory=Prior)

    def __post_init__(self) -> None:
        if not 0.0 < self.coverage < 1.0:
            raise DiagnosisError(f"coverage: {self.coverage}: must be between 0 and 1")
        if not 0 < self.cases <= MOST_CASES:
            raise DiagnosisError(f"cases: {self.cases}: must be a whole number from 1 to {MOST_CASES}")
        for name, known in (("effort", get_args(Effort)), ("mode", get_args(ModeAsked))):
            if getattr(self, name) not in known:
                *first, last = known
                raise DiagnosisError(f"{name}: {getattr(self, name)}: must be {', '.join(first)} or {last}")


def diagnose(
    measurement: Recording | MeasuredSpectrum,
    catalogue: Catalogue,
    *,
    speed: float | None = None,
    effort: Effort = "standard",
    mode: ModeAsked = "auto",
    mapping: Mapping[str, str] | None = None,
    coverage: float = 0.95,
    cases: int = 2304,
    prior: Prior | None = None,
    baseline: Recording | None = None,
    library: ModelLibrary | None = None,
) -> Diagnosis:
    """Say which joints are worn, by how much, and how sure that is.

    Parameters
    ----------
    measurement : Recording or MeasuredSpectrum
        Recording of sensors on the frame, or spectra of them.
    catalogue : Catalogue
        Of the same machine.
    speed : float, optional
        Drive speed, rad/s; estimated from the recording where it is not given.
    effort, mode, coverage, cases, prior
        See :class:`Question`.
    mapping : mapping of str to str, optional
        Sensor of each column, for columns not named like their sensor.
    baseline : Recording, optional
        Recording of the same machine in order by the same sensors: fits what is uncertain about machine and sensors.
    library : ModelLibrary, optional
        Answers, and keeps what was learned for the next recording; the catalogue's own unless given. One of another
        method is a :class:`jointplay.catalogue.evaluation.cross_checks.MethodLibrary`.

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
    question = Question(effort, mode, coverage, cases, prior or Prior())
    scale = (catalogue.scheme, catalogue.recipe.nominal_drive_speed)
    prepared = prepare(measurement, catalogue.machine, mapping, speed, *scale)
    known = None
    if baseline is not None:
        in_order = prepare(baseline, catalogue.machine, mapping, None, *scale)
        known = KnownMachine(fit_baseline(in_order, catalogue), baseline.sha256)
    shown, _ = answer(
        prepared,
        measurement.sha256,
        catalogue,
        question,
        mapping=mapping,
        known=known,
        suggesting=effort != "fast",
        library=library,
    )
    return shown


def answer(
    prepared: PreparedMeasurement,
    sha256: str,
    catalogue: Catalogue,
    question: Question,
    *,
    mapping: Mapping[str, str] | None = None,
    known: KnownMachine | None = None,
    suggesting: bool = False,
    library: ModelLibrary | None = None,
    without: tuple[str, ...] = (),
    most: int | None = None,
) -> tuple[Diagnosis, MatchResult]:
    """Diagnose a recording that has been prepared, and return what the answer was made of, too.

    Parameters
    ----------
    prepared : PreparedMeasurement
    sha256 : str
        Of the recording.
    catalogue : Catalogue
        The one it was prepared for.
    question : Question
    known : KnownMachine, optional
        What a recording of the machine in order has shown.
    suggesting : bool
        Whether to say what would tell the first hypotheses apart, where they are not.
    mapping, library
        As for :func:`diagnose`.
    without : tuple of str
        Hypotheses that are left out.
    most : int, optional
        Entries of a hypothesis that are learned from, at most.

    Returns
    -------
    (Diagnosis, MatchResult)
        The answer, and the posterior that it shows.

    Raises
    ------
    DiagnosisError
        The catalogue holds too little.
    """
    question.prior.check(catalogue.matrix.joints)
    library = library or library_of(catalogue)
    weights = None
    if known:
        prepared = known.baseline.correct(prepared, catalogue.machine)
        # A recording that was converted is of the machine file's frame and supports: no entries are nearer to it.
        if all(step.name != "suspension" for step in prepared.steps):
            weights = known.weights(catalogue)
    look = partial(_match, catalogue=catalogue, library=library, question=question, without=without, most=most)
    sensing, feature, result = look(prepared, weights)
    causes: tuple[NamedCause, ...] = ()
    if not prepared.flaws and (question.effort != "fast" or needs_cause(result)):
        with one_thread():
            causes = find_causes(prepared, catalogue, result)
    p_value, verdict = judge(result, question.coverage, causes, prepared.flaws)
    if causes and causes[0].suspension:
        # Seen as if its frame stood as the file says, a machine shows whether it is worn as well.
        seen = with_filed_suspension(prepared, catalogue.machine, causes[0].suspension)
        other_sensing, other_feature, other = look(seen, None)
        if (other.trusted_p_value or 0.0) > (result.trusted_p_value or 0.0) and not needs_cause(other):
            prepared, sensing, feature, result = seen, other_sensing, other_feature, other
            p_value, verdict = judge(other, question.coverage)
            verdict = verdict if verdict == "worn" and other.p_worn >= SURE_ABOVE else "changed"
    spent = EffortSpent(simulations=0, generations=0, note="")
    if question.effort == "thorough" and library.simulates_anew:
        if prepared.flaws:
            spent = EffortSpent(simulations=0, generations=0, note="the sensors contradict each other")
        elif causes and not causes[0].name.startswith("load"):
            spent = EffortSpent(simulations=0, generations=0, note="the machine is not as its file says")
        elif weights is not None:
            note = "the baseline says more of the machine's numbers than its file, which is simulated"
            spent = EffortSpent(simulations=0, generations=0, note=note)
        else:
            refined = refine(
                prepared,
                Observed(sensing, feature, watched_levels(prepared), prepared.drive_speed),
                catalogue,
                result,
                result.set(question.coverage).labels,
                mode=question.mode,
                prior=question.prior,
                cases=question.cases,
            )
            was_changed, p_before = needs_cause(result), result.trusted_p_value
            result, causes = refined.result, (refined.load,) if refined.load else causes
            spent = EffortSpent(simulations=refined.simulations, generations=refined.generations, note=refined.reason)
            if refined.simulations:
                p_value, verdict = judge(result, question.coverage, causes)
                if was_changed and not (verdict == "worn" and result.p_worn >= SURE_ABOVE):
                    # With a load that the file does not have it is not in order, however well that explains it.
                    verdict = "unknown" if verdict == "unknown" else "changed"
                elif p_before is not None and p_before < DOUBTED_BELOW and verdict == "worn":
                    verdict = "worn" if result.p_worn >= SURE_ABOVE else "unknown"  # as without the simulation
    candidates = result.set(question.coverage)
    warnings = [
        *prepared.warnings,
        *speed_warnings(prepared, catalogue),
        *edge_warnings(result.best, catalogue),
        *result.notes,
        *(known.baseline.warnings if known else ()),
        # Entries count by how near they are to the machine's numbers: then some have to be near.
        *(number_warnings(known.baseline, catalogue) if known and weights is not None else ()),
    ]
    with one_thread():
        joints = joint_states(result, catalogue, question.coverage)
    unclear = suggesting and verdict in ("worn", "in_order") and result.best.probability < CLEAR
    with one_thread():
        suggestions = suggest(catalogue, prepared, result) if unclear else ()
    provenance = Provenance(
        measurement=prepared.name,
        measurement_sha256=sha256,
        catalogue_sha256=catalogue.id,
        machine_sha256=catalogue.machine.content_key,
        solver_version=__version__,
        catalogue_solver_version=catalogue.manifest.versions.get("jointplay", ""),
        matcher=MatcherIdentity(name=library.name, version=library.version, network=result.network),
        recipe=prepared.steps,
    )
    prior = PriorUsed(
        worn=question.prior.worn,
        another=question.prior.another,
        joints=dict(sorted(question.prior.joints.items())),
        numbers=question.prior.numbers(
            len(catalogue.matrix.joints), max(len(match.joints) for match in result.hypotheses)
        ),
    )
    asked = [question.effort, question.mode, question.coverage, *([question.cases] * (question.effort == "thorough"))]
    content = {
        "id": _digest(
            [
                provenance.model_dump(mode="json"),
                prepared.drive_speed,
                dict(mapping or {}),
                asked,
                prior.model_dump(mode="json"),
                # What a sender has said of the file: units, sensitivities, a full scale.
                list(prepared.notes),
                known and [known.sha256, {name: f"{gain.factor:.4g}" for name, gain in known.baseline.gains.items()}],
            ]
        )[:32],
        "machine": catalogue.machine.name,
        "catalogue": catalogue.path.name,
        "drive_speed_rpm": prepared.drive_speed * 30.0 / math.pi,
        "effort": question.effort,
        "effort_spent": spent,
        "mode": ModeUsed(asked=question.mode, used=result.mode, trusted_p_value=result.trusted_p_value),
        "prior": prior,
        "verdict": verdict,
        "joints": joints,
        "hypotheses": tuple(hypothesis_shown(match) for match in result.hypotheses),
        "causes": tuple(
            Cause(name=cause.name, size=cause.size, unit=cause.unit, probability=min(1.0, cause.probability))
            for cause in causes
        ),
        "sensors": tuple(SensorFlaw(sensors=flaw.sensors, kind=flaw.kind, said=flaw.text) for flaw in prepared.flaws),
        "joint_probabilities": result.joint_probabilities(),
        "candidate_set": candidates.labels,
        "coverage": candidates.coverage,
        "widened": candidates.widened,
        "goodness_of_fit": GoodnessOfFit(p_value=p_value),
        "evidence": evidence(prepared, result.best, feature[: sensing.noise.size], rival_of(result)),
        "baseline": known.describe() if known else None,
        "suggestions": suggestions,
        "warnings": tuple(dict.fromkeys(warnings)),
        "provenance": provenance,
    }
    unsigned = Diagnosis.model_validate({**content, "hash": ""})
    return unsigned.model_copy(update={"hash": _digest(unsigned.model_dump(mode="json", exclude={"hash"}))}), result


def _match(
    prepared: PreparedMeasurement,
    weights: FloatArray | None,
    *,
    catalogue: Catalogue,
    library: ModelLibrary,
    question: Question,
    without: tuple[str, ...],
    most: int | None,
) -> tuple[Sensing, FloatArray, MatchResult]:
    """How a recording is seen, its features, and what the catalogue says of them."""
    sensing = exact_sensing(prepared)
    feature = features_of(prepared, sensing)
    result = library.answer(
        sensing,
        feature,
        watched_levels(prepared),
        question.effort,
        question.mode,
        speed=prepared.drive_speed,
        weights=weights,
        without=without,
        most=most,
    )
    return sensing, feature, question.prior.apply(result, len(catalogue.matrix.joints))


def _digest(content: object) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
