"""``jointplay verify``: check a catalogue and repair its index."""

from __future__ import annotations

from pathlib import Path

import click

from app.commands.parameters import existing_catalogue, json_option, print_json


@click.command("verify")
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@json_option
def command(catalogue: Path, as_json: bool) -> None:
    """Check every stored spectrum against its checksum and the index against the files; repair the index.

    Exit status 1 means that spectra are lost: building again computes them.
    """
    from app.errors import DamagedCatalogueError
    from catalogue.verify import verify

    report = verify(existing_catalogue(catalogue))
    if as_json:
        print_json(
            {
                "catalogue": str(catalogue),
                "sound": report.is_sound,
                "files": report.shards,
                "entries": report.entries,
                "failed_entries": report.failed,
                "lost_entries": report.lost_entries,
                "findings": [
                    {"path": str(finding.path), "what": finding.what, "action": finding.action}
                    for finding in report.findings
                ],
            }
        )
    else:
        for finding in report.findings:
            click.echo(str(finding))
        state = "in order" if report.is_sound else "repaired"
        click.echo(
            f"{catalogue}: {state}: {report.entries} cases in {report.shards} files, {report.failed} without a spectrum"
        )
    if report.lost_entries:
        raise DamagedCatalogueError(
            f"{catalogue}: {report.lost_entries} cases are lost; `jointplay build` computes them again"
        )
