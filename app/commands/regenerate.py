"""``jointplay regenerate``: simulate stored cases again and compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import catalogue_option, existing_catalogue, json_option, print_json
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.figures.machine_account import drive_of

if TYPE_CHECKING:
    from jointplay.catalogue.building.regenerate import RegenerateReport


@click.command("regenerate")
@catalogue_option
@click.option(
    "--sample", type=click.IntRange(1), default=20, show_default=True, metavar="N", help="Number of cases, at random."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Which cases.")
@click.option("--workers", type=click.IntRange(1, 1024), help="Processes that compute; by default one a processor.")
@json_option
def command(catalogue: Path, sample: int, seed: int, workers: int | None, as_json: bool) -> None:
    """Simulate N cases of a catalogue again and compare them with what is stored.

    On the kind of computer that built it, with the same packages, every bit is the same. Where sums round differently,
    machines with play take another course: levels then differ by some tenths of a decibel on average. Exit status 1: a
    status has changed, or the mean difference is above 1 dB.
    """
    from jointplay.app.errors import DamagedCatalogueError
    from jointplay.catalogue.building.executors import count_processors
    from jointplay.catalogue.building.regenerate import TOLERANCE_DB, regenerate
    from jointplay.catalogue.storage.store import Catalogue

    opened = Catalogue.open(existing_catalogue(catalogue))
    with ProgressLine("simulating", "cases") as line:
        report = regenerate(opened, sample, seed=seed, workers=workers or count_processors(), progress=line.show)
    if as_json:
        print_json(document(report, catalogue))
    else:
        tell(report, catalogue)
        click.echo(f"drive: {drive_of(opened.machine, opened.recipe.nominal_drive_speed)}")
    if report.changed:
        first = report.changed[0]
        raise DamagedCatalogueError(
            f"{catalogue}: {len(report.changed)} of {len(report.cases)} cases end otherwise now: "
            f"{first.key[:12]} was {first.stored}, is {first.now}"
        )
    if not report.agrees:
        raise DamagedCatalogueError(
            f"{catalogue}: mean difference {report.mean_db:.2f} dB: must not be greater than {TOLERANCE_DB:g} dB"
        )


def document(report: RegenerateReport, catalogue: Path) -> dict[str, object]:
    """Return the report as JSON values."""
    return {
        "catalogue": str(catalogue),
        "cases": [
            {
                "key": case.key,
                "hypothesis": case.hypothesis,
                "stored": case.stored,
                "now": case.now,
                "difference_db": case.difference_db,
                "identical": case.identical,
            }
            for case in report.cases
        ],
        "identical": report.identical,
        "changed": len(report.changed),
        "mean_db": report.mean_db,
        "same_program": report.same_program,
        "agrees": report.agrees,
        "elapsed_s": report.seconds,
    }


def tell(report: RegenerateReport, catalogue: Path) -> None:
    """Print the report as plain lines."""
    click.echo(
        f"{catalogue}: {report.identical} of {len(report.cases)} cases identical, "
        f"mean difference {report.mean_db:.2f} dB, in {report.seconds:.1f} s"
    )
    worst = report.worst
    if worst is not None and worst.difference_db > 0.0:
        click.echo(f"largest difference: {worst.difference_db:.2f} dB, {worst.key[:12]} ({worst.hypothesis})")
    if not report.same_program:
        click.echo("packages, system or processor are not those of the build")
