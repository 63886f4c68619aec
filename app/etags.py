"""Entity tags: the same content is not sent twice."""

from __future__ import annotations

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
