"""A catalogue that cannot be read is listed as damaged, asked for it is named as such, and logged once."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from small_service import PLAN, asking

from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.solver.machines.machine import shipped_machine

API = "/api/v1"


def test_a_damaged_catalogue_is_listed_named_and_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    machine = shipped_machine("slider-crank")
    layout = CatalogueDirectory(tmp_path / "catalogues" / "press-7")
    layout.create()
    Manifest.of(machine, parse_plan(PLAN).resolve(machine)).write(layout)
    whole = layout.manifest.read_bytes()
    layout.manifest.write_bytes(whole.replace(b'"', b"?", 1))
    settings = ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", workers=1, builds=0)
    with caplog.at_level(logging.WARNING), asking(settings) as client:
        for _ in range(3):
            page = client.get(f"{API}/catalogues").json()
            assert page["items"] == []
            ((name, reason),) = [tuple(each.values()) for each in page["damaged"]]
            assert name == "press-7" and "cannot be read as JSON" in reason
        for place in ("press-7", "press-7/drawing.svg", "press-7/entries"):
            answer = client.get(f"{API}/catalogues/{place}")
            assert (answer.status_code, answer.json()["type"]) == (500, "urn:jointplay:problem:damaged-catalogue")
            assert answer.json()["detail"].startswith("catalogue: press-7: is damaged: ")
        assert client.get(f"{API}/catalogues/press-8").status_code == 404
        assert "jointplay_catalogues_damaged 1.0" in client.get("/metrics").text
        page_text = client.get("/catalogues", headers={"Accept": "text/html"}).text
        assert "press-7" in page_text and "cannot be read as JSON" in page_text
        (said,) = [each.message for each in caplog.records if each.name.endswith("shelves.catalogues")]
        assert said.startswith("catalogue press-7 is damaged: ")
        layout.manifest.write_bytes(whole)
        page = client.get(f"{API}/catalogues").json()
        assert ([each["name"] for each in page["items"]], page["damaged"]) == (["press-7"], [])


def test_ids_with_a_slash_are_refused_in_one_line(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "none", data=tmp_path / "data", workers=1, builds=0)
    with asking(settings) as client:
        for method in ("PUT", "GET"):
            answer = client.request(
                method, f"{API}/assets/HALL%2F7", json={"machine": "m"} if method == "PUT" else None
            )
            assert answer.status_code == 422
            assert answer.json()["detail"] == "the address holds %2F: no id or name has a / in it"
        asked = {"measurement": "0" * 32, "catalogue": "c", "asset": "HALL/7"}
        answer = client.post(f"{API}/diagnoses", json=asked)
        assert answer.status_code in (404, 422)
        answer = client.put(f"{API}/assets/-7", json={"machine": "m"})
        assert (answer.status_code, "without / or blanks" in answer.json()["detail"]) == (422, True)
