"""Builds in a real browser: asked for on the page, followed live to the end, and on to the catalogue.

The service leaves its builds to the test, which says how far they are: so nothing waits for a simulation.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from real_browser import SCREENS, Visit, is_within_screen, serious, visiting
from small_service import serving

from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.store import Store

LONG = f"mine-{'x' * 59}"  # as long as a name may be, without a place to break it


@pytest.fixture
def settings(tmp_path: Path) -> ServiceSettings:
    return ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", builds=0, workers=1)


@pytest.fixture
def queue(settings: ServiceSettings) -> Iterator[BuildQueue]:
    store = Store(settings.data)
    yield BuildQueue(store.database)
    store.close()


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, settings: ServiceSettings) -> Iterator[Visit]:
    with serving(settings) as address, visiting(browser, address, request.param) as found:
        yield found


def ask(page: Page, name: str) -> None:
    page.get_by_label("Machine", exact=True).select_option("slider-crank")
    page.get_by_label("Name of the catalogue").fill(name)
    page.get_by_role("radio", name="quick").check()
    page.get_by_role("button", name="Build").click()


@pytest.mark.long
def test_from_the_form_to_the_catalogue(
    visit: Visit, queue: BuildQueue, settings: ServiceSettings, shelf: Path
) -> None:
    page = visit.page
    page.get_by_role("link", name="Builds").click()
    expect(page.get_by_role("heading", name="Build a catalogue")).to_be_visible()
    assert is_within_screen(page) and serious(page) == []
    ask(page, "not/a/name")
    expect(page.locator("#error-catalogue")).to_contain_text("catalogue: ")
    assert page.evaluate("document.activeElement.id") == "catalogue"
    assert serious(page) == []
    ask(page, LONG)
    state, count = page.locator("[data-part=state] .state"), page.locator(".count")
    expect(state).to_have_text("Waiting")
    row = queue.claim("test", 1000.0)
    assert row is not None
    expect(state).to_have_text("Running")
    cancel = page.get_by_role("button", name="Cancel")
    cancel.focus()
    queue.beat(row.id, "test", 1000.0, {"cases_done": 30, "cases_total": 120, "rate_per_s": 2.5, "seconds_left": 36})
    expect(count).to_have_text("30 of 120 cases (25 %) 2.5 cases a second, about 36 s left")
    expect(page.get_by_role("progressbar")).to_have_attribute("value", "30")
    expect(cancel).to_be_focused()
    assert is_within_screen(page) and serious(page) == []
    shutil.copytree(shelf / "slider-crank", settings.catalogues / LONG)
    queue.end(row.id, "test", "done", {"catalogue_id": "c" * 64, "cases_done": 120, "message": ""})
    expect(state).to_have_text("Done")
    expect(cancel).to_have_count(0)
    assert is_within_screen(page) and serious(page) == []
    page.get_by_role("link", name="Look at the catalogue").click()
    expect(page.get_by_role("heading", name=f"{LONG}: worn against in order")).to_be_visible()
    assert is_within_screen(page)
    page.go_back()
    expect(state).to_have_text("Done")
    page.get_by_role("link", name="All builds").click()
    expect(page.get_by_role("row", name=LONG)).to_contain_text("120 of 120")
    assert is_within_screen(page) and serious(page) == []


def test_cancelled_and_gone_on_with(visit: Visit, queue: BuildQueue) -> None:
    page = visit.page
    page.get_by_role("link", name="Builds").click()
    ask(page, "mine")
    page.get_by_role("button", name="Cancel").click()
    state = page.locator("[data-part=state] .state")
    expect(state).to_have_text("Cancelled")
    first = page.url
    page.get_by_role("button", name="Go on with it").click()
    expect(state).to_have_text("Waiting")
    assert page.url != first
    row = queue.claim("test", 1000.0)
    assert row is not None
    queue.end(row.id, "test", "failed", {"message": "the disk is full"})
    expect(state).to_have_text("Failed")
    expect(page.get_by_text("the disk is full")).to_be_visible()
    assert is_within_screen(page) and serious(page) == []


def test_a_service_that_is_gone_for_a_while_is_told(visit: Visit, queue: BuildQueue) -> None:
    page = visit.page
    page.get_by_role("link", name="Builds").click()
    ask(page, "mine")
    state, told = page.locator("[data-part=state] .state"), page.locator("#following-text")
    expect(state).to_have_text("Waiting")
    page.route(re.compile(r"/builds/[0-9a-f]{32}$"), lambda route: route.abort())
    row = queue.claim("test", 1000.0)
    assert row is not None
    expect(told).to_contain_text("does not answer")
    page.unroute_all()
    queue.beat(row.id, "test", 1000.0, {"cases_done": 30, "cases_total": 120})
    expect(state).to_have_text("Running")
    expect(told).to_have_text("")
    page.route("**/events", lambda route: route.fulfill(status=503))
    page.reload()
    expect(told).to_contain_text("load it again")
    visit.complaints = [text for text in visit.complaints if "net::ERR_FAILED" not in text]
