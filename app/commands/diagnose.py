"""``jointplay diagnose``: which joints are worn, and how much."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app import words
from jointplay.app.commands.answers_table import Answered, answer_each, check_table, summary
from jointplay.app.commands.parameters import (
    Pairs,
    baseline_option,
    each_once,
    existing_catalogue,
    file_options,
    json_option,
    print_json,
    refuse_given,
    speeds_option,
)
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.errors import BadFieldError, RefusedFilesError
from jointplay.app.fields import FILE_FIELDS, PROFILE
from jointplay.app.rows import hypothesis_rows, joint_rows, recording_rows, suggestion_rows
from jointplay.app.storage.told import with_said
from jointplay.app.tables import indent, table
from jointplay.app.words import spell_moment
from jointplay.catalogue.matching.prior import LARGEST, Prior

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.matching.modes import Effort, ModeAsked
    from jointplay.catalogue.measurements.import_profile import ImportProfile
    from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
    from jointplay.catalogue.measurements.measurement import Recording


@click.command("diagnose")
@click.argument("measurements", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="MEASUREMENT...")
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@speeds_option
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
    default=2304,
    show_default=True,
    help="Cases that effort thorough may simulate; beside a baseline 576 for each set of joints at least, and 768.",
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
@baseline_option
@file_options
@click.option(
    "--map", "mapping", type=Pairs("COLUMN=SENSOR"), multiple=True, help="Column of a sensor; may be repeated."
)
@click.option(
    "--profile",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=PROFILE,
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE.png|.svg|.pdf", help="Draw measured and matched."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="TABLE.csv|.json",
    help="Answer each measurement by itself: a row each in this table, with the reason of those that are refused.",
)
@json_option
def command(
    measurements: Sequence[Path],
    catalogue: Path,
    speeds: Sequence[float],
    effort: Effort,
    mode: ModeAsked,
    cases: int,
    priors: Sequence[tuple[str, str]],
    worn: float,
    another: float,
    baselines: Sequence[Path],
    mapping: Sequence[tuple[str, str]],
    profile: Path | None,
    plot: Path | None,
    out: Path | None,
    as_json: bool,
    **told: Any,
) -> None:
    """Rank the fault hypotheses of a catalogue for MEASUREMENT, accelerations of the machine's frame ("-": the input).

    Several measurements of one machine in one state, at several speeds, loads or sensors, have one answer; with --out
    each has its own.
    """
    if out is not None:
        refuse_given(("plot",), "is of one answer, and --out has one for each measurement")
        check_table(out)
        if out.resolve() in {each.resolve() for each in (*measurements, *baselines)}:
            raise click.BadParameter(f"{out}: is one of the recordings", param_hint="'--out'")
    if plot is not None:
        from jointplay.app.figures.plots import check_ending

        check_ending(plot)
    if effort != "thorough":
        refuse_given(("cases",), "means something with --effort thorough only")
    from jointplay.catalogue.diagnosing.together import diagnose_together
    from jointplay.catalogue.storage.store import Catalogue

    check_counts(measurements, told, speeds)
    read = [] if out is not None else measurements  # each when its turn comes
    recordings, said = read_measurements(read, {**told, "measured_at": ()} if out else told, profile)
    sensors, opened = each_once(mapping, "--map"), Catalogue.open(existing_catalogue(catalogue))
    ask = partial(
        diagnose_together,
        catalogue=opened,
        effort=effort,
        mode=mode,
        mapping=sensors or None,
        cases=cases,
        prior=Prior(
            worn, another, {joint: weight_of(joint, weight) for joint, weight in each_once(priors, "--prior").items()}
        ),
        baseline=read_baselines(baselines, said, profile),
    )
    if out is not None:

        def ask_one(number: int) -> Answered:
            one = slice(number, number + 1)
            (recording,), _ = read_measurements(
                measurements[one], {**told, "measured_at": told["measured_at"][one]}, profile
            )
            return recording, ask([recording], speeds=speeds[one] or None)

        rows = answer_each(measurements, ask_one, out, opened.matrix.joints)
        if as_json:
            print_json(rows)
        else:
            click.echo(f"{summary(rows)}\nwritten: {out}")
        refused = sum(row["refusal"] is not None for row in rows)
        if refused:
            raise RefusedFilesError(f"{refused} of {len(rows)} measurements were refused; {out} says why")
        return
    with ProgressLine("diagnosing", "cases simulated") as line:
        diagnosis = ask(recordings, speeds=speeds or None, progress=line.show)
    if plot is not None:
        from jointplay.app.figures.plots import plot_diagnosis

        plot_diagnosis(diagnosis, diagnosis.provenance.measurement, plot)
    when = [each.measured_at for each in recordings]
    if as_json:
        moments = [None if moment is None else moment.isoformat() for moment in when]
        print_json({**diagnosis.model_dump(mode="json"), "measured_at": moments})
    else:
        click.echo(report(diagnosis))
        for each, moment in zip(recordings, when, strict=True):
            if moment is not None:
                click.echo(f"measured: {each.name}, {spell_moment(moment)} UTC")
        if plot is not None:
            click.echo(f"drawn: {plot}")


def check_counts(measurements: Sequence[Path], told: Mapping[str, Any], speeds: Sequence[float] = ()) -> None:
    """Refuse what is said of each measurement in turn where it is not said of each."""
    for option, given in (("--speed", speeds), ("--measured-at", told["measured_at"])):
        if len(given) not in (0, len(measurements)):
            rule = f"{len(given)} for {len(measurements)} measurements: must be one for each, or none"
            raise click.BadParameter(rule, param_hint=f"'{option}'")


def read_measurements(
    measurements: Sequence[Path], told: Mapping[str, Any], profile: Path | None
) -> tuple[list[Recording | MeasuredSpectrum], dict[str, Any]]:
    """Read files as the options of `file_options` say; return what these say of all of them, too."""
    from jointplay.catalogue.measurements.measured_spectrum import read_recording

    check_counts(measurements, told)
    said = read_file_options(told)
    moments = said.pop("measured_at", ())
    told_each = [{**said, "measured_at": each} for each in moments] or [said] * len(measurements)
    told_too = {"sample_rate": said.get("sample_rate"), "units": said.get("units")}
    recordings = []
    for measurement, own in zip(measurements, told_each, strict=True):
        read_by = with_options(profile_of(measurement, profile), own)
        source, name = source_of(measurement)
        recordings.append(read_recording(source, name=name, **told_too, profile=read_by))
    return recordings, said


def source_of(file: Path) -> tuple[Path | bytes, str | None]:
    """Return a file; of the standard input, "-", what it holds, and a name that says what kind it is."""
    if str(file) not in ("-", "/dev/stdin"):
        return file, None
    from jointplay.catalogue.measurements.readers import Limits, ending_for

    data = sys.stdin.buffer.read(Limits().file_bytes + 1)
    return data, f"stdin{ending_for(data)}"


def read_baselines(files: Sequence[Path], said: Mapping[str, Any], profile: Path | None) -> list[Recording]:
    """Read recordings of the machine in order, by what options say of all files (see :func:`read_measurements`)."""
    from jointplay.catalogue.measurements.measurement import read_measurement

    told = {"sample_rate": said.get("sample_rate"), "units": said.get("units")}
    shared = {name: value for name, value in said.items() if name in ("full_scale", "sensitivity")}
    return [read_measurement(file, **told, profile=with_options(profile_of(file, profile), shared)) for file in files]


def weight_of(joint: str, said: str) -> float:
    """Return the weight that an option gives a joint."""
    try:
        return float(said)
    except ValueError:
        raise click.BadParameter(f'"{joint}={said}": the weight must be a number', param_hint="--prior") from None


def with_options(profile: ImportProfile, said: Mapping[str, Any]) -> ImportProfile:
    """Return a profile with what options say, which win over it; a refusal names the option."""
    try:
        return with_said(profile, said)
    except BadFieldError as error:
        option = next((each.option for each in FILE_FIELDS if each.name == error.field), error.field)
        rule = str(error).removeprefix(f"{error.field}: ")
        raise click.BadParameter(rule, param_hint=f"'--{option}'") from None


def read_file_options(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the options of `file_options` say, as far as they were given."""
    return {
        each.name: each_once(told[each.name], f"--{each.option}") if each.by_column else told[each.name]
        for each in FILE_FIELDS
        if told[each.name] not in (None, ())
    }


def profile_of(file: Path, given: Path | None) -> ImportProfile:
    """Return how to read a file: by the profile that is given, or by the one beside it."""
    from jointplay.catalogue.measurements.import_profile import load_profile, profile_beside

    return profile_beside(file) if given is None else load_profile(given)


def report(result: Diagnosis) -> str:
    """Return a diagnosis as plain text."""
    parts = [words.sentence(result), *words.remarks(result)]
    if joint_rows(result):
        parts.append(indent(joints(result)))
    if result.recordings:
        parts += ["What each recording says, and all others without it:", indent(recordings(result))]
    turning = "" if result.recordings else f"drive speed {result.drive_speed_rpm:.6g} rpm; "
    parts += [
        f"{turning}{words.fit_sentence(result)}",
        f"{words.mode_sentence(result)} {words.prior_sentence(result)}",
        indent(ranking(result)),
        words.set_sentence(result),
    ]
    if result.effort_spent.note:
        parts.append(f"simulated anew: {result.effort_spent.note}")
    if result.suggestions:
        parts += ["What would tell them apart, diagnosed together with this:", indent(suggestions(result))]
    parts += [f"warning: {line}" for line in result.warnings]
    return "\n".join(parts)


def joints(result: Diagnosis) -> str:
    """Return what is said of every joint as a table, the most probably worn first."""
    rows = [
        (row.name, row.said, row.percent, row.play.say(), row.shows or "-", row.limit, row.beyond)
        for row in joint_rows(result)
    ]
    head = ("joint", "state", "worn", "radial clearance (90 % interval)", "wear shows from", "limit", "beyond")
    return table(head, rows, frozenset({2, 4, 5, 6}))


def recordings(result: Diagnosis) -> str:
    """Return what each recording has contributed as a table."""
    rows = [(row.name, row.speed, row.alone, row.counts, row.others, row.said) for row in recording_rows(result)]
    return table(("recording", "speed", "alone", "counts", "all others", "with them"), rows, frozenset({1, 3}))


def suggestions(result: Diagnosis) -> str:
    """Return what could be done, the best first, as a table."""
    return table(("add", "for", "wrong now", "then"), suggestion_rows(result), frozenset({2, 3}))


def ranking(result: Diagnosis, most: int | None = None) -> str:
    """Return the hypotheses, or the first of them, as a table, the most probable first."""
    rows = [(row.label, row.percent, row.clearance or "-", row.distance) for row in hypothesis_rows(result, most)]
    return table(("hypothesis", "probability", "radial clearance (90 % interval)", "distance"), rows, frozenset({1, 3}))
