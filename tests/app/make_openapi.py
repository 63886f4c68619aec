"""``make openapi``: the OpenAPI document made anew, its examples being what a service answers now."""

from __future__ import annotations

import copy
import hashlib
import json
import logging
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from example_calls import Answers, ExampleService
from example_differences import differences
from recordings import unpacked
from small_service import PLAN

from jointplay.app.http.examples import DOCUMENT, read_document
from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.building.build import build
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.solver.machines.machine import shipped_machine


def digest_of(document: dict[str, Any]) -> str:
    """What tells a document from any other; its version aside."""
    rest = {name: value for name, value in document.items() if name != "x-digest"}
    rest["info"] = {name: value for name, value in document["info"].items() if name != "version"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()[:16]


def with_answers(document: dict[str, Any], answers: Answers) -> dict[str, Any]:
    """A document whose examples are these answers, but for those that are like their example."""
    found = copy.deepcopy(document)
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                now = answers.get(f"{method} {path}", {}).get(status, {})
                for kind, media in response.get("content", {}).items():
                    if kind not in now:
                        media.pop("example", None)
                    elif "example" not in media or any(differences(media["example"], now[kind], "")):
                        media["example"] = now[kind]
    return found


def with_version(document: dict[str, Any], former: dict[str, Any]) -> dict[str, Any]:
    """A document with the version of the former one: with the next minor one if it is another."""
    version, digest = former["info"]["version"], digest_of(document)
    if digest != former["x-digest"]:
        major, minor, _ = version.split(".")
        version = f"{major}.{int(minor) + 1}.0"
    return {**document, "info": {**document["info"], "version": version}, "x-digest": digest}


def main() -> None:
    logging.getLogger("python_multipart").setLevel(logging.ERROR)  # one example is a body that it cannot read
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        build(shipped_machine("slider-crank"), parse_plan(PLAN), folder / "shelf" / "slider-crank", workers=2)
        service = ExampleService(folder / "shelf", folder / "data", unpacked("slider-crank-02.csv"))
        try:
            successes = service.successes()
            for each in successes:
                if each.response.status_code >= 300:
                    raise SystemExit(
                        f"{each.call.method} {each.call.path}: its example is refused: {each.response.text}"
                    )
            answers = service.answers(successes)
        finally:
            service.close()
        document = create_app(ServiceSettings(data=folder / "unused", keys="required")).openapi()
    former = read_document()
    made = with_version(with_answers(document, answers), former)
    DOCUMENT.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    changed = "as it was" if made == former else f"changed; before it was {former['info']['version']}"
    print(f"{DOCUMENT.name} {made['info']['version']}: {changed}")


if __name__ == "__main__":
    main()
