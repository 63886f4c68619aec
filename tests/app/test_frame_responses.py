"""What the frame of a machine answers to forces, where its file says it: on the page of a catalogue, in reports."""

from __future__ import annotations

import dataclasses
import io
import re
from xml.etree import ElementTree

import httpx
import pytest
from bent_frames import bent
from playwright.sync_api import Browser, expect
from pypdf import PdfReader
from real_browser import SCREENS, is_within_screen, serious, visiting

from jointplay.app.figures.pictures import response_picture
from jointplay.app.shelves.catalogues import CatalogueShelf, Offer
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.app.storage.store import Store

ALOUD = "slider-crank, what its sensors answer to forces at joint O; by the modes at 180 Hz of frame on its supports; "
HEADING = "What the frame answers to forces"


@pytest.fixture
def bending(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the machine of the catalogue, and of those diagnosed, the frame has a mode."""
    find, diagnosis = CatalogueShelf.find, Store.diagnosis

    def find_bent(shelf: CatalogueShelf, name: str) -> Offer:
        return dataclasses.replace(find(shelf, name), machine=bent(180.0))

    def with_bent(store: Store, key: str) -> DiagnosisRow:
        row = diagnosis(store, key)
        row.machine = bent(180.0).model_dump(mode="json")
        return row

    monkeypatch.setattr(CatalogueShelf, "find", find_bent)
    monkeypatch.setattr(Store, "diagnosis", with_bent)


@pytest.fixture(scope="module")
def report(client: httpx.Client, worn: bytes) -> str:
    """Where the report of a diagnosis is."""
    fields = {"catalogue": "slider-crank", "effort": "fast"}
    answer = client.post("/api/v1/diagnoses", files={"file": ("worn.csv", worn)}, data=fields)
    assert answer.status_code == 201, answer.text
    return f"/api/v1/diagnoses/{answer.json()['id']}/report"


def text_of(client: httpx.Client, report: str) -> str:
    (page,) = PdfReader(io.BytesIO(client.get(report, params={"format": "pdf"}).content)).pages
    return " ".join(page.extract_text().split())


def test_a_machine_without_has_none(client: httpx.Client, report: str) -> None:
    for place in ("/catalogues/slider-crank", report):
        assert HEADING not in client.get(place).text
    assert HEADING not in text_of(client, report)


@pytest.mark.usefixtures("bending")
def test_pages_and_reports_show_it(client: httpx.Client, report: str) -> None:
    for place in ("/catalogues/slider-crank", report):
        text = client.get(place).text
        assert HEADING in text
        # Titles are what it is read aloud by.
        assert len(re.findall(rf'<svg [^>]*role="img"[^>]*>\s*<title>{ALOUD}the strongest answers: to fx 0', text)) == 1
        assert ' style="' not in text  # which the policies of both let no browser follow
    assert "</html>" in text
    assert client.get("/catalogues/slider-crank", headers={"HX-Request": "true"}).text.count("<svg") == 1
    said = text_of(client, report)
    assert HEADING in said
    assert "to moment [m/s2/(N m)]" in said


@pytest.mark.usefixtures("bending")
@pytest.mark.parametrize("screen", SCREENS, ids=["wide", "narrow"])
def test_it_is_seen_in_a_browser(browser: Browser, server: str, screen: tuple[int, int, str], report: str) -> None:
    with visiting(browser, f"{server}/catalogues/slider-crank", screen) as visit:
        expect(visit.page.get_by_role("img", name=ALOUD)).to_be_visible()
        expect(visit.page.get_by_role("region", name=HEADING)).to_be_visible()
        assert is_within_screen(visit.page)
        assert serious(visit.page) == []
    with visiting(browser, f"{server}{report}?format=html", screen) as visit:
        drawn = visit.page.get_by_role("img", name=ALOUD)
        expect(drawn).to_be_visible()
        # The sheet with its tables may be wider than a telephone; the figure is not.
        box = drawn.bounding_box()
        assert box is not None and box["width"] <= screen[0]


def test_the_figure_has_phases_where_asked_for() -> None:
    drawn = {phase: ElementTree.fromstring(response_picture(bent(180.0), phase)) for phase in (True, False)}
    texts = {phase: {each.text for each in svg.iter() if each.tag.endswith("}text")} for phase, svg in drawn.items()}
    assert texts[True] - texts[False] >= {"phase [deg]", "90"}
    assert texts[False] >= {"magnitude", "s1-x", "to fy [m/s2/N]"}
