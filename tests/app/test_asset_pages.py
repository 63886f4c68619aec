"""The pages of assets without a browser: noted, changed, refused, and what they tell of the past."""

from __future__ import annotations

import html
import json
import re
from datetime import UTC, datetime
from pathlib import Path
from shutil import copytree

import httpx
import pytest
from answers import diagnosis, hypothesis, joint
from small_service import asking

from jointplay.app.pages.history import chart, history
from jointplay.app.rows import Play
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.asset_rows import FindingRow
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow

API = "/api/v1"


def error_of(text: str, field: str) -> str:
    found = re.search(rf'<p class="error" id="error-{field}"[^>]*>([^<]*)</p>', text)
    assert found is not None
    return found[1]


@pytest.fixture(scope="module")
def recording(client: httpx.Client, worn: bytes) -> str:
    return str(client.post(f"{API}/measurements", files={"file": ("worn.csv", worn)}).json()["id"])


def noted(client: httpx.Client, name: str, machine: str = "slider-crank", notes: str = "") -> httpx.Response:
    return client.post("/assets", data={"external_id": name, "machine": machine, "notes": notes})


def page_of(client: httpx.Client, name: str) -> str:
    return client.get(f"/assets/{name}").text


def test_an_asset_is_noted_and_changed(client: httpx.Client, recording: str, in_order: bytes) -> None:
    answer = noted(client, "page-1", notes="hall <B>")
    assert (answer.status_code, answer.headers["location"]) == (303, "/assets/page-1")
    page = client.get("/assets/page-1").text
    assert "hall &lt;B&gt;" in page and "None yet." in page and "data-history" not in page
    assert 'href="/assets/page-1"' in client.get("/assets").text
    client.put(f"{API}/assets/page-1/measurements/{recording}")
    assert f'<input id="baseline-{recording}" name="baseline-{recording}" type="checkbox" value="yes" >' in (
        client.get("/assets/page-1").text
    )
    changed = client.post("/assets/page-1", data={f"baseline-{recording}": "yes", "notes": "line 3"})
    assert changed.status_code == 303
    stored = client.get(f"{API}/assets/page-1").json()
    assert (stored["machine"], stored["notes"], stored["baseline"]) == ("slider-crank", "line 3", recording)
    assert "<dd>worn.csv</dd>" in client.get("/assets/page-1").text
    assert re.search(rf'name="baseline-{recording}" type="checkbox" value="yes" checked>', page_of(client, "page-1"))
    other = client.post(f"{API}/measurements", files={"file": ("new.csv", in_order)}).json()["id"]
    client.put(f"{API}/assets/page-1/measurements/{other}")
    client.post("/assets/page-1", data={f"baseline-{recording}": "yes", f"baseline-{other}": "yes"})
    assert set(client.get(f"{API}/assets/page-1").json()["baselines"]) == {recording, other}
    client.post("/assets/page-1", data={"notes": ""})
    stored = client.get(f"{API}/assets/page-1").json()
    assert (stored["notes"], stored["baseline"], stored["baselines"]) == ("", None, [])
    assert 'class="machine-drawing' in page_of(client, "page-1")


@pytest.mark.parametrize(
    ("change", "field", "text"),
    [
        ({"external_id": ""}, "external_id", "give it a name"),
        ({"external_id": "hall B"}, "external_id", "external_id: "),
        ({"external_id": "page-taken"}, "external_id", "page-taken: there is an asset of this id already"),
        ({"machine": ""}, "machine", "choose a machine"),
        ({"notes": "a\u0001b"}, "notes", "notes: "),
    ],
)
def test_a_refusal_is_told_beside_its_field(
    client: httpx.Client, change: dict[str, str], field: str, text: str
) -> None:
    noted(client, "page-taken", notes="first")
    form = {"external_id": "page-new", "machine": "slider-crank", "notes": "second", **change}
    answer = client.post("/assets", data=form)
    assert answer.status_code == 422
    assert text in error_of(answer.text, field)
    assert not any(error_of(answer.text, other) for other in {"external_id", "machine", "notes"} - {field})
    assert f'value="{form["external_id"]}"' in answer.text, "what was typed stays"
    assert client.get(f"{API}/assets/page-taken").json()["notes"] == "first"
    assert client.get(f"{API}/assets/page-new").status_code == 404


def test_a_baseline_that_is_none_is_told_beside_it(client: httpx.Client) -> None:
    noted(client, "page-2")
    answer = client.post("/assets/page-2", data={"baseline-none": "yes", "notes": "typed"})
    assert answer.status_code == 422
    assert error_of(answer.text, "baselines") == "baselines: measurement none: there is none of this id"
    assert ">typed</textarea>" in answer.text
    assert client.get(f"{API}/assets/page-2").json()["notes"] == ""


def test_what_is_not_there_is_a_page(client: httpx.Client) -> None:
    for answer in (client.get("/assets/nobody"), client.post("/assets/nobody", data={"notes": ""})):
        assert answer.status_code == 404 and "No such asset" in answer.text
    for place in ("/assets?cursor=x!", "/assets/page-1?cursor=x!"):
        noted(client, "page-1")
        assert client.get(place).status_code == 400


def test_a_diagnosis_of_the_form_is_of_its_asset(client: httpx.Client, worn: bytes) -> None:
    noted(client, "page-3")
    noted(client, "page-bar", "four-bar")
    files = {"file": ("worn.csv", worn)}
    for asset, text in (("nobody", "asset nobody: there is none"), ("page-bar", "asset: page-bar: is a four-bar")):
        refused = client.post("/recordings", data={"catalogue": "slider-crank", "asset": asset}, files=files)
        assert text in error_of(refused.text, "asset")
    place = client.post("/recordings", data={"catalogue": "slider-crank", "asset": "page-3"}, files=files).headers[
        "location"
    ]
    page = client.get(place).text
    assert re.search(r'name="asset" [^>]*value="page-3"', page)
    form = {"measurement": httpx.URL(place).params["measurement"], "catalogue": "slider-crank", "effort": "fast"}
    refused = client.post("/diagnose", data={**form, "asset": "page-bar"})
    assert "is a four-bar" in error_of(refused.text, "asset")
    result = client.post("/diagnose", data={**form, "asset": "page-3"}).headers["location"]
    text = client.get(result).text
    assert 'href="/assets/page-3"' in text and "asset=page-3" in text
    page = client.get("/assets/page-3").text
    assert f'href="{result}">B worn</a>' in page
    drawn = json.loads(html.unescape(re.findall(r'data-history="([^"]+)"', page)[0]))
    stored = client.get(f"{API}{result}").json()["joints"]["B"]
    (joint,) = drawn["joints"]
    (point,) = joint["points"]
    assert joint["name"] == "B"
    assert (point["um"], [point["low"], point["high"]]) == (stored["clearance_um"], stored["interval_um"])
    finding = {"joints": {"B": {"clearance_um": 140}}, "text": "feeler <gauge>", "at": "2026-03-01T08:00:00Z"}
    client.post(f"{API}{result}/finding", json=finding)
    page = client.get("/assets/page-3").text
    assert "feeler &lt;gauge&gt;" in page and "B 140 µm" in page
    drawn = json.loads(html.unescape(re.findall(r'data-history="([^"]+)"', page)[0]))
    assert drawn["events"] == [{"at": 1772352000.0, "kind": "finding", "joint": "B", "um": 140.0}]


# --- what is drawn of a longer past


def day(number: int) -> datetime:
    return datetime(2026, 3, number, 12, tzinfo=UTC)


def measured(number: int) -> MeasurementRow:
    moment = day(number)
    return MeasurementRow(
        id=f"m{number}", name=f"{number}.csv", created_at=day(20), measured_at=moment, measured_at_source="file"
    )


def diagnosed(number: int, verdict: str, made: int = 0, effort: str = "fast", **worn: float) -> DiagnosisRow:
    joints = {name: joint("worn", um, 0.9, interval_um=[0.8 * um, 1.2 * um]) for name, um in worn.items()}
    hypotheses = [hypothesis("+".join(worn), 0.9, **worn), hypothesis("healthy", 0.1)]
    shown = hypotheses if worn else hypotheses[1:]
    result = diagnosis(verdict=verdict, joints=joints, effort=effort, hypotheses=shown).model_dump(mode="json")
    machine = {"joints": {"O": {}, "A": {}, "B": {}}}
    return DiagnosisRow(
        id=f"d{number}{made}",
        measurement=f"m{number}",
        created_at=day(number + made),
        machine=machine,
        request={},
        result=result,
    )


def test_the_newest_diagnosis_of_a_recording_is_drawn_and_all_are_listed() -> None:
    past = [
        diagnosed(1, "worn", made=9, effort="thorough", B=105.0),
        diagnosed(5, "changed"),
        diagnosed(4, "unknown", A=300.0),
        diagnosed(3, "worn", A=80.0, B=150.0),
        diagnosed(2, "in_order"),
        diagnosed(1, "worn", B=100.0),
    ]
    text_only = FindingRow(at=day(5), joints={}, text="noise", diagnosis="d30")
    rows = {f"m{number}": measured(number) for number in range(1, 6)}
    shown = history(past, rows, {key: row.measured_at for key, row in rows.items()}, [text_only])
    assert [row["short"] for row in shown["rows"]] == [
        "changed",
        "no verdict",
        "A+B worn",
        "in order",
        "B worn",
        "B worn",
    ]
    assert [row["percent"] for row in shown["rows"]] == ["–", "–", "90 %", "10 %", "90 %", "90 %"]
    assert [row["measured"][:10] for row in shown["rows"]] == [f"{day(n):%Y-%m-%d}" for n in (5, 4, 3, 2, 1, 1)]
    assert shown["rows"][2]["plays"] == (Play("80 µm", "64 to 96", "A"), Play("150 µm", "120 to 180", "B"))
    drawn = shown["chart"]["data"]
    points = {joint["name"]: [(point["at"], point["um"]) for point in joint["points"]] for joint in drawn["joints"]}
    third = day(3).timestamp()
    assert points == {"A": [(third, 80.0)], "B": [(day(1).timestamp(), 105.0), (third, 150.0)]}
    assert [(joint["name"], joint["look"]) for joint in drawn["joints"]] == [("A", 0), ("B", 1)]
    assert [(event["kind"], event.get("um")) for event in drawn["events"]] == [
        ("in_order", None),
        ("unknown", None),
        ("changed", None),
        ("finding", None),
    ]
    assert shown["chart"]["summary"] == (
        "Radial clearance over time, of 5 recordings and 1 finding. Found worn: A once, 80 µm; B from 105 to 150 µm."
        " The tables below have the values."
    )


def test_the_next_recording_is_compared_with_the_catalogue_of_the_last(
    shelf: Path, worn: bytes, tmp_path: Path
) -> None:
    for name in ("a-first", "slider-crank"):
        copytree(shelf / "slider-crank", tmp_path / "catalogues" / name)
    settings = ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", workers=1, time_limit_s=300)
    with asking(settings) as client:
        noted(client, "page-1")
        measured = client.post(
            f"{API}/measurements", files={"file": ("worn.csv", worn)}, data={"asset": "page-1"}
        ).json()
        assert 'href="/?catalogue=a-first&amp;asset=page-1"' in page_of(client, "page-1")
        body = {"measurement": measured["id"], "catalogue": "slider-crank", "asset": "page-1", "effort": "fast"}
        assert client.post(f"{API}/diagnoses", json=body).status_code == 201
        assert 'href="/?catalogue=slider-crank&amp;asset=page-1"' in page_of(client, "page-1")


def test_a_past_without_wear_is_drawn() -> None:
    drawn = chart([diagnosed(2, "in_order")], {"m2": day(2)}, [])
    assert drawn["joints"] == [] and "No joint was found worn." in drawn["summary"]


def test_recordings_of_an_asset_have_one_answer(client: httpx.Client, worn: bytes) -> None:
    noted(client, "page-several")
    keys = []
    for name in ("monday.csv", "tuesday.csv", "wednesday.csv"):
        # The same bytes under another name are another measurement, and count once.
        key = client.post(f"{API}/measurements", files={"file": (name, worn)}).json()["id"]
        client.put(f"{API}/assets/page-several/measurements/{key}")
        keys.append(key)
        shown = client.get("/assets/page-several").text
        assert ("Diagnose together" in shown) == (len(keys) > 1)
    assert '<option value="slider-crank" selected>' in shown
    asked = {f"with-{key}": "yes" for key in reversed(keys)} | {"catalogue": "slider-crank", "effort": "fast"}
    answer = client.post("/assets/page-several/together", data=asked)
    assert answer.status_code == 303
    found = client.get(f"{API}{answer.headers['location']}").json()
    assert found["measurements"] == keys
    assert (found["asset"], found["effort"]) == ("page-several", "fast")
    client.put(f"{API}/assets/page-several", json={"machine": "slider-crank", "baseline": keys[0]}).raise_for_status()
    for ticked, said in (({}, "choose recordings"), ({f"with-{key}": "yes" for key in keys}, "is the baseline that")):
        refused = client.post("/assets/page-several/together", data={"catalogue": "slider-crank", **ticked})
        assert refused.status_code == 422
        assert said in error_of(refused.text, "measurements")
        assert re.search(rf'name="baseline-{keys[0]}" type="checkbox" value="yes" checked', refused.text), "it stays"


@pytest.mark.parametrize(
    ("method", "address", "sent", "text"),
    [
        ("GET", "/assets?state=rusty", None, "state: Input should be"),
        ("POST", "/assets/page-above/acknowledgement", {"state": "rusty"}, "state: Input should be"),
        ("GET", "/assets/page-above/state", None, "none of its recordings was diagnosed"),
    ],
)
def test_what_no_field_of_a_page_is_about_is_told_above(
    client: httpx.Client, method: str, address: str, sent: dict[str, str] | None, text: str
) -> None:
    noted(client, "page-above")
    refused = client.request(method, address, data=sent)
    assert refused.status_code in (404, 422)
    said = re.search(r'<p class="detail">([^<]*)</p>', refused.text)
    assert said is not None and text in said[1]


def test_recordings_that_cannot_be_diagnosed_together_are_told_beside_their_ticks(
    client: httpx.Client, worn: bytes
) -> None:
    noted(client, "page-unmapped")
    keys = []
    for name in (b"p", b"q"):
        table = worn.replace(b"s1-", name).replace(b"s2-", 2 * name)
        sent = client.post(f"{API}/measurements", files={"file": ("unmapped.csv", table)})
        keys.append(sent.json()["id"])
        client.put(f"{API}/assets/page-unmapped/measurements/{keys[-1]}")
    asked = {f"with-{key}": "yes" for key in keys} | {"catalogue": "slider-crank", "effort": "fast"}
    refused = client.post("/assets/page-unmapped/together", data=asked)
    assert refused.status_code == 422
    assert "sensor" in error_of(refused.text, "measurements")
