"""Shapes of assets and of findings in the HTTP interface's bodies."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import ConfigDict, Field, model_validator

from jointplay.app.schemas.resources import Page, Shape
from jointplay.app.words import MeasuredAt
from jointplay.catalogue.diagnosing.question import MOST_TOGETHER

EXTERNAL_ID = r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,127}$"
TEXT = r"^[^\x00-\x08\x0b\x0c\x0e-\x1f]*$"  # a database takes no NUL, and nobody wants the others

AssetId = Annotated[str, Field(pattern=EXTERNAL_ID, description="Its name in your own records.")]


class AssetName(Shape):
    """How an asset is called."""

    external_id: AssetId


class AssetIn(Shape):
    """What is known of one machine that stands somewhere."""

    model_config = ConfigDict(json_schema_extra={"example": {"machine": "slider-crank", "notes": "hall 2, line 3"}})

    machine: Annotated[
        str, Field(min_length=1, max_length=200, pattern=TEXT, description="Name of the machine that it is one of.")
    ]
    notes: Annotated[str, Field(default="", max_length=4000, pattern=TEXT)]
    baseline: Annotated[
        str | None,
        Field(
            default=None,
            max_length=64,
            description="Id of a measurement of it in order; every diagnosis of the asset uses it.",
        ),
    ]
    baselines: Annotated[
        list[Annotated[str, Field(max_length=64)]],
        Field(
            default=[],
            max_length=MOST_TOGETHER,
            description="Ids of several such measurements; `baseline` is then the first, or left out.",
        ),
    ]

    @property
    def in_order(self) -> tuple[str, ...]:
        """Ids of its baselines, each once."""
        given = self.baselines or ([] if self.baseline is None else [self.baseline])
        return tuple(dict.fromkeys(given))


class AssetOut(Shape):
    """An asset."""

    external_id: AssetId
    machine: str
    notes: str
    baseline: str | None
    baselines: list[str] = Field(description="All of its baselines, of which `baseline` is the first.")
    created_at: datetime
    updated_at: datetime


class AssetPage(Page):
    """A page of assets."""

    items: list[AssetOut]


class JointFound(Shape):
    """What was measured at one joint."""

    clearance_um: Annotated[
        float,
        Field(
            ge=0, le=1e5, allow_inf_nan=False, strict=True, description="Radial clearance: half of the diametral play."
        ),
    ]
    repaired: Annotated[bool, Field(default=False, strict=True, description="Whether it was as new afterwards.")]


class FindingIn(Shape):
    """What an inspection found; joints, or a text, or both."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "joints": {"B": {"clearance_um": 140}},
                "text": "gudgeon pin worn, replaced",
                "at": "2026-11-21T10:30:00Z",
            }
        }
    )

    joints: Annotated[dict[str, JointFound], Field(default={}, max_length=200, description="By name of the joint.")]
    text: Annotated[str, Field(default="", max_length=4000, pattern=TEXT)]
    at: Annotated[MeasuredAt, Field(description="When it was found, with a time zone.")]

    @model_validator(mode="after")
    def says_something(self) -> FindingIn:
        """Refuse a finding that says nothing."""
        if not self.joints and not self.text.strip():
            raise ValueError("give joints with their clearance, or a text")
        return self


class FindingOut(Shape):
    """What an inspection found, as it is kept."""

    id: str
    diagnosis: str = Field(description="Id of the diagnosis that it answers.")
    asset: str | None
    created_at: datetime
    at: datetime
    joints: dict[str, JointFound]
    text: str


class FindingPage(Page):
    """A page of findings."""

    items: list[FindingOut]
