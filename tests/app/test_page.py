"""The page without a browser: what it loads, what it says, and that it works without scripts."""

from __future__ import annotations

import gzip
import hashlib
import html
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import httpx
import pytest
from recordings import RECORDINGS
from small_service import spoiled

from jointplay.app import main
from jointplay.app.errors import BadFieldError
from jointplay.app.fields import TOLD
from jointplay.app.pages.page_forms import Beside
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.solver.machines.machine import shipped_machine

VENDOR = main.STATIC / "vendor"


class Page(HTMLParser):
    """Collects what the tests ask about."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.inline: list[str] = []
        self.ids: list[str] = []
        self.labels: set[str] = set()
        self.fields: list[dict[str, str | None]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        if tag in ("script", "img", "link", "source", "iframe"):
            place = found.get("src") or found.get("href")
            self.loaded.append(place) if place else self.inline.append(tag)
        self.inline += [name for name in found if name == "style" or name.startswith("on")]
        self.inline += [tag] if tag == "style" else []
        if identity := found.get("id"):
            self.ids.append(identity)
        if tag == "label" and found.get("for"):
            self.labels.add(str(found["for"]))
        if tag in ("input", "select", "textarea"):
            self.fields.append(found)


def send(client: httpx.Client, content: bytes | None, *, htmx: bool = False, **fields: str) -> httpx.Response:
    files = {"file": ("worn.csv", content)} if content is not None else {"file": ("", b"")}
    headers = {"HX-Request": "true"} if htmx else {}
    return client.post("/recordings", data={"catalogue": "slider-crank", **fields}, files=files, headers=headers)


def ask(client: httpx.Client, place: str, *, htmx: bool = False, **fields: str) -> httpx.Response:
    """Confirm what a page says was understood, but for some fields."""
    headers = {"HX-Request": "true"} if htmx else {}
    form = {**confirmed(client.get(place).text), "effort": "fast", **fields}
    return client.post("/diagnose", data=form, headers=headers)


def confirmed(text: str) -> dict[str, str]:
    """Fields of the form of confirmation as they are filled in."""
    form = text[text.index('<form id="confirm"') :]
    fields = dict(re.findall(r'<input (?:id="[^"]*" |type="hidden" )*name="([^"]+)"[^>]*? value="([^"]*)"', form))
    for name, options in re.findall(r'<select id="[^"]+" name="([^"]+)".*?>(.*?)</select>', form, re.DOTALL):
        fields[name] = re.findall(r'value="([^"]*)" selected', options)[0]
    return fields


@pytest.fixture(scope="module")
def place(client: httpx.Client, worn: bytes) -> str:
    """Address of the page that says what was understood of the worn recording."""
    return send(client, worn).headers["location"]


@pytest.fixture(scope="module")
def again() -> bytes:
    """Another recording of a slider-crank whose joint B is worn."""
    return gzip.decompress((RECORDINGS / "slider-crank-05.csv.gz").read_bytes())


def error_of(text: str, field: str) -> str:
    found = re.search(rf'<p class="error" id="error-{field}"[^>]*>([^<]*)</p>', text)
    assert found is not None
    return html.unescape(found[1])


def test_only_own_files_are_loaded(client: httpx.Client) -> None:
    page = Page(client.get("/").text)
    assert page.loaded
    assert all(place.startswith("/static/") for place in page.loaded)
    assert not page.inline
    for place in page.loaded:
        assert client.get(place).status_code == 200
    own = [path for path in main.STATIC.iterdir() if path.suffix in (".js", ".css")]
    assert {f"/static/{path.name}" for path in own} <= set(page.loaded)
    for path in own:
        assert not re.search(r"https?:|@import|url\(", path.read_text(encoding="utf-8"))


def test_a_page_and_its_part_are_told_apart_by_caches(client: httpx.Client) -> None:
    place = "/catalogues/slider-crank?hypothesis=B&clearance=200"
    whole, part = client.get(place), client.get(place, headers={"HX-Request": "true"})
    assert ("<html" in whole.text, "<html" in part.text) == (True, False)
    assert whole.headers["vary"] == part.headers["vary"] == "HX-Request"


@pytest.mark.parametrize("folder", [VENDOR, Path(__file__).parent / "vendor"])
def test_vendored_files_are_those_of_the_table(folder: Path) -> None:
    table = (folder / "README.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| `([^`]+)` .* \| `([0-9a-f]{64})` \|$", table, re.MULTILINE))
    files = {path.name for path in folder.iterdir() if path.suffix in (".js", ".css")}
    assert files and set(listed) == files
    for name, checksum in listed.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == checksum
    assert all((folder / name).is_file() for name in re.findall(r"`([a-z]+-LICENSE\.txt)`", table))


@pytest.mark.parametrize("step", ["/", "confirm"])
def test_every_field_has_a_label_and_a_place_for_its_error(client: httpx.Client, place: str, step: str) -> None:
    page = Page(client.get(place if step == "confirm" else step).text)
    assert len(page.ids) == len(set(page.ids))
    shown = [field for field in page.fields if field.get("type") != "hidden" and field["id"] != "other-catalogue"]
    assert len(shown) == (9 if step == "confirm" else 3 + len(TOLD))
    for field in shown:
        assert field["id"] in page.labels
        described = str(field["aria-describedby"]).split()
        assert any(name.startswith("error-") for name in described)
        assert set(described) <= set(page.ids)


def test_what_was_understood_is_shown(client: httpx.Client, place: str) -> None:
    text = client.get(place).text
    assert "5 s, " in text and "Hz" in text and "acceleration in m/s2" in text
    form = confirmed(text)
    assert [form[f"sensor-{index}"] for index in range(4)] == ["s1-x", "s1-y", "s2-x", "s2-y"]
    assert float(form["speed"]) == pytest.approx(607.3, abs=0.3)
    assert form["estimated"] == form["speed"]
    assert re.search(r"Found in the recording: 60[67]\.\d+ ± 0\.\d+ rpm", text)
    assert "<li>" in text[text.index("Import report") :]


def test_the_form_works_without_scripts(client: httpx.Client, place: str) -> None:
    response = ask(client, place)
    assert response.status_code == 303
    page = client.get(response.headers["location"])
    assert page.status_code == 200
    assert "Joint B is worn: radial clearance" in page.text
    assert "<title>B worn: jointplay</title>" in page.text
    assert "Bands that decided for B and against" in page.text
    assert not Page(page.text).inline
    assert len(Page(page.text).ids) == len(set(Page(page.text).ids))
    again = re.findall(r'href="(/confirm[^"]+)"', page.text)[0].replace("&amp;", "&")
    assert client.get(again).status_code == 200


def test_an_estimate_that_was_not_touched_is_no_given_speed(client: httpx.Client, place: str) -> None:
    key = ask(client, place).headers["location"].rpartition("/")[2]
    notes = {step["name"]: step["found"] for step in provenance(client, key)}
    assert "found in the recording" in notes["drive speed"]
    key = ask(client, place, speed="606,5").headers["location"].rpartition("/")[2]
    notes = {step["name"]: step["found"] for step in provenance(client, key)}
    assert "606.5 rpm, as given" in notes["drive speed"]


def test_a_column_can_be_left_out(client: httpx.Client, place: str) -> None:
    key = ask(client, place, **{"sensor-3": "-"}).headers["location"].rpartition("/")[2]
    notes = {step["name"]: step["found"] for step in provenance(client, key)}
    assert "as s1-x, s1-y, s2-x" in notes["sensors"] and "s2-y" not in notes["sensors"]


def provenance(client: httpx.Client, key: str) -> list[dict[str, str]]:
    steps: list[dict[str, str]] = client.get(f"/api/v1/diagnoses/{key}").json()["provenance"]["recipe"]
    return steps


def test_the_script_is_told_where_to_go(client: httpx.Client, worn: bytes, place: str) -> None:
    response = send(client, worn, htmx=True)
    assert response.status_code == 201
    assert response.headers["location"] == place
    assert place.startswith("/confirm?measurement=")


def test_htmx_gets_a_fragment(client: httpx.Client, place: str) -> None:
    response = ask(client, place, htmx=True, speed="606.8")
    assert response.status_code == 200
    assert "<html" not in response.text
    assert "Joint B is worn" in response.text
    assert "606.8 rpm" in response.text
    assert response.headers["hx-push-url"].startswith("/diagnoses/")
    assert error_of(response.text, "measurement") == ""


def test_the_drawing_of_a_result_can_move(client: httpx.Client, place: str) -> None:
    shown = client.get(ask(client, place).headers["location"])
    moving = client.get(re.findall(r'data-motion="([^"]+)"', shown.text)[0]).json()
    assert len(moving["transforms"]["link-rod"]) == 72
    for name in moving["transforms"]:
        assert re.search(rf'class="[^"]*\b{name}"', shown.text)
    (pin,) = moving["pins"]
    assert (pin["joint"], len(pin["at"])) == ("B", 360)
    assert max(math.hypot(x, y) for x, y in pin["at"]) > 1  # it touches, and does not leave its socket
    assert all(math.hypot(x, y) < 1.5 for x, y in pin["at"])


@pytest.mark.parametrize(
    ("fields", "field", "text"),
    [
        ({"sample_rate": "3 kg"}, "sample_rate", "3 kg"),
        ({"units": '{"s1-x": 3}'}, "units", "s1-x: 3"),
        ({"full_scale": "5 g"}, "full_scale", "does not hold fractions of one"),
        ({"sensitivity": "9 mV/g"}, "sensitivity", "no column is in V"),
        ({"tacho": "key"}, "tacho", "columns are time"),
        ({"window": "hann"}, "window", "holds a recording over time"),
        ({"profile": "skip_lines: -1"}, "profile", "skip_lines"),
        ({"catalogue": "nonsense"}, "catalogue", "there is none"),
        ({"catalogue": ""}, "catalogue", "choose a catalogue"),
    ],
)
@pytest.mark.parametrize("htmx", [True, False])
def test_a_wrong_field_of_the_upload_is_told_beside_it(
    client: httpx.Client, worn: bytes, fields: dict[str, str], field: str, text: str, htmx: bool
) -> None:
    response = send(client, worn, htmx=htmx, **fields)
    assert_told(response, field, text, {"catalogue", "file", *TOLD})
    assert htmx or re.search(r"<details\s+(open)?>", response.text)[1] == ("open" if field in TOLD else None)


@pytest.mark.parametrize(
    ("fields", "field", "text"),
    [
        ({"speed": "fast"}, "speed", "speed: fast: "),
        ({"speed": "-3"}, "speed", "greater than 0"),
        ({"sensor-0": "s1-y"}, "mapping", "sensor s1-y: two columns are said to be it"),
        ({f"sensor-{index}": "-" for index in range(4)}, "mapping", "which sensor"),
        ({"effort": "much"}, "effort", "fast"),
        ({"mode": "much"}, "mode", "robust"),
        ({"prior": "Z=3"}, "prior", "prior.joints.Z: must be one of the joints A, B, O"),
        ({"prior": "A=much"}, "prior", "prior: A=much: must be joint=number"),
        ({"prior": "A=2, A=3"}, "prior", "prior: A=3: is said twice"),
        ({"prior": "A=0"}, "prior", "prior.joints.A: 0.0: must be from 0.001 to 1000"),
    ],
)
@pytest.mark.parametrize("htmx", [True, False])
def test_a_wrong_field_of_the_confirmation_is_told_beside_it(
    client: httpx.Client, place: str, fields: dict[str, str], field: str, text: str, htmx: bool
) -> None:
    response = ask(client, place, htmx=htmx, **fields)
    assert_told(response, field, text, {"measurement", "speed", "effort", "mode", "prior", "mapping"})


def test_what_is_likely_beforehand_is_asked_and_told(client: httpx.Client, place: str) -> None:
    key = ask(client, place, prior="A=3, O = 0.5").headers["location"].rpartition("/")[2]
    assert client.get(f"/api/v1/diagnoses/{key}").json()["prior"]["joints"] == {"A": 3.0, "O": 0.5}
    assert "A 3 times as likely; O 0.5 times as likely" in client.get(f"/api/v1/diagnoses/{key}/report").text


def assert_told(response: httpx.Response, field: str, text: str, fields: set[str]) -> None:
    assert response.status_code in (404, 422)
    assert response.headers["content-type"].startswith("text/html")
    assert text in error_of(response.text, field)
    assert not any(error_of(response.text, other) for other in fields - {field})


@pytest.mark.parametrize("kind", ["no number", "short"])
def test_a_bad_recording_is_told_beside_the_file(client: httpx.Client, worn: bytes, kind: str) -> None:
    response = send(client, spoiled(worn, kind), htmx=True)
    assert response.status_code == 422
    assert error_of(response.text, "file").startswith("worn.csv: ")


def test_columns_that_are_no_sensor_are_asked_for(client: httpx.Client, worn: bytes) -> None:
    head, _, rest = worn.partition(b"\n")
    response = send(client, head.replace(b"s1-", b"left-").replace(b"s2-", b"right-") + b"\n" + rest)
    place = response.headers["location"]
    text = client.get(place).text
    assert "no column is a sensor" in error_of(text, "mapping")
    assert confirmed(text)["sensor-0"] == "-"
    chosen = {f"sensor-{index}": name for index, name in enumerate(("s1-x", "s1-y", "s2-x", "s2-y"))}
    assert "Joint B is worn" in ask(client, place, htmx=True, **chosen).text


def test_a_missing_file_is_told_beside_it(client: httpx.Client) -> None:
    assert error_of(send(client, None, htmx=True).text, "file") == "choose a recording"


def test_a_large_file_is_told_beside_it(client: httpx.Client) -> None:
    response = send(client, b"0" * 3_100_000, htmx=True)
    assert response.status_code == 413
    assert "3 MB" in error_of(response.text, "file")


def test_what_was_typed_stays_and_cannot_become_markup(client: httpx.Client, place: str) -> None:
    response = ask(client, place, speed='"><script>alert(1)</script>')
    assert response.status_code == 422
    assert "<script>alert" not in response.text
    assert "&lt;script&gt;" in response.text


def test_a_hostile_file_name_is_text(client: httpx.Client, worn: bytes) -> None:
    response = client.post(
        "/recordings",
        files={"file": ("<img src=x onerror=alert(1)>.csv", worn)},
        data={"catalogue": "slider-crank"},
    )
    text = client.get(response.headers["location"]).text
    assert "<img" not in text and "&lt;img" in text


def test_a_confirmation_of_nothing_is_a_page(client: httpx.Client) -> None:
    response = client.get("/confirm?measurement=nonsense&catalogue=slider-crank")
    assert response.status_code == 404
    assert "No such measurement" in response.text
    assert client.post("/diagnose", data={"effort": "fast"}).status_code == 422
    assert client.post("/diagnose", content=b"{}").status_code == 415


def test_a_further_recording_is_diagnosed_together_with_a_result(
    client: httpx.Client, place: str, worn: bytes, again: bytes
) -> None:
    """What a suggestion asks for is sent from its page, and both have one answer."""
    client.put("/api/v1/assets/press-2", json={"machine": "slider-crank"}).raise_for_status()
    first = ask(client, place, asset="press-2").headers["location"].removeprefix("/diagnoses/")
    form = client.get("/", params={"catalogue": "slider-crank", "asset": "press-2", "beside": first}).text
    assert f'<input type="hidden" name="beside" value="{first}">' in form
    assert "Diagnosed together with" in form and "worn.csv</a> of" in form
    sent = send(client, again, asset="press-2", beside=first)
    assert sent.status_code == 303
    shown = client.get(sent.headers["location"]).text
    assert confirmed(shown)["beside"] == first and "worn.csv</a> of" in shown
    answer = ask(client, sent.headers["location"])
    assert answer.status_code == 303, answer.text
    made = client.get(f"/api/v1{answer.headers['location']}").json()
    held = client.get(f"/api/v1/diagnoses/{first}").json()["measurement"]
    assert made["measurement"] == held and made["asset"] == "press-2"
    assert [share["sha256"] for share in made["recordings"]] == [
        hashlib.sha256(each).hexdigest() for each in (worn, again)
    ]


def test_each_of_several_recordings_has_a_speed_of_its_own(client: httpx.Client, place: str, again: bytes) -> None:
    """That of the first was given with it, or is found, that of the second is typed, and that of the third is found."""
    found = [
        float(confirmed(client.get(each).text)["estimated"])
        for each in (place, send(client, again).headers["location"])
    ]
    given = [round(1.001 * speed, 2) for speed in found]
    first = ask(client, place, speed=str(given[0])).headers["location"]
    beside = first.removeprefix("/diagnoses/")
    second = ask(client, send(client, again, beside=beside).headers["location"], speed=f"{given[1]} rpm").headers[
        "location"
    ]
    made = client.get(f"/api/v1{second}").json()
    assert [share["drive_speed_rpm"] for share in made["recordings"]] == pytest.approx(given)
    other = gzip.decompress((RECORDINGS / "slider-crank-03.csv.gz").read_bytes())
    third = ask(client, send(client, other, beside=made["id"]).headers["location"]).headers["location"]
    shares = client.get(f"/api/v1{third}").json()["recordings"]
    assert [share["drive_speed_rpm"] for share in shares][:2] == pytest.approx(given)
    assert len(shares) == 3
    beside = ask(client, place).headers["location"].removeprefix("/diagnoses/")
    joined = ask(client, send(client, again, beside=beside).headers["location"], speed=str(given[1]))
    shares = client.get(f"/api/v1{joined.headers['location']}").json()["recordings"]
    assert [share["drive_speed_rpm"] for share in shares] == pytest.approx([found[0], given[1]])


def test_what_does_not_fit_to_a_result_is_told_beside_its_field(client: httpx.Client, place: str, again: bytes) -> None:
    for name in ("press-3", "press-4"):
        client.put(f"/api/v1/assets/{name}", json={"machine": "slider-crank"}).raise_for_status()
    first = ask(client, place, asset="press-3").headers["location"].removeprefix("/diagnoses/")
    where = send(client, again, asset="press-3", beside=first).headers["location"]
    for wrong, field, said in (
        ({"asset": "press-4"}, "asset", "what stands beside it is of asset press-3"),
        ({"asset": ""}, "asset", "asset: none: what stands beside it is of asset press-3"),
        ({"sensor-0": "s1-y", "sensor-1": "s1-x"}, "mapping", "must be one sensor in all recordings of an answer"),
        ({"sensor-3": "-"}, "mapping", "column s2-y: is - here and s2-y in "),
        ({"beside": "nonsense"}, "beside", "nonsense"),
    ):
        refused = ask(client, where, **wrong)
        assert refused.status_code == 422 and said in error_of(refused.text, field), wrong
        assert confirmed(refused.text)["beside"] == wrong.get("beside", first)
    assert send(client, again, beside="nonsense").status_code == 422
    client.delete(f"/api/v1/diagnoses/{first}").raise_for_status()
    gone = ask(client, where)
    assert gone.status_code == 422 and "deleted" in error_of(gone.text, "beside")


def test_a_further_recording_has_the_sensors_of_each_that_stands_beside_it() -> None:
    row = DiagnosisRow(request={"mapping": {"ch0": "s1-x", "line0": "s1-x"}})
    beside = Beside(row, {"m1": ["ch0"], "m2": ["line0"]})
    machine = shipped_machine("slider-crank")
    assert beside.join_sensors({"line0": "s1-x"}, ["line0"], machine) == row.request["mapping"]
    with pytest.raises(BadFieldError, match="column line0: is s1-y here and s1-x in m2: must be one sensor"):
        beside.join_sensors({"line0": "s1-y"}, ["line0"], machine)


def test_an_unknown_result_is_a_page(client: httpx.Client) -> None:
    response = client.get("/diagnoses/nonsense")
    assert response.status_code == 404
    assert "No such diagnosis" in response.text


def test_static_files_are_packaged() -> None:
    assert Path(main.STATIC / "page.css").is_file()


def test_what_the_file_does_not_say_is_asked_for_and_shown(client: httpx.Client, worn: bytes) -> None:
    bare = b"a,b,c,d\n" + b"\n".join(line.partition(b",")[2] for line in worn.splitlines()[1:])
    given: dict[str, str] = {}
    for field, text, value in (
        ("units", "has no unit", "m/s2"),
        ("sample_rate", "give the sample rate", "10 kHz"),
    ):
        response = send(client, bare, **given)
        assert_told(response, field, text, {"catalogue", "file", *TOLD})
        for name, said in given.items():
            assert f'name="{name}" type="text"' in response.text and f'value="{said}"' in response.text
        given[field] = value
    shown = client.get(send(client, bare, **given).headers["location"])
    assert "sample rate 10000 Hz; units m/s2" in shown.text
