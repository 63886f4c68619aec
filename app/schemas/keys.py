"""Shapes of API keys in the HTTP interface's bodies."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from jointplay.app.schemas.assets import TEXT
from jointplay.app.schemas.resources import Page, Shape
from jointplay.app.scopes import GRACE_HOURS, LIFETIME_DAYS, LONGEST_DAYS, LONGEST_GRACE_HOURS, Scope

Days = Annotated[
    int, Field(default=LIFETIME_DAYS, ge=1, le=LONGEST_DAYS, strict=True, description="How long it holds, from now.")
]


class KeyIn(Shape):
    """A key to be made."""

    model_config = ConfigDict(json_schema_extra={"example": {"name": "historian", "scopes": ["read"], "days": 90}})

    name: Annotated[str, Field(min_length=1, max_length=80, pattern=TEXT, description="Says whose it is.")]
    scopes: Annotated[
        list[Scope],
        Field(
            min_length=1,
            max_length=len(Scope),
            description="What it may be used for; of the scopes that whoever asks has.",
        ),
    ]
    days: Days


class Rotation(Shape):
    """How a key gets its new secret."""

    model_config = ConfigDict(json_schema_extra={"example": {"grace_hours": 24, "days": 90}})

    grace_hours: Annotated[
        int,
        Field(
            default=GRACE_HOURS,
            ge=0,
            le=LONGEST_GRACE_HOURS,
            strict=True,
            description="How long the secrets before it hold yet; with 0 they and their sessions end now.",
        ),
    ]
    days: Days


class KeyOut(Shape):
    """A key, without its secret."""

    id: str
    name: str
    scopes: list[Scope]
    created_at: datetime
    expires_at: datetime
    used_at: datetime | None = Field(description="When it was used last, to the minute; null before its first use.")
    state: Literal["valid", "expired", "revoked"]


class KeyMade(KeyOut):
    """A key with a new secret."""

    key: str = Field(description="Goes into `Authorization: Bearer` or `X-API-Key`; it is not shown again.")


class KeyRotated(KeyMade):
    """A key with a new secret in place of others."""

    former_until: datetime = Field(description="Until when the secrets before it hold.")


class KeyPage(Page):
    """A page of keys."""

    items: list[KeyOut]
