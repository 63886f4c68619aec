"""``jointplay reindex``: make what is derived from a catalogue's spectra again."""

from __future__ import annotations

from pathlib import Path

import click

from jointplay.app.commands.parameters import catalogue_option, existing_catalogue, json_option
from jointplay.app.commands.verify import tell


@click.command("reindex")
@catalogue_option
@json_option
def command(catalogue: Path, as_json: bool) -> None:
    """Throw the index and the feature matrix away and make them again from the stored spectra, which are checked.

    Exit status 1 means that spectra are lost: building again computes them.
    """
    from jointplay.catalogue.storage.verify import reindex

    tell(reindex(existing_catalogue(catalogue)), catalogue, "index and matrix made again", as_json=as_json)
