"""Links in the OpenAPI document: where what an operation answers can be used next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

API = "/api/v1"
ID = "$response.body#/id"
FIRST = "$response.body#/items/0"


@dataclass(frozen=True)
class Target:
    """An operation that takes a name or id in its path.

    Parameters
    ----------
    name : str
        Of the link.
    method, path : str
    parameter : str
        Which part of the path it is.
    """

    name: str
    method: str
    path: str
    parameter: str


@dataclass(frozen=True)
class Source:
    """An operation that answers with a name or id.

    Parameters
    ----------
    method, path, status : str
    value : str
        Runtime expression of OpenAPI.
    others : tuple of str
        Parts of its own path that the targets have, too.
    """

    method: str
    path: str
    status: str
    value: str
    others: tuple[str, ...] = ()


#: What can be made or found in a list, and what can be asked for then.
LINKS: tuple[tuple[tuple[Source, ...], tuple[Target, ...]], ...] = (
    (
        (
            Source("get", "/machines", "200", f"{FIRST}/name"),
            Source("put", "/machines/{name}", "201", "$request.path.name"),
        ),
        (
            Target("machine", "get", "/machines/{name}", "name"),
            Target("machine_drawing", "get", "/machines/{name}/drawing.svg", "name"),
        ),
    ),
    (
        (Source("get", "/catalogues", "200", f"{FIRST}/name"),),
        (
            Target("catalogue", "get", "/catalogues/{name}", "name"),
            Target("catalogue_drawing", "get", "/catalogues/{name}/drawing.svg", "name"),
            Target("entries", "get", "/catalogues/{name}/entries", "name"),
        ),
    ),
    (
        (Source("get", "/catalogues/{name}/entries", "200", f"{FIRST}/key", ("name",)),),
        (Target("entry", "get", "/catalogues/{name}/entries/{key}", "key"),),
    ),
    (
        (Source("post", "/builds", "202", ID), Source("get", "/builds", "200", f"{FIRST}/id")),
        (
            Target("build", "get", "/builds/{key}", "key"),
            Target("build_events", "get", "/builds/{key}/events", "key"),
            Target("cancel_build", "post", "/builds/{key}/cancel", "key"),
        ),
    ),
    (
        (Source("post", "/measurements", "201", ID), Source("get", "/measurements", "200", f"{FIRST}/id")),
        (Target("measurement", "get", "/measurements/{key}", "key"),),
    ),
    (
        (Source("post", "/diagnoses", "201", ID), Source("get", "/diagnoses", "200", f"{FIRST}/id")),
        (
            Target("diagnosis", "get", "/diagnoses/{key}", "key"),
            Target("report", "get", "/diagnoses/{key}/report", "key"),
            Target("report_finding", "post", "/diagnoses/{key}/finding", "key"),
        ),
    ),
    (
        (Source("post", "/diagnoses/{key}/finding", "201", ID), Source("get", "/findings", "200", f"{FIRST}/id")),
        (Target("finding", "get", "/findings/{key}", "key"),),
    ),
    (
        (
            Source("put", "/assets/{external_id}", "201", "$request.path.external_id"),
            Source("get", "/assets", "200", f"{FIRST}/external_id"),
        ),
        (Target("asset", "get", "/assets/{external_id}", "external_id"),),
    ),
    (
        (Source("post", "/webhooks", "201", ID), Source("get", "/webhooks", "200", f"{FIRST}/id")),
        (
            Target("webhook", "get", "/webhooks/{key}", "key"),
            Target("deliveries", "get", "/webhooks/{key}/deliveries", "key"),
            Target("forget_webhook", "delete", "/webhooks/{key}", "key"),
        ),
    ),
)


def with_links(document: dict[str, Any]) -> dict[str, Any]:
    """Add the links to an OpenAPI document."""
    paths = document["paths"]
    for sources, targets in LINKS:
        for source in sources:
            others = {name: f"$request.path.{name}" for name in source.others}
            paths[API + source.path][source.method]["responses"][source.status]["links"] = {
                target.name: {
                    "operationId": paths[API + target.path][target.method]["operationId"],
                    "parameters": {**others, target.parameter: source.value},
                }
                for target in targets
            }
    return document
