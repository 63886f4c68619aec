"""Entity tags: the same content is not sent twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from starlette.requests import Request
from starlette.responses import Response


def tag(key: str) -> str:
    """Return the strong entity tag of a content key."""
    return f'"{key}"'


def matches(request: Request, key: str) -> bool:
    """Return whether the client holds the content of this key already (``If-None-Match``, compared weakly)."""
    held = request.headers.get("if-none-match")
    if held is None:
        return False
    return any(part.strip().removeprefix("W/") in (tag(key), "*") for part in held.split(","))


@dataclass(frozen=True)
class Conditions:
    """What a client that writes says of what is there.

    Parameters
    ----------
    match, none_match : tuple of str, optional
        Entity tags, or ``*``; ``None`` when the header is not there.
    """

    match: tuple[str, ...] | None = None
    none_match: tuple[str, ...] | None = None

    @classmethod
    def of(cls, request: Request) -> Self:
        """Read ``If-Match`` and ``If-None-Match`` of a request."""
        return cls(parse_tags(request, "if-match"), parse_tags(request, "if-none-match"))

    def hold(self, key: str | None) -> bool:
        """Return whether they hold for a content key; ``None``: nothing is there.

        ``If-Match`` is compared strongly, ``If-None-Match`` weakly.
        """
        if self.match is not None and (key is None or not {"*", tag(key)} & set(self.match)):
            return False
        held = {each.removeprefix("W/") for each in self.none_match or ()}
        return key is None or not {"*", tag(key)} & held


def parse_tags(request: Request, header: str) -> tuple[str, ...] | None:
    """Return the entity tags in a header."""
    given = request.headers.get(header)
    return None if given is None else tuple(part.strip() for part in given.split(","))


def respond(request: Request, response: Response, key: str) -> Response:
    """Return a response with its entity tag, or 304 when the client holds it already.

    Parameters
    ----------
    request : Request
    response : Response
        The whole answer.
    key : str
        Key of its content.
    """
    headers = {"ETag": tag(key), "Cache-Control": "no-cache"}
    if matches(request, key):
        return Response(status_code=304, headers=headers)
    response.headers.update(headers)
    return response
