"""The audit log, in every kind of database: one chain, whoever writes, and whatever is done to it is seen."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from answers import diagnosis
from command_line import invoke
from sqlalchemy import text
from sqlalchemy.orm import Session
from uploaded import uploaded

from jointplay.app.actor import Actor, acting
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.scopes import Scope
from jointplay.app.storage import audit
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.audit import AuditLog, AuditRow
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.app.storage.told import Told
from jointplay.app.storage.webhooks import Webhooks

MACHINE = {"name": "m", "joints": {"B": {"kind": "turning"}}}
SENDER = Actor(key="0a1b2c", address="192.0.2.7", request_id="r-1")


@pytest.fixture
def stores(url: str, tmp_path: Path) -> Iterator[list[Store]]:
    """What two servers of one database have."""
    with ExitStack() as stack:
        yield [stack.enter_context(closing(Store(tmp_path, url))) for _ in range(2)]


def put(store: Store, notes: str = "") -> None:
    Assets(store.database).put("press-7", AssetIn.model_validate({"machine": "m", "notes": notes}))


def done(store: Store) -> list[tuple[str, str, str]]:
    """Everything that was done, the first first."""
    return [(row.action, row.kind, row.object) for row in rows(store)]


def rows(store: Store) -> list[AuditRow]:
    return AuditLog(store.database).page(None, 1000)[::-1]


def damage(store: Store) -> list[str]:
    return list(AuditLog(store.database).damage())


def test_every_change_is_noted_with_who_made_it(store: Store) -> None:
    with acting(SENDER):
        kept = store.add_measurement(uploaded(store), "a.csv", None, {})
        store.add_measurement(uploaded(store), "a.csv", Told(measured_at=now()), {})
        store.correct_moment(kept.id, now())
        Assets(store.database).put(
            "press-7", AssetIn.model_validate({"machine": "m", "baseline": kept.id, "notes": "hall A"})
        )
        put(store, "hall B")
        put(store, "hall B")
        asked = store.add_diagnosis(NewDiagnosis(kept.id, "c" * 64, MACHINE, {"asset": None}, diagnosis()))
        store.add_diagnosis(NewDiagnosis(kept.id, "c" * 64, MACHINE, {"asset": None}, diagnosis()))
        found = Findings(store.database).add(
            asked, FindingIn.model_validate({"at": "2026-03-01T06:00:00Z", "text": "in order"})
        )
        hook = Webhooks(store.database).add("https://user:secret@example.org/path-secret", ["build.ended"])
        tried = Webhooks(store.database).test(hook.id)
        Webhooks(store.database).redeliver(hook.id, tried.id)
        Webhooks(store.database).remove(hook.id)
        build = BuildQueue(store.database).add(MACHINE, {"name": "p"}, "h", "c", None)
        BuildQueue(store.database).add(MACHINE, {"name": "p"}, "h", "c", None)
        BuildQueue(store.database).cancel(build.id)
        key, token = Keys(store.database).create("line 3", frozenset({Scope.READ}), timedelta(days=1))
        session = Keys(store.database).open_session(key)
        Keys(store.database).close_session(session)
        Keys(store.database).close_session(session)
        Keys(store.database).revoke(key.id)
        Keys(store.database).revoke(key.id)
        keys = Keys(store.database)
        for _ in range(3):
            keys.note_refusal("192.0.2.9")
    assert done(store) == [
        ("made", "measurement", kept.id),
        ("corrected", "measurement", kept.id),
        ("corrected", "measurement", kept.id),
        ("made", "asset", "press-7"),
        ("gained", "asset", "press-7"),
        ("changed", "asset", "press-7"),
        ("made", "diagnosis", asked.id),
        ("made", "finding", found.id),
        ("made", "webhook", hook.id),
        ("tried", "webhook", hook.id),
        ("redelivered", "webhook", hook.id),
        ("deleted", "webhook", hook.id),
        ("made", "build", build.id),
        ("asked for again", "build", build.id),
        ("cancelled", "build", build.id),
        ("made", "key", key.id),
        ("signed in", "key", key.id),
        ("signed out", "key", key.id),
        ("revoked", "key", key.id),
        ("refused to sign in", "address", "192.0.2.9"),
    ]
    assert {(row.key, row.address, row.request_id) for row in rows(store)} == {("0a1b2c", "192.0.2.7", "r-1")}
    changed = rows(store)[5]
    assert changed.before is not None and changed.after is not None
    assert changed.before["members"] == {"notes": "hall A", "baselines": [kept.id]}
    assert changed.after["members"] == {"notes": "hall B", "baselines": []}
    kept_text = str([row.content for row in rows(store)])
    assert "secret" not in kept_text and token.split("_", 2)[2] not in kept_text
    assert damage(store) == []


def test_a_change_that_fails_is_not_noted(store: Store) -> None:
    def fail(_session: object, _key: str) -> None:
        raise RuntimeError("the transaction fails")

    put(store)
    with pytest.raises(RuntimeError, match="transaction fails"):
        store.add_measurement(uploaded(store), "a.csv", None, {}, fail)
    assert done(store) == [("made", "asset", "press-7")]


def test_what_the_program_does_by_itself_is_the_systems(store: Store) -> None:
    put(store)
    [row] = rows(store)
    assert (row.key, row.person, row.address, Actor().name) == (None, None, "", "system")


def test_a_note_that_nobody_would_write_is_refused(store: Store) -> None:
    with Session(store.database.engine) as session, pytest.raises(RuntimeError, match="writes no audit log"):
        audit.note(session, "made", "asset", "press-7")


def test_two_servers_write_one_chain(stores: list[Store]) -> None:
    def write(number: int) -> None:
        for turn in range(15):
            stores[number % 2].add_measurement(uploaded(stores[0]), f"{number}-{turn}.csv", None, {})

    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(write, range(4))) == [None] * 4
    assert [row.number for row in rows(stores[0])] == list(range(1, 61))
    assert damage(stores[1]) == []


def test_a_long_member_is_kept_as_its_checksum(store: Store) -> None:
    put(store, "x" * 4000)
    after: Any = rows(store)[0].after
    assert after["members"]["notes"].keys() == {"sha256"}


TAMPERED = {
    "changed": (["UPDATE audit SET address = '192.0.2.8' WHERE number = 2"], "row 2 (changed asset press-7) is not"),
    "removed": (["DELETE FROM audit WHERE number IN (2, 3)"], "rows 2 to 3 are missing"),
    "first": (["DELETE FROM audit WHERE number = 1"], "row 1 is missing"),
    "last": (["DELETE FROM audit WHERE number = 5"], "row 5 is missing"),
    "end": (["UPDATE audit_end SET number = 4"], "row 4 is not the one that was written last"),
    "swapped": (
        [f"UPDATE audit SET number = {to} WHERE number = {of}" for of, to in ((3, 0), (4, 3), (0, 4))],
        "row 3 does not follow row 2",
    ),
}


@pytest.mark.parametrize("kind", TAMPERED)
def test_whatever_is_done_to_the_chain_is_seen(store: Store, kind: str) -> None:
    for number in range(5):
        put(store, str(number))
    assert damage(store) == []
    statements, said = TAMPERED[kind]
    with store.database.engine.begin() as connection:
        for statement in statements:
            connection.execute(text(statement))
    assert damage(store)[0].startswith(said)


def test_keys_that_are_made_at_the_prompt_are_noted_with_whoever_typed(
    tmp_path: Path, invoke_keys: Callable[..., str]
) -> None:
    identity = invoke_keys("create", "line 3")
    invoke_keys("revoke", identity)
    with closing(Store(tmp_path / "data")) as store:
        assert done(store) == [("made", "key", identity), ("revoked", "key", identity)]
        assert {row.address for row in rows(store)} == {"command line"}
        assert all(row.person for row in rows(store))


@pytest.fixture
def invoke_keys(tmp_path: Path) -> Callable[..., str]:
    """Runs `jointplay keys`, and gives the id of the key it is about."""

    def run(*arguments: str) -> str:
        result = invoke("keys", *arguments, "--data", str(tmp_path / "data"), "--json")
        assert result.exit_code == 0, result.output
        identity: str = json.loads(result.stdout)["id"]
        return identity

    return run
