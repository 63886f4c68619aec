"""Assets in a real browser: noted, diagnosed, given a baseline, and their past looked at."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from http_answers import API
from playwright.sync_api import Browser, Page, expect
from real_browser import SCREENS, SECONDS, Visit, has_drawn, is_within_screen, serious, visiting
from test_wear_state import diagnose as answer_to


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


@pytest.mark.long
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
    page.get_by_role("group", name="Baselines").get_by_role("checkbox").first.check()
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
    expect(page.get_by_role("row", name=name)).to_contain_text("slider-crank")


COUNT = """(canvas, colour) => {
  const probe = document.createElement("i");
  probe.style.color = getComputedStyle(document.documentElement).getPropertyValue(colour);
  document.body.append(probe);
  const wanted = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
  probe.remove();
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4) if (data[i + 3] && wanted.every((v, k) => v === data[i + k])) count += 1;
  return count;
}"""
"""Pixels of a colour of the page's own on a canvas."""


def wait_until_judged(client: httpx.Client, name: str) -> None:
    deadline = time.monotonic() + SECONDS / 1000
    while not client.get(f"{API}/assets/{name}").json()["standing"]["up_to_date"]:
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.long
def test_an_alarm_is_found_acknowledged_and_repaired(visit: Visit, client: httpx.Client, worn: bytes) -> None:
    page = visit.page
    name = f"crank-{page.viewport_size['width']}" if page.viewport_size else ""
    wanted = {"machine": "slider-crank", "limits_um": {"B": 90}}
    client.put(f"{API}/assets/{name}", json=wanted).raise_for_status()
    form = {"catalogue": "slider-crank", "asset": name, "effort": "fast"}
    client.post(f"{API}/diagnoses", files={"file": ("a.csv", worn)}, data=form).raise_for_status()
    wait_until_judged(client, name)
    page.get_by_role("link", name="Assets", exact=True).click()
    page.get_by_label("Search").fill(name.upper())
    page.get_by_role("button", name="Show").click()
    rows = page.get_by_role("region", name="Assets").get_by_role("row")
    expect(rows).to_have_count(2)
    expect(rows.nth(1)).to_contain_text("Alarm")
    expect(rows.nth(1)).to_contain_text("over: B")
    assert is_within_screen(page) and serious(page) == []
    rows.nth(1).get_by_role("link", name=name).click()
    expect(page.get_by_role("heading", name="Alarm")).to_be_visible()
    expect(page.get_by_text("Joint B is beyond its limit of 90 µm")).to_be_visible()
    canvas = page.locator("#state canvas")
    expect(canvas).to_have_count(1, timeout=SECONDS)
    assert canvas.evaluate(COUNT, "--bad") > 100, "the limit is a line"
    page.get_by_label("Note", exact=False).first.fill("bearing is ordered")
    page.get_by_role("button", name="I have seen it").click()
    expect(page.get_by_text("Seen by somebody")).to_contain_text("bearing is ordered")
    page.get_by_role("link", name="Enter what was found or repaired").click()
    page.get_by_role("button", name="Keep it").click()
    expect(page.get_by_text("give joints with their clearance, or a text")).to_be_visible()
    page.get_by_label("Joint B", exact=True).fill("300")
    page.locator("#repaired-B").check()
    assert is_within_screen(page) and serious(page) == []
    page.get_by_role("button", name="Keep it").click()
    expect(page.get_by_role("region", name="Found by inspections").last).to_contain_text("B 150 µm, repaired")
    wait_until_judged(client, name)
    page.reload()
    expect(page.get_by_role("heading", name="Alarm")).to_have_count(0)
    expect(page.get_by_text("Seen by somebody")).to_have_count(0)
    assert is_within_screen(page) and serious(page) == []


@pytest.mark.parametrize("screen", SCREENS, ids=["wide", "narrow"])
def test_what_was_found_is_entered_by_the_clock_of_the_reader(
    screen: tuple[int, int, str], browser: Browser, server: str, client: httpx.Client
) -> None:
    name = f"found-{screen[0]}"
    client.put(f"{API}/assets/{name}", json={"machine": "slider-crank"}).raise_for_status()
    key = answer_to(client, 2, name)["id"]
    with visiting(browser, server, screen, timezone_id="Europe/Berlin") as visit:
        page = visit.page
        for place in ("measurements", "diagnoses", f"diagnoses/{key}/finding"):
            page.goto(f"{server}/{place}")
            expect(page.locator("[data-zone]").first).to_contain_text("Europe/Berlin")
            assert is_within_screen(page) and serious(page) == []
        page.get_by_label("When").fill("2026-07-21T10:30:05")
        page.get_by_label("Joint B", exact=True).fill("much")
        page.get_by_role("button", name="Keep it").click()
        expect(page.locator("#error-joints")).to_contain_text("joint B: much: must be a length")
        expect(page.get_by_label("When")).to_have_value("2026-07-21T10:30:05")
        page.get_by_label("Joint B", exact=True).fill("0,25 mm")
        page.get_by_role("button", name="Keep it").click()
        expect(page.get_by_role("heading", name=name)).to_be_visible()
    (found,) = client.get(f"{API}/findings", params={"diagnosis": key}).json()["items"]
    assert (found["at"], found["joints"]["B"]["clearance_um"]) == ("2026-07-21T08:30:05Z", 125.0)
