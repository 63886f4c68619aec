"""A diagnosis as the HTTP interface answers it."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, Field

from jointplay.app.storage.store import DiagnosisRow
from jointplay.catalogue.diagnosing.answer import Answer


class _Stored(BaseModel):
    """What an answer has besides when it is stored; a base of its own, so that it comes first."""

    id: str
    created_at: datetime
    measurement: str = Field(description="Id of the measurement.")
    asset: str | None = Field(description="External id of the machine that was measured, where the request named it.")


class DiagnosisOut(Answer, _Stored):
    """A finished diagnosis."""

    id: str
    catalogue: str = Field(description="Id of the catalogue as it was then; one that has grown has another.")


def diagnosis_out(row: DiagnosisRow) -> DiagnosisOut:
    """Return the outside shape of a stored diagnosis."""
    stored = {
        "id": row.id,
        "created_at": row.created_at,
        "measurement": row.measurement,
        "asset": row.request.get("asset"),
        "catalogue": row.catalogue,
    }
    members = {name: value for name, value in row.answer if name != "hash"}
    return DiagnosisOut.model_validate({**members, **stored})
