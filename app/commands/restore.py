"""``jointplay restore``: bring a backup to where a service is to find it."""

from __future__ import annotations

from pathlib import Path

import click

from jointplay.app.commands.backup import catalogues_option, place_of, tell
from jointplay.app.commands.keys import data_option
from jointplay.app.commands.parameters import json_option


@click.command("restore")
@click.argument("folder", type=click.Path(path_type=Path))
@catalogues_option
@data_option
@click.option("--check", "only_check", is_flag=True, help="Bring nothing anywhere: read every file and row of FOLDER.")
@json_option
def command(folder: Path, catalogues: Path | None, data: Path | None, only_check: bool, as_json: bool) -> None:
    """Bring what `jointplay backup` copied to FOLDER to a new place, before a service is started there.

    JOINTPLAY_DATABASE names the database, which may be of another kind than the copied one; it has to be empty. What is
    damaged, or was when it was copied, is named and left out, and all else is brought: then the exit status is 1.
    """
    from jointplay.app.storage.backup import check, restore

    if only_check:
        tell(check(folder), "checked", folder, as_json=as_json)
    else:
        tell(restore(folder, place_of(catalogues, data)), "restored", folder, as_json=as_json)
