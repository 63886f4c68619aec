"""The pages of builds without a browser: what they say, refuse and do, and that they need no script."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
import troubled_catalogue
from small_service import asking, serving

from jointplay.app.pages.build_view import PLANS, build_view, duration_text
from jointplay.app.scopes import Scope
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.build_queue import BuildQueue, BuildRow
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store
from jointplay.catalogue.plans.plan import preset_names

FORM = {"machine": "slider-crank", "plan": "quick", "catalogue": "mine"}
HTML = {"Accept": "text/html"}


@dataclass
class Site:
    """A service that leaves its builds to the test, which is a server of the same database."""

    client: httpx.Client
    queue: BuildQueue
    folder: Path

    def asked(self, name: str) -> str:
        """Ask for a build as the form does; returns its page's address."""
        answer = self.client.post("/builds", data={**FORM, "catalogue": name})
        assert answer.status_code == 303, answer.text
        return str(answer.headers["location"])

    def taken(self) -> BuildRow:
        row = self.queue.claim("test", 1000.0)
        assert row is not None
        return row


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    settings = ServiceSettings(
        catalogues=tmp_path / "catalogues", data=tmp_path / "data", builds=0, workers=1, page_size=2
    )
    with asking(settings, headers=HTML) as client:
        store = Store(settings.data)
        yield Site(client, BuildQueue(store.database), settings.catalogues)
        store.close()


def error_of(text: str, field: str) -> str:
    found = re.search(rf'<p class="error" id="error-{field}"[^>]*>([^<]*)</p>', text)
    assert found is not None
    return found[1]


def test_every_shipped_plan_is_explained() -> None:
    assert tuple(PLANS) == preset_names()


def test_a_build_is_asked_for_followed_and_done_without_scripts(site: Site) -> None:
    place = site.asked("mine")
    page = site.client.get(place).text
    assert "Waiting" in page and "<noscript>" in page and "Go on with it" not in page
    row = site.taken()
    assert place == f"/builds/{row.id}" and (row.machine["name"], row.plan["name"]) == ("slider-crank", "quick")
    site.queue.beat(
        row.id, "test", 1000.0, {"cases_done": 30, "cases_total": 120, "rate_per_s": 2.5, "seconds_left": 36}
    )
    page = site.client.get(place).text
    assert "30 of 120 cases (25 %)" in page and "2.5 cases a second, about 36 s left" in page
    assert '<progress class="long" max="120" value="30"' in page
    total, failed = troubled_catalogue.make(site.folder / "mine")
    values = {"catalogue_id": "c" * 64, "cases_done": total, "cases_total": total}
    site.queue.end(row.id, "test", "done", {**values, "message": f"cases without a spectrum: {failed} diverged"})
    page = site.client.get(place).text
    assert "Done" in page and "data-events" not in page and "<noscript>" not in page and "Cancel" not in page
    assert f"{failed} of the catalogue" in page
    assert page.count("left &lt;the range&gt; at t = 0.1 s") == failed
    for link in re.findall(r'href="(/api/v1/catalogues/mine/entries/[0-9a-f]{64})"', page):
        assert site.client.get(link, headers={"Accept": "application/json"}).json()["status"] == "diverged"
    assert site.client.get(re.findall(r'class="button" href="([^"]+)"', page)[0]).status_code == 200
    assert "done" in site.client.get("/builds").text


def test_a_build_is_cancelled_and_gone_on_with(site: Site) -> None:
    place = site.asked("mine")
    refused = site.client.post(f"{place}/resume")
    assert refused.status_code == 409 and "goes on by itself" in refused.text
    assert site.client.post(f"{place}/cancel").headers["location"] == place
    page = site.client.get(place).text
    assert "Cancelled" in page and "What was computed is kept" in page
    again = site.client.post(f"{place}/resume").headers["location"]
    assert again != place
    row = site.taken()
    assert again == f"/builds/{row.id}"
    first = site.queue.find(place.rpartition("/")[2])
    assert (row.machine, row.plan, row.catalogue) == (first.machine, first.plan, first.catalogue)
    site.client.post(f"{again}/cancel")
    page = site.client.get(again).text
    assert "Stopping" in page and 'action="' + again + '/cancel"' not in page
    site.queue.end(row.id, "test", "failed", {"message": "the disk <is> full"})
    assert "the disk &lt;is&gt; full" in site.client.get(again).text
    refused = site.client.post(f"{again}/cancel")
    assert refused.status_code == 409 and "is failed already" in refused.text


@pytest.mark.parametrize(
    ("change", "status", "field", "text"),
    [
        ({"machine": "loom"}, 422, "machine", "machine: loom: there is none of this name"),
        ({"plan": "quik"}, 422, "plan", "is not a shipped plan; did you mean"),
        ({"plan": ""}, 422, "plan", "choose a plan"),
        ({"catalogue": ""}, 422, "catalogue", "give it a name"),
        ({"catalogue": "../up"}, 422, "catalogue", "catalogue: "),
        ({"catalogue": "my press"}, 422, "catalogue", "must be 1 to 64 letters, digits, . _ and -, without blanks"),
        ({"machine": "four-bar", "catalogue": "taken"}, 409, "catalogue", "taken: is a catalogue of another machine"),
    ],
)
def test_a_refusal_is_told_beside_its_field(
    site: Site, change: dict[str, str], status: int, field: str, text: str
) -> None:
    troubled_catalogue.make(site.folder / "taken")
    answer = site.client.post("/builds", data={**FORM, **change})
    assert answer.status_code == status
    assert text in error_of(answer.text, field)
    assert not any(error_of(answer.text, other) for other in {"machine", "plan", "catalogue"} - {field})
    assert f'value="{change.get("catalogue", "mine")}"' in answer.text, "what was typed stays"
    assert site.queue.list_builds(None, 9) == []


def test_other_refusals_are_told_above_the_form(site: Site) -> None:
    unknown = f"/builds/{'0' * 32}"
    for answer in (
        site.client.get(unknown),
        site.client.post(f"{unknown}/cancel"),
        site.client.post(f"{unknown}/resume"),
    ):
        assert answer.status_code == 404 and "No such build" in answer.text
    answer = site.client.get("/builds?cursor=nonsense")
    assert answer.status_code == 400 and "is not a cursor of this list" in answer.text
    answer = site.client.get("/nowhere")
    assert answer.status_code == 404 and "Nothing is at this address." in answer.text


def test_the_list_goes_back_page_by_page(site: Site) -> None:
    places = [site.asked(f"c{number}") for number in range(5)]
    seen: list[str] = []
    following: str | None = "/builds"
    while following is not None:
        text = site.client.get(following).text
        seen += re.findall(r'href="(/builds/[0-9a-f]{32})"', text)
        found = re.search(r'href="(/builds\?cursor=[^"]+)"', text)
        following = found[1] if found else None
    assert seen == places[::-1]


def test_who_may_not_build_is_told_so(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path, data=tmp_path / "data", builds=0, workers=1, keys="required")
    with serving(settings) as address:
        store = Store(settings.data)
        token = Keys(store.database).create("reader", frozenset({Scope.READ, Scope.MATCH}), timedelta(days=1))[1]
        store.close()
        with httpx.Client(base_url=address, headers={**HTML, "Origin": address}, timeout=300) as reader:
            reader.post("/sign-in", data={"key": token})
            page = reader.get("/builds").text
            assert "it has not the scope <code>build</code>" in page and "<select" not in page
            refused = reader.post("/builds", data=FORM)
    assert refused.status_code == 403
    assert refused.headers["content-type"].startswith("text/html")
    assert "has not the scope build" in refused.text and "Sign out" in refused.text


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.2, "1 s"), (59.6, "60 s"), (150, "2 min"), (7300, "2 h"), (200_000, "2 days")]
)
def test_durations(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_a_build_that_looks_about_says_so(site: Site) -> None:
    site.asked("mine")
    view = build_view(site.taken())
    assert view["count"] == "Looking what is to be computed…"
    assert (view["pace"], view["attempt"]) == ("", "")
