"""Log lines: JSON or text, each with the id of the request it belongs to, none with a secret.

The service's own logs and those of its server are shown from a level on; of other libraries only warnings: what
they say of their inner life (SQL with its values, for instance) may hold what nobody is to read.
"""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

OWN = ("jointplay", "uvicorn")
"""Loggers that the level is for."""

MEMBERS = "members"
"""Name under which a record carries what its line says besides the message."""

SECRETS: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"(?i)\b((?:x-api-key|authorization|cookie)[\"']?\s*[:=]\s*[\"']?)[^\r\n\"']+"), r"\1***"),
    (re.compile(r"\b(jp_[0-9a-f]{12})_[\w-]+"), r"\1_***"),
    (re.compile(r"(?i)\b(bearer)\s+[^\s\"',]+"), r"\1 ***"),
    (re.compile(r"\b(jointplay_session=)[^\s;\"',]+"), r"\1***"),
    (re.compile(r"(://[^\s/:@\"']*):[^\s/@\"']+@"), r"\1:***@"),
    (re.compile(r"(?i)\b((?:password|passwd|secret|token)=)[^\s&;\"',]+"), r"\1***"),
)
"""What a secret looks like wherever it turns up, and what is written in its place."""

SUSPECT = re.compile(r"(?i)jp_|bearer|api-key|authorization|cookie|jointplay_session|://|passw|secret=|token=")
"""What each of them begins with: most texts have nothing of it, and need no closer look."""

_REQUEST: ContextVar[str | None] = ContextVar("request_id", default=None)


class LogSettings(NamedTuple):
    """How a process writes its log."""

    form: Literal["json", "text"] = "text"
    level: str = "info"


DEFAULT_LOG = LogSettings()


def request_id() -> str | None:
    """Return the id of the request that is worked on here; ``None`` outside of one."""
    return _REQUEST.get()


@contextmanager
def of_request(identity: str | None) -> Iterator[None]:
    """Let the lines that are logged in a block belong to a request."""
    token = _REQUEST.set(identity)
    try:
        yield
    finally:
        _REQUEST.reset(token)


def configure(settings: LogSettings) -> None:
    """Write this process's log to stderr, in place of whatever was set up before."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if settings.form == "json" else TextFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    for name in OWN:
        logging.getLogger(name).setLevel(settings.level.upper())
    logging.captureWarnings(True)


def without_secrets(text: str) -> str:
    """Return a text with stars in place of what looks like a key, a session or a password."""
    if SUSPECT.search(text):
        for pattern, shown in SECRETS:
            text = pattern.sub(shown, text)
    return text


class JsonFormatter(logging.Formatter):
    """One JSON object a line: ``time``, ``level``, ``logger``, ``message``, and what else is known."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        said: dict[str, Any] = {
            "time": moment(record.created),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **members(record),
        }
        if record.exc_info:
            said["exception"] = self.formatException(record.exc_info)
        return json.dumps(clean(said), ensure_ascii=False, default=str)


class TextFormatter(logging.Formatter):
    """Time, level, logger and message, then ``name=value``; a traceback follows on lines of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record, and those of its traceback."""
        shown = " ".join(f"{name}={json.dumps(value, default=str)}" for name, value in members(record).items())
        message = json.dumps(record.getMessage(), ensure_ascii=False)[1:-1].replace('\\"', '"')  # one line, whatever
        line = f"{moment(record.created)} {record.levelname.lower()} {record.name}: {message}"
        if shown:
            line += f" {shown}"
        if record.exc_info:
            line += f"\n{self.formatException(record.exc_info)}"
        return without_secrets(line)


def members(record: logging.LogRecord) -> dict[str, Any]:
    """Return what a record says besides its message."""
    own: Mapping[str, Any] = getattr(record, MEMBERS, {})
    identity = request_id()
    return {**({} if identity is None else {"request_id": identity}), **own}


def clean(value: Any) -> Any:
    """Return JSON values without secrets in their texts."""
    if isinstance(value, str):
        return without_secrets(value)
    if isinstance(value, Mapping):
        return {name: clean(each) for name, each in value.items()}
    return value


def moment(seconds: float) -> str:
    """Return a time as RFC 3339 in UTC, to the millisecond."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
