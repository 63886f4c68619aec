"""What a file does not say, in a real browser: asked for beside the field that is missing, until it can be read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from real_browser import SCREENS, SECONDS, Visit, is_within_screen, serious, visiting


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, server: str) -> Iterator[Visit]:
    with visiting(browser, server, request.param) as found:
        yield found


def test_what_is_missing_is_asked_for_one_after_the_other(visit: Visit, worn: bytes, tmp_path: Path) -> None:
    page = visit.page
    bare = tmp_path / "bare.csv"
    rows = [line.partition(b",")[2] for line in worn.splitlines()[1:]]
    bare.write_bytes(b"\n".join([b"s1-x,s1-y,s2-x,s2-y", *rows]))
    unit, rate = page.get_by_label("Unit", exact=True), page.get_by_label("Sample rate")
    expect(unit).to_be_hidden()
    page.get_by_label("Recording", exact=True).set_input_files(bare)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.locator("#error-units")).to_contain_text("has no unit", timeout=SECONDS)
    expect(unit).to_be_visible()
    expect(unit).to_be_focused()
    expect(unit).to_have_attribute("aria-invalid", "true")
    assert serious(page) == [] and is_within_screen(page)
    unit.fill("m/s2")
    page.keyboard.press("Enter")
    expect(page.locator("#error-sample_rate")).to_contain_text("give the sample rate", timeout=SECONDS)
    expect(page.locator("#error-units")).to_have_text("")
    expect(rate).to_be_focused()
    rate.fill("10 kHz")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=SECONDS)
    expect(page.get_by_text("sample rate 10000 Hz; units m/s2")).to_be_visible()
    expect(page.get_by_label("s1-x")).to_have_value("s1-x")


def test_units_are_written_as_people_write_them(visit: Visit, worn: bytes, tmp_path: Path) -> None:
    page = visit.page
    file = tmp_path / "in-g.csv"
    _, *rows = worn.splitlines()
    file.write_bytes(b"\n".join([b"Nr,s1-x,s1-y,s2-x,s2-y", *rows]))
    unit = page.get_by_label("Unit", exact=True)
    page.get_by_label("Recording", exact=True).set_input_files(file)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.locator("#error-units")).to_contain_text("in the form 'Unit'", timeout=SECONDS)
    expect(unit).to_be_focused()
    unit.fill("Nr=s, m/s2")
    page.keyboard.press("Enter")
    expect(page.locator("#error-units")).to_contain_text('as in "t=s, *=g"', timeout=SECONDS)
    unit.fill("Nr=s, *=m/s2")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=SECONDS)
    expect(page.get_by_label("s1-x")).to_have_value("s1-x")


def test_a_spectrum_is_confirmed_as_one(visit: Visit, tmp_path: Path) -> None:
    page = visit.page
    file = tmp_path / "spectrum.csv"
    lines = [f"{0.5 * k},{0.001 if k % 20 else 0.3}" for k in range(2000)]
    file.write_text("\n".join(["frequency [Hz],s1-x [m/s2]", *lines]))
    page.get_by_label("Recording", exact=True).set_input_files(file)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.locator("#error-scaling")).to_contain_text("give its scaling", timeout=SECONDS)
    page.get_by_label("Scaling").select_option("amplitude")
    page.get_by_label("Detector").select_option("rms")
    page.get_by_label("Window").select_option("hann")
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_text("0.5 Hz, 2000 lines")).to_be_visible(timeout=SECONDS)
    expect(page.get_by_text("acceleration in m/s², amplitude, rms")).to_be_visible()
    assert serious(page) == [] and is_within_screen(page)


def test_a_moment_is_typed_in_the_zone_of_the_reader(
    browser: Browser, server: str, worn: bytes, tmp_path: Path
) -> None:
    file = tmp_path / "typed.csv"
    file.write_bytes(worn)
    with visiting(browser, server, SCREENS[0], timezone_id="America/New_York") as visit:
        page = visit.page
        page.get_by_label("Recording", exact=True).set_input_files(file)
        page.get_by_text("What the file does not say").click()
        field = page.get_by_label("Measured at")
        expect(page.locator("label[for=measured_at]")).to_contain_text("America/New_York")
        assert serious(page) == [] and is_within_screen(page)
        field.fill("2024-07-21T10:03:05")
        page.get_by_role("button", name="Read the recording").click()
        expect(page.get_by_text("2024-07-21 10:03 EDT, as its sender says")).to_be_visible(timeout=SECONDS)
        expect(page.locator("time").first).to_have_attribute("title", "2024-07-21 14:03 UTC")
    with visiting(browser, server, SCREENS[0], timezone_id="Europe/Berlin") as visit:
        page = visit.page
        page.goto(f"{server}/?measured_at=2024-07-21T14:03:05.000Z")
        expect(page.get_by_label("Measured at")).to_have_value("2024-07-21T16:03:05")
