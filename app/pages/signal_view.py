"""What the page of a recording shows besides its charts: where it belongs, and with what it can be compared."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select

from jointplay.app.service import Service
from jointplay.app.storage.asset_rows import AssetDiagnosisRow, AssetMeasurementRow
from jointplay.app.storage.assets import Assets, measurements_of
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.words import short, spell_moment

OFFERED = 100
DIAGNOSES = 20


def signal_view(service: Service, key: str) -> dict[str, Any]:
    """Return what the page of a recording shows.

    Raises
    ------
    UnknownMeasurementError
        When there is none of this id.
    """
    store = service.store
    row = store.measurement(key)
    of_it = select(DiagnosisRow.id).where(DiagnosisRow.measurement == key)
    diagnoses = store.diagnoses(None, DIAGNOSES, among=of_it, damaged=[])
    with store.database.reading() as session:
        sent = session.scalars(select(AssetMeasurementRow.asset).where(AssetMeasurementRow.measurement == key))
        found = session.scalars(select(AssetDiagnosisRow.asset).where(AssetDiagnosisRow.diagnosis.in_(of_it)))
        assets = sorted({*sent, *found})
    others: dict[str, str] = {}
    for name in assets:
        asset = Assets(store.database).asset(name)
        own = store.measurements(None, OFFERED, measurements_of(name), [])
        baselines = [store.measurement(each) for each in asset.in_order]
        for other in [*baselines, *sorted(own, key=lambda each: each.measured_at, reverse=True)]:
            role = "baseline, " if other.id in asset.in_order else ""
            if other.id != key and other.summary.get("kind") != "spectrum":
                others.setdefault(other.id, f"{role}{other.name}, {spell_moment(other.measured_at)} UTC")
    return {
        "id": row.id,
        "name": row.name,
        "is_recording": row.summary.get("kind") != "spectrum",
        "facts": facts_of(row),
        "moment": f"{row.measured_at:%Y-%m-%dT%H:%M:%SZ}",
        "channels": [channel["name"] for channel in row.summary["channels"]],
        "warnings": row.summary["warnings"],
        "assets": assets,
        "diagnoses": [(each.id, short(each.answer), each.created_at) for each in diagnoses],
        "speed": f"{diagnoses[0].answer.drive_speed_rpm:.6g} rpm" if diagnoses else "",
        "others": list(others.items()),
    }


def facts_of(row: MeasurementRow) -> list[tuple[str, str]]:
    """Return what is known of a measurement, in words."""
    received = " (received)" if row.measured_at_source == "received" else ""
    found = [("Measured", f"{spell_moment(row.measured_at)} UTC{received}")]
    if row.summary.get("sample_rate_hz"):
        found.append(("Length", f"{row.summary['duration_s']:.4g} s at {row.summary['sample_rate_hz']:g} Hz"))
    channels = ", ".join(f"{channel['name']} [{channel['unit']}]" for channel in row.summary["channels"])
    return [*found, ("Channels", channels)]
