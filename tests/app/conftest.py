"""A small real catalogue of the slider-crank, built once, and a service over it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from filelock import FileLock
from http_answers import send
from playwright.sync_api import Browser
from real_browser import running
from recordings import unpacked
from small_service import PLAN, serving
from webhook_listener import Listener, listening

from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.store import Store
from jointplay.catalogue.building.build import build
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.solver.machines.machine import shipped_machine


@pytest.fixture
def store(url: str, tmp_path: Path) -> Iterator[Store]:
    """A new store over a database of each kind there is."""
    with closing(Store(tmp_path, url)) as opened:
        yield opened


@pytest.fixture(scope="session")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that holds one catalogue, ``slider-crank``; test processes share it."""
    folder = tmp_path_factory.getbasetemp()
    if folder.name.startswith("popen-"):
        folder = folder.parent
    folder = folder / "shelf"
    with FileLock(folder.with_suffix(".lock")):
        build(shipped_machine("slider-crank"), parse_plan(PLAN), folder / "slider-crank", workers=2)
    return folder


@pytest.fixture(scope="session")
def settings(shelf: Path, tmp_path_factory: pytest.TempPathFactory) -> ServiceSettings:
    """Settings of a small service."""
    data = tmp_path_factory.mktemp("data")
    return ServiceSettings(catalogues=shelf, data=data, max_upload_mb=3.0, time_limit_s=300.0, workers=1)


@pytest.fixture(scope="session")
def server(settings: ServiceSettings) -> Iterator[str]:
    """Address of the running service."""
    with serving(settings) as address:
        yield address


@pytest.fixture(scope="session")
def client(server: str) -> Iterator[httpx.Client]:
    """A client of the running service."""
    with httpx.Client(base_url=server, timeout=300) as running:
        yield running


@pytest.fixture(scope="session")
def worn() -> bytes:
    """A recording, as CSV, of a slider-crank whose joint B has 150 um of radial clearance."""
    return unpacked("slider-crank-02.csv")


@pytest.fixture(scope="session")
def in_order() -> bytes:
    """A recording, as CSV, of a slider-crank in order."""
    return unpacked("slider-crank-01.csv")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium; closed with the module, because its loop would be in the way of others."""
    with running() as found:
        yield found


@pytest.fixture
def listener() -> Iterator[Listener]:
    """A server that webhooks can lead to."""
    with listening() as found:
        yield found


@pytest.fixture(scope="module")
def measurement(client: httpx.Client, worn: bytes) -> dict[str, Any]:
    """A recording of a worn machine, stored."""
    response = send(client, worn, "worn.csv")
    assert response.status_code == 201, response.text
    document: dict[str, Any] = response.json()
    return document
