"""``jointplay verify``: check a catalogue and repair its index."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import catalogue_option, existing_catalogue, json_option, print_json

if TYPE_CHECKING:
    from jointplay.catalogue.storage.verify import VerifyReport


@click.command("verify")
@catalogue_option
@json_option
def command(catalogue: Path, as_json: bool) -> None:
    """Check every stored spectrum against its checksum and the index against the files; repair the index.

    Exit status 1 means that spectra are lost: building again computes them.
    """
    from jointplay.catalogue.storage.verify import verify

    tell(verify(existing_catalogue(catalogue)), catalogue, "in order", as_json=as_json)


def tell(report: VerifyReport, catalogue: Path, sound: str, *, as_json: bool) -> None:
    """Print what a check found.

    Parameters
    ----------
    report : VerifyReport
    catalogue : Path
        Its folder.
    sound : str
        What is said when nothing was wrong.
    as_json : bool

    Raises
    ------
    DamagedCatalogueError
        Cases are lost.
    """
    from jointplay.app.errors import DamagedCatalogueError

    if as_json:
        print_json(
            {
                "catalogue": str(catalogue),
                "sound": report.is_sound,
                "files": report.shards,
                "entries": report.entries,
                "failed_entries": report.failed,
                "lost_entries": report.lost_entries,
                "other_numbers": report.other_numbers or None,
                "findings": [
                    {"path": str(finding.path), "what": finding.what, "action": finding.action}
                    for finding in report.findings
                ],
            }
        )
    else:
        for finding in report.findings:
            click.echo(str(finding))
        state = sound if report.is_sound else "repaired"
        click.echo(
            f"{catalogue}: {state}: {report.entries} cases in {report.shards} files, {report.failed} without a spectrum"
        )
        if report.other_numbers:
            click.echo(f"{catalogue}: {report.other_numbers}: diagnoses go on with it, builds do not")
    if report.lost_entries:
        raise DamagedCatalogueError(
            f"{catalogue}: {report.lost_entries} cases are lost; `jointplay build` computes them again"
        )
