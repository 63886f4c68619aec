"""Examples in the OpenAPI document: of every parameter, body and answer.

Parameters and models of bodies say their own, except for ids, of which there is one a kind.

A test sends them all to a running service, and compares what it answers with the examples of answers.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

DOCUMENT = Path(__file__).with_name("openapi.json")
"""The document of a service that asks for keys, made by `make openapi`: its examples are what a service answered."""

ITEMS = 3
TEXT = 400
NOTE = (
    f"Examples are answers of a running service; lists are cut to {ITEMS} items there, texts to {TEXT} characters,"
    " numbers to six digits."
)

MEASUREMENT = "0f7c3f8b9f0d4a6e8f3d5a1b2c4e6f80"
DIAGNOSIS = "5b1e0c9d8a7f46352413f0e1d2c3b4a5"
BUILD = "58131617bf3da29c5b6c8cf7718f0dd5"
FINDING = "9d2f6b1c4e8a40739b5c6d7e8f901a2b"
WEBHOOK = "3a1d5e7f9b2c4d6e8f0a1b2c3d4e5f60"
DELIVERY = "7c4b9a2e1d6f4830a5b7c9d1e3f50246"
ENTRY = "61e0e39c6d7a"
KEY = "3f9c21d07a55"

#: Names and ids by name and the beginning of the path, the longest beginning first; other parameters say their own.
PARAMETERS: tuple[tuple[str, str, Any], ...] = (
    ("key", "/api/v1/catalogues/{name}/entries", ENTRY),
    ("key", "/api/v1/builds", BUILD),
    ("key", "/api/v1/measurements", MEASUREMENT),
    ("key", "/api/v1/diagnoses", DIAGNOSIS),
    ("key", "/api/v1/findings", FINDING),
    ("key", "/api/v1/webhooks", WEBHOOK),
    ("key", "/api/v1/keys", KEY),
    ("delivery", "/api/v1/webhooks", DELIVERY),
    ("name", "/api/v1/", "slider-crank"),
    ("external_id", "", "press-7"),
    ("measurement", "", MEASUREMENT),
    ("diagnosis", "", DIAGNOSIS),
    ("asset", "", "press-7"),
)
#: A machine is put under a name of its own.
PUT_NAME = "press-7"
#: Handed out by the service: an example of it would be one of nothing.
WITHOUT = frozenset({"cursor"})


@cache
def read_document() -> dict[str, Any]:
    """Return the document that was made: examples of answers are taken from it, and the version of the interface."""
    found: dict[str, Any] = json.loads(DOCUMENT.read_text(encoding="utf-8"))
    return found


def with_examples(document: dict[str, Any]) -> dict[str, Any]:
    """Add the examples to an OpenAPI document."""
    made = read_document()["paths"]
    document["info"]["description"] = NOTE
    schemas = document["components"]["schemas"]
    moved = []
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for parameter in operation.get("parameters", ()):
                own = parameter["schema"].pop("examples", [example_of(method, path, parameter["name"])])
                if own[0] is not None:
                    parameter["example"] = own[0]
            for media in operation.get("requestBody", {}).get("content", {}).values():
                schema = schemas.get(media["schema"].get("$ref", "").rpartition("/")[2], media["schema"])
                if "example" in schema:
                    media["example"] = schema["example"]
                    moved.append(schema)
            answered = made.get(path, {}).get(method, {}).get("responses", {})
            for status, response in operation["responses"].items():
                for kind, media in response.get("content", {}).items():
                    shown = answered.get(status, {}).get("content", {}).get(kind, {})
                    if "example" in shown:
                        media["example"] = shown["example"]
    for schema in moved:
        schema.pop("example", None)
    return document


def example_of(method: str, path: str, name: str) -> Any:
    """Return the example of a parameter; ``None`` where there is none."""
    if method in ("put", "delete") and (path, name) == ("/api/v1/machines/{name}", "name"):
        return PUT_NAME
    return next((value for each, start, value in PARAMETERS if each == name and path.startswith(start)), None)
