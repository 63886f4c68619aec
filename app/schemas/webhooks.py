"""Shapes of webhooks and of what they were told."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal, get_args

from pydantic import ConfigDict, Field

from jointplay.app.schemas.resources import Page, Shape

Event = Literal[
    "diagnosis.created",
    "finding.created",
    "asset.state_changed",
    "limit.predicted",
    "asset.silent",
    "build.ended",
    "webhook.disabled",
]
EVENTS: tuple[str, ...] = get_args(Event)


class WebhookIn(Shape):
    """Whom to tell, and of what."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"url": "https://maintenance.example/jointplay", "events": ["diagnosis.created"]}}
    )

    url: Annotated[str, Field(min_length=1, max_length=2000, description="http or https, at a public address.")]
    events: Annotated[list[Event], Field(min_length=1, max_length=len(EVENTS), description="What to tell of.")]


class WebhookOut(Shape):
    """A webhook."""

    id: str
    url: str
    events: list[str]
    created_at: datetime
    state: Literal["active", "failing", "disabled"] = Field(
        description="failing: nothing succeeded since `failing_since`; disabled: for so long that nothing is sent."
    )
    failing_since: datetime | None = None
    disabled_at: datetime | None = None
    error: str = Field(default="", description="Why the last attempt failed; empty where the last one did not.")


class WebhookMade(WebhookOut):
    """A webhook that has just been made."""

    secret: str = Field(description="Signs every delivery (HMAC-SHA256); it is not shown again.")


class WebhookPage(Page):
    """A page of webhooks."""

    items: list[WebhookOut]


class DeliveryOut(Shape):
    """One thing that a webhook was told, or is to be told."""

    id: str = Field(description="Also in the header Jointplay-Delivery: the same again is the same delivery.")
    event: str
    state: str = Field(description="waiting, delivered, or failed after the last attempt.")
    attempts: int
    error: str = Field(description="Why the last attempt did not succeed; empty when it did, or there was none.")
    created_at: datetime
    due_at: datetime | None = Field(description="When the next attempt is made.")


class DeliveryPage(Page):
    """A page of deliveries."""

    items: list[DeliveryOut]
