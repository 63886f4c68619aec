"""Sensors and units that were said once of the files of an asset, for its next file with the same columns."""

from __future__ import annotations

import json
import re

import httpx
import pytest
from http_answers import API, assert_problem
from recordings import unpacked
from sqlalchemy import select

from jointplay.app.schemas.assets import AssetIn
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.remembered import Remembered, RememberedRow
from jointplay.app.storage.store import Store

UNITS = "m/s2"
CATALOGUE = {"catalogue": "slider-crank", "effort": "fast"}


def renamed(number: int, name: str = "ch", step: int = 1) -> tuple[bytes, dict[str, str]]:
    """A recording whose columns are called like no sensor and have no unit; and which sensor each is.

    Their numbers fall with a step of -1, as of sensors that were plugged in the other way.
    """
    head, _, rest = unpacked(f"slider-crank-{number:02}.csv").decode().partition("\n")
    time, *columns = head.split(",")
    names = [re.sub(r" *\[.*", "", column).strip() for column in columns]
    called = [f"{name}{place}" for place in range(len(names))][::step]
    return "\n".join([",".join([time, *called]), rest]).encode(), dict(zip(called, names, strict=True))


def send(client: httpx.Client, asset: str, number: int, name: str = "ch", step: int = 1, **said: str) -> httpx.Response:
    """Have a recording diagnosed; what is said of it besides is a form, or how its columns are called."""
    content, _ = renamed(number, name, step)
    form = {**CATALOGUE, "asset": asset, **said}
    return client.post(f"{API}/diagnoses", files={"file": (f"{number}.csv", content)}, data=form)


@pytest.fixture(scope="module")
def confirmed(client: httpx.Client) -> dict[str, str]:
    """An asset, of whose first file was said which column is which sensor and what its units are."""
    client.put(f"{API}/assets/own-columns", json={"machine": "slider-crank"}).raise_for_status()
    assert_problem(send(client, "own-columns", 2), 422)
    mapping = renamed(2)[1]
    as_json = str(mapping).replace("'", '"')
    first = send(client, "own-columns", 2, units=UNITS, mapping=as_json)
    assert first.status_code == 201, first.text
    assert (first.json()["mapping"], first.json()["mapping_remembered"]) == (mapping, False)
    return mapping


def test_the_second_file_needs_to_say_nothing(client: httpx.Client, confirmed: dict[str, str]) -> None:
    second = send(client, "own-columns", 1)
    assert second.status_code == 201, second.text
    found = second.json()
    assert (found["mapping"], found["mapping_remembered"], found["verdict"]) == (confirmed, True, "in_order")
    measured = client.get(f"{API}/measurements/{found['measurement']}").json()
    assert measured["told"] == {"units": {"*": UNITS}}
    assert measured["import_report"][-1].startswith("as said of the last file of asset own-columns with these columns:")
    assert "as confirmed for the last recording of own-columns" in client.get(f"/diagnoses/{found['id']}").text
    alone = client.post(
        f"{API}/measurements", files={"file": ("3.csv", renamed(3)[0])}, data={"asset": "own-columns"}
    ).json()
    assert alone["told"] == {"units": {"*": UNITS}}
    stored = {**CATALOGUE, "asset": "own-columns", "measurement": alone["id"]}
    assert client.post(f"{API}/diagnoses", json=stored).json()["mapping_remembered"] is True


def test_what_is_said_wins_and_other_assets_know_nothing(client: httpx.Client, confirmed: dict[str, str]) -> None:
    client.put(f"{API}/assets/other-columns", json={"machine": "slider-crank"}).raise_for_status()
    assert_problem(send(client, "other-columns", 1), 422)
    said = send(client, "own-columns", 1, units="g")
    measured = client.get(f"{API}/measurements/{said.json()['measurement']}").json()
    assert measured["told"] == {"units": {"*": "g"}}
    assert_problem(send(client, "own-columns", 1, mapping='{"ch0": "nowhere"}'), 422, "nowhere")
    send(client, "own-columns", 1, units=UNITS)  # as it was


def test_the_page_shows_it_and_it_can_be_changed(client: httpx.Client, confirmed: dict[str, str]) -> None:
    files = {"file": ("1.csv", renamed(1)[0])}
    sent = client.post("/recordings", data={"catalogue": "slider-crank", "asset": "own-columns"}, files=files)
    assert sent.status_code == 303, sent.text
    page = client.get(sent.headers["location"]).text
    assert "As confirmed for the last recording of own-columns with these columns." in page
    assert "no column is a sensor" not in page and "Found in the recording" in page, page
    chosen = re.findall(r'<option value="([^"]*)" selected>\1</option>', page)
    assert chosen[: len(confirmed)] == list(confirmed.values())
    last = len(confirmed) - 1
    form = {
        **CATALOGUE,
        "asset": "own-columns",
        "measurement": httpx.URL(sent.headers["location"]).params["measurement"],
    }
    sensors = {f"sensor-{place}": sensor for place, sensor in enumerate(confirmed.values())}
    changed = {**form, **sensors, f"sensor-{last}": "-"}
    assert client.post("/diagnose", data=changed).status_code == 303
    page = client.get(sent.headers["location"]).text
    assert re.search(rf'name="sensor-{last}"[^>]*>\s*<option value="-" selected>', page)
    assert client.post("/diagnose", data={**form, **sensors}).status_code == 303


def test_a_baseline_keeps_its_sensors_when_they_are_plugged_in_otherwise(client: httpx.Client) -> None:
    asset = "plugged-otherwise"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    said = {"units": UNITS, "mapping": json.dumps(renamed(1)[1])}
    first = send(client, asset, 1, **said).json()
    wanted = {"machine": "slider-crank", "baselines": [first["measurement"]]}
    client.put(f"{API}/assets/{asset}", json=wanted).raise_for_status()
    as_before = send(client, asset, 2, **said).json()
    assert as_before["baseline"] is not None
    otherwise = send(client, asset, 2, step=-1, units=UNITS, mapping=json.dumps(renamed(2, step=-1)[1])).json()
    for member in ("verdict", "hypotheses", "past", "baseline"):
        assert otherwise[member] == as_before[member]
    (told,) = set(otherwise["warnings"]) - set(as_before["warnings"])
    assert re.fullmatch(
        "baseline 1.csv: column ch0, ch1, ch2, ch3: is another sensor there .*, as was said of it", told
    )
    again = client.get(f"{API}/diagnoses/{otherwise['id']}/verification").json()
    assert again["repeated"] == "equal", again


def test_what_was_said_of_a_recording_is_not_what_was_said_of_the_last_one(client: httpx.Client) -> None:
    """Also of a stored one that is asked about again, and of two with the same columns that were plugged otherwise."""
    asset = "plugged-twice"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    keys = []
    for number, step in ((1, 1), (2, -1)):
        mapping = json.dumps(renamed(number, step=step)[1])
        keys.append(send(client, asset, number, step=step, units=UNITS, mapping=mapping).json()["measurement"])
    again = {**CATALOGUE, "asset": asset, "measurement": keys[0], "effort": "standard"}
    answer = client.post(f"{API}/diagnoses", json=again).json()
    assert (answer["mapping"], answer["verdict"]) == (renamed(1)[1], "in_order")
    together = {**CATALOGUE, "asset": asset, "measurements": keys}
    refused = client.post(f"{API}/diagnoses", json=together)
    assert_problem(refused, 422, "mapping: column ch3: is s1-x in one of them and s2-y in another, as was said of them")
    # The next file is read as the last one was said to be.
    assert send(client, asset, 3, step=-1).json()["mapping"] == renamed(3, step=-1)[1]


def test_recordings_with_different_columns_have_one_answer_by_what_was_said_of_each(client: httpx.Client) -> None:
    asset = "two-loggers"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    keys = []
    for number, name in ((2, "ch"), (3, "line")):
        mapping = json.dumps(renamed(number, name)[1])
        keys.append(send(client, asset, number, name, units=UNITS, mapping=mapping).json()["measurement"])
    together = {**CATALOGUE, "asset": asset, "measurements": keys}
    answer = client.post(f"{API}/diagnoses", json=together)
    assert answer.status_code == 201, answer.text
    assert answer.json()["mapping"] == renamed(2)[1] | renamed(3, "line")[1]
    # Beside one whose columns of the same names are other sensors nothing is guessed.
    content, _ = renamed(4, step=-1)
    head, *rows = content.rstrip().split(b"\n")
    content = b"\n".join([head + b",more", *(row + b",%d" % (place % 7) for place, row in enumerate(rows))])
    form = {**CATALOGUE, "asset": asset, "units": UNITS, "mapping": json.dumps(renamed(4, step=-1)[1])}
    other = client.post(f"{API}/diagnoses", files={"file": ("4.csv", content)}, data=form).json()
    together["measurements"] = [keys[0], other["measurement"]]
    refused = client.post(f"{API}/diagnoses", json=together)
    assert_problem(refused, 422, "mapping: column ch3: is s1-x in one of them and s2-y in another, as was said of them")


def test_what_was_said_last_is_kept_in_every_database(store: Store) -> None:
    assets, known = Assets(store.database), Remembered(store.database)
    for name in ("a", "b"):
        assets.put(name, AssetIn.model_validate({"machine": "m"}))
    units = {"units": {"*": "g"}}
    with store.database.writing() as session:
        known.remember(session, "a", ["x", "y"], units)
        known.remember(session, "a", ["y", "x"], {}, {"x": "s1"})
        known.remember(session, "b", ["x"], {}, None)
    assert known.mapping("a", ["x", "y"]) == {"x": "s1"}
    assert [said for _, said in known.all_said("a")] == [units]
    assert (known.mapping("a", ["x"]), known.mapping("b", ["x", "y"]), known.all_said("b")) == (None, None, [])
    assert (known.has_mappings("a"), known.has_mappings("b")) == (True, False)
    with store.database.writing() as session:
        known.remember(session, "a", ["x", "y"], {}, {})
    assert known.mapping("a", ["x", "y"]) == {}
    with store.database.reading() as session:
        assert len(list(session.scalars(select(RememberedRow)))) == 1
