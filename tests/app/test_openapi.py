"""The committed OpenAPI document is the one the service gives."""

from __future__ import annotations

import json
from typing import Any

import pytest
from example_calls import examples_of
from make_openapi import digest_of, with_answers, with_version

from jointplay.app.http.examples import read_document
from jointplay.app.http.openapi import REFERENCE
from jointplay.app.main import create_app
from jointplay.app.problems import MEDIA_TYPE
from jointplay.app.settings import ServiceSettings

ASSET_MEASUREMENT = "/api/v1/assets/{external_id}/measurements/{measurement}"


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return create_app(ServiceSettings(data=tmp_path_factory.mktemp("unused"), keys="required")).openapi()


def test_the_committed_document_is_up_to_date(document: dict[str, Any]) -> None:
    written = {name: value for name, value in read_document().items() if name != "x-digest"}
    assert written == document, "run `make openapi`"


def test_a_change_raises_the_version(document: dict[str, Any]) -> None:
    written = read_document()
    assert digest_of(written) == written["x-digest"], "another document has another version: run `make openapi`"
    assert with_version(document, written) == written
    other = with_version({**document, "paths": {}}, {**written, "info": {**written["info"], "version": "3.4.5"}})
    assert other["info"]["version"] == "3.5.0" and other["x-digest"] == digest_of(other) != written["x-digest"]


def test_answers_that_are_like_their_examples_leave_them(document: dict[str, Any]) -> None:
    answers = json.loads(json.dumps(examples_of(document)))
    webhook = answers["post /api/v1/webhooks"]["201"]["application/json"]
    webhook["created_at"] = "2031-01-01T00:00:00Z"
    assert with_answers(document, answers) == document
    webhook["events"] = []
    del answers["get /healthz"]
    made = examples_of(with_answers(document, answers))
    assert made["post /api/v1/webhooks"]["201"]["application/json"] == webhook
    assert "get /healthz" not in made


def test_every_error_is_a_problem(document: dict[str, Any]) -> None:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            assert "default" in operation["responses"], (method, path)
            for status, response in operation["responses"].items():
                if status == "default" or status.startswith(("4", "5")):
                    assert list(response["content"]) == [MEDIA_TYPE], (method, path, status)
                    assert response["content"][MEDIA_TYPE]["schema"] == REFERENCE, (method, path, status)


def test_nothing_of_the_frameworks_error_shape_remains(document: dict[str, Any]) -> None:
    text = json.dumps(document)
    assert "HTTPValidationError" not in text
    assert "ValidationError" not in text


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]

    def references(node: Any) -> list[str]:
        if isinstance(node, dict):
            own = [node["$ref"]] if isinstance(node.get("$ref"), str) else []
            return own + [found for child in node.values() for found in references(child)]
        return [found for child in node for found in references(child)] if isinstance(node, list) else []

    for reference in references(document):
        assert reference.removeprefix("#/components/schemas/") in schemas, reference


def test_every_operation_says_what_it_does(document: dict[str, Any]) -> None:
    for operations in document["paths"].values():
        for operation in operations.values():
            assert operation["summary"]
            assert operation["description"]


def test_every_link_leads_to_an_operation_that_takes_it(document: dict[str, Any]) -> None:
    operations = {
        operation["operationId"]: (path, operation)
        for path, each in document["paths"].items()
        for operation in each.values()
    }
    reached = set()
    for path, operation in operations.values():
        for response in operation["responses"].values():
            for name, link in response.get("links", {}).items():
                _, taken = operations[link["operationId"]]
                wanted = {each["name"] for each in taken["parameters"] if each["in"] == "path"}
                assert set(link["parameters"]) == wanted, (path, name)
                reached.add(link["operationId"])
    by_name = {key for key, (path, _) in operations.items() if "{" in path}
    known = {operations[key][0] for key in by_name - reached}
    # What is put has a name that its sender gives.
    acknowledged = "/api/v1/assets/{external_id}/acknowledgement"
    retention = "/api/v1/measurements/{key}/retention"
    put = {"/api/v1/machines/{name}", "/api/v1/assets/{external_id}", acknowledged, ASSET_MEASUREMENT, retention}
    # A delivery is asked for in its list alone.
    assert known == put | {"/api/v1/webhooks/{key}/deliveries/{delivery}/redelivery"}
