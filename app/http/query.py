"""Query parameters: one that an operation does not have, or that is given twice, is refused, not passed over."""

from __future__ import annotations

from starlette.requests import Request

from jointplay.app.errors import BadFieldError
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
