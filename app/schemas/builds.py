"""Shapes of builds of catalogues, and of what they would take."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from jointplay.app.schemas.resources import Page, Shape

State = Literal["queued", "running", "done", "failed", "cancelled", "worker_lost"]

CATALOGUE_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"


def check_catalogue_name(given: object) -> object:
    """Return the name of a catalogue; one that breaks the rule is refused in words, not by its pattern."""
    if isinstance(given, str) and not re.fullmatch(CATALOGUE_NAME, given):
        raise ValueError(
            f'"{given[:80]}": must be 1 to 64 letters, digits, . _ and -, without blanks, the first a letter or digit'
        )
    return given


class BuildRequest(Shape):
    """Which catalogue to build, or to go on with."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"machine": "slider-crank", "plan": "quick", "catalogue": "press-7"}}
    )

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
        BeforeValidator(check_catalogue_name),
    ]
    workers: Annotated[
        int | None,
        Field(default=None, ge=1, le=1024, strict=True, description="Processes that compute; one a processor."),
    ]


class ForecastOut(Shape):
    """What a build would take, by some of its cases that were tried now."""

    cases: int = Field(description="Of the plan.")
    present: int = Field(description="Of these, in the catalogue already.")
    tried: int = Field(description="Computed for this forecast; none are kept.")
    seconds: float = Field(description="Time of the build, as busy as the computer is now.")
    seconds_idle: float = Field(description="Time of the build if the computer had nothing else to do.")
    size_bytes: int = Field(description="Of the files of the cases that are missing.")
    workers: int = Field(description="Processes that it is for.")


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
