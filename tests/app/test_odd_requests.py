"""Requests that are almost right: names that nobody reads, nothing in the body, a slash too many, other methods."""

from __future__ import annotations

import httpx
import pytest


@pytest.mark.parametrize(
    ("place", "field", "rule"),
    [
        ("measurements?assset=press-7", "query.assset", "the parameters are asset, cursor, limit"),
        ("machines/four-bar?x=1", "query.x", "it has none"),
        ("machines?limit=1&limit=2", "query.limit", "is given twice"),
        ("catalogues/slider-crank/entries?limit=1&worn=A", "query.worn", "stratum"),
    ],
)
def test_what_nobody_reads_in_a_query_is_refused(client: httpx.Client, place: str, field: str, rule: str) -> None:
    answer = client.get(f"/api/v1/{place}")
    assert answer.status_code == 422, answer.text
    assert rule in answer.json()["detail"]
    assert [entry["field"] for entry in answer.json()["errors"]] == [field]


def test_an_empty_body_is_named(client: httpx.Client) -> None:
    answer = client.post("/api/v1/webhooks", content=b"", headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["detail"]) == (422, "body: Field required")


def test_no_address_is_redirected_to_another(client: httpx.Client) -> None:
    answer = client.get("/api/v1/machines/")
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")


def test_only_where_files_are_taken_may_a_form_be_as_large_as_one(client: httpx.Client) -> None:
    form = {"file": ("a.csv", b" " * 1_100_000)}
    answers = {place: client.post(f"/api/v1/{place}", files=form) for place in ("webhooks", "builds", "measurements")}
    statuses = {place: answer.status_code for place, answer in answers.items()}
    assert statuses == {"webhooks": 413, "builds": 415, "measurements": 422}


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PATCH", "/api/v1/machines/four-bar", "GET, PUT, DELETE"),
        ("PATCH", "/api/v1/diagnoses", "GET, POST"),
        ("POST", "/healthz", "GET"),
        ("POST", "/static/page.css", "GET, HEAD"),
    ],
)
def test_a_method_that_is_not_known_is_told_the_others(
    client: httpx.Client, method: str, path: str, allowed: str
) -> None:
    answer = client.request(method, path)
    assert (answer.status_code, answer.headers["allow"]) == (405, allowed)
    assert answer.headers["content-type"] == "application/problem+json"
