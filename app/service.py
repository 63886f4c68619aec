"""What the HTTP interface and the web page both do: keep recordings, diagnose them, find results again."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from anyio import CapacityLimiter
from cachetools import TTLCache
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from jointplay.app.errors import QuotaError
from jointplay.app.figures.pictures import response_picture
from jointplay.app.jobs import following, forecasts, tasks, virtual
from jointplay.app.jobs.answers import Answers
from jointplay.app.jobs.build_orders import machine_of, plan_of
from jointplay.app.jobs.build_runner import BuildRunner
from jointplay.app.jobs.samples import StoredRecording
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.metrics import Metrics
from jointplay.app.questions import Asked, Questions, columns_of
from jointplay.app.schemas.builds import BuildRequest
from jointplay.app.schemas.resources import DiagnosisRequest
from jointplay.app.schemas.virtual import VirtualRequest
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves import built_in
from jointplay.app.shelves.catalogues import CatalogueShelf, stamp_of
from jointplay.app.shelves.entries import EntryShelf
from jointplay.app.storage import webhooks
from jointplay.app.storage.assets import AsRead, Assets, newest_machine, touch_owners
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.remembered import Remembered
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.storage.store import NewDiagnosis, Store, measurement_key
from jointplay.app.storage.stored_files import SIGNALS
from jointplay.app.storage.told import Told
from jointplay.app.storage.uploads import Upload
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.following.state import WearState
from jointplay.solver.machines.machine import Machine, parse_machine

FORECASTS, FORECAST_S = 64, 600.0
"""Forecasts of builds that are kept, and for how long [s]: the computer may be busier later."""


LOOKS = 8
"""Looks at a time whether the service is ready."""


@dataclass(frozen=True)
class Service:
    """The parts of a running service; made by the application factory, found at ``request.app.state``."""

    settings: ServiceSettings
    store: Store
    shelf: CatalogueShelf
    pool: WorkerPool
    machines: MachineStore
    builds: BuildQueue
    runner: BuildRunner
    metrics: Metrics
    answers: Answers
    entries: EntryShelf = field(default_factory=EntryShelf)
    forecasts: TTLCache[tuple[Any, ...], dict[str, Any]] = field(
        default_factory=lambda: TTLCache(FORECASTS, FORECAST_S)
    )
    stopping: threading.Event = field(default_factory=threading.Event)
    """Set when the server is to stop: answers that go on and on then end."""
    looks: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(LOOKS))
    """Threads that look whether all is well: those of requests may all wait for what is not."""

    @property
    def questions(self) -> Questions:
        """Finds what requests for diagnoses name."""
        return Questions(self.store, self.shelf)

    @property
    def samples(self) -> str:
        """Folder of the samples of recordings that were read."""
        return str(self.settings.data / SIGNALS)

    def stop(self) -> None:
        """Let everything end that would go on by itself: streams of events, and builds, which others take up."""
        self.stopping.set()
        self.runner.stop()

    async def warm(self) -> None:
        """Let every worker load what a diagnosis needs, so that the first one does not wait for it."""
        offers = await run_in_threadpool(self.shelf.offers)
        shown = [(str(offer.path), offer.stamp) for offer in offers]
        await self.pool.warm(tasks.warm, shown)

    async def add_measurement(self, upload: Upload, name: str, told: Told, asset: str | None = None) -> MeasurementRow:
        """Read an uploaded recording or spectrum in a worker and store it, as one of an asset where that is named."""
        known = None if asset is None else await run_in_threadpool(Assets(self.store.database).asset, asset)
        told = await self.recall(upload, name, told, asset)
        recording = (str(upload.path), name, told)
        kept = StoredRecording(measurement_key(upload.sha256, name, told), *recording, self.samples)
        summary = await self.pool.run(tasks.summarise, *recording, kept)
        note = None if known is None else self.noting(known.external_id, columns_of(summary), told)
        try:
            return await run_in_threadpool(self.store.add_measurement, upload, name, told, summary, note)
        except QuotaError:
            self.store.files.drop_samples(kept.id)
            raise

    async def add_virtual(self, wanted: VirtualRequest) -> MeasurementRow:
        """Simulate a recording of a catalogue's machine in a worker and store it as any other."""
        offer = await run_in_threadpool(self.shelf.find, wanted.catalogue)
        task = virtual.VirtualTask(
            offer.machine.canonical_json(),
            wanted.clearances_um,
            wanted.drive_speed_rpm,
            wanted.sensor_noise_m_s2,
            wanted.revolutions,
            wanted.seed,
        )
        content, name, summary = await self.pool.run(virtual.make_recording, task, times=virtual.LIMITS)
        upload = await run_in_threadpool(self.store.uploads.receive, io.BytesIO(content))
        try:
            return await run_in_threadpool(self.store.add_measurement, upload, name, None, summary)
        finally:
            self.store.uploads.settle(upload)

    async def add_built_in(self, name: str) -> MeasurementRow:
        """Store a recording that ships with the program."""
        content = await run_in_threadpool(built_in.content_of, name)
        upload = await run_in_threadpool(self.store.uploads.receive, io.BytesIO(content))
        try:
            return await self.add_measurement(upload, built_in.file_name(name), Told())
        finally:
            self.store.uploads.settle(upload)

    async def follow(self, external_id: str, up_to: DiagnosisRow | None = None) -> WearState:
        """Return the state of wear of an asset, or what it was by all up to the recording of a diagnosis of it.

        Raises
        ------
        UnknownAssetError
            When there is none of this id.
        NothingToFollowError
            When none of its recordings was diagnosed.
        """
        life = await run_in_threadpool(following.gather, self.store, external_id, up_to)
        state: WearState = await self.pool.run(following.follow_life, life)
        return state

    async def recall(self, upload: Upload, name: str, told: Told, asset: str | None) -> Told:
        """Return what is said of a file: what was said of an asset's last one with its columns, where it needs that."""
        if asset is None or told.shown:
            return told
        known = await run_in_threadpool(Remembered(self.store.database).all_said, asset)
        said = await self.pool.run(tasks.recall, str(upload.path), name, told, known) if known else {}
        return Told(**said, measured_at=told.measured_at, remembered_of=asset) if said else told

    def noting(self, external_id: str, columns: Sequence[str], told: Told) -> Callable[[Session, str], None]:
        """Return what notes in a transaction that a measurement is of an asset, and how its file was read."""
        database = self.store.database

        def noted(session: Session, key: str) -> None:
            Assets(database).own_in(session, external_id, key)
            touch_owners(session, key)
            Remembered(database).remember(session, external_id, columns, told.shown)

        return noted

    async def diagnose(self, request: DiagnosisRequest) -> DiagnosisRow:
        """Diagnose a stored measurement, or several of one machine, in a worker and store the result."""
        rows, asked, request = await run_in_threadpool(self.questions.about_stored, request)
        recordings = [(str(self.store.path_of(row.sha256)), row.name, row.told) for row in rows]
        ids = [row.id for row in rows]
        one = request.measurement is not None
        task, recorded = (tasks.diagnose, recordings[0]) if one else (tasks.diagnose_together, (recordings,))
        result: Diagnosis = await self.answers.answer(task, *recorded, question=asked.question, measurements=ids)
        if not one:
            request = request.model_copy(update={"measurements": ids})
        self.metrics.count_diagnosis(result)
        diagnosis = self.new_diagnosis(request, asked, result, [(columns_of(each.summary), each.told) for each in rows])
        return await run_in_threadpool(self.store.add_diagnosis, diagnosis)

    async def diagnose_upload(self, upload: Upload, name: str, told: Told, request: DiagnosisRequest) -> DiagnosisRow:
        """Diagnose an uploaded recording and store both: the same as both calls by themselves, but it is read once.

        Nothing stays when the question is refused, or takes too long.

        Parameters
        ----------
        upload, name, told
            As for :meth:`add_measurement`.
        request : DiagnosisRequest
        """
        told = await self.recall(upload, name, told, request.asset)
        request = request.model_copy(update={"measurement": measurement_key(upload.sha256, name, told)})
        asked = await run_in_threadpool(self.questions.about, request)
        recording = (str(upload.path), name, told)
        if asked.asset is not None and await run_in_threadpool(self.questions.may_remember, asked, request):
            read = await self.pool.run(tasks.summarise, *recording)
            columns = {request.measurement or "": columns_of(read)}
            asked, request = await run_in_threadpool(self.questions.with_remembered, asked, request, columns)
        summary, result = await self.answers.answer(
            tasks.summarise_and_diagnose,
            *recording,
            question=asked.question,
            measurements=[request.measurement or ""],
            upload=upload,
        )
        self.metrics.count_diagnosis(result)
        diagnosis = self.new_diagnosis(request, asked, result, [(columns_of(summary), told)])
        return await run_in_threadpool(self.store.add_both, upload, name, told, summary, diagnosis)

    async def forecast(self, wanted: BuildRequest) -> dict[str, Any]:
        """Return what a build would take, by some cases that are tried in a worker; nothing is asked for.

        Raises
        ------
        BadFieldError
            There is no such machine or plan, or the plan does not fit the machine.
        TaskFailedError
            The catalogue is there, but of another machine, or made otherwise.
        """
        machine = await run_in_threadpool(machine_of, self.machines, wanted.machine)
        plan = await run_in_threadpool(plan_of, wanted.plan, machine)
        folder = self.settings.catalogues / wanted.catalogue
        key = (machine.content_key, plan.hash, wanted.catalogue, stamp_of(folder), wanted.workers)
        if key not in self.forecasts:
            content = json.loads(machine.canonical_json())
            found = await self.pool.run(forecasts.measure, content, plan.content, wanted.workers, folder)
            self.forecasts[key] = found
        return self.forecasts[key]

    async def draw_response(self, machine: Machine, phase: bool) -> str:
        """Return how the frame of a machine answers to forces, as SVG; empty where its file does not say."""
        if not machine.has_response:
            return ""
        drawn: str = await self.pool.run(response_picture, machine, phase)
        return drawn

    def new_diagnosis(
        self, request: DiagnosisRequest, asked: Asked, result: Diagnosis, recordings: Sequence[tuple[list[str], Told]]
    ) -> NewDiagnosis:
        """Return a diagnosis as it is stored, with what is told of it, and remembered of its recordings."""
        measurements = request.measurements or [request.measurement or ""]
        speeds = asked.question.speeds or (None,) * len(measurements)
        own = [{name: sensor for name, sensor in request.mapping.items() if name in each} for each, _ in recordings]
        read = {key: AsRead(said, at) for key, said, at in zip(measurements, own, speeds, strict=True)}
        is_said = "mapping" in request.model_fields_set and not asked.remembered

        def also(session: Session, key: str, new: bool) -> None:
            external_id = asked.asset.external_id if asked.asset else None
            if new:
                announce(session, key, external_id, result)
            # One that was deleted may be another one of that name since.
            if external_id and Assets(self.store.database).note(session, external_id, read, key, again=not new):
                for (columns, told), mapping in zip(recordings, own, strict=True):
                    said = mapping if is_said else None
                    Remembered(self.store.database).remember(session, external_id, columns, told.shown, said)

        baselines = [{"mapping": mapping, "speed": speed} for *_, mapping, speed in asked.question.baselines]
        return NewDiagnosis(
            measurements[0],
            asked.offer.description.id,
            asked.offer.document,
            request.model_dump(mode="json")
            | {"baselines": list(asked.baselines), "limits_um": dict(asked.question.limits_um)}
            | ({"baselines_read": baselines} if baselines else {})
            | ({"mapping_remembered": True} if asked.remembered else {}),
            result,
            also,
        )

    def machine_of(self, name: str, external_id: str) -> Machine | None:
        """Return the machine of a name that an asset is, as its newest diagnosis says.

        Without one, as a catalogue or a file of it says; None where there is none of this name.
        """
        with self.store.database.reading() as session:
            diagnosed = newest_machine(session, external_id)
        if diagnosed is not None and diagnosed["name"] == name:
            return parse_machine(diagnosed)
        for offer in self.shelf.offers():
            if offer.machine.name == name:
                return offer.machine
        found = (self.machines.find(each) for each in self.machines.names())
        return next((machine for machine in found if machine.name == name), None)


def announce(session: Session, diagnosis: str, asset: str | None, result: Diagnosis) -> None:
    """Note in the transaction that stores a diagnosis that webhooks are to know of it."""
    told = result.model_dump(mode="json", include={"machine", "verdict", "candidate_set"})
    webhooks.announce(session, "diagnosis.created", {"diagnosis": diagnosis, "asset": asset, **told})


def of_request(request: Request) -> Service:
    """Return the service that answers a request."""
    service: Service = request.app.state.service
    return service
