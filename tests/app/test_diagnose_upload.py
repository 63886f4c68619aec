"""A recording sent with its question: read once, and kept with its answer, or not at all."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from jointplay.app.errors import AppError, BadFieldError, TimeLimitError, UnknownCatalogueError, WorkerDiedError
from jointplay.app.jobs import tasks
from jointplay.app.jobs.answers import Answers
from jointplay.app.jobs.background import Background
from jointplay.app.jobs.build_runner import BuildRunner
from jointplay.app.jobs.workers import TaskFailedError, WorkerPool, attempt
from jointplay.app.metrics import Metrics
from jointplay.app.schemas.assets import AssetIn
from jointplay.app.schemas.resources import DiagnosisRequest
from jointplay.app.service import Service
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.catalogues import CatalogueShelf
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.remembered import Remembered
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.app.storage.store import Store, measurement_key
from jointplay.app.storage.told import Told
from jointplay.catalogue.measurements.measurement import Recording


class Here:
    """Runs tasks in this process, and notes which; may fail as a pool of processes does."""

    def __init__(self, failure: AppError | None = None) -> None:
        self.failure = failure
        self.asked: list[str] = []

    async def run(self, task: Callable[..., Any], *args: Any) -> Any:
        self.asked.append(task.__name__)
        if self.failure is not None and task is tasks.summarise_and_diagnose:
            raise self.failure
        return attempt(task, args).result()


def service_of(shelf: Path, data: Path, pool: Here) -> Service:
    settings = ServiceSettings(catalogues=shelf, data=data)
    store = Store(data)
    queue = BuildQueue(store.database)
    runner = BuildRunner(queue, shelf, 0, 30.0)
    parts = (CatalogueShelf(shelf), cast(WorkerPool, pool), MachineStore(data / "machines"), queue, runner)
    answers = Answers(cast(WorkerPool, pool), Background(120.0), store.uploads, 120.0)
    return Service(settings, store, *parts, Metrics(), answers)


def ask(service: Service, content: bytes, **members: Any) -> DiagnosisRow:
    upload = service.store.uploads.receive(io.BytesIO(content))
    key = measurement_key(upload.sha256, "worn.csv", Told())
    question = {"catalogue": "slider-crank", "effort": "fast", "measurement": key, **members}
    try:
        request = DiagnosisRequest.model_validate(question)
        return asyncio.run(service.diagnose_upload(upload, "worn.csv", Told(), request))
    finally:
        service.store.uploads.settle(upload)


def kept(service: Service) -> int:
    """Rows and files, of samples too."""
    rows = len(service.store.measurements(None, 10))
    folders = (service.store.directory / name for name in ("measurements", "signals"))
    return rows + len([path for folder in folders for path in folder.rglob("*") if path.is_file()])


def test_the_recording_is_read_once(shelf: Path, tmp_path: Path, worn: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    read, times = tasks.read, []

    def counting(*recording: Any) -> Recording:
        times.append(recording)
        return read(*recording)

    monkeypatch.setattr(tasks, "read", counting)
    pool = Here()
    service = service_of(shelf, tmp_path, pool)
    row = ask(service, worn)
    assert pool.asked == ["summarise_and_diagnose"]
    assert len(times) == 1
    stored = service.store.measurement(row.measurement)
    again = tasks.summarise(str(service.store.path_of(stored.sha256)), "worn.csv", Told())
    assert {**stored.summary, "measured_at": None} == again  # when it was measured has columns of its own
    asked = {name: value for name, value in row.request.items() if name in DiagnosisRequest.model_fields}
    again = asyncio.run(service.diagnose(DiagnosisRequest.model_validate(asked)))
    assert (again.id, again.result) == (row.id, row.result)


@pytest.mark.parametrize(
    ("members", "error", "said"),
    [
        ({"catalogue": "nonsense"}, UnknownCatalogueError, "catalogue: nonsense"),
        ({"speed": "3 kg"}, BadFieldError, "speed: 3 kg"),
        ({"mapping": {"x": "y"}}, TaskFailedError, "s1-x"),
        ({"asset": "press-7"}, TaskFailedError, "s1-x"),  # what is remembered of its files does not fit
    ],
)
def test_what_is_refused_is_not_kept(
    shelf: Path, tmp_path: Path, worn: bytes, members: dict[str, Any], error: type[Exception], said: str
) -> None:
    service = service_of(shelf, tmp_path, Here())
    columns = worn.partition(b"\n")[0].decode().split(",")
    names = [name.partition(" [")[0].strip() for name in columns if not name.startswith("t")]
    Assets(service.store.database).put("press-7", AssetIn(machine="slider-crank"))
    with service.store.database.writing() as session:
        Remembered(service.store.database).remember(session, "press-7", names, {}, dict.fromkeys(names[:1], "y"))
    with pytest.raises(error, match=said):
        ask(service, worn, **members)
    assert kept(service) == 0
    assert service.store.diagnoses(None, 10) == []


@pytest.mark.parametrize("failure", [TimeLimitError("stopped"), WorkerDiedError("ended")])
def test_a_recording_goes_when_its_diagnosis_fails(shelf: Path, tmp_path: Path, worn: bytes, failure: AppError) -> None:
    pool = Here(failure)
    service = service_of(shelf, tmp_path, pool)
    with pytest.raises(type(failure), match=str(failure)):
        ask(service, worn)
    assert pool.asked == ["summarise_and_diagnose"]
    assert kept(service) == 0


@pytest.mark.parametrize(
    ("members", "error", "said"),
    [({}, TaskFailedError, r"worn\.csv"), ({"catalogue": "nonsense"}, UnknownCatalogueError, "catalogue: nonsense")],
)
def test_what_cannot_be_read_is_not_kept(
    shelf: Path, tmp_path: Path, members: dict[str, str], error: type[Exception], said: str
) -> None:
    service = service_of(shelf, tmp_path, Here())
    with pytest.raises(error, match=said):
        ask(service, b"no recording", **members)
    assert kept(service) == 0
