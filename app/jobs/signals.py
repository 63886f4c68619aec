"""The worker's task behind the charts of a recording: what is seen of it, as bytes to be sent."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
from cachetools import LRUCache, cached

from jointplay.app.errors import BadFieldError
from jointplay.app.jobs.samples import StoredRecording, measured_of, samples_of
from jointplay.app.jobs.tasks import open_catalogue

if TYPE_CHECKING:
    from jointplay.app.schemas.signals import SignalOut
    from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
    from jointplay.catalogue.measurements.measurement import Recording
    from jointplay.catalogue.signals.shown_motion import ShownSignal
    from jointplay.catalogue.signals.signal_question import LineKind, SignalQuestion

#: In place of a media type: every value of every line by itself, as JSON.
ROWS, MOST_ROWS = "rows", 100_000
#: Part of a recording that a speed is looked for in.
SEARCHED_S = 20.0

KINDS: dict[LineKind, str] = {
    "value": "",
    "low": " lowest",
    "high": " highest",
    "mean": " mean",
    "rms": " rms",
    "first": ", first hypothesis",
    "second": ", second hypothesis",
    "in_order": ", in order",
}


def look(
    stored: StoredRecording,
    question: SignalQuestion,
    kind: str,
    machine: Mapping[str, Any] | None,
    mapping: Mapping[str, str],
    near: float | None = None,
    clearances: Mapping[str, float] | None = None,
    catalogue: tuple[str, str] | None = None,
    hypotheses: Sequence[tuple[str, Mapping[str, float]]] = (),
) -> bytes:
    """Return what is seen of a recording.

    Parameters
    ----------
    stored : StoredRecording
    question : SignalQuestion
    kind : str
        ``text/csv``, ``application/json`` or `ROWS`.
    machine : mapping, optional
        The machine's canonical document.
    mapping : mapping of column to sensor
    near : float, optional
        Where no speed is asked for: what it is near to [rad/s].
    clearances : mapping of joint to float, optional
        Of the machine as it was matched, m.
    catalogue : (str, str), optional
        Folder and stamp of the catalogue that it was matched with.
    hypotheses : sequence of (str, Mapping)
        The first two, by their labels, with clearances by joint, m.
    """
    from jointplay.catalogue.measurements.measurement import Recording
    from jointplay.catalogue.signals.shown_views import show_signal, show_spectrum
    from jointplay.solver.machines.machine import parse_machine

    recording = measured_of(stored) if question.view == "spectrum" else samples_of(stored)
    if not isinstance(recording, Recording):
        return written(kind, stored, recording, question, show_spectrum(recording, question))
    if question.speed is None and near is not None:
        question = replace(question, speed=speed_of(stored, near))
    parsed = None if machine is None else parse_machine(dict(machine))
    if question.view == "contact":
        if parsed is None:
            raise BadFieldError(
                "diagnosis: forces in joints are those of a matched machine: name one", field="diagnosis"
            )
        from jointplay.catalogue.signals.shown_contact import show_contact

        shown = show_contact(recording, question, parsed, mapping or None, clearances or {})
    elif question.view == "matched":
        if parsed is None or catalogue is None:
            raise BadFieldError("diagnosis: machines are laid over by a diagnosis: name one", field="diagnosis")
        from jointplay.catalogue.signals.shown_matched import IN_ORDER, ShownHypothesis, show_matched

        kinds: tuple[LineKind, LineKind] = ("first", "second")
        told = [ShownHypothesis(kind, *each) for kind, each in zip(kinds, hypotheses, strict=False)]
        if IN_ORDER not in [each.label for each in told]:
            told.append(ShownHypothesis("in_order", IN_ORDER, {}))
        shown = show_matched(recording, question, parsed, mapping or None, open_catalogue(*catalogue), told)
    else:
        shown = show_signal(recording, question, parsed, mapping or None)
    return written(kind, stored, recording, question, shown)


def written(
    kind: str,
    stored: StoredRecording,
    recording: Recording | MeasuredSpectrum,
    question: SignalQuestion,
    shown: ShownSignal,
) -> bytes:
    """Return what is seen in the form that is asked for."""
    if kind == "text/csv":
        return as_csv(shown)
    if kind == ROWS:
        return as_rows(shown, question)
    return signal_out(stored.id, recording, question, shown).model_dump_json().encode()


@cached(LRUCache(256), key=lambda stored, near: (stored.id, near))
def speed_of(stored: StoredRecording, near: float) -> float:
    """Return the drive speed of a recording [rad/s], which is near to another.

    Raises
    ------
    MeasurementError
        When none is found there.
    """
    from jointplay.catalogue.measurements.drivespeed import estimate_speed

    recording = samples_of(stored)
    signal = np.asarray(recording.signal[: round(SEARCHED_S * recording.sample_rate)], np.float64)
    return estimate_speed(signal, recording.sample_rate, near, source=recording.name).speed


def signal_out(
    key: str, recording: Recording | MeasuredSpectrum, question: SignalQuestion, shown: ShownSignal
) -> SignalOut:
    """Return the outside shape of what is seen."""
    from jointplay.app.schemas.signals import SignalLine, SignalMap, SignalOut, SignalOverall

    spectrogram = None
    lines = shown.lines
    if shown.rows is not None and shown.levels is not None:
        levels = np.round(shown.levels, 1).tolist()
        spectrogram = SignalMap(rows=plain(shown.rows), unit=f"{lines[0].unit} rms", levels_db=levels)
    return SignalOut(
        measurement=key,
        view=question.view,
        unit=question.unit,
        of=question.of,
        sample_rate_hz=getattr(recording, "sample_rate", None),
        duration_s=getattr(recording, "duration", None),
        drive_speed_rpm=None if question.speed is None else abs(question.speed) * 30 / pi,
        high_pass_hz=shown.high_pass,
        axis=shown.axis,
        axis_unit=shown.axis_unit,
        ends=shown.ends,
        at=plain(shown.at, 9),
        lines=[SignalLine(name=line.name, kind=line.kind, unit=line.unit, values=plain(line.values)) for line in lines],
        map=spectrogram,
        overall=[SignalOverall(**asdict(row)) for row in shown.overall],
        band_hz=shown.band,
        resolution=shown.resolution,
        notes=list(shown.notes),
    )


def plain(numbers: np.typing.NDArray[np.floating[Any]], digits: int = 6) -> list[float]:
    """Return numbers with as many digits as a chart needs."""
    return [float(f"{number:.{digits}g}") for number in numbers.tolist()]


def as_rows(shown: ShownSignal, question: SignalQuestion) -> bytes:
    """Return what is seen as a list of values, each with its place and what it is.

    Raises
    ------
    BadFieldError
        Of what has no lines, or more values than anybody can look at.
    """
    if shown.overall or shown.rows is not None:
        rule = "is not made of lines; its rows stand in the answer of /signal"
        raise BadFieldError(f"view: {question.view}: {rule}", field="view")
    at = plain(shown.at, 9)
    if len(at) * len(shown.lines) > MOST_ROWS:
        rule = f"of {len(shown.lines)} lines are more than {MOST_ROWS} rows; ask for fewer, or for one channel"
        raise BadFieldError(f"points: {len(at)} {rule}", field="points")
    rows = [
        {"at": place, "name": line.name, "kind": line.kind, "unit": line.unit, "value": value}
        for line in shown.lines
        for place, value in zip(at, plain(line.values), strict=True)
    ]
    return json.dumps(rows, ensure_ascii=False, separators=(",", ":")).encode()


def as_csv(shown: ShownSignal) -> bytes:
    """Return what is seen as a table: a row a place, or a row a channel of the overall levels."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    label = f"{shown.axis} [{shown.axis_unit}]" if shown.axis_unit else shown.axis
    if shown.overall:
        writer.writerow(["channel", "unit", "rms", "peak", "velocity rms [mm/s; mrad/s]"])
        writer.writerows([row.name, row.unit, row.rms, row.peak, row.velocity_rms] for row in shown.overall)
    elif shown.rows is not None and shown.levels is not None:
        writer.writerow([label, *(f"{row:.6g} [dB]" for row in shown.rows.tolist())])
        for at, levels in zip(plain(shown.at, 9), np.round(shown.levels.T, 1).tolist(), strict=True):
            writer.writerow([at, *levels])
    else:
        writer.writerow([label, *(f"{line.name}{KINDS[line.kind]} [{line.unit}]" for line in shown.lines)])
        writer.writerows(zip(plain(shown.at, 9), *(plain(line.values) for line in shown.lines), strict=True))
    return text.getvalue().encode()
