"""``jointplay build``: make or extend a catalogue."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import json_option, print_json
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.jobs.forecasts import forecast_text
from jointplay.app.jobs.quality_cards import card_text, made_card

if TYPE_CHECKING:
    from jointplay.catalogue.building.build import BuildReport


@click.command("build")
@click.argument("machine")
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@click.option(
    "--plan",
    default="standard",
    show_default=True,
    metavar="quick|standard|thorough|PLAN.yaml",
    help="Which cases it is to hold.",
)
@click.option("--workers", type=click.IntRange(1, 1024), help="Processes that compute; by default one a processor.")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Compute on a Dask cluster, tcp://host:8786, in place of processes here."
)
@click.option(
    "--index", metavar="URL", help="Database for the index, postgresql://user@host/database; remembered in the folder."
)
@click.option("--dry-run", is_flag=True, help="Build nothing: try some cases, and say what time and space all take.")
@json_option
def command(
    machine: str,
    catalogue: Path,
    plan: str,
    workers: int | None,
    scheduler: str | None,
    index: str | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Build the catalogue of MACHINE (a shipped machine's name, or a file).

    What is there already is kept; the same command again goes on where an interrupted one stopped.
    """
    with going_on(dry_run):
        from jointplay.catalogue.building.build import build
        from jointplay.catalogue.building.executors import count_processors
        from jointplay.catalogue.building.network_building import train_networks
        from jointplay.catalogue.plans.plan import load_plan
        from jointplay.catalogue.plans.plan_check import check_plan, plan_lines
        from jointplay.solver.machines.fault import Fault
        from jointplay.solver.machines.machine import load_machine

        if scheduler is not None and workers is not None:
            raise click.UsageError("--workers is for processes here; a cluster has its own")
        if scheduler is not None and dry_run:
            raise click.UsageError("--dry-run is for processes here; how fast a cluster is, only it can tell")
        if scheduler is not None:
            from jointplay.catalogue.building.cluster import DaskCluster, check_address

            check_address(scheduler)
        filed, wanted = load_machine(machine), load_plan(plan)
        found = filed.without_clearances()
        if filed.clearances:
            told = f"{Fault(filed.clearances).label} of the file is left aside: the plan says what is worn"
            click.echo(f"note: {told}", err=True)
        check_plan(wanted, found, plan)
        for shown in plan_lines(wanted, found):
            click.echo(shown, err=True)
        count = workers or count_processors()
        if dry_run:
            from jointplay.catalogue.building.forecast import forecast

            foreseen = forecast(found, wanted, count, catalogue)
            if as_json:
                print_json({"plan": {"name": wanted.name, "hash": wanted.hash}} | asdict(foreseen))
            else:
                click.echo(f"{catalogue}: {forecast_text(foreseen)}")
            return
        with ExitStack() as stack:
            line = stack.enter_context(ProgressLine("building", "cases"))
            executor = None
            if scheduler is not None:
                executor = DaskCluster(scheduler, tell=lambda said: click.echo(said, err=True))
                stack.callback(executor.close, at_once=True)
            report = build(
                found,
                wanted,
                catalogue,
                workers=count,
                executor=executor,
                index=index,
                progress=lambda state: line.show(state.done, state.total, rate=state.rate, left=state.eta),
            )
        if as_json:
            print_json({"plan": {"name": wanted.name, "hash": wanted.hash}} | document(report, catalogue))
        else:
            tell(report, catalogue)
        if report.lost:
            from jointplay.app.errors import IncompleteBuildError

            raise IncompleteBuildError(
                f"{len(report.lost)} cases could not be computed: {report.lost_reason};"
                " the same command tries them again"
            )
        # Last, so that what was built is told whatever becomes of it.
        with ProgressLine("learning", "networks") as line:
            train_networks(catalogue, workers=count, progress=line.show)
        card, why = made_card(catalogue)
        if not as_json:
            click.echo(card_text(card) if card is not None else f"no quality card: {why}")


@contextmanager
def going_on(dry_run: bool) -> Iterator[None]:
    """Say, where a build is interrupted, how it goes on."""
    try:
        yield
    except KeyboardInterrupt:
        if not dry_run:
            click.echo("what is computed is kept; the same command goes on where this one stopped", err=True)
        raise


def document(report: BuildReport, catalogue: Path) -> dict[str, object]:
    """Return the report as JSON values."""
    return {
        "catalogue": str(catalogue),
        "added": report.added,
        "added_by_others": report.others,
        "present": report.present,
        "adopted": report.adopted,
        "failed": dict(report.failed),
        "lost": list(report.lost),
        "lost_reason": report.lost_reason,
        "workers_lost": report.workers_lost,
        "elapsed_s": report.seconds,
        "size_bytes": report.size,
    }


def tell(report: BuildReport, catalogue: Path) -> None:
    """Print the report as plain lines."""
    others = f", {report.others} by other builders" if report.others else ""
    click.echo(
        f"{catalogue}: {report.added} cases added in {report.seconds:.1f} s{others}, {report.present} were there; "
        f"{report.size / 1e6:.1f} MB"
    )
    if report.failed:
        listed = ", ".join(f"{count} {status}" for status, count in sorted(report.failed.items()))
        click.echo(f"cases without a spectrum: {listed}")
    if report.workers_lost:
        click.echo(f"workers that died and were replaced: {report.workers_lost}")
