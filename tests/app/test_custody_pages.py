"""What is kept, held and deleted by the pages: as the HTTP interface does it, by whoever may."""

from __future__ import annotations

import html
from typing import Any

import httpx
import pytest
from http_answers import API, send
from test_api_keys import guarded  # noqa: F401, a fixture
from test_wear_state import diagnose

from jointplay.app.scopes import Scope, scope_of
from jointplay.app.storage.keys import Keys

SURE = {"sure": "yes", "why": "the customer has left"}


@pytest.fixture(scope="module")
def answer(client: httpx.Client) -> dict[str, Any]:
    client.put(f"{API}/assets/going-1", json={"machine": "slider-crank"}).raise_for_status()
    return diagnose(client, 3, "going-1")


def refused(response: httpx.Response, status: int, field: str, said: str) -> None:
    assert response.status_code == status, response.text
    text = html.unescape(response.text)
    place = text.index(f'id="error-{field}"' if field else "</h1>")
    assert said in text[place : place + 600]


def test_a_hold_is_said_and_lifted(client: httpx.Client, answer: dict[str, Any]) -> None:
    key = answer["measurement"]
    page = client.get(f"/measurements/{key}")
    assert f'href="/measurements/{key}/delete"' in page.text
    place = f"/measurements/{key}/retention"
    said = client.post(place, data={"keep_as": "evidence", "hold": "claim <42>"})
    assert (said.status_code, said.headers["location"]) == (303, f"/measurements/{key}/delete")
    kept = client.get(f"{API}{place}").json()
    assert (kept["keep_as"], kept["said"], kept["hold"]) == ("evidence", True, "claim <42>")
    shown = client.get(said.headers["location"]).text
    assert "claim &lt;42&gt;" in shown and '<option value="evidence" selected>' in shown
    for folder, name in (("measurements", key), ("diagnoses", answer["id"]), ("assets", "going-1")):
        refused(client.post(f"/{folder}/{name}/delete", data=SURE), 409, "", "is on hold (claim <42>)")
    refused(client.post(place, data={"keep_as": "rubbish"}), 422, "keep_as", "keep_as: ")
    assert client.post(place, data={"keep_as": ""}).status_code == 303
    assert client.get(f"{API}{place}").json()["hold"] is None


def test_nothing_goes_unless_somebody_is_sure(client: httpx.Client, answer: dict[str, Any]) -> None:
    for folder, name, said in (
        ("measurements", answer["measurement"], "a recording"),
        ("diagnoses", answer["id"], "a diagnosis"),
        ("assets", "going-1", "an asset"),
    ):
        page = client.get(f"/{folder}/{name}/delete")
        assert page.status_code == 200 and f" {said}</h1>" in page.text
        refused(
            client.post(f"/{folder}/{name}/delete", data={"why": "x"}),
            422,
            "sure",
            f"say that this {said.split()[1]} is to go",
        )
        refused(client.post(f"/{folder}/{name}/delete", data={**SURE, "why": "a\u0001b"}), 422, "why", "why: ")
        assert client.get(f"{API}/{folder}/{name}").status_code == 200


def test_finding_diagnosis_recording_and_asset_go_in_turn(client: httpx.Client, answer: dict[str, Any]) -> None:
    finding = client.post(
        f"{API}/diagnoses/{answer['id']}/finding", json={"text": "loose", "at": "2026-11-21T10:30:00Z"}
    ).json()["id"]
    assert f'href="/findings/{finding}/delete"' in client.get("/assets/going-1").text
    refused(client.post(f"/diagnoses/{answer['id']}/delete", data=SURE), 409, "", "delete that first")
    for folder, name in (
        ("findings", finding),
        ("diagnoses", answer["id"]),
        ("measurements", answer["measurement"]),
        ("assets", "going-1"),
    ):
        gone = client.post(f"/{folder}/{name}/delete", data=SURE)
        assert gone.status_code == 200 and "is gone" in gone.text, gone.text
        document = client.get(f"{API}/{folder}/{name}")
        assert document.status_code == 410 and "the customer has left" in document.text
        again = client.post(f"/{folder}/{name}/delete", data=SURE)
        assert again.status_code == 410 and "This did not work" in again.text
        assert client.get(f"/{folder}/{name}/delete").status_code == 410


def test_who_may_not_is_told(guarded: tuple[str, Keys], worn: bytes) -> None:  # noqa: F811
    address, keys = guarded
    from test_api_keys import make

    sender = {"Authorization": f"Bearer {make(keys, Scope.READ, Scope.MATCH)}"}
    with httpx.Client(base_url=address, timeout=300, headers=sender) as client:
        key = send(client, worn).json()["id"]
        page = client.get(f"/measurements/{key}/delete")
        assert page.status_code == 200 and "scope <code>admin</code>" in page.text and "<form" not in page.text
        for place in (f"/measurements/{key}/delete", f"/measurements/{key}/retention"):
            assert client.post(place, data=SURE).status_code == 403
        assert client.get(f"{API}/measurements/{key}").status_code == 200
    for folder in ("measurements", "diagnoses", "findings", "assets"):
        assert scope_of("POST", f"/{folder}/x/delete") == Scope.ADMIN
