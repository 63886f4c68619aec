"""``jointplay follow``: a machine's state of wear from all its recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.commands.diagnose import check_counts, read_baselines, read_measurements
from jointplay.app.commands.parameters import (
    Pairs,
    baseline_option,
    each_once,
    existing_catalogue,
    file_options,
    json_option,
    speeds_option,
)
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.fields import PROFILE
from jointplay.app.tables import indent, table
from jointplay.app.words import in_utc, parse_moment, placed

if TYPE_CHECKING:
    from jointplay.catalogue.following.state import WearState
    from jointplay.catalogue.following.visits import Inspection
    from jointplay.catalogue.matching.modes import Effort


@click.command("follow")
@click.argument("measurements", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="MEASUREMENT...")
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@click.option(
    "--effort",
    type=click.Choice(["fast", "standard", "thorough"]),
    default="standard",
    show_default=True,
    help="How much to compute for each measurement; for baselines among them standard at the most.",
)
@speeds_option
@baseline_option
@click.option(
    "--found",
    type=Pairs("JOINT=CLEARANCE@TIME"),
    multiple=True,
    help='Radial clearance that somebody measured: "B=140um@2026-11-21T10:30:00Z"; may be repeated.',
)
@click.option(
    "--repaired",
    type=Pairs("JOINT=TIME"),
    multiple=True,
    help='Joint that was made as new: "B=2026-11-21T12:00:00Z"; may be repeated.',
)
@file_options
@click.option(
    "--map", "mapping", type=Pairs("COLUMN=SENSOR"), multiple=True, help="Column of a sensor; may be repeated."
)
@click.option("--profile", type=click.Path(path_type=Path), metavar="FILE", help=PROFILE)
@json_option
def command(
    measurements: Sequence[Path],
    catalogue: Path,
    effort: Effort,
    speeds: Sequence[float],
    baselines: Sequence[Path],
    found: Sequence[tuple[str, str]],
    repaired: Sequence[tuple[str, str]],
    mapping: Sequence[tuple[str, str]],
    profile: Path | None,
    as_json: bool,
    **told: Any,
) -> None:
    """Say how worn a machine is by all its MEASUREMENTS in the order they were made, how fast it wears, and until when.

    Each needs the time when it was made: in the file, or by --measured-at.
    """
    from jointplay.catalogue.diagnosing.diagnosis import diagnose
    from jointplay.catalogue.following.follow import follow
    from jointplay.catalogue.following.play import bounds_of
    from jointplay.catalogue.following.visits import Visit
    from jointplay.catalogue.storage.store import Catalogue

    check_counts(measurements, told, speeds)
    inspections = list(read_inspections(found, repaired))
    recordings, said = read_measurements(measurements, told, profile)
    for file, recording in zip(measurements, recordings, strict=True):
        if recording.measured_at is None:
            raise click.BadParameter(f"{file}: says no time of measurement", param_hint="'--measured-at'")
    opened = Catalogue.open(existing_catalogue(catalogue))
    wearing = sorted({joint for hypothesis in opened.matrix.hypotheses for joint in hypothesis.joints})
    bounds = bounds_of(opened.machine, wearing)
    for option, each in (("--found", found), ("--repaired", repaired)):
        for joint, what in each:
            if joint not in bounds:
                rule = f"must be one of {', '.join(bounds)}"
                raise click.BadParameter(f'"{joint}={what}": joint {joint}: {rule}', param_hint=f"'{option}'")
    sensors, in_order = each_once(mapping, "--map") or None, read_baselines(baselines, said, profile)
    visits = []
    with ProgressLine("diagnosing", "recordings") as line:
        for place, recording in enumerate(recordings):
            line.show(place, len(recordings))
            assert recording.measured_at is not None
            past = [each for each in in_order if each.sha256 != recording.sha256]
            # One of the baselines has another past, whose machine effort thorough would simulate for it alone.
            asked = "standard" if effort == "thorough" and len(past) < len(in_order) else effort
            speed = speeds[place] if speeds else None
            answer = diagnose(recording, opened, speed=speed, effort=asked, mapping=sensors, baseline=past)
            visits.append(Visit(recording.measured_at, recording.sha256, answer))
        line.show(len(recordings), len(recordings))
    state = follow(visits, inspections, bounds=bounds)
    if as_json:
        click.echo(state.model_dump_json(indent=2))
        return
    click.echo(report(state))
    turned = (
        f"{each.name} {visit.answer.drive_speed_rpm:.6g} rpm" for each, visit in zip(recordings, visits, strict=True)
    )
    click.echo(f"drive speeds: {', '.join(turned)}")


def read_inspections(found: Sequence[tuple[str, str]], repaired: Sequence[tuple[str, str]]) -> Iterator[Inspection]:
    """Return what options say was found, and made as new."""
    from jointplay.catalogue.following.visits import Inspection
    from jointplay.solver.errors import UnitError
    from jointplay.solver.machines.units import LENGTH, to_si

    for joint, said in found:
        size, _, at = said.partition("@")
        try:
            if size.strip()[-1:].isdigit():
                raise UnitError(f"{size}: must have a unit, such as {size.strip()}um")
            yield Inspection(read_moment(at, f"{joint}={said}", "--found"), {joint: to_si(size, LENGTH)})
        except UnitError as error:
            raise click.BadParameter(f'"{joint}={said}": {error}', param_hint="'--found'") from None
    for joint, at in repaired:
        yield Inspection(read_moment(at, f"{joint}={at}", "--repaired"), repaired=frozenset([joint]))


def read_moment(text: str, said: str, option: str) -> datetime:
    """Return a moment with its zone; a refusal names the option."""
    try:
        return placed(in_utc(datetime.fromisoformat(str(parse_moment(text)))))
    except ValueError as error:
        raise click.BadParameter(f'"{said}": the time {error}', param_hint=f"'{option}'") from None


def report(state: WearState) -> str:
    """Return a state of wear as plain text."""
    from jointplay.app.pages.wear_state import show_state

    shown = show_state(state)
    rows = [
        (row["name"], f"{row['said']}, {row['percent']}", f"{row['clearance']} ({row['interval']})", row["rate"],
         row["limit"], row["reached"] + (f", likely {row['likely']}" if row["likely"] else ""), row["sure"] or "-")
        for row in shown["joints"]
    ]  # fmt: skip
    head = ("joint", "worn", "radial clearance (90 % interval)", "grows by", "limit", "reached (90 %)", "sure since")
    said = f"By {state.visits} recording{'s' * (state.visits > 1)}, up to {shown['at']} UTC:"
    return "\n".join([said, indent(table(head, rows)), shown["moved"], *shown["besides"]])
