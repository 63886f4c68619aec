"""Deleting over HTTP, quotas, what is counted of it, and the command that does what the service does every hour."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from command_line import invoke
from example_calls import MEDIA_TYPE
from prometheus_client.parser import text_string_to_metric_families
from small_service import asking

from jointplay.app.routes.machines import MACHINE_FILE
from jointplay.app.scopes import Scope, scope_of
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.rows import MeasurementRow, now
from jointplay.app.storage.store import Store

API = "/api/v1"
QUESTION = {"catalogue": "slider-crank", "effort": "fast"}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a service of these tests alone."""
    return tmp_path_factory.mktemp("deleting")


@pytest.fixture(scope="module")
def alone(shelf: Path, data: Path) -> Iterator[httpx.Client]:
    """A client of it."""
    with asking(
        ServiceSettings(catalogues=shelf, data=data, workers=1, builds=0, time_limit_s=300.0, keys="off")
    ) as client:
        yield client


def files(folder: Path) -> dict[Path, int]:
    """All files but the database's, with their sizes."""
    found = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("service.sqlite"))
    return {path: path.stat().st_size for path in found}


def problem(answer: httpx.Response, status: int, slug: str) -> str:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == MEDIA_TYPE
    assert answer.json()["type"] == f"urn:jointplay:problem:{slug}"
    detail: str = answer.json()["detail"]
    return detail


@pytest.mark.long
def test_a_recording_and_all_that_speaks_of_it(alone: httpx.Client, worn: bytes) -> None:
    alone.put(f"{API}/assets/press-7", json={"machine": "slider-crank"}).raise_for_status()
    sent = {"files": {"file": ("w.csv", worn)}, "data": {**QUESTION, "asset": "press-7"}}
    key = {"Idempotency-Key": "first"}
    diagnosis = alone.post(f"{API}/diagnoses", **sent, headers=key).json()  # type: ignore[arg-type]
    place, measurement = f"{API}/diagnoses/{diagnosis['id']}", f"{API}/measurements/{diagnosis['measurement']}"
    finding = alone.post(f"{place}/finding", json={"text": "worn", "at": "2026-11-21T10:30:00Z"}).json()
    assert alone.get(f"{measurement}/retention").json() == {
        "keep_as": "evidence",
        "said": False,
        "hold": None,
        "changed_by": "",
        "changed_at": None,
        "keep_until": None,
    }
    assert "say that it is routine first" in problem(alone.delete(measurement), 409, "in-use")
    said = alone.put(f"{measurement}/retention", json={"keep_as": "routine", "hold": "claim 7"}).json()
    assert (said["keep_as"], said["said"], said["hold"], said["changed_by"]) == (
        "routine",
        True,
        "claim 7",
        "127.0.0.1",
    )
    assert "is on hold (claim 7)" in problem(alone.delete(place), 409, "in-use")
    alone.put(f"{measurement}/retention", json={"keep_as": "routine"}).raise_for_status()
    once = {"Idempotency-Key": "gone"}
    for _ in range(2):
        assert alone.delete(measurement, params={"why": "the customer has left"}, headers=once).status_code == 204
    for gone in (measurement, f"{measurement}/retention", f"{measurement}/signal?view=waveform"):
        assert "by 127.0.0.1: the customer has left" in problem(alone.get(gone), 410, "deleted")
    problem(alone.delete(measurement), 410, "deleted")
    problem(alone.post(f"{API}/diagnoses", json={**QUESTION, "measurement": diagnosis["measurement"]}), 410, "deleted")
    assert alone.get(f"{API}/measurements").json()["items"] == []

    shown = alone.get(place).json()
    assert (shown["measurements_deleted"], shown["verdict"]) == ([diagnosis["measurement"]], "worn")
    assert f"Deleted</th><td>{diagnosis['measurement']}" in "".join(alone.get(f"{place}/report").text.split("\n"))
    page = alone.get(f"/diagnoses/{diagnosis['id']}", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "The recording was deleted." in page.text
    assert alone.get("/assets/press-7", headers={"Accept": "text/html"}).status_code == 200
    state = alone.get(f"{API}/assets/press-7/state")
    assert state.status_code == 200  # its life goes on
    answer = alone.get(measurement.removeprefix(API), headers={"Accept": "text/html"})
    assert answer.status_code == 410
    assert "the customer has left" in answer.text

    again = alone.post(f"{API}/diagnoses", **sent).json()  # type: ignore[arg-type]
    assert again == diagnosis
    assert alone.get(measurement).status_code == 200
    for place_of in (f"{API}/findings/{finding['id']}", place, measurement, f"{API}/assets/press-7"):
        answer = alone.delete(place_of)
        assert answer.status_code == 204, answer.text
        problem(alone.get(place_of), 410, "deleted")
    fresh = alone.post(f"{API}/diagnoses", **sent, headers=key)  # type: ignore[arg-type]
    assert "asset press-7: was deleted" in problem(fresh, 410, "deleted")  # and not the answer of then


def test_machines_catalogues_and_builds(alone: httpx.Client) -> None:
    alone.put(f"{API}/machines/mine", json=MACHINE_FILE).raise_for_status()
    assert alone.delete(f"{API}/machines/mine").status_code == 204
    assert "machine mine: was deleted" in problem(alone.get(f"{API}/machines/mine"), 410, "deleted")
    problem(alone.delete(f"{API}/machines/slider-crank"), 409, "shipped-machine")
    asked = {"machine": "slider-crank", "plan": "quick", "catalogue": "other"}
    build = alone.post(f"{API}/builds", json=asked).json()
    place = f"{API}/builds/{build['id']}"
    assert "cancel it first" in problem(alone.delete(place), 409, "build-open")
    alone.post(f"{place}/cancel").raise_for_status()
    assert alone.delete(place).status_code == 204
    problem(alone.get(place), 410, "deleted")
    for kind in ("machines", "catalogues", "builds", "measurements", "diagnoses", "assets", "findings"):
        assert alone.delete(f"{API}/{kind}/nothing").status_code == 404


def test_what_is_refused_leaves_nothing(alone: httpx.Client, data: Path, worn: bytes) -> None:
    """The attack that left 160 MB: recordings that can be read, with a question that cannot be answered."""
    before, rows = files(data), alone.get(f"{API}/measurements").json()
    lines = worn.splitlines(keepends=True)
    for number in range(5):
        short = b"".join(lines[: 1300 + number])
        refused = alone.post(f"{API}/diagnoses", files={"file": ("short.csv", short)}, data=QUESTION)
        assert "at least 3 are needed" in problem(refused, 422, "measurement")
    refused = alone.post(
        f"{API}/diagnoses", files={"file": ("w.csv", worn + b"\n")}, data={**QUESTION, "speed": "3 kg"}
    )
    problem(refused, 422, "invalid-field")
    assert (files(data), alone.get(f"{API}/measurements").json()) == (before, rows)


@pytest.mark.parametrize(
    ("method", "path", "scope"),
    [
        ("DELETE", "/api/v1/measurements/7", Scope.ADMIN),
        ("DELETE", "/api/v1/catalogues/7", Scope.ADMIN),
        ("DELETE", "/api/v1/machines/press", Scope.ADMIN),
        ("DELETE", "/api/v1/builds/7", Scope.ADMIN),
        ("DELETE", "/api/v1/assets/press-7/acknowledgement", Scope.MATCH),
        ("PUT", "/api/v1/measurements/7/retention", Scope.ADMIN),
        ("GET", "/api/v1/measurements/7/retention", Scope.READ),
    ],
)
def test_scopes(method: str, path: str, scope: Scope) -> None:
    assert scope_of(method, path) is scope


def test_a_quota_of_a_key(tmp_path: Path, worn: bytes) -> None:
    settings = ServiceSettings(
        catalogues=tmp_path / "none",
        data=tmp_path,
        workers=1,
        builds=0,
        keys="required",
        quota_each_gb=1.5e-9 * len(worn),
    )
    with closing(Store(settings.data)) as store:
        tokens = [Keys(store.database).create("k", frozenset(Scope), timedelta(hours=1))[1] for _ in range(2)]
    with asking(settings) as client:
        for token in tokens:
            client.headers["X-API-Key"] = token
            client.post(f"{API}/measurements", files={"file": (f"{token[:9]}.csv", worn)}).raise_for_status()
        refused = client.post(f"{API}/measurements", files={"file": ("b.csv", worn + b"\n")})
        detail = problem(refused, 507, "quota")
        assert "MB are used by key" in detail
        families = {each.name: each for each in text_string_to_metric_families(client.get("/metrics").text)}
    found = {each.labels["class"]: each.value for each in families["jointplay_recordings_bytes"].samples}
    assert found == {"routine": 2.0 * len(worn), "baseline": 0.0, "evidence": 0.0}
    for name in ("disk_free_bytes", "disk_full_days", "database_bytes", "recordings_bytes_per_day"):
        assert families[f"jointplay_{name}"].samples[0].value > 0
    assert families["jointplay_uploads_partial"].samples[0].value == 0
    assert math.isfinite(families["jointplay_disk_full_days"].samples[0].value)


def test_the_command_says_and_does_what_the_service_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(Store(tmp_path / "data")) as store:
        kept = [
            store.add_measurement(store.uploads.receive(io.BytesIO(bytes([k]) * 2_000_000)), "a.csv", None, {})
            for k in range(2)
        ]
        with store.database.writing() as session:
            session.get_one(MeasurementRow, kept[0].number).created_at = now() - timedelta(days=91)
    places = ["--data", tmp_path / "data", "--catalogues", tmp_path / "none"]
    result = invoke("prune", "--dry-run", *places)
    assert result.exit_code == 0, result.stderr
    assert "would go: nothing" in result.stdout
    monkeypatch.setenv("JOINTPLAY_KEEP_ROUTINE_DAYS", "90")
    result = invoke("prune", "--dry-run", *places)
    assert "routine recordings  2.0 MB  kept for 90 days" in result.stdout
    assert "full in" in result.stdout or "not full" in result.stdout
    for dry in (["--dry-run"], []):
        result = invoke("prune", *dry, *places, "--json")
        document: dict[str, Any] = json.loads(result.stdout)
        assert document["deleted"] is (not dry)
        (going,) = document["going"]
        assert (going["ids"], going["bytes"]) == ([kept[0].id], 2_000_000)
        assert document["stored"]["recordings"]["routine"]["count"] == (2 if dry else 1)
    assert json.loads(invoke("prune", *places, "--json").stdout)["going"] == []
