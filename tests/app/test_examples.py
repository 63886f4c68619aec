"""The examples of the OpenAPI document: every parameter and body has one, and every operation succeeds with them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import jsonschema
import pytest
from small_service import serving

from app import examples
from app.settings import Settings
from catalogue.store import Catalogue

OPERATIONS_AT_LEAST = 25
#: Not in any document: the file of a form.
UPLOAD = ("post", "/api/v1/measurements")
STREAM = ("get", "/api/v1/builds/{key}/events")


@pytest.fixture(scope="module")
def service(shelf: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    settings = Settings(catalogues=shelf, data=tmp_path_factory.mktemp("examples"), workers=1, builds=0, keys="off")
    with serving(settings) as address, httpx.Client(base_url=address, timeout=90) as client:
        yield client


def documented(client: httpx.Client) -> tuple[dict[str, Any], list[tuple[str, str, dict[str, Any]]]]:
    document: dict[str, Any] = client.get("/openapi.json").json()
    return document, [(m, path, each) for path, each_path in document["paths"].items() for m, each in each_path.items()]


def swapped(node: Any, real: dict[str, str]) -> Any:
    """A copy of an example in which invented ids are real ones."""
    if isinstance(node, dict):
        return {name: swapped(child, real) for name, child in node.items()}
    return real.get(node, node) if isinstance(node, str) else node


def test_everything_has_an_example(service: httpx.Client) -> None:
    _, operations = documented(service)
    assert len(operations) >= OPERATIONS_AT_LEAST
    for method, path, operation in operations:
        for parameter in operation.get("parameters", ()):
            assert ("example" in parameter) != (parameter["name"] in examples.WITHOUT), (method, path, parameter)
        for kind, media in operation.get("requestBody", {}).get("content", {}).items():
            assert "example" in media or (method, path) == UPLOAD, (method, path, kind)


def test_every_operation_succeeds_with_its_examples(service: httpx.Client, shelf: Path, worn: bytes) -> None:
    document, operations = documented(service)
    answer = service.post("/api/v1/measurements", files={"file": ("worn.csv", worn)})
    real = {examples.MEASUREMENT: answer.json()["id"]}
    real[examples.ENTRY] = str(Catalogue.open(shelf / "slider-crank").entries.key[0])[:12]
    # What creates comes first, and gives the ids that the others ask for.
    created = {"/api/v1/diagnoses": examples.DIAGNOSIS, "/api/v1/builds": examples.BUILD}
    created["/api/v1/diagnoses/{key}/finding"] = examples.FINDING
    created["/api/v1/webhooks"] = examples.WEBHOOK
    places = ("/api/v1/assets/{external_id}", "/api/v1/diagnoses", "/api/v1/builds", "/api/v1/diagnoses/{key}/finding")

    def order(entry: tuple[str, str, dict[str, Any]]) -> tuple[bool, bool, int, bool]:
        method, path, _ = entry
        return (
            method == "delete",
            method not in ("put", "post"),
            places.index(path) if path in places else 9,
            path.endswith("/cancel"),
        )

    tried = 0
    for method, path, operation in sorted(operations, key=order):
        if (method, path) in (UPLOAD, STREAM):
            continue
        given = [each for each in operation.get("parameters", ()) if "example" in each]
        where = {each["name"]: swapped(each["example"], real) for each in given if each["in"] == "path"}
        query = {each["name"]: swapped(each["example"], real) for each in given if each["in"] == "query"}
        content = operation.get("requestBody", {}).get("content", {None: {}})
        for kind, media in content.items():
            body = swapped(media.get("example"), real)
            if kind == "multipart/form-data":
                sent: dict[str, Any] = {"files": {name: (None, str(value)) for name, value in body.items()}}
            elif kind == "application/json":
                sent = {"json": body}
            else:
                sent = {"content": body, "headers": {"Content-Type": kind}} if kind else {}
            answer = service.request(method.upper(), path.format(**where), params=query, **sent)
            assert answer.status_code < 300, (method, path, kind, answer.text)
            described = operation["responses"][str(answer.status_code)].get("content", {})
            found = answer.headers.get("content-type", "").partition(";")[0]
            assert found in described or not answer.content, (method, path, found)
            if found == "application/json" and answer.content:
                schema = {**described[found]["schema"], "components": document["components"]}
                jsonschema.validate(answer.json(), schema)
            if method == "post" and path in created:
                real[created[path]] = answer.json()["id"]
            tried += 1
    assert tried >= OPERATIONS_AT_LEAST


def test_an_example_that_is_wrong_would_be_seen(service: httpx.Client) -> None:
    place = f"/api/v1/machines/{examples.PUT_NAME}"
    wrong = {**examples.MACHINE_FILE, "drive": {"kind": "rotation", "joint": "P", "speed": 1}}
    assert service.put(place, json=wrong).status_code == 422
