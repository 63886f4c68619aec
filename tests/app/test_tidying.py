"""What goes by itself, when its time is over or its server was killed."""

from __future__ import annotations

import io
import os
import time
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from life_cycle import CONTENT, aged, diagnosed, files, found, pruner, statements, stored
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from jointplay.app.errors import (
    BusyError,
    DeletedError,
    InUseError,
)
from jointplay.app.jobs.housekeeper import Housekeeper
from jointplay.app.schemas.assets import AssetIn
from jointplay.app.storage import retention
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.idempotency import IdempotencyRow
from jointplay.app.storage.pruning import Pruner
from jointplay.app.storage.removal import Removal
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow, now
from jointplay.app.storage.store import Store
from jointplay.app.storage.stored_files import ABANDONED_S, ORPHANS_S, PARTIAL, StoredFiles
from jointplay.app.storage.webhooks import DeliveryRow, Webhooks, announce


def test_recordings_go_when_their_time_is_over(store: Store) -> None:
    rows = [stored(store, CONTENT + bytes([65 + k]) * (k + 1)) for k in range(6)]
    routine, young, held, baseline, evidence, same = rows
    twin = stored(store, CONTENT + b"F" * 6, name="twin.csv")
    assert twin.sha256 == same.sha256
    Assets(store.database).put("press-7", AssetIn(machine="press", baseline=baseline.id))
    found(store, diagnosed(store, evidence))
    retention.say(store.database, held.id, "routine", "claim 7")
    retention.say(store.database, baseline.id, "routine", None)  # which it is all the same
    aged(store, routine, held, baseline, evidence, same)
    assert pruner(store).look() == []
    keeper = pruner(store, routine=90.0, evidence=3650.0)
    (going,) = keeper.look()
    assert set(going.ids) == {routine.id, same.id}
    assert (going.what, going.why) == ("routine recordings", "kept for 90 days")
    assert going.size_bytes == routine.size_bytes + same.size_bytes
    assert len(files(store)) == 6  # it was only looked at
    (gone,) = keeper.prune()
    assert set(gone.ids) == set(going.ids)
    assert files(store) == {row.sha256 for row in (young, held, baseline, evidence, twin)}
    assert list(keeper.prune()) == []
    with pytest.raises(DeletedError, match="by system: kept for 90 days"):
        store.measurement(routine.id)
    (gone,) = pruner(store, evidence=50.0).prune()
    assert gone.ids == (evidence.id,)


def test_a_damaged_row_keeps_no_other_from_going_and_goes_when_it_is_told(
    store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [stored(store, CONTENT + bytes([65 + k])) for k in range(3)]
    key = diagnosed(store, rows[2])
    found(store, key)
    aged(store, *rows)
    with store.database.writing() as session:
        damage = update(MeasurementRow).where(MeasurementRow.id == rows[0].id).values(name="other.csv")
        session.execute(damage)
        session.execute(update(DiagnosisRow).values(catalogue="other"))
    (gone,) = pruner(store, routine=90.0).prune()
    assert gone.ids == (rows[1].id,)
    assert f"not tidied up: measurement {rows[0].id}: its row is not what was written" in caplog.text
    with pytest.raises(InUseError, match=rf"\(a finding speaks of diagnosis {key}\)"):
        Removal(store).delete_measurement(rows[2].id, "")
    Removal(store)._bury_catalogue("made", "other", "")
    Removal(store).delete_measurement(rows[0].id, "damaged")
    assert files(store) == {rows[2].sha256}
    with store.database.reading() as session:
        assert session.scalar(select(MeasurementRow.name).where(MeasurementRow.id == rows[0].id)) == ""
    with pytest.raises(DeletedError, match="damaged"):
        Removal(store).delete_measurement(rows[0].id, "")


def test_assets_and_kept_answers_are_touched_once_for_a_batch(store: Store) -> None:
    rows = [stored(store, CONTENT + bytes([65 + k])) for k in range(3)]
    assets = Assets(store.database)
    for row, name in zip(rows, ("c", "b", "a"), strict=True):
        assets.put(name, AssetIn(machine="press"))
        assets.own(name, row.id)
    with store.database.writing() as session:
        for row in rows:
            kept = {"location": f"/api/v1/measurements/{row.id}"}
            session.add(IdempotencyRow(id=row.id, fingerprint="f", created_at=now(), headers=kept, body=b""))
    changes = [assets.asset(name).changes for name in "abc"]
    asked = statements(store, lambda: Removal(store).delete_measurements([row.id for row in rows], ""))
    assert sum(each.startswith("UPDATE assets") for each in asked) == 1
    assert sum(each.startswith("DELETE FROM idempotency") for each in asked) == 1
    assert [assets.asset(name).changes for name in "abc"] == [count + 1 for count in changes]
    with store.database.reading() as session:
        assert session.scalars(select(IdempotencyRow)).all() == []


def test_what_killed_servers_left_is_tidied_while_others_run(store: Store) -> None:
    row = stored(store)
    late = store.uploads.receive(io.BytesIO(b"sending"))  # killed here: the bytes have no name yet
    named = store.uploads.receive(io.BytesIO(b"named"))
    store.uploads._name(named)  # and here: they have it, but no row
    young = store.uploads.receive(io.BytesIO(b"young"))
    old = time.time() - ABANDONED_S - 60
    for path in (late.path, store.path_of(named.sha256), store.path_of(row.sha256)):
        os.utime(path, (old, old))
    stranger = store.path_of(row.sha256).with_name("notes.txt")
    stranger.write_text("not ours")
    os.utime(stranger, (old, old))
    assert [(each.what, each.ids) for each in pruner(store).look()] == [
        ("uploads that broke off", (late.path.name,)),
        ("files of no recording", (named.sha256,)),
    ]
    assert len(list(pruner(store).prune())) == 2
    assert files(store) == {young.path.name, row.sha256, "notes.txt"}
    assert young.path.name.startswith(PARTIAL)
    aside = store.directory / "orphans" / named.sha256
    assert aside.read_bytes() == b"named"
    os.utime(aside, (old, old))
    assert list(pruner(store).prune()) == []  # a day is not enough
    month = time.time() - ORPHANS_S - 60
    os.utime(aside, (month, month))
    expected = [("files in orphans/", (named.sha256,))]
    assert [(each.what, each.ids) for each in pruner(store).look()] == expected
    assert [(each.what, each.ids) for each in pruner(store).prune()] == expected
    assert not aside.exists()


def age_files(store: Store, *, by_s: float = ABANDONED_S + 60) -> None:
    for path in (store.directory / "measurements").rglob("*"):
        os.utime(path, (time.time() - by_s,) * 2)


def test_nothing_goes_beside_the_database_of_another(
    url: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(Store(tmp_path / "data", url)) as store:
        rows = [stored(store, CONTENT + bytes([65 + k])) for k in range(3)]
        age_files(store)
        assert store.files.why_apart() == ""
    with closing(Store(tmp_path / "data", f"sqlite:///{tmp_path / 'wrong.sqlite'}")) as wrong:
        for _ in range(2):
            assert "it has the id of another database than" in pruner(wrong).why_apart()
            assert pruner(wrong).look() == list(pruner(wrong).prune()) == []
            (tmp_path / "data" / "database.id").unlink(missing_ok=True)  # as folders of before there were ids
            assert "most of its files are of another database than" in pruner(wrong).why_apart()
            assert pruner(wrong).look() == list(pruner(wrong).prune()) == []
            stored(wrong, b"new")  # one that is spoken of is not most of them
            (tmp_path / "data" / "database.id").write_text("0" * 32)
        keeper = Housekeeper(pruner(wrong))
        keeper.step()
        keeper.step()
        assert caplog.text.count("files of no recording stay there; name the right one in JOINTPLAY_DATABASE") == 1
        assert {row.sha256 for row in rows} < files(wrong)
        (tmp_path / "data" / "database.id").unlink()
    with closing(Store(tmp_path / "data", url)) as store:
        age_files(store)
        (gone,) = pruner(store).prune()  # most of its files are its own: that of the other is put aside
        assert gone.what == "files of no recording"
        assert files(store) == {row.sha256 for row in rows}
        assert (tmp_path / "data" / "database.id").is_file()


def test_what_was_put_aside_comes_back_with_its_row(store: Store) -> None:
    row = stored(store)
    aside = store.directory / "orphans" / row.sha256
    aside.parent.mkdir()
    store.path_of(row.sha256).rename(aside)  # its row had been lost, and is back from a backup
    assert list(pruner(store).prune()) == []
    assert store.path_of(row.sha256).read_bytes() == CONTENT
    assert not aside.exists()


def test_what_fails_keeps_nothing_else_from_going(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    late = store.uploads.receive(io.BytesIO(b"sending"))
    os.utime(late.path, (0, 0))

    def fail(*_: object, **__: object) -> None:
        raise OSError("no")

    monkeypatch.setattr(Pruner, "_prune_expired", fail)
    monkeypatch.setattr(Pruner, "_prune_told", fail)
    with pytest.raises(OSError, match="no") as failed:
        list(pruner(store).prune())
    assert failed.value.__notes__ == ["besides: OSError: no"]
    assert not late.path.exists()


def test_deliveries_that_were_made_go(store: Store) -> None:
    hooks = Webhooks(store.database)
    hook = hooks.add("http://127.0.0.1:9/x", ["finding.created"])
    for _ in range(3):
        with store.database.writing() as session:
            announce(session, "finding.created", {"finding": "f"})
    waiting, recent, old = hooks.deliveries(hook.id, None, 5)
    month = now() - timedelta(days=31)
    with store.database.writing() as session:
        for key, state in ((recent.id, "delivered"), (old.id, "delivered")):
            session.execute(update(DeliveryRow).where(DeliveryRow.id == key).values(state=state))
        session.execute(update(DeliveryRow).where(DeliveryRow.id != recent.id).values(created_at=month))
    (gone,) = pruner(store).prune()
    assert (gone.what, gone.ids) == ("deliveries of webhooks", (old.id,))
    assert {each.id for each in hooks.deliveries(hook.id, None, 5)} == {waiting.id, recent.id}


def test_bytes_that_are_deleted_while_they_come_are_not_acknowledged(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the moment at which a file has its name and its row, somebody deletes the last row of the same bytes."""
    row = stored(store)
    lock = StoredFiles.lock

    def others(self: StoredFiles, session: Session, *, alone: bool) -> None:
        lock(self, session, alone=alone)
        if not alone:
            store.path_of(row.sha256).unlink()

    monkeypatch.setattr(StoredFiles, "lock", others)
    with pytest.raises(BusyError, match="deleted at this moment; send them again"):
        stored(store, name="b.csv")
    assert len(store.measurements(None, 10)) == 1


def test_a_deletion_that_is_cut_short_leaves_no_row_without_its_file(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = stored(store)

    def killed(*_arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as dying:
        dying.setattr(StoredFiles, "drop", killed)
        with pytest.raises(KeyboardInterrupt):
            Removal(store).delete_measurement(row.id, "")
    with pytest.raises(DeletedError):
        store.measurement(row.id)
    assert files(store) == {row.sha256}
    os.utime(store.path_of(row.sha256), (0, 0))
    (gone,) = pruner(store).prune()
    assert (gone.what, gone.ids) == ("files of no recording", (row.sha256,))
