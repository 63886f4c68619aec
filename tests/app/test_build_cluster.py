"""Builds over HTTP on a Dask cluster and a database, both by configuration alone."""

from __future__ import annotations

import json
from pathlib import Path

import distributed
import httpx
import pytest
from command_line import assert_refused, invoke
from small_service import PLAN, serving

from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.building.build import build
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine

API = "/api/v1"
TINY = {**PLAN, "draws": {"healthy": 3, "single": 4}, "guard": 0}
ASKED = {"machine": "slider-crank", "plan": TINY, "catalogue": "made", "workers": 1}


@pytest.mark.long
def test_a_build_is_computed_by_the_cluster(tmp_path: Path, url: str) -> None:
    options = {"processes": False, "dashboard_address": ":0", "protocol": "tcp"}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
        settings = ServiceSettings(
            catalogues=tmp_path / "c", data=tmp_path / "d", database=url, scheduler=cluster.scheduler_address, workers=1
        )
        with serving(settings) as address, httpx.Client(base_url=address, timeout=300) as client:
            place = client.post(f"{API}/builds", json=ASKED).headers["location"]
            with client.stream("GET", f"{place}/events") as stream:
                states = [json.loads(line[6:]) for line in stream.iter_lines() if line.startswith("data: ")]
        worked = sum(worker.state.executed_count for worker in cluster.workers.values())
    assert states[-1]["state"] == "done", states[-1]
    assert worked > 0
    build(shipped_machine("slider-crank"), parse_plan(TINY), tmp_path / "here", workers=0)
    assert Catalogue.open(tmp_path / "here").id == states[-1]["catalogue_id"]


@pytest.mark.long
def test_a_scheduler_that_is_not_there_fails_the_build_in_one_line(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "c", data=tmp_path / "d", scheduler="tcp://127.0.0.1:1", workers=1)
    with serving(settings) as address, httpx.Client(base_url=address, timeout=300) as client:
        place = client.post(f"{API}/builds", json=ASKED).headers["location"]
        with client.stream("GET", f"{place}/events") as stream:
            states = [json.loads(line[6:]) for line in stream.iter_lines() if line.startswith("data: ")]
    assert states[-1]["state"] == "failed"
    assert states[-1]["message"] == "tcp://127.0.0.1:1: no scheduler answers within 10 s"
    assert "waiting for the scheduler tcp://127.0.0.1:1, up to 10 s" in [state["message"] for state in states]


def test_an_address_of_no_scheduler_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JOINTPLAY_SCHEDULER", "nonsense://x")
    result = invoke("serve", "--port", "0", "--data", tmp_path, "--catalogues", tmp_path)
    assert_refused(result, 2, "nonsense://x: is no address of a scheduler")
