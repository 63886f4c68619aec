"""Shapes of the HTTP interface's bodies."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StrictFloat, StrictStr

from jointplay.app.words import MeasuredAt, Moment
from jointplay.catalogue.diagnosing.quality_card import QualityCard
from jointplay.catalogue.diagnosing.question import MOST_TOGETHER
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.prior import LARGEST, Prior
from jointplay.solver.errors import UnitError
from jointplay.solver.machines.units import speed_to_si


def refuse_bare_speed(given: object) -> object:
    """Return what is given as a speed, but for a number: it could be in rpm as well as in rad/s.

    Raises
    ------
    ValueError
    """
    if isinstance(given, int | float):
        try:
            speed_to_si(given)
        except UnitError as error:
            raise ValueError(f"{given}: {error}") from None
    return given


class Shape(BaseModel):
    """A body; unknown members are refused where it comes from outside."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class FieldError(Shape):
    """One field that breaks a rule."""

    field: str
    line: int | None = Field(default=None, description="Of the machine file that was sent, where it is about one.")
    message: str


class ProblemDocument(BaseModel):
    """What every error answers (RFC 9457, ``application/problem+json``)."""

    type: str = Field(description="A URI that names the kind of problem; about:blank for a plain HTTP status.")
    title: str = Field(description="The kind of problem in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What was wrong this time, in one line.")
    instance: str = Field(description="Path of the request.")
    errors: list[FieldError] = Field(default=[], description="The fields at fault, where there are any.")


class MachineItem(Shape):
    """A machine."""

    name: str
    content_key: str = Field(description="SHA-256 of the machine's content; also its ETag.")
    links: int
    turning_joints: list[str]
    sliding_joints: list[str]
    shipped: bool = Field(description="Whether it ships with the program; others were put there.")
    sensors: list[str]


class PinOrbit(Shape):
    """Where the pin of a worn joint is in its socket over one revolution."""

    joint: str
    clearance_um: float = Field(description="Radial.")
    at: list[tuple[float, float]] = Field(
        description="x, y of the pin's middle from the socket's, in parts of the clearance: at 1 it touches. Evenly"
        " over the revolution of the drive, the drawn position first."
    )


class Motion(Shape):
    """How the drawing of a machine moves in one period of its drive."""

    view_box: str = Field(description="Of the drawing, so that nothing leaves it.")
    transforms: dict[str, list[str]] = Field(
        description="By the class of an element of the drawing: its `transform` at each position, evenly over a period,"
        " the drawn one first. What is not there stands still."
    )
    pins: list[PinOrbit] = Field(description="Of the joints with clearance that were asked for; simulated.")


class Page(Shape):
    """What all lists have."""

    next_cursor: str | None = Field(description="Give it as `cursor` to get the next page; null on the last.")


class MachinePage(Page):
    """A page of machines."""

    items: list[MachineItem]


class SensorItem(Shape):
    """A sensor of a catalogue's machine."""

    name: str
    at_m: tuple[float, float]
    direction: tuple[float, float]


class CatalogueItem(Shape):
    """A catalogue that measurements can be compared with."""

    id: str
    name: str = Field(description="Name of its folder; it may stand wherever the id may.")
    machine: str
    machine_content_key: str
    hypotheses: list[str]
    entries: int = Field(description="Number of simulated cases.")
    turning_joints: list[str]
    sensors: list[SensorItem]
    nominal_speed_rpm: float | None


class CatalogueDetail(CatalogueItem):
    """A catalogue with its plan and what became of its cases."""

    plan: dict[str, Any]
    statuses: dict[str, int] = Field(description="Number of cases by the status of their simulation.")
    quality: QualityCard | None = Field(
        description="What draws that it has not learned from show of its answers, made at the end of a build; null"
        " where there is none of its present state."
    )


class DamagedItem(Shape):
    """A catalogue that cannot be used."""

    name: str = Field(description="Name of its folder.")
    reason: str


class CataloguePage(Page):
    """A page of catalogues."""

    items: list[CatalogueItem]
    damaged: list[DamagedItem] = Field(description="All that cannot be used: on every page.")


class ChannelItem(Shape):
    """One column of a measurement."""

    name: str
    unit: str
    quantity: str
    scaling: Literal["psd", "power", "amplitude"] | None = Field(
        default=None, description="What the numbers of a spectrum are; null for a recording."
    )
    detector: Literal["rms", "peak", "peak-to-peak"] | None = Field(
        default=None, description="Of a spectrum; null for a recording."
    )
    decibel: bool | None = Field(default=None, description="Whether they are levels in dB; null for a recording.")


class SpectrumItem(Shape):
    """How far and how finely a spectrum reaches."""

    lines: int
    resolution_hz: float = Field(description="Distance of its lines.")
    lowest_hz: float
    highest_hz: float


class MeasurementOut(Shape):
    """A stored measurement: a recording over time, or a spectrum."""

    id: str
    name: str
    sha256: str = Field(description="Of the file's bytes.")
    size_bytes: int
    created_at: datetime = Field(description="When it was received.")
    measured_at: datetime = Field(description="When it was measured; when it was received where nobody says that.")
    measured_at_source: Literal["sender", "file", "received"] = Field(description="Who says so; received: nobody does.")
    kind: Literal["recording", "spectrum"] = "recording"
    virtual: dict[str, Any] | None = Field(
        default=None, description="What a simulated recording was made with; null for what was measured."
    )
    told: dict[str, Any] = Field(
        description="What its sender said of the file: `sample_rate_hz`, `units`, `profile`, as far as they were given."
        " When it was measured stands by itself."
    )
    sample_rate_hz: float | None = Field(default=None, description="Null for a spectrum.")
    samples: int | None = Field(default=None, description="Null for a spectrum.")
    duration_s: float | None = Field(default=None, description="Null for a spectrum.")
    revolutions: int | None = Field(default=None, description="By the pulses of a tacho, where one is named.")
    spectrum: SpectrumItem | None = Field(default=None, description="Null for a recording.")
    channels: list[ChannelItem]
    warnings: list[str]
    import_report: list[str]


class MeasurementChange(Shape):
    """What can be corrected of a measurement."""

    model_config = ConfigDict(json_schema_extra={"example": {"measured_at": "2024-11-21T10:03:00+01:00"}})

    measured_at: Annotated[MeasuredAt, Field(description="When it was measured, with a time zone.")]


class MeasurementPage(Page):
    """A page of measurements."""

    items: list[MeasurementOut]


class PriorAsked(Shape):
    """What is held likely before a measurement."""

    worn: Annotated[
        StrictFloat,
        Field(
            default=Prior().worn,
            ge=1.0 / LARGEST,
            le=1.0 - 1.0 / LARGEST,
            description="Probability that any joint is worn, joints alike.",
        ),
    ]
    another: Annotated[
        StrictFloat,
        Field(
            default=Prior().another,
            ge=1.0 / LARGEST,
            le=LARGEST,
            description="How much likelier it is that one joint more is worn, whichever they are.",
        ),
    ]
    joints: Annotated[
        dict[str, Annotated[StrictFloat, Field(ge=1.0 / LARGEST, le=LARGEST)]],
        Field(
            default={},
            max_length=64,
            description="What a worn joint multiplies the weight of a hypothesis by; 1 for those that are not named.",
        ),
    ]


class DiagnosisRequest(Shape):
    """What to compare, and how."""

    measurement: Annotated[
        str | None, Field(default=None, min_length=1, max_length=64, description="Id of a stored measurement.")
    ]
    measurements: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=64)]] | None,
        Field(
            default=None,
            min_length=1,
            max_length=MOST_TOGETHER,
            description="Ids of several, of one machine in one state, in place of `measurement`: they have one answer.",
        ),
    ]
    since: Annotated[
        Moment | None,
        Field(default=None, description="In place of measurements: all of `asset` measured from this moment on."),
    ]
    until: Annotated[Moment | None, Field(default=None, description="With `since`: those measured before this moment.")]
    catalogue: Annotated[str, Field(min_length=1, max_length=255, description="Id or name of a catalogue.")]
    speed: Annotated[
        StrictStr | None,
        BeforeValidator(refuse_bare_speed),
        Field(default=None, description='Drive speed with a unit: "600 rpm", "62.8 rad/s". Estimated when not given.'),
    ]
    effort: Annotated[Effort, Field(default="standard", description="How much to compute.")]
    mode: Annotated[
        ModeAsked,
        Field(
            default="auto",
            description="Whether the machine is as simulated (trusted) or may differ from it (robust); auto trusts the"
            " model unless that does not explain the measurement.",
        ),
    ]
    mapping: Annotated[
        dict[str, str],
        Field(
            default={},
            max_length=64,
            description="Measurement column to sensor of the machine; columns named like a sensor need no entry, and"
            " one with an empty sensor is left out.",
        ),
    ]
    prior: Annotated[PriorAsked, Field(default=PriorAsked(), description="What is held likely beforehand.")]
    asset: Annotated[
        str | None,
        Field(default=None, max_length=128, description="External id of the machine that was measured."),
    ]


class DiagnosisItem(Shape):
    """A finished diagnosis in a list."""

    id: str
    created_at: datetime
    machine: str
    catalogue: str
    measurement: str
    asset: str | None
    verdict: Literal["worn", "in_order", "changed", "unknown"]
    candidate_set: list[str]


class DiagnosisPage(Page):
    """A page of diagnoses."""

    items: list[DiagnosisItem]


class Health(Shape):
    """State of the process."""

    status: Literal["ok"]


class Readiness(Shape):
    """State of what the service needs."""

    status: Literal["ready"]
    catalogues: int


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
