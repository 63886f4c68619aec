"""Opaque cursors: where the next page of a list begins."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from typing import Protocol, TypeVar

from jointplay.app.errors import BadCursorError


def encode(position: str) -> str:
    """Return the cursor of a position; its inside is nobody's business."""
    return base64.urlsafe_b64encode(position.encode()).decode().rstrip("=")


def decode(cursor: str) -> str:
    """Return the position of a cursor.

    Raises
    ------
    BadCursorError
        When this service did not make it.
    """
    try:
        padded = cursor.encode("ascii") + b"=" * (-len(cursor) % 4)
        return base64.b64decode(padded, altchars=b"-_", validate=True).decode()
    except (binascii.Error, UnicodeError):
        raise refusal(cursor) from None


class Numbered(Protocol):
    """A row that knows its place in the order of all."""

    @property
    def number(self) -> int:
        """Its place."""


N = TypeVar("N", bound=Numbered)
D = TypeVar("D", bound=Numbered)


def cut(rows: Sequence[N], size: int) -> tuple[Sequence[N], str | None]:
    """Return the rows of a page of some size, and the cursor of the next one if there is one more row than that."""
    return rows[:size], encode(str(rows[size - 1].number)) if len(rows) > size else None


def cut_around(rows: Sequence[N], damaged: Sequence[D], size: int) -> tuple[Sequence[N], Sequence[D], str | None]:
    """Return what :func:`cut` does of rows among which there are damaged ones, which have their places, too."""
    numbers = sorted((each.number for each in (*rows, *damaged)), reverse=True)
    if len(numbers) <= size:
        return rows, damaged, None
    last = numbers[size - 1]
    shown = [each for each in rows if each.number >= last], [each for each in damaged if each.number >= last]
    return *shown, encode(str(last))


def decode_number(cursor: str | None) -> int | None:
    """Return the row number in a cursor; ``None`` for the first page."""
    if cursor is None:
        return None
    position = decode(cursor)
    if not position.isascii() or not position.isdecimal() or len(position) > 18:
        raise refusal(cursor)
    return int(position)


def refusal(cursor: str) -> BadCursorError:
    """Return the error for a cursor that was not handed out here."""
    return BadCursorError(f"cursor: {cursor[:80]}: is not a cursor of this list", field="cursor")
