"""Content negotiation: which of several forms of one thing a client wants (``Accept``)."""

from __future__ import annotations

from collections.abc import Sequence

from starlette.requests import Request

from jointplay.app.errors import NotAcceptableError


def chosen_type(request: Request, offered: Sequence[str]) -> str:
    """Return the media type that a client likes best; of equals, the one offered first.

    Parameters
    ----------
    request : Request
        Without ``Accept`` it takes anything.
    offered : sequence of str
        Media types, lower case, the usual one first.

    Raises
    ------
    NotAcceptableError
        When it takes none of them.
    """
    ranges = accepted(",".join(request.headers.getlist("accept")) or "*/*")
    best = max(offered, key=lambda kind: weight(kind, ranges))  # max() keeps the first of equals
    if weight(best, ranges) <= 0.0:
        shown = request.headers.get("accept", "")[:80]
        raise NotAcceptableError(f"Accept: {shown}: must allow one of {', '.join(offered)}")
    return best


def accepted(header: str) -> dict[str, float]:
    """Return media ranges with their weights; what is no range, or has no weight from 0 to 1, is left out."""
    found = {}
    for part in header.split(","):
        kind, *parameters = (each.strip().lower() for each in part.split(";"))
        if kind.count("/") != 1:
            continue
        quality = next((each[2:] for each in parameters if each.startswith("q=")), "1")
        try:
            value = float(quality)
        except ValueError:
            continue
        if 0.0 <= value <= 1.0:
            found[kind] = value
    return found


def weight(kind: str, ranges: dict[str, float]) -> float:
    """Return how much a media type is liked: by the narrowest range that holds it."""
    for each in (kind, f"{kind.partition('/')[0]}/*", "*/*"):
        if each in ranges:
            return ranges[each]
    return 0.0
