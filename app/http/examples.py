"""Examples in the OpenAPI document: of every parameter, body and answer.

A test sends them all to a running service, and compares what it answers with the examples of answers.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

ANSWERS = Path(__file__).with_name("example_answers.json")
"""Operation, status and media type to example: what a service really answered."""

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
ENTRY = "61e0e39c6d7a"

MACHINE_FILE = {
    "name": "pendulum",
    "links": {"base": {"fixed": True}, "arm": {"mass": "1.2 kg", "inertia": 0.02, "cg": [0.1, 0]}},
    "joints": {"O": {"kind": "turning", "links": ["arm", "base"], "at": [0, 0]}},
    "drive": {"kind": "rotation", "joint": "O", "speed": "120 rpm"},
}
MACHINE_YAML = """name: pendulum
links:
  base: {fixed: true}
  arm: {mass: 1.2 kg, inertia: 0.02, cg: [0.1, 0]}
joints:
  O: {kind: turning, links: [arm, base], at: [0, 0]}
drive: {kind: rotation, joint: O, speed: 120 rpm}
"""

#: By name and the beginning of the path, the longest beginning first.
PARAMETERS: tuple[tuple[str, str, Any], ...] = (
    ("key", "/api/v1/catalogues/{name}/entries", ENTRY),
    ("key", "/api/v1/builds", BUILD),
    ("key", "/api/v1/measurements", MEASUREMENT),
    ("key", "/api/v1/diagnoses", DIAGNOSIS),
    ("key", "/api/v1/findings", FINDING),
    ("key", "/api/v1/webhooks", WEBHOOK),
    ("name", "/api/v1/", "slider-crank"),
    ("external_id", "", "press-7"),
    ("measurement", "", MEASUREMENT),
    ("diagnosis", "", DIAGNOSIS),
    ("asset", "", "press-7"),
    ("since", "", "2026-11-21T00:00:00Z"),
    ("format", "", "html"),
    ("hypothesis", "", "A"),
    ("joint", "", "A"),
    ("stratum", "", "trusted"),
    ("status", "", "ok"),
    ("law", "", "own"),
    ("min_clearance_um", "", 50),
    ("max_clearance_um", "", 400),
    ("limit", "", 20),
    ("Idempotency-Key", "", "7f3c1c1e-2f5b-4d0e-9a43-0c6a5d1f8e22"),
)
#: A machine is put under a name of its own.
PUT_NAME = "press-7"
#: Handed out by the service: an example of it would be one of nothing.
WITHOUT = frozenset({"cursor"})

#: A recording of 0.1 s; the shortest that is taken has 256 samples.
RECORDING = {
    "name": "press-7",
    "sample_rate_hz": 2560,
    "channels": [{"name": "s1-y", "unit": "g", "values": [(7 * k) % 13 - 6 for k in range(256)]}],
    "profile": {"sensors": {"s1-y": "s1-y"}},
}
DIAGNOSE = {"catalogue": "slider-crank", "speed": "606.8 rpm", "effort": "fast", "asset": "press-7"}
BODIES: dict[tuple[str, str], dict[str, Any]] = {
    ("put", "/api/v1/machines/{name}"): {"application/json": MACHINE_FILE, "application/yaml": MACHINE_YAML},
    ("post", "/api/v1/builds"): {
        "application/json": {"machine": "slider-crank", "plan": "quick", "catalogue": "press-7"}
    },
    ("post", "/api/v1/measurements"): {"application/json": RECORDING},
    ("post", "/api/v1/diagnoses"): {
        "application/json": {**DIAGNOSE, "measurement": MEASUREMENT},
        "multipart/form-data": {**DIAGNOSE, "measurement": MEASUREMENT},
    },
    ("put", "/api/v1/assets/{external_id}"): {
        "application/json": {"machine": "slider-crank", "notes": "hall 2, line 3"}
    },
    ("post", "/api/v1/webhooks"): {
        "application/json": {"url": "https://maintenance.example/jointplay", "events": ["diagnosis.created"]}
    },
    ("post", "/api/v1/diagnoses/{key}/finding"): {
        "application/json": {
            "joints": {"B": {"clearance_um": 140}},
            "text": "gudgeon pin worn, replaced",
            "at": "2026-11-21T10:30:00Z",
        }
    },
}


def with_examples(document: dict[str, Any]) -> dict[str, Any]:
    """Add the examples to an OpenAPI document."""
    answers: dict[str, dict[str, dict[str, Any]]] = json.loads(ANSWERS.read_text(encoding="utf-8"))
    document["info"]["description"] = NOTE
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for parameter in operation.get("parameters", ()):
                found = example_of(method, path, parameter["name"])
                if found is not None:
                    parameter["example"] = found
            for kind, example in BODIES.get((method, path), {}).items():
                operation["requestBody"]["content"][kind]["example"] = example
            for status, contents in answers.get(f"{method} {path}", {}).items():
                for kind, example in contents.items():
                    operation["responses"][status]["content"][kind]["example"] = example
    return document


def example_of(method: str, path: str, name: str) -> Any:
    """Return the example of a parameter; ``None`` where there is none."""
    if (method, path, name) == ("put", "/api/v1/machines/{name}", "name"):
        return PUT_NAME
    return next((value for each, start, value in PARAMETERS if each == name and path.startswith(start)), None)
