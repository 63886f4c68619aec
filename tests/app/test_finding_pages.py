"""The page on which findings and repairs are entered."""

from __future__ import annotations

import html
import re
from typing import Any

import httpx
import pytest
from http_answers import API
from test_wear_state import diagnose

from jointplay.app.reports.content import FORM_COLUMNS
from jointplay.app.schemas.assets import FindingIn


@pytest.fixture(scope="module")
def answer(client: httpx.Client) -> dict[str, Any]:
    client.put(f"{API}/assets/found-1", json={"machine": "slider-crank"}).raise_for_status()
    return diagnose(client, 2, "found-1")


def findings(client: httpx.Client, answer: dict[str, Any]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = client.get(f"{API}/findings", params={"diagnosis": answer["id"]}).json()["items"]
    return found


def test_what_was_found_and_repaired_is_entered(client: httpx.Client, answer: dict[str, Any]) -> None:
    place = f"/diagnoses/{answer['id']}/finding"
    assert f'href="{place}"' in client.get("/assets/found-1").text
    assert f'href="{place}"' in client.get(f"/diagnoses/{answer['id']}").text
    page = client.get(place).text
    assert "What was found at found-1" in page and 'name="play-O"' in page
    assert FORM_COLUMNS[2].removesuffix(", µm") in page, "the sheet asks for the same"
    form = {"play-B": "0,305 mm", "repaired-B": "yes", "play-A": "24 µm", "play-O": "18,5", "text": "pin <new>"}
    offered = re.findall(r'name="at" type="datetime-local"[^>]* data-moment="([^"]+)"', page)[0]
    assert FindingIn.model_validate({"text": "x", "at": offered})
    for _ in range(2):  # sent twice
        kept = client.post(place, data={**form, "at": "2026-11-21T10:30:00+01:00"})
        assert (kept.status_code, kept.headers["location"]) == (303, "/assets/found-1")
    (found,) = findings(client, answer)
    assert (found["at"], found["text"], found["asset"]) == ("2026-11-21T09:30:00Z", "pin <new>", "found-1")
    assert found["joints"] == {
        "A": {"clearance_um": 12.0, "repaired": False},
        "B": {"clearance_um": 152.5, "repaired": True},
        "O": {"clearance_um": 9.25, "repaired": False},
    }
    shown = client.get("/assets/found-1").text
    assert "A 12 µm" in shown and "B 152 µm, repaired" in shown and "pin &lt;new&gt;" in shown


def test_a_repair_may_be_told_alone(client: httpx.Client, answer: dict[str, Any]) -> None:
    form = {"repaired-O": "yes", "play-A": "24", "at": "2026-11-23T10:30:00Z"}
    assert client.post(f"/diagnoses/{answer['id']}/finding", data=form).status_code == 303
    assert findings(client, answer)[0]["joints"] == {
        "A": {"clearance_um": 12.0, "repaired": False},
        "O": {"clearance_um": None, "repaired": True},
    }
    assert "A 12 µm; O repaired" in client.get("/assets/found-1").text


@pytest.mark.parametrize(
    ("form", "field", "said"),
    [
        ({"play-B": "much"}, "joints", "joint B: much: must be a length"),
        ({"play-B": "-1"}, "joints", "joint B: -1: must be 0 to 200 mm"),
        ({"play-B": "1e300"}, "joints", "joint B: 1e300: must be 0 to 200 mm"),
        ({"play-B": "nan"}, "joints", "joint B: nan: must be a length"),
        ({"play-B": "20 g"}, "joints", 'joint B: 20 g: "g" is a mass, must be a length'),
        ({"play-B": "1,500"}, "joints", "joint B: 1,500: write 1500 or 1.500"),
        ({"play-Z": "10"}, "joints", "joints: Z: is no joint of this machine that can wear (A, B, O)"),
        ({"text": "loose", "at": "yesterday"}, "at", "at: "),
        ({"text": "a\u0001b"}, "text", "text: "),
        ({}, "", "give joints with their clearance, or a text"),
    ],
)
def test_refusals_are_told_beside_their_field(
    client: httpx.Client, answer: dict[str, Any], form: dict[str, str], field: str, said: str
) -> None:
    before = findings(client, answer)
    typed = {"at": "2026-11-21T10:30:00Z", **form}
    refused = client.post(f"/diagnoses/{answer['id']}/finding", data=typed)
    assert refused.status_code == 422
    text = html.unescape(refused.text)
    place = text.index(f'id="error-{field}"' if field else "</h1>")
    assert said in text[place : place + 900]
    assert f'data-moment="{typed["at"]}"' in text, "what was typed stays"
    assert findings(client, answer) == before


@pytest.mark.parametrize(("typed", "kept"), [("2026-11-21T10:30", "10:30:00Z"), ("2026-11-21T10:31:05", "10:31:05Z")])
def test_a_browser_without_scripts_says_when_in_utc(
    client: httpx.Client, answer: dict[str, Any], typed: str, kept: str
) -> None:
    sent = client.post(f"/diagnoses/{answer['id']}/finding", data={"text": typed, "at": typed})
    assert sent.status_code == 303
    assert [each["at"] for each in findings(client, answer) if each["text"] == typed] == [f"2026-11-21T{kept}"]


def test_of_no_diagnosis_nothing_is_found(client: httpx.Client) -> None:
    for answer in (
        client.get("/diagnoses/nobody/finding"),
        client.post("/diagnoses/nobody/finding", data={"text": "x"}),
    ):
        assert answer.status_code == 404 and "there is none of this id" in answer.text
