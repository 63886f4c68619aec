"""Sending files to a service: what it said, whether it is worth trying again, and what concerns all files."""

from __future__ import annotations

import http.client
import json
import secrets
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

TIMEOUT_S = 600.0
LATER = frozenset({408, 429, 502, 503, 507})
"""Statuses of a service that cannot take anything now."""

ALL_FILES = frozenset({401, 403, 404, 405, 421})
"""Statuses that every file would get: what was asked for is wrong, not the file."""

ASKED = frozenset({"asset", "catalogue"})


class NotNowError(Exception):
    """The service cannot take a file now; ``str()`` says why."""


class WrongRequestError(Exception):
    """No file can be sent so; ``str()`` says why."""


class RefusedError(Exception):
    """A file is refused; ``str()`` says why."""


class FailedError(Exception):
    """The service failed at a file, which may be the file's fault; ``str()`` says how."""


@dataclass(frozen=True)
class Destination:
    """Where files go.

    Parameters
    ----------
    server : str
        URL of the service, without a path.
    fields : mapping of str to str
        Of the form, besides the file: with ``catalogue`` a diagnosis is asked for.
    key : str
        API key; empty for a service that asks for none.
    """

    server: str
    fields: Mapping[str, str]
    key: str = ""

    def send(self, name: str, content: bytes, token: str) -> dict[str, Any]:
        """Send one file; return the answer.

        Parameters
        ----------
        name : str
        content : bytes
        token : str
            Key of idempotency.

        Raises
        ------
        NotNowError, WrongRequestError, RefusedError, FailedError
        """
        boundary = secrets.token_hex(16)
        headers = {
            "Content-Type": f"multipart/form-data; boundary={boundary}",
            "Idempotency-Key": token,
            **({"Authorization": f"Bearer {self.key}"} if self.key else {}),
        }
        kind = "diagnoses" if "catalogue" in self.fields else "measurements"
        connection = self._connection()
        try:
            connection.request("POST", f"/api/v1/{kind}", form_body(self.fields, name, content, boundary), headers)
            response = connection.getresponse()
            status, text = response.status, response.read()
        except ssl.SSLCertVerificationError as error:
            raise WrongRequestError(f"{self.server}: {error.verify_message}") from None
        except (OSError, http.client.HTTPException) as error:
            raise NotNowError(f"{self.server} does not answer ({error or type(error).__name__})") from None
        finally:
            connection.close()
        return judge(status, text, self.fields.get("effort") == "thorough")

    def _connection(self) -> http.client.HTTPConnection:
        parts = urlsplit(self.server)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        return kind(parts.hostname or "", parts.port, timeout=TIMEOUT_S)


def form_body(fields: Mapping[str, str], name: str, content: bytes, boundary: str) -> bytes:
    """Return the body of a multipart form with one file."""
    quoted = name.replace("\\", "_").replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
    parts = [
        f'--{boundary}\r\nContent-Disposition: form-data; name="{field}"\r\n\r\n{value}\r\n'.encode()
        for field, value in fields.items()
    ]
    disposition = f'Content-Disposition: form-data; name="file"; filename="{quoted}"'
    head = f"--{boundary}\r\n{disposition}\r\nContent-Type: application/octet-stream\r\n\r\n"
    return b"".join([*parts, head.encode("utf-8", "replace"), content, f"\r\n--{boundary}--\r\n".encode()])


def judge(status: int, text: bytes, is_long: bool = False) -> dict[str, Any]:
    """Return the answer of a service, or raise what it means for this file and the next ones.

    Parameters
    ----------
    status : int
    text : bytes
    is_long : bool
        Whether what takes too long goes on in the service's background, at once or when there is room.
    """
    try:
        document = json.loads(text)
    except ValueError:
        document = None
    if not isinstance(document, dict):
        document = {"detail": f"answered {status}, and not as a jointplay service does"}
        status = status if status >= 500 else 404
    if 200 <= status < 300:
        return document
    said = " ".join(str(document.get("detail") or document.get("title") or status).split())
    fields = {each.get("field") for each in document.get("errors", []) if isinstance(each, dict)}
    later = status in LATER or (status == http.HTTPStatus.GATEWAY_TIMEOUT and is_long)
    if later or str(document.get("type", "")).endswith("idempotency-key-in-use"):
        raise NotNowError(said)
    if status in ALL_FILES or status < 400 or fields & ASKED:
        raise WrongRequestError(said)
    raise (FailedError if status >= 500 else RefusedError)(said)
