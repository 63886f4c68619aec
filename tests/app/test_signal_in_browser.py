"""Charts in a real browser: zoom, coupled cursors, touch, keys and files, by what is drawn and by its numbers."""

from __future__ import annotations

import csv
import io
import re
import struct
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import httpx
import numpy as np
import pytest
from http_answers import send
from playwright.sync_api import Browser, Locator, Page, expect
from real_browser import SCREENS, SECONDS, Visit, has_drawn, is_within_screen, serious, visiting

RATE, SECONDS_LONG = 500, 60
BLOW = 21_561
TONE = 120.0


@pytest.fixture(scope="module")
def minute(server: str) -> str:
    """Id of a recording of a minute, four channels, with one blow."""
    rng = np.random.default_rng(4)
    time = np.arange(RATE * SECONDS_LONG) / RATE
    wave = np.sin(2 * np.pi * TONE * time)
    table = np.column_stack([time, *(wave * size + 0.05 * rng.normal(size=len(time)) for size in (1, 2, 3, 4))])
    table[BLOW, 1] = 50.0
    rows = [",".join(f"{value:.4g}" if place else f"{value:.6g}" for place, value in enumerate(row)) for row in table]
    content = "\n".join(["t [s],a [m/s2],b [m/s2],c [m/s2],d [m/s2]", *rows]).encode()
    with httpx.Client(base_url=server, timeout=300) as client:
        response = send(client, content, "minute.csv")
    assert response.status_code == 201, response.text
    key: str = response.json()["id"]
    return key


@pytest.fixture(params=SCREENS, ids=["wide", "narrow"])
def visit(request: pytest.FixtureRequest, browser: Browser, server: str) -> Iterator[Visit]:
    with visiting(browser, server, request.param, has_touch=True) as found:
        yield found


ALL_HAS_COME = """() => [...document.querySelectorAll("[data-signal], #overall")].every(
    each => each.hidden || each.closest("[hidden]") || each.querySelector("canvas, tbody tr"))"""


def axis(chart: Locator) -> tuple[float, float]:
    """Ends of the axis that is drawn."""
    return float(chart.get_attribute("data-from") or "nan"), float(chart.get_attribute("data-to") or "nan")


def pixels(chart: Locator) -> str:
    found: str = chart.locator("canvas").evaluate("canvas => canvas.toDataURL()")
    return found


def drag(page: Page, chart: Locator, begin: float, end: float) -> None:
    """Once all of the page has come: charts above move it as they come, and the table has every chart drawn anew."""
    page.wait_for_function(ALL_HAS_COME, timeout=SECONDS)
    chart.scroll_into_view_if_needed()
    box = chart.locator(".u-over").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + begin * box["width"], box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], box["y"] + box["height"] / 2, steps=5)
    page.mouse.up()


def saved(page: Page, chart: Locator, kind: str) -> bytes:
    tools = chart.locator("xpath=following-sibling::div[1]")
    with page.expect_download() as held:
        tools.get_by_role("button", name=f"Download as {kind.upper()}").click()
    assert held.value.suggested_filename.endswith(f".{kind}")
    path = held.value.path()
    return path.read_bytes()


def numbers(page: Page, chart: Locator) -> tuple[list[str], np.ndarray]:
    head, *rows = csv.reader(io.StringIO(saved(page, chart, "csv").decode()))
    return head, np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])


def test_a_drag_zooms_all_charts_of_a_page_and_a_double_click_shows_all(visit: Visit, server: str) -> None:
    page = visit.page
    page.goto(f"{server}/catalogues/slider-crank?hypothesis=B")
    charts = page.locator("[data-chart]")
    expect(charts).to_have_count(3)
    expect(charts.nth(2).locator("canvas")).to_have_count(1)
    whole, before = axis(charts.nth(0)), [pixels(chart) for chart in charts.all()]
    drag(page, charts.nth(0), 0.3, 0.6)
    expect(charts.nth(2)).not_to_have_attribute("data-from", str(whole[0]))
    low, high = axis(charts.nth(0))
    # The axis is logarithmic: the dragged part of it is a power of the whole.
    span = np.log(whole[1] / whole[0])
    assert np.log([low / whole[0], high / whole[0]]) / span == pytest.approx([0.3, 0.6], abs=0.02)
    assert axis(charts.nth(1)) == axis(charts.nth(2)) == (low, high)
    assert all(pixels(chart) != former for chart, former in zip(charts.all(), before, strict=True))
    charts.nth(1).locator(".u-over").dblclick()
    expect(charts.nth(0)).to_have_attribute("data-from", charts.nth(1).get_attribute("data-from") or "")
    for chart in charts.all():
        assert axis(chart) == whole


def test_cursors_are_coupled_and_read_out_by_mouse_touch_and_keys(visit: Visit, server: str) -> None:
    page = visit.page
    page.goto(f"{server}/catalogues/slider-crank?hypothesis=B")
    charts = page.locator("[data-chart]")
    first, last = (charts.nth(index).locator(".u-legend .u-value") for index in (0, 2))
    expect(last.first).to_be_visible()
    assert last.first.inner_text() in ("–", "--")
    charts.nth(0).scroll_into_view_if_needed()
    charts.nth(0).locator(".u-over").hover(position={"x": 80, "y": 60})
    expect(last.first).not_to_have_text("–")
    assert last.first.inner_text() == first.first.inner_text()
    assert last.nth(3).inner_text().endswith("dB")
    box = charts.nth(1).locator(".u-over").bounding_box()
    assert box is not None
    before = first.first.inner_text()
    charts.nth(1).scroll_into_view_if_needed()
    box = charts.nth(1).locator(".u-over").bounding_box()
    assert box is not None
    page.touchscreen.tap(box["x"] + 0.8 * box["width"], box["y"] + 40)
    expect(first.first).not_to_have_text(before)
    charts.nth(2).focus()
    page.keyboard.press("Home")
    said = charts.nth(2).locator("xpath=following-sibling::div[1]").get_by_role("status")
    expect(said).to_contain_text("order 1,")
    # Neither a page that moves from under the mouse nor the browser's echo of a touch takes the place from the keys.
    charts.nth(1).locator(".u-over").evaluate("""(over) => {
      const sourceCapabilities = new InputDeviceCapabilities({ firesTouchEvents: true });
      const [clientX, clientY] = [over.getBoundingClientRect().left + 90, over.getBoundingClientRect().top + 40];
      over.dispatchEvent(new MouseEvent("mousemove", { clientX, clientY, sourceCapabilities }));
    }""")
    assert first.first.inner_text() in ("–", "1")
    charts.nth(1).locator(".u-over").dispatch_event("mouseleave")
    expect(first.first).to_have_text("–")
    page.keyboard.press("ArrowRight")
    expect(said).to_contain_text("order 2,")
    whole = axis(charts.nth(2))
    page.keyboard.press("+")
    expect(charts.nth(2)).not_to_have_attribute("data-to", str(whole[1]))
    page.keyboard.press("0")
    expect(charts.nth(2)).to_have_attribute("data-to", charts.nth(0).get_attribute("data-to") or "")
    assert axis(charts.nth(2)) == whole
    assert is_within_screen(page) and serious(page) == []


def test_a_minute_is_looked_at_ever_closer(visit: Visit, server: str, minute: str) -> None:
    page = visit.page
    page.goto(f"{server}/measurements/{minute}")
    wave = page.locator("[data-signal='waveform']")
    expect(wave.locator("canvas")).to_have_count(1, timeout=SECONDS)
    assert has_drawn(wave.locator("canvas"))
    head, coarse = numbers(page, wave)
    assert head[:3] == ["time, s", "a [m/s2]", "a, lowest [m/s2]"]
    assert len(coarse) < 2000
    assert np.nanmax(coarse[:, 1]) == 50.0  # one sample of all is not lost
    blow = BLOW / RATE
    drag(page, wave, blow / 60 - 0.01, blow / 60 + 0.01)
    expect(wave).not_to_have_attribute("data-points", str(len(coarse)))
    low, high = axis(wave)
    assert low < blow < high and high - low < 2.0
    _, fine = numbers(page, wave)
    inside = fine[(fine[:, 0] >= low) & (fine[:, 0] <= high)]
    assert np.median(np.diff(inside[:, 0])) < 0.01 < 0.1 < np.median(np.diff(coarse[:, 0])) * 2
    assert inside[np.argmax(inside[:, 1]), 0] == pytest.approx(blow, abs=3 / RATE)
    wave.locator(".u-over").dblclick()
    expect(wave).to_have_attribute("data-points", str(len(coarse)))
    spectrum = page.locator("[data-signal='spectrum']")
    page.get_by_label("Levels").select_option("lin")
    page.get_by_label("Unit").select_option("g")
    expect(spectrum).to_have_attribute("data-look", re.compile("unit=g.*levels=lin"))
    head, lines = numbers(page, spectrum)
    assert head[4] == "d [g rms]"
    assert lines[np.argmax(lines[:, 4]), 0] == pytest.approx(TONE, abs=0.5)
    assert np.max(lines[:, 4]) == pytest.approx(4 / 2**0.5 / 9.80665, rel=0.02)
    expect(page.locator("#overall tbody tr")).to_have_count(4)
    expect(page.locator("#overall tbody tr").nth(3)).to_contain_text("mm/s")
    assert is_within_screen(page) and serious(page) == []


def test_harmonics_stand_where_they_are_wanted(visit: Visit, server: str, minute: str) -> None:
    page = visit.page
    page.goto(f"{server}/measurements/{minute}?speed=600+rpm&axis=hz")
    spectrum = page.locator("[data-signal='spectrum']")
    expect(spectrum.locator("canvas")).to_have_count(1, timeout=SECONDS)
    plain = pixels(spectrum)
    page.get_by_label("Harmonics").select_option("cursor")
    expect(spectrum).to_have_attribute("data-look", re.compile("harmonics=cursor"))
    spectrum.scroll_into_view_if_needed()
    spectrum.locator(".u-over").click(position={"x": 60, "y": 50})
    assert pixels(spectrum) != plain
    for view in ("revolution", "spectrogram"):
        assert has_drawn(page.locator(f"[data-signal='{view}'] canvas"))


def test_forces_in_the_joints_are_simulated_when_asked_for(
    browser: Browser, server: str, measurement: dict[str, Any]
) -> None:
    asked = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast"}
    with httpx.Client(base_url=server, timeout=300) as client:
        assert client.post("/api/v1/diagnoses", json=asked).status_code == 201
    with visiting(browser, f"{server}/measurements/{measurement['id']}", SCREENS[0]) as visit:
        page = visit.page
        expect(page.locator("[data-signal='revolution'] canvas")).to_have_count(1, timeout=SECONDS)
        page.get_by_role("button", name="Simulate them").click()
        force = page.locator("[data-signal='contact']")
        expect(force.locator("canvas")).to_have_count(1, timeout=SECONDS)
        head, rows = numbers(page, force)
        assert head[1:] == ["A [N]", "B [N]", "G1 [N]", "O [N]"] and len(rows) == 360
        expect(page.locator("[data-note='contact']")).to_contain_text(
            "laid over the recording by its sensors", ignore_case=True
        )
        # Where somebody looks closer, the recording and the forces are seen at the same angles.
        drag(page, force, 0.5, 0.75)
        expect(page.locator("[data-signal='revolution']")).to_have_attribute(
            "data-from", force.get_attribute("data-from") or ""
        )
        assert axis(force) == axis(page.locator("[data-signal='revolution']"))


def test_the_catalogue_is_laid_over_one_channel_and_the_moment_is_corrected(
    browser: Browser, server: str, measurement: dict[str, Any]
) -> None:
    asked = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast"}
    with httpx.Client(base_url=server, timeout=300) as client:
        assert client.post("/api/v1/diagnoses", json=asked).status_code == 201
    with visiting(browser, f"{server}/measurements/{measurement['id']}?of=frame", SCREENS[0]) as visit:
        page = visit.page
        spectrum = page.locator("[data-signal='spectrum']")
        expect(spectrum.locator("canvas")).to_have_count(1, timeout=SECONDS)
        plain = pixels(spectrum)
        page.get_by_label("Channel").select_option("y")
        expect(page.locator("[data-note='spectrum']")).to_contain_text("First: B. Second: ", timeout=SECONDS)
        expect(spectrum).to_have_attribute("data-look", re.compile("channel=y"))
        assert pixels(spectrum) != plain
        head, rows = numbers(page, spectrum)
        column = {name.partition(" [")[0]: place for place, name in enumerate(head)}
        # At the first orders the machine shakes as the catalogue's does.
        at = [int(np.nanargmin(np.abs(rows[:, 0] - order))) for order in (1, 2, 3)]
        laid = [int(np.flatnonzero(rows[:, 0] == order)[0]) for order in (1, 2, 3)]
        measured = [np.nanmax(rows[max(0, place - 8) : place + 9, column["y"]]) for place in at]
        assert np.median(np.abs(rows[laid, column["y, first"]] - measured)) < 8.0
        page.get_by_text("Correct when it was measured").click()
        page.get_by_role("textbox", name="Measured").fill("2026-03-01T06:00:00")
        page.get_by_role("button", name="Correct it").click()
        expect(page.get_by_text("2026-03-01 06:00").first).to_be_visible()
        assert is_within_screen(page) and serious(page) == []


def test_a_measured_spectrum_has_its_chart(visit: Visit, server: str) -> None:
    rows = [f"{line},{2.0 if line == 120 else 0.01}" for line in range(1, 401)]
    content = "\n".join(["f [Hz],a [m/s2 rms]", *rows]).encode()
    with httpx.Client(base_url=server, timeout=300) as client:
        key = send(client, content, "route.csv", window="hann").json()["id"]
    page = visit.page
    page.goto(f"{server}/measurements/{key}?levels=lin")
    spectrum = page.locator("[data-signal='spectrum']")
    expect(spectrum.locator("canvas")).to_have_count(1, timeout=SECONDS)
    assert has_drawn(spectrum.locator("canvas")) and page.locator("[data-signal]").count() == 1
    head, lines = numbers(page, spectrum)
    assert head == ["frequency, Hz", "a [m/s2 rms]"] and len(lines) == 400
    assert lines[119] == pytest.approx([120.0, 2.0], rel=1e-4)
    assert is_within_screen(page) and serious(page) == []


def test_a_family_of_lines_goes_from_one_colour_to_another(visit: Visit, server: str) -> None:
    page = visit.page
    page.goto(f"{server}/catalogues/slider-crank?hypothesis=B")
    chart = page.locator("[data-chart]").first
    expect(chart.locator("canvas")).to_have_count(1)
    family = """place => {
        const data = JSON.parse(place.dataset.chart);
        data.lines = [0, 0.5, 1].map(share => ({ name: `${share}`, share, levels: data.orders.map(() => 10 * share) }));
        place.dataset.chart = JSON.stringify(data);
        document.dispatchEvent(new Event("htmx:after:swap", { bubbles: true }));
    }"""
    chart.evaluate(family)
    strokes = chart.evaluate(
        "place => window.jointplay.chartAt(place).chart.series.slice(3).map(line => line.stroke())"
    )
    assert len(set(strokes)) == 3 and all(stroke.startswith("rgb(") for stroke in strokes)


def test_a_spectrogram_that_is_shown_whole_again_is_the_whole_one(visit: Visit, server: str, minute: str) -> None:
    page = visit.page
    page.goto(f"{server}/measurements/{minute}?speed=600+rpm")
    place = page.locator("[data-signal='spectrogram']")
    expect(place.locator("canvas")).to_have_count(1, timeout=SECONDS)
    place.scroll_into_view_if_needed()
    figure = "window.jointplay.chartAt(document.querySelector(\"[data-signal='spectrogram']\")).figure"
    shown = f"[{figure}.at[0], {figure}.at.at(-1), JSON.stringify({figure}.map.levels_db[0])]"
    whole = page.evaluate(shown)
    place.evaluate("each => delete each.dataset.points")
    drag(page, place, 0.4, 0.6)
    expect(place).to_have_attribute("data-points", re.compile(r"\d"), timeout=SECONDS)
    assert page.evaluate(shown)[2] != whole[2]
    zoomed = axis(place)
    place.evaluate("each => delete each.dataset.points")
    # A part of the page that comes late, or another width, has all charts drawn anew: as closely as they were.
    page.evaluate("document.dispatchEvent(new Event('htmx:after:swap', { bubbles: true }))")
    expect(place).to_have_attribute("data-points", re.compile(r"\d"), timeout=SECONDS)
    assert axis(place) == pytest.approx(zoomed)
    place.evaluate("each => delete each.dataset.points")
    place.locator(".u-over").dblclick()
    expect(place).to_have_attribute("data-points", re.compile(r"\d"), timeout=SECONDS)
    assert page.evaluate(shown) == whole


def test_charts_are_saved_as_png_and_svg(visit: Visit, server: str, minute: str) -> None:
    page = visit.page
    page.goto(f"{server}/measurements/{minute}?speed=600+rpm")
    for view in ("spectrum", "waveform", "revolution", "spectrogram"):
        chart = page.locator(f"[data-signal='{view}']")
        expect(chart.locator("canvas")).to_have_count(1, timeout=SECONDS)
        png = saved(page, chart, "png")
        assert png[:8] == b"\x89PNG\r\n\x1a\n"
        width, height = struct.unpack(">II", png[16:24])
        assert width > 200 and height > 200 and len(png) > 3000
        drawn = ElementTree.fromstring(saved(page, chart, "svg"))
        names = {element.tag.rpartition("}")[2] for element in drawn.iter()}
        texts = [element.text for element in drawn.iter() if element.tag.endswith("text")]
        assert drawn.tag == "{http://www.w3.org/2000/svg}svg"
        assert ("image" if view == "spectrogram" else "path") in names
        assert any(
            text
            and text.startswith(
                {"waveform": "time", "spectrum": "frequency", "revolution": "angle", "spectrogram": "time"}[view]
            )
            for text in texts
        )
        if view == "waveform":
            paths = [element.get("d") or "" for element in drawn.iter() if element.tag.endswith("path")]
            assert sum(path.count("L") for path in paths) > 400
