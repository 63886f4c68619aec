"""Shapes of the HTTP interface's bodies."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

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


MADE_BY: Any = Field(
    description="Who made it: a person, else `key ID`, else an address; null where that was not noted yet."
)


class Page(Shape):
    """What all lists have."""

    next_cursor: str | None = Field(description="Give it as `cursor` to get the next page; null on the last.")


class DamagedItem(Shape):
    """A row of a list that is not what was stored."""

    id: str = Field(description="Empty where even that cannot be read.")
    problem: str = Field(description="What is wrong, in a line.")


class StoredPage(Page):
    """What lists have of which single rows may be damaged."""

    damaged: list[DamagedItem] = Field(description="Rows of this page that are not what was stored; mostly none.")


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


class CataloguePage(Page):
    """A page of catalogues."""

    items: list[CatalogueItem]
    damaged: list[DamagedItem] = Field(description="All that cannot be used, by their names; on every page.")


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
    made_by: str | None = MADE_BY
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


class MeasurementPage(StoredPage):
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
        Field(default=None, description="In place of measurements: all of `asset` but its baselines from then on."),
    ]
    until: Annotated[Moment | None, Field(default=None, description="With `since`: those measured before this moment.")]
    catalogue: Annotated[str, Field(min_length=1, max_length=255, description="Id or name of a catalogue.")]
    speed: Annotated[
        StrictStr | None,
        BeforeValidator(refuse_bare_speed),
        Field(default=None, description='Drive speed with a unit: "600 rpm", "62.8 rad/s". Estimated when not given.'),
    ]
    speeds: Annotated[
        list[Annotated[StrictStr | None, BeforeValidator(refuse_bare_speed)]] | None,
        Field(
            default=None,
            min_length=1,
            max_length=MOST_TOGETHER,
            description="In place of `speed`, that of each of `measurements` in turn; null for one that is estimated.",
        ),
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


class DiagnosisPage(StoredPage):
    """A page of diagnoses."""

    items: list[DiagnosisItem]


class Health(Shape):
    """State of the process."""

    status: Literal["ok"]


class Readiness(Shape):
    """State of what the service needs."""

    status: Literal["ready"]
    catalogues: int
