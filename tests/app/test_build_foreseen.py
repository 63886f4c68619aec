"""Before, during and after a build: what it will take, that it goes on, how to go on, and how good its answers are."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from command_line import assert_refused, invoke

from jointplay.app.commands.progress import ProgressLine
from jointplay.app.jobs import heartbeat
from jointplay.app.jobs.build_process import BuildProgress, Telling
from jointplay.app.jobs.forecasts import forecast_text
from jointplay.app.jobs.heartbeat import Heartbeat
from jointplay.app.jobs.quality_cards import card_text
from jointplay.catalogue.building.forecast import Forecast
from jointplay.catalogue.diagnosing.quality_card import QualityCard
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines import machine

QUICK = {"machine": "slider-crank", "plan": "quick", "catalogue": "mine"}


def test_a_dry_run_says_time_and_size_and_writes_nothing(tmp_path: Path) -> None:
    asked = ("build", "slider-crank", "--catalogue", tmp_path / "c", "--plan", "quick", "--dry-run", "--workers", "3")
    document = json.loads(invoke(*asked, "--json").stdout)
    assert (document["cases"], document["present"], document["workers"]) == (960, 0, 3)
    assert document["seconds"] >= document["seconds_idle"] > 0
    assert 2e6 < document["size_bytes"] < 50e6
    said = invoke(*asked).stdout
    assert re.fullmatch(rf"{tmp_path / 'c'}: 960 cases: .* by 3 processes and \d+ MB, by \d+ cases .*\n", said)
    assert not list(tmp_path.iterdir())
    assert_refused(invoke(*asked[:-2], "--scheduler", "tcp://127.0.0.1:1"), 2, "--dry-run is for processes here")


def test_what_is_foreseen_in_words() -> None:
    found = Forecast(
        cases=100, present=40, tried=16, seconds=400.0, seconds_idle=395.0, size_bytes=2_500_000_000, workers=1
    )
    assert forecast_text(found) == (
        "100 cases, 40 are there: about 7 min by 1 process and 2.5 GB, by 16 cases that were tried now"
    )
    assert forecast_text(replace(found, seconds_idle=50.0)) == (
        "100 cases, 40 are there: 50 s on an idle computer, 7 min on one as busy as this is now, by 1 process"
        " and 2.5 GB, by 16 cases that were tried now"
    )
    assert forecast_text(Forecast(100, 100, 0, 0.0, 0.0, 0, 2)) == "all 100 cases are there"


def test_a_forecast_over_http_and_on_the_page(client: httpx.Client) -> None:
    answer = client.post("/api/v1/forecasts", json=QUICK)
    assert answer.status_code == 200, answer.text
    found = answer.json()
    assert (found["cases"], found["present"]) == (960, 0)
    assert client.post("/api/v1/forecasts", json=QUICK).json() == found, "kept for a while"
    refused = client.post("/api/v1/forecasts", json={**QUICK, "machine": "none"})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "machine")
    text = f"{found['cases']} cases: "
    form = {**QUICK}
    page = client.post("/builds/forecast", data=form, headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert text in page.text and 'value="mine"' in page.text
    part = client.post("/builds/forecast", data=form, headers={"HX-Request": "true", "Accept": "text/html"})
    assert part.text.startswith(text) and "<form" not in part.text
    bad = client.post("/builds/forecast", data={**form, "machine": "none"}, headers={"Accept": "text/html"})
    assert bad.status_code == 422


def test_ctrl_c_says_that_the_same_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(machine, "load_machine", stopped)
    result = invoke("build", "slider-crank", "--catalogue", tmp_path / "c")
    assert result.exit_code == 130
    first, *_, last = result.stderr.splitlines()
    assert first == "what is computed is kept; the same command goes on where this one stopped"
    assert last == "jointplay: interrupted"
    assert "kept" not in invoke("build", "slider-crank", "--catalogue", tmp_path / "c", "--dry-run").stderr


def test_work_that_has_nothing_to_tell_says_that_it_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(heartbeat, "EVERY_S", 0.02)
    with ProgressLine("building", "cases") as line:
        line.show(3, 12, rate=0.5, left=18.0)
        deadline = time.monotonic() + 60
        shown = ""
        while "at work" not in shown and time.monotonic() < deadline:
            shown += capsys.readouterr().err
            time.sleep(0.01)
    first, second, *_ = shown.splitlines()
    assert first == "building: 3 of 12 cases, 0.5 a second, 18 s left"
    assert re.fullmatch(r"building: 3 of 12 cases: at work for \d+ s", second)
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().err == "", "it ends with the work"


def test_a_heart_does_not_beat_while_something_is_heard() -> None:
    beats: list[float] = []
    with Heartbeat(beats.append, every=3600.0) as found:
        found.heard()
    assert beats == []


class Sender:
    def __init__(self) -> None:
        self.sent: list[BuildProgress] = []

    def send(self, sent: BuildProgress) -> None:
        self.sent.append(sent)


def test_a_build_tells_its_server_that_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heartbeat, "EVERY_S", 0.02)
    sender = Sender()
    with Telling(sender) as tell:  # type: ignore[arg-type]
        tell({"cases_done": 3, "message": "1 of 2 networks are trained"})
        deadline = time.monotonic() + 60
        while len(sender.sent) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
    told = sender.sent[1]
    assert told.kind == "progress"
    assert re.fullmatch(r"1 of 2 networks are trained; at work for \d+ s", told.values["message"])


@pytest.mark.long
def test_the_quality_card_at_the_prompt_over_http_and_on_the_page(client: httpx.Client, shelf: Path) -> None:
    folder = shelf / "slider-crank"
    card = json.loads(invoke("evaluate", "--catalogue", folder, "--card", "--json").stdout)
    assert card["catalogue"] == Catalogue.open(folder).id
    assert json.loads(CatalogueDirectory(folder).quality.read_text()) == card
    said = invoke("evaluate", "--catalogue", folder, "--card").stdout
    assert said == f"{card_text(QualityCard.model_validate(card))}\n"
    first = card["noises"][0]
    assert f"{100 * first['right']:.0f} % of {first['draws']} answers name exactly the worn joints" in said
    assert client.get("/api/v1/catalogues/slider-crank").json()["quality"] == card
    page = client.get("/catalogues/slider-crank", headers={"Accept": "text/html"}).text
    assert "How good its answers are" in page
    assert f"{first['joints']['B']['detectable_from_um']:.0f} µm" in page
    assert_refused(
        invoke("evaluate", "--catalogue", folder, "--card", "--count", "9"), 2, "--count: means nothing with --card"
    )
