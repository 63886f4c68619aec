"""Shapes of how long a recording is kept."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from jointplay.app.schemas.assets import TEXT
from jointplay.app.schemas.resources import Shape

KeepAs = Literal["routine", "baseline", "evidence"]


class RetentionIn(Shape):
    """What somebody says of how long a recording is kept; what is left out is taken back."""

    model_config = ConfigDict(json_schema_extra={"example": {"keep_as": "routine"}})

    keep_as: Annotated[
        KeepAs | None, Field(default=None, description="Null: what follows from what speaks of the recording.")
    ]
    hold: Annotated[
        str | None,
        Field(
            default=None,
            min_length=1,
            max_length=200,
            pattern=TEXT,
            description="Why nobody may delete it, nor what was answered of it, whatever its time; null for no hold.",
        ),
    ]


class Reason(Shape):
    """Why something is deleted, as a form says it."""

    why: Annotated[str, Field(max_length=200, pattern=TEXT)]


class RetentionOut(Shape):
    """How long a recording is kept."""

    keep_as: KeepAs = Field(
        description="A baseline is one of an asset; of evidence a finding speaks; all others are routine."
    )
    said: bool = Field(description="Whether somebody says so, in place of what follows.")
    hold: str | None = Field(description="Why nobody may delete it.")
    changed_by: str = Field(description="Who said one of them last; empty where nobody did.")
    changed_at: datetime | None = Field(description="When that was.")
    keep_until: datetime | None = Field(description="When it is deleted by itself; null for never.")
