"""Links in the OpenAPI document: where what an operation answers can be used next. They follow from the paths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from jointplay.app.scopes import API

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
