"""Shapes of assets and of findings in the HTTP interface's bodies."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from jointplay.app.schemas.resources import MADE_BY, Shape, StoredPage
from jointplay.app.words import MeasuredAt
from jointplay.catalogue.diagnosing.answer import Verdict
from jointplay.catalogue.diagnosing.question import MOST_TOGETHER
from jointplay.catalogue.following.standing import Reason, StandingName

EXTERNAL_ID = r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,127}$"
TEXT = r"^[^\x00-\x08\x0b\x0c\x0e-\x1f]*$"  # a database takes no NUL, and nobody wants the others


def check_external_id(given: object) -> object:
    """Return the id of an asset; one that breaks the rule is refused in words, not by its pattern."""
    if isinstance(given, str) and not re.fullmatch(EXTERNAL_ID, given):
        raise ValueError(
            f'"{given[:80]}": must be 1 to 128 letters, digits, . _ : and -, without / or blanks, the first a letter'
            " or digit"
        )
    return given


AssetId = Annotated[
    str, Field(pattern=EXTERNAL_ID, description="Its name in your own records."), BeforeValidator(check_external_id)
]


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

    limits_um: Annotated[
        dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]],
        Field(
            default={},
            max_length=200,
            description="Radial clearance from which a joint of this asset is worn out, by its name; those that are not"
            " named have the machine's `limit`.",
        ),
    ]
    silent_after_days: Annotated[
        int,
        Field(
            default=30, ge=1, le=3650, strict=True, description="Age of its last recording from which on it is silent."
        ),
    ]
    warn_within_days: Annotated[
        int,
        Field(default=30, ge=0, le=3650, strict=True, description="How long before a limit is reached that is said."),
    ]

    @property
    def in_order(self) -> tuple[str, ...]:
        """Ids of its baselines, each once."""
        given = self.baselines or ([] if self.baseline is None else [self.baseline])
        return tuple(dict.fromkeys(given))


class Looking(Shape):
    """Which assets a list shows alone."""

    state: StandingName | None = None
    search: Annotated[str | None, Field(default=None, max_length=200, pattern=TEXT)]


class Acknowledgement(Shape):
    """That somebody has seen how an asset stands."""

    model_config = ConfigDict(json_schema_extra={"example": {"state": "unknown", "note": "stands still until Monday"}})

    state: Annotated[StandingName, Field(description="What was seen; refused where it is another by now.")]
    note: Annotated[str, Field(default="", max_length=2000, pattern=TEXT)]


class Acknowledged(Shape):
    """Who has seen how an asset stands; it holds until the state gets worse, or something else is the reason."""

    by: str = Field(description="The person, or the name of the key; empty where neither is asked for.")
    at: datetime
    note: str


class StandingOut(Shape):
    """How an asset stands."""

    state: StandingName = Field(
        description="alarm: a joint is beyond its limit; watch: somebody should look; unknown: too little is known, or"
        " nothing was heard for long; in_order."
    )
    reasons: list[Reason] = Field(description="What asks most of somebody first; none where it is in order.")
    acknowledged: Acknowledged | None
    verdict: Verdict | None = Field(description="Of the last recording that was diagnosed.")
    verdict_at: datetime | None = Field(description="When that recording was made.")
    diagnosis: str | None = Field(description="Id of that diagnosis.")
    heard_at: datetime | None = Field(description="When its last recording was made.")
    over_limit: list[str] = Field(description="Joints beyond their limit.")
    near_limit: list[str] = Field(description="Joints that may be, or will be within `warn_within_days`.")
    limit_at: tuple[datetime | None, datetime | None, datetime | None] | None = Field(
        description="When the first worn joint has reached its limit, with probabilities of 0.05, 0.5 and 0.95."
    )
    up_to_date: bool = Field(description="Whether it follows from all that is stored by now.")


class AssetOut(Shape):
    """An asset."""

    external_id: AssetId
    machine: str
    notes: str
    baseline: str | None
    baselines: list[str] = Field(description="All of its baselines, of which `baseline` is the first.")
    limits_um: dict[str, float]
    silent_after_days: int
    warn_within_days: int
    created_at: datetime
    updated_at: datetime
    made_by: str | None = MADE_BY
    standing: StandingOut


class AssetPage(StoredPage):
    """A page of assets."""

    items: list[AssetOut]


class TrendRow(Shape):
    """How worn one joint was at one moment, by all that was known then."""

    at: datetime
    joint: str
    p_worn: float
    clearance_um: float = Field(description="Radial.")
    low_um: float = Field(description="Of an interval that holds it with 90 %.")
    high_um: float
    limit_um: float


class JointFound(Shape):
    """What was measured at one joint, or that it was repaired, or both."""

    clearance_um: Annotated[
        float | None,
        Field(
            default=None,
            ge=0,
            le=1e5,
            allow_inf_nan=False,
            strict=True,
            description="Radial clearance: half of the diametral play; left out where nobody measured it.",
        ),
    ]
    repaired: Annotated[bool, Field(default=False, strict=True, description="Whether it was as new afterwards.")]

    @model_validator(mode="after")
    def says_something(self) -> JointFound:
        """Refuse a joint of which nothing is said."""
        if self.clearance_um is None and not self.repaired:
            raise ValueError("give clearance_um, or repaired, or both")
        return self


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
    made_by: str | None = MADE_BY
    at: datetime
    joints: dict[str, JointFound]
    text: str


class FindingPage(StoredPage):
    """A page of findings."""

    items: list[FindingOut]
