"""What the pages say of how assets stand: each on its own page, and all of them by who needs somebody."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from jointplay.app.schemas.assets import StandingOut
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.standings import standing_out
from jointplay.app.words import spell_moment

STATES = {"alarm": "Alarm", "watch": "Watch", "unknown": "Unknown", "in_order": "In order"}
"""What they are called, in the order of who needs somebody."""

VERDICTS = {"worn": "worn", "in_order": "in order", "changed": "changed", "unknown": "no verdict"}


def show_standing(row: AssetRow, at: datetime) -> dict[str, Any]:
    """Return what templates show of how an asset stands."""
    found = standing_out(row)
    seen = found.acknowledged
    return {
        "state": found.state,
        "said": STATES[found.state],
        "reasons": [reason.text for reason in found.reasons],
        "acknowledged": None
        if seen is None
        else {"by": seen.by or "somebody", "at": spell_moment(seen.at), "note": seen.note},
        "verdict": VERDICTS[found.verdict] if found.verdict else "",
        "verdict_at": found.verdict_at,
        "diagnosis": found.diagnosis,
        "joints": joints_of(found),
        "limit_at": limit_words(found, at),
        "heard": age(at - found.heard_at) if found.heard_at else "",
        "up_to_date": found.up_to_date,
    }


def joints_of(found: StandingOut) -> str:
    """Return which joints are beyond their limit, and near it, in words."""
    parts = [("over", found.over_limit), ("near", found.near_limit)]
    return "; ".join(f"{what}: {', '.join(names)}" for what, names in parts if names)


def limit_words(found: StandingOut, at: datetime) -> str:
    """Return when the first limit is reached, with its interval."""
    if found.limit_at is None:
        return ""
    early, likely, late = found.limit_at
    begins = "now" if early is None or early <= at else day(early)
    if likely is None:
        return f"perhaps, {begins} or later"
    if likely <= at:
        return "reached"
    return f"{day(likely)} ({begins} to {day(late) or 'more than a century'})"


def age(passed: timedelta) -> str:
    """Return how long ago something was."""
    hours = passed / timedelta(hours=1)
    if hours < 48:
        return "just now" if hours < 1 else f"{hours:.0f} h"
    return f"{hours / 24:.0f} days"


def day(at: datetime | None) -> str:
    """Return a day in UTC, which is as exact as a forecast; empty for none."""
    return spell_moment(at)[:10] if at else ""
