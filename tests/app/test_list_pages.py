"""The pages that list recordings and diagnoses: what was sent is found again, also when nothing was asked of it."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from http_answers import API, send
from small_service import serving
from test_wear_state import diagnose

from jointplay.app.settings import ServiceSettings


@pytest.fixture(scope="module")
def client(settings: ServiceSettings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    own = settings.model_copy(update={"data": tmp_path_factory.mktemp("lists"), "page_size": 2})
    with serving(own) as server, httpx.Client(base_url=server, timeout=300) as running:
        yield running


@pytest.fixture(scope="module")
def sent(client: httpx.Client, worn: bytes) -> tuple[dict[str, Any], list[str]]:
    """A diagnosis of an asset, and the ids of two recordings that came after its own."""
    assert "None yet." in client.get("/measurements").text and "None yet." in client.get("/diagnoses").text
    client.put(f"{API}/assets/press-7", json={"machine": "slider-crank"}).raise_for_status()
    answer = diagnose(client, 2, "press-7", "first.csv.gz")
    return answer, [send(client, worn, name).json()["id"] for name in ("<second>.csv", "third.csv")]


def listed(text: str) -> list[str]:
    return re.findall(r'<th scope="row" class="named"><a href="/([^"]+)"', text)


def test_recordings_are_listed_newest_first_page_by_page(client: httpx.Client, sent: Any) -> None:
    answer, (second, third) = sent
    page = client.get("/measurements").text
    assert listed(page) == [f"measurements/{third}", f"measurements/{second}"]
    assert "&lt;second&gt;.csv" in page and page.count('<td class="named">none</td>') == 2
    (older,) = re.findall(r'href="(/measurements\?cursor=[^"]+)">Older', page)
    last = client.get(older).text
    assert listed(last) == [f"measurements/{answer['measurement']}"]
    assert (
        'href="/assets/press-7"' in last and f'<a href="/diagnoses?measurement={answer["measurement"]}">1</a>' in last
    )
    assert 'href="/measurements">Newest' in last and "Older" not in last
    refused = client.get("/measurements", params={"cursor": "!"})
    assert refused.status_code == 400 and "is not a cursor of this list" in refused.text


def test_diagnoses_are_listed_of_all_and_of_one_recording(client: httpx.Client, sent: Any) -> None:
    answer, (second, _) = sent
    key = answer["measurement"]
    for place in ("/diagnoses", f"/diagnoses?measurement={key}"):
        page = client.get(place).text
        assert listed(page) == [f"diagnoses/{answer['id']}"]
        assert f'<a href="/measurements/{key}?diagnosis={answer["id"]}">first.csv.gz</a>' in page
    assert listed(client.get("/diagnoses", params={"measurement": second}).text) == []
    assert client.get("/diagnoses", params={"measurement": "nobody"}).status_code == 404


def test_what_was_understood_leads_to_the_recording_and_a_page_to_the_lists(client: httpx.Client, sent: Any) -> None:
    _, (second, _) = sent
    page = client.get("/confirm", params={"measurement": second, "catalogue": "slider-crank"}).text
    assert f'<a href="/measurements/{second}">Look at the recording</a>' in page
    footer = page[page.index("<footer>") :]
    assert 'href="/measurements"' in footer and 'href="/diagnoses"' in footer


def test_moments_of_a_recording_and_of_the_fleet_are_shown_in_the_zone_of_the_reader(
    client: httpx.Client, sent: Any
) -> None:
    answer, _ = sent
    page = client.get(f"/measurements/{answer['measurement']}").text
    assert re.search(r'<dt>Measured</dt><dd><time datetime="', page)
    asked = re.escape(answer["created_at"][:16])
    assert re.search(rf'<a href="/diagnoses/{answer["id"]}">[^<]+</a> \(<time datetime="{asked}Z">', page)
    deadline = time.monotonic() + 60
    while (row := re.search(r'<a class="piece" href="/diagnoses/.*', fleet := client.get("/assets").text)) is None:
        assert time.monotonic() < deadline, fleet
        time.sleep(0.2)
    assert '<time datetime="' in row[0]


def test_a_speed_is_called_not_found_only_where_it_was_looked_for(client: httpx.Client, worn: bytes) -> None:
    head, rest = worn.split(b"\n", 1)
    strange = re.sub(rb"s(\d)-", rb"probe\1 ", head) + b"\n" + rest
    unknown = send(client, strange, "strange.csv").json()["id"]
    page = client.get("/confirm", params={"measurement": unknown, "catalogue": "slider-crank"}).text
    assert "It is looked for in the columns whose sensors are said above." in page and "was not found" not in page


def test_a_diagnosis_of_what_was_deleted_stays_listed(client: httpx.Client, sent: Any) -> None:
    answer, _ = sent
    client.delete(f"{API}/measurements/{answer['measurement']}").raise_for_status()
    page = client.get("/diagnoses").text
    assert listed(page) == [f"diagnoses/{answer['id']}"] and "deleted or damaged" in page
