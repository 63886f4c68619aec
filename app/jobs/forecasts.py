"""What a build will take, said before it begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jointplay.catalogue.building.forecast import Forecast


def measure(machine: Mapping[str, Any], plan: Mapping[str, Any], workers: int | None, folder: Path) -> dict[str, Any]:
    """Try some cases of a build; the task of a worker."""
    from jointplay.catalogue.building.executors import count_processors
    from jointplay.catalogue.building.forecast import forecast
    from jointplay.catalogue.plans.plan import parse_plan
    from jointplay.solver.machines.machine import parse_machine

    return asdict(forecast(parse_machine(machine), parse_plan(plan), workers or count_processors(), folder))


def forecast_text(found: Forecast | Mapping[str, Any]) -> str:
    """Return a forecast in one sentence."""
    given = found if isinstance(found, Mapping) else asdict(found)
    left = given["cases"] - given["present"]
    there = f", {given['present']} are there" if given["present"] else ""
    if not left:
        return f"all {given['cases']} cases are there"
    processes = "1 process" if given["workers"] == 1 else f"{given['workers']} processes"
    idle, busy = duration_text(given["seconds_idle"]), duration_text(given["seconds"])
    time = f"about {busy}" if idle == busy else f"{idle} on an idle computer, {busy} on one as busy as this is now,"
    return (
        f"{given['cases']} cases{there}: {time} by {processes} and {size_text(given['size_bytes'])},"
        f" by {given['tried']} cases that were tried now"
    )


def duration_text(seconds: float) -> str:
    """Return a duration with the digits that mean something."""
    if seconds < 1:
        return "1 s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 120:
        return f"{minutes} min"
    hours = round(seconds / 3600)
    return f"{hours} h" if hours < 48 else f"{round(seconds / 86400)} days"


def size_text(size: int) -> str:
    """Return a number of bytes with its unit."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{max(1, round(size / 1e6))} MB"
