"""The report of a diagnosis: what it says, one page as HTML and as PDF."""

from __future__ import annotations

import gzip
import io
import re
from collections.abc import Iterator
from html import unescape
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
from answers import hypothesis, joint
from http_answers import assert_problem
from pypdf import PdfReader
from recordings import RECORDINGS

from jointplay.app import words
from jointplay.app.http.handlers import templates
from jointplay.app.pages.views import view
from jointplay.app.reports.content import NO_ZONE, Report, report_of
from jointplay.app.reports.documents import html, pdf
from jointplay.app.reports.figures import DECIDED, figures_of, spectrum
from jointplay.app.routes.diagnoses import DiagnosisOut
from jointplay.app.rows import Comparison
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.storage.store import Store
from jointplay.catalogue.diagnosing.answer import BandEvidence

API = "/api/v1"
NAME = "press <7> & 'co'.csv"


@pytest.fixture(scope="module")
def diagnosis(client: httpx.Client, worn: bytes) -> DiagnosisOut:
    files = {"file": (NAME, worn)}
    fields = {"catalogue": "slider-crank", "effort": "fast"}
    answer = client.post(f"{API}/diagnoses", files=files, data=fields)
    assert answer.status_code == 201, answer.text
    return DiagnosisOut.model_validate(answer.json())


@pytest.fixture(scope="module")
def rows(settings: ServiceSettings, diagnosis: DiagnosisOut) -> Iterator[tuple[DiagnosisRow, MeasurementRow]]:
    store = Store(settings.data)
    row = store.diagnosis(diagnosis.id)
    yield row, store.measurement(row.measurement)
    store.close()


def changed(row: DiagnosisRow, **members: Any) -> DiagnosisRow:
    """The same diagnosis with another answer."""
    same = ("id", "machine", "created_at", "request", "catalogue", "checksum")
    return DiagnosisRow(**{name: getattr(row, name) for name in same}, result={**row.result, **members})


def text_of(document: bytes) -> str:
    (page,) = PdfReader(io.BytesIO(document)).pages
    return " ".join(page.extract_text().split())


def everything(report: Report) -> str:
    return " ".join(
        [
            *report.likelihood,
            *report.severity,
            *report.suggestions,
            *report.inspection,
            *report.warnings,
            *report.limits,
        ]
    )


def test_html_says_the_verdict_and_escapes_names(client: httpx.Client, diagnosis: DiagnosisOut) -> None:
    answer = client.get(f"{API}/diagnoses/{diagnosis.id}/report")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert "Accept" in answer.headers["vary"].split(", ")
    assert words.sentence(diagnosis) in unescape(answer.text)
    assert "press &lt;7&gt; &amp; &#39;co&#39;.csv" in answer.text
    assert "<7>" not in answer.text
    assert answer.text.count("<svg") == 4
    assert diagnosis.provenance.catalogue_sha256 in answer.text


def test_html_loads_nothing_and_says_so(client: httpx.Client, diagnosis: DiagnosisOut) -> None:
    answer = client.get(f"{API}/diagnoses/{diagnosis.id}/report")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; style-src 'sha256-")
    assert "unsafe" not in policy
    assert not re.findall(r"<script|<link|<img|\bsrc=|url\(|@import|\sstyle=", answer.text)
    assert set(re.findall(r"https?://[^\s\"'<]+", answer.text)) == {"http" + "://www.w3.org/2000/svg"}


def test_pdf_is_one_page_with_the_verdict(client: httpx.Client, diagnosis: DiagnosisOut) -> None:
    answer = client.get(f"{API}/diagnoses/{diagnosis.id}/report", headers={"Accept": "application/pdf"})
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/pdf"
    assert f"diagnosis-{diagnosis.id}.pdf" in answer.headers["content-disposition"]
    said = text_of(answer.content)
    assert words.sentence(diagnosis) in said
    assert NAME in said
    assert diagnosis.provenance.measurement_sha256 in said
    assert "s2-y" in said, "the drawing has its labels"
    assert "rotation of the frame" in said, "the spectra are there"


def test_the_form_is_chosen_by_query_before_accept(client: httpx.Client, diagnosis: DiagnosisOut) -> None:
    place = f"{API}/diagnoses/{diagnosis.id}/report"
    answer = client.get(place, params={"format": "pdf"}, headers={"Accept": "text/html"})
    assert answer.content.startswith(b"%PDF-")
    assert client.get(place, params={"format": "odt"}).status_code == 422
    refused = client.get(place, headers={"Accept": "image/png"})
    assert refused.status_code == 406
    assert "text/html" in refused.json()["detail"]
    assert client.get(f"{API}/diagnoses/none/report").status_code == 404


@pytest.mark.parametrize("form", ["html", "pdf"])
def test_the_same_report_is_not_sent_twice(client: httpx.Client, diagnosis: DiagnosisOut, form: str) -> None:
    place = f"{API}/diagnoses/{diagnosis.id}/report?format={form}"
    first = client.get(place)
    again = client.get(place, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert client.get(place).content == first.content


def test_a_document_is_of_its_diagnosis_and_fills_its_sheet(
    rows: tuple[DiagnosisRow, MeasurementRow],
) -> None:
    row, measurement = rows
    report = report_of(row, measurement, "press-7", "Hall 3,\nline 2")
    document = pdf(report, figures_of(row))
    reader = PdfReader(io.BytesIO(document))
    assert reader.metadata is not None and reader.metadata.creation_date == row.created_at.replace(microsecond=0)
    assert document == pdf(report, figures_of(row)), "the same report is the same bytes"
    said = text_of(document)
    assert "Notes Hall 3, line 2" in said
    assert "Sensors at s1-x (0.2, -0.1) m along (1, 0)" in said
    assert "nobody says when; received" in said
    assert "Play found across the pin, µm" in said and "Signature" in said
    assert [joint for joint, _ in report.form] == ["B", "", ""]
    seen = words.seen_sentence(row.answer)
    assert seen.startswith("No wear above: ") and seen in said
    assert words.next_step(row.answer) in said
    lowest, highest = extent_of(reader)
    assert lowest < 60 and highest > 760, "nothing of the sheet is left empty"


def extent_of(reader: PdfReader) -> tuple[float, float]:
    """The lowest and the highest text of the first page."""
    heights: list[float] = []

    def visit(text: str, cm: list[float], tm: list[float], font: object, size: float) -> None:
        if text.strip():
            heights.append(cm[3] * tm[5] + cm[5])

    reader.pages[0].extract_text(visitor_text=visit)
    return min(heights), max(heights)


def test_the_state_of_wear_stands_in_a_report_up_to_its_recording(
    client: httpx.Client, worn: bytes, in_order: bytes
) -> None:
    client.put(f"{API}/assets/trend-1", json={"machine": "slider-crank"})
    keys, measurements = [], []
    again = gzip.decompress((RECORDINGS / "slider-crank-05.csv.gz").read_bytes())
    for month, content in ((1, in_order), (5, worn), (7, again)):
        fields = {"catalogue": "slider-crank", "effort": "fast", "asset": "trend-1"}
        fields["measured_at"] = f"2024-0{month}-01T06:00:00Z"
        answer = client.post(f"{API}/diagnoses", files={"file": (f"{month}.csv", content)}, data=fields)
        assert answer.status_code == 201, answer.text
        keys.append(answer.json()["id"])
        measurements.append(answer.json()["measurement"])
    place = f"{API}/diagnoses/{keys[1]}/report?format=html"
    before = client.get(place)
    told = unescape(before.text)
    # What comes later changes nothing of it: findings, a repair, another limit, an answer to all recordings together.
    repair = {"joints": {"B": {"clearance_um": 900, "repaired": True}}, "at": "2024-06-01T06:00:00Z"}
    client.post(f"{API}/diagnoses/{keys[1]}/finding", json=repair).raise_for_status()
    limited = {"machine": "slider-crank", "limits_um": {"B": 40.0}}
    client.put(f"{API}/assets/trend-1", json=limited).raise_for_status()
    together = {"measurements": measurements[:2], "catalogue": "slider-crank", "effort": "fast", "asset": "trend-1"}
    assert_problem(client.post(f"{API}/diagnoses", json=together | {"measurements": measurements}), 422)
    common = client.post(f"{API}/diagnoses", json=together)
    assert common.status_code == 201, common.text
    first, third = (client.get(f"{API}/diagnoses/{key}/report?format=html").text for key in keys[::2])
    assert client.get(place, headers={"If-None-Match": before.headers["etag"]}).status_code == 304
    assert "up to here" not in first
    said = re.search(r"The last recording has moved the probability of wear of (.*)\.</p>", before.text)
    assert said and "B from " in said[1]
    assert re.search(r"Joint B is worn, \d+ %, sure since 2024-05-01: \d+ µm \(", told)
    drawn = before.text[before.text.index("Radial clearance over time") :]
    drawn = drawn[: drawn.index("</svg>")]
    # Joint B is drawn from when it was worn on.
    assert [text in drawn for text in ("● B", "limit", "2024-01-01", "2024-05-01")] == [True, True, False, True]
    assert "Joint B was repaired on 2024-06-01." in third and "by all 3 answers up to it" in third
    assert "↺ B" in third and "◆ B" in third
    now = client.get(f"{API}/assets/trend-1/state").json()
    assert now["visits"] == 2 and len(now["repairs"]) == 1
    assert "up to here" in text_of(client.get(f"{API}/diagnoses/{keys[2]}/report?format=pdf").content)


def test_severity_and_likelihood_stand_apart(rows: tuple[DiagnosisRow, MeasurementRow]) -> None:
    report = report_of(*rows)
    assert "µm" not in " ".join(report.likelihood)
    assert NO_ZONE in report.severity
    assert "probability" not in " ".join(report.severity)
    assert "µm" in report.severity[0]


def test_the_play_to_be_measured_is_twice_the_clearance(rows: tuple[DiagnosisRow, MeasurementRow]) -> None:
    row, measurement = rows
    hypotheses = [
        {**hypothesis("A", 0.8), "joints": {"A": {"clearance_um": 200.0, "interval_um": [150.0, 260.0]}}},
        hypothesis("B", 0.2, B=90.0),
    ]
    joints = {"A": joint("open", 190.0, 0.8), "B": joint("open", 40.0, 0.2)}
    members = {"verdict": "worn", "hypotheses": hypotheses, "candidate_set": ["A", "B"], "joints": joints}
    report = report_of(changed(row, **members), measurement)
    assert "300 to 520 µm of diametral play" in report.inspection[0]
    assert report.inspection[1] == "If that is not found, look at B next."
    assert report.suggestions[0].endswith("the second hypothesis, B, has a probability of 20 %.")


def test_what_tells_the_first_two_apart_comes_first(rows: tuple[DiagnosisRow, MeasurementRow]) -> None:
    row, measurement = rows
    first, second, third = (entry.label for entry in row.answer.hypotheses[:3])
    numbers = {"separation_now": 1.0, "separation": 3.0, "error_now": 0.2, "error": 0.03}
    told = [
        {"kind": "speed", "what": "96 rpm", "hypotheses": [first, third], **numbers},
        {"kind": "sensor", "what": "s3-y", "hypotheses": [first, second], **numbers},
    ]
    report = report_of(changed(row, suggestions=told), measurement)
    page = templates.env.get_template("_result.html").render(result=view(changed(row, suggestions=told), measurement))
    listed = re.findall(r'<th scope="row">(.*?)</th><td>(.*?)</td><td class="figure">(.*?)</td>', page)
    assert [each[:2] for each in listed][:2] == [
        ("speed 96 rpm", f"{first} / {third}"),
        ("sensor s3-y", f"{first} / {second}"),
    ]
    link = f'href="/?beside={row.id}&amp;catalogue=slider-crank"'
    given = changed(row, suggestions=told)
    given.request = {**row.request, "speed": "600 rpm"}
    turned = templates.env.get_template("_result.html").render(result=view(given, measurement))
    assert link in page and link in turned
    assert "Measured besides" not in templates.env.get_template("_result.html").render(result=view(row, measurement))
    assert len(report.suggestions) == 1
    assert report.suggestions[0].startswith(f"Sensor s3-y: of {first} and {second} the wrong one")


@pytest.mark.parametrize("verdict", ["in_order", "changed", "unknown"])
def test_no_joint_is_to_be_opened_without_a_fault(rows: tuple[DiagnosisRow, MeasurementRow], verdict: str) -> None:
    report = report_of(changed(rows[0], verdict=verdict), rows[1])
    assert "drive locked out" not in everything(report)
    assert "µm" not in " ".join(report.severity)


@pytest.mark.parametrize(
    ("verdict", "decided"), [("worn", True), ("in_order", True), ("changed", False), ("unknown", False)]
)
def test_no_joint_is_coloured_barred_or_ringed_without_a_verdict_on_joints(
    rows: tuple[DiagnosisRow, MeasurementRow], verdict: str, decided: bool
) -> None:
    row = changed(rows[0], verdict=verdict)
    page = templates.env.get_template("_result.html").render(result=view(row, rows[1]))
    figures = figures_of(row)
    ring = f'fill="none" stroke="{DECIDED}"'
    seen = [
        'fill="rgb(232 106 20' in page,
        "<meter" in page,
        'class="key decided"' in page,
        "Bands that decided" in page,
        bool(re.search(r'class="joint joint-B"><title>[^<]*</title><circle [^>]*fill="#', figures.mechanism)),
        any(ring in spectrum for spectrum in figures.spectra),
        "Rings: " in figures.caption,
    ]
    assert seen == [decided] * len(seen)
    for line in words.remarks(row.answer):
        assert line in unescape(page) and line in report_of(row, rows[1]).remarks


def test_much_text_stays_on_one_page(rows: tuple[DiagnosisRow, MeasurementRow]) -> None:
    row, measurement = rows
    numbers = {"separation_now": 1.0, "separation": 3.0, "error_now": 0.2, "error": 0.03}
    first, second = (entry.label for entry in row.answer.hypotheses[:2])
    told = [{"kind": "direction", "what": "y at (0.2, -0.1) m", "hypotheses": [first, second], **numbers}] * 9
    full = changed(row, warnings=["<script>alert(1)</script> & more " * 30] * 20, suggestions=told)
    past = tuple(f"The state of wear, line {number}: joint B is worn; {'more ' * 30}" for number in range(10))
    report, figures = report_of(full, measurement, "W" * 300, past=past), figures_of(full)
    said = text_of(pdf(report, figures))
    assert "16 more in the answer itself" in said and "The state of wear, line 9" in said
    assert "Steps sensors" in said, "the last table is there"
    page = html(report, figures)
    assert "<script" not in page
    assert "W" * 65 not in page


def band(order: int, measured: float, spread: float, z: float) -> BandEvidence:
    edges = {"low_hz": order - 0.5, "high_hz": order + 0.5}
    levels = {"measured_db": measured, "predicted_db": -20.0, "spread_db": spread, "z": z}
    return BandEvidence(order=order, channel="x", **edges, **levels)


def test_a_spectrum_rings_the_bands_that_decided() -> None:
    bands = tuple(band(order, -20.0 + order, 2.0, float(order)) for order in range(1, 11))
    drawn = ElementTree.fromstring(spectrum(Comparison("s1 <x>", bands), bands[-3:]))
    circles = [each for each in drawn.iter() if each.tag.endswith("circle")]
    rings = [each for each in circles if each.get("fill") == "none"]
    dots = [each for each in circles if each.get("fill") != "none"]
    assert (len(dots), len(rings)) == (10, 3)
    assert {ring.get("cx") for ring in rings} == {dot.get("cx") for dot in dots[-3:]}
    assert "s1 <x>" in [each.text for each in drawn.iter()]


def test_a_single_band_can_be_drawn() -> None:
    ElementTree.fromstring(spectrum(Comparison("x", (band(1, -20.0, 0.0, 0.0),))))


def test_a_report_stays_when_its_asset_is_gone(client: httpx.Client, worn: bytes, in_order: bytes) -> None:
    client.put(f"{API}/assets/trend-2", json={"machine": "slider-crank"})
    fields = {"catalogue": "slider-crank", "effort": "fast", "asset": "trend-2"}
    for content in (in_order, worn):
        answer = client.post(f"{API}/diagnoses", files={"file": ("one.csv", content)}, data=fields)
        assert answer.status_code == 201, answer.text
    place = f"{API}/diagnoses/{answer.json()['id']}/report?format=html"
    assert "up to here" in client.get(place).text
    assert client.delete(f"{API}/assets/trend-2").status_code == 204
    gone = client.get(place)
    assert gone.status_code == 200 and "up to here" not in gone.text
