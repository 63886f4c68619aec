"""Measurements as JSON: the same as a file of them, with every refusal naming its member."""

from __future__ import annotations

import json
import math
from typing import Any

import httpx
import pytest

from jointplay.app.http.middleware import RECORDING_BYTES
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.measurements.measurement import Recording, read_measurement

API = "/api/v1"
PLAIN = [math.sin(0.3 * k) for k in range(300)]


def body(**more: Any) -> dict[str, Any]:
    return {"sample_rate_hz": 1000, "channels": [{"name": "s1-x", "unit": "g", "values": PLAIN}], **more}


def channel(**more: Any) -> dict[str, Any]:
    return {"name": "s1-x", "unit": "g", "values": PLAIN, **more}


def send(client: httpx.Client, sent: dict[str, Any]) -> httpx.Response:
    return client.post(f"{API}/measurements", json=sent)


@pytest.fixture(scope="module")
def recording(worn: bytes) -> Recording:
    return read_measurement(worn, name="worn.csv")


def whole(recording: Recording) -> dict[str, Any]:
    channels = [
        {"name": name, "unit": "m/s2", "values": recording.signal[:, place].tolist()}
        for place, name in enumerate(recording.channel_names)
    ]
    return {"name": "press 7", "sample_rate_hz": recording.sample_rate, "channels": channels}


def test_a_recording_as_json_is_diagnosed_as_its_file_is(
    client: httpx.Client, recording: Recording, worn: bytes
) -> None:
    response = send(client, whole(recording))
    assert response.status_code == 201, response.text
    found = response.json()
    assert response.headers["location"] == f"{API}/measurements/{found['id']}"
    assert (found["name"], found["kind"], found["samples"]) == ("press 7.json", "recording", len(recording.signal))
    again = send(client, dict(reversed(whole(recording).items())))
    assert again.json()["id"] == found["id"]
    asked = {"catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm"}
    ours = client.post(f"{API}/diagnoses", json={**asked, "measurement": found["id"]}).json()
    files = {"file": ("worn.csv", worn)}
    theirs = client.post(f"{API}/diagnoses", files=files, data=asked).json()
    # The same numbers, to the last bit.
    assert ours["hypotheses"] == theirs["hypotheses"]


def test_a_spectrum_as_json(client: httpx.Client) -> None:
    lines = [0.5 * k for k in range(300)]
    plain = {"frequency_hz": lines, "channels": [channel(values=[abs(value) for value in PLAIN])]}
    refused = send(client, plain)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "scaling"
    told = {"spectrum": {"scaling": "amplitude", "detector": "peak", "window": "hann"}}
    found = send(client, {**plain, "profile": told}).json()
    assert found["kind"] == "spectrum"
    assert found["told"] == {"profile": told}
    assert found["spectrum"] == {"lines": 300, "resolution_hz": 0.5, "lowest_hz": 0, "highest_hz": 149.5}


def test_times_and_a_tacho_as_json(client: httpx.Client) -> None:
    pulses = channel(name="key", unit="V", values=[float(k % 50 < 5) for k in range(300)])
    sent = {"time_s": [0.001 * k for k in range(300)], "channels": [channel(), pulses]}
    found = send(client, {**sent, "profile": {"tacho": {"column": "key"}}}).json()
    assert found["sample_rate_hz"] == pytest.approx(1000)
    assert [each["name"] for each in found["channels"]] == ["s1-x"]
    assert found["revolutions"] == 4


def test_a_measurement_as_json_may_be_of_an_asset(client: httpx.Client) -> None:
    assert client.put(f"{API}/assets/sent-1", json={"machine": "slider-crank"}).status_code == 201
    found = send(client, body(asset="sent-1")).json()
    listed = client.get(f"{API}/measurements", params={"asset": "sent-1"}).json()["items"]
    assert [each["id"] for each in listed] == [found["id"]]
    for unknown in ("nobody", "a\0b", "../etc"):
        response = send(client, body(asset=unknown))
        assert response.status_code == 404
        assert response.json()["errors"][0]["field"] == "asset"


@pytest.mark.parametrize(
    ("sent", "field"),
    [
        ({"channels": []}, "channels"),
        (body(channels=[{"name": "a"}]), "channels.0.values"),
        (body(channels=[channel(values=[*PLAIN, "1"])]), "channels.0.values.300"),
        (body(channels=[channel(values=[True] * 300)]), "channels.0.values.0"),
        (body(channels=[channel(name="")]), "channels.0.name"),
        (body(channels=[channel(unit=3)]), "channels.0.unit"),
        (body(channels=[channel(unit=None)]), "units"),
        (body(sample_rate_hz=None), "sample_rate"),
        (body(sample_rate_hz=0), "sample_rate_hz"),
        (body(colour="red"), "colour"),
        (body(profile={"tacho": {}}), "profile.tacho.column"),
        (body(profile={"tacho": {"column": "key"}}), "tacho"),
        (body(profile={"full_scale": "5 g"}), "full_scale"),
        (body(name=""), "name"),
    ],
)
def test_refusals_name_the_member(client: httpx.Client, sent: dict[str, Any], field: str) -> None:
    response = send(client, sent)
    assert response.status_code == 422, response.text
    document = response.json()
    assert [each["field"] for each in document["errors"]] == [field]
    assert "\n" not in document["detail"]


@pytest.mark.parametrize(
    ("content", "status", "text"),
    [
        (b"{", 400, "is not JSON"),
        (b'{"channels": [{"name": "a", "values": [NaN]}]}', 422, "finite number"),
        (b"[]", 422, ""),
        (json.dumps(body(channels=[channel(name="a\0")])).encode(), 422, "no text"),
        (json.dumps(body(channels=[channel(name="\ud800")])).encode(), 400, "is not JSON"),
        (json.dumps(body(channels=[channel(), channel()])).encode(), 422, "two channels have the same name"),
        (json.dumps(body(channels=[channel(), channel(name="b", values=[1, 2])])).encode(), 422, "different length"),
        (json.dumps(body(channels=[channel(values=[1, 2])])).encode(), 422, "at least 256"),
        (json.dumps(body(channels=[channel(values=["x"] * 200_000)])).encode(), 422, "channels.0.values.0"),
    ],
)
def test_bodies_that_are_no_measurement(client: httpx.Client, content: bytes, status: int, text: str) -> None:
    headers = {"Content-Type": "application/json"}
    response = client.post(f"{API}/measurements", content=content, headers=headers)
    assert response.status_code == status
    assert text in response.json()["detail"]
    assert len(response.content) < 2000


def test_a_body_over_the_limit(client: httpx.Client, settings: ServiceSettings) -> None:
    assert settings.max_upload_bytes < RECORDING_BYTES
    headers = {"Content-Type": "application/json"}
    response = client.post(f"{API}/measurements", content=b" " * (settings.max_upload_bytes + 1), headers=headers)
    assert response.status_code == 413


def test_a_refused_measurement_leaves_no_file(client: httpx.Client, settings: ServiceSettings) -> None:
    def held() -> set[str]:
        return {path.name for path in (settings.data / "measurements").rglob("*") if path.is_file()}

    before = held()
    assert send(client, body(channels=[channel(values=[*PLAIN[:-1], 1e300])])).status_code == 422
    assert held() == before
