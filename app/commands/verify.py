"""``jointplay verify``: check a catalogue and repair its index, or check everything that a service keeps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.backup import catalogues_option
from jointplay.app.commands.parameters import existing_catalogue, json_option, print_json

if TYPE_CHECKING:
    from jointplay.catalogue.storage.verify import VerifyReport


@click.command("verify")
@click.option("--catalogue", type=click.Path(path_type=Path), metavar="DIR", help="Folder of a catalogue to check.")
@click.option("--data", type=click.Path(path_type=Path), metavar="DIR", help="Directory of a service to check.")
@click.option(
    "--repeat",
    type=click.IntRange(0),
    default=0,
    metavar="N",
    show_default=True,
    help="With --data: make the newest N diagnoses again, and compare.",
)
@click.option(
    "--report",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE",
    help="With --data: check a report, HTML or PDF, against the diagnosis it is of, in place of everything.",
)
@catalogues_option
@json_option
def command(
    catalogue: Path | None, data: Path | None, repeat: int, report: Path | None, catalogues: Path | None, as_json: bool
) -> None:
    """Check a catalogue, or what a service keeps.

    --catalogue checks every stored spectrum against its checksum and the index against the files, and repairs the
    index. Exit status 1 means that spectra are lost: building again computes them.

    --data checks every row against its checksum, every recording against its SHA-256, and the chain of the audit log.
    JOINTPLAY_DATABASE names the database, where that is no file in DIR. A line for each damage, and exit status 1, mean
    that what they name is to be brought back from a backup.
    """
    if (catalogue is None) == (data is None):
        raise click.UsageError("--catalogue, --data: give one of them")
    if data is not None:
        from jointplay.app.commands.verify_data import verify_service
        from jointplay.app.settings import ServiceSettings

        settings = (
            ServiceSettings(data=data) if catalogues is None else ServiceSettings(data=data, catalogues=catalogues)
        )
        if not settings.database and not (data / "service.sqlite").is_file():
            raise click.UsageError(f"--data: {data}: holds no service")
        verify_service(settings, repeat, report, as_json=as_json)
        return
    if repeat or report:
        raise click.UsageError("--repeat, --report: need --data")
    from jointplay.catalogue.storage.verify import verify

    assert catalogue is not None
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
