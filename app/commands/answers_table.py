"""Many recordings, each with an answer of its own, in one table: a row a file, a refused one's with its reason."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.commands.progress import ProgressLine
from jointplay.app.problems import kind_of, one_line, say
from jointplay.app.rows import percent
from jointplay.app.tables import table

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
    from jointplay.catalogue.measurements.measurement import Recording

ENDINGS = (".csv", ".json")
OF_JOINT = ("p_worn", "clearance_um", "low_um", "high_um")

Answered = tuple["Recording | MeasuredSpectrum", "Diagnosis"]


def check_table(file: Path) -> None:
    """Refuse a table of a kind that is not written, or where it cannot be.

    Raises
    ------
    click.BadParameter
    """
    if file.suffix.lower() not in ENDINGS:
        raise click.BadParameter(f"{file}: must end in {' or '.join(ENDINGS)}", param_hint="'--out'")
    if not file.parent.is_dir():
        raise click.BadParameter(f"{file}: there is no folder {file.parent}", param_hint="'--out'")


def answer_each(
    files: Sequence[Path], ask: Callable[[int], Answered], out: Path, joints: Sequence[str]
) -> list[dict[str, Any]]:
    """Ask for an answer to each file and write the table; what is there is written when it is interrupted, too.

    Parameters
    ----------
    files : sequence of Path
    ask : callable
        Reads and diagnoses the file of a number.
    out : Path
        The table, checked by :func:`check_table`.
    joints : sequence of str
        Of the catalogue, which have columns in this order.

    Returns
    -------
    list of dict
        The rows, as JSON values.
    """
    rows: list[dict[str, Any]] = []
    try:
        with ProgressLine("diagnosing", "recordings") as line:
            for number, file in enumerate(files):
                line.show(number, len(files))
                rows.append(_row(file, lambda number=number: ask(number)))  # type: ignore[misc]
            line.show(len(files), len(files))
    finally:
        text = json.dumps(rows, indent=2) + "\n" if out.suffix.lower() == ".json" else as_csv(rows, joints)
        out.write_text(text, encoding="utf-8", newline="")
    return rows


def _row(file: Path, ask: Callable[[], Answered]) -> dict[str, Any]:
    """One file's row; a failure that nobody foresaw is raised."""
    row: dict[str, Any] = {"file": str(file), "sha256": None, "refusal": None}
    try:
        recording, found = ask()
    except Exception as error:
        if kind_of(error) is None and not isinstance(error, OSError | click.ClickException):
            raise
        text = error.format_message() if isinstance(error, click.ClickException) else say(error)
        with suppress(OSError):
            row["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
        return {**row, "refusal": one_line(text)}
    first, moment = found.hypotheses[0], recording.measured_at
    return {
        **row,
        "sha256": recording.sha256,
        "measured_at": None if moment is None else moment.isoformat(),
        "drive_speed_rpm": found.drive_speed_rpm,
        "verdict": found.verdict,
        "first": first.label,
        "probability": first.probability,
        "p_value": found.goodness_of_fit.p_value,
        "joints": {name: state.model_dump(mode="json") for name, state in found.joints.items()},
        "warnings": list(found.warnings),
    }


def as_csv(rows: Iterable[dict[str, Any]], joints: Sequence[str]) -> str:
    """Return rows as CSV: four columns a joint, warnings in one cell; empty cells where there is no answer."""
    text = io.StringIO()
    plain = ("file", "sha256", "measured_at", "drive_speed_rpm", "verdict", "first", "probability", "p_value")
    writer = csv.writer(text)
    writer.writerow([*plain, *(f"{joint}_{each}" for joint in joints for each in OF_JOINT), "warnings", "refusal"])
    for row in rows:
        cells = [row.get(name) for name in plain]
        for joint in joints:
            state = row.get("joints", {}).get(joint)
            none = [None] * len(OF_JOINT)
            cells += [state["p_worn"], state["clearance_um"], *state["interval_um"]] if state else none
        writer.writerow([*cells, " | ".join(row.get("warnings", [])), row["refusal"]])
    return text.getvalue()


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Return what a table says in short, for the terminal."""
    cells = []
    for row in rows:
        if row["refusal"]:
            cells.append((row["file"], "", "refused", row["refusal"]))
        else:
            # Without a verdict on joints none of them is named.
            said = f"{row['first']}, {percent(row['probability'])}" if row["verdict"] in ("worn", "in_order") else ""
            cells.append((row["file"], f"{row['drive_speed_rpm']:.6g} rpm", row["verdict"].replace("_", " "), said))
    return table(("file", "speed", "verdict", "first"), cells, frozenset({1}))
