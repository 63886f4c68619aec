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
@json_option
def command(folder: Path, catalogues: Path | None, data: Path | None, no_catalogues: bool, as_json: bool) -> None:
    """Copy recordings, results, keys, machines and catalogues of a service to FOLDER, which is new or empty.

    The service may go on meanwhile. JOINTPLAY_DATABASE names its database, where that is no file in its directory.
    """
    from jointplay.app.storage.backup import back_up

    tell(back_up(place_of(catalogues, data), folder, catalogues=not no_catalogues), "copied", as_json=as_json)


def place_of(catalogues: Path | None, data: Path | None) -> Place:
    """Return where a service keeps what it keeps, from options and environment."""
    from jointplay.app.settings import ServiceSettings
    from jointplay.app.storage.backup import Place

    given: dict[str, Any] = {"catalogues": catalogues, "data": data}
    settings = ServiceSettings(**{name: value for name, value in given.items() if value is not None})
    return Place(settings.data, settings.catalogues, settings.database)


def tell(content: dict[str, Any], done: str, *, as_json: bool) -> None:
    """Print what a backup holds."""
    if as_json:
        print_json(content)
        return
    rows = sum(content["rows"].values())
    catalogues = ", ".join(content["catalogues"]) or "none"
    click.echo(
        f"{done}: {rows} rows, {content['recordings']} recordings, {content['machines']} machines; "
        f"catalogues: {catalogues}"
    )
