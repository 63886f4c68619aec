"""The OpenAPI document: every error is a problem document, and nothing of the framework's own 422 remains.

Links say where what an operation answers can be used next; they follow from the paths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from jointplay.app.http.examples import with_examples
from jointplay.app.problems import MEDIA_TYPE
from jointplay.app.schemas.resources import ProblemDocument
from jointplay.app.scopes import API, scope_of

REFERENCE = {"$ref": "#/components/schemas/ProblemDocument"}

DESCRIPTIONS = {
    400: "The request cannot be read.",
    404: "There is none of this name or id.",
    406: "There is no form that `Accept` allows.",
    409: "What is there already does not allow it.",
    410: "It was deleted; the detail says when, by whom and why.",
    412: "A condition of the request (`If-Match`, `If-None-Match`) does not hold.",
    413: "The body is larger than the limit of the service.",
    415: "This type of body is not taken here.",
    422: "The content breaks a rule; the detail names file, field, value and rule.",
    500: "The service failed.",
    503: "All workers are busy, or the database does not answer; Retry-After says when to try again.",
    504: "The computation took longer than the limit of the service; where it goes on in the background, the detail"
    " says how far it is, and Retry-After when to ask again.",
    507: "A disk of the service is full, or a quota is used up; nothing was stored.",
}
SCHEMES = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "A key: Authorization: Bearer KEY."},
    "header": {"type": "apiKey", "in": "header", "name": "X-API-Key", "description": "A key: X-API-Key: KEY."},
}
COMPUTING = (400, 404, 409, 413, 415, 422, 500, 503, 504, 507)

#: What a drawing is described as.
DRAWING: dict[int | str, dict[str, Any]] = {
    200: {"description": "The drawing.", "content": {"image/svg+xml": {"schema": {"type": "string"}}}}
}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the description of a route's errors by status."""
    return {
        status: {"description": DESCRIPTIONS[status], "content": {MEDIA_TYPE: {"schema": REFERENCE}}}
        for status in statuses
    }


def make_document(application: FastAPI, *, keyed: bool) -> Callable[[], dict[str, Any]]:
    """Return the function that makes the application's OpenAPI document, once.

    Parameters
    ----------
    application : FastAPI
    keyed : bool
        Whether requests need keys.
    """

    def document() -> dict[str, Any]:
        if application.openapi_schema is None:
            document = with_problems(
                get_openapi(
                    title=application.title,
                    version=application.version,
                    summary=application.summary,
                    description=application.description,
                    routes=application.routes,
                )
            )
            document = with_links(with_examples(document))
            application.openapi_schema = with_security(document) if keyed else document
        return application.openapi_schema

    return document


def with_problems(document: dict[str, Any]) -> dict[str, Any]:
    """Take the framework's own 422 out, and say that any error has our shape, also where a route lists none."""
    for path in document["paths"].values():
        for operation in path.values():
            responses = operation["responses"]
            # The framework says 422 of everything that takes a parameter, also of ids, of which any text may be one.
            if "422" in responses and responses["422"]["content"].get(MEDIA_TYPE, {}).get("schema") != REFERENCE:
                del responses["422"]
            responses["default"] = {"description": "Any other error.", "content": {MEDIA_TYPE: {"schema": REFERENCE}}}
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    for path in document["paths"].values():
        for operation in path.values():
            if "requestBody" in operation:
                operation["requestBody"] = hoist(operation["requestBody"], schemas)
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    problem = ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs", {}))
    schemas["ProblemDocument"] = problem
    return document


def hoist(body: dict[str, Any], schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the description of a body with its schemas' own definitions among those of the document.

    Parameters
    ----------
    body : dict
        Belongs to a route, which may be described again: it stays as it is.
    schemas : dict
        Of the document; what is found is added.
    """
    content = {}
    for kind, media in body["content"].items():
        schema = dict(media.get("schema", {}))
        schemas.update(schema.pop("$defs", {}))
        content[kind] = {**media, "schema": schema}
    return {**body, "content": content}


def with_security(document: dict[str, Any]) -> dict[str, Any]:
    """Say of every operation which scope a key needs for it."""
    document["components"]["securitySchemes"] = SCHEMES
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            scope = scope_of(method.upper(), path)
            operation["security"] = [{name: [scope.value]} for name in SCHEMES] if scope is not None else []
    return document


MADE = ("201", "202")


def with_links(document: dict[str, Any]) -> dict[str, Any]:
    """Add to an OpenAPI document what can be asked for next.

    Where there is a ``GET /things/{key}``, whatever lists or makes things, or puts one there, leads to it and to what
    else is below it.
    """
    for path, operations in document["paths"].items():
        collection, _, last = path.rpartition("/")
        if not path.startswith(API) or not last.startswith("{") or "get" not in operations:
            continue
        found = dict(targets(document, path))
        for response, value in sources(document, collection, last.strip("{}")):
            above = {part.strip("{}") for part in collection.split("/") if part.startswith("{")}
            parameters = {**{name: f"$request.path.{name}" for name in above}, last.strip("{}"): value}
            response["links"] = {
                name: {"operationId": operation, "parameters": parameters} for name, operation in found.items()
            }
    return document


def targets(document: dict[str, Any], path: str) -> Iterator[tuple[str, str]]:
    """Name and id of the operations that need no more than what is in a path."""
    for other, operations in document["paths"].items():
        if (other == path or other.startswith(f"{path}/")) and "{" not in other[len(path) :]:
            for method, operation in operations.items():
                if method != "put":
                    yield operation["operationId"].partition("_api_")[0], operation["operationId"]


def sources(document: dict[str, Any], collection: str, parameter: str) -> Iterator[tuple[dict[str, Any], str]]:
    """Answers that hold what a thing is asked for by, and where in them."""
    paths, schemas = document["paths"], document["components"]["schemas"]
    path = f"{collection}/{{{parameter}}}"
    listed = paths.get(collection, {}).get("get", {}).get("responses", {}).get("200", {})
    page = schemas.get(schema_of(listed).rpartition("/")[2], {}).get("properties", {})
    if "items" in page:
        item = schemas[page["items"]["items"]["$ref"].rpartition("/")[2]]["properties"]
        yield listed, f"$response.body#/items/0/{parameter if parameter in item else 'id'}"
    if "put" in paths[path]:
        yield paths[path]["put"]["responses"]["201"], f"$request.path.{parameter}"
    thing = schema_of(paths[path]["get"]["responses"]["200"])
    for other, operations in paths.items():
        for status in MADE:
            made = operations.get("post", {}).get("responses", {}).get(status, {})
            same = schema_of(made) == thing and not other.startswith(f"{path}/")
            if made and (other == collection or (thing and same)):
                yield made, "$response.body#/id"


def schema_of(response: dict[str, Any]) -> str:
    """Return what names the model of an answer; empty where it has none."""
    found: str = response.get("content", {}).get("application/json", {}).get("schema", {}).get("$ref", "")
    return found
