"""The pages of machines in a real browser: a text is edited beside its drawing, on a wide and a narrow screen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from real_browser import SCREENS, SECONDS, Visit, is_within_screen, serious, visiting
from small_service import serving

from jointplay.app.settings import ServiceSettings
from jointplay.solver.machines.machine import shipped_machine_text

WRONG = "\n".join(shipped_machine_text("slider-crank").replace("kind: rotation", "kind: rotatoin").splitlines())
OPEN = shipped_machine_text("slider-crank").replace("at: [0.2, 0.05], pin", "at: [0.02, 0.05], pin")


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, shelf: Path, tmp_path: Path) -> Iterator[Visit]:
    settings = ServiceSettings(catalogues=shelf, data=tmp_path / "data", workers=1, builds=0)
    with serving(settings) as address, visiting(browser, address, request.param) as found:
        yield found


@pytest.mark.long
def test_a_text_is_edited_beside_its_drawing(visit: Visit, tmp_path: Path) -> None:
    page = visit.page
    page.get_by_role("link", name="Machines").click()
    expect(page.locator(".cards svg.machine-drawing").first).to_be_visible()
    assert is_within_screen(page) and serious(page) == []
    page.get_by_role("link", name="Use as a start: slider-crank").click()
    text, told, drawing = page.get_by_label("Machine file"), page.locator("#told"), page.locator("#drawing")
    expect(told).to_have_text("A valid machine.", timeout=SECONDS)
    assert is_within_screen(page) and serious(page) == []
    line = WRONG.splitlines().index(next(each for each in WRONG.splitlines() if "rotatoin" in each)) + 1
    text.fill(WRONG)
    expect(page.locator(".gutter .wrong")).to_have_text(str(line), timeout=SECONDS)
    expect(told).to_contain_text(f'Line {line}: drive.kind: rotatoin: is not a known kind; did you mean "rotation"?')
    expect(drawing.locator(".link-rod").first).to_be_visible()  # as it could be drawn last
    assert is_within_screen(page) and serious(page) == []
    told.locator("[data-line]").click()
    chosen = "document.getElementById('text')"
    assert "rotatoin" in page.evaluate(f"{chosen}.value.slice({chosen}.selectionStart, {chosen}.selectionEnd)")
    text.fill(OPEN)
    expect(told).to_contain_text("cannot be assembled", timeout=SECONDS)
    expect(drawing).to_contain_text("mm open")
    assert serious(page) == []
    file = tmp_path / "mine.yaml"
    file.write_text(shipped_machine_text("four-bar"))
    page.get_by_label("Load a file into the text").set_input_files(file)
    expect(told).to_have_text("A valid machine.", timeout=SECONDS)
    expect(drawing.locator(".joint-D").first).to_be_visible()
    expect(page.locator("#account")).to_contain_text("4, of which 3 are integrated")
    page.get_by_label("Name", exact=True).fill("mine")
    page.keyboard.press("Enter")  # the whole form by the keyboard
    expect(page.get_by_role("heading", name="Versions")).to_be_visible()
    assert is_within_screen(page) and serious(page) == []
    page.goto(page.url.replace("/machines/mine", "/try"))
    expect(page.get_by_role("heading", name="A virtual recording of slider-crank")).to_be_visible()
    assert is_within_screen(page) and serious(page) == []
