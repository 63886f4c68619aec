"""``jointplay evaluate``: how good the diagnoses of a catalogue are, on recordings simulated now."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from app.commands.parameters import existing_catalogue, json_option, print_json
from app.commands.progress import ProgressLine
from app.commands.tables import indented, table

if TYPE_CHECKING:
    from catalogue.evaluate import Evaluation


@click.command("evaluate")
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@click.option(
    "--protocol",
    default="noisy",
    show_default=True,
    metavar="matched|noisy|hard",
    help="Conditions of the recordings.",
)
@click.option("--count", default=120, show_default=True, type=click.IntRange(1, 100_000), help="Recordings.")
@click.option("--seed", default=1, show_default=True, type=int, help="Of everything drawn.")
@click.option(
    "--effort",
    default="standard",
    show_default=True,
    type=click.Choice(["fast", "standard", "thorough"]),
    help="Method.",
)
@json_option
def command(catalogue: Path, protocol: str, count: int, seed: int, effort: str, as_json: bool) -> None:
    """Measure diagnoses on freshly simulated recordings that the catalogue has not seen."""
    from typing import cast

    from catalogue.answer import Effort
    from catalogue.evaluate import evaluate
    from catalogue.store import Catalogue

    opened = Catalogue.open(existing_catalogue(catalogue))
    with ProgressLine("diagnosing", "recordings") as line:
        found = evaluate(opened, protocol, count, seed, effort=cast("Effort", effort), progress=line.show)
    if as_json:
        print_json(found.content())
    else:
        click.echo(report(found))


def report(found: Evaluation) -> str:
    """Return the figures as text."""

    def percent(value: float | None) -> str:
        return "-" if value is None else f"{100 * value:.1f} %"

    lines = [
        f"{found.count} recordings, protocol {found.protocol.name}, seed {found.seed}, effort {found.effort}"
        + (f"; {found.failed} could not be simulated" if found.failed else "")
        + (f"; {found.refused} were refused" if found.refused else ""),
        f"right hypothesis first            {percent(found.top1)}",
        f"among the first two               {percent(found.top2)}",
        f"log-loss, calibration error       {found.log_loss:.3f}, {found.calibration_error:.3f}",
        f"clearance error, median and p90   {percent(found.clearance_median)}, {percent(found.clearance_p90)}",
        f"truth inside the 90 % interval    {percent(found.interval_coverage)}",
        f"truth in the candidate set        {percent(found.set_coverage)}, {found.set_size:.2f} members",
        f"verdict unknown; wrong verdict    {percent(found.unknown)}; {percent(found.wrong_verdict)}",
        f"a diagnosis, median and worst     {found.seconds_median:.3f} s, {found.seconds_worst:.2f} s",
        "",
        "truth (rows) against the first hypothesis (columns):",
    ]
    rows = [[label, *(str(cell) for cell in row)] for label, row in zip(found.labels, found.confusion, strict=True)]
    numbers = frozenset(range(1, len(found.labels) + 1))
    return "\n".join([*lines, indented(table(["", *found.labels], rows, numbers))])
