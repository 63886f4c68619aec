"""What is told of what was heard: the answer with how sure, how well it fits, and why."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence

from jointplay.catalogue.diagnosing.answer import (
    Cause,
    Diagnosis,
    GoodnessOfFit,
    MatcherIdentity,
    ModeUsed,
    PriorUsed,
    Provenance,
    RecordingShare,
    SensorFlaw,
)
from jointplay.catalogue.diagnosing.heard import Heard
from jointplay.catalogue.diagnosing.joint_states import edge_warnings, joint_states
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.separation import suggest
from jointplay.catalogue.diagnosing.verdict import (
    evidence,
    hypothesis_shown,
    number_warnings,
    rival_of,
    speed_warnings,
)
from jointplay.catalogue.matching.model_library import ModelLibrary, one_thread
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.version import __version__

CLEAR = 0.99
"""Probability of the first hypothesis from which on nothing more is suggested."""


def tell(
    heard: Heard,
    catalogue: Catalogue,
    question: Question,
    library: ModelLibrary,
    *,
    mapping: Mapping[str, str] | None = None,
    suggesting: bool = False,
    others: Sequence[PreparedMeasurement] = (),
    recordings: Sequence[RecordingShare] = (),
    warnings: Sequence[str] = (),
    said: Sequence[object] = (),
) -> Diagnosis:
    """Return the answer.

    Parameters
    ----------
    heard : Heard
        What a recording says; of several, what they say together, and else of the first that counts.
    catalogue, question, library, mapping, suggesting
        As for :func:`~jointplay.catalogue.diagnosing.diagnosis.answer`.
    others : sequence of PreparedMeasurement
        Further recordings that count.
    recordings : sequence of RecordingShare
        What each of several has contributed.
    warnings : sequence of str
        Besides those of this recording.
    said : sequence
        What the question consists of besides, as of further recordings.
    """
    prepared, result, known = heard.prepared, heard.result, heard.known
    candidates = result.set(question.coverage)
    told = [
        *warnings,
        *prepared.warnings,
        *speed_warnings(prepared, catalogue),
        *edge_warnings(result.best, catalogue),
        *result.notes,
        *(known.baseline.warnings if known else ()),
        # Entries count by how near they are to the machine's numbers: then some have to be near.
        *(number_warnings(known.baseline, catalogue) if known and heard.weighed else ()),
    ]
    with one_thread():
        joints = joint_states(result, catalogue, question.coverage, question.limits_um)
    unclear = suggesting and heard.verdict in ("worn", "in_order") and result.best.probability < CLEAR
    with one_thread():
        suggestions = suggest(catalogue, prepared, result, others=others) if unclear else ()
    provenance = Provenance(
        measurement=prepared.name,
        measurement_sha256=heard.sha256,
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
                known and [*known.sha256, {name: f"{gain.factor:.4g}" for name, gain in known.baseline.gains.items()}],
                *([dict(sorted(question.limits_um.items()))] if question.limits_um else ()),
                *said,
            ]
        )[:32],
        "machine": catalogue.machine.name,
        "catalogue": catalogue.path.name,
        "drive_speed_rpm": prepared.drive_speed * 30.0 / math.pi,
        "effort": question.effort,
        "effort_spent": heard.spent,
        "mode": ModeUsed(asked=question.mode, used=result.mode, trusted_p_value=result.trusted_p_value),
        "prior": prior,
        "verdict": heard.verdict,
        "joints": joints,
        "hypotheses": tuple(hypothesis_shown(match) for match in result.hypotheses),
        "causes": tuple(
            Cause(
                name=cause.name,
                size=cause.size,
                unit=cause.unit,
                probability=min(1.0, cause.probability),
                since=cause.since,
            )
            for cause in heard.causes
        ),
        "sensors": tuple(SensorFlaw(sensors=flaw.sensors, kind=flaw.kind, said=flaw.text) for flaw in prepared.flaws),
        "joint_probabilities": result.joint_probabilities(),
        "candidate_set": candidates.labels,
        "coverage": candidates.coverage,
        "widened": candidates.widened,
        "goodness_of_fit": GoodnessOfFit(p_value=heard.p_value),
        "evidence": evidence(prepared, result.best, heard.feature[: heard.sensing.noise.size], rival_of(result)),
        "baseline": known.describe(heard=result.beside) if known else None,
        "past": heard.past.describe() if heard.past else None,
        "suggestions": suggestions,
        "recordings": tuple(recordings),
        "warnings": tuple(dict.fromkeys(told)),
        "provenance": provenance,
    }
    unsigned = Diagnosis.model_validate({**content, "hash": ""})
    return unsigned.model_copy(update={"hash": _digest(unsigned.model_dump(mode="json", exclude={"hash"}))})


def _digest(content: object) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
