"""When a measurement was made: what its sender says of it, else what its file says."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import UTC, datetime, timedelta, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from jointplay.catalogue.measurements.readers.moments import RawMoment, read_moment

FIRST = datetime(1970, 1, 1, tzinfo=UTC)
"""Nothing was measured before."""

AHEAD = timedelta(days=1)
"""Farthest in the future, for clocks and zones that are set wrong."""

_SAID = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?([Zz]|[+-]\d\d:?\d\d)?", re.ASCII)


def parse_said(given: object) -> object:
    """Return a moment as a sender writes it, with a zone or without.

    Raises
    ------
    ValueError
        It has another form.
    """
    if isinstance(given, datetime):
        return given
    if not isinstance(given, str) or not _SAID.fullmatch(given.strip()):
        raise ValueError('must be a date with a time, such as "2024-11-21T10:03:00+01:00"')
    try:
        return datetime.fromisoformat(given.strip().upper())
    except ValueError:
        raise ValueError("is no day of the calendar, or no time of the day") from None


def check_zone(text: str) -> str:
    """Return the name of a time zone as it is given.

    Raises
    ------
    ValueError
        It is none.
    """
    zone_of(text)
    return text


def zone_of(text: str) -> tzinfo:
    """Return the time zone of "Europe/Berlin", "UTC" or "+01:00".

    Raises
    ------
    ValueError
        It is none.
    """
    if text[:1] in ("+", "-"):
        with suppress(ValueError):
            return datetime.strptime(text, "%z").tzinfo or UTC
    try:
        return ZoneInfo(text)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError('must be a time zone, such as "Europe/Berlin" or "+01:00"') from None


def place_moment(moment: datetime, zone: str | None) -> datetime:
    """Return a moment in UTC.

    Parameters
    ----------
    moment : datetime
    zone : str, optional
        Of one that has none; UTC unless given.

    Raises
    ------
    ValueError
        It lies before 1970, or more than a day ahead.
    """
    try:
        placed = moment.replace(tzinfo=zone_of(zone) if zone else UTC) if moment.tzinfo is None else moment
        placed = placed.astimezone(UTC)
    except OverflowError:
        raise ValueError("is outside of the calendar") from None
    if placed < FIRST:
        raise ValueError("lies before 1970")
    if placed > datetime.now(UTC) + AHEAD:
        raise ValueError("lies more than a day ahead")
    return placed


def understand_moment(raw: RawMoment, zone: str | None) -> tuple[datetime | None, str]:
    """Return the moment of measurement that a file states, and what was understood; None where that is not sure.

    Parameters
    ----------
    raw : RawMoment
    zone : str, optional
        Of times that have none; UTC unless given.
    """
    shown = " ".join(raw.text.split())[:60]
    try:
        moment, whole = read_moment(raw.text)
        placed = place_moment(moment, zone)
    except ValueError as error:
        rule = "the time of measurement is not taken from it: give measured_at"
        return None, f"{raw.where}: {shown!r} {error}: {rule}"
    notes = [] if whole else ["a day alone: taken from its beginning"]
    if moment.tzinfo is None:
        notes.append(
            f"no time zone: taken as {zone}" if zone else "no time zone: taken as UTC, unless time_zone is given"
        )
    said = f" ({'; '.join(notes)})" if notes else ""
    return placed, f"{raw.where}: measured at {spell(placed)}{said}"


def spell(moment: datetime) -> str:
    """Return a moment as reports of files show it."""
    return f"{moment:%Y-%m-%d %H:%M:%S} UTC"
