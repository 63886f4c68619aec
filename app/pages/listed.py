"""Rows of the pages that list recordings and diagnoses, the newest first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import func, select

from jointplay.app.storage.asset_rows import AssetMeasurementRow
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Damaged, DiagnosisRow, MeasurementRow
from jointplay.app.storage.store import Store
from jointplay.app.words import short


def recording_rows(database: ServiceDatabase, rows: Sequence[MeasurementRow]) -> list[dict[str, Any]]:
    """Return what the list shows of measurements: whose they are, and how many diagnoses there are of each."""
    keys = [row.id for row in rows]
    asked = select(DiagnosisRow.measurement, func.count()).where(DiagnosisRow.measurement.in_(keys))
    sent = select(AssetMeasurementRow).where(AssetMeasurementRow.measurement.in_(keys))
    with database.reading() as session:
        counts = {row[0]: row[1] for row in session.execute(asked.group_by(DiagnosisRow.measurement))}
        owners = {each.measurement: each.asset for each in session.scalars(sent)}
    return [
        {
            "place": f"/measurements/{row.id}",
            "name": row.name,
            "moment": row.measured_at,
            "asset": owners.get(row.id, ""),
            "beside": f"/diagnoses?measurement={row.id}" if row.id in counts else "",
            "said": str(counts.get(row.id, "none")),
        }
        for row in rows
    ]


def diagnosis_rows(store: Store, rows: Sequence[DiagnosisRow], damaged: list[Damaged]) -> list[dict[str, Any]]:
    """Return what the list shows of diagnoses: the verdict, and of which recording, as long as there is that."""
    among = select(MeasurementRow.id).where(MeasurementRow.id.in_([row.measurement for row in rows]))
    names = {each.id: each.name for each in store.measurements(None, len(rows), among, damaged)}
    return [
        {
            "place": f"/diagnoses/{row.id}",
            "name": short(row.answer),
            "moment": row.created_at,
            "asset": row.request.get("asset") or "",
            "beside": f"/measurements/{row.measurement}?diagnosis={row.id}" if row.measurement in names else "",
            "said": names.get(row.measurement, "deleted or damaged") + also(row),
        }
        for row in rows
    ]


def also(row: DiagnosisRow) -> str:
    """How many recordings more have the same answer."""
    more = len(row.measurements) - 1
    return f" and {more} more" if more else ""
