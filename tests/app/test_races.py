"""Two transactions that meet in PostgreSQL: the first stands before its commit until the second waits, or has ended."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import databases
import pytest
from life_cycle import CONTENT, files, stored
from sqlalchemy import create_engine, event, text

from jointplay.app.errors import DeletedError, InUseError
from jointplay.app.storage import retention
from jointplay.app.storage.removal import Removal
from jointplay.app.storage.store import Store

postgresql = [kind for kind in databases.KINDS if kind == "postgresql"]
pytestmark = pytest.mark.parametrize("url", postgresql, indirect=True)
WAITING = "SELECT count(*) FROM pg_locks WHERE NOT granted AND pid = ANY(:pids)"


def meet(
    store: Store, first: Callable[[], Any], second: Callable[[], Any], *, commit: int = 1
) -> tuple[Future[Any], Future[Any], bool]:
    """Do both at once; return what became of them, and whether the second waited for the first.

    Parameters
    ----------
    store : Store
    first, second : callable
    commit : int
        Which commit of the first is held.
    """
    engine, looks = store.database.engine, create_engine(store.database.engine.url)
    reached, ended = threading.Event(), threading.Event()
    mine: set[int] = set()
    commits: list[bool] = []  # of the first: whether somebody waited for it

    def waited() -> bool:
        while not ended.wait(0.02):
            with looks.connect() as look:
                if look.scalar(text(WAITING), {"pids": list(mine)}):
                    return True
        return False

    def begun(connection: Any) -> None:
        if threading.current_thread().name.startswith("second"):
            mine.add(connection.connection.dbapi_connection.info.backend_pid)

    def held(_connection: Any) -> None:
        if threading.current_thread().name.startswith("first"):
            commits.append(False)
            if len(commits) == commit:
                reached.set()
                commits[-1] = waited()

    def follow() -> Any:
        assert reached.wait(60)
        try:
            return second()
        finally:
            ended.set()

    event.listen(engine, "begin", begun)
    event.listen(engine, "commit", held)
    try:
        with ThreadPoolExecutor(1, "first") as one, ThreadPoolExecutor(1, "second") as other:
            both = one.submit(first), other.submit(follow)
    finally:
        event.remove(engine, "begin", begun)
        event.remove(engine, "commit", held)
        looks.dispose()
    return *both, any(commits)


@pytest.mark.parametrize("tidied", [False, True])
def test_a_hold_before_a_deletion(store: Store, tidied: bool) -> None:
    row, removal = stored(store), Removal(store)
    said, gone, waited = meet(
        store,
        lambda: retention.say(store.database, row.id, None, "claim 7"),
        lambda: removal.delete_measurements([row.id], "") if tidied else removal.delete_measurement(row.id, ""),
    )
    assert waited and said.result().hold == "claim 7"
    if tidied:
        assert gone.result() == {}
    else:
        assert isinstance(gone.exception(), InUseError)
    assert store.measurement(row.id).id == row.id and files(store) == {row.sha256}


def test_a_deletion_before_a_hold(store: Store) -> None:
    row = stored(store)
    gone, said, waited = meet(
        store,
        lambda: Removal(store).delete_measurement(row.id, "left"),
        lambda: retention.say(store.database, row.id, None, "claim 7"),
    )
    assert waited and gone.exception() is None and isinstance(said.exception(), DeletedError)
    with pytest.raises(DeletedError, match="left"):
        store.measurement(row.id)
    assert files(store) == set()


@pytest.mark.parametrize("name", ["a.csv", "b.csv"])
def test_an_upload_before_a_deletion_of_the_same_bytes(store: Store, name: str) -> None:
    row = stored(store)
    sent, gone, waited = meet(
        store, lambda: stored(store, CONTENT, name), lambda: Removal(store).delete_measurement(row.id, "")
    )
    assert waited and sent.exception() is None and gone.exception() is None
    there = {each.id for each in store.measurements(None, 9)}
    assert there == ({sent.result().id} if name == "b.csv" else set())  # the same upload again was there already
    assert files(store) == ({row.sha256} if there else set())


@pytest.mark.parametrize("name", ["a.csv", "b.csv"])
@pytest.mark.parametrize("commit", [1, 2])  # of the row; of the file
def test_a_deletion_before_an_upload_of_the_same_bytes(store: Store, name: str, commit: int) -> None:
    row = stored(store)
    gone, sent, waited = meet(
        store,
        lambda: Removal(store).delete_measurement(row.id, ""),
        lambda: stored(store, CONTENT, name),
        commit=commit,
    )
    assert gone.exception() is None and sent.result().sha256 == row.sha256
    assert waited
    assert [each.id for each in store.measurements(None, 9)] == [sent.result().id]
    assert files(store) == {row.sha256}
