"""``jointplay export``: a catalogue as one file."""

from __future__ import annotations

from pathlib import Path

import click

from jointplay.app.commands.parameters import catalogue_option, existing_catalogue, json_option, print_json


@click.command("export")
@catalogue_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="File to write; .h5, .npz (everything) or .csv (levels in feature bands).",
)
@click.option(
    "--hypothesis",
    "hypotheses",
    multiple=True,
    metavar="LABEL",
    help="Only this one, such as A+C; repeatable.",
)
@json_option
def command(catalogue: Path, out: Path, hypotheses: tuple[str, ...], as_json: bool) -> None:
    """Write the cases of a catalogue with their spectra into one file for other programs."""
    from jointplay.app.errors import OutputError
    from jointplay.app.figures.outputs import check_output
    from jointplay.catalogue.storage.export import ENDINGS, export
    from jointplay.catalogue.storage.store import Catalogue

    check_output(out, ENDINGS, "must end in .h5, .csv or .npz")
    opened = Catalogue.open(existing_catalogue(catalogue))
    unknown = [label for label in hypotheses if label not in opened.matrix.labels]
    if unknown:
        raise OutputError(f"--hypothesis {unknown[0]}: is not one of {', '.join(opened.matrix.labels)}")
    count = export(opened, out, hypotheses or None)
    if as_json:
        print_json({"catalogue": str(catalogue), "file": str(out), "cases": count, "size_bytes": out.stat().st_size})
    else:
        click.echo(f"{out}: {count} cases, {out.stat().st_size / 1e6:.1f} MB")
