"""``jointplay prune``: delete what a service keeps no longer, or say what that is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.commands.backup import catalogues_option
from jointplay.app.commands.keys import data_option
from jointplay.app.commands.parameters import json_option, print_json
from jointplay.app.tables import table

if TYPE_CHECKING:
    from jointplay.app.storage.pruning import Going
    from jointplay.app.storage.usage import Usage


@click.command("prune")
@click.option("--dry-run", is_flag=True, help="Say what would go, how large it is and why, and delete nothing.")
@catalogues_option
@data_option
@json_option
def command(dry_run: bool, catalogues: Path | None, data: Path | None, as_json: bool) -> None:
    """Delete what a service keeps no longer, as a running service does every hour, and say how much is stored.

    How long recordings are kept is set as for the service (JOINTPLAY_KEEP_ROUTINE_DAYS, JOINTPLAY_KEEP_BASELINE_DAYS,
    JOINTPLAY_KEEP_EVIDENCE_DAYS); without that all of them stay. What is on hold stays, and baselines of assets.
    """
    from jointplay.app.actor import acting_at_prompt
    from jointplay.app.settings import ServiceSettings
    from jointplay.app.storage.pruning import Pruner
    from jointplay.app.storage.store import Store
    from jointplay.app.storage.usage import measure

    given: dict[str, Any] = {"catalogues": catalogues, "data": data}
    settings = ServiceSettings(**{name: value for name, value in given.items() if value is not None})
    store = Store(settings.data, settings.database)
    try:
        with acting_at_prompt():
            pruner = Pruner(store, settings.catalogues, settings.keep_days)
            going, apart = pruner.look(), pruner.why_apart()
            if not dry_run:
                going = together(list(pruner.prune()))
            usage = measure(store)
    finally:
        store.close()
    days = usage.days_until_full(settings.keep_days)
    if as_json:
        print_json(
            {
                "deleted": not dry_run,
                "apart": apart,
                "going": [
                    {"what": each.what, "why": each.why, "bytes": each.size_bytes, "ids": list(each.ids)}
                    for each in going
                ],
                "stored": stored(usage),
                "full_in_days": None if math.isinf(days) else round(days, 1),
            }
        )
        return
    if apart:
        click.echo(f"{apart}\n")
    tell(going, usage, days, dry_run)


def together(gone: list[Going]) -> list[Going]:
    """Return what has gone, once for every kind and reason."""
    from jointplay.app.storage.pruning import Going

    found: dict[tuple[str, str], Going] = {}
    for each in gone:
        known = found.get((each.what, each.why), Going(each.what, each.why, (), 0))
        sum_of = known.size_bytes + each.size_bytes
        found[each.what, each.why] = Going(each.what, each.why, known.ids + each.ids, sum_of)
    return list(found.values())


def stored(usage: Usage) -> dict[str, Any]:
    """Return what is printed of what is stored as JSON."""
    return {
        "recordings": {
            of: {
                "count": held.count,
                "bytes": held.size_bytes,
                "bytes_per_day": round(held.per_day),
                "oldest": None if held.oldest is None else held.oldest.isoformat(),
            }
            for of, held in usage.classes.items()
        },
        "diagnoses": usage.diagnoses,
        "database_bytes": usage.database_bytes,
        "partial_uploads": usage.partials.count,
        "partial_bytes": usage.partials.size_bytes,
        "free_bytes": usage.free_bytes,
    }


def tell(going: list[Going], usage: Usage, days: float, dry_run: bool) -> None:
    """Print what goes or has gone, and what is stored."""
    done = "would go" if dry_run else "deleted"
    rows = [(f"{len(each.ids)}", each.what, megabytes(each.size_bytes), each.why) for each in going]
    click.echo(table((done, "", "size", "why"), rows) if rows else f"{done}: nothing")
    click.echo()
    rows = [
        (of, f"{held.count}", megabytes(held.size_bytes), f"{megabytes(held.per_day)} a day")
        for of, held in usage.classes.items()
    ]
    click.echo(table(("recordings", "count", "size", "comes"), rows))
    click.echo(f"database {megabytes(usage.database_bytes)} with {usage.diagnoses} diagnoses", nl=False)
    click.echo(f"; free {megabytes(usage.free_bytes)}: {forecast(days)}")


def forecast(days: float) -> str:
    """Return when a disk is full, in words."""
    return "not full by what comes now" if math.isinf(days) else f"full in {days:.3g} days if all goes on as now"


def megabytes(size: float) -> str:
    """Return a number of bytes as it is read."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
