"""Shapes of builds in the HTTP interface."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from jointplay.app.schemas.resources import Page, Shape

State = Literal["queued", "running", "done", "failed", "cancelled", "worker_lost"]

CATALOGUE_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"


class BuildRequest(Shape):
    """Which catalogue to build, or to go on with."""

    machine: Annotated[str, Field(min_length=1, max_length=255, description="Name of a machine.")]
    plan: Annotated[
        dict[str, Any] | str,
        Field(default="standard", description="quick, standard or thorough; or a plan file's content as JSON."),
    ]
    catalogue: Annotated[
        str,
        Field(
            pattern=CATALOGUE_NAME,
            description="Name of the catalogue's folder. One that is there is extended, if it is of the same machine.",
        ),
    ]
    workers: Annotated[
        int | None,
        Field(default=None, ge=1, le=1024, strict=True, description="Processes that compute; one a processor."),
    ]


class BuildOut(Shape):
    """A build, and how far it is."""

    id: str
    machine: str
    plan: str = Field(description="Name of the plan.")
    plan_hash: str = Field(description="SHA-256 of what the plan asks for, without its name.")
    catalogue: str = Field(description="Name of the catalogue's folder.")
    catalogue_id: str | None = Field(description="Id of the catalogue as it was when the build ended.")
    workers: int | None
    state: State = Field(
        description="A queued build waits for a server, or for another of the same catalogue; worker_lost: its process"
        " or its server ended again and again. What was computed is kept in any case: the same build goes on with it."
    )
    message: str = Field(description="What went wrong, or what is being done besides cases, in one line; or nothing.")
    cases_done: int = Field(description="Cases of the plan that are in the catalogue.")
    cases_total: int = Field(description="All cases of the plan; 0 until the build has begun.")
    rate_per_s: float = Field(description="Cases a second.")
    seconds_left: float | None = Field(description="At this rate; null where it is not known.")
    attempts: int = Field(description="How often it was begun, but for stops of its server in good order.")
    created_at: datetime
    started_at: datetime | None
    ended_at: datetime | None


class BuildPage(Page):
    """A page of builds."""

    items: list[BuildOut]
