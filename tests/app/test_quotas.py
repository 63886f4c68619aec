"""How much may be kept, and how full a disk is."""

from __future__ import annotations

from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from life_cycle import CONTENT, aged, diagnosed, files, found, stored

from jointplay.app.actor import Actor, acting
from jointplay.app.errors import (
    QuotaError,
)
from jointplay.app.storage.removal import Removal
from jointplay.app.storage.retention import Quotas
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import Store
from jointplay.app.storage.usage import days_to_fill, measure


def test_a_quota_says_what_is_used_and_allowed(url: str, tmp_path: Path) -> None:
    size = len(CONTENT) + 1
    with closing(Store(tmp_path, url, Quotas(3 * size, 2 * size))) as store:
        check_quotas(store)


def check_quotas(store: Store) -> None:
    with acting(Actor(key="k1")):
        one, _ = (stored(store, CONTENT + bytes([65 + k])) for k in range(2))
        with pytest.raises(QuotaError, match=r"2.4e-05 MB of 2.4e-05 MB are used by key k1; this has 1.2e-05 MB"):
            stored(store, CONTENT + b"C")
        assert stored(store, CONTENT + b"A").id == one.id  # what is there already is no more
    assert len(files(store)) == 2  # neither row nor file of what was refused
    with acting(Actor(key="k2")):
        stored(store, CONTENT + b"D")
        with pytest.raises(QuotaError, match="are used by all together"):
            stored(store, CONTENT + b"E")
    Removal(store).delete_measurement(one.id, "")
    with acting(Actor(key="k1")):
        stored(store, CONTENT + b"C")


def test_a_quota_of_a_person_who_signed_in_at_a_proxy(url: str, tmp_path: Path) -> None:
    with closing(Store(tmp_path, url, Quotas(None, 2 * len(CONTENT) + 2))) as store:
        for who, letters in (("ann", b"AB"), ("x" * 300, b"CD"), ("x" * 299, b"")):
            with acting(Actor(person=who, address="192.0.2.7")):
                for letter in letters:
                    stored(store, CONTENT + bytes([letter]))
                with pytest.raises(QuotaError, match=f"are used by {who[:256]};"):
                    stored(store, CONTENT + b"E")
        with acting(Actor(address="192.0.2.7")):  # without keys nobody is known who could be held to it
            stored(store, CONTENT + b"E")


def test_when_a_disk_is_full() -> None:
    assert days_to_fill(100.0, []) == float("inf")
    assert days_to_fill(100.0, [(10.0, float("inf"))]) == 10.0
    assert days_to_fill(100.0, [(10.0, 50.0)]) == float("inf")  # as much goes as comes before it is full
    assert days_to_fill(100.0, [(10.0, 50.0), (5.0, float("inf"))]) == 10.0  # 50 and 25 in 5 days, then 5 a day
    assert days_to_fill(0.0, [(1.0, float("inf"))]) == 0.0


def test_what_is_stored_is_measured(store: Store) -> None:
    rows = [stored(store, CONTENT + bytes(1000 * k)) for k in range(3)]
    found(store, diagnosed(store, rows[2]))
    aged(store, rows[0], days=30.0)
    usage = measure(store)
    routine, evidence = usage.classes["routine"], usage.classes["evidence"]
    assert (routine.count, evidence.count, usage.classes["baseline"].count) == (2, 1, 0)
    assert routine.size_bytes == rows[0].size_bytes + rows[1].size_bytes
    assert routine.per_day == pytest.approx(rows[1].size_bytes / 7)  # of a week; the first came before
    assert evidence.per_day == pytest.approx(rows[2].size_bytes)  # of the day since which it is there
    assert routine.oldest is not None and now() - routine.oldest > timedelta(days=29)
    assert usage.database_bytes > 10_000
    daily = routine.per_day + evidence.per_day + usage.database_per_day
    assert usage.days_until_full({}) == pytest.approx(usage.free_bytes / daily)
    Removal(store).delete_measurement(rows[1].id, "")
    assert measure(store).classes["routine"].count == 1
