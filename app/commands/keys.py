"""``jointplay keys``: make, list, renew and take back the keys to a service's HTTP interface."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import json_option, print_json
from jointplay.app.scopes import GRACE_HOURS, LIFETIME_DAYS, LONGEST_DAYS, LONGEST_GRACE_HOURS, Scope
from jointplay.app.tables import table

if TYPE_CHECKING:
    from jointplay.app.storage.keys import Key, Keys

data_option = click.option(
    "--data",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="The service's directory (JOINTPLAY_DATA) [default: .jointplay/server].",
)

days_option = click.option(
    "--days",
    type=click.IntRange(1, LONGEST_DAYS),
    default=LIFETIME_DAYS,
    show_default=True,
    help="How long it holds, from now.",
)


@click.group("keys")
def command() -> None:
    """Keys that clients send as `Authorization: Bearer KEY` or `X-API-Key: KEY`.

    Of their secrets only hashes are kept.
    """


@command.command("create")
@click.argument("name")
@click.option(
    "--scope",
    "scopes",
    type=click.Choice([scope.value for scope in Scope]),
    multiple=True,
    default=("read", "match"),
    show_default=True,
    help="What it may be used for; may be given several times.",
)
@days_option
@data_option
@json_option
def create(name: str, scopes: tuple[str, ...], days: int, data: Path | None, as_json: bool) -> None:
    """Make a key and print it, once: it cannot be shown again. NAME says whose it is."""
    with keys_of(data) as keys:
        key, token = keys.create(name, frozenset(Scope(scope) for scope in scopes), timedelta(days=days))
    if as_json:
        print_json({**describe_key(key), "key": token})
        return
    click.echo(f"jointplay: key {key.id} for {' '.join(sorted(key.scopes))}, until {day(key.expires_at)}", err=True)
    click.echo(token)


@command.command("list")
@data_option
@json_option
def list_keys(data: Path | None, as_json: bool) -> None:
    """List keys, those included that have expired or were revoked."""
    with keys_of(data) as keys:
        found = keys.all()
    if as_json:
        print_json([describe_key(key) for key in found])
        return
    rows = [
        (
            key.id,
            key.name,
            " ".join(sorted(key.scopes)),
            day(key.created_at),
            day(key.expires_at),
            "never" if key.used_at is None else day(key.used_at),
            key.state,
        )
        for key in found
    ]
    click.echo(table(("id", "name", "scopes", "made", "holds until", "last used", "state"), rows))


@command.command("rotate")
@click.argument("identity", metavar="ID")
@click.option(
    "--grace-hours",
    type=click.IntRange(0, LONGEST_GRACE_HOURS),
    default=GRACE_HOURS,
    show_default=True,
    help="How long secrets before it hold yet; with 0 they and their sessions end now.",
)
@days_option
@data_option
@json_option
def rotate(identity: str, grace_hours: int, days: int, data: Path | None, as_json: bool) -> None:
    """Give the key ID a new secret and print it, once; the one before holds a while longer."""
    with keys_of(data) as keys:
        key, token, until = keys.rotate(identity, timedelta(hours=grace_hours), timedelta(days=days))
    if as_json:
        print_json({**describe_key(key), "key": token, "former_until": until.isoformat()})
        return
    former = f"the secret before it until {until:%Y-%m-%d %H:%M} UTC"
    click.echo(f"jointplay: key {key.id} until {day(key.expires_at)}, {former}", err=True)
    click.echo(token)


@command.command("revoke")
@click.argument("identity", metavar="ID")
@data_option
@json_option
def revoke(identity: str, data: Path | None, as_json: bool) -> None:
    """Take the key ID back: from now on it opens nothing, and no session that was opened with it."""
    with keys_of(data) as keys:
        key = keys.revoke(identity)
    if as_json:
        print_json(describe_key(key))
    else:
        click.echo(f"jointplay: key {key.id} ({key.name}) is revoked", err=True)


@contextmanager
def keys_of(data: Path | None) -> Iterator[Keys]:
    """Open the keys of a service's database, for the time of a ``with`` block."""
    from jointplay.app.actor import acting_at_prompt
    from jointplay.app.settings import ServiceSettings
    from jointplay.app.storage.keys import Keys
    from jointplay.app.storage.store import Store

    settings = ServiceSettings() if data is None else ServiceSettings(data=data)
    store = Store(settings.data, settings.database)
    try:
        with acting_at_prompt():
            yield Keys(store.database)
    finally:
        store.close()


def describe_key(key: Key) -> dict[str, object]:
    """Return what is printed of a key as JSON."""
    return {
        "id": key.id,
        "name": key.name,
        "scopes": sorted(key.scopes),
        "created_at": key.created_at.isoformat(),
        "expires_at": key.expires_at.isoformat(),
        "used_at": None if key.used_at is None else key.used_at.isoformat(),
        "state": key.state,
    }


def day(moment: datetime) -> str:
    """Return a date."""
    return moment.date().isoformat()
