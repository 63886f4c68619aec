"""What a report says: plain lines and tables, the same in HTML and PDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from jointplay.app import words
from jointplay.app.jobs.summaries import extent, kind_of, summarise_told
from jointplay.app.reports.evidence import evidence_of
from jointplay.app.rows import JointRow, between, hypothesis_rows, joint_rows, percent, play_of, recording_rows
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.words import SOURCES, spell_moment
from jointplay.catalogue.diagnosing.answer import Answer, JointState
from jointplay.solver.machines.machine import parse_machine

SHOWN_HYPOTHESES = 5
SHOWN_SUGGESTIONS = 3
SHOWN_WARNINGS = 4
SHOWN_SENSORS = 6
SHOWN_WIDTH = 64  # characters of a name from outside: one page has to do

NO_ZONE = (
    "Severity is not judged here: a matched clearance says how much play there is, not how severe the vibration is."
    " No zone of ISO 20816 (or ISO 10816) is derived from a match; zones need the broad-band velocity of the machine,"
    " measured as they ask."
)
LIMITS = (
    "Links are taken to be rigid and to move in a plane. Wear was compared with the hypotheses of this catalogue alone,"
    " and probabilities count among these. Other causes are named from the few that are known (mounts, masses, an"
    " unbalance, loads, a ripple of the drive); any other (a bearing, a crack) is a change without a name, or no"
    " verdict. Intervals hold the clearance in 90 % of cases."
)
JOINT_COLUMNS = (
    "Joint",
    "State",
    "Worn",
    "Radial clearance (90 % interval)",
    "Wear shows from",
    "Beyond its limit",
)


FORM_COLUMNS = ("Joint", "Expected", "Play found across the pin, µm", "Repaired, replaced")
FORM_ROWS = 3


@dataclass(frozen=True)
class Named:
    """One line of a table of facts."""

    name: str
    value: str


@dataclass(frozen=True)
class Report:
    """Everything a report says.

    Parameters
    ----------
    title : str
    verdict : str
        worn, in_order, changed or unknown.
    sentence : str
        The verdict in one sentence.
    remarks : tuple of str
        What belongs to it: limits, other causes, sensors.
    colours : str
        What those of joints in the drawing mean.
    facts : tuple of Named
        Asset, machine and measurement.
    likelihood, severity : tuple of str
        How sure, and how large: never mixed.
    joints : tuple of tuple of str
        By `JOINT_COLUMNS`; none for answers that say nothing of single joints.
    hypotheses : tuple of tuple of str
        Label, probability, clearance with interval, distance.
    suggestions : tuple of str
        What would tell the first two apart.
    inspection : tuple of str
        What to look at.
    form : tuple of tuple of str
        Joints, and the diametral play that is expected, of the box in which a finding is noted by hand.
    past : tuple of str
        What the answers to all recordings of the asset up to this one say; empty where there are no others.
    at : datetime
        When the diagnosis was made.
    method : tuple of Named
        Versions and hashes.
    warnings, limits : tuple of str
    evidence : str
        The line by which the report can be checked.
    """

    title: str
    verdict: str
    sentence: str
    remarks: tuple[str, ...]
    colours: str
    facts: tuple[Named, ...]
    likelihood: tuple[str, ...]
    severity: tuple[str, ...]
    joints: tuple[tuple[str, ...], ...]
    hypotheses: tuple[tuple[str, str, str, str], ...]
    suggestions: tuple[str, ...]
    inspection: tuple[str, ...]
    form: tuple[tuple[str, str], ...]
    past: tuple[str, ...]
    at: datetime
    method: tuple[Named, ...]
    warnings: tuple[str, ...]
    limits: tuple[str, ...]
    evidence: str


def report_of(
    row: DiagnosisRow,
    measurement: MeasurementRow,
    asset: str | None = None,
    notes: str = "",
    gone: Sequence[str] = (),
    past: tuple[str, ...] = (),
) -> Report:
    """Return what the report of a diagnosis says.

    Parameters
    ----------
    row : DiagnosisRow
    measurement : MeasurementRow
        Its recording.
    asset : str, optional
        External id of the machine that was measured, where the diagnosis names it.
    notes : str
        Of that asset: where it stands.
    gone : sequence of str
        Which of its recordings were deleted since.
    past : tuple of str
        What the answers to all recordings of the asset up to this one say.
    """
    result = row.answer
    return Report(
        title=f"Joint play of {cut(asset or result.machine)}",
        verdict=result.verdict,
        sentence=words.sentence(result),
        remarks=tuple(cut(line, 240) for line in words.remarks(result)),
        colours=words.colour_sentence(result),
        facts=facts(row, measurement, asset, notes, gone),
        likelihood=(
            words.set_sentence(result),
            f"{words.capital(words.fit_sentence(result))}. {words.mode_sentence(result)}",
            words.prior_sentence(result),
        ),
        severity=(*sizes(result), NO_ZONE),
        joints=tuple(joint_row(row) for row in joint_rows(result)),
        hypotheses=tuple(
            (each.label, each.percent, each.clearance or "–", each.distance)
            for each in hypothesis_rows(result, SHOWN_HYPOTHESES)
        ),
        suggestions=suggestions(result),
        inspection=inspection(result),
        form=form(result),
        past=past,
        at=row.created_at,
        method=method(row),
        warnings=tuple(warnings(result.warnings)),
        limits=(LIMITS,),
        evidence=evidence_of(row).line,
    )


def facts(
    row: DiagnosisRow, measurement: MeasurementRow, asset: str | None, notes: str = "", gone: Sequence[str] = ()
) -> tuple[Named, ...]:
    """Return who was measured, where, how and when."""
    summary = measurement.summary
    channels = ", ".join(channel["name"] for channel in summary["channels"])
    return (
        *((Named("Asset", cut(asset)),) if asset else ()),
        Named("Machine", cut(row.answer.machine)),
        *((Named("Notes", cut(" ".join(notes.split()), 160)),) if notes.strip() else ()),
        Named(kind_of(summary).capitalize(), cut(measurement.name)),
        *((Named("Deleted", f"{', '.join(gone)}: the bytes are not there any more"),) if gone else ()),
        Named("Measured", measured(measurement)),
        Named("Extent" if kind_of(summary) == "spectrum" else "Length", extent(summary)),
        *((Named("Said of it", cut(summarise_told(measurement.told.shown))),) if measurement.told.shown else ()),
        Named("Channels", cut(channels)),
        *sensors(row),
        Named("Drive speed", f"{row.answer.drive_speed_rpm:.5g} rpm"),
        *(
            Named(f"Recording {number}", f"{cut(each.name)}, {each.speed}; alone {each.alone}; {each.said}")
            for number, each in enumerate(recording_rows(row.answer), 1)
        ),
        Named("Diagnosed", f"{spell_moment(row.created_at)} UTC"),
    )


def measured(measurement: MeasurementRow) -> str:
    """Return when a measurement was made, as far as somebody says so, and when it came."""
    source, came = measurement.measured_at_source, f"received {spell_moment(measurement.created_at)} UTC"
    if source == "received":
        return f"nobody says when; {came}"
    return f"{spell_moment(measurement.measured_at)} UTC, {SOURCES[source]}; {came}"


def sensors(row: DiagnosisRow) -> tuple[Named, ...]:
    """Return where the sensors of the machine stand, and along what they measure."""
    found = parse_machine(row.machine).sensors
    said = [
        f"{each.name} ({each.at[0]:.4g}, {each.at[1]:.4g}) m along ({each.direction[0]:.3g}, {each.direction[1]:.3g})"
        for each in found[:SHOWN_SENSORS]
    ]
    more = [f"{len(found) - SHOWN_SENSORS} more in the machine's file"] if len(found) > SHOWN_SENSORS else []
    return (Named("Sensors at", "; ".join([*said, *more])),) if said else ()


def form(result: Answer) -> tuple[tuple[str, str], ...]:
    """Return the rows of the box in which a finding is noted by hand: what is to be measured first, and empty ones."""
    rows = [(joint, double(each)) for joint, each in words.named_joints(result).items()]
    return (*rows, *((("", ""),) * max(FORM_ROWS - len(rows), 1)))


def joint_row(row: JointRow) -> tuple[str, ...]:
    """Return one row of the table of joints."""
    beyond = f"{row.beyond} ({row.limit})"
    return row.name, row.said, row.percent, row.play.say(), row.shows or "–", beyond


def sizes(result: Answer) -> tuple[str, ...]:
    """Return how large the play of worn joints is, if there are any, whatever its probability."""
    worn = words.named_joints(result)
    if not worn:
        return ("No size of play is given, because no joint is named as worn.",)
    found = "; ".join(f"{joint}: {play_of(each).say('90 %: ')}" for joint, each in worn.items())
    return (f"Radial clearance if worn: {found}.",)


def suggestions(result: Answer) -> tuple[str, ...]:
    """Return what would tell the first two hypotheses apart, or that nothing is suggested."""
    first = {entry.label for entry in result.hypotheses[:2]}
    wanted = [each for each in result.suggestions if first <= set(each.hypotheses)] or result.suggestions
    lines = tuple(
        f"{words.capital(each.kind)} {each.what}: of {' and '.join(each.hypotheses)} the wrong one is first"
        f" in {percent(each.error)} of cases then, {percent(each.error_now)} now."
        for each in wanted[:SHOWN_SUGGESTIONS]
    )
    if lines:
        return lines
    if len(result.hypotheses) < 2:
        return ("There is no second hypothesis.",)
    second = result.hypotheses[1]
    return (
        f"The diagnosis suggests no further measurement; the second hypothesis, {second.label}, has a"
        f" probability of {percent(second.probability)}.",
    )


def inspection(result: Answer) -> tuple[str, ...]:
    """Return what to look at, by verdict."""
    back = "Report what was found to this diagnosis (its finding), so that later answers can be judged by it."
    if result.verdict == "in_order":
        return ("No inspection follows from this recording. Repeat the measurement at the usual interval.",)
    if result.verdict == "changed":
        named = [words.cause(each) for each in result.causes]
        looked = (
            f"Look at what may have changed: {'; or '.join(named)}."
            if named
            else (
                "Look for what has changed since the machine file was written: mounts, foundation, masses, load, drive."
            )
        )
        if words.may_be_worn(result):
            return (
                looked,
                "It may be wear: measure again, longer or with more sensors, before a joint is opened.",
                back,
            )
        return (looked, "No joint is to be opened for this. Measure again when it is put right, or the file is.", back)
    worn = words.named_joints(result)
    if not worn:
        return (
            "No joint can be named. Check sensors, their mounting and directions, the drive speed, mounts and"
            " foundation, then measure again; inspect for causes that the catalogue does not hold.",
            back,
        )
    lines = [
        f"Joint {joint}: with the drive locked out, measure the play across the pin; expected are {double(each)} of"
        " diametral play (twice the radial clearance)."
        for joint, each in worn.items()
    ]
    sound = {entry.label for entry in result.hypotheses if set(entry.joints) <= set(worn)}
    others = [label for label in result.candidate_set if label not in sound]
    if others:
        lines.append(f"If that is not found, look at {words.enumerate_words(others)} next.")
    return (*lines, back)


def double(found: JointState) -> str:
    """Return the interval of the diametral play."""
    low, high = (2.0 * end for end in found.interval_um)
    if found.bound == "none":
        return between(low, high)
    return play_of(found.model_copy(update={"interval_um": (low, high)})).value


def method(row: DiagnosisRow) -> tuple[Named, ...]:
    """Return everything that determined the answer."""
    result = row.answer
    origin, matcher, baseline = result.provenance, result.provenance.matcher, result.baseline
    shown = "none"
    if baseline is not None:
        shown = f"{cut(baseline.measurement)}, {'used' if baseline.used else 'numbers not used'}"
        shown += "; wear told beside it" if baseline.heard else ""
    versions = f"solver {origin.solver_version} (catalogue: {origin.catalogue_solver_version}),"
    return (
        Named("Diagnosis", f"{row.id}, answer {result.hash}, as stored {row.checksum}"),
        Named("Recording", f"SHA-256 {origin.measurement_sha256}"),
        Named("Catalogue", f"SHA-256 {origin.catalogue_sha256}"),
        Named("Machine", f"SHA-256 {origin.machine_sha256}"),
        Named("Network", f"SHA-256 {matcher.network}" if matcher.network else "none"),
        Named("Versions", f"{versions} matcher {matcher.name} {matcher.version}"),
        Named("Settings", f"effort {result.effort}, mode {result.mode.used}, baseline {shown}"),
        Named("Steps", ", ".join(f"{step.name} {step.version}" for step in origin.recipe)),
    )


def warnings(lines: Sequence[str]) -> list[str]:
    """Return the warnings that fit on the page, and how many do not."""
    shown = [cut(line, 160) for line in lines[:SHOWN_WARNINGS]]
    more = len(lines) - len(shown)
    return [*shown, f"{more} more in the answer itself"] if more else shown


def cut(text: str, width: int = SHOWN_WIDTH) -> str:
    """Return a text from outside at a bounded length."""
    return text if len(text) <= width else f"{text[: width - 1]}…"
