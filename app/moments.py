"""Moments: in requests RFC 3339 with a time zone, and nothing that merely resembles it; as a person reads them."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BeforeValidator

PATTERN = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d)")


def written(given: object) -> object:
    """Return what was given if it has the form; numbers of seconds and bare dates are refused."""
    if not isinstance(given, str) or not PATTERN.fullmatch(given):
        raise ValueError('must be a moment with a time zone, such as "2026-03-01T06:00:00Z"')
    return given


def in_utc(moment: datetime) -> datetime:
    """Return a moment in UTC; the first and last hours of the calendar have none."""
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise ValueError("is outside of the calendar") from None


def spelled(moment: datetime) -> str:
    """Return a moment as a person reads it, in UTC."""
    return f"{moment:%Y-%m-%d %H:%M}"


Moment = Annotated[AwareDatetime, BeforeValidator(written), AfterValidator(in_utc)]
