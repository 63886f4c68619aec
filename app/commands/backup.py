"""``jointplay backup``: copy everything a service keeps, while it works."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.commands.keys import data_option
from jointplay.app.commands.parameters import json_option, print_json

if TYPE_CHECKING:
    from jointplay.app.storage.backup import Place

catalogues_option = click.option(
    "--catalogues",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Directory of catalogues (JOINTPLAY_CATALOGUES) [default: .jointplay/catalogues].",
)


@click.command("backup")
@click.argument("folder", type=click.Path(path_type=Path))
@catalogues_option
@data_option
@click.option("--no-catalogues", is_flag=True, help="Leave the catalogues out: they can be built again.")
@click.option(
    "--last",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="A backup of before, on the same disk: files that have not changed are links to it, and take no space.",
)
@json_option
def command(
    folder: Path, catalogues: Path | None, data: Path | None, no_catalogues: bool, last: Path | None, as_json: bool
) -> None:
    """Copy recordings, results, keys, machines and catalogues of a service to FOLDER, which is new or empty.

    The service may go on meanwhile. JOINTPLAY_DATABASE names its database, where that is no file in its directory. What
    is damaged is named, left out or taken from the last backup, and all else is copied: then the exit status is 1.
    """
    from jointplay.app.storage.backup import back_up

    copied = back_up(place_of(catalogues, data), folder, catalogues=not no_catalogues, last=last)
    tell(copied, "copied", folder, as_json=as_json)


def place_of(catalogues: Path | None, data: Path | None) -> Place:
    """Return where a service keeps what it keeps, from options and environment."""
    from jointplay.app.settings import ServiceSettings
    from jointplay.app.storage.backup import Place

    given: dict[str, Any] = {"catalogues": catalogues, "data": data}
    settings = ServiceSettings(**{name: value for name, value in given.items() if value is not None})
    return Place(settings.data, settings.catalogues, settings.database)


def tell(content: dict[str, Any], done: str, folder: Path, *, as_json: bool) -> None:
    """Print what a backup holds.

    Raises
    ------
    DamagedBackupError
        When something in it is damaged.
    """
    from jointplay.app.errors import DamagedBackupError

    damaged = content.get("damaged", [])
    if as_json:
        print_json(content)
    else:
        for each in damaged:
            click.echo(f"damaged: {each['what']} {each['name']}: {each['how']}")
        if gone := content.get("deleted_meanwhile"):
            click.echo(f"deleted while it was copied: {len(gone)} recordings")
        rows = sum(content["rows"].values())
        catalogues = ", ".join(content["catalogues"]) or "none"
        size = f"; {content['copied_bytes'] / 1e6:.1f} MB new" if "copied_bytes" in content else ""
        click.echo(
            f"{done}: {rows} rows, {content['recordings']} recordings, {content['machines']} machines{size}; "
            f"catalogues: {catalogues}"
        )
    if damaged:
        raise DamagedBackupError(f"{folder}: {len(damaged)} damaged, {done} all the same: {said(damaged[0])}")


def said(damage: dict[str, str]) -> str:
    """Return what is damaged, in words."""
    return f"{damage['what']} {damage['name']} {damage['how']}"
