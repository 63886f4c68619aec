"""The examples of the OpenAPI document: every parameter, body and answer has one, and they are what really happens."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from example_calls import BINARY, Answered, ExampleService, shown

from jointplay.app.http import examples
from jointplay.app.problems import MEDIA_TYPE
from jointplay.app.routes.machines import MACHINE_FILE

OPERATIONS_AT_LEAST = 34
#: Not in any document: the file of a form.
UPLOAD = ("post", "/api/v1/measurements")
ID = re.compile(r"\b[0-9a-f]{12,64}\b")
TIME = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+Z")
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
#: Numbers that were computed differ from one computer to another: joints that knock make much of a rounding, and the
#: catalogue of these examples is small.
RELATIVE, ABSOLUTE = 0.5, 0.1
#: Hypotheses that are less likely are what rounding makes of them: their order and their numbers are no difference, nor
#: is what evidence says against the likeliest of them, the rival.
NEGLIGIBLE, RIVAL = 0.01, "rival"
#: How a text ends that was cut, and how much of its end may be half a word.
CUT, LAST_WORD = "…", 20

Answers = dict[str, dict[str, dict[str, Any]]]


@pytest.fixture(scope="module")
def service(shelf: Path, tmp_path_factory: pytest.TempPathFactory, worn: bytes) -> Iterator[ExampleService]:
    running = ExampleService(shelf, tmp_path_factory.mktemp("examples"), worn)
    yield running
    running.close()


@pytest.fixture(scope="module")
def successes(service: ExampleService) -> list[Answered]:
    return service.successes()


@pytest.fixture(scope="module")
def answers(service: ExampleService, successes: list[Answered]) -> Answers:
    """What the service answers now: operation, status and media type to example."""
    found: Answers = {}
    for each in successes:
        if each.response.content and each.kind not in BINARY:
            place = found.setdefault(f"{each.call.method} {each.call.path}", {})
            place.setdefault(str(each.response.status_code), {}).setdefault(each.kind, shown(each.response))
    for method, path, status, response in service.refusals():
        assert status in (str(response.status_code), "default"), (method, path, status, response.text)
        found.setdefault(f"{method} {path}", {})[status] = {MEDIA_TYPE: shown(response)}
    text = json.dumps(found)
    for real, invented in service.invented.items():
        text = text.replace(real, invented)
    replaced: Answers = json.loads(text)
    return replaced


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


def test_the_examples_are_what_is_answered(answers: Answers, tmp_path: Path) -> None:
    written = json.loads(examples.ANSWERS.read_text(encoding="utf-8"))
    made = tmp_path / examples.ANSWERS.name
    made.write_text(json.dumps(answers, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    found = list(differences(written, answers, ""))
    assert not found, f"{found[:5]}: if what is answered now is right, copy {made} to {examples.ANSWERS}"


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


def differences(one: Any, other: Any, place: str) -> Iterator[str]:
    """Where two answers differ: ids, times and the last digits of what was computed aside."""
    if isinstance(one, dict) and isinstance(other, dict):
        if one.get(RIVAL) != other.get(RIVAL):
            one, other = dict.fromkeys(one), dict.fromkeys(other)
        for name in one.keys() | other.keys():
            if name in one and name in other:
                yield from differences(one[name], other[name], f"{place}/{name}")
            else:
                yield f"{place}/{name} is only {'written' if name in one else 'answered'}"
    elif isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            yield f"{place} has {len(one)} items, not {len(other)}"
        one, other = ranking(one), ranking(other)
        for number, (each, its) in enumerate(zip(one, other, strict=False)):
            yield from differences(each, its, f"{place}/{number}")
    elif isinstance(one, float) and isinstance(other, float):
        if not math.isclose(one, other, rel_tol=RELATIVE, abs_tol=ABSOLUTE):
            yield f"{place} is {one}, not {other}"
    elif isinstance(one, str) and isinstance(other, str):
        first, second = plain(one), plain(other)
        if one.endswith(CUT) and other.endswith(CUT):  # where exactly depends on the length of its numbers
            most = min(len(first), len(second)) - LAST_WORD
            first, second = first[:most], second[:most]
        if first != second:
            yield f"{place} is {one!r}, not {other!r}"
    elif type(one) is not type(other) or one != other:
        yield f"{place} is {one!r}, not {other!r}"


def ranking(items: list[Any]) -> list[Any]:
    """Hypotheses with what is left of those that are not negligible, these by name; any other list as it is."""
    if not all(isinstance(each, dict) and {"label", "probability"} <= each.keys() for each in items):
        return items
    likely = [each for each in items if each["probability"] >= NEGLIGIBLE]
    return likely + sorted(each["label"] for each in items if each["probability"] < NEGLIGIBLE)


def plain(text: str) -> str:
    """A text without what differs from call to call."""
    return NUMBER.sub("0", ID.sub("ID", TIME.sub("TIME", text)))
