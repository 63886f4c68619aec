"""Multipart forms: one file, streamed to disk, and a few short fields."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import PurePosixPath
from urllib.parse import parse_qsl

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.requests import Request

from jointplay.app.errors import BadFieldError, BadRequestError, UnsupportedMediaError, UploadTooLargeError
from jointplay.app.storage.store import Store
from jointplay.app.storage.uploads import Upload

MULTIPART = "multipart/form-data"
URLENCODED = "application/x-www-form-urlencoded"
JSON_TYPE = "application/json"
PLAIN_BYTES, MAX_PLAIN_FIELDS = 64_000, 300
MAX_FIELDS = 32
MAX_FIELD_BYTES = 16_000
MAX_PROFILE_BYTES = 32_000


@dataclass(frozen=True)
class Form:
    """A form as it came.

    Parameters
    ----------
    file : Upload or None
        The file of the field ``file``, on disk; ``None`` when there was none.
    file_name : str
        Its name as the sender gave it, without folders.
    fields : Mapping
        The other fields; empty ones are left out, as a web form sends them for "not given".
    """

    file: Upload | None
    file_name: str
    fields: Mapping[str, str]


def media_type(request: Request) -> str:
    """Return the type of the request's body, lower case, without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def json_body(request: Request) -> None:
    """Refuse a request whose body is not said to be JSON: a dependency of routes whose body the framework reads.

    Raises
    ------
    UnsupportedMediaError
        When it is of another type, or of none.
    """
    kind = media_type(request)
    if kind != JSON_TYPE:
        raise UnsupportedMediaError(f"Content-Type: {kind or 'none'}: must be {JSON_TYPE}")


async def plain_fields(request: Request, most: int = PLAIN_BYTES) -> list[tuple[str, str]]:
    """Return names and values of a form without files, in order; empty values count.

    Parameters
    ----------
    request : Request
    most : int
        Largest body [bytes].

    Raises
    ------
    UnsupportedMediaError
        When the body is no such form.
    UploadTooLargeError
        When it is larger.
    BadRequestError
        When it has too many fields.
    """
    kind = media_type(request)
    if kind != URLENCODED:
        raise UnsupportedMediaError(f"Content-Type: {kind or 'none'}: must be {URLENCODED}")
    body = await request.body()
    if len(body) > most:
        raise UploadTooLargeError(f"the form is larger than {most / 1000:g} kB, the limit of this page")
    text = body.decode("utf-8", "replace")
    count = text.count("&") + 1
    if count > MAX_PLAIN_FIELDS:  # before the first of them is read
        raise BadRequestError(f"{count} fields: a form may have at most {MAX_PLAIN_FIELDS}")
    return await run_in_threadpool(parse_qsl, text, keep_blank_values=True)


@asynccontextmanager
async def receive_form(request: Request, store: Store, known: frozenset[str]) -> AsyncIterator[Form]:
    """Read a multipart form, and keep its file on disk for the time of a ``with`` block.

    The field ``profile``, where it is known, may be a text or a small file of one.
    After it, whatever way it ends, the file stays only if it became a measurement.

    Parameters
    ----------
    request : Request
    store : Store
        Takes the file.
    known : frozenset of str
        Names of fields that may occur besides ``file``.

    Raises
    ------
    UnsupportedMediaError
        When the body is no multipart form.
    BadFieldError
        For an unknown or doubled field, or a file under another name.
    """
    if media_type(request) != MULTIPART:
        found = media_type(request) or "none"
        raise UnsupportedMediaError(f"Content-Type: {found}: must be {MULTIPART}")
    uploads: list[Upload] = []
    file_name = ""
    fields: dict[str, str] = {}
    try:
        async with request.form(max_files=3, max_fields=MAX_FIELDS, max_part_size=MAX_FIELD_BYTES) as form:
            for name, value in form.multi_items():
                if name != "file" and name not in known:
                    allowed = ", ".join(sorted(known | {"file"}))
                    raise BadFieldError(
                        f"{name[:80]}: is not a field of this form; the fields are {allowed}", field=name[:80]
                    )
                if name in fields or (name == "file" and uploads):
                    raise BadFieldError(f"{name}: is given twice", field=name)
                if value == "":
                    continue
                if name == "profile" and isinstance(value, UploadFile):
                    if value.filename or value.size:
                        fields[name] = await text_of(value, name)
                    continue
                if (name == "file") != isinstance(value, UploadFile):
                    must = "a file" if name == "file" else "text, not a file"
                    raise BadFieldError(f"{name}: must be {must}", field=name)
                if isinstance(value, UploadFile):
                    # A browser sends a file field that was left empty as a file without a name.
                    if value.filename:
                        uploads.append(await run_in_threadpool(store.uploads.receive, value.file))
                        file_name = base_name(value.filename)
                elif value.strip():
                    fields[name] = value.strip()
        yield Form(uploads[0] if uploads else None, file_name, fields)
    finally:
        for upload in uploads:
            store.uploads.settle(upload)


async def text_of(part: UploadFile, name: str) -> str:
    """Return the text of a small file.

    Raises
    ------
    BadFieldError
        When it is large, or no text in UTF-8.
    """
    content = await part.read(MAX_PROFILE_BYTES + 1)
    if len(content) > MAX_PROFILE_BYTES:
        raise BadFieldError(f"{name}: is larger than {MAX_PROFILE_BYTES // 1000} kB", field=name)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadFieldError(f"{name}: is not a text in UTF-8", field=name) from None


def base_name(name: str) -> str:
    """Return the last part of a file name, printable and of bounded length, whatever system it comes from."""
    last = PurePosixPath(name.replace("\\", "/")).name
    shown = "".join(character if character.isprintable() else "_" for character in last)
    return shown[-200:] or "recording"
