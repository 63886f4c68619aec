"""Bodies about machine files: their versions, and what is made of one that is checked."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import Field

from jointplay.app.schemas.resources import FieldError, Page, Shape


class MachineVersionItem(Shape):
    """What was put under the name of a machine once."""

    number: int = Field(description="From 1 on, the newest last.")
    content_key: str
    saved_at: datetime | None = Field(description="Null for what ships with the program.")


class MachineVersionPage(Page):
    """A page of versions of a machine."""

    items: list[MachineVersionItem]


class MachineCheck(Shape):
    """What a machine file is, right or wrong."""

    refusal: FieldError | None = Field(description="Why it would be refused; null for one that is right.")
    account: dict[str, Any] | None = Field(
        description="What `jointplay check --json` prints: joints, degrees of freedom, what the model holds and leaves"
        " out, suspension modes, notes on what is implausible. Null for a file that would be refused."
    )
