"""What is stored for tests of how long it is kept."""

from __future__ import annotations

import io
from collections.abc import Callable
from datetime import timedelta
from typing import Any

from answers import diagnosis
from sqlalchemy import event
from sqlalchemy.orm import Session

from jointplay.app.schemas.assets import FindingIn
from jointplay.app.storage.assets import AsRead, Assets
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.pruning import Pruner
from jointplay.app.storage.retention import kept_of
from jointplay.app.storage.rows import MeasurementRow, now
from jointplay.app.storage.store import NewDiagnosis, Store

SUMMARY = {"kind": "recording", "channels": [{"name": "s1-x", "unit": "g"}], "warnings": [], "import_report": []}
MACHINE = {"name": "press", "joints": {"A": {"kind": "turning"}}}
CONTENT = b"t,s1-x\n0,1\n"


def stored(store: Store, content: bytes = CONTENT, name: str = "a.csv") -> MeasurementRow:
    upload = store.uploads.receive(io.BytesIO(content))
    try:
        return store.add_measurement(upload, name, None, SUMMARY)
    finally:
        store.uploads.settle(upload)


def diagnosed(
    store: Store,
    *measurements: MeasurementRow,
    asset: str | None = None,
    catalogue: str = "c",
    verdict: str = "unknown",
    **members: Any,
) -> str:
    ids = [each.id for each in measurements]
    request = {"asset": asset, "measurements": ids if len(ids) > 1 else None}

    def also(session: Session, key: str, new: bool) -> None:
        if asset is not None:
            Assets(store.database).note(session, asset, dict.fromkeys(ids, AsRead({})), key, again=not new)

    result = diagnosis(**members, verdict=verdict, hash=f"{verdict:0<64}")  # another answer has another one
    return store.add_diagnosis(NewDiagnosis(ids[0], catalogue, MACHINE, request, result, also)).id


def found(store: Store, diagnosis: str) -> str:
    said = FindingIn.model_validate({"joints": {"A": {"clearance_um": 140}}, "at": "2026-11-21T10:30:00Z"})
    return Findings(store.database).add(store.diagnosis(diagnosis), said).id


def class_of(store: Store, row: MeasurementRow) -> str:
    with store.database.reading() as session:
        return kept_of(session, row.id).of


def aged(store: Store, *rows: MeasurementRow, days: float = 100.0) -> None:
    with store.database.writing() as session:
        for row in rows:
            session.get_one(MeasurementRow, row.number).created_at = now() - timedelta(days=days)


def pruner(store: Store, **keep_days: float) -> Pruner:
    return Pruner(store, store.directory / "catalogues", keep_days)


def files(store: Store) -> set[str]:
    return {path.name for path in (store.directory / "measurements").rglob("*") if path.is_file()}


def statements(store: Store, act: Callable[[], Any]) -> list[str]:
    """What a database is asked meanwhile."""
    asked: list[str] = []

    def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        asked.append(statement)

    event.listen(store.database.engine, "before_cursor_execute", note)
    act()
    event.remove(store.database.engine, "before_cursor_execute", note)
    return asked
