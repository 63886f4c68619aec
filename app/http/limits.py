"""The limit on request bodies, enforced while they arrive."""

from __future__ import annotations

import asyncio

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jointplay.app.errors import BadRequestError, SlowRequestError, UploadTooLargeError
from jointplay.app.scopes import API

JSON_BYTES = 1_000_000
RECORDINGS = f"{API}/measurements"
DIAGNOSES = f"{API}/diagnoses"
RECORDING_BYTES = 16_000_000
"""Largest recording as JSON, which is held in memory; a file is not."""


class BodyLimit:
    """Middleware that stops reading a body at its limit, so that no upload is ever held whole in memory.

    Parameters
    ----------
    app : ASGIApp
        The application behind.
    upload_bytes : int
        Largest multipart body where files are taken; any other body may have at most `JSON_BYTES`, a recording
        `RECORDING_BYTES`.
    receive_timeout : float
        Longest pause between two parts of a body [s].
    """

    def __init__(self, app: ASGIApp, upload_bytes: int, receive_timeout: float) -> None:
        self._app = app
        self._receive_timeout = receive_timeout
        self._upload_bytes = upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with a counted body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Request(scope).headers
        multipart = headers.get("content-type", "").lower().startswith("multipart/") and takes_files(scope["path"])
        usual = RECORDING_BYTES if scope["path"] == RECORDINGS else JSON_BYTES
        limit = self._upload_bytes if multipart else min(usual, self._upload_bytes)
        declared = headers.get("content-length", "0")
        received = 0
        whole = False

        async def counted() -> Message:
            nonlocal received, whole
            if not declared.isdecimal():
                raise BadRequestError(f"Content-Length: {declared}: must be a whole number")
            # A declared length is refused before the first byte is read, an undeclared one when the limit is passed.
            if int(declared) > limit:
                raise too_large(limit)
            # After the body the same call waits for the client to go, as long as an answer takes.
            try:
                async with asyncio.timeout(None if whole else self._receive_timeout):
                    message = await receive()
            except TimeoutError:
                raise SlowRequestError(
                    f"the request body paused for longer than {self._receive_timeout:g} s, the limit of this service"
                ) from None
            received += len(message.get("body", b""))
            whole = not message.get("more_body", False)
            if received > limit:
                raise too_large(limit)
            return message

        await self._app(scope, counted, send)


def takes_files(path: str) -> bool:
    """Return whether files are streamed to disk at an address; elsewhere in the interface a body is held in memory."""
    return path in (RECORDINGS, DIAGNOSES) or not path.startswith(f"{API}/")


def too_large(limit: int) -> UploadTooLargeError:
    """Return the refusal of a body over the limit."""
    return UploadTooLargeError(f"the request body is larger than {limit / 1e6:g} MB, the limit of this service")
