"""A backup made while requests come, brought back elsewhere: the same answers, whatever the kinds of the databases."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import databases
import httpx
import pytest
from answers import diagnosis
from command_line import assert_refused, invoke
from small_service import serving
from sqlalchemy import text

from jointplay.app.errors import BackupError, DeletedError, RecordingDamagedError
from jointplay.app.etags import Conditions
from jointplay.app.routes.machines import MACHINE_FILE
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage import backup
from jointplay.app.storage.backup import Place, back_up, check, restore
from jointplay.app.storage.copying import digest_of
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.removal import Removal
from jointplay.app.storage.rows import MeasurementRow
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.solver.machines.machine import shipped_machine

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


@pytest.mark.long
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


def test_what_is_no_backup_is_refused(tmp_path: Path) -> None:
    data, places = tmp_path / "data", ["--catalogues", tmp_path / "c", "--data", tmp_path / "data"]
    assert_refused(invoke("backup", tmp_path / "copy", *places), 2, "holds no data of a service")
    with closing(Store(data)):
        pass
    assert_refused(invoke("backup", data, *places), 2, "must be a new or empty folder")
    assert_refused(invoke("backup", tmp_path / "copy", *places, "--last", tmp_path), 2, "is no complete backup")
    new = ["--catalogues", tmp_path / "c", "--data", tmp_path / "new"]
    (tmp_path / "empty").mkdir()
    for broken in ("empty", "nothing"):
        assert_refused(invoke("restore", tmp_path / broken, *new), 2, "is no complete backup")
        assert_refused(invoke("restore", tmp_path / broken, "--check"), 2, "is no complete backup")
    assert not (tmp_path / "new").exists()


class Kept:
    """A service's data without a service: recordings of a megabyte, one of them with a diagnosis, and a machine."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.place = Place(folder / "data", folder / "catalogues", "")
        self.rows: list[MeasurementRow] = []
        shards = folder / "catalogues" / "made" / "shards"
        shards.mkdir(parents=True)
        (shards.parent / "manifest.json").write_text("{}")
        content = b"shard" * 50_000
        self.shard = shards / f"{hashlib.sha256(content).hexdigest()}.h5"
        self.shard.write_bytes(content)
        with closing(Store(self.place.data)) as store:
            MachineStore(self.place.data / "machines").put("mine", machine(), Conditions())
            self.add(store, 3)
            self.file = store.path_of(self.rows[0].sha256)

    def add(self, store: Store, count: int) -> None:
        for _ in range(count):
            upload = store.uploads.receive(io.BytesIO(bytes([len(self.rows)]) * 1_000_000))
            self.rows.append(store.add_measurement(upload, "a.csv", None, {"channels": []}))

    def copy(self, name: str, last: str = "") -> dict[str, Any]:
        return back_up(self.place, self.folder / name, last=self.folder / last if last else None)

    def brought(self, name: str) -> tuple[dict[str, Any], Place]:
        place = Place(self.folder / "new", self.folder / "shelf", "")
        return restore(self.folder / name, place), place


def machine() -> str:
    return shipped_machine("slider-crank").canonical_json()


@pytest.fixture
def kept(tmp_path: Path) -> Kept:
    return Kept(tmp_path)


def test_a_second_backup_copies_what_is_new(kept: Kept) -> None:
    first = kept.copy("one")
    assert (first["recordings"], first["damaged"], first["linked_bytes"]) == (3, [], 0)
    assert first["copied_bytes"] > 3_250_000
    with closing(Store(kept.place.data)) as store:
        kept.add(store, 1)
    second = kept.copy("two", last="one")
    assert second["linked_bytes"] == 3_250_000 + (kept.folder / "two/machines/mine.json").stat().st_size + sum(
        path.stat().st_size for path in (kept.folder / "two/machines/versions").rglob("*.json")
    ) + len("{}")
    assert second["copied_bytes"] == 1_000_000
    assert check(kept.folder / "two")["damaged"] == []
    shutil.rmtree(kept.folder / "one")  # each is whole by itself
    assert check(kept.folder / "two")["damaged"] == []
    said, place = kept.brought("two")
    assert said["damaged"] == []
    assert (place.catalogues / "made" / "shards" / kept.shard.name).read_bytes() == kept.shard.read_bytes()
    with closing(Store(place.data)) as store:
        assert [row.id for row in store.measurements(None, 9)] == [row.id for row in reversed(kept.rows)]
        assert all(store.path_of(row.sha256).stat().st_size == 1_000_000 for row in kept.rows)
        assert store.files.why_apart() == ""
    ids = [(folder / "database.id").read_text() for folder in (kept.place.data, place.data)]
    assert len(set(ids)) == 2  # the copy is of its own


@pytest.mark.parametrize("how", ["is not what it was", "is missing"])
def test_a_backup_goes_on_past_damage_and_says_so(kept: Kept, how: str) -> None:
    kept.copy("before")
    for path in (kept.file, kept.shard):
        if how == "is missing" and path is kept.file:
            path.unlink()
        else:
            path.write_bytes(b"other bytes")
    damaged = [
        {"what": "recording", "name": kept.rows[0].sha256, "how": how},
        {"what": "catalogue made", "name": kept.shard.stem, "how": "is not what it was"},
    ]
    places = ["--catalogues", kept.place.catalogues, "--data", kept.place.data]
    result = invoke("backup", kept.folder / "copy", *places)
    assert result.exit_code == 1
    assert f"2 damaged, copied all the same: recording {kept.rows[0].sha256} {how}" in result.stderr
    assert f"damaged: recording {kept.rows[0].sha256}: {how}" in result.stdout
    sealed = json.loads((kept.folder / "copy" / "backup.json").read_text())
    assert (sealed["damaged"], sealed["recordings"]) == (damaged, 2)
    assert check(kept.folder / "copy")["damaged"] == damaged  # nothing more than it says
    brought, place = kept.brought("copy")
    assert brought["damaged"] == damaged
    with closing(Store(place.data)) as store:
        assert len(store.measurements(None, 9)) == 3
        assert [store.path_of(row.sha256).is_file() for row in kept.rows] == [False, True, True]

    healed = kept.copy("healed", last="before")  # what the last backup has
    told = [each["how"].partition("; ") for each in healed["damaged"]]
    assert told == [(each["how"], "; ", "taken from the last backup") for each in damaged]
    assert healed["recordings"] == 3
    again = check(kept.folder / "healed")["damaged"]
    assert again == healed["damaged"]


def test_rows_that_cannot_be_read_are_left_out(kept: Kept) -> None:
    with closing(Store(kept.place.data)) as store:
        store.add_diagnosis(NewDiagnosis(kept.rows[1].id, "c", {}, {}, diagnosis()))
        with store.database.engine.begin() as connection:
            spoil = text("UPDATE measurements SET summary = '{' || :half WHERE id = :id")
            connection.execute(spoil, {"half": chr(34), "id": kept.rows[1].id})
    copied = kept.copy("copy")
    assert [(each["what"], each["name"], each["how"]) for each in copied["damaged"]] == [
        ("row", "measurements 2", "cannot be read (DamagedDatabaseError)"),
        ("row", "diagnoses 1", "speaks of what is lost"),
    ]
    assert (copied["rows"]["measurements"], copied["rows"]["diagnoses"], copied["recordings"]) == (2, 0, 2)
    assert check(kept.folder / "copy")["damaged"] == copied["damaged"]
    _, place = kept.brought("copy")
    with closing(Store(place.data)) as store:
        assert len(store.measurements(None, 9)) == 2


def test_a_backup_that_has_rotted_is_found_out(kept: Kept) -> None:
    kept.copy("copy")
    folder = kept.folder / "copy"
    assert invoke("restore", folder, "--check").exit_code == 0
    recording = folder / kept.file.relative_to(kept.place.data)
    recording.chmod(0o600)
    recording.write_bytes(b"1")
    (folder / "machines" / "mine.json").unlink()
    result = invoke("restore", folder, "--check")
    assert result.exit_code == 1
    assert "2 damaged, checked all the same" in result.stderr
    assert f"damaged: file measurements/{recording.parent.name}/{recording.name}: is not what it was" in result.stdout
    assert "damaged: file machines/mine.json: cannot be read (No such file or directory)" in result.stdout
    brought, _ = kept.brought("copy")
    assert [each["how"] for each in brought["damaged"]] == ["is not what it was"]
    with sqlite3.connect(folder / "service.sqlite") as rows:
        rows.execute("DELETE FROM measurements WHERE number = 3")
    rows.close()
    hashes = folder / "files.sha256"
    lines = [line for line in hashes.read_text().splitlines() if not line.endswith("service.sqlite")]
    hashes.write_text("\n".join([*lines, f"{digest_of(folder / 'service.sqlite')}  service.sqlite", ""]))
    found = {each["name"]: each["how"] for each in check(folder)["damaged"]}
    assert found["files.sha256"] == "is not what it was"
    assert found["measurements"] == "2 rows; there were 3"


def test_what_was_deleted_is_in_no_backup_and_stays_deleted(kept: Kept) -> None:
    with closing(Store(kept.place.data)) as store:
        Removal(store).delete_measurement(kept.rows[0].id, "left")
    assert kept.copy("copy")["recordings"] == 2
    said, place = kept.brought("copy")
    assert said["damaged"] == []
    with closing(Store(place.data)) as store, pytest.raises(DeletedError, match="left"):
        store.measurement(kept.rows[0].id)


@pytest.mark.parametrize("last", ["", "before"])
def test_what_is_deleted_while_it_is_copied_is_no_damage(
    kept: Kept, monkeypatch: pytest.MonkeyPatch, last: str
) -> None:
    if last:
        kept.copy(last)
    gone = kept.rows[0].sha256
    rows_first = backup.copy_rows

    def meanwhile(*arguments: Any) -> dict[str, int]:
        counts = rows_first(*arguments)
        with closing(Store(kept.place.data)) as store:
            Removal(store).delete_measurement(kept.rows[0].id, "left")
            store.path_of(kept.rows[1].sha256).unlink()  # which is damage
        return counts

    with monkeypatch.context() as copying:
        copying.setattr(backup, "copy_rows", meanwhile)
        content = kept.copy("copy", last)
    assert content["deleted_meanwhile"] == [gone]
    damaged = content["damaged"]
    assert [each["name"] for each in damaged] == [kept.rows[1].sha256]
    assert check(kept.folder / "copy")["damaged"] == damaged
    said, _ = kept.brought("copy")
    assert said["damaged"] == damaged


def test_a_backup_names_nothing_outside_of_it(kept: Kept) -> None:
    kept.copy("copy")
    folder = kept.folder / "copy"
    sealed = json.loads((folder / "backup.json").read_text())
    for name in ("../../shelf", str(kept.folder), "."):
        (folder / "backup.json").write_text(json.dumps({**sealed, "catalogues": [name]}))
        with pytest.raises(BackupError, match="which does not lie in it"):
            kept.brought("copy")
    assert not (kept.folder / "new" / "service.sqlite").exists()
    (folder / "backup.json").write_text(json.dumps(sealed))
    hashes = (folder / "files.sha256").read_text()
    (folder / "files.sha256").write_text(f"{hashes}{'0' * 64}  ../data/service.sqlite\n")
    with pytest.raises(BackupError, match=r"names '\.\./data/service\.sqlite', which does not lie in it"):
        check(folder)
    (folder / "files.sha256").write_text(hashes)
    with closing(sqlite3.connect(folder / "service.sqlite")) as rows, rows:
        rows.execute("UPDATE measurements SET sha256 = '../../secret' WHERE number = 1")
    (folder / "secret").write_text("secret")
    expected = {"what": "recording", "name": "'../../secret'", "how": "is no SHA-256"}
    said, place = kept.brought("copy")
    assert said["damaged"] == [expected]
    lines = [line for line in hashes.splitlines() if not line.endswith("service.sqlite")]
    mended = "\n".join([*lines, f"{digest_of(folder / 'service.sqlite')}  service.sqlite", ""])
    (folder / "files.sha256").write_text(mended)
    assert expected in check(folder)["damaged"]
    with closing(Store(place.data)) as store, pytest.raises(RecordingDamagedError, match="is no SHA-256"):
        store.path_of("../../secret")
