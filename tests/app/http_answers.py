"""What tests of the HTTP interface ask and hold of its answers."""

from __future__ import annotations

import time
from datetime import datetime, timedelta
from typing import Any

import httpx
import pytest

from jointplay.app.logs import MEMBERS

API = "/api/v1"
PROBLEM = {"type", "title", "status", "detail", "instance"}


def assert_problem(response: httpx.Response, status: int, text: str = "", slug: str = "") -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert set(document) - {"errors"} == PROBLEM
    assert document["status"] == status
    assert document["instance"] == response.request.url.path
    assert "\n" not in document["detail"]
    assert text in document["detail"], document["detail"]
    if slug:
        assert document["type"] == f"urn:jointplay:problem:{slug}"
    return document


def send(client: httpx.Client, content: bytes, name: str = "recording.csv", **fields: str) -> httpx.Response:
    return client.post(f"{API}/measurements", files={"file": (name, content)}, data=fields)


def assert_time(text: str) -> None:
    moment = datetime.fromisoformat(text)
    assert moment.utcoffset() == timedelta(0)


def line_of(caplog: pytest.LogCaptureFixture, path: str) -> dict[str, Any]:
    """The line of a request, which is written when its answer is over."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        for each in caplog.records:
            if (members := getattr(each, MEMBERS, {})).get("path") == path:
                return dict(members)
        time.sleep(0.02)
    raise AssertionError(f"no line of {path}")
