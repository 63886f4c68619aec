"""Answers that earlier versions stored: read in the present form, shown everywhere, and stored as they were."""

from __future__ import annotations

import json
from contextlib import closing
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from small_service import asking
from sqlalchemy import text
from uploaded import uploaded

from jointplay.app import words
from jointplay.app.pages.views import view
from jointplay.app.reports.content import report_of
from jointplay.app.reports.figures import figures_of
from jointplay.app.reports.html import html
from jointplay.app.reports.pdf import pdf
from jointplay.app.settings import Settings
from jointplay.app.storage.older_results import in_present_form
from jointplay.app.storage.results import DiagnosisOut, diagnosis_out
from jointplay.app.storage.store import DiagnosisRow, MeasurementRow, Store, now
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.solver.machines.machine import shipped_machine

STORED = Path(__file__).parents[1] / "data" / "answers" / "answer-1.24.json"
MACHINE: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json")
SUMMARY = {"kind": "recording", "channels": [], "samples": 25_000, "duration_s": 2.5, "sample_rate_hz": 10_000.0}


@pytest.fixture
def older() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(STORED.read_text(encoding="utf-8"))
    return found


def of_verdict(older: dict[str, Any], verdict: str) -> dict[str, Any]:
    if verdict == "healthy":
        sound = {"label": "as-new", "joints": {}, "probability": 0.97, "distance_db": 1.0}
        return {
            **older,
            "verdict": verdict,
            "hypotheses": [sound, *older["hypotheses"][1:]],
            "candidate_set": ["as-new"],
        }
    return {**older, "verdict": verdict}


def kept(store: Store, result: dict[str, Any]) -> tuple[str, MeasurementRow]:
    measurement = store.add_measurement(uploaded(store), "a.csv", None, SUMMARY)
    row = DiagnosisRow(
        id="d" * 32,
        measurement=measurement.id,
        catalogue="c" * 64,
        machine=MACHINE,
        created_at=now(),
        request={"catalogue": "slider-crank"},
        result=result,
    )
    with store.database.writing() as session:
        session.add(row)
    return "d" * 32, measurement


def test_a_worn_joint_is_said_by_itself(older: dict[str, Any]) -> None:
    found = in_present_form(older, MACHINE)
    assert found["verdict"] == "worn"
    assert found["joints"].keys() == {"B"}
    joint = found["joints"]["B"]
    assert (joint["condition"], joint["p_worn"], joint["bound"]) == ("worn", 1.0, "none")
    assert (joint["clearance_um"], joint["interval_um"]) == (191.563, [154.016, 226.776])
    assert joint["limit_um"] == pytest.approx(200.0)
    assert 0.3 < joint["p_over_limit"] < 0.45
    assert joint["detectable_from_um"] is None
    assert (found["causes"], found["sensors"]) == ([], [])
    assert {name: found[name] for name in ("id", "hash", "hypotheses")} == {
        name: older[name] for name in ("id", "hash", "hypotheses")
    }
    assert (
        words.sentence(Diagnosis.model_validate(found))
        == "Joint B is worn: radial clearance 192 µm (90 %: 154 to 227), probability > 99 %."
    )


def test_a_joint_that_was_not_sure_is_open(older: dict[str, Any]) -> None:
    doubtful = {**older, "joint_probabilities": {"A": 0.3, "B": 0.7, "O": 0.0}}
    found = in_present_form(doubtful, MACHINE)
    assert found["joints"]["B"]["condition"] == "open"
    assert words.sentence(Diagnosis.model_validate(found)).startswith("Probably joint B is worn: ")
    assert words.short(Diagnosis.model_validate(found)) == "B probably worn"


@pytest.mark.parametrize(("verdict", "now"), [("healthy", "in_order"), ("unknown", "unknown")])
def test_other_verdicts_name_no_joint(older: dict[str, Any], verdict: str, now: str) -> None:
    found = in_present_form(of_verdict(older, verdict), MACHINE)
    assert (found["verdict"], found["joints"]) == (now, {})


def test_a_prior_of_every_set_is_said_by_how_many_joints_wear(older: dict[str, Any]) -> None:
    three = {"label": "A+B+O", "joints": {"A": {}, "B": {}, "O": {}}, "probability": 0.0}
    answered = {**older, "prior": {"another": 0.4, "joints": {}}, "hypotheses": [*older["hypotheses"], three]}
    # Three single joints, three pairs at 0.4 and a triple at 0.16.
    prior = in_present_form(answered, MACHINE)["prior"]
    assert prior["numbers"] == pytest.approx([3 / 4.36, 1.2 / 4.36, 0.16 / 4.36])
    assert prior["worn"] == pytest.approx(4.36 / 5.36)
    # Then every number of joints had as much as there are joints: 3, 3 x 0.4 and 3 x 0.16.
    later = in_present_form({**answered, "prior": {**answered["prior"], "numbers": [0.6, 0.3, 0.1]}}, MACHINE)["prior"]
    assert later["numbers"] == [0.6, 0.3, 0.1]
    assert later["worn"] == pytest.approx(4.68 / 5.68)


def test_an_answer_of_now_stays(older: dict[str, Any]) -> None:
    found = in_present_form(older, MACHINE)
    assert in_present_form(found, MACHINE) == found


@pytest.mark.parametrize("verdict", ["fault", "healthy", "unknown"])
def test_what_was_stored_is_read_and_shown(store: Store, older: dict[str, Any], verdict: str) -> None:
    result = of_verdict(older, verdict)
    key, measurement = kept(store, result)
    row = store.diagnosis(key)
    (listed,) = store.diagnoses(None, 5)
    assert row.result == listed.result == in_present_form(result, MACHINE)
    assert DiagnosisOut.model_validate_json(diagnosis_out(row).model_dump_json()).verdict == row.result["verdict"]
    assert view(row, measurement)["sentence"] == words.sentence(row.answer)
    report = report_of(row, measurement)
    assert report.sentence in unescape(html(report, figures_of(row)))
    assert pdf(report, figures_of(row)).startswith(b"%PDF-")
    with store.database.writing() as session:  # nothing that is read is written back
        (kept_text,) = session.execute(text("SELECT result FROM diagnoses")).one()
    assert (json.loads(kept_text) if isinstance(kept_text, str) else kept_text) == result


def test_the_service_answers_in_the_present_form(older: dict[str, Any], tmp_path: Path) -> None:
    with closing(Store(tmp_path / "data")) as store:
        key, _ = kept(store, older)
    settings = Settings(catalogues=tmp_path / "none", data=tmp_path / "data", workers=1, builds=0, keys="off")
    with asking(settings) as client:
        (item,) = client.get("/api/v1/diagnoses").json()["items"]
        assert (item["id"], item["verdict"]) == (key, "worn")
        answer = client.get(f"/api/v1/diagnoses/{key}")
        assert answer.json()["joints"]["B"]["condition"] == "worn"
        assert client.get(f"/api/v1/diagnoses/{key}", headers={"If-None-Match": f'"{key}"'}).status_code == 200
        page = client.get(f"/diagnoses/{key}")
        assert page.status_code == 200
        assert words.sentence(Diagnosis.model_validate(in_present_form(older, MACHINE))) in unescape(page.text)
