"""``python -m jointplay.app.demo``: build or reuse a catalogue, diagnose three recordings, compare with the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jointplay.app import words
from jointplay.app.cli import run
from jointplay.app.commands.diagnose import ranking
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.shelves.built_in import content_of, file_name, read_truths
from jointplay.app.tables import indent
from jointplay.catalogue.building.executors import count_processors

MACHINE = "quick-return"
PLAN = "quick"
CATALOGUE = Path(".jointplay/catalogues") / MACHINE


def demo() -> None:
    """Run the demo in the present folder."""
    from jointplay.catalogue.diagnosing.diagnosis import diagnose
    from jointplay.catalogue.measurements.measurement import read_measurement
    from jointplay.catalogue.storage.store import Catalogue

    click.echo(f"Machine {MACHINE}: which of its turning joints is worn, from vibration of its frame alone?\n")
    build_catalogue()
    started = time.monotonic()
    catalogue = Catalogue.open(CATALOGUE)
    for name, truth in read_truths().items():
        recording = read_measurement(content_of(name), name=file_name(name))
        result = diagnose(recording, catalogue)
        click.echo(f"\n{name}.csv.gz")
        click.echo(f"  verdict: {words.sentence(result)}")
        click.echo(f"  truth:   {truth_sentence(truth)}")
        for line in words.remarks(result):
            click.echo(f"  {line}")
        click.echo(indent(ranking(result, 3), "    "))
        for warning in result.warnings:
            click.echo(f"  warning: {warning}")
    click.echo(f"\nDiagnosed in {time.monotonic() - started:.1f} s.")
    click.echo(
        "The same in a browser: `make serve`, then http://127.0.0.1:8000; the recordings are in app/demo/recordings."
    )


def build_catalogue() -> None:
    """Build the catalogue of the demo, or go on with it; one that fits no longer is built anew."""
    import shutil

    from jointplay.catalogue.building.build import build
    from jointplay.catalogue.errors import CatalogueMismatchError
    from jointplay.catalogue.plans.plan import load_plan
    from jointplay.solver.machines.machine import shipped_machine

    machine, plan = shipped_machine(MACHINE), load_plan(PLAN)

    def make() -> None:
        with ProgressLine("simulating", "cases") as line:
            report = build(
                machine,
                plan,
                CATALOGUE,
                workers=count_processors(),
                progress=lambda state: line.show(state.done, state.total),
            )
        made = f"built in {report.seconds:.1f} s" if report.added else "there already"
        click.echo(f"Catalogue {CATALOGUE}: {report.added + report.present} simulated cases, {made}.")

    try:
        make()
    except CatalogueMismatchError:
        # Made by an older version, or for another machine file: it is a cache, and nothing in it is missed.
        shutil.rmtree(CATALOGUE)
        make()


def truth_sentence(truth: Mapping[str, Any]) -> str:
    """Return what a recording was made with."""
    worn = truth["worn_um"]
    if not worn:
        return f"no worn joint ({truth['speed_rpm']:.5g} rpm)"
    listed = ", ".join(f"{joint} worn, {clearance:.0f} µm" for joint, clearance in worn.items())
    return f"{listed} ({truth['speed_rpm']:.5g} rpm)"


if __name__ == "__main__":
    raise SystemExit(run(demo))
