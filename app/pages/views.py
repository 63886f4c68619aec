"""What the page shows of a diagnosis: sentences, a table, a drawing and charts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from urllib.parse import urlencode

from jointplay.app import words
from jointplay.app.figures.pictures import machine_picture
from jointplay.app.rows import (
    Comparison,
    comparisons,
    deciding,
    has_decided,
    hypothesis_rows,
    joint_colours,
    joint_rows,
    order,
    recording_rows,
    suggestion_rows,
)
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.catalogue.diagnosing.answer import Answer, BandEvidence
from jointplay.solver.machines.machine import parse_machine

SHOWN_HYPOTHESES = 12


def view(row: DiagnosisRow, measurement: MeasurementRow, gone: Sequence[str] = ()) -> dict[str, Any]:
    """Return the members that the result's template shows.

    Parameters
    ----------
    row : DiagnosisRow
        A stored diagnosis.
    measurement : MeasurementRow
        Its recording.
    gone : sequence of str
        Which of its recordings were deleted since.
    """
    result = row.answer
    found = comparisons(result)
    decided = deciding(result, found)
    return {
        "id": row.id,
        "verdict": result.verdict,
        "sentence": words.sentence(result),
        "short": words.short(result),
        "remarks": words.remarks(result),
        "joints": joint_rows(result),
        "machine": result.machine,
        "speed": speeds(result),
        "measurement": row.measurement,
        "deleted": list(gone),
        "recording": words.recorded(result, measurement.name),
        "recordings": recording_rows(result),
        "suggestions": suggestion_rows(result),
        "beside": "" if gone else urlencode({"beside": row.id} | same_place(row)),
        "asset": row.request.get("asset"),
        "mapped": ", ".join(
            f"{column}: {sensor or 'not used'}" for column, sensor in row.request.get("mapping", {}).items()
        ),
        "remembered": row.request.get("mapping_remembered", False),
        "created": row.created_at,
        "warnings": result.warnings,
        "ranking": hypothesis_rows(result, SHOWN_HYPOTHESES),
        "in_order": "“healthy”" if all(each.label != "as-new" for each in result.hypotheses) else "“healthy”, “as-new”",
        "set_sentence": words.set_sentence(result),
        "chart_hint": words.fit_sentence(result),
        "drawing": machine_picture(parse_machine(row.machine), joint_colours(result)),
        "colours": words.colour_sentence(result),
        "rings": words.rings_sentence(result),
        "ranked": has_decided(result),
        "rival": result.evidence.rival,
        "best": result.hypotheses[0].label,
        "decided": [decision(comparison, band) for comparison, band in decided],
        "charts": [chart(comparison, [band for other, band in decided if other is comparison]) for comparison in found],
    }


def same_place(row: DiagnosisRow) -> dict[str, str]:
    """Return the catalogue and the asset of a diagnosis, for a form that asks again."""
    return {name: row.request[name] for name in ("catalogue", "asset") if row.request.get(name)}


def speeds(result: Answer) -> str:
    """Return the drive speed of a recording, or the lowest and highest of several."""
    turned = [share.drive_speed_rpm for share in result.recordings] or [result.drive_speed_rpm]
    low, high = (f"{speed:.5g}" for speed in (min(turned), max(turned)))
    return f"{low} rpm" if low == high else f"{low} to {high} rpm"


def decision(comparison: Comparison, band: BandEvidence) -> dict[str, str]:
    """Return the row of a band that decided."""
    return {
        "channel": comparison.title.removesuffix(" of the frame"),
        "order": order(band.order),
        "measured": f"{band.measured_db:.1f}",
        "matched": f"{band.predicted_db:.1f}",
        "rival": "–" if band.rival_db is None else f"{band.rival_db:.1f}",
    }


def chart(comparison: Comparison, decided: Sequence[BandEvidence] = ()) -> dict[str, Any]:
    """Return one chart: its data for the script and its content in words for those who do not see it."""
    worst = max(comparison.bands, key=lambda band: abs(band.measured_db - band.predicted_db))
    return {
        "title": comparison.title,
        "summary": (
            f"Level by order of {comparison.title}, measured and matched; they differ most at order "
            f"{order(worst.order)}: "
            f"{worst.measured_db:.1f} dB measured, {worst.predicted_db:.1f} dB matched."
        ),
        "data": {
            "label": comparison.label,
            "orders": [band.order for band in comparison.bands],
            "upper": [band.predicted_db + 2 * band.spread_db for band in comparison.bands],
            "lower": [band.predicted_db - 2 * band.spread_db for band in comparison.bands],
            "lines": [
                {"name": "matched", "look": "matched", "levels": [band.predicted_db for band in comparison.bands]},
                {"name": "second", "look": "rival", "levels": [band.rival_db for band in comparison.bands]},
                {"name": "measured", "look": "measured", "levels": [band.measured_db for band in comparison.bands]},
                {
                    "name": "decided",
                    "look": "decided",
                    "levels": [band.measured_db if band in decided else None for band in comparison.bands],
                },
            ],
        },
    }
