"""``jointplay audit``: the audit log of a service as a file."""

from __future__ import annotations

from pathlib import Path

import click

from jointplay.app.commands.keys import data_option


@click.command("audit")
@data_option
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="Where to write; by default to standard output."
)
def command(data: Path | None, out: Path | None) -> None:
    """Write who did what, the first first, one JSON object a line.

    Each line holds the hash of the one before. Keep such files elsewhere: whatever is changed in the service later, the
    last hash of an old file is still among those of a new one, or the log was made anew.
    """
    from contextlib import ExitStack, closing

    from jointplay.app.errors import DamageError
    from jointplay.app.settings import ServiceSettings
    from jointplay.app.storage.audit import AuditLog
    from jointplay.app.storage.checksums import canonical
    from jointplay.app.storage.store import Store

    settings = ServiceSettings() if data is None else ServiceSettings(data=data)
    with ExitStack() as stack:
        log = AuditLog(stack.enter_context(closing(Store(settings.data, settings.database))).database)
        file = None if out is None else stack.enter_context(open(out, "w", encoding="utf-8"))
        number, _ = log.end()
        for row in log.all(number):
            click.echo(canonical({**row.content, "hash": row.hash}), file=file)
        damage = list(log.damage())
    if damage:
        raise DamageError(f"the audit log is not whole: {damage[0]}")
