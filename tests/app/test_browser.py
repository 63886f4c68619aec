"""The page in a real browser: from an upload to a verdict, on a wide and a narrow screen."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, Route, expect
from real_browser import SCREENS, SECONDS, Visit, has_drawn, is_within_screen, serious, visiting
from small_service import serving, spoiled

from jointplay.app.scopes import Scope
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, server: str) -> Iterator[Visit]:
    with visiting(browser, server, request.param) as found:
        yield found


@pytest.fixture(scope="module")
def recording(worn: bytes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("upload") / "worn.csv"
    path.write_bytes(worn)
    return path


def read(page: Page, recording: Path) -> None:
    """From the form to what was understood of a recording."""
    page.get_by_label("Recording", exact=True).set_input_files(recording)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=SECONDS)


def diagnose(page: Page, recording: Path) -> None:
    """From the form to the verdict."""
    read(page, recording)
    page.get_by_label("Effort").select_option("fast")
    page.get_by_role("button", name="Diagnose").click()
    expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)


def test_several_files_have_a_row_each(visit: Visit, recording: Path, in_order: bytes, tmp_path: Path) -> None:
    (tmp_path / "new.csv").write_bytes(in_order)
    (tmp_path / "bad.csv").write_text("time [s],s1-x [m/s2]\n0,1\n")
    page = visit.page
    files = [recording, tmp_path / "bad.csv", tmp_path / "new.csv"]
    page.get_by_label("Recording", exact=True).set_input_files(files)
    page.get_by_role("button", name="Read the recording").click()
    rows = page.locator("#answers tbody tr")
    expect(rows).to_have_count(3, timeout=SECONDS)
    expect(rows.nth(0)).to_contain_text("worn.csvwornB, ")
    expect(rows.nth(1)).to_contain_text("bad.csvrefused")
    expect(rows.nth(2)).to_contain_text("new.csvin order")
    expect(page.locator("#sending")).to_be_hidden()
    assert is_within_screen(page)
    assert serious(page) == []
    rows.nth(0).get_by_role("link").click()
    expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)


def test_from_upload_to_verdict(visit: Visit, recording: Path) -> None:
    page = visit.page
    assert is_within_screen(page)
    assert serious(page) == []
    read(page, recording)
    assert is_within_screen(page)
    assert serious(page) == []
    expect(page.get_by_label("s2-x")).to_have_value("s2-x")
    expect(page.get_by_text("Found in the recording: 607")).to_be_visible()
    page.get_by_label("Effort").select_option("fast")
    page.get_by_role("button", name="Diagnose").click()
    expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)
    expect(page).to_have_url(re.compile(r"/diagnoses/[0-9a-f]{32}$"))
    assert is_within_screen(page)
    assert page.locator("#result tbody th").first.inner_text() == "B"
    coloured = page.locator("#result .joint-B [fill^='rgb']")
    expect(coloured).to_have_count(1)
    charts = page.locator(".chart canvas")
    expect(charts).to_have_count(3)
    assert all(has_drawn(canvas) for canvas in charts.all())
    assert page.evaluate("document.activeElement.id") == "result"
    expect(page.get_by_role("button", name="Diagnose")).to_be_enabled()
    verdict = page.locator(".verdict h2").inner_text()
    page.reload()
    expect(page.locator(".verdict h2")).to_have_text(verdict)
    expect(page.locator(".chart canvas")).to_have_count(3)
    assert is_within_screen(page)
    assert serious(page) == []


def test_the_mechanism_moves_when_asked(visit: Visit, recording: Path) -> None:
    page = visit.page
    diagnose(page, recording)
    rod, pin = page.locator(".mechanism .link-rod"), page.locator(".pins .pin")
    assert rod.get_attribute("transform") is None
    page.get_by_label("slowly").check()
    page.get_by_role("button", name="Show one revolution").click()
    expect(rod).to_have_attribute("transform", re.compile(r"^translate\(-\d"), timeout=SECONDS)
    page.get_by_role("button", name="Pause").click()
    held = rod.get_attribute("transform")
    expect(page.get_by_role("button", name="Go on")).to_be_visible()
    slider = page.get_by_label("Drive", exact=True)
    at = int(slider.input_value())
    assert 0 < at < 180
    assert rod.get_attribute("transform") == held
    # Half a revolution on, the crank points the other way: the rod has gone by two cranks, 100 mm.
    slider.fill("180")
    expect(slider).to_have_attribute("aria-valuetext", "180 degrees")
    scale = float(re.findall(r"-[\d.]+", str(page.locator(".mechanism .joint-B").get_attribute("transform")))[0]) / -0.1
    moved = re.findall(r"-?[\d.]+", str(page.locator(".mechanism .joint-A").get_attribute("transform")))
    assert float(moved[0]) == pytest.approx(-0.1 * scale, rel=0.01)
    # The pin of the worn joint, large in its socket, is somewhere else now.
    expect(page.get_by_text("B: 1")).to_be_visible()
    first = pin.get_attribute("transform")
    slider.press("PageUp")
    expect(pin).not_to_have_attribute("transform", str(first))
    assert is_within_screen(page)
    assert serious(page) == []
    page.emulate_media(reduced_motion="reduce")
    page.reload()
    expect(page.get_by_role("button", name="Show one revolution")).to_be_hidden()
    page.get_by_label("Drive", exact=True).fill("90")
    expect(rod).to_have_attribute("transform", re.compile(r"^translate\(-\d"), timeout=SECONDS)


def test_back_and_forth_in_the_history(visit: Visit, recording: Path) -> None:
    page = visit.page
    diagnose(page, recording)
    page.go_back()
    expect(page.locator(".verdict")).to_have_count(0)
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=SECONDS)
    expect(page.get_by_role("button", name="Diagnose")).to_be_enabled()
    page.go_forward()
    expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)
    expect(page.locator(".chart canvas")).to_have_count(3)
    page.go_back()
    page.go_back()
    expect(page.get_by_role("button", name="Read the recording")).to_be_enabled()


def test_the_upload_is_seen_to_go_on(visit: Visit, recording: Path) -> None:
    page = visit.page
    held: list[Route] = []
    page.route("**/recordings", lambda route: held.append(route))
    page.get_by_label("Recording", exact=True).set_input_files(recording)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_role("progressbar", name="Upload")).to_be_visible()
    expect(page.get_by_role("status")).to_have_text(re.compile("Sending|Reading"))
    expect(page.get_by_role("button", name="Read the recording")).to_be_disabled()
    held[0].continue_()
    expect(page.get_by_role("heading", name="Is this right?")).to_be_visible(timeout=SECONDS)


def test_a_service_that_is_gone_is_noticed(visit: Visit, recording: Path) -> None:
    page = visit.page
    page.route("**/recordings", lambda route: route.abort())
    page.get_by_label("Recording", exact=True).set_input_files(recording)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_role("alert")).to_contain_text("did not answer")
    page.unroute("**/recordings")
    read(page, recording)
    page.route("**/diagnose", lambda route: route.abort())
    page.get_by_role("button", name="Diagnose").click()
    expect(page.get_by_role("alert")).to_contain_text("did not answer")
    # The console notes the failed request, and so does htmx; nothing else may be there.
    visit.complaints = [text for text in visit.complaints if not re.search("net::ERR_FAILED|Failed to fetch", text)]


def test_a_wrong_field_is_told_beside_it_and_put_right(visit: Visit, recording: Path) -> None:
    page = visit.page
    page.get_by_role("button", name="Read the recording").click()
    expect(page.locator("#error-file")).to_have_text("choose a recording")
    assert page.evaluate("document.activeElement.id") == "file"
    read(page, recording)
    button = page.get_by_role("button", name="Diagnose")
    page.get_by_label("Drive speed").fill("fast")
    button.click()
    expect(page.locator("#error-speed")).to_contain_text("speed: fast")
    expect(page.get_by_label("Drive speed")).to_have_attribute("aria-invalid", "true")
    assert serious(page) == []
    page.get_by_label("Drive speed").fill("606.8")
    page.get_by_label("s1-x").select_option("s1-y")
    button.click()
    expect(page.locator("#error-mapping")).to_contain_text("two columns")
    expect(page.locator("#error-speed")).to_have_text("")
    assert page.evaluate("document.activeElement.id") == "mapping"
    page.get_by_label("s1-x").select_option("s1-x")
    page.get_by_label("Effort").select_option("fast")
    button.click()
    expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)
    expect(page.locator("#error-mapping")).to_have_text("")
    assert page.get_by_label("Drive speed").get_attribute("aria-invalid") is None


def test_what_is_wrong_with_a_recording_is_told_beside_it(visit: Visit, worn: bytes, tmp_path: Path) -> None:
    page = visit.page
    bad = tmp_path / "bad.csv"
    bad.write_bytes(spoiled(worn, "no number"))
    page.get_by_label("Recording", exact=True).set_input_files(bad)
    page.get_by_role("button", name="Read the recording").click()
    expect(page.locator("#error-file")).to_contain_text("bad.csv: line 301", timeout=SECONDS)
    assert serious(page) == []


def test_a_file_that_is_too_large_is_not_even_sent(visit: Visit, tmp_path: Path) -> None:
    page = visit.page
    large = tmp_path / "large.csv"
    large.write_bytes(b"0" * 3_100_000)
    page.get_by_label("Recording", exact=True).set_input_files(large)
    expect(page.locator("#error-file")).to_contain_text("at most 3 MB")
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url))
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_label("Recording", exact=True)).to_have_attribute("aria-invalid", "true")
    # Another page is asked for after it: by then an upload would have been, too.
    page.goto(f"{page.url}static/icon.svg")
    assert [url for url in sent if not url.endswith("icon.svg")] == []


def test_a_dropped_file_is_taken(visit: Visit, recording: Path) -> None:
    page = visit.page
    transfer = page.evaluate_handle(
        "text => { const held = new DataTransfer(); held.items.add(new File([text], 'dropped.csv')); return held; }",
        recording.read_text(),
    )
    page.locator("#drop").dispatch_event("drop", {"dataTransfer": transfer})
    assert page.evaluate("document.getElementById('file').files[0].name") == "dropped.csv"
    page.get_by_role("button", name="Read the recording").click()
    expect(page.get_by_role("heading", name="dropped.csv")).to_be_visible(timeout=SECONDS)


def test_the_forms_can_be_used_by_keyboard(visit: Visit, recording: Path) -> None:
    page = visit.page
    assert [name for name in tabbed(page) if name in ("catalogue", "file", "submit")] == ["catalogue", "file", "submit"]
    read(page, recording)
    wanted = ["sensor-0", "sensor-1", "sensor-2", "sensor-3", "speed", "effort", "mode", "submit"]
    assert [name for name in tabbed(page) if name in wanted] == wanted


def tabbed(page: Page) -> list[str]:
    """What the tabulator reaches, one after the other."""
    reached = []
    for _ in range(20):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.tagName"))
        if reached[-1] == "submit":
            break
    return reached


def test_a_catalogue_is_browsed(visit: Visit) -> None:
    page = visit.page
    page.get_by_role("link", name="Catalogues").click()
    expect(page.get_by_role("heading", name="Catalogues")).to_be_visible()
    assert serious(page) == []
    assert is_within_screen(page)
    page.get_by_role("link", name="slider-crank").click()
    expect(page.locator(".chart canvas")).to_have_count(3, timeout=SECONDS)
    page.get_by_label("Worn", exact=True).select_option("B")
    page.get_by_label("Radial clearance").fill("none")
    page.get_by_role("button", name="Show").click()
    expect(page.locator("#error-clearance")).to_contain_text("clearance: none")
    assert page.evaluate("document.activeElement.id") == "clearance"
    page.get_by_label("Radial clearance").fill("0.2 mm")
    page.get_by_role("button", name="Show").click()
    expect(page.get_by_role("heading", name=re.compile("^B at .* against a machine in order"))).to_be_visible(
        timeout=SECONDS
    )
    expect(page.locator(".chart canvas")).to_have_count(3)
    expect(page).to_have_url(re.compile("hypothesis=B&clearance=0.2"))
    assert is_within_screen(page)
    assert serious(page) == []


@pytest.mark.parametrize("place", ["/diagnoses/nonsense", "/catalogues/nonsense", "/confirm?measurement=nonsense"])
def test_pages_of_what_is_not_there_are_in_order(visit: Visit, server: str, place: str) -> None:
    answer = visit.page.goto(f"{server}{place}")
    assert answer is not None and answer.status == 404
    expect(visit.page.get_by_role("alert")).to_contain_text("there is none of this id")
    assert is_within_screen(visit.page)
    assert serious(visit.page) == []


@pytest.fixture
def guarded(settings: ServiceSettings, tmp_path: Path) -> Iterator[tuple[str, Keys]]:
    """A service over the small catalogue that asks for keys, and its keys."""
    asking = settings.model_copy(update={"keys": "required", "data": tmp_path / "data"})
    with serving(asking) as address:
        store = Store(asking.data)
        yield address, Keys(store.database)
        store.close()


@pytest.mark.long
def test_a_session_that_ends_is_begun_anew_where_it_was(
    browser: Browser, guarded: tuple[str, Keys], recording: Path
) -> None:
    address, keys = guarded
    token = keys.create("analyst", frozenset({Scope.READ, Scope.MATCH}), timedelta(days=1))[1]

    def enter(page: Page) -> None:
        page.get_by_label("Key").fill(token)
        page.get_by_role("button", name="Sign in").click()

    with visiting(browser, f"{address}/?sample_rate=9000", SCREENS[0]) as visit:
        page = visit.page
        enter(page)
        expect(page.get_by_label("Sample rate")).to_have_value("9000")
        page.context.clear_cookies()
        page.get_by_label("Recording", exact=True).set_input_files(recording)
        page.get_by_label("Sample rate").fill("")
        page.get_by_label("Catalogue").select_option(label=page.locator("#catalogue option").inner_text())
        page.get_by_role("button", name="Read the recording").click()
        enter(page)
        expect(page).to_have_url(re.compile(r"/\?catalogue=[0-9a-f]{64}$"))
        read(page, recording)
        page.get_by_label("Drive speed").fill("606.5")
        page.get_by_label("s2-y").select_option("not used")
        page.get_by_label("Effort").select_option("fast")
        page.context.clear_cookies()
        page.get_by_role("button", name="Diagnose").click()
        enter(page)
        expect(page.get_by_label("Drive speed")).to_have_value("606.5")
        expect(page.get_by_label("Effort")).to_have_value("fast")
        expect(page.get_by_label("s2-y")).to_have_value("-")
        page.get_by_role("button", name="Diagnose").click()
        expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)


def test_without_scripts_from_upload_to_verdict(browser: Browser, server: str, recording: Path) -> None:
    with visiting(browser, server, SCREENS[1], java_script_enabled=False) as visit:
        page = visit.page
        page.get_by_role("button", name="Read the recording").click()
        expect(page.locator("#error-file")).to_have_text("choose a recording")
        read(page, recording)
        page.get_by_label("Drive speed").fill("fast")
        page.get_by_role("button", name="Diagnose").click()
        expect(page.locator("#error-speed")).to_contain_text("speed: fast")
        page.get_by_label("Drive speed").fill("")
        page.get_by_label("Effort").select_option("fast")
        page.get_by_role("button", name="Diagnose").click()
        expect(page.locator(".verdict h2")).to_contain_text("Joint B is worn", timeout=SECONDS)
        expect(page.get_by_role("heading", name="Bands that decided")).to_be_visible()
        expect(page.get_by_role("button", name="Show one revolution")).to_be_hidden()
        page.get_by_role("link", name="Catalogues").click()
        page.get_by_role("link", name="slider-crank").click()
        page.get_by_label("Worn", exact=True).select_option("B")
        page.get_by_role("button", name="Show").click()
        expect(page.get_by_role("heading", name=re.compile("^B at .* against a machine in order"))).to_be_visible()


def test_the_page_to_sign_in_is_in_order(browser: Browser, tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "none", data=tmp_path / "data", workers=1, keys="required")
    with serving(settings) as address:
        for scheme in ("light", "dark"):
            context = browser.new_context(viewport={"width": 360, "height": 740}, color_scheme=scheme)
            page = context.new_page()
            page.goto(address)
            page.get_by_label("Key").fill("nonsense")
            page.get_by_role("button", name="Sign in").click()
            expect(page.get_by_role("alert")).to_be_visible()
            assert is_within_screen(page)
            assert serious(page) == []
            context.close()
