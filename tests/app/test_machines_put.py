"""Machines put there over HTTP: checks, conditions, names, two writers at once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from small_service import asking

from jointplay.app.etags import Conditions
from jointplay.app.jobs import tasks
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.machine_store import MachineStore
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import parse_machine, shipped_machine, shipped_machine_text

MACHINES = "/api/v1/machines"
TEXT = shipped_machine_text("slider-crank")
YAML = {"Content-Type": "application/yaml"}


@pytest.fixture(scope="module")
def own(shelf: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    settings = ServiceSettings(catalogues=shelf, data=tmp_path_factory.mktemp("machines"), workers=1, keys="off")
    with asking(settings) as client:
        yield client


def changed(**members: Any) -> dict[str, Any]:
    return {**json.loads(shipped_machine("slider-crank").canonical_json()), **members}


def test_a_machine_is_stored_and_found(own: httpx.Client) -> None:
    answer = own.put(f"{MACHINES}/press-1", content=TEXT, headers=YAML)
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"{MACHINES}/press-1"
    got = own.get(answer.headers["location"])
    assert got.json() == answer.json()
    assert got.headers["etag"] == answer.headers["etag"]
    assert parse_machine(got.text) == shipped_machine("slider-crank")
    assert own.get(f"{MACHINES}/press-1/drawing.svg").text.startswith("<svg")
    items = {item["name"]: item for item in own.get(MACHINES).json()["items"]}
    assert (items["press-1"]["shipped"], items["four-bar"]["shipped"]) == (False, True)
    again = own.put(f"{MACHINES}/press-1", json=got.json())  # the JSON form is the same machine
    assert (again.status_code, again.headers["etag"]) == (200, got.headers["etag"])


def test_a_file_that_is_not_stored_is_drawn(own: httpx.Client) -> None:
    drawn = own.post(f"{MACHINES}/drawing.svg", content=TEXT, headers=YAML)
    assert (drawn.status_code, drawn.headers["content-type"]) == (200, "image/svg+xml")
    assert drawn.text == own.get(f"{MACHINES}/slider-crank/drawing.svg").text
    joints = changed()["joints"]
    joints["A"]["at"] = [0.15, 0.05]  # a crank longer than the rod
    drawn = own.post(f"{MACHINES}/drawing.svg", json=changed(joints=joints))
    assert drawn.status_code == 200
    assert drawn.text.count('class="gap ') == 1
    assert "It cannot be assembled: at " in drawn.text
    refused = own.post(f"{MACHINES}/drawing.svg", json=changed(gravity="fast"))
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:jointplay:problem:machine")
    assert own.post(f"{MACHINES}/drawing.svg", content=TEXT).status_code == 415


def test_machines_move(own: httpx.Client) -> None:
    still = own.get(f"{MACHINES}/slider-crank/motion").json()
    assert still["pins"] == []
    assert len(still["transforms"]["link-rod"]) == 72
    (pin,) = own.get(f"{MACHINES}/slider-crank/motion", params={"fault": "A=0.2mm"}).json()["pins"]
    assert (pin["joint"], pin["clearance_um"], len(pin["at"])) == ("A", pytest.approx(200), 360)
    refused = own.get(f"{MACHINES}/slider-crank/motion", params={"fault": "Z=0.2mm"})
    assert (refused.status_code, "no such joint" in refused.json()["detail"]) == (422, True)


def test_a_machine_stored_before_another_of_its_name_was_shipped_stays(tmp_path: Path) -> None:
    kept = parse_machine(changed(gravity=1.0))
    (tmp_path / "toggle-press.json").write_text(kept.canonical_json())
    assert MachineStore(tmp_path).find("toggle-press") == kept
    assert MachineStore(tmp_path).find("v-twin") == shipped_machine("v-twin")


def test_conditions(own: httpx.Client) -> None:
    place = f"{MACHINES}/press-2"
    first = own.put(place, json=changed(), headers={"If-None-Match": "*"})
    assert first.status_code == 201
    refused = own.put(place, json=changed(gravity=0), headers={"If-None-Match": "*"})
    assert (refused.status_code, refused.json()["type"]) == (412, "urn:jointplay:problem:precondition")
    second = own.put(place, json=changed(gravity=0), headers={"If-Match": first.headers["etag"]})
    assert second.status_code == 200
    assert own.put(place, json=changed(), headers={"If-Match": first.headers["etag"]}).status_code == 412
    assert own.get(place).json()["gravity"] == 0
    assert own.put(f"{MACHINES}/press-3", json=changed(), headers={"If-Match": "*"}).status_code == 412
    assert own.get(f"{MACHINES}/press-3").status_code == 404


@pytest.mark.parametrize(
    ("conditions", "key", "hold"),
    [
        (Conditions(), None, True),
        (Conditions(match=('"a"', '"b"')), "b", True),
        (Conditions(match=('W/"b"',)), "b", False),  # a weak tag matches nothing strongly
        (Conditions(match=("*",)), None, False),
        (Conditions(none_match=('W/"b"',)), "b", False),
        (Conditions(none_match=('"a"',)), "b", True),
        (Conditions(none_match=("*",)), None, True),
    ],
)
def test_what_conditions_mean(conditions: Conditions, key: str | None, hold: bool) -> None:
    assert conditions.hold(key) is hold


@pytest.mark.parametrize(
    ("name", "body", "kind", "status", "text"),
    [
        ("four-bar", TEXT, "application/yaml", 409, "machine: four-bar: ships with the program"),
        ("UPPER", TEXT, "application/yaml", 422, "name: UPPER: must be"),
        ("a.b", TEXT, "application/yaml", 422, "name: a.b: must be"),
        ("p", TEXT, "text/plain", 415, "Content-Type: text/plain"),
        ("p", TEXT, "application/json", 400, "not JSON"),
        ("p", b"\xff\xfe", "application/yaml", 400, "UTF-8"),
        ("p", "[]", "application/json", 422, "p: "),
        ("p", TEXT.replace("kind: turning", "kind: turnng", 1), "application/yaml", 422, "turnng"),
        ("p", TEXT + "\nunknown: 1\n", "application/yaml", 422, "p: unknown: "),
        ("p", json.dumps(changed())[:-1] + ', "gravity": 1}', "application/json", 422, "gravity"),
    ],
)
def test_what_is_refused(own: httpx.Client, name: str, body: str | bytes, kind: str, status: int, text: str) -> None:
    answer = own.put(f"{MACHINES}/{name}", content=body, headers={"Content-Type": kind})
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert text in problem["detail"] and "\n" not in problem["detail"]
    assert own.get(f"{MACHINES}/p").status_code == 404


def test_a_refusal_names_the_place_in_the_file(own: httpx.Client) -> None:
    tree = changed()
    tree["joints"]["B"]["contact"]["stiffness"] = -5
    problem = own.put(f"{MACHINES}/p", json=tree).json()
    assert problem["errors"][0]["field"] == "joints.B.contact.stiffness"
    assert problem["detail"].startswith("p: joints.B.contact.stiffness: -5")


def test_a_machine_that_cannot_be_assembled_is_refused(own: httpx.Client) -> None:
    tree = changed()
    tree["drive"] = {"kind": "rotation", "joint": "B", "speed": 10.0}
    answer = own.put(f"{MACHINES}/p", json=tree)
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:jointplay:problem:assembly"), answer.text


def test_of_many_first_writers_one_wins(tmp_path: Path) -> None:
    contents = [parse_machine(changed(gravity=float(number))).canonical_json() for number in range(8)]

    def first(content: str) -> bool:
        from jointplay.app.errors import PreconditionError

        try:
            return MachineStore(tmp_path).put("press", content, Conditions(none_match=("*",)))[1]
        except PreconditionError:
            return False

    with ThreadPoolExecutor(8) as pool:
        won = list(pool.map(first, contents))
    assert sum(won) == 1
    assert MachineStore(tmp_path).find("press") == parse_machine(contents[won.index(True)])
    assert sorted(file.name for file in tmp_path.iterdir()) == [".lock", "press.json", "versions"]
    assert MachineStore(tmp_path).versions("press") == [1]


@pytest.mark.parametrize(
    ("links", "joints", "rule"),
    [(65, 1, "links: 65: must be at most 64"), (2, 129, "joints: 129: must be at most 128")],
)
def test_a_machine_of_more_links_or_joints_than_are_taken_is_refused_before_it_is_looked_at(
    links: int, joints: int, rule: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def looked_at(*_given: object) -> None:
        pytest.fail("it was looked at")

    monkeypatch.setattr(tasks, "sizes_of", looked_at)
    file: dict[str, Any] = {
        "name": "row",
        "links": {f"l{k}": {"mass": "1 kg", "inertia": 0.01, "cg": [0.1 * k, 0.1]} for k in range(1, links)},
        "joints": {f"J{k}": {"kind": "turning", "links": ["l1", "base"], "at": [0.1 * k, 0]} for k in range(joints)},
        "drive": {"kind": "rotation", "joint": "J0", "speed": "120 rpm"},
    }
    for k in range(2, links):
        file["joints"] = {**file["joints"], f"K{k}": {"kind": "turning", "links": [f"l{k}", f"l{k - 1}"], "at": [0, k]}}
    file["links"]["base"] = {"fixed": True}
    with pytest.raises(MachineError, match=f"m: {rule} in a machine sent to a service"):
        tasks.check_machine(json.dumps(file), "m")
    assert rule in str(tasks.look_at_machine(json.dumps(file), "m").refusal)
