"""A diagnosis as the HTTP interface answers it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from jointplay.app.storage.store import DiagnosisRow, aware
from jointplay.catalogue.diagnosing.answer import (
    BaselineShown,
    Cause,
    Effort,
    EffortSpent,
    Evidence,
    GoodnessOfFit,
    Hypothesis,
    JointState,
    ModeUsed,
    PriorUsed,
    Provenance,
    SensorFlaw,
    SuggestionShown,
    Verdict,
)

VERDICT = (
    "`worn`: some joint is; `in_order`: none is; `changed`: the machine is not as its file says, and not by play;"
    " `unknown`: nothing explains the measurement."
)


class DiagnosisOut(BaseModel):
    """A finished diagnosis."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    created_at: datetime
    measurement: str = Field(description="Id of the measurement.")
    asset: str | None = Field(description="External id of the machine that was measured, where the request named it.")
    machine: str
    catalogue: str = Field(description="Id of the catalogue as it was then; one that has grown has another.")
    drive_speed_rpm: float
    effort: Effort = Field(description="How much was computed.")
    effort_spent: EffortSpent = Field(description="What was simulated for this answer alone.")
    mode: ModeUsed = Field(description="How far the model of the machine was believed.")
    prior: PriorUsed = Field(description="What was held likely before the measurement.")
    verdict: Verdict = Field(description=VERDICT)
    joints: Mapping[str, JointState] = Field(
        description="Every joint by itself; of answers from before 2.0 those alone that were found worn."
    )
    hypotheses: tuple[Hypothesis, ...] = Field(description="The most probable first; no joints: no wear.")
    causes: tuple[Cause, ...] = Field(
        description="Other than play, the most probable first; empty: none is needed or known."
    )
    sensors: tuple[SensorFlaw, ...] = Field(description="What is wrong with which sensors.")
    joint_probabilities: Mapping[str, float] = Field(description="Of each joint, to be among the worn ones.")
    candidate_set: tuple[str, ...] = Field(description="Labels of the hypotheses that hold the truth at `coverage`.")
    coverage: float = Field(description="As asked.")
    widened: bool = Field(False, description="No hypothesis was in that set, and it was widened: it holds about that.")
    goodness_of_fit: GoodnessOfFit
    evidence: Evidence
    baseline: BaselineShown | None = Field(description="What a recording of the machine in order said.")
    suggestions: tuple[SuggestionShown, ...] = Field(description="What would tell the first hypotheses apart.")
    warnings: tuple[str, ...]
    provenance: Provenance


def diagnosis_out(row: DiagnosisRow) -> DiagnosisOut:
    """Return the outside shape of a stored diagnosis."""
    own: dict[str, Any] = {
        "id": row.id,
        "created_at": aware(row.created_at),
        "measurement": row.measurement,
        "catalogue": row.catalogue,
        "asset": row.request.get("asset"),
    }
    kept = {name: value for name, value in row.result.items() if name in DiagnosisOut.model_fields}
    return DiagnosisOut.model_validate({**kept, **own})
