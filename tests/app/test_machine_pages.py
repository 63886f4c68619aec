"""The pages of machines without a browser, and their versions and checks over HTTP."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from small_service import asking, serving

from jointplay.app.routes.machines import MACHINE_YAML
from jointplay.app.scopes import Scope
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store
from jointplay.solver.machines.machine import shipped_machine, shipped_machine_names, shipped_machine_text

API = "/api/v1/machines"
YAML = {"Content-Type": "application/yaml"}
OPEN = shipped_machine_text("slider-crank").replace("at: [0.2, 0.05], pin", "at: [0.02, 0.05], pin")
"""A slider-crank whose rod is too short to go round."""


@pytest.fixture(scope="module")
def site(shelf: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    settings = ServiceSettings(catalogues=shelf, data=tmp_path_factory.mktemp("machines"), workers=1, keys="off")
    with asking(settings, headers={"Accept": "text/html"}) as client:
        yield client


def save(site: httpx.Client, name: str, text: str, **more: str) -> httpx.Response:
    return site.post("/machines/new", data={"name": name, "text": text, **more})


def etag_of(page: str) -> str:
    found = re.search(r'name="etag" value="([^"]+)"', page)
    assert found is not None
    return html.unescape(found[1])


def text_of(page: str) -> str:
    found = re.search(r"<textarea.*?>\n(.*?)</textarea>", page, re.DOTALL)
    assert found is not None
    return html.unescape(found[1])


def test_the_list_shows_every_machine_drawn_and_who_uses_it(site: httpx.Client) -> None:
    site.put("/api/v1/assets/press-9", json={"machine": "four-bar"}).raise_for_status()
    page = site.get("/machines").text
    for name in shipped_machine_names():
        assert f'href="/machines/{name}"' in page and f'href="/machines/new?start={name}"' in page
    assert page.count('class="machine-drawing"') == len(re.findall(r'<li class="card">', page))
    cards = {re.findall(r'href="/machines/([^"]+)"', card)[0]: card for card in page.split('<li class="card">')[1:]}
    assert 'Catalogues: <a href="/catalogues/slider-crank">' in cards["slider-crank"]
    assert 'Assets: <a href="/assets/press-9">' in cards["four-bar"]
    assert "No catalogue or asset uses it" in cards["quick-return"]


def test_a_shipped_machine_is_a_start_and_stays_as_it_is(site: httpx.Client) -> None:
    page = site.get("/machines/slider-crank").text
    assert "readonly" in page and ">Save<" not in page and "4, of which 3 are integrated" in page
    assert "20.9 Hz" in page and "drive: order 2 is at 20 Hz, in the resonance" in page
    assert text_of(site.get("/machines/new?start=slider-crank").text) == shipped_machine_text("slider-crank")
    refused = site.post("/machines/slider-crank", data={"text": MACHINE_YAML})
    assert refused.status_code == 409 and "ships with the program" in refused.text


def test_a_machine_is_brought_and_changed_and_taken_back(site: httpx.Client) -> None:
    saved = save(site, "pendulum-1", f"# mine\n{MACHINE_YAML}".replace("\n", "\r\n"))  # as browsers send it
    assert (saved.status_code, saved.headers["location"]) == (303, "/machines/pendulum-1")
    page = site.get("/machines/pendulum-1").text
    assert text_of(page) == f"# mine\n{MACHINE_YAML}", "comments stay"
    heavier = MACHINE_YAML.replace("1.2 kg", "1.5 kg")
    changed = site.post("/machines/pendulum-1", data={"text": heavier, "etag": etag_of(page)})
    assert changed.status_code == 303
    assert [row["number"] for row in site.get(f"{API}/pendulum-1/versions").json()["items"]] == [2, 1]
    old = site.get("/machines/pendulum-1?version=1").text
    assert text_of(old) == f"# mine\n{MACHINE_YAML}" and "Saved, it becomes the newest" in old
    back = site.post("/machines/pendulum-1", data={"text": text_of(old), "etag": etag_of(old)})
    assert back.status_code == 303
    assert site.get(f"{API}/pendulum-1").json()["links"]["arm"]["mass"] == 1.2
    file = site.get(f"{API}/pendulum-1/file")
    assert file.text == f"# mine\n{MACHINE_YAML}"
    assert file.headers["content-disposition"] == 'attachment; filename="pendulum-1.yaml"'
    assert site.get(f"{API}/pendulum-1/file?version=2").text == heavier
    items = site.get(f"{API}/pendulum-1/versions", params={"limit": 2}).json()
    assert [row["number"] for row in items["items"]] == [3, 2]
    rest = site.get(f"{API}/pendulum-1/versions", params={"cursor": items["next_cursor"]}).json()
    assert [row["number"] for row in rest["items"]] == [1] and rest["next_cursor"] is None
    for place in (
        f"{API}/pendulum-1/file?version=4",
        "/machines/pendulum-1?version=4",
        "/machines/pendulum-1?version=x",
    ):
        assert site.get(place).status_code == 404


def test_two_editors_do_not_overwrite_each_other(site: httpx.Client) -> None:
    save(site, "pendulum-2", MACHINE_YAML)
    etag = etag_of(site.get("/machines/pendulum-2").text)
    mine, theirs = (MACHINE_YAML.replace("1.2 kg", f"{mass} kg") for mass in (2, 3))
    assert site.post("/machines/pendulum-2", data={"text": theirs, "etag": etag}).status_code == 303
    late = site.post("/machines/pendulum-2", data={"text": mine, "etag": etag})
    assert late.status_code == 412 and "Somebody else has saved this machine" in late.text
    assert text_of(late.text) == mine, "what was typed stays"
    assert etag_of(late.text) == etag, "the same again is refused again"
    assert site.get(f"{API}/pendulum-2").json()["links"]["arm"]["mass"] == 3
    assert site.post("/machines/pendulum-2", data={"text": mine}).status_code == 412
    twice = save(site, "pendulum-2", mine)
    assert twice.status_code == 412 and "There is a machine of this name already" in twice.text


@pytest.mark.parametrize(
    ("name", "text", "status", "said"),
    [
        ("", MACHINE_YAML, 422, "give it a name"),
        ("Press 7", MACHINE_YAML, 422, "must be 1 to 63 of a-z"),
        ("new", MACHINE_YAML, 422, "not the word new"),
        ("press-8", "", 422, "write or load a machine file"),
        (
            "press-8",
            MACHINE_YAML.replace("mass", "mas"),
            422,
            "<strong>Line 4:</strong> links.arm.mas: 1.2 kg: unknown",
        ),
        ("press-8", OPEN, 422, "cannot be assembled"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_stored(
    site: httpx.Client, name: str, text: str, status: int, said: str
) -> None:
    answer = save(site, name, text)
    assert answer.status_code == status
    assert said in html.unescape(answer.text)
    assert text_of(answer.text).strip() == text.strip(), "what was typed stays"
    assert site.get(f"{API}/press-8").status_code == 404


def test_a_text_is_checked_without_being_stored(site: httpx.Client) -> None:
    """By the script, which keeps what was drawn last, without one, and over HTTP."""
    wrong = "\n" + MACHINE_YAML.replace("at: [0, 0]", "at: [0]")
    fragment = site.post("/machines/check", data={"text": wrong}, headers={"HX-Request": "true"}).text
    assert 'data-line="7"' in fragment and "svg" not in fragment and 'id="account"' not in fragment
    open_one = site.post("/machines/check", data={"text": OPEN}, headers={"HX-Request": "true"}).text
    assert "cannot be assembled" in open_one and " open<" in open_one and 'id="account"' not in open_one
    right = site.post("/machines/check", data={"text": MACHINE_YAML}, headers={"HX-Request": "true"}).text
    assert "A valid machine." in right and "svg" in right and "0 of 8 unknowns" in right
    bare = shipped_machine_text("slider-crank").replace("speed: 62.831853072", "speed: 600")
    doubted = html.unescape(site.post("/machines/check", data={"text": bare}).text)
    assert "<dt>Drive</dt><dd>O at 5729.58 rpm</dd>" in doubted
    assert "drive.speed: 600 is in rad/s: 5729.6 rpm; write 600rpm if that was meant" in doubted
    assert "slider-crank, drive O at 600 rpm</option>" in site.get("/builds").text
    whole = site.post("/machines/check", data={"text": wrong, "name": "mine"}).text
    assert "<strong>Line 7:</strong>" in whole and text_of(whole) == wrong and 'value="mine"' in whole
    said = site.post(f"{API}/check", content=wrong, headers=YAML).json()
    assert said["account"] is None
    assert (said["refusal"]["line"], said["refusal"]["field"]) == (7, "joints.O.at")
    checked = site.post(f"{API}/check", content=shipped_machine_text("slider-crank"), headers=YAML).json()
    assert checked["refusal"] is None
    assert checked["account"]["content_key"] == shipped_machine("slider-crank").content_key
    assert [mode["motion"] for mode in checked["account"]["suspension_modes"]] == ["x", "y", "theta"]
    refused = site.put(f"{API}/mine", content=wrong, headers=YAML).json()
    assert refused["errors"][0]["line"] == 7


def test_machines_of_before_versions_were_kept_keep_what_they_were(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", workers=1)
    folder = settings.data / "machines"
    folder.mkdir(parents=True)
    (folder / "old.json").write_text(shipped_machine("four-bar").canonical_json())
    with asking(settings) as client:
        assert [row["number"] for row in client.get(f"{API}/old/versions").json()["items"]] == [1]
        client.put(f"{API}/old", content=MACHINE_YAML, headers=YAML).raise_for_status()
        assert [row["number"] for row in client.get(f"{API}/old/versions").json()["items"]] == [2, 1]
        first = client.get(f"{API}/old/file?version=1")
        assert first.headers["content-disposition"].endswith('"old.json"')
        back = client.put(f"{API}/old", content=first.content, headers={"Content-Type": "application/json"})
        assert back.json() == shipped_machine("four-bar").model_dump(mode="json")


def test_who_may_not_build_looks_on(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path, data=tmp_path / "data", builds=0, workers=1, keys="required")
    with serving(settings) as address:
        store = Store(settings.data)
        token = Keys(store.database).create("reader", frozenset({Scope.READ, Scope.MATCH}), timedelta(days=1))[1]
        store.close()
        with httpx.Client(base_url=address, timeout=300, headers={"Accept": "text/html", "Origin": address}) as reader:
            reader.post("/sign-in", data={"key": token})
            assert "Bring your own" not in reader.get("/machines").text
            page = reader.get("/machines/four-bar").text
            assert "readonly" in page and "Use as a start" not in page
            assert save(reader, "mine", MACHINE_YAML).status_code == 403
