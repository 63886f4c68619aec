"""Disk full and database gone: told as such, nothing half stored, and all is well again when they are."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path
from typing import Any

import databases
import httpx
import pytest
from lines import remote
from small_service import PLAN, asking
from sqlalchemy import event, text
from sqlalchemy.exc import OperationalError
from starlette.datastructures import UploadFile

from jointplay.app.problems import foreseen, problem_of
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.store import Store
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.storage.directory import publish

API = "/api/v1"
ASKED = {"machine": "slider-crank", "plan": PLAN, "catalogue": "made"}


def full(*_arguments: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(("owner", "name"), [(os, "fsync"), (os, "replace"), (UploadFile, "write")])
def test_an_upload_to_a_full_disk_is_refused_and_taken_later(
    client: httpx.Client, worn: bytes, settings: ServiceSettings, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str
) -> None:
    upload = {"file": (f"full-{name}.csv", worn)}
    before = files(settings.data / "measurements")
    with monkeypatch.context() as broken:
        broken.setattr(owner, name, full)
        response = client.post(f"{API}/measurements", files=upload)
    assert response.status_code == 507, response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["type"] == "urn:jointplay:problem:storage-full"
    assert files(settings.data / "measurements") == before
    assert client.post(f"{API}/measurements", files=upload).status_code == 201


def test_a_full_database_is_told_and_recovers(tmp_path: Path) -> None:
    store = Store(tmp_path)

    def add(name: str) -> None:
        upload = store.uploads.receive(io.BytesIO(name.encode()))
        store.add_measurement(upload, name, None, {"text": "x" * 1_000_000})

    with store.database.engine.connect() as connection:
        pages = connection.scalar(text("PRAGMA page_count"))
        connection.execute(text(f"PRAGMA max_page_count = {pages + 5}"))
    with pytest.raises(OperationalError) as caught:
        add("a.csv")
    assert problem_of(caught.value).status == 507
    assert store.measurements(None, 5) == []
    with store.database.engine.connect() as connection:
        connection.execute(text("PRAGMA max_page_count = 100000"))
    add("a.csv")
    assert [row.name for row in store.measurements(None, 5)] == ["a.csv"]
    store.close()


def test_files_of_a_catalogue_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CatalogueFileError) as caught:
        publish(tmp_path / "x", b"1")
    assert problem_of(caught.value).status == 507


def test_other_failures_are_not_taken_for_these() -> None:
    for error in (PermissionError(errno.EACCES, "no"), KeyError("x"), CatalogueFileError("x", "is damaged")):
        assert foreseen(error) is None
        assert problem_of(error).status == 500


def test_what_is_acknowledged_was_synced_and_then_committed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    seen: list[str] = []
    sync = os.fsync

    def noted(descriptor: int) -> None:
        sync(descriptor)
        place = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        whole = any(path.is_file() and len(path.name) == 64 for path in (tmp_path / "measurements").rglob("*"))
        seen.append(f"{'folder' if place.is_dir() else 'file'} {'named' if whole else 'unnamed'}")

    monkeypatch.setattr(os, "fsync", noted)
    event.listen(store.database.engine, "commit", lambda _connection: seen.append("commit"))
    store.add_measurement(store.uploads.receive(io.BytesIO(b"bytes")), "a.csv", None, {})
    assert seen == ["file unnamed", "folder unnamed", "folder named", "commit"]
    with store.database.engine.connect() as connection:
        assert connection.scalar(text("PRAGMA synchronous")) == 2  # FULL: a commit waits for the disk
    store.close()


@pytest.mark.parametrize("kind", [kind for kind in databases.KINDS if kind == "postgresql"])
def test_a_database_that_is_gone_is_told_and_comes_back(tmp_path: Path, kind: str) -> None:
    with remote(tmp_path) as (line, url):
        # Its builder looks for builds all the time, and has to outlive this as well.
        settings = ServiceSettings(catalogues=tmp_path / "none", data=tmp_path / "data", database=url, workers=1)
        with asking(settings) as client:
            assert client.get("/readyz").status_code == 200
            line.cut()
            for method, place in (("GET", f"{API}/diagnoses"), ("POST", f"{API}/builds"), ("GET", "/readyz")):
                response = client.request(method, place, json=ASKED if method == "POST" else None)
                assert response.status_code == 503, (place, response.text)
                assert response.json()["type"] == "urn:jointplay:problem:database-gone"
                assert response.headers["retry-after"] == "5"
            assert client.get("/healthz").status_code == 200
            line.mend()
            assert client.get("/readyz").status_code == 200
            place = client.post(f"{API}/builds", json=ASKED).headers["location"]
            with client.stream("GET", f"{place}/events") as stream:
                next(line for line in stream.iter_lines() if '"running"' in line)
                client.post(f"{place}/cancel")
            assert len(client.get(f"{API}/builds").json()["items"]) == 1
