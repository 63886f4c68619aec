"""Entries over HTTP: pages, filters, the four forms, entity tags."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from small_service import asking
from starlette.requests import Request

import jointplay.catalogue.storage.store
from jointplay.app.errors import NotAcceptableError
from jointplay.app.http.query import chosen_type
from jointplay.app.schemas.entries import EntryFilter
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.entries import EntryShelf, fits
from jointplay.catalogue.storage.hdf5 import read_arrays
from jointplay.catalogue.storage.store import Catalogue

ENTRIES = "/api/v1/catalogues/slider-crank/entries"
HDF5, NPY, CSV = "application/x-hdf5", "application/x-npy", "text/csv"


@pytest.fixture(scope="module")
def stored(shelf: Path) -> Catalogue:
    return Catalogue.open(shelf / "slider-crank")


@pytest.fixture(scope="module")
def key(stored: Catalogue) -> str:
    return str(stored.entries.key[np.flatnonzero(stored.entries.hypothesis == "B")[3]])


def walked(client: httpx.Client, **query: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    while True:
        page = client.get(ENTRIES, params=query).json()
        found += page["items"]
        if page["next_cursor"] is None:
            return found
        assert len(page["items"]) == query["limit"]
        query["cursor"] = page["next_cursor"]


def test_pages_hold_every_entry_once_and_in_order(client: httpx.Client, stored: Catalogue) -> None:
    assert [item["key"] for item in walked(client, limit=100)] == stored.entries.key.tolist()
    exactly = walked(client, limit=36, hypothesis="healthy")  # as many as there are: no empty page behind
    assert len(exactly) == 36


def test_filters(client: httpx.Client, stored: Catalogue) -> None:
    table = stored.entries
    of_b = walked(client, limit=50, joint="B")
    assert [item["key"] for item in of_b] == table.key[table.worn[:, table.joints.index("B")]].tolist()
    assert all(item["worn"] == ["B"] for item in of_b)
    sizes = sorted(item["clearances_um"]["B"] for item in of_b)
    some = walked(client, limit=50, joint="B", min_clearance_um=sizes[10], max_clearance_um=sizes[20])
    assert sorted(item["clearances_um"]["B"] for item in some) == sizes[10:21]
    assert {item["hypothesis"] for item in walked(client, limit=200, min_clearance_um=21)} == {"A", "B", "O"}
    in_order = walked(client, limit=200, max_clearance_um=20)
    assert {item["hypothesis"] for item in in_order} == {"healthy"}
    # Those of silent machines are ideal where they are not worn.
    assert {"".join(sorted(item["clearances_um"])) for item in in_order} == {"ABO", ""}
    assert all(item["worn"] == [] for item in in_order)
    assert walked(client, limit=10, hypothesis="A", joint="B") == []
    assert walked(client, limit=10, status="jammed") == []
    assert len(walked(client, limit=200, status="ok", law="own", stratum="trusted")) == len(table)
    assert walked(client, limit=10, stratum="wide") == walked(client, limit=10, law="hertz") == []


def test_filters_choose_a_part_of_mixed_entries(stored: Catalogue) -> None:
    table = stored.entries
    odd = np.arange(len(table)) % 2 == 1
    mixed = replace(
        table,
        stratum=np.where(odd, "wide", "trusted"),
        status=np.where(odd, "jammed", "ok"),
        law=np.where(odd, "hertz", "own"),
    )
    for name, value in (("stratum", "wide"), ("status", "jammed"), ("law", "hertz")):
        assert np.array_equal(fits(mixed, EntryFilter.model_validate({name: value})), odd)


@pytest.mark.parametrize(
    ("query", "status", "text"),
    [
        ({"joint": "Z"}, 422, "joint: Z: must be one of A, B, O"),
        ({"hypothesis": "nought"}, 422, "hypothesis: nought: must be one of healthy, A, B, O"),
        ({"min_clearance_um": 3, "max_clearance_um": 2}, 422, "min_clearance_um: 3: must not be above"),
        ({"min_clearance_um": "nan"}, 422, "min_clearance_um"),
        ({"law": "square"}, 422, "law"),
        ({"hypotesis": "A"}, 422, "hypotesis"),
        ({"limit": 0}, 422, "limit"),
        ({"cursor": "AAAA"}, 400, "cursor"),
        ({"cursor": "!"}, 400, "cursor"),
    ],
)
def test_what_cannot_be_asked(client: httpx.Client, query: dict[str, Any], status: int, text: str) -> None:
    answer = client.get(ENTRIES, params=query)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert text in answer.json()["detail"]


def test_the_forms_hold_the_same_numbers(client: httpx.Client, stored: Catalogue, key: str, tmp_path: Path) -> None:
    entry = stored.entry(key)
    assert entry.power is not None and entry.spread_db is not None
    whole = client.get(f"{ENTRIES}/{key}").json()
    assert whole["clearances_um"]["B"] == pytest.approx(entry.clearances["B"] * 1e6, abs=1e-6)
    assert whole["parameters"] == entry.parameters
    shown = whole["spectrum"]
    assert shown["band_edges_orders"] == list(entry.scheme.edges)
    assert np.array_equal(np.float32(shown["power"]["theta"]), entry.power[:, 2, 2].real)
    assert np.array_equal(np.float32(shown["cross_power"]["x theta"]["im"]), entry.power[:, 0, 2].imag)
    assert np.array_equal(np.float32(shown["spread_db"]["y"]), entry.spread_db[:, 1])

    table = np.load(io.BytesIO(client.get(f"{ENTRIES}/{key}", headers={"Accept": NPY}).content), allow_pickle=False)
    assert np.array_equal(table["power"], entry.power)
    assert np.array_equal(table["spread_db"], entry.spread_db)
    assert table["order_high"].tolist() == list(entry.scheme.edges[1:])

    answer = client.get(f"{ENTRIES}/{key}", headers={"Accept": CSV})
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert np.array_equal(np.float32([row["power x [(m/s2)^2]"] for row in rows]), entry.power[:, 0, 0].real)
    assert np.array_equal(np.float32([row["im y theta [(m/s2)(rad/s2)]"] for row in rows]), entry.power[:, 1, 2].imag)
    hertz = entry.drive_speed / (2 * np.pi)
    assert float(rows[0]["frequency high [Hz]"]) == pytest.approx(entry.scheme.edges[1] * hertz)

    file = tmp_path / "entry.h5"
    file.write_bytes(client.get(f"{ENTRIES}/{key}", headers={"Accept": HDF5}).content)
    arrays, attributes = read_arrays(file)
    assert np.array_equal(arrays["power"], entry.power)
    assert (attributes["key"], attributes["hypothesis"]) == (key, "B")


def test_levels_as_another_quantity_and_scaling(client: httpx.Client, stored: Catalogue, key: str) -> None:
    entry = stored.entry(key)
    assert entry.power is not None
    power = entry.power[:, 1, 1].real
    rate = entry.scheme.centres * entry.drive_speed
    width = np.diff(entry.scheme.edges) * entry.drive_speed / (2 * np.pi)
    for query, expected, unit in (
        ({}, power, "(m/s2)^2"),
        ({"scaling": "rms"}, np.sqrt(power), "m/s2 rms"),
        ({"scaling": "psd"}, power / width, "(m/s2)^2/Hz"),
        ({"quantity": "velocity"}, power / rate**2, "(m/s)^2"),
        ({"quantity": "displacement", "scaling": "peak"}, np.sqrt(2 * power) / rate**2, "m peak"),
    ):
        answer = client.get(f"{ENTRIES}/{key}/levels", params=query)
        shown = answer.json()
        assert shown["levels"]["y"] == pytest.approx(expected, rel=1e-6)  # single precision
        assert (shown["units"]["y"], shown["key"]) == (unit, key)
        assert shown["band_edges_orders"] == list(entry.scheme.edges)
        held = client.get(
            f"{ENTRIES}/{key}/levels", params=query, headers={"If-None-Match": answer.headers["etag"]}
        )  # fmt: skip
        assert held.status_code == 304
    for wrong in ({"quantity": "jerk"}, {"scaling": "loud"}, {"scale": "rms"}):
        assert client.get(f"{ENTRIES}/{key}/levels", params=wrong).status_code == 422
    assert client.get(f"{ENTRIES}/{'0' * 64}/levels").status_code == 404


def test_a_shortened_key_will_do(client: httpx.Client, key: str) -> None:
    assert client.get(f"{ENTRIES}/{key[:12]}").json()["key"] == key
    for unknown in (key[:7], key[:-1] + "g", "0" * 64):
        answer = client.get(f"{ENTRIES}/{unknown}")
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:jointplay:problem:unknown-entry")


def test_no_form_that_the_client_takes(client: httpx.Client, key: str) -> None:
    answer = client.get(f"{ENTRIES}/{key}", headers={"Accept": "image/png"})
    assert (answer.status_code, answer.json()["type"]) == (406, "urn:jointplay:problem:not-acceptable")


@pytest.mark.parametrize(
    ("header", "chosen"),
    [
        (None, "a/json"),
        ("*/*", "a/json"),
        ("b/*;q=0.5, a/json;q=0.4", "b/csv"),
        ("a/json;q=0, */*;q=0.1", "b/csv"),
        ("B/CSV", "b/csv"),
        ("nonsense, b/csv;q=nought, a/json;q=0.3", "a/json"),
    ],
)
def test_negotiation(header: str | None, chosen: str) -> None:
    headers = [] if header is None else [(b"accept", header.encode())]
    assert chosen_type(Request({"type": "http", "headers": headers}), ["a/json", "b/csv"]) == chosen


@pytest.mark.parametrize("header", ["c/d", "a/json;q=0", "nonsense", "b/csv;q=2"])
def test_negotiation_without_an_end(header: str) -> None:
    with pytest.raises(NotAcceptableError):
        chosen_type(Request({"type": "http", "headers": [(b"accept", header.encode())]}), ["a/json", "b/csv"])


def test_entity_tags_need_no_shard(
    client: httpx.Client, settings: ServiceSettings, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    forms = {kind: client.get(f"{ENTRIES}/{key}", headers={"Accept": kind}) for kind in ("*/*", CSV, HDF5, NPY)}
    tags = {answer.headers["etag"] for answer in forms.values()}
    assert len(tags) == 4 and not any(tag.startswith("W/") for tag in tags)
    assert {answer.headers["vary"] for answer in forms.values()} == {"Accept"}

    def refused(*_: object) -> None:
        raise AssertionError("a shard was read")

    with asking(settings) as other:  # it has nothing in memory
        again = {kind: other.get(f"{ENTRIES}/{key}", headers={"Accept": kind}) for kind in forms}
        assert [answer.content for answer in again.values()] == [answer.content for answer in forms.values()]
        assert {answer.headers["etag"] for answer in again.values()} == tags
    with asking(settings) as other:
        monkeypatch.setattr(jointplay.catalogue.storage.store, "decode_shard", refused)
        for kind, answer in forms.items():
            headers = {"Accept": kind, "If-None-Match": answer.headers["etag"]}
            held = other.get(f"{ENTRIES}/{key}", headers=headers)
            assert (held.status_code, held.content) == (304, b"")
            assert held.headers["etag"] == answer.headers["etag"]
        assert other.get(f"{ENTRIES}/{key}").status_code == 500  # what is not held must be read


def test_bodies_in_memory_are_bounded(
    settings: ServiceSettings, stored: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    from jointplay.app.shelves.catalogues import CatalogueShelf

    monkeypatch.setattr("jointplay.app.shelves.entries.KEPT_BYTES", 100_000)
    entries, offer = EntryShelf(), CatalogueShelf(settings.catalogues).find("slider-crank")
    keys = stored.entries.key.tolist()[:8]
    bodies = [entries.whole(offer, key, NPY).body for key in keys]
    kept = [entries.recall(offer, key, NPY) for key in keys]
    held = [each.body for each in kept if each is not None and each.body is not None]
    assert 0 < sum(map(len, held)) <= 100_000
    assert held == bodies[-len(held) :]  # the last ones asked for
    assert entries.whole(offer, keys[0], NPY).body == bodies[0]
