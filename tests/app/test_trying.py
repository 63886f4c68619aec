"""Recordings for whoever has none: simulated ones and those that ship, over HTTP and on the page."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from small_service import asking

from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.built_in import content_of, read_truths, recordings_of
from jointplay.solver.machines.machine import shipped_machine, shipped_machine_names

VIRTUAL = "/api/v1/measurements/virtual"
HTML = {"Accept": "text/html"}


@pytest.fixture(scope="module")
def made(client: httpx.Client) -> dict[str, Any]:
    """A virtual recording of the slider-crank, B worn by 150 um."""
    answer = client.post(VIRTUAL, json={"catalogue": "slider-crank", "clearances_um": {"B": 150.0, "A": 0.0}})
    assert answer.status_code == 201, answer.text
    document: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"/api/v1/measurements/{document['id']}"
    return document


def test_a_virtual_recording_is_a_measurement_that_says_so(client: httpx.Client, made: dict[str, Any]) -> None:
    assert made["name"] == "virtual B=150um 600rpm.csv"
    truth = made["virtual"]
    assert truth["clearances_um"] == {"A": 0.0, "B": 150.0, "O": pytest.approx(7.746)}, "what is not named is as new"
    assert (truth["drive_speed_rpm"], truth["sensor_noise_m_s2"], truth["seed"]) == (pytest.approx(600), 0.01, 1)
    assert (made["duration_s"], made["sample_rate_hz"]) == (pytest.approx(2.0), 10_000)
    assert [channel["name"] for channel in made["channels"]] == ["s1-x", "s1-y", "s2-x", "s2-y"]
    assert client.get(f"/api/v1/measurements/{made['id']}").json() == made
    again = client.post(VIRTUAL, json={"catalogue": "slider-crank", "clearances_um": {"B": 150.0, "A": 0.0}})
    assert again.json()["id"] == made["id"]


def test_its_wear_is_found_again(client: httpx.Client, made: dict[str, Any]) -> None:
    asked = {"measurement": made["id"], "catalogue": "slider-crank", "effort": "fast"}
    found = client.post("/api/v1/diagnoses", json=asked).json()
    assert max(found["joint_probabilities"].items(), key=lambda each: each[1])[0] == "B"


def test_speed_noise_length_and_seed_are_those_asked_for(client: httpx.Client) -> None:
    asked = {"catalogue": "slider-crank", "drive_speed_rpm": 610.0, "sensor_noise_m_s2": 0.5, "revolutions": 6}
    one, two = (client.post(VIRTUAL, json={**asked, "seed": seed}).json() for seed in (1, 2))
    assert one["duration_s"] == pytest.approx(6 * 60 / 610, abs=1e-3)
    assert one["name"] == two["name"] == "virtual as-new 610rpm.csv"
    assert one["sha256"] != two["sha256"]


@pytest.mark.parametrize(
    ("change", "status", "said"),
    [
        ({"catalogue": "none"}, 404, "there is none of this id or name"),
        ({"clearances_um": {"Z": 100.0}}, 422, "clearances_um.Z: is no joint that can wear; those are A, B, O"),
        ({"clearances_um": {"B": -1.0}}, 422, "greater than or equal to 0"),
        ({"clearances_um": {"B": 1e6}}, 422, "less than or equal to 10000"),
        ({"drive_speed_rpm": 0.0}, 422, "greater than 0"),
        ({"drive_speed_rpm": 0.01}, 422, "drive_speed_rpm: 0.01: must be 120 to 3000"),
        ({"revolutions": 5}, 422, "greater than or equal to 6"),
        ({"sensor_noise_m_s2": "loud"}, 422, "valid number"),
        ({"asset": "press-7"}, 422, "Extra inputs are not permitted"),
    ],
)
def test_what_cannot_be_simulated_is_refused(
    client: httpx.Client, change: dict[str, Any], status: int, said: str
) -> None:
    answer = client.post(VIRTUAL, json={"catalogue": "slider-crank", **change})
    assert (answer.status_code, said in answer.json()["detail"]) == (status, True), answer.text


def test_recordings_that_ship_are_those_of_their_machine(client: httpx.Client) -> None:
    machines = {name: shipped_machine(name) for name in shipped_machine_names()}
    assert recordings_of(machines["quick-return"]) == list(read_truths()) == [f"quick-return-0{n}" for n in (1, 3, 5)]
    assert not any(recordings_of(machine) for name, machine in machines.items() if name != "quick-return")
    answer = client.post("/api/v1/measurements/built-in", json={"name": "quick-return-03"})
    assert answer.status_code == 201
    found = answer.json()
    assert (found["name"], found["size_bytes"]) == ("quick-return-03.csv.gz", len(content_of("quick-return-03")))
    assert found["virtual"] is None
    assert client.post("/api/v1/measurements/built-in", json={"name": "quick-return-02"}).status_code == 422


def test_the_page_asks_for_one_and_shows_what_it_is(client: httpx.Client) -> None:
    page = client.get("/try", headers=HTML).text
    assert [html.unescape(name) for name in re.findall(r'name="wear-([^"]+)"', page)] == ["A", "B", "O"]
    assert "Recordings that ship" not in page, "they are of another machine"
    sent = {"catalogue": "slider-crank", "wear-B": "0,15 mm", "speed": "600", "noise": "0,01", "revolutions": "20"}
    answer = client.post("/try", data=sent, headers=HTML)
    assert answer.status_code == 303
    shown = client.get(answer.headers["location"], headers=HTML).text
    assert "simulated, not measured: A 7.7 µm, B 150 µm, O 7.7 µm; 600 rpm; noise 0.01 m/s²" in shown


@pytest.mark.parametrize(
    ("change", "field", "said"),
    [
        ({"catalogue": ""}, "catalogue", "choose a catalogue"),
        ({"wear-B": "much"}, "wear", "wear of B: much: "),
        ({"wear-B": "3 rpm"}, "wear", "wear of B: 3 rpm: "),
        ({"wear-B": "20 mm"}, "wear", "less than or equal to 10000"),
        ({"wear-Z": "20"}, "wear", "is no joint that can wear"),
        ({"speed": "-3"}, "speed", "greater than 0"),
        ({"noise": "-1"}, "noise", "greater than or equal to 0"),
        ({"revolutions": "2"}, "revolutions", "greater than or equal to 6"),
        ({"revolutions": "many"}, "revolutions", "must be a whole number"),
    ],
)
def test_the_page_tells_a_refusal_beside_its_field(
    client: httpx.Client, change: dict[str, str], field: str, said: str
) -> None:
    answer = client.post("/try", data={"catalogue": "slider-crank", **change}, headers=HTML)
    assert answer.status_code == 422
    slot = re.search(rf'id="error-{field}">([^<]*)<', answer.text)
    assert slot is not None and said in html.unescape(slot[1]), answer.text
    for name, value in change.items():
        assert not value or f'value="{value}"' in answer.text, f"{name} stays"


def test_an_empty_installation_leads_through(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "c", data=tmp_path / "d", workers=1, builds=0)
    with asking(settings, headers=HTML) as client:
        page = client.get("/").text
        assert 'href="/machines/new"' in page and 'href="/builds"' in page and "<form" not in page
        assert "build one first" in client.get("/try").text
        client.post("/builds", data={"machine": "slider-crank", "plan": "quick", "catalogue": "mine"})
        assert re.search(r'<a href="/builds/[0-9a-f]{32}">mine</a>: waiting', client.get("/").text)
        refused = client.post("/recordings", files={"file": ("a.csv", b"1")})
        assert refused.status_code == 422 and "choose a catalogue" in refused.text
