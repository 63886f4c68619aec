"""What checksums of rows and files, and the audit log, cost: processor seconds with and without them, and ratios.

``python -m benchmarks.custody [--postgres URL]``
"""

from __future__ import annotations

import argparse
import io
import json
import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import patch

from jointplay.app.routes.diagnoses import diagnosis_out, item
from jointplay.app.storage import audit, rows
from jointplay.app.storage.recording_files import read_bytes
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.catalogue.diagnosing.answer import Diagnosis

ANSWER = Path(__file__).parents[1] / "tests/data/service/answer-1.json"
ROUNDS = 20
CLIENTS, EACH = 32, 15


def seconds(act: Callable[[], object]) -> float:
    """Processor seconds of one call, the least of several."""
    found = []
    for _ in range(ROUNDS):
        began = time.process_time()
        act()
        found.append(time.process_time() - began)
    return min(found)


def answers(count: int) -> list[Diagnosis]:
    document = json.loads(ANSWER.read_text())
    return [Diagnosis.model_validate({**document, "hash": f"{number:064x}"}) for number in range(count)]


def with_rows(store: Store, count: int) -> str:
    """Store diagnoses; give the id of the last."""
    measured = store.add_measurement(store.uploads.receive(io.BytesIO(os.urandom(300_000))), "a.csv", None, {})
    machine = {"name": "m", "joints": {"B": {"kind": "turning"}}, "padding": "x" * 3000}
    last = ""
    for answer in answers(count):
        last = store.add_diagnosis(NewDiagnosis(measured.id, "c" * 64, machine, {}, answer)).id
    return last


def reading(store: Store) -> None:
    """Print what a list of 50 and a single diagnosis take to be read and shown, with and without their checksums."""
    key = with_rows(store, 60)

    def listed() -> list[Any]:
        return [item(row) for row in store.diagnoses(None, 50)]

    def single() -> str:
        return diagnosis_out(store.diagnosis(key)).model_dump_json()

    for name, act in (("list of 50 diagnoses", listed), ("one diagnosis", single)):
        checked = seconds(act)
        with patch.object(rows.Sealed, "digest", lambda row: row.checksum):
            plain = seconds(act)
        print(f"{name}: {1e3 * plain:.2f} ms without, {1e3 * checked:.2f} ms with checksums: x {checked / plain:.2f}")


def files(folder: Path) -> None:
    """Print what checking a recording adds to reading it."""
    with closing(Store(folder)) as store:
        upload = store.uploads.receive(io.BytesIO(os.urandom(300_000)))
        path = store.path_of(store.add_measurement(upload, "a.csv", None, {}).sha256)
    plain, checked = seconds(path.read_bytes), seconds(lambda: read_bytes(path))
    print(f"recording of 0.3 MB: {1e3 * plain:.2f} ms without, {1e3 * checked:.2f} ms with its SHA-256")


def writing(stores: list[Store], name: str) -> None:
    """Print how many measurements a second 32 clients of one or two servers get stored, with and without the log."""

    def write(number: int) -> None:
        store = stores[number % len(stores)]
        for turn in range(EACH):
            upload = store.uploads.receive(io.BytesIO(f"{name} {number} {turn} {time.monotonic_ns()}".encode()))
            store.add_measurement(upload, f"{number}.csv", None, {})

    def run() -> tuple[float, float]:
        began, busy = time.monotonic(), time.process_time()
        with ThreadPoolExecutor(CLIENTS) as threads:
            list(threads.map(write, range(CLIENTS)))
        count = CLIENTS * EACH
        return count / (time.monotonic() - began), 1e3 * (time.process_time() - busy) / count

    for _ in range(2):
        logged = run()
        with patch.object(audit, "note", lambda *_, **__: None), patch("jointplay.app.storage.store.audit.note"):
            plain = run()
        print(
            f"{name}, {len(stores)} servers, {CLIENTS} clients: {plain[0]:.0f}/s and {plain[1]:.1f} ms of processor"
            f" each without, {logged[0]:.0f}/s and {logged[1]:.1f} ms with the audit log"
        )
    print(f"chain: {list(audit.AuditLog(stores[0].database).damage()) or 'whole'}")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--postgres", help="URL of an empty database, or schema, for the second half.")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        files(Path(folder) / "files")
        with closing(Store(Path(folder) / "rows")) as store:
            reading(store)
            writing([store], "SQLite")
        if chosen.postgres:
            data = Path(folder) / "shared"
            with closing(Store(data, chosen.postgres)) as first, closing(Store(data, chosen.postgres)) as second:
                writing([first, second], "PostgreSQL")


if __name__ == "__main__":
    main()
