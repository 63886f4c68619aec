"""/readyz tells what is missing: each thing is taken away and given back."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from small_service import running

from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return tmp_path / "data"


@pytest.fixture
def application(tmp_path: Path, data: Path) -> FastAPI:
    return create_app(ServiceSettings(catalogues=tmp_path / "none", data=data, workers=1, builds=0))


@pytest.fixture
def client(application: FastAPI) -> Iterator[httpx.Client]:
    with running(application) as address, httpx.Client(base_url=address, timeout=300) as found:
        yield found


def assert_ready(client: httpx.Client) -> None:
    response = client.get("/readyz")
    assert (response.status_code, response.json()) == (200, {"status": "ready", "catalogues": 0})


def assert_not_ready(client: httpx.Client, detail: str, kind: str = "not-ready") -> None:
    response = client.get("/readyz")
    assert response.status_code == 503
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["retry-after"] == "5"
    document = response.json()
    assert (document["type"], document["detail"]) == (f"urn:jointplay:problem:{kind}", detail)
    assert client.get("/healthz").json() == {"status": "ok"}  # the process itself is well


def test_a_folder_that_cannot_be_written_to(client: httpx.Client, data: Path) -> None:
    assert_ready(client)
    (data / "measurements").rename(data / "elsewhere")
    assert_not_ready(client, "data: No such file or directory")
    (data / "measurements").write_bytes(b"")
    assert_not_ready(client, "data: Not a directory")
    (data / "measurements").unlink()
    (data / "elsewhere").rename(data / "measurements")
    assert_ready(client)
    assert list((data / "measurements").iterdir()) == []


def test_a_database_whose_file_is_gone(client: httpx.Client, data: Path) -> None:
    file = data / "service.sqlite"
    file.rename(data / "kept")
    assert_not_ready(client, "database: its file is not the one that was opened", "database-gone")
    file.write_bytes((data / "kept").read_bytes())  # another file: what the service writes does not get there
    assert_not_ready(client, "database: its file is not the one that was opened", "database-gone")
    (data / "kept").rename(file)
    assert_ready(client)


def test_workers_that_cannot_start(client: httpx.Client) -> None:
    try:
        multiprocessing.set_executable("/bin/false")
        assert_not_ready(client, "workers: none can be started")
        multiprocessing.set_executable("/nothing/here")
        assert_not_ready(client, "workers: none can be started")
    finally:
        multiprocessing.set_executable(sys.executable)
    assert_ready(client)


def test_a_worker_that_died_is_replaced(client: httpx.Client, application: FastAPI) -> None:
    assert_ready(client)
    ((_name, process),) = application.state.service.pool.processes()
    os.kill(process, signal.SIGKILL)
    assert_ready(client)
    assert application.state.service.pool.processes() != [("worker-0", process)]


def test_all_that_is_missing_is_named(client: httpx.Client, application: FastAPI, data: Path) -> None:
    application.state.service.stop()
    assert_not_ready(client, "the service is stopping")
    data.rename(data.with_name("moved"))
    faults = "database: its file is not the one that was opened; data: No such file or directory"
    assert_not_ready(client, f"{faults}; the service is stopping", "database-gone")
