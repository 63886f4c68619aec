"""Assets in a real browser: noted, diagnosed, given a baseline, and their past looked at."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from real_browser import SCREENS, SECONDS, Visit, has_drawn, is_within_screen, serious, visiting


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, server: str) -> Iterator[Visit]:
    with visiting(browser, server, request.param) as found:
        yield found


def diagnose(page: Page, name: str, content: bytes, folder: Path, verdict: str) -> None:
    """From the page of an asset to the verdict on a recording of it, and back."""
    path = folder / name
    path.write_bytes(content)
    asset = page.get_by_role("heading", level=1).inner_text()
    page.get_by_role("link", name="Diagnose a recording of it").click()
    expect(page.get_by_label("Asset")).to_have_value(asset)
    page.get_by_label("Recording", exact=True).set_input_files(path)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=SECONDS)
    expect(page.get_by_label("Asset")).to_have_value(asset)
    page.get_by_label("Effort").select_option("fast")
    page.get_by_role("button", name="Diagnose").click()
    expect(page.locator(".verdict h2")).to_contain_text(verdict, ignore_case=True, timeout=SECONDS)
    page.locator("#result").get_by_role("link", name=asset, exact=True).click()


def test_an_asset_from_its_name_to_its_past(visit: Visit, worn: bytes, in_order: bytes, tmp_path: Path) -> None:
    page = visit.page
    name = f"press-{page.viewport_size['width']}" if page.viewport_size else ""
    page.get_by_role("link", name="Assets", exact=True).click()
    expect(page.get_by_role("heading", name="New asset")).to_be_visible()
    assert is_within_screen(page) and serious(page) == []
    page.get_by_label("Name in your records").fill("hall B")
    page.get_by_label("Machine").select_option("slider-crank")
    page.get_by_role("button", name="Note it").click()
    expect(page.locator("#error-external_id")).to_contain_text("external_id: ")
    assert page.evaluate("document.activeElement.id") == "external_id"
    page.get_by_label("Name in your records").fill(name)
    page.get_by_role("button", name="Note it").click()
    expect(page.get_by_role("heading", name=name)).to_be_visible()
    diagnose(page, f"new-{name}.csv", in_order, tmp_path, "No worn joint")
    page.get_by_label("Baseline", exact=True).select_option(label=page.locator("#baseline option").nth(1).inner_text())
    page.get_by_label("Notes", exact=True).fill("hall B, line 3")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("hall B, line 3").first).to_be_visible()
    diagnose(page, f"worn-{name}.csv", worn, tmp_path, "Joint B is worn")
    rows = page.get_by_role("region", name="Diagnoses").get_by_role("row")
    expect(rows).to_have_count(3)
    expect(rows.nth(1)).to_contain_text("B worn")
    expect(rows.nth(2)).to_contain_text("in order")
    past = page.get_by_role("img", name="Radial clearance over time, of 2 recordings")
    expect(past.locator("canvas")).to_have_count(1)
    assert has_drawn(past.locator("canvas"))
    assert is_within_screen(page) and serious(page) == []
    page.get_by_role("link", name="B worn").click()
    expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn")
    page.get_by_role("link", name="Assets", exact=True).click()
    expect(page.get_by_role("row", name=name)).to_contain_text("yes")
