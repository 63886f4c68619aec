"""What Prometheus and Grafana ask by the files of docker/ is answered: every metric, label, address and field."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import httpx
import numpy as np
import pytest
from http_answers import API, assert_problem
from prometheus_client.parser import text_string_to_metric_families
from recordings import RECORDINGS
from ruamel.yaml import YAML
from small_service import running

from jointplay.app.errors import BadFieldError
from jointplay.app.jobs.signals import MOST_ROWS, as_rows
from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.signals.signal_question import SignalQuestion

FOLDER = Path(__file__).parents[2] / "docker"
ASSET = "crank-on-the-wall"

# PromQL, as far as names and labels go.
TEXT = re.compile(r'"(?:[^"\\]|\\.)*"')
SELECTOR = re.compile(r"([a-zA-Z_:][\w:]*)?\s*\{([^}]*)\}")
GROUPED = re.compile(r"\b(by|without|on|ignoring|group_left|group_right)\s*\(([^)]*)\)")
WORDS = frozenset({"and", "or", "unless", "bool", "offset", "group_left", "group_right", "Inf", "NaN"})
NAME = re.compile(r"(?<![\w.:$])([a-zA-Z_:][\w:]*)(?!\w)(?!\s*\()")
DURATION = re.compile(r"\[[^\]]*\]")
#: What Prometheus knows of everything it collects.
ADDED = {"up": set[str]()}
COLLECTED = frozenset({"instance", "job"})


def asked(expression: str) -> tuple[set[str], set[str], dict[str, set[str]]]:
    """Names of metrics in an expression; labels that it groups by; labels that each metric is chosen by."""
    bare = DURATION.sub("", expression)
    chosen: dict[str, set[str]] = {}
    for name, inside in SELECTOR.findall(TEXT.sub('""', bare)):
        chosen.setdefault(name, set()).update(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", inside))
    bare = SELECTOR.sub(lambda found: found[1] or "", TEXT.sub("", bare))
    grouped = {label.strip() for _, inside in GROUPED.findall(bare) for label in inside.split(",") if label.strip()}
    names = set(NAME.findall(GROUPED.sub(" ", bare))) - WORDS
    return names, grouped, chosen


@pytest.mark.parametrize(
    ("expression", "names", "grouped", "chosen"),
    [
        ('up{job="x"} == 0', {"up"}, set(), {"up": {"job"}}),
        ("a_b / on (c) group_left d:e > 1e3", {"a_b", "d:e"}, {"c"}, {}),
        (
            'histogram_quantile(0.9, sum by (route, le) (rate(a_bucket{status=~"5..",x!="{}"}[5m])))',
            {"a_bucket"},
            {"route", "le"},
            {"a_bucket": {"status", "x"}},
        ),
        ("sum without (le) (increase(a[$__rate_interval])) or b", {"a", "b"}, {"le"}, {}),
        ("process_start_time_seconds * 1000", {"process_start_time_seconds"}, set(), {}),
    ],
)
def test_names_of_expressions(expression: str, names: set[str], grouped: set[str], chosen: dict[str, set[str]]) -> None:
    assert asked(expression) == (names, grouped, chosen)


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Labels of every sample that a service has once everything has happened that it counts."""
    folder = tmp_path_factory.mktemp("counted")
    application = create_app(ServiceSettings(catalogues=folder, data=folder / "data", builds=0, workers=1, keys="off"))
    with running(application) as address:
        metrics = application.state.service.metrics
        metrics.count_refusal("too-large")
        metrics.count_delivery("given_up")
        metrics.count_wait("diagnose", 1.0)
        metrics.count_work("diagnose", "ok", 1.0)
        metrics.count_diagnosis(SimpleNamespace(effort="fast", mode=SimpleNamespace(used="robust"), verdict="worn"))
        httpx.get(f"{address}/healthz", timeout=300)
        text = httpx.get(f"{address}/metrics", timeout=300).text
    found: dict[str, set[str]] = dict(ADDED)
    for family in text_string_to_metric_families(text):
        found.setdefault(family.name, set())  # of a gauge without values yet, such as entries of no catalogue
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    found["jointplay_catalogue_entries"].add("catalogue")
    return found


def rules() -> list[dict[str, Any]]:
    """All rules of Prometheus."""
    document = YAML(typ="safe").load((FOLDER / "prometheus" / "rules.yml").read_text(encoding="utf-8"))
    return [rule for group in document["groups"] for rule in group["rules"]]


def dashboard(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / "grafana" / "dashboards" / f"{name}.json").read_text(encoding="utf-8"))
    return found


def questions() -> Iterator[tuple[str, str, str]]:
    """Who asks for what, and in which words it is shown."""
    for rule in rules():
        yield rule["alert"], rule["expr"], " ".join(rule["annotations"].values())
    for panel in dashboard("service")["panels"]:
        for target in panel["targets"]:
            yield panel["title"], target["expr"], target["legendFormat"]


@pytest.mark.parametrize(("who", "expression", "words"), list(questions()), ids=lambda each: each[:40])
def test_what_prometheus_is_asked_is_counted(
    who: str, expression: str, words: str, counted: dict[str, set[str]]
) -> None:
    names, grouped, chosen = asked(expression)
    assert names, who
    assert names <= set(counted), f"{who}: nothing is called {names - set(counted)}"
    for name, labels in chosen.items():
        assert labels <= counted[name] | COLLECTED, f"{who}: {name} has no {labels - counted[name]}"
    known = set[str]().union(*(counted[name] for name in names)) | COLLECTED
    assert grouped <= known, f"{who}: groups by {grouped - known}"
    left = grouped or known
    shown = set(re.findall(r"\$labels\.(\w+)|\{\{(\w+)\}\}", words))
    assert {one or other for one, other in shown} <= left, f"{who}: shows {shown}, of which there is {left}"


def test_rules_are_named_once_and_say_what_to_do() -> None:
    names = [rule["alert"] for rule in rules()]
    assert len(set(names)) == len(names) >= 12
    for rule in rules():
        assert rule["labels"]["severity"] in ("page", "ticket"), rule["alert"]
        assert {"summary", "action"} == set(rule["annotations"]), rule["alert"]


def test_prometheus_itself_takes_them(tmp_path: Path) -> None:
    """Where its package is installed; names and labels are judged above in any case."""
    promtool = shutil.which("promtool")
    if promtool is None:
        say = pytest.fail if os.environ.get("JOINTPLAY_REQUIRE_PROMTOOL") else pytest.skip
        say("promtool is not installed")
    shown = [{"record": f"q{number}", "expr": each.replace("$__rate_interval", "5m")}
             for number, (_, each, _) in enumerate(questions())]  # fmt: skip
    panels = tmp_path / "panels.yml"
    panels.write_text(json.dumps({"groups": [{"name": "panels", "rules": shown}]}), encoding="utf-8")
    for file in (FOLDER / "prometheus" / "rules.yml", panels):
        done = subprocess.run([promtool, "check", "rules", str(file)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def machine(client: httpx.Client) -> dict[str, str]:
    """Values of the variables of the dashboard: an asset with two diagnosed recordings."""
    client.put(f"{API}/assets/{ASSET}", json={"machine": "slider-crank", "notes": "hall 2"}).raise_for_status()
    for number in (2, 5):
        name = f"slider-crank-{number:02}.csv.gz"
        files = {"file": (name, (RECORDINGS / name).read_bytes())}
        said = {"catalogue": "slider-crank", "asset": ASSET, "effort": "fast"}
        answer = client.post(f"{API}/diagnoses", files=files, data=said)
        assert answer.status_code == 201, answer.text
    deadline = time.monotonic() + 300
    while not client.get(f"{API}/assets/{ASSET}").json()["standing"]["up_to_date"]:
        assert time.monotonic() < deadline, "the asset was not judged"
        time.sleep(0.1)
    return {"asset": ASSET, "measurement": answer.json()["measurement"]}


def told(client: httpx.Client, query: dict[str, Any], values: dict[str, str]) -> list[dict[str, Any]]:
    """The rows that a query of Infinity reads."""
    url = re.sub(r"\$\{(\w+)\}", lambda found: quote(values[found[1]], safe=""), query["url"])
    assert "$" not in url, url
    answer = client.get(url)
    assert answer.status_code == 200, f"{url}: {answer.text[:300]}"
    document = answer.json()
    rows: list[dict[str, Any]] = document[query["root_selector"]] if query["root_selector"] else document
    assert rows and isinstance(rows, list), url
    return rows


def field(row: dict[str, Any], selector: str) -> Any:
    """What a column of Infinity selects of a row; it has to be there, if only as null."""
    for name in selector.split("."):
        assert name in row, f"{selector}: only {', '.join(row)}"
        row = row[name]
    return row


def check(value: Any, kind: str) -> bool:
    """Whether a value is of the kind that its column says; null is of any."""
    if value is None:
        return True
    if kind == "timestamp":
        return datetime.fromisoformat(value).tzinfo is not None
    if kind == "number":
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, str) or (isinstance(value, list) and all(isinstance(each, str) for each in value))


def test_what_the_dashboard_of_machines_reads_is_answered(client: httpx.Client, machine: dict[str, str]) -> None:
    document = dashboard("machines")
    variables = {each["name"]: each for each in document["templating"]["list"]}
    assert set(variables) == {*machine, "unit"}
    values = dict(machine)
    for unit in variables["unit"]["query"].split(","):
        values["unit"] = unit
        for panel in document["panels"]:
            for target in panel["targets"]:
                if unit != variables["unit"]["current"]["value"] and "${unit}" not in target["url"]:
                    continue
                rows = told(client, target, values)
                for column in target["columns"]:
                    found = [field(row, column["selector"]) for row in rows]
                    assert all(check(each, column["type"]) for each in found), (panel["title"], column, found[0])
                    assert any(each is not None for each in found), (panel["title"], column)
    for name in machine:
        query = variables[name]["query"]["infinityQuery"]
        selectors = {column["text"]: column["selector"] for column in query["columns"]}
        assert set(selectors) == {"__text", "__value"}
        offered = [field(row, selectors["__value"]) for row in told(client, query, values)]
        assert machine[name] in offered


def test_titles_and_sources_are_of_what_there_is() -> None:
    sources = YAML(typ="safe").load(
        (FOLDER / "grafana" / "provisioning" / "datasources" / "jointplay.yaml").read_text(encoding="utf-8")
    )["datasources"]
    known = {each["uid"]: each["type"] for each in sources}
    for name in ("machines", "service"):
        document = dashboard(name)
        numbers = [panel["id"] for panel in document["panels"]]
        assert len(set(numbers)) == len(numbers)
        places = [target["datasource"] for panel in document["panels"] for target in panel["targets"]]
        assert all(known[each["uid"]] == each["type"] for each in places)
        variables = {each["name"] for each in document["templating"]["list"]}
        assert set(re.findall(r"\$\{(\w+)[:}]", json.dumps(document))) - {"__field"} <= variables
        for panel in document["panels"]:
            assert panel["gridPos"]["x"] + panel["gridPos"]["w"] <= 24


def test_rows_of_a_trend_are_the_courses_of_the_state(client: httpx.Client, machine: dict[str, str]) -> None:
    answer = client.get(f"{API}/assets/{ASSET}/series")
    rows = answer.json()
    joints = client.get(f"{API}/assets/{ASSET}/state").json()["joints"]
    assert len(rows) == sum(len(joint["course"]) for joint in joints.values()) == 2 * len(joints)
    for row in rows:
        (point,) = [each for each in joints[row["joint"]]["course"] if each["at"] == row["at"]]
        assert [row["low_um"], row["high_um"]] == point["interval_um"]
        assert (row["clearance_um"], row["p_worn"]) == (point["clearance_um"], point["p_worn"])
        assert row["limit_um"] == joints[row["joint"]]["limit_um"]
    assert (
        client.get(f"{API}/assets/{ASSET}/series", headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    )
    assert_problem(client.get(f"{API}/assets/nowhere/series"), 404, slug="unknown-asset")


@pytest.mark.parametrize("view", ["spectrum", "waveform", "revolution"])
def test_rows_of_a_recording_are_its_lines(client: httpx.Client, machine: dict[str, str], view: str) -> None:
    place = f"{API}/measurements/{machine['measurement']}"
    asked_for = {"view": view, "points": 50, "speed": "600 rpm", "unit": "mm/s"}
    whole, rows = (client.get(f"{place}/{end}", params=asked_for).json() for end in ("signal", "series"))
    expected = [
        {"at": at, "name": line["name"], "kind": line["kind"], "unit": line["unit"], "value": value}
        for line in whole["lines"]
        for at, value in zip(whole["at"], line["values"], strict=True)
    ]
    assert rows == expected and len(rows) >= 50


@pytest.mark.parametrize("view", ["overall", "spectrogram"])
def test_what_is_not_made_of_lines_has_no_rows(client: httpx.Client, machine: dict[str, str], view: str) -> None:
    refused = client.get(f"{API}/measurements/{machine['measurement']}/series", params={"view": view})
    assert_problem(refused, 422, f"view: {view}: is not made of lines", "invalid-field")


def test_rows_are_bounded() -> None:
    places = np.arange(MOST_ROWS // 2 + 1.0)
    line = SimpleNamespace(name="a", kind="value", unit="g", values=places)
    shown: Any = SimpleNamespace(at=places, lines=[line, line], overall=(), rows=None)
    with pytest.raises(BadFieldError, match="more than 100000 rows"):
        as_rows(shown, SignalQuestion("waveform"))
