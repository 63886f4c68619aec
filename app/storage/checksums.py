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


def _spelled(value: object) -> object:
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} has no canonical form")
