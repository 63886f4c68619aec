"""The examples of the OpenAPI document as calls: what is sent with them, and what is sent to be refused."""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import httpx
from small_service import serving
from sqlalchemy import update

from jointplay.app.errors import (
    BusyError,
    DamagedRowError,
    DatabaseGoneError,
    DeletedError,
    KeyInUseError,
    KeyRevokedError,
    TimeLimitError,
    WebhookDisabledError,
    WorkerDiedError,
)
from jointplay.app.http import examples
from jointplay.app.http.gate import Gate
from jointplay.app.jobs.standing_keeper import StandingKeeper
from jointplay.app.jobs.webhook_sender import WebhookSender
from jointplay.app.problems import MEDIA_TYPE
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.build_queue import BuildRow
from jointplay.app.storage.store import Store
from jointplay.catalogue.errors import CatalogueFileError, CatalogueMismatchError
from jointplay.catalogue.storage.store import Catalogue

UPLOAD_MB = 3.0
MULTIPART = "multipart/form-data"
JSON = "application/json"
BINARY = ("application/pdf", "application/x-hdf5", "application/x-npy")
#: What creates comes first, and gives the ids that the others ask for; what forgets comes last.
FIRST = (
    "/api/v1/webhooks",
    "/api/v1/webhooks/{key}/test",
    "/api/v1/keys",
    "/api/v1/measurements",
    "/api/v1/assets/{external_id}",
    "/api/v1/diagnoses",
    "/api/v1/builds",
)
#: What is deleted last, in this order: others speak of it.
LAST = tuple(
    f"/api/v1/{each}"
    for each in ("findings/{key}", "diagnoses/{key}", "assets/{external_id}", "measurements/{key}", "catalogues/{name}")
)
PUT = ("/api/v1/assets/{external_id}", "/api/v1/machines/{name}")
CREATED = {
    "/api/v1/diagnoses": examples.DIAGNOSIS,
    "/api/v1/builds": examples.BUILD,
    "/api/v1/diagnoses/{key}/finding": examples.FINDING,
    "/api/v1/webhooks": examples.WEBHOOK,
    "/api/v1/webhooks/{key}/test": examples.DELIVERY,
    "/api/v1/keys": examples.KEY,
    "/api/v1/measurements": examples.MEASUREMENT,
}

#: Operation, status and media type to answer.
Answers = dict[str, dict[str, dict[str, Any]]]


@dataclass(frozen=True)
class Call:
    """One request of an operation, as the client takes it."""

    method: str
    path: str
    where: dict[str, str] = field(default_factory=dict)
    query: dict[str, Any] = field(default_factory=dict)
    sent: dict[str, Any] = field(default_factory=dict)
    headers: dict[str, str] = field(default_factory=dict)

    def made(self, client: httpx.Client) -> httpx.Response:
        place = self.path.format(**self.where)
        return client.request(self.method.upper(), place, params=self.query, headers=self.headers, **self.sent)


@dataclass(frozen=True)
class Answered:
    """A call with its answer."""

    call: Call
    response: httpx.Response

    @property
    def kind(self) -> str:
        return str(self.response.headers.get("content-type", "")).partition(";")[0]


class ExampleService:
    """A running service to which examples are sent."""

    def __init__(self, shelf: Path, data: Path, worn: bytes) -> None:
        self._shelf = shelf
        settings: dict[str, Any] = {
            "catalogues": data / "shelf",  # a copy: it is deleted, too
            "data": data,
            "workers": 1,
            "builds": 0,
            "max_upload_mb": UPLOAD_MB,
            "time_limit_s": 600.0,  # by the clock, beside whatever other work
        }
        self._stack = ExitStack()
        enter = self._stack.enter_context
        enter(mock.patch.object(WebhookSender, "_begin", return_value=False))  # nobody is told of examples
        enter(mock.patch.object(StandingKeeper, "step", return_value=False))  # at some moment of its own
        self.client = enter(httpx.Client(base_url=enter(serving(ServiceSettings(**settings, keys="off"))), timeout=300))
        locked = ServiceSettings(**{**settings, "data": data / "locked"}, keys="required")
        self.locked = enter(httpx.Client(base_url=enter(serving(locked)), timeout=300))
        self._data, self._worn = data, worn
        self.put_catalogues()
        self.document: dict[str, Any] = self.client.get("/openapi.json").json()
        #: Example of an id, or of an entry's key, to the real one.
        self.real: dict[str, str] = {}
        #: And back, also of those that are forgotten by now.
        self.invented: dict[str, str] = {}
        self.know(examples.ENTRY, str(Catalogue.open(shelf / "slider-crank").entries.key[0])[:12])

    def close(self) -> None:
        self._stack.close()

    def know(self, invented: str, real: str) -> None:
        self.real[invented] = real
        self.invented[real] = invented

    def operations(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Method, path and description of every operation, in the order in which they can succeed."""
        found = [(m, path, each) for path, each_path in self.document["paths"].items() for m, each in each_path.items()]

        def order(entry: tuple[str, str, dict[str, Any]]) -> tuple[bool, bool, int, bool]:
            method, path, _ = entry
            if method == "delete":
                place = LAST.index(path) if path in LAST else -1
            else:
                place = FIRST.index(path) if path in FIRST else len(FIRST)
            return method == "delete", method not in ("put", "post"), place, path.endswith("/cancel")

        return sorted(found, key=order)

    def calls(self, method: str, path: str, operation: dict[str, Any]) -> Iterator[Call]:
        """The calls of an operation with its examples: one for each body it takes."""
        given = [each for each in operation.get("parameters", ()) if "example" in each]
        where, query = (
            {each["name"]: self.swapped(each["example"]) for each in given if each["in"] == place}
            for place in ("path", "query")
        )
        for kind, media in operation.get("requestBody", {}).get("content", {None: {}}).items():
            body = self.swapped(media.get("example", {}))
            if kind == MULTIPART:
                sent: dict[str, Any] = {"files": {name: (None, str(value)) for name, value in body.items()}}
                if path == "/api/v1/measurements":
                    sent["files"]["file"] = ("press-7.csv", self._worn)
            elif kind == JSON:
                sent = {"json": body}
            else:
                sent = {"content": body, "headers": {"Content-Type": kind}} if kind else {}
            headers = sent.pop("headers", {})
            yield Call(method, path, where, query, sent, headers)

    def successes(self) -> list[Answered]:
        """Send every example."""
        found = []
        for method, path, operation in self.operations():
            shown = [kind for status in operation["responses"].values() for kind in status.get("content", {})]
            for call in self.calls(method, path, operation):
                answered = Answered(call, call.made(self.client))
                found.append(answered)
                self.learn(answered)
                if method == "put" and answered.response.status_code == 201:
                    found.append(Answered(call, call.made(self.client)))  # now there is one
                if method == "get":
                    # The forms that are not the usual one; `format` goes before `Accept`.
                    others = [kind for kind in shown if kind not in (answered.kind, "application/problem+json")]
                    query = {name: value for name, value in call.query.items() if name != "format"}
                    for kind in others:
                        other = replace(call, query=query, headers={"Accept": kind})
                        found.append(Answered(other, other.made(self.client)))
        return found

    def answers(self, successes: list[Answered]) -> Answers:
        """What is answered now, errors included, with the invented ids in place of the real ones."""
        found: Answers = {}
        for each in successes:
            if each.response.content and each.kind not in BINARY:
                place = found.setdefault(f"{each.call.method} {each.call.path}", {})
                place.setdefault(str(each.response.status_code), {}).setdefault(each.kind, shown(each.response))
        for method, path, status, response in self.refusals():
            assert status in (str(response.status_code), "default"), (method, path, status, response.text)
            found.setdefault(f"{method} {path}", {})[status] = {MEDIA_TYPE: shown(response)}
        text = json.dumps(found)
        for real, invented in self.invented.items():
            text = text.replace(real, invented)
        replaced: Answers = json.loads(text)
        return replaced

    def learn(self, answered: Answered) -> None:
        """Note the id of what was created."""
        place = answered.call.path if answered.call.method == "post" else ""
        if place == "/api/v1/measurements" and CREATED[place] in self.real:
            return  # the first of them is long enough to be diagnosed
        if place in CREATED and answered.response.status_code < 300:
            self.know(CREATED[place], answered.response.json()["id"])

    def refusals(self) -> Iterator[tuple[str, str, str, httpx.Response]]:
        """Method, path, status (or ``default``) and the answer, for every error that an operation says it has."""
        self.put_catalogues()
        for method, path, operation in self.operations():  # all of it was there, and was deleted
            call = next(self.calls(method, path, operation))
            if (method == "post" and path in CREATED) or (method == "put" and path in PUT):
                self.learn(Answered(call, call.made(self.client)))
        for method, path, operation in self.operations():
            call = next(self.calls(method, path, operation))
            for status in operation["responses"]:
                if status == "default":
                    if path.startswith("/api/"):  # the others are open
                        yield method, path, status, call.made(self.locked)
                elif status >= "400":
                    yield method, path, status, self.refused(call, operation, int(status))

    def refused(self, call: Call, operation: dict[str, Any], status: int) -> httpx.Response:
        """Send a call that is answered with an error."""
        failing = self.failing(call, operation, status)
        if failing is not None:
            with mock.patch.object(Gate, "_judge", mock.AsyncMock(side_effect=failing)):
                return call.made(self.client)
        if call.path == "/api/v1/builds/{key}/cancel" and status == 409:
            self.end_build()
            return call.made(self.client)
        return WRONG[status](call, operation).made(self.client)

    def put_catalogues(self) -> None:
        """Let the catalogues be there."""
        shutil.copytree(self._shelf, self._data / "shelf", dirs_exist_ok=True)

    def failing(self, call: Call, operation: dict[str, Any], status: int) -> Exception | None:
        """What goes wrong inside where an error is not the client's fault, or only at that moment."""
        keyed = any(each["name"] == "Idempotency-Key" for each in operation.get("parameters", ()))
        if status == 409 and keyed:
            return KeyInUseError("Idempotency-Key: the first request with it is not answered yet")
        if call.path.endswith("/verification") and status == 409:
            said = f"diagnosis {examples.DIAGNOSIS}: its row is not what was written; bring it back from a backup"
            return DamagedRowError(said, number=1)
        if call.path.endswith("/forecasts") and status == 409:
            return CatalogueMismatchError("press-7", "holds a catalogue of another machine: name another folder")
        if call.path.endswith("/rotate") and status == 409:
            return KeyRevokedError(f"the key {call.where['key']} was revoked; make another")
        if call.path.endswith("/redelivery") and status == 409:
            return WebhookDisabledError(f"webhook {call.where['key']}: is disabled; a test that succeeds enables it")
        if "entries" in call.path and status in (409, 500):
            if status == 409:
                return CatalogueMismatchError("slider-crank", "has layout 1; this program reads layout 2")
            return CatalogueFileError("slider-crank", "does not match its checksum: verify the catalogue")
        if status == 410:
            said = "was deleted at 2026-11-26T08:00:00Z by key 3f9c21d07a55: the customer has left"
            return DeletedError(f"measurement {examples.MEASUREMENT}: {said}")
        computing = "504" in operation["responses"]
        return {
            500: WorkerDiedError("the process that computed this ended early, perhaps for want of memory"),
            503: BusyError("32 requests wait for a worker already; try again in a few seconds")
            if computing
            else DatabaseGoneError("the database of the service does not answer; try again in a few seconds"),
            504: TimeLimitError("stopped after 120 s, the time limit of this service"),
            507: OSError(errno.ENOSPC, "No space left on device"),
        }.get(status)

    def end_build(self) -> None:
        """Let all builds be done."""
        store = Store(self._data)
        with store.database.writing() as session:
            session.execute(update(BuildRow).values(state="done"))
        store.close()

    def swapped(self, node: Any) -> Any:
        """A copy of an example in which invented ids are real ones."""
        if isinstance(node, dict):
            return {name: self.swapped(child) for name, child in node.items()}
        return self.real.get(node, node) if isinstance(node, str) else node


def unreadable(call: Call, operation: dict[str, Any]) -> Call:
    """A cursor that is none, or a body that ends early."""
    if any(each["name"] == "cursor" for each in operation.get("parameters", ())):
        return replace(call, query={"cursor": "x"})
    if "files" in call.sent:
        headers = {"Content-Type": f"{MULTIPART}; boundary=b"}
        return replace(call, sent={"content": b"--b\r\nContent-Disposition\r\n\r\n"}, headers=headers)
    return replace(call, sent={"content": b'{"name": '}, headers={"Content-Type": JSON})


def unknown(call: Call, _operation: dict[str, Any]) -> Call:
    """An id that nothing has."""
    if call.where:
        last = "name" if "name" in call.where else list(call.where)[-1]
        return replace(call, where={**call.where, last: "unknown"})
    if "files" in call.sent:
        return replace(call, sent={"files": {**call.sent["files"], "asset": (None, "unknown")}})
    named = "catalogue" if call.path.endswith("/virtual") else "measurement"
    return replace(call, sent={"json": {**call.sent["json"], named: "unknown"}})


def too_large(call: Call, _operation: dict[str, Any]) -> Call:
    """A body over the limit."""
    if "files" in call.sent:
        return replace(call, sent={"files": {"file": ("long.csv", b"0" * int(UPLOAD_MB * 1.01e6))}})
    return replace(call, sent={"content": b" " * 1_010_000}, headers={"Content-Type": JSON})


def wrong(call: Call, operation: dict[str, Any]) -> Call:
    """A field that breaks a rule: of the body, of the query, of the path."""
    if call.path.endswith("/rotate"):  # everything in it may be left out
        return replace(call, sent={"json": {"days": 0}})
    if "json" in call.sent:
        needed = ("machine", "catalogue", "links", "url", "at", "measured_at", "state", "name")
        body = dict.fromkeys(call.sent["json"], "nonsense")
        if named := [name for name in needed if name in body]:
            body = {name: value for name, value in call.sent["json"].items() if name != named[0]}
        return replace(call, sent={"json": body})
    if "files" in call.sent:
        return replace(call, sent={"files": {"sample_rate": (None, "10 kHz")}})
    names = [each["name"] for each in operation.get("parameters", ()) if each["in"] == "query"]
    if names:
        return replace(call, query={names[-1]: "0" if call.method != "delete" else "x" * 201})
    return replace(call, where={**call.where, "external_id": ".press"})


def conditional(call: Call, _operation: dict[str, Any]) -> Call:
    return replace(call, headers={**call.headers, "If-None-Match": "*"})


def of_no_type(call: Call, _operation: dict[str, Any]) -> Call:
    return replace(call, sent={"content": b"-"}, headers={"Content-Type": "text/plain"})


def unwanted(call: Call, _operation: dict[str, Any]) -> Call:
    return replace(call, query={}, headers={"Accept": "image/png"})


def shipped(call: Call, _operation: dict[str, Any]) -> Call:
    return replace(call, where={"name": "slider-crank"})


#: From a call that succeeds to one that is refused.
WRONG: dict[int, Callable[[Call, dict[str, Any]], Call]] = {
    400: unreadable,
    404: unknown,
    406: unwanted,
    409: shipped,
    412: conditional,
    413: too_large,
    415: of_no_type,
    422: wrong,
}


def examples_of(document: dict[str, Any]) -> Answers:
    """The examples of answers in a document."""
    found: Answers = {}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                for kind, media in response.get("content", {}).items():
                    if "example" in media:
                        found.setdefault(f"{method} {path}", {}).setdefault(status, {})[kind] = media["example"]
    return found


def shown(answered: httpx.Response) -> Any:
    """An answer as its example: JSON, the first event of a stream, the beginning of a text."""
    kind = answered.headers.get("content-type", "").partition(";")[0]
    if kind.endswith("json"):
        return shortened(answered.json())
    if kind == "text/event-stream":
        first = answered.text.partition("\n\n")[0]
        return dict(line.split(": ", 1) for line in first.splitlines())
    return shortened(answered.text)


def shortened(node: Any) -> Any:
    """A copy with three items of every list, six digits of every number, the beginning of every long text."""
    if isinstance(node, dict):
        return {name: shortened(child) for name, child in node.items()}
    if isinstance(node, list):
        return [shortened(child) for child in node[: examples.ITEMS]]
    if isinstance(node, float):
        return float(f"{node:.6g}")
    if isinstance(node, str) and len(node) > examples.TEXT:
        return f"{node[: examples.TEXT]}…"
    return node
