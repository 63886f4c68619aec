"""Keeping and deleting in a real browser: named before it goes, and never by one click."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from http_answers import API, send
from playwright.sync_api import Browser, expect
from real_browser import SCREENS, Visit, is_within_screen, serious, visiting


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, server: str) -> Iterator[Visit]:
    with visiting(browser, server, request.param) as found:
        yield found


def test_a_recording_is_held_released_and_deleted(visit: Visit, client: httpx.Client, worn: bytes) -> None:
    page = visit.page
    name = f"gone-{page.viewport_size['width']}.csv" if page.viewport_size else ""
    key = send(client, worn, name).json()["id"]
    page.goto(f"{client.base_url}/measurements/{key}")
    page.get_by_role("link", name="Keep or delete it").click()
    expect(page.get_by_role("heading", name="Keep or delete a recording")).to_be_visible()
    assert is_within_screen(page) and serious(page) == []
    page.get_by_label("Hold, because").fill("claim 42")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("definition").filter(has_text="claim 42")).to_be_visible()
    page.get_by_label(f"Delete {name}").check()
    page.get_by_role("button", name="Delete it").click()
    expect(page.get_by_role("alert")).to_contain_text("is on hold (claim 42)")
    page.get_by_label("Hold, because").fill("")
    page.get_by_role("button", name="Save").click()
    page.get_by_role("button", name="Delete it").click()
    expect(page.locator("#error-sure")).to_contain_text("say that this recording is to go")
    page.get_by_label("Why").fill("sent twice")
    page.get_by_label(f"Delete {name}").check()
    page.get_by_role("button", name="Delete it").click()
    expect(page.get_by_role("status")).to_contain_text(name)
    answer = client.get(f"{API}/measurements/{key}")
    assert answer.status_code == 410 and "sent twice" in answer.text
