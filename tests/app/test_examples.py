"""The examples of the OpenAPI document: every parameter, body and answer has one, and they are what really happens."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from example_calls import BINARY, Answered, ExampleService, examples_of
from example_differences import differences

from jointplay.app.http import examples
from jointplay.app.routes.machines import MACHINE_FILE

OPERATIONS_AT_LEAST = 34
#: Not in any document: the file of a form.
UPLOAD = ("post", "/api/v1/measurements")


@pytest.fixture(scope="module")
def service(shelf: Path, tmp_path_factory: pytest.TempPathFactory, worn: bytes) -> Iterator[ExampleService]:
    running = ExampleService(shelf, tmp_path_factory.mktemp("examples"), worn)
    yield running
    running.close()


@pytest.fixture(scope="module")
def successes(service: ExampleService) -> list[Answered]:
    return service.successes()


def test_everything_that_is_sent_has_an_example(service: ExampleService) -> None:
    operations = service.operations()
    assert len(operations) >= OPERATIONS_AT_LEAST
    for method, path, operation in operations:
        for parameter in operation.get("parameters", ()):
            assert ("example" in parameter) != (parameter["name"] in examples.WITHOUT), (method, path, parameter)
        for kind, media in operation.get("requestBody", {}).get("content", {}).items():
            assert "example" in media or (method, path) == UPLOAD, (method, path, kind)


def test_every_operation_succeeds_with_its_examples(service: ExampleService, successes: list[Answered]) -> None:
    described = {(method, path): operation["responses"] for method, path, operation in service.operations()}
    seen = set()
    for each in successes:
        place = (each.call.method, each.call.path)
        assert each.response.status_code < 300, (place, each.response.text)
        content = described[place][str(each.response.status_code)].get("content", {})
        assert each.kind in content or not each.response.content, (place, each.kind)
        if each.kind == "application/json" and each.response.content:
            schema = {**content[each.kind]["schema"], "components": service.document["components"]}
            jsonschema.validate(each.response.json(), schema)
        seen.add(place)
    assert seen == set(described)


def test_every_answer_has_an_example_that_fits(service: ExampleService) -> None:
    for method, path, operation in service.operations():
        for status, response in operation["responses"].items():
            if status == "default" and not path.startswith("/api/"):
                continue
            for kind, media in response.get("content", {}).items():
                assert ("example" in media) != (kind in BINARY), (method, path, status, kind)
                if kind not in BINARY:
                    schema = {**media["schema"], "components": service.document["components"]}
                    jsonschema.validate(media["example"], schema)


def test_the_examples_are_what_is_answered(service: ExampleService, successes: list[Answered]) -> None:
    found = list(differences(examples_of(service.document), service.answers(successes), ""))
    assert not found, f"{found[:5]}: if what is answered now is right, run `make openapi`"


def test_an_example_that_is_wrong_would_be_seen(service: ExampleService) -> None:
    place = f"/api/v1/machines/{examples.PUT_NAME}"
    wrong = {**MACHINE_FILE, "drive": {"kind": "rotation", "joint": "P", "speed": 1}}
    assert service.client.put(place, json=wrong).status_code == 422


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        ({"a": 1}, {"a": 1, "b": 2}, False),
        ([1, 2], [1], False),
        ([1.0], [1.1], True),
        ([100.0], [250.0], False),
        ({"interval_um": [100.0, 900.0]}, {"interval_um": [250.0, 900.0]}, True),
        ({"interval_um": [100.0, 900.0]}, {"interval_um": [400.0, 900.0]}, False),
        ({"detectable_from_um": None}, {"detectable_from_um": 61.3}, True),
        ({"size_bytes": 543276}, {"size_bytes": 543267}, True),
        ({"size_bytes": 543276}, {"size_bytes": 540000}, False),
        (3, 4, False),
        (None, 1.0, False),
        (True, 1, False),
        ([{"label": "A", "probability": 1e-3}], [{"label": "A", "probability": 1e-9}], True),
        ([{"label": "A", "probability": 1e-3}], [{"label": "B", "probability": 1e-3}], False),
        ([{"label": "A", "probability": 1e-3}], [{"label": "A", "probability": 0.5}], False),
        ("a 17.5", "a 18", True),
        ("a 17.5", "b 17.5", False),
        (f"{'a' * 30} 1 word…", f"{'a' * 30} 1000 wo…", True),
        (f"x{'z' * 30}…", f"y{'z' * 30}…", False),
        ("0123456789abcdef", "fedcba9876543210", True),
        ("2026-11-21T10:00:00Z", "2027-01-01T00:00:00.5Z", True),
    ],
)
def test_what_counts_as_a_difference(one: Any, other: Any, alike: bool) -> None:
    assert bool(list(differences(one, other, ""))) is not alike
