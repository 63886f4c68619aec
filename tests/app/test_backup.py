"""A backup made while requests come, brought back elsewhere: the same answers, whatever the kinds of the databases."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import databases
import httpx
import pytest
from command_line import assert_refused, invoke
from small_service import serving

from jointplay.app.routes.machines import MACHINE_FILE
from jointplay.app.settings import ServiceSettings

API = "/api/v1"
DIAGNOSE = {"catalogue": "slider-crank", "effort": "fast"}
KINDS = databases.KINDS
PAIRS = [("sqlite", "sqlite"), *(pair for pair in (("sqlite", KINDS[-1]), (KINDS[-1], "sqlite")) if len(KINDS) > 1)]


@contextmanager
def service(settings: ServiceSettings) -> Iterator[httpx.Client]:
    with serving(settings) as address, httpx.Client(base_url=address, timeout=300) as client:
        yield client


def everything(client: httpx.Client) -> dict[str, bytes]:
    """All that the service answers about what it keeps, by address; reports have no times of their own."""
    answers: dict[str, bytes] = {}
    for kind in ("machines", "catalogues", "measurements", "diagnoses", "assets", "findings", "webhooks", "builds"):
        listed = client.get(f"{API}/{kind}", params={"limit": 500})
        answers[kind] = listed.content
        for item in listed.json()["items"]:
            key = item.get("id") or item.get("external_id") or item["name"]
            places = [f"{API}/{kind}/{key}"] + ([f"{API}/{kind}/{key}/report"] if kind == "diagnoses" else [])
            for place in places:
                answer = client.get(place)
                assert answer.status_code == 200, (place, answer.text)
                answers[place] = answer.content
    return answers


@pytest.mark.parametrize(("kind", "other"), PAIRS)
def test_a_backup_of_a_working_service_gives_the_same_answers(
    tmp_path: Path, shelf: Path, worn: bytes, monkeypatch: pytest.MonkeyPatch, kind: str, other: str
) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    two.mkdir()
    with databases.database(kind, tmp_path) as url, databases.database(other, two) as new_url:
        settings = ServiceSettings(catalogues=shelf, data=one, database=url, builds=0, workers=1)
        with service(settings) as client:
            client.put(f"{API}/machines/mine", json=MACHINE_FILE).raise_for_status()
            client.put(f"{API}/assets/press-7", json={"machine": "slider-crank"}).raise_for_status()
            hook = {"url": "https://example.org/x", "events": ["finding.created"]}
            client.post(f"{API}/webhooks", json=hook).raise_for_status()
            made = client.post(
                f"{API}/diagnoses", files={"file": ("w.csv", worn)}, data={**DIAGNOSE, "asset": "press-7"}
            ).json()
            place = f"{API}/diagnoses/{made['id']}/finding"
            said = {"joints": {"B": {"clearance_um": 140}}, "text": "worn", "at": "2026-11-21T10:30:00Z"}
            client.post(place, json=said).raise_for_status()
            while not client.get(f"{API}/assets/press-7").json()["standing"]["up_to_date"]:
                time.sleep(0.05)  # it is judged in the background
            before = everything(client)

            stop, sent = threading.Event(), 0

            def go_on() -> None:
                nonlocal sent
                while not stop.is_set():
                    files = {"file": (f"{sent}.csv", worn + b"\n" * (sent % 3))}
                    client.post(f"{API}/measurements", files=files).raise_for_status()
                    sent += 1

            others = threading.Thread(target=go_on)
            others.start()
            try:
                monkeypatch.setenv("JOINTPLAY_DATABASE", url)
                result = invoke("backup", tmp_path / "copy", "--catalogues", shelf, "--data", one)
            finally:
                stop.set()
                others.join()
            assert result.exit_code == 0, result.stderr
            assert sent > 0
            after = everything(client)
        assert ((tmp_path / "copy").stat().st_mode & 0o077) == 0

        monkeypatch.setenv("JOINTPLAY_DATABASE", new_url)
        places = ["--catalogues", two / "catalogues", "--data", two / "data"]
        result = invoke("restore", tmp_path / "copy", *places)
        assert result.exit_code == 0, result.stderr
        moved = ServiceSettings(catalogues=two / "catalogues", data=two / "data", database=new_url, builds=0, workers=1)
        with service(moved) as client:
            found = everything(client)
            kept = [place for place in before if place.startswith("/")]
            assert {place: found[place] for place in kept} == {place: before[place] for place in kept}
            assert {place: found[place] for place in found if place.startswith("/")}.items() <= after.items()
            again = client.post(
                f"{API}/diagnoses", json={**DIAGNOSE, "measurement": made["measurement"], "asset": "press-7"}
            )
            assert (again.status_code, again.json()) == (201, made)
            fresh = client.post(f"{API}/measurements", files={"file": ("fresh.csv", worn + b"\n\n\n\n")})
            assert fresh.status_code == 201, fresh.text
        assert_refused(invoke("restore", tmp_path / "copy", *places), 2, "holds catalogues already")
        places[1] = two / "elsewhere"
        assert_refused(invoke("restore", tmp_path / "copy", *places), 2, "measurements: is not empty")
        places[3] = two / "elsewhere"
        assert_refused(invoke("restore", tmp_path / "copy", *places), 2, "holds data already")


def test_what_is_no_backup_is_refused(tmp_path: Path, worn: bytes) -> None:
    data, places = tmp_path / "data", ["--catalogues", tmp_path / "c", "--data", tmp_path / "data"]
    assert_refused(invoke("backup", tmp_path / "copy", *places), 2, "holds no data of a service")
    with service(ServiceSettings(catalogues=tmp_path / "c", data=data, builds=0, workers=1)) as client:
        client.post(f"{API}/measurements", files={"file": ("w.csv", worn)}).raise_for_status()
    assert_refused(invoke("backup", data, *places), 2, "must be a new or empty folder")
    (kept,) = (path for path in (data / "measurements").rglob("*") if path.is_file())
    kept.write_bytes(b"other bytes")
    assert_refused(invoke("backup", tmp_path / "copy", *places), 2, f"the recording {kept.name} is not what it was")
    kept.unlink()
    assert_refused(invoke("backup", tmp_path / "second", *places), 2, f"the recording {kept.name} is missing")
    new = ["--catalogues", tmp_path / "c", "--data", tmp_path / "new"]
    for broken in ("copy", "second", "nothing"):
        assert_refused(invoke("restore", tmp_path / broken, *new), 2, "is no complete backup")
    assert not (tmp_path / "new").exists()
