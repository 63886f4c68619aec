"""How assets stand over HTTP and on their pages: limits of their own, acknowledged, told by webhooks."""

from __future__ import annotations

import html
import json
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from http_answers import API, assert_problem
from recordings import RECORDINGS
from service_process import client_of, service_process
from small_service import serving
from webhook_listener import Listener, listening

from jointplay.app.pages.history import with_places
from jointplay.app.schemas.webhooks import EVENTS
from jointplay.app.scopes import Scope
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store


@pytest.fixture(scope="module")
def listener() -> Iterator[Listener]:
    with listening() as found:
        yield found


@pytest.fixture(scope="module")
def service(shelf: Path, tmp_path_factory: pytest.TempPathFactory, listener: Listener) -> Iterator[httpx.Client]:
    """A service of these tests alone, that tells the listener everything of assets."""
    data = tmp_path_factory.mktemp("standing")
    settings = ServiceSettings(catalogues=shelf, data=data, workers=1, webhooks_private=True, keys="off")
    with serving(settings) as address, httpx.Client(base_url=address, timeout=300) as client:
        events = [event for event in EVENTS if event.startswith(("asset.", "limit."))]
        client.post(f"{API}/webhooks", json={"url": listener.url, "events": events}).raise_for_status()
        yield client


def put(client: httpx.Client, name: str, **members: Any) -> httpx.Response:
    return client.put(f"{API}/assets/{name}", json={"machine": "slider-crank", **members})


def diagnose(client: httpx.Client, name: str, number: int, **said: str) -> dict[str, Any]:
    file = f"slider-crank-{number:02}.csv.gz"
    asked = {"catalogue": "slider-crank", "asset": name, "effort": "fast", **said}
    answer = client.post(f"{API}/diagnoses", files={"file": (file, (RECORDINGS / file).read_bytes())}, data=asked)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    return found


def standing(client: httpx.Client, name: str) -> dict[str, Any]:
    """How an asset stands when everything is worked out."""
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        found: dict[str, Any] = client.get(f"{API}/assets/{name}").json()["standing"]
        if found["up_to_date"]:
            return found
        time.sleep(0.1)
    raise AssertionError("it was not worked out")


def told(listener: Listener) -> tuple[str, dict[str, Any]]:
    body = json.loads(listener.told.get(timeout=300).body)
    return body["event"], body["data"]


@pytest.mark.long
def test_a_worn_asset_from_its_first_recording_to_its_repair(service: httpx.Client, listener: Listener) -> None:
    assert put(service, "life-1", limits_um={"B": 90}).status_code == 201
    assert standing(service, "life-1")["reasons"][0]["text"] == "There is no recording of it yet."
    moment = (datetime.now(UTC) - timedelta(days=2)).replace(microsecond=0)
    answer = diagnose(service, "life-1", 2, measured_at=moment.isoformat())  # B has 150 um
    found = standing(service, "life-1")
    assert (found["state"], found["over_limit"], found["verdict"]) == ("alarm", ["B"], "worn")
    assert "Joint B is beyond its limit of 90 µm" in found["reasons"][0]["text"]
    assert (found["diagnosis"], datetime.fromisoformat(found["heard_at"])) == (answer["id"], moment)
    # What is said of this recording is said by the same limit, on its page, too.
    assert answer["joints"]["B"]["limit_um"] == 90.0 and answer["joints"]["B"]["p_over_limit"] > 0.9
    assert answer["joints"]["A"]["limit_um"] == 200.0
    assert "B is beyond its limit of 90 µm" in service.get(f"/diagnoses/{answer['id']}").text
    wear = service.get(f"{API}/assets/life-1/state").json()["joints"]
    assert (wear["B"]["limit_um"], wear["A"]["limit_um"]) == (90.0, 200.0)
    assert wear["B"]["p_over_limit"] > 0.5 > wear["A"]["p_over_limit"]
    event, data = told(listener)
    assert (event, data["asset"], data["before"], data["state"]) == (
        "asset.state_changed",
        "life-1",
        "unknown",
        "alarm",
    )
    assert data["reasons"] == found["reasons"] and data["diagnosis"] == answer["id"]
    event, data = told(listener)
    assert (event, data["joint"], data["limit_um"]) == ("limit.predicted", "B", 90.0)
    put(service, "life-1", limits_um={"B": 1000})
    again = service.get(f"{API}/diagnoses/{answer['id']}/verification").raise_for_status().json()
    assert (again["repeated"], again["differences"]) == ("equal", []), "the limit of then goes with the question"
    assert standing(service, "life-1")["state"] == "watch"
    assert told(listener)[1]["state"] == "watch"
    put(service, "life-1", limits_um={"B": 1000}, silent_after_days=1)
    found = standing(service, "life-1")
    assert [reason["about"] for reason in found["reasons"]] == ["joint B", "recordings"]
    assert [told(listener)[0] for _ in range(2)] == ["asset.state_changed", "asset.silent"]
    deep = re.compile(r"rgb\([\d ]+ / (1|0\.[5-9])")
    assert deep.search(service.get("/assets/life-1").text)
    body = {"joints": {"B": {"clearance_um": 150, "repaired": True}}, "at": (moment + timedelta(hours=1)).isoformat()}
    put(service, "life-1", limits_um={"B": 1000})  # before it: silent and repaired, it would be told as unknown first
    assert [reason["about"] for reason in standing(service, "life-1")["reasons"]] == ["joint B"]
    service.post(f"{API}/diagnoses/{answer['id']}/finding", json=body).raise_for_status()
    found = standing(service, "life-1")
    assert (found["state"], found["reasons"]) == ("in_order", [])
    event, data = told(listener)
    assert (event, data["state"]) == ("asset.state_changed", "in_order")
    page = service.get("/assets/life-1").text
    assert "Repaired since: B." in page and not deep.search(page)
    assert listener.told.empty()


@pytest.mark.parametrize(
    ("members", "rule"),
    [
        ({"limits_um": {"Z": 90}}, "limits_um: Z: is no joint of slider-crank that can wear (A, B, O)"),
        ({"limits_um": {"B": 5}}, "limits_um: B: 5: must be above its play as new, 20 um, and at most 100000 um"),
        ({"limits_um": {"B": 2e5}}, "limits_um: B: 200000: must be above its play as new, 20 um, and at most"),
        ({"machine": "nobody's", "limits_um": {"B": 90}}, "limits_um: machine nobody's: is not known here"),
        ({"limits_um": {"B": -1}}, "limits_um.B: "),
        ({"silent_after_days": 0}, "silent_after_days: "),
        ({"warn_within_days": 1.5}, "warn_within_days: "),
    ],
)
def test_limits_that_are_none_are_refused(service: httpx.Client, members: dict[str, Any], rule: str) -> None:
    assert_problem(put(service, "life-refused", **members), 422, rule)
    assert service.get(f"{API}/assets/life-refused").status_code == 404


def test_what_is_seen_is_acknowledged(service: httpx.Client) -> None:
    put(service, "life-2")
    diagnose(service, "life-2", 2)
    assert standing(service, "life-2")["state"] == "watch"
    place = f"{API}/assets/life-2/acknowledgement"
    assert_problem(service.put(place, json={"state": "alarm"}), 422, "state: alarm: life-2 is watch now")
    seen = service.put(place, json={"state": "watch", "note": "bearing is ordered"}).json()["standing"]["acknowledged"]
    assert (seen["by"], seen["note"]) == ("", "bearing is ordered")
    assert "Seen by somebody" in service.get("/assets/life-2").text
    assert service.delete(place).status_code == 204
    assert standing(service, "life-2")["acknowledged"] is None
    assert_problem(service.delete(f"{API}/assets/nobody/acknowledgement"), 404)
    page = service.post("/assets/life-2/acknowledgement", data={"state": "watch", "note": "by <hand>"})
    assert page.status_code == 303
    assert "by &lt;hand&gt;" in service.get("/assets/life-2").text
    stale = service.post("/assets/life-2/acknowledgement", data={"state": "alarm"})
    assert stale.status_code == 422 and "life-2 is watch now" in stale.text
    service.post("/assets/life-2/acknowledgement", data={"again": "yes"})
    assert standing(service, "life-2")["acknowledged"] is None


def test_who_acknowledges_is_the_name_of_the_key(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path, data=tmp_path, keys="required", workers=1)
    with serving(settings) as address, closing(Store(tmp_path)) as store:
        token = Keys(store.database).create("hall B", frozenset({Scope.MATCH, Scope.READ}), timedelta(days=1))[1]
        with httpx.Client(base_url=address, headers={"Authorization": f"Bearer {token}"}, timeout=300) as client:
            put(client, "press-7").raise_for_status()
            seen = client.put(f"{API}/assets/press-7/acknowledgement", json={"state": "unknown"}).json()
    assert seen["standing"]["acknowledged"]["by"] == "hall B"


def test_the_list_says_who_needs_somebody(service: httpx.Client) -> None:
    put(service, "fleet-new", notes="hall <9>")
    put(service, "fleet-worn")
    diagnose(service, "fleet-worn", 2)
    put(service, "fleet-fine")
    diagnose(service, "fleet-fine", 1)
    states = [standing(service, name)["state"] for name in ("fleet-new", "fleet-worn", "fleet-fine")]
    assert states == ["unknown", "watch", "in_order"]
    query = {"search": "FLEET", "order": "urgent"}
    first = service.get(f"{API}/assets", params={**query, "limit": 2}).json()
    rest = service.get(f"{API}/assets", params={**query, "limit": 2, "cursor": first["next_cursor"]}).json()
    names = [item["external_id"] for item in [*first["items"], *rest["items"]]]
    assert (names, rest["next_cursor"]) == (["fleet-worn", "fleet-new", "fleet-fine"], None)
    only = service.get(f"{API}/assets", params={"search": "hall <9", "state": "unknown"}).json()["items"]
    assert [item["external_id"] for item in only] == ["fleet-new"]
    page = service.get("/assets", params={"search": "fleet"}).text
    assert re.findall(r'<a href="/assets/(fleet[^"]*)">', page) == names
    words = re.findall(r'<span class="standing \w+">([^<]+)</span>', page)
    assert words == ["Watch", "Unknown", "In order"]
    assert "hall &lt;9&gt;" in page and "There is no recording of it yet." in page
    assert "None of these." in service.get("/assets", params={"search": "nothing like it"}).text
    assert service.get("/assets", params={"state": "sleepy"}).status_code == 422
    assert_problem(service.get(f"{API}/assets", params={"state": "sleepy"}), 422)


def test_limits_are_set_on_the_page(service: httpx.Client) -> None:
    put(service, "life-3", limits_um={"A": 150}, silent_after_days=7)
    page = service.get("/assets/life-3").text
    assert re.search(r'name="limit-A"[^>]* placeholder="200" value="150"', page)
    form = {"limit-A": "", "limit-B": "80,5", "silent_after_days": "14", "warn_within_days": "60", "notes": "x"}
    assert service.post("/assets/life-3", data=form).status_code == 303
    stored = service.get(f"{API}/assets/life-3").json()
    assert (stored["limits_um"], stored["silent_after_days"], stored["warn_within_days"]) == ({"B": 80.5}, 14, 60)
    for change, said in (
        ({"limit-B": "much"}, "limit of B: much: must be a number"),
        ({"limit-B": "nan"}, "limits_um.B: "),
        ({"silent_after_days": "0"}, "silent_after_days: "),
        ({"warn_within_days": "soon"}, "warn_within_days: soon: must be a number"),
    ):
        refused = service.post("/assets/life-3", data={**form, **change})
        assert refused.status_code == 422 and said in html.unescape(refused.text), refused.text
    assert service.get(f"{API}/assets/life-3").json()["updated_at"] == stored["updated_at"]


@pytest.mark.long
def test_a_change_outlives_kill_9_and_is_told_once_by_two_servers(shelf: Path, tmp_path: Path) -> None:
    with listening() as own:
        folder = tmp_path / "killed"
        folder.mkdir()
        (folder / "catalogues").symlink_to(shelf)
        options = {"builds": "0", "keys": "off", "webhooks_private": "true"}
        with service_process(folder, **options) as running, client_of(running) as client:
            events = ["asset.state_changed", "build.ended"]
            client.post(f"{API}/webhooks", json={"url": own.url, "events": events}).raise_for_status()
            put(client, "killed").raise_for_status()
            standing(client, "killed")
            answer = diagnose(client, "killed", 2)
            running.process.kill()
        with ExitStack() as stack:
            both = [stack.enter_context(service_process(folder, **options)) for _ in range(2)]
            client = stack.enter_context(client_of(both[1]))
            event, data = told(own)
            assert (event, data["state"], data["diagnosis"]) == ("asset.state_changed", "watch", answer["id"])
            build = client.post(
                f"{API}/builds", json={"machine": "slider-crank", "plan": "quick", "catalogue": "x"}
            ).json()
            client.post(f"{API}/builds/{build['id']}/cancel").raise_for_status()
            assert told(own) == (
                "build.ended",
                {
                    "build": build["id"],
                    "machine": "slider-crank",
                    "catalogue": "x",
                    "catalogue_id": None,
                    "state": "cancelled",
                    "message": "",
                },
            ), "nothing else was to be told before"
            assert standing(client, "killed")["state"] == "watch"
        assert own.told.empty()


def test_the_text_of_a_limit_stands_where_there_is_room() -> None:
    ends, limits = (0.0, 100.0), [{"um": 100.0, "text": "limit A"}, {"um": 104.0, "text": "limit B"}]
    free = with_places(limits[:1], [(50.0, 20.0, 60.0)], ends, 200.0)
    assert free == [{"um": 100.0, "text": "limit A", "at": pytest.approx(12.0)}]
    # A finding stands at the first place, a bar over the second, and the text of the other limit is in the way as well.
    taken = [(10.0, 105.0, 105.0), (55.0, 40.0, 120.0)]
    first, second = (each["at"] for each in with_places(limits, taken, ends, 200.0))
    assert first == pytest.approx(30.0) and second == pytest.approx(88.0)


def test_the_trend_has_limits_findings_and_the_date_of_each(service: httpx.Client) -> None:
    put(service, "life-4", limits_um={"B": 400})
    first = datetime.now(UTC).replace(microsecond=0) - timedelta(days=40)
    answer = diagnose(service, "life-4", 2, measured_at=first.isoformat())
    diagnose(service, "life-4", 5, measured_at=(first + timedelta(days=20)).isoformat())
    found = {"joints": {"B": {"clearance_um": 180}}, "at": (first + timedelta(days=21)).isoformat()}
    service.post(f"{API}/diagnoses/{answer['id']}/finding", json=found).raise_for_status()
    page = service.get("/assets/life-4/state").text
    drawn = json.loads(html.unescape(re.findall(r'data-history="([^"]+)"', page)[0]))
    (limit,) = drawn["limits"]
    assert (limit["um"], limit["text"]) == (400.0, "limit B") and drawn["ends"][0] < limit["at"] < drawn["ends"][1]
    assert {"at": (first + timedelta(days=21)).timestamp(), "kind": "finding", "joint": "B", "um": 180} in drawn[
        "events"
    ]
    dates = service.get(f"{API}/assets/life-4/state").json()["joints"]["B"]["limit_at"]
    (reached,) = drawn["reached"]
    assert (reached["name"], reached["um"]) == ("B", 400.0)
    assert reached["at"] == [date and datetime.fromisoformat(date).timestamp() for date in dates]
