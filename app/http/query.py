"""What a request asks for: query parameters, and the form of the answer (``Accept``).

A parameter that an operation does not have, or that is given twice, is refused, not passed over.
"""

from __future__ import annotations

from collections.abc import Sequence

from starlette.requests import Request

from jointplay.app.errors import BadFieldError, NotAcceptableError
from jointplay.app.scopes import API


async def refuse_unknown(request: Request) -> None:
    """Refuse a query that says something which nobody reads: a dependency of all operations.

    Which parameters there are is what the OpenAPI document says of the operation.

    Raises
    ------
    BadFieldError
        Naming the parameter, and those that there are.
    """
    given = [name for name, _ in request.query_params.multi_items()]
    if not given:
        return
    path = API + request.scope["route"].path.removeprefix(API)  # the framework's routes know their router's part alone
    operation = request.app.openapi()["paths"][path][request.method.lower()]
    known = [each["name"] for each in operation.get("parameters", ()) if each["in"] == "query"]
    for name in given:
        field = f"query.{name[:80]}"
        if name not in known:
            rule = f"the parameters are {', '.join(known)}" if known else "it has none"
            raise BadFieldError(f"{field}: is no parameter of this operation; {rule}", field=field)
        if given.count(name) > 1:
            raise BadFieldError(f"{field}: is given twice", field=field)


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
    ranges = parse_accept(",".join(request.headers.getlist("accept")) or "*/*")
    best = max(offered, key=lambda kind: weight(kind, ranges))  # max() keeps the first of equals
    if weight(best, ranges) <= 0.0:
        shown = request.headers.get("accept", "")[:80]
        raise NotAcceptableError(f"Accept: {shown}: must allow one of {', '.join(offered)}")
    return best


def parse_accept(header: str) -> dict[str, float]:
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
