"""A measurement on its way in: as a file in a form, or as JSON."""

from __future__ import annotations

import io
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import ConfigDict, FailFast, Field
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from jointplay.app.errors import BadFieldError, UnsupportedMediaError
from jointplay.app.fields import TOLD
from jointplay.app.http.uploads import MULTIPART, base_name, media_type, receive_form
from jointplay.app.http.validation import validate
from jointplay.app.schemas.resources import Shape
from jointplay.app.storage.store import Store
from jointplay.app.storage.told import Told, read_told
from jointplay.app.storage.uploads import Upload
from jointplay.app.words import MeasuredAt
from jointplay.catalogue.measurements.import_profile import ImportProfile

JSON_TYPE = "application/json"
ENDING = ".json"
#: Members of a JSON body that are the recording itself, as a file of this kind holds it.
HELD = ("sample_rate_hz", "time_s", "frequency_hz", "channels")

#: A recording of 0.1 s; the shortest that is taken has 256 samples.
RECORDING: dict[str, Any] = {
    "name": "press-7",
    "sample_rate_hz": 2560,
    "channels": [{"name": "s1-y", "unit": "g", "values": [(7 * k) % 13 - 6 for k in range(256)]}],
    "profile": {"sensors": {"s1-y": "s1-y"}},
}

# The first number that is none is told; a body may hold a million.
Numbers = Annotated[list[Annotated[float, Field(strict=True, allow_inf_nan=False)]], Field(min_length=1), FailFast()]


class ChannelIn(Shape):
    """One channel of a measurement."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    unit: Annotated[
        str | None,
        Field(default=None, min_length=1, max_length=200, description='Such as "m/s2", "g", "mm/s", "(m/s2)^2/Hz".'),
    ]
    values: Annotated[Numbers, Field(description="At least 256, as many in every channel.")]


class MeasurementIn(Shape):
    """A recording over time (with `sample_rate_hz` or `time_s`), or a spectrum (with `frequency_hz`)."""

    model_config = ConfigDict(json_schema_extra={"example": RECORDING})

    name: Annotated[
        str,
        Field(default="recording.json", min_length=1, max_length=200, description="What to call it; .json is added."),
    ]
    sample_rate_hz: Annotated[float | None, Field(default=None, gt=0, strict=True, allow_inf_nan=False)]
    time_s: Annotated[Numbers, Field(default=[], description="Evenly spaced; in place of a sample rate.")]
    frequency_hz: Annotated[Numbers, Field(default=[], description="Of a spectrum: its lines, evenly spaced.")]
    channels: Annotated[list[ChannelIn], Field(min_length=1, max_length=256)]
    profile: Annotated[
        ImportProfile,
        Field(default=ImportProfile(), description="What else there is to say, such as what a spectrum is."),
    ]
    measured_at: Annotated[
        MeasuredAt | None, Field(default=None, description="When it was measured; when it is received unless given.")
    ]
    asset: Annotated[
        str | None,
        Field(default=None, min_length=1, max_length=128, description="External id of the machine that was measured."),
    ]


@dataclass(frozen=True)
class Sent:
    """A measurement that was sent.

    Parameters
    ----------
    file : Upload
        On disk.
    name : str
    told : Told
        What is said of it.
    asset : str or None
    """

    file: Upload
    name: str
    told: Told
    asset: str | None

    @property
    def content(self) -> list[object]:
        """All of it, as JSON values."""
        moment = self.told.measured_at
        said: list[object] = [self.file.sha256, self.name, self.told.shown, self.asset]
        return said if moment is None else [*said, moment.isoformat()]


@asynccontextmanager
async def receive_measurement(request: Request, store: Store) -> AsyncIterator[Sent]:
    """Read the body of a request that sends a measurement, and keep its file for the time of a ``with`` block.

    Parameters
    ----------
    request : Request
    store : Store
        Takes the file; after the block it stays only if it became a measurement.

    Raises
    ------
    UnsupportedMediaError
        When the body is neither a form nor JSON.
    BadRequestError, BadFieldError, RequestValidationError
        When it cannot be read, or a field breaks a rule.
    """
    kind = media_type(request)
    if kind == MULTIPART:
        async with receive_form(request, store, TOLD | {"asset"}) as form:
            if form.file is None:
                raise BadFieldError("file: is missing", field="file")
            told = await run_in_threadpool(read_told, form.fields)
            yield Sent(form.file, form.file_name, told, form.fields.get("asset"))
    elif kind == JSON_TYPE:
        wanted = await run_in_threadpool(validate, MeasurementIn, await request.body())
        upload = await run_in_threadpool(store.uploads.receive, io.BytesIO(file_of(wanted)))
        try:
            said = {} if wanted.measured_at is None else {"measured_at": wanted.measured_at}
            told = Told.of(wanted.profile.model_copy(update=said))
            yield Sent(upload, name_recording(wanted.name), told, wanted.asset)
        finally:
            store.uploads.settle(upload)
    else:
        raise UnsupportedMediaError(f"Content-Type: {kind or 'none'}: must be {JSON_TYPE} or {MULTIPART}")


def file_of(wanted: MeasurementIn) -> bytes:
    """Return the recording as a file of JSON holds it."""
    return wanted.model_dump_json(include=set(HELD), exclude_defaults=True).encode()


def name_recording(name: str) -> str:
    """Return what a recording is called: its ending says what it is."""
    return base_name(name if name.lower().endswith(ENDING) else f"{name}{ENDING}")
