"""Checksums over what is stored; one that was written once has to come out the same for ever."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any


def canonical(values: Any) -> str:
    """Return JSON values, with moments among them, as the one text that stands for them."""
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=True, default=_spelled)


def checksum(values: Any) -> str:
    """Return the SHA-256 of JSON values, with moments among them."""
    return hashlib.sha256(canonical(values).encode()).hexdigest()


class Document(dict[str, Any]):
    """A JSON object as it was read from the database, with the checksum of its text."""

    __slots__ = ("sha256",)
    sha256: str

    def __reduce__(self) -> tuple[type[dict[str, Any]], tuple[dict[str, Any]]]:
        """Make copies, and what is sent to workers, plain dictionaries: they may become something else."""
        return dict, (dict(self),)


class Written(Document):
    """A JSON object on its way to the database, with its text: a long answer is made text once."""

    __slots__ = ("text",)
    text: str

    @classmethod
    def of(cls, value: Mapping[str, Any]) -> Written:
        """Return an object that is changed no more."""
        written = cls(value)
        written.text = json.dumps(value)
        written.sha256 = hashlib.sha256(written.text.encode()).hexdigest()
        return written


def write_document(value: Any) -> str:
    """Return JSON values as the text that the database holds."""
    return value.text if isinstance(value, Written) else json.dumps(value)


def read_document(text: str | bytes) -> Any:
    """Return the values of a JSON text; of an object with the checksum of the text, which costs next to nothing."""
    value = json.loads(text)
    if not isinstance(value, dict):
        return value
    document = Document(value)
    document.sha256 = hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()
    return document


def row_checksum(values: Mapping[str, Any]) -> str:
    """Return the checksum of a row: JSON objects in it count by the text that stands, or will stand, in the database.

    Put into an order of its own, an answer would have to be made text again whenever it is read.
    """
    return checksum({name: _digest(value) if isinstance(value, Mapping) else value for name, value in values.items()})


def _digest(value: Mapping[str, Any]) -> str:
    return value.sha256 if isinstance(value, Document) else hashlib.sha256(json.dumps(value).encode()).hexdigest()


def _spelled(value: object) -> object:
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} has no canonical form")
