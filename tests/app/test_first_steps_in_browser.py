"""From an empty installation to a right diagnosis, in the browser alone: the steps of docs/guide/first-steps.md.

The press ships nowhere. The plan is a small one, so that its catalogue is there in a minute.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from real_browser import SCREENS, SECONDS, has_drawn, is_within_screen, serious, visiting
from small_service import serving

from jointplay.app.jobs import build_orders
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.plans.plan import parse_plan

PRESS = """name: small toggle press
links:
  bed:   {mass: 45, inertia: 1.9, cg: [0.05, -0.02]}
  crank: {mass: 0.8, inertia: 1.1e-3, cg: [-0.235, -0.02]}
  rod:   {mass: 1.1, inertia: 9.0e-3, cg: [-0.1, -0.01]}
  upper: {mass: 0.9, inertia: 4.0e-3, cg: [0.01, 0.09]}
  lower: {mass: 0.9, inertia: 4.0e-3, cg: [0.01, -0.09]}
  ram:   {mass: 2.4, inertia: 6.0e-3, cg: [0, -0.2]}
joints:
  O: {kind: turning, links: [crank, bed],   at: [-0.26, -0.02], pin_radius: 12 mm}
  A: {kind: turning, links: [rod, crank],   at: [-0.22, -0.02], pin_radius: 10 mm}
  B: {kind: turning, links: [rod, upper],   at: [0.02, 0], pin_radius: 10 mm}
  K: {kind: turning, links: [lower, upper], at: [0.02, 0], pin_radius: 10 mm}
  C: {kind: turning, links: [upper, bed],   at: [0, 0.18], pin_radius: 10 mm}
  D: {kind: turning, links: [lower, ram],   at: [0, -0.18], pin_radius: 10 mm}
  G: {kind: sliding, links: [ram, bed],     at: [0, -0.18], direction: [0, 1]}
drive: {kind: rotation, joint: O, speed: 300 rpm}
supports:
  - {kind: mount, link: bed, at: [-0.3, -0.25], stiffness: [3.0e5, 5.0e5], damping: [250, 350]}
  - {kind: mount, link: bed, at: [0.3, -0.25], stiffness: [3.0e5, 5.0e5], damping: [250, 350]}
sensors:
  - {name: head-x, at: [0.05, 0.22], direction: [1, 0]}
  - {name: head-y, at: [0.05, 0.22], direction: [0, 1]}
  - {name: foot-y, at: [-0.3, -0.2], direction: [0, 1]}
"""
SMALL = {"name": "small", "draws": {"healthy": 32, "single": 40}, "laws": {"own": 1}, "seconds": 0.6}


@pytest.fixture
def page(browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    """The first page of an empty installation, whose plan quick is a small one."""
    monkeypatch.setattr(build_orders, "preset", lambda name: parse_plan(SMALL))
    settings = ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", workers=1, time_limit_s=600)
    with serving(settings) as address, visiting(browser, address, SCREENS[0]) as visit:
        visit.page.set_default_timeout(4 * SECONDS)
        yield visit.page


@pytest.mark.long
def test_from_nothing_to_a_worn_joint(page: Page) -> None:
    bring_the_press(page)
    build_its_catalogue(page)
    wear_joint_d(page)
    read_the_answer(page)


def bring_the_press(page: Page) -> None:
    """Step 1: describe the machine, mistakes and all, beside its drawing."""
    page.get_by_role("link", name="Bring your own machine").click()
    page.get_by_label("Name", exact=True).fill("press-7")
    text, told = page.get_by_label("Machine file"), page.locator("#told")
    text.fill(PRESS.replace("pin_radius: 12 mm", "pinradius: 12 mm"))
    expect(told).to_contain_text('Line 10: joints.O.pinradius: 12 mm: unknown key; did you mean "pin_radius"?')
    text.fill(PRESS)
    expect(told).to_have_text("A valid machine.", timeout=SECONDS)
    expect(page.locator("#drawing .joint-K")).to_be_visible()
    expect(page.locator("#account")).to_contain_text("4, of which 3 are integrated")
    good(page)
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="small toggle press")).to_be_visible()


def build_its_catalogue(page: Page) -> None:
    """Step 2: simulate it with every joint worn, and watch."""
    page.get_by_role("link", name="Build a catalogue of it").click()
    expect(page.get_by_label("Machine", exact=True)).to_have_value("press-7")
    page.get_by_label("Name of the catalogue").fill("press-7")
    page.get_by_role("radio", name="quick").check()
    page.get_by_role("button", name="Build", exact=True).click()
    expect(page.locator(".count")).to_contain_text(re.compile(r"[1-9]\d* of 272 cases"), timeout=4 * SECONDS)
    expect(page.locator("[data-part=state] .state")).to_have_text("Done", timeout=8 * SECONDS)


def wear_joint_d(page: Page) -> None:
    """Step 3: a virtual recording of the press with joint D worn by 200 um."""
    page.get_by_role("link", name="Try it with a virtual recording").click()
    page.get_by_label("D as new 3 to 20").fill("200")
    good(page)
    page.get_by_role("button", name="Simulate").click()
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=4 * SECONDS)
    expect(page.get_by_text("simulated, not measured")).to_contain_text("D 200 µm")
    expect(page.get_by_label("head-x")).to_have_value("head-x")
    page.get_by_role("button", name="Diagnose").click()


def read_the_answer(page: Page) -> None:
    """Step 4: the answer is that joint, and an interval that holds its clearance."""
    verdict = page.locator(".verdict h2")
    expect(verdict).to_contain_text("Joint D is worn", timeout=4 * SECONDS)
    low, high = re.findall(r"\((?:90 %: )?(\d+) to (\d+)", page.locator("#result").inner_text())[0]
    assert int(low) <= 200 <= int(high)
    assert all(has_drawn(canvas) for canvas in page.locator(".chart canvas").all())
    good(page)


def good(page: Page) -> None:
    assert is_within_screen(page) and serious(page) == []
