"""Shapes of verifications and of the audit log in the HTTP interface's bodies."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from jointplay.app.schemas.resources import Page, Shape


class EvidenceOut(Shape):
    """A recording that a diagnosis was made of."""

    measurement: str
    sha256: str = Field(description="As it was stored; empty where the measurement is not there any more.")
    state: Literal["sound", "damaged", "missing", "deleted"]
    said: str = Field(description="What is wrong; empty where nothing is.")


class CatalogueThen(Shape):
    """The catalogue that a diagnosis was made with."""

    id: str
    name: str
    state: Literal["same", "other", "damaged", "missing", "deleted"] = Field(
        description="other: the catalogue of this name has another content now; missing: there is none of this name."
    )


class VersionPair(Shape):
    """A version of the program's numbers then and now."""

    then: str
    now: str | None = Field(description="Null where it was not repeated.")


class DifferenceOut(Shape):
    """A member of an answer that is another one now."""

    member: str = Field(description='Its path: "joints.B.clearance_um".')
    then: Any
    now: Any


class VerificationOut(Shape):
    """Whether a diagnosis can be relied on as evidence."""

    diagnosis: str
    checksum: str = Field(description="SHA-256 of what is stored of it, which was checked.")
    verified: bool = Field(description="Whether all recordings are sound, and the answer came out the same again.")
    recordings: list[EvidenceOut]
    baselines: list[EvidenceOut]
    catalogue: CatalogueThen
    versions: dict[str, VersionPair] = Field(description="Of solver and matcher.")
    repeated: Literal["equal", "rounding", "differs", "not_repeated"] = Field(
        description="equal: bit for bit; rounding: all numbers within 1e-6 of each other, everything else equal."
    )
    differences: list[DifferenceOut] = Field(description="The first 20 members that are not the same.")
    said: str = Field(description="Why it was not repeated; empty where it was.")


class AuditItem(Shape):
    """One thing that was done."""

    number: int
    at: datetime
    action: str
    kind: str
    object: str
    key: str | None = Field(description="Id of the API key.")
    person: str | None
    address: str = Field(description="Where it came from; empty where the program did it by itself.")
    request_id: str | None
    before: dict[str, Any] | None = Field(description="Checksum of all that was known, and the members that differ.")
    after: dict[str, Any] | None
    previous: str = Field(description="The hash of the row before.")
    hash: str = Field(description="SHA-256 of everything else.")


class AuditPage(Page):
    """A page of the audit log."""

    items: list[AuditItem]
