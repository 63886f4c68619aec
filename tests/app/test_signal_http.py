"""What a recording looks like, over HTTP: as arrays in closed form, bounded, and read once."""

from __future__ import annotations

import csv
import io
import math
import os
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from http_answers import send
from recordings import unpacked

from jointplay.app.jobs import samples
from jointplay.app.settings import ServiceSettings
from jointplay.solver.arrays import FloatArray

RATE, SECONDS = 5000, 4
AMPLITUDE, TONE = 2.0, 50.0


def table(names: str, columns: FloatArray) -> bytes:
    rows = [",".join(f"{value:.9g}" for value in row) for row in columns]
    return "\n".join([names, *rows]).encode()


@pytest.fixture(scope="module")
def tone(client: httpx.Client) -> str:
    """Id of a recording of a tone [m/s2], and of the same with a blow in it."""
    time = np.arange(RATE * SECONDS) / RATE
    wave = AMPLITUDE * np.sin(2 * math.pi * TONE * time)
    blow = wave.copy()
    blow[12_345] = 77.0
    response = send(client, table("t [s],a [m/s2],b [m/s2]", np.column_stack([time, wave, blow])), "tone.csv")
    assert response.status_code == 201, response.text
    key: str = response.json()["id"]
    return key


@pytest.fixture(scope="module")
def diagnosis(client: httpx.Client, measurement: dict[str, Any]) -> dict[str, Any]:
    asked = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast"}
    found: dict[str, Any] = client.post("/api/v1/diagnoses", json=asked).json()
    return found


def seen(client: httpx.Client, key: str, **asked: Any) -> dict[str, Any]:
    response = client.get(f"/api/v1/measurements/{key}/signal", params=asked)
    assert response.status_code == 200, response.text
    found: dict[str, Any] = response.json()
    return found


@pytest.mark.parametrize(
    ("unit", "peak"),
    [
        ("m/s2", AMPLITUDE),
        ("g", AMPLITUDE / 9.80665),
        ("mm/s", 1e3 * AMPLITUDE / (2 * math.pi * TONE)),
        ("um", 1e6 * AMPLITUDE / (2 * math.pi * TONE) ** 2),
    ],
)
def test_a_tone_has_its_height_in_every_unit(client: httpx.Client, tone: str, unit: str, peak: float) -> None:
    spectrum = seen(client, tone, view="spectrum", unit=unit, scaling="peak", channel="a")
    (line,) = spectrum["lines"]
    assert spectrum["at"][int(np.argmax(line["values"]))] == TONE
    assert max(line["values"]) == pytest.approx(peak, rel=1e-4)
    assert line["unit"] == f"{unit} peak"
    overall = seen(client, tone, view="overall", unit=unit)["overall"][0]
    assert overall["rms"] == pytest.approx(peak / 2**0.5, rel=0.01)
    assert overall["velocity_rms"] == pytest.approx(1e3 * AMPLITUDE / (2 * math.pi * TONE) / 2**0.5, rel=0.01)


def test_few_points_keep_what_is_highest_and_more_are_there_for_a_part(client: httpx.Client, tone: str) -> None:
    whole = seen(client, tone, points=50)
    lines = {(line["name"], line["kind"]): line["values"] for line in whole["lines"]}
    assert {len(values) for values in lines.values()} == {50}
    assert max(lines["b", "high"]) == 77.0 and max(lines["a", "high"]) == pytest.approx(AMPLITUDE, rel=1e-6)
    at = 12_345 / RATE
    part = seen(client, tone, points=100, **{"from": at - 0.01, "to": at + 0.01})
    assert {line["kind"] for line in part["lines"]} == {"value"}
    assert part["at"][int(np.argmax(part["lines"][1]["values"]))] == pytest.approx(at)
    assert part["ends"] == whole["ends"]


def test_what_was_read_is_kept_and_may_be_lost(client: httpx.Client, tone: str, settings: ServiceSettings) -> None:
    (kept,) = (settings.data / "signals").glob(f"{tone}.npy")  # from the upload on
    first = seen(client, tone)
    kept.unlink()
    assert seen(client, tone) == first
    assert kept.is_file()


def test_the_folder_of_samples_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for age, name in enumerate("abcd"):
        (tmp_path / name).write_bytes(b"0" * 100)
        os.utime(tmp_path / name, (1000 - age, 1000 - age))
    monkeypatch.setattr(samples, "KEPT_BYTES", 250)
    samples.tidy(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_diagnosis_gives_speed_and_frame(
    client: httpx.Client, measurement: dict[str, Any], diagnosis: dict[str, Any]
) -> None:
    asked = {"diagnosis": diagnosis["id"], "axis": "order", "of": "frame", "view": "spectrum"}
    found = seen(client, measurement["id"], **asked)
    assert found["drive_speed_rpm"] == pytest.approx(diagnosis["drive_speed_rpm"])
    assert [line["name"] for line in found["lines"]] == ["x", "y", "theta"]
    assert found["axis"] == "order"
    first = [place for place, at in enumerate(found["at"]) if abs(at - 1) < 0.1]
    level = max(found["lines"][0]["values"][place] for place in first)
    # The evidence of the diagnosis has the level of the first order, too.
    evidence = next(
        each for each in diagnosis["evidence"]["orders"] if abs(each["order"] - 1) < 0.2 and each["channel"] == "x"
    )
    assert 20 * math.log10(level) == pytest.approx(evidence["measured_db"], abs=0.5)


def test_another_recording_is_seen_at_its_own_speed(client: httpx.Client, diagnosis: dict[str, Any]) -> None:
    other = send(client, unpacked("slider-crank-01.csv"), "in-order.csv").json()["id"]
    found = seen(client, other, view="revolution", diagnosis=diagnosis["id"])
    assert found["drive_speed_rpm"] != diagnosis["drive_speed_rpm"]
    assert found["drive_speed_rpm"] == pytest.approx(diagnosis["drive_speed_rpm"], rel=0.02)
    assert len(found["at"]) == 360


def test_forces_in_the_joints_lie_over_the_recording(
    client: httpx.Client, measurement: dict[str, Any], diagnosis: dict[str, Any]
) -> None:
    asked = {"diagnosis": diagnosis["id"]}
    force = seen(client, measurement["id"], view="contact", **asked)
    lines = {line["name"]: np.array(line["values"]) for line in force["lines"]}
    assert set(lines) == {"O", "A", "B", "G1"} and {line["unit"] for line in force["lines"]} == {"N"}
    assert any("B 1" in note for note in force["notes"])
    recorded = seen(client, measurement["id"], view="revolution", **asked)
    assert recorded["at"] == force["at"]
    # The pin flies, and where it lands the recording has its steepest step.
    assert lines["B"].min() < 0.02 * lines["B"].max() < lines["O"].min()
    mean = next(line["values"] for line in recorded["lines"] if line["kind"] == "mean")
    landing, step = (int(np.argmax(np.abs(np.diff(values)))) for values in (lines["B"], mean))
    assert abs((landing - step + 180) % 360 - 180) <= 3
    refused = client.get(f"/api/v1/measurements/{measurement['id']}/signal", params={"view": "contact"})
    assert refused.status_code == 422 and "name one" in refused.json()["detail"]


def test_a_revolution_and_a_spectrogram_as_tables(client: httpx.Client, tone: str) -> None:
    for view, columns in (("revolution", 5), ("spectrogram", None), ("spectrum", 3), ("overall", 5)):
        asked = {"view": view, "speed": "600 rpm"}
        response = client.get(f"/api/v1/measurements/{tone}/signal", params=asked, headers={"Accept": "text/csv"})
        assert response.headers["content-type"].startswith("text/csv")
        rows = list(csv.reader(io.StringIO(response.text)))
        found = seen(client, tone, **asked)
        count = len(found["at"]) if view != "overall" else len(found["overall"])
        assert len(rows) == 1 + count
        assert len(rows[0]) == (columns or 1 + len(found["map"]["rows"]))
        if view == "revolution":
            assert rows[0][:2] == ["angle [deg]", "a mean [m/s2]"]
            mean = [float(row[1]) for row in rows[1:]]
            # Five periods of the tone in a revolution: the phase of its beginning is that of the recording.
            wanted = AMPLITUDE * np.sin(5 * np.radians([float(row[0]) for row in rows[1:]]))
            np.testing.assert_allclose(mean, wanted, atol=0.12 * AMPLITUDE)


def test_the_same_is_not_sent_twice(client: httpx.Client, tone: str) -> None:
    place = f"/api/v1/measurements/{tone}/signal"
    again = client.get(place, headers={"If-None-Match": client.get(place).headers["etag"]})
    assert again.status_code == 304


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"view": "revolution"}, "need the drive speed"),
        ({"of": "frame"}, "name a diagnosis"),
        ({"view": "spectrogram", "channel": "c"}, "channel c: must be one of a, b"),
        ({"from": 3, "to": 2}, "to: 2: must be greater than from, 3"),
        ({"from": 1000}, "no samples"),
        ({"points": 0}, "points"),
        ({"view": "cepstrum"}, "view"),
        ({"zoom": 3}, "zoom"),
    ],
)
def test_what_cannot_be_shown_is_refused(client: httpx.Client, tone: str, asked: dict[str, Any], text: str) -> None:
    response = client.get(f"/api/v1/measurements/{tone}/signal", params=asked)
    assert response.status_code == 422
    assert text in response.json()["detail"]


def test_a_spectrum_has_no_samples(client: httpx.Client) -> None:
    content = unpacked("four-bar-02-spectrum.csv")
    sent = send(client, content, "spectrum.csv", scaling="psd", detector="rms")
    assert sent.status_code == 201, sent.text
    response = client.get(f"/api/v1/measurements/{sent.json()['id']}/signal")
    assert response.status_code == 422 and "is a spectrum" in response.json()["detail"]
    page = client.get(f"/measurements/{sent.json()['id']}")
    assert page.status_code == 200 and 'data-signal="spectrum"' in page.text
    assert 'data-signal="waveform"' not in page.text and "motion of the frame" not in page.text


def test_a_spectrum_is_shown_as_it_was_sent(client: httpx.Client) -> None:
    lines = np.arange(1.0, 401.0)
    levels = np.where(lines == 50, 2.0, 0.01)
    rows = table("f [Hz],a [g peak],b [mm/s rms]", np.column_stack([lines, levels, levels]))
    key = send(client, rows, "route.csv", window="hann").json()["id"]
    peak = seen(client, key, view="spectrum", unit="g", scaling="peak", points=1000)
    assert (peak["axis"], peak["sample_rate_hz"], peak["resolution"]) == ("frequency", None, pytest.approx(1.0))
    np.testing.assert_allclose(peak["lines"][0]["values"], levels, rtol=1e-5)
    rms = seen(client, key, view="spectrum", unit="mm/s", points=1000)
    np.testing.assert_allclose(rms["lines"][1]["values"], levels, rtol=1e-5)
    assert rms["lines"][0]["values"][49] == pytest.approx(2.0 / 2**0.5 * 9806.65 / (2 * math.pi * 50), rel=1e-5)
    orders = seen(client, key, view="spectrum", axis="order", speed="600 rpm", channel="b", **{"from": 4, "to": 6})
    assert [line["name"] for line in orders["lines"]] == ["b"]
    assert orders["at"][int(np.argmax(orders["lines"][0]["values"]))] == pytest.approx(5.0)
    for asked, field in (({"axis": "order"}, "speed"), ({"channel": "c"}, "channel"), ({"view": "overall"}, "view")):
        response = client.get(f"/api/v1/measurements/{key}/signal", params={"view": "spectrum", **asked})
        assert response.status_code == 422 and response.json()["errors"][0]["field"] == field


def test_machines_of_the_catalogue_are_laid_over_a_spectrum(
    client: httpx.Client, measurement: dict[str, Any], diagnosis: dict[str, Any]
) -> None:
    asked = {"diagnosis": diagnosis["id"], "axis": "order"}
    laid = seen(client, measurement["id"], view="matched", of="frame", channel="y", **asked)
    lines = {line["kind"]: np.array(line["values"]) for line in laid["lines"]}
    assert set(lines) >= {"first", "second"} and laid["at"][:3] == [1.0, 2.0, 3.0]
    assert f"first: {diagnosis['hypotheses'][0]['label']}" in laid["notes"]
    # The levels of the answer itself: of a band of several orders each has its share.
    bands = [band for band in diagnosis["evidence"]["bands"] if band["channel"] == "y" and band["order"] < 200]
    turned = 60 / diagnosis["drive_speed_rpm"]
    widths = [max(1.0, (band["high_hz"] - band["low_hz"]) * turned) for band in bands]
    shares = np.interp([band["order"] for band in bands], laid["at"], 20 * np.log10(lines["first"]))
    predicted = [band["predicted_db"] for band in bands] - 10 * np.log10(widths)
    assert len(bands) > 5 and np.median(np.abs(shares - predicted)) < 3.0
    by_hz = seen(
        client, measurement["id"], view="matched", of="frame", channel="y", unit="mm/s", diagnosis=asked["diagnosis"]
    )
    turn = diagnosis["drive_speed_rpm"] / 60
    assert by_hz["at"][1] == pytest.approx(2 * turn, rel=1e-6)
    first = next(line for line in by_hz["lines"] if line["kind"] == "first")["values"]
    assert first[1] == pytest.approx(lines["first"][1] * 1e3 / (2 * math.pi * 2 * turn), rel=1e-4)
    sensors = seen(client, measurement["id"], view="matched", **asked)
    assert {line["name"] for line in sensors["lines"]} == {"s1-x", "s1-y", "s2-x", "s2-y"}
    response = client.get(
        f"/api/v1/measurements/{measurement['id']}/signal", params={"view": "matched", "speed": "600rpm"}
    )
    assert response.status_code == 422 and "name one" in response.json()["detail"]


def test_when_it_was_measured_is_corrected_on_its_page(client: httpx.Client, tone: str) -> None:
    place = f"/measurements/{tone}"
    refused = client.post(place, data={"measured_at": "yesterday"})
    assert refused.status_code == 422 and "must be a moment with a time zone" in refused.text
    assert client.post(place, data={"measured_at": ""}).status_code == 422
    assert client.post(place, data={"measured_at": "2026-03-01T06:00:00.000Z"}).status_code == 303
    known = client.get(f"/api/v1{place}").json()
    assert (known["measured_at"], known["measured_at_source"]) == ("2026-03-01T06:00:00Z", "sender")
    assert 'data-moment="2026-03-01T06:00:00Z"' in client.get(place).text
    assert client.post("/measurements/nonsense", data={"measured_at": "2026-03-01T06:00:00Z"}).status_code == 404


def test_overall_levels_come_as_a_table(client: httpx.Client, tone: str) -> None:
    text = client.get(f"/measurements/{tone}/overall", params={"unit": "g", "harmonics": "drive"}).text
    assert "<td>0.1442 g</td>" in text and text.count('<th scope="row">') == 2
    refused = client.get(f"/measurements/{tone}/overall", params={"channel": "c"})
    assert refused.status_code == 422 and "channel c: must be one of a, b" in refused.text


def test_the_page_names_what_belongs_to_it(
    client: httpx.Client, measurement: dict[str, Any], diagnosis: dict[str, Any]
) -> None:
    text = client.get(f"/measurements/{measurement['id']}").text
    assert f'href="/diagnoses/{diagnosis["id"]}"' in text
    assert f'value="{diagnosis["drive_speed_rpm"]:.6g} rpm"' in text
    assert f'href="/measurements/{measurement["id"]}' in client.get(f"/diagnoses/{diagnosis['id']}").text
    assert client.get("/measurements/nonsense").status_code == 404
