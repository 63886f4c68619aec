"""``jointplay diagnose``: which joints are worn, and how much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app import words
from jointplay.app.commands.parameters import (
    Pairs,
    Quantity,
    each_once,
    existing_catalogue,
    json_option,
    print_json,
    refuse_given,
)
from jointplay.app.rows import hypothesis_rows, joint_rows, percent
from jointplay.app.tables import indented, table
from jointplay.catalogue.matching.prior import LARGEST, Prior

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Diagnosis, Effort, ModeAsked
    from jointplay.catalogue.measurements.import_profile import ImportProfile


@click.command("diagnose")
@click.argument("measurement", type=click.Path(path_type=Path))
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@click.option(
    "--speed", type=Quantity("ANGULAR_SPEED"), help='Drive speed, such as "600 rpm"; estimated when not given.'
)
@click.option(
    "--effort",
    type=click.Choice(["fast", "standard", "thorough"]),
    default="standard",
    show_default=True,
    help="How much to compute.",
)
@click.option(
    "--mode",
    type=click.Choice(["auto", "trusted", "robust"]),
    default="auto",
    show_default=True,
    help="Whether the machine is as simulated, or may differ from it.",
)
@click.option(
    "--cases",
    type=click.IntRange(1, 100_000),
    default=240,
    show_default=True,
    help="Cases that effort thorough may simulate.",
)
@click.option(
    "--prior",
    "priors",
    type=Pairs("JOINT=WEIGHT"),
    multiple=True,
    help='How much likelier than the others a joint is to wear: "A=3"; may be repeated.',
)
@click.option(
    "--worn",
    type=click.FloatRange(1.0 / LARGEST, 1.0 - 1.0 / LARGEST),
    default=Prior().worn,
    show_default=True,
    help="Probability beforehand that any joint is worn.",
)
@click.option(
    "--another",
    type=click.FloatRange(1.0 / LARGEST, LARGEST),
    default=Prior().another,
    show_default=True,
    help="How much likelier beforehand it is that one joint more is worn, whichever they are.",
)
@click.option(
    "--baseline",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Recording of the machine in order by the same sensors: fits frame, supports and sensor gains.",
)
@click.option("--sample-rate", type=Quantity("FREQUENCY"), help='Of a recording without times, such as "10 kHz".')
@click.option(
    "--map", "mapping", type=Pairs("COLUMN=SENSOR"), multiple=True, help="Column of a sensor; may be repeated."
)
@click.option(
    "--unit", "units", type=Pairs("COLUMN=UNIT"), multiple=True, help='Unit of a column; "*" for all that name none.'
)
@click.option(
    "--profile",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="How to read the recording: names, units, full scale, decimal comma and more, in YAML or JSON.",
)
@click.option("--full-scale", metavar="VALUE UNIT", help='What the full scale of a WAV file stands for, such as "5 g".')
@click.option(
    "--sensitivity",
    "sensitivities",
    type=Pairs("COLUMN=VOLTAGE/UNIT"),
    multiple=True,
    help='What a sensor gives whose column is in volts: "s1-x=100 mV/g"; "*" for all of them.',
)
@click.option("--tacho", metavar="COLUMN", help="Column with pulses of the drive's shaft.")
@click.option("--pulses", type=click.IntRange(1, 10_000), help="Pulses of the tacho a revolution; 1 unless given.")
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE.png|.svg|.pdf", help="Draw measured and matched."
)
@json_option
def command(
    measurement: Path,
    catalogue: Path,
    speed: float | None,
    effort: Effort,
    mode: ModeAsked,
    cases: int,
    priors: Sequence[tuple[str, str]],
    worn: float,
    another: float,
    baseline: Path | None,
    sample_rate: float | None,
    mapping: Sequence[tuple[str, str]],
    units: Sequence[tuple[str, str]],
    profile: Path | None,
    full_scale: str | None,
    sensitivities: Sequence[tuple[str, str]],
    tacho: str | None,
    pulses: int | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Rank the fault hypotheses of a catalogue for MEASUREMENT, accelerations of the machine's frame."""
    if plot is not None:
        from jointplay.app.figures.plots import check_ending

        check_ending(plot)
    if effort != "thorough":
        refuse_given(("cases",), "means something with --effort thorough only")
    if tacho is None:
        refuse_given(("pulses",), "means something with --tacho only")
    from jointplay.catalogue.diagnosing.diagnosis import diagnose
    from jointplay.catalogue.measurements.measured_spectrum import read_recording
    from jointplay.catalogue.measurements.measurement import read_measurement
    from jointplay.catalogue.storage.store import Catalogue

    sensors, given_units = each_once(mapping, "--map"), each_once(units, "--unit")
    opened = Catalogue.open(existing_catalogue(catalogue))
    said = said_of(full_scale, each_once(sensitivities, "--sensitivity"))
    told = told_of(measurement, profile, said, tacho, pulses)
    recording = read_recording(measurement, sample_rate=sample_rate, units=given_units or None, profile=told)
    in_order = None
    if baseline is not None:
        told = told_of(baseline, profile, said)
        in_order = read_measurement(baseline, sample_rate=sample_rate, units=given_units or None, profile=told)
    diagnosis = diagnose(
        recording,
        opened,
        speed=speed,
        effort=effort,
        mode=mode,
        mapping=sensors or None,
        cases=cases,
        prior=Prior(
            worn, another, {joint: weight_of(joint, said) for joint, said in each_once(priors, "--prior").items()}
        ),
        baseline=in_order,
    )
    if plot is not None:
        from jointplay.app.figures.plots import plot_diagnosis

        plot_diagnosis(diagnosis, measurement.name, plot)
    if as_json:
        print_json(diagnosis.model_dump(mode="json"))
    else:
        click.echo(report(diagnosis))
        if plot is not None:
            click.echo(f"drawn: {plot}")


def weight_of(joint: str, said: str) -> float:
    """Return the weight that an option gives a joint."""
    try:
        return float(said)
    except ValueError:
        raise click.BadParameter(f'"{joint}={said}": the weight must be a number', param_hint="--prior") from None


def said_of(full_scale: str | None, sensitivities: Mapping[str, str]) -> dict[str, Any]:
    """Return the members of a profile that options stand for, and that all files have in common."""
    said: dict[str, Any] = {}
    if full_scale is not None:
        said |= {"full_scale": full_scale, "full_scale_m_s2": None}
    if sensitivities:
        said["sensitivity"] = dict(sensitivities)
    return said


def told_of(
    file: Path, profile: Path | None, said: Mapping[str, Any], tacho: str | None = None, pulses: int | None = None
) -> ImportProfile:
    """Return what is told of a file: its profile, the given one or that beside it, and what options say."""
    from jointplay.catalogue.measurements.import_profile import Tacho, load_profile, profile_beside

    told = profile_beside(file) if profile is None else load_profile(profile)
    members = dict(said)
    if tacho is not None:
        before = {} if told.tacho is None else told.tacho.model_dump()
        given = {"column": tacho} if pulses is None else {"column": tacho, "pulses_per_revolution": pulses}
        members["tacho"] = Tacho.model_validate({**before, **given})
    return told.model_copy(update=members)


def report(result: Diagnosis) -> str:
    """Return a diagnosis as plain text."""
    parts = [words.sentence(result), *words.remarks(result)]
    if joint_rows(result):
        parts += [words.joints_sentence(result), indented(joints(result))]
    parts += [
        f"drive speed {result.drive_speed_rpm:.6g} rpm; {words.fit_sentence(result)}",
        f"{words.mode_sentence(result)} {words.prior_sentence(result)}",
        indented(ranking(result)),
        words.set_sentence(result),
    ]
    if result.effort_spent.note:
        parts.append(f"simulated anew: {result.effort_spent.note}")
    if result.suggestions:
        parts += ["What would tell them apart:", indented(suggestions(result))]
    parts += [f"warning: {line}" for line in result.warnings]
    return "\n".join(parts)


def joints(result: Diagnosis) -> str:
    """Return what is said of every joint as a table, the most probably worn first."""
    rows = [
        (row.name, row.said, row.percent, row.play.said(), row.shows or "-", row.limit, row.beyond)
        for row in joint_rows(result)
    ]
    head = ("joint", "state", "worn", "radial clearance (90 % interval)", "wear shows from", "limit", "beyond")
    return table(head, rows, frozenset({2, 4, 5, 6}))


def suggestions(result: Diagnosis) -> str:
    """Return what could be done, the best first, as a table."""
    rows = [
        (
            f"{each.kind} {each.what}",
            " / ".join(each.hypotheses),
            percent(each.error_now),
            percent(each.error),
        )
        for each in result.suggestions
    ]
    return table(("add", "for", "mistaken now", "then"), rows, frozenset({2, 3}))


def ranking(result: Diagnosis, most: int | None = None) -> str:
    """Return the hypotheses, or the first of them, as a table, the most probable first."""
    rows = [(row.label, row.percent, row.clearance or "-", row.distance) for row in hypothesis_rows(result, most)]
    return table(("hypothesis", "probability", "radial clearance (90 % interval)", "distance"), rows, frozenset({1, 3}))
