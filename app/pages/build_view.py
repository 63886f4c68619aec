"""What the page shows of a build: how far it is, in words."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from jointplay.app.jobs.forecasts import duration_text
from jointplay.app.rows import micrometres
from jointplay.app.schemas.entries import EntryItem
from jointplay.app.storage.build_queue import ENDED, BuildRow
from jointplay.app.words import spell_moment

STATES = {
    "queued": "Waiting",
    "running": "Running",
    "done": "Done",
    "failed": "Failed",
    "cancelled": "Cancelled",
    "worker_lost": "Given up",
}
EXPLAINED = {
    "queued": "It begins as soon as a server is free, and when no other build works on this catalogue.",
    "cancelled": "What was computed is kept.",
    "worker_lost": "Its process or its server ended again and again. What was computed is kept.",
    "failed": "What was computed is kept.",
}
PLANS = {
    "quick": "single worn joints; for trying things out",
    "standard": "pairs of worn joints, too, and machines that differ from their model; some ten times the cases",
    "thorough": "as standard, with four times the cases",
}


def build_view(row: BuildRow) -> dict[str, Any]:
    """Return the members that the templates show of a build.

    Parameters
    ----------
    row : BuildRow
        A stored build.
    """
    ended = row.state in ENDED
    stopping = row.cancel_asked and not ended
    return {
        "id": row.id,
        "catalogue": row.catalogue,
        "machine": row.machine["name"],
        "plan": row.plan["name"],
        "state": row.state,
        "state_text": "Stopping" if stopping else STATES[row.state],
        "explained": EXPLAINED.get(row.state, ""),
        "message": row.message,
        "done": row.cases_done,
        "total": row.cases_total,
        "count": count_text(row),
        "pace": "" if ended else pace_text(row),
        "attempt": str(row.attempts) if row.attempts > 1 else "",
        "created": moment_text(row.created_at),
        "started": moment_text(row.started_at),
        "ended": moment_text(row.ended_at),
        "took": took_text(row),
        "open": not ended,
        "can_cancel": not ended and not row.cancel_asked,
        "can_resume": ended and row.state != "done",
    }


def count_text(row: BuildRow) -> str:
    """Return how many cases are there, of how many."""
    if not row.cases_total:
        return "" if row.state in ENDED or row.state == "queued" else "Looking what is to be computed…"
    return f"{row.cases_done} of {row.cases_total} cases ({int(100 * row.cases_done / row.cases_total)} %)"


def pace_text(row: BuildRow) -> str:
    """Return how fast it goes and how long it takes from now on, as far as that is known."""
    if row.cases_total and not row.cases_done:
        return "The first take longest: the machine's equations become a program of their own."
    if row.cases_done == row.cases_total:
        return ""
    parts = [f"{row.rate_per_s:.3g} cases a second"] if row.rate_per_s > 0 else []
    if row.seconds_left is not None:
        parts.append(f"about {duration_text(row.seconds_left)} left")
    return ", ".join(parts)


def took_text(row: BuildRow) -> str:
    """Return how long a build took that ended after it had begun."""
    if row.ended_at is None or row.started_at is None:
        return ""
    return duration_text((row.ended_at - row.started_at).total_seconds())


def moment_text(moment: datetime | None) -> str:
    """Return a time as the page shows it; nothing for none."""
    return f"{spell_moment(moment)} UTC" if moment is not None else ""


def failures_view(items: Sequence[EntryItem]) -> list[dict[str, str]]:
    """Return the rows of the table of cases that have no spectrum."""
    return [
        {
            "key": entry.key,
            "what": entry.hypothesis,
            "clearances": clearances_text(entry) or "–",
            "speed": f"{entry.drive_speed_rpm:.5g} rpm",
            "status": entry.status,
            "message": entry.message,
        }
        for entry in items
    ]


def clearances_text(entry: EntryItem) -> str:
    """Return the clearances of a case's joints."""
    return ", ".join(f"{joint} {micrometres(um)} µm" for joint, um in entry.clearances_um.items())
