"""What is said of a file that it does not say itself: the same over HTTP as on the command line."""

from __future__ import annotations

import io
import json
import re
from typing import Any

import httpx
import numpy as np
import pytest
import soundfile

from jointplay.app.commands.diagnose import command
from jointplay.app.errors import BadFieldError
from jointplay.app.fields import FILE_FIELDS, TOLD, FileField
from jointplay.app.storage.told import Told, read_told
from jointplay.catalogue.measurements.import_profile import ImportProfile
from jointplay.catalogue.measurements.measurement import Recording, read_measurement

API = "/api/v1"
PROFILE = "units: {a: g, b: g}\nsensors: {a: s1-x, b: s1-y}\n"


def send(client: httpx.Client, content: bytes, name: str = "r.csv", **fields: str) -> httpx.Response:
    return client.post(f"{API}/measurements", files={"file": (name, content)}, data=fields)


def refused(response: httpx.Response, field: str, text: str) -> None:
    document = response.json()
    assert response.status_code == 422, document
    assert [each["field"] for each in document["errors"]] == [field]
    assert text in document["detail"] and "\n" not in document["detail"]


def table(values: np.ndarray, head: str) -> bytes:
    text = io.StringIO()
    np.savetxt(text, values, fmt="%.9g", delimiter=",", header=head, comments="")
    return text.getvalue().encode()


@pytest.fixture(scope="module")
def recording(worn: bytes) -> Recording:
    return read_measurement(worn, name="worn.csv")


@pytest.fixture(scope="module")
def spectrum(recording: Recording) -> bytes:
    """Density of the worn recording."""
    from scipy.signal import welch

    frequency, density = welch(recording.signal, recording.sample_rate, nperseg=8192, axis=0)
    head = ",".join(f"{name} [(m/s2)^2/Hz]" for name in recording.channel_names)
    return table(np.column_stack([frequency, density]), f"frequency [Hz],{head}")


@pytest.fixture(scope="module")
def bare(recording: Recording) -> bytes:
    """Two columns in g without times and without units."""
    return table(recording.signal[:, :2] / 9.80665, "a,b")


def test_units_and_rate_of_a_bare_table(client: httpx.Client, bare: bytes, recording: Recording) -> None:
    refused(send(client, bare), "units", "has no unit")
    refused(send(client, bare, units="g"), "sample_rate", "give the sample rate")
    refused(send(client, bare, units="g", sample_rate="10 kHz", window="hann"), "window", "said of a spectrum")
    found = send(client, bare, units="g", sample_rate="10 kHz").json()
    assert found["told"] == {"sample_rate_hz": 10_000, "units": {"*": "g"}}
    assert [channel["unit"] for channel in found["channels"]] == ["g", "g"]
    assert (found["kind"], found["spectrum"], found["sample_rate_hz"]) == ("recording", None, 10_000)
    assert found["samples"] == len(recording.signal)
    by_column = send(client, bare, units='{"a": "g", "b": "mm/s"}', sample_rate="10000").json()
    assert send(client, bare, units="a=g, b=mm/s", sample_rate="10000").json() == by_column
    refused(send(client, bare, units="a=g, mm/s"), "units", 'mm/s: must be COLUMN=TEXT, as in "t=s, *=g"')
    refused(send(client, bare, units="a=g, a=mm/s"), "units", "a=mm/s: is given twice")
    assert [channel["quantity"] for channel in by_column["channels"]] == ["acceleration", "velocity"]
    assert by_column["sha256"] == found["sha256"]
    assert by_column["id"] != found["id"]
    assert client.get(f"{API}/measurements/{by_column['id']}").json() == by_column


def test_a_profile_is_a_text_or_a_file(client: httpx.Client, bare: bytes) -> None:
    told = {"sample_rate": "10 kHz"}
    as_text = send(client, bare, profile=PROFILE, **told).json()
    assert [channel["name"] for channel in as_text["channels"]] == ["s1-x", "s1-y"]
    assert as_text["told"]["profile"] == {"units": {"a": "g", "b": "g"}, "sensors": {"a": "s1-x", "b": "s1-y"}}
    files = {"file": ("r.csv", bare), "profile": ("profile.yaml", PROFILE.encode())}
    as_file = client.post(f"{API}/measurements", files=files, data=told)
    assert as_file.status_code == 201
    same = json.dumps({"sensors": {"b": "s1-y", "a": "s1-x"}, "units": {"b": "g", "a": "g"}})
    assert as_file.json() == as_text == send(client, bare, profile=same, **told).json()
    refused(send(client, bare, profile="delimitr: x", **told), "profile", "profile: column 'delimitr'")
    refused(send(client, bare, profile="sensors: {c: s1-x}", **told), "profile", "columns are a, b")
    for content, text in ((b"\xff\xfe", "UTF-8"), (b"#" * 40_000, "32 kB")):
        files = {"file": ("r.csv", bare), "profile": ("profile.yaml", content)}
        refused(client.post(f"{API}/measurements", files=files, data=told), "profile", text)


def test_a_wav_file_and_its_full_scale(client: httpx.Client, recording: Recording) -> None:
    file = io.BytesIO()
    soundfile.write(file, recording.signal[:, :2] / 300.0, 10_000, format="WAV", subtype="PCM_16")
    content = file.getvalue()
    refused(send(client, content, "r.wav"), "full_scale", "full_scale")
    refused(send(client, content, "r.wav", full_scale="5 apples"), "full_scale", "5 apples")
    found = send(client, content, "r.wav", full_scale="300 m/s2").json()
    # The same by 0.1 V at 100 mV a g and full scale.
    sensed = send(client, content, "r.wav", full_scale="3.0591486 V", sensitivity="100 mV/g").json()
    rms = [[float(line.split("rms ")[1].split(",")[0]) for line in each["import_report"] if "rms" in line]
           for each in (found, sensed)]  # fmt: skip
    assert rms[0] == pytest.approx(np.sqrt((recording.signal[:, :2] ** 2).mean(axis=0)), rel=1e-2)
    assert rms[0] == pytest.approx(rms[1], rel=1e-3)
    refused(send(client, content, "r.wav", full_scale="1 V"), "sensitivity", "sensitivity")
    refused(send(client, content, "r.wav", full_scale="1 V", sensitivity="9 mV/s"), "sensitivity", "100 mV/g")


def test_a_tacho_gives_the_speed(client: httpx.Client, recording: Recording) -> None:
    times = np.arange(len(recording.signal)) / recording.sample_rate
    pulses = np.clip(np.cos(2.0 * np.pi * 10.11 * times) - 0.9, 0.0, None)
    content = table(np.column_stack([times, recording.signal, pulses]), "time [s],s1-x,s1-y,s2-x,s2-y,key [V]")
    told = {"units": "m/s2", "catalogue": "slider-crank", "effort": "fast"}
    found = client.post(f"{API}/diagnoses", files={"file": ("r.csv", content)}, data={**told, "tacho": "key"}).json()
    assert found["drive_speed_rpm"] == pytest.approx(606.6, abs=0.05)
    stored = client.get(f"{API}/measurements/{found['measurement']}").json()
    assert stored["revolutions"] == pytest.approx(10.11 * times[-1], abs=2)
    assert [channel["name"] for channel in stored["channels"]] == ["s1-x", "s1-y", "s2-x", "s2-y"]
    twice = send(client, content, units="m/s2", tacho="key", pulses_per_revolution="2").json()
    assert twice["revolutions"] == pytest.approx(stored["revolutions"] / 2, abs=1)
    refused(send(client, content, units="m/s2", tacho="kee"), "tacho", "columns are time, s1-x")
    refused(send(client, content, units="m/s2", pulses_per_revolution="2"), "pulses_per_revolution", "tacho")


def test_a_spectrum_is_stored_and_diagnosed(client: httpx.Client, spectrum: bytes, recording: Recording) -> None:
    stored = send(client, spectrum, "s.csv").json()
    assert stored["kind"] == "spectrum"
    assert stored["sample_rate_hz"] is stored["samples"] is stored["duration_s"] is None
    assert stored["spectrum"]["resolution_hz"] == pytest.approx(recording.sample_rate / 8192)
    assert (stored["spectrum"]["lines"], stored["spectrum"]["highest_hz"]) == (4097, 5000)
    assert {(c["scaling"], c["detector"], c["decibel"]) for c in stored["channels"]} == {("psd", "rms", False)}
    assert stored in client.get(f"{API}/measurements").json()["items"]
    asked = {"measurement": stored["id"], "catalogue": "slider-crank", "speed": "606.8 rpm", "effort": "fast"}
    answer = client.post(f"{API}/diagnoses", json=asked)
    assert answer.status_code == 201, answer.text
    document = answer.json()
    assert document["hypotheses"][0]["joints"].keys() == {"B"}
    assert {each["channel"] for each in document["evidence"]["orders"]} == set(recording.channel_names)
    report = client.get(f"{API}/diagnoses/{document['id']}/report").text
    assert "4097 lines, 1.221 Hz apart" in report
    assert re.search(r"Spectrum\s*</\w+>\s*<\w+>\s*s\.csv", report) and "nobody says when; received" in report
    assert "Said of it" not in report
    page = client.get("/confirm", params={"measurement": stored["id"], "catalogue": "slider-crank"}).text
    assert "1.221 Hz, 4097 lines" in page and "density, rms" in page
    assert client.get(f"/diagnoses/{document['id']}").status_code == 200


def test_a_spectrum_says_what_it_is_or_is_told(client: httpx.Client, spectrum: bytes) -> None:
    vague = spectrum.replace(b"(m/s2)^2/Hz", b"m/s2")
    refused(
        send(client, vague, "s.csv"),
        "scaling",
        "give its scaling: psd, power or amplitude (option --scaling, field scaling, in the form 'Scaling')",
    )
    refused(send(client, vague, "s.csv", scaling="amplitude"), "detector", "rms or peak")
    told = {"scaling": "amplitude", "detector": "peak"}
    refused(send(client, vague, "s.csv", **told), "window", "window")
    refused(send(client, vague, "s.csv", scaling="loud"), "scaling", "scaling: loud")
    found = send(client, vague, "s.csv", window="hann", **told).json()
    assert {(c["scaling"], c["detector"]) for c in found["channels"]} == {("amplitude", "peak")}
    levels = send(client, vague, "s.csv", decibel="true", window="hann", **told)
    refused(levels, "reference", "without a reference")
    in_profile = json.dumps({"spectrum": {**told, "window": "hann"}})
    assert send(client, vague, "s.csv", profile=in_profile).json() == found
    refused(
        send(client, vague, "s.csv", window="flattop", sensitivity="9 V/g", **told), "sensitivity", "no column is in V"
    )
    refused(send(client, vague, "s.csv", sample_rate="10 kHz", **told), "sample_rate", "holds a spectrum")
    refused(send(client, vague, "s.csv", tacho="s1-x", **told), "tacho", "holds a spectrum")


def test_a_measurement_of_an_asset(client: httpx.Client, worn: bytes, spectrum: bytes) -> None:
    assert client.put(f"{API}/assets/told-1", json={"machine": "slider-crank"}).status_code == 201
    found = send(client, worn, "of told-1.csv", asset="told-1").json()
    listed = client.get(f"{API}/measurements", params={"asset": "told-1"}).json()["items"]
    assert [item["id"] for item in listed] == [found["id"]]
    unknown = send(client, worn, "nobody's.csv", asset="nobody")
    assert unknown.status_code == 404
    assert unknown.json()["errors"][0]["field"] == "asset"
    assert all(item["name"] != "nobody's.csv" for item in client.get(f"{API}/measurements").json()["items"])
    # Of one that was stored before, too.
    assert send(client, worn, "plain.csv").status_code == 201
    assert send(client, worn, "plain.csv", asset="told-1").status_code == 201
    assert len(client.get(f"{API}/measurements", params={"asset": "told-1"}).json()["items"]) == 2
    of_spectrum = send(client, spectrum, "s.csv").json()["id"]
    baseline = client.put(f"{API}/assets/told-1", json={"machine": "slider-crank", "baseline": of_spectrum})
    refused(baseline, "baseline", "is a spectrum; a baseline has to be a recording over time")


@pytest.mark.parametrize("field", ["tacho", "units", "profile", "sample_rate"])
def test_what_is_said_of_no_file_is_refused(client: httpx.Client, worn: bytes, field: str) -> None:
    stored = send(client, worn).json()["id"]
    data = {"measurement": stored, "catalogue": "slider-crank", field: "10"}
    response = client.post(f"{API}/diagnoses", files={"file": ("", b"")}, data=data)
    assert response.status_code == 422
    assert field in response.json()["detail"]


@pytest.mark.parametrize(
    ("fields", "field", "text"),
    [
        ({"units": "{"}, "units", "units: is not JSON"),
        ({"units": '{"a": "\\ud800"}'}, "units", "no text"),
        ({"units": "g\0"}, "units", "no text"),
        ({"tacho": "a\0b"}, "tacho", "tacho: a"),
        ({"profile": '{"sensors": {"a": "\\u0000"}}'}, "profile", "sensors.a"),
        ({"units": "x" * 201}, "units", "1 to 200 characters"),
        ({"units": '{"a": 3}'}, "units", "units: a: 3: must be a text"),
        ({"sensitivity": '{"a": ""}'}, "sensitivity", 'sensitivity: a: ""'),
        ({"tacho": "key", "pulses_per_revolution": "0"}, "pulses_per_revolution", "pulses_per_revolution: 0: "),
        ({"reference": "-1"}, "reference", "reference: -1: "),
        ({"decibel": "perhaps"}, "decibel", "decibel: perhaps: "),
        ({"sample_rate": "0"}, "sample_rate", "sample_rate: 0: must be greater than 0"),
        ({"profile": "skip_lines: -1"}, "profile", "skip_lines"),
    ],
)
def test_refusals_name_the_field(fields: dict[str, str], field: str, text: str) -> None:
    with pytest.raises(BadFieldError) as caught:
        read_told(fields)
    assert caught.value.field == field
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 30_000,
        "{" * 30_000,
        "- " * 15_000,
        "a: &a [*a]",
        "skip_lines: " + "9" * 6000,
        "2001-01-01",
        "x: !!python/object:os.system y",
        "tacho: {column: a, threshold: .nan}",
        "\0",
        "\ud800",
    ],
)
def test_profiles_that_are_meant_to_hurt_are_refused_in_one_short_line(text: str) -> None:
    with pytest.raises(BadFieldError) as caught:
        read_told({"profile": text})
    assert caught.value.field == "profile"
    assert len(str(caught.value)) < 400 and "\n" not in str(caught.value)


@pytest.mark.parametrize("field", sorted(TOLD - {"profile", "units", "sensitivity", "tacho"}))
@pytest.mark.parametrize("text", ["9" * 6000, "nan", "1e999", "{" * 2000, "\ud800"])
def test_single_fields_are_refused_in_one_short_line(field: str, text: str) -> None:
    with pytest.raises(BadFieldError) as caught:
        read_told({field: text, "tacho": "key"} if field == "pulses_per_revolution" else {field: text})
    assert caught.value.field == field
    assert len(str(caught.value)) < 400 and "\n" not in str(caught.value)


@pytest.mark.parametrize("field", FILE_FIELDS, ids=lambda field: field.name)
def test_every_field_is_one_of_a_profile_and_an_option(field: FileField) -> None:
    (option,) = (each for each in command.params if each.name == field.name)
    assert option.opts == [f"--{field.option}"]
    if not field.place:
        assert field.name in ("sample_rate", "units")
        return
    members, defined = ImportProfile.model_json_schema(), ImportProfile.model_json_schema()["$defs"]
    for name in field.place.split("."):
        found = members["properties"][name]
        found = found.get("anyOf", [found])[0]
        members = defined[found["$ref"].rpartition("/")[2]] if "$ref" in found else found
    values = ["false", "true"] if members["type"] == "boolean" else members.get("enum", [])
    assert sorted(field.choices) == sorted(values)
    assert bool(field.by_column) == (members["type"] == "object")


def test_single_fields_win_over_the_profile() -> None:
    profile = "full_scale_m_s2: 3\ntacho: {column: a, edge: falling}\nspectrum: {window: hann}\n"
    told = read_told({"profile": profile, "full_scale": "5 g", "tacho": "b", "detector": "rms"})
    assert told.profile == {
        "full_scale": "5 g",
        "tacho": {"column": "b", "edge": "falling"},
        "spectrum": {"window": "hann", "detector": "rms"},
    }
    assert read_told({}) == Told()


def test_what_is_said_of_a_file_is_kept_with_it(client: httpx.Client, bare: bytes) -> None:
    found: dict[str, Any] = send(client, bare, units="g", sample_rate="10 kHz").json()
    asked = {"measurement": found["id"], "catalogue": "slider-crank", "mapping": {"a": "s1-x", "b": "s1-y"}}
    answer = client.post(f"{API}/diagnoses", json={**asked, "effort": "fast"})
    assert answer.status_code == 201, answer.text
    assert answer.json()["provenance"]["measurement_sha256"] == found["sha256"]
    report = client.get(f"{API}/diagnoses/{answer.json()['id']}/report").text
    assert "sample rate 10000 Hz; units g" in report
