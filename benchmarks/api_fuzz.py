"""Schemathesis against a running service: ``python -m benchmarks.api_fuzz CATALOGUES [--examples 50]``.

It starts a server of its own over a directory of catalogues and sends what the OpenAPI document allows, what it
forbids, and chains of both along the document's links, over every operation. Builds are ordered and cancelled, but not
carried out. Before that a recording, a diagnosis, a build, an asset, a finding and a webhook are made, and the examples
of the document, whose ids are invented, are given the ids of these, so that every operation can succeed.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pyuff

from benchmarks.entry_load import serving
from jointplay.app.http import examples
from jointplay.app.routes.machines import MACHINE_FILE

CONFIGURATION = Path(__file__).parent.parent / "schemathesis.toml"
RECORDINGS = Path(__file__).parent.parent / "tests" / "data" / "recordings"
PHASES = "examples,coverage,fuzzing,stateful"
COLOURS = re.compile(r"\x1b\[[0-9;]*m")
API = "/api/v1"
SPARE = "zz-spare"
"""Name of a catalogue that may be deleted; it is the last in a list."""
#: Samples of the recording that is sent as an example: enough to be one, few enough to be sent often.
SAMPLES, RATE_HZ = 300, 2000.0


@dataclass(frozen=True)
class Found:
    """What a run of Schemathesis says.

    Parameters
    ----------
    calls, operations, tested : int
        Requests sent; operations of the document, and those that were reached.
    failures : int
        Answers that broke a check.
    exit_status : int
    output : str
    succeeded : Counter
        Method and path of every operation that had a request answered with 2xx, and how often.
    links : int
        Links that chains of requests went along.
    """

    calls: int
    operations: int
    tested: int
    failures: int
    exit_status: int
    output: str
    succeeded: Counter[str] = field(default_factory=Counter)
    links: int = 0

    @property
    def whole(self) -> bool:
        """Whether every operation was reached and succeeded, and nothing failed."""
        reached = 0 < self.operations == self.tested == len(self.succeeded)
        return self.exit_status == 0 and not self.failures and reached

    @property
    def line(self) -> str:
        """The figures in one line."""
        return (
            f"{self.calls} calls, {self.tested} of {self.operations} operations, {len(self.succeeded)} with success"
            f" ({self.succeeded.total()} calls), {self.links} links, {self.failures} failures"
        )


def seeded(address: str, folder: Path) -> Path:
    """Make one of everything in a service; return its OpenAPI document as a file, with the ids of these as examples."""
    # The server names its address a moment before it takes connections.
    with httpx.Client(base_url=address, timeout=120, transport=httpx.HTTPTransport(retries=8)) as client:

        def made(method: str, place: str, **sent: Any) -> str:
            answer = client.request(method, f"{API}{place}", **sent)
            if answer.is_error:
                raise SystemExit(f"{method} {place}: {answer.text}")
            return str(answer.json().get("id", ""))

        catalogue = client.get(f"{API}/catalogues").json()["items"][0]
        packed = sorted(RECORDINGS.glob(f"{catalogue['machine']}-*.csv.gz"))[0]
        recording = gzip.decompress(packed.read_bytes()).decode()
        entry = client.get(f"{API}/catalogues/{catalogue['name']}/entries", params={"limit": 1}).json()["items"][0]
        asset, event = "press-7", ["finding.created"]
        body = {"catalogue": catalogue["name"], "effort": "fast", "asset": asset}
        made("PUT", f"/assets/{asset}", json={"machine": catalogue["machine"]})
        measurement = made("POST", "/measurements", files={"file": ("r.csv", recording)})
        diagnosis = made("POST", "/diagnoses", json={**body, "measurement": measurement})
        said = {"text": "bush worn", "at": "2026-03-01T08:00:00Z"}
        hook = made("POST", "/webhooks", json={"url": "https://hooks.example/", "events": event})
        real = {
            examples.MEASUREMENT: measurement,
            examples.DIAGNOSIS: diagnosis,
            examples.FINDING: made("POST", f"/diagnoses/{diagnosis}/finding", json=said),
            examples.BUILD: made("POST", "/builds", json={"machine": catalogue["machine"], "catalogue": "new"}),
            examples.WEBHOOK: hook,
            examples.DELIVERY: made("POST", f"/webhooks/{hook}/test"),
            examples.KEY: made("POST", "/keys", json={"name": "fuzz", "scopes": ["read"]}),
            examples.ENTRY: str(entry["key"])[:12],
            "slider-crank": catalogue["name"],
        }
        # What is on hold nobody deletes, nor the catalogue it was diagnosed with: all else goes on meeting them.
        made("PUT", f"/measurements/{measurement}/retention", json={"hold": "of this run"})
        spared = made("POST", "/measurements", files={"file": ("spare.csv", recording)})
        answered = made("POST", "/diagnoses", json={**body, "measurement": spared, "asset": None})
        finding = made("POST", f"/diagnoses/{answered}/finding", json=said)
        dropped = made("POST", "/measurements", files={"file": ("dropped.csv", recording)})
        build = made("POST", "/builds", json={"machine": catalogue["machine"], "catalogue": "newer"})
        made("POST", f"/builds/{build}/cancel")
        made("PUT", "/assets/spare", json={"machine": catalogue["machine"]})
        made("PUT", f"/machines/{examples.PUT_NAME}", json=MACHINE_FILE)
        unfound = made("POST", "/diagnoses", json={**body, "measurement": dropped, "asset": None})
        #: What may be deleted.
        spare = {
            examples.MEASUREMENT: dropped,
            examples.DIAGNOSIS: unfound,
            examples.FINDING: finding,
            examples.BUILD: build,
            examples.WEBHOOK: made("POST", "/webhooks", json={"url": "https://hooks.example/", "events": event}),
            examples.KEY: made("POST", "/keys", json={"name": "spare", "scopes": ["read"]}),
            asset: "spare",
            "slider-crank": SPARE,
        }
        document = client.get("/openapi.json").json()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            known = {**real, **spare} if takes_away(method, path) else real
            for parameter in operation.get("parameters", ()):
                if isinstance(given := parameter.get("example"), str):
                    parameter["example"] = known.get(given, given)
            for media in operation.get("requestBody", {}).get("content", {}).values():
                if isinstance(given := media.get("example"), dict):
                    media["example"] = {name: swapped(value, real) for name, value in given.items()}
    forms = document["paths"][f"{API}/measurements"]["post"]["requestBody"]["content"]
    forms["multipart/form-data"]["example"] = {"file": universal_file(folder / "r.uff")}
    file = folder / "openapi.json"
    file.write_text(json.dumps(document), encoding="utf-8")
    return file


def takes_away(method: str, path: str) -> bool:
    """Return whether an operation deletes something for good, or lets it be deleted."""
    deletes = method == "delete" and not path.endswith(("/acknowledgement", "/machines/{name}"))
    return deletes or (method == "put" and path.endswith("/retention")) or path.endswith("/keys/{key}/revoke")


def copied(catalogues: Path, folder: Path) -> Path:
    """Return a copy of a folder of catalogues, with a spare one besides: the fuzz deletes what it can."""
    shelf = folder / "shelf"
    shutil.copytree(catalogues, shelf)
    first = next(path.parent for path in sorted(shelf.glob("*/manifest.json")))
    shutil.copytree(first, shelf / SPARE)
    return shelf


def universal_file(path: Path) -> str:
    """Return a small recording that says of itself what it is: Schemathesis gives files no name."""
    record = {
        "type": 58,
        "binary": 0,
        "func_type": 1,
        "id1": "s1-x",
        "rsp_node": 1,
        "rsp_dir": 1,
        "ref_node": 1,
        "ref_dir": 1,
        "data": np.sin(np.arange(SAMPLES) / 3.0),
        "x": np.arange(SAMPLES) / RATE_HZ,
        "abscissa_inc": 1.0 / RATE_HZ,
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 12,
        "ordinate_axis_units_lab": "m/s2",
        "orddenom_spec_data_type": 0,
        "z_axis_spec_data_type": 0,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # the library leaves a file open when it writes
        pyuff.UFF(str(path)).write_sets(record, "overwrite")
    return path.read_text(encoding="ascii")


def swapped(value: Any, real: dict[str, str]) -> Any:
    """Return the real id in the place of an invented one, anything else as it is."""
    return real.get(value, value) if isinstance(value, str) else value


def run(address: str, examples: int, seed: int = 1, phases: str = PHASES, more: Sequence[str] = ()) -> Found:
    """Run Schemathesis against a service.

    Parameters
    ----------
    address : str
    examples : int
        Most requests for one operation in a phase of random ones.
    seed : int
    phases : str
        Names with commas between.
    more : sequence of str
        Further options.
    """
    program = Path(sys.executable).parent / "schemathesis"
    with tempfile.TemporaryDirectory() as folder:
        document, report = seeded(address, Path(folder)), Path(folder, "report.ndjson")
        command = [str(program), "--config-file", str(CONFIGURATION), "run", str(document), "--url", address]
        command += ["--mode", "all", "--report", "ndjson", "--report-ndjson-path", str(report)]
        command += ["--phases", phases, "--max-examples", str(examples), "--seed", str(seed), *more]
        command += ["--suppress-health-check", "all", "--request-timeout", "60", "--generation-database", "none"]
        ended = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"})
        succeeded = successes(report)
    output = COLOURS.sub("", ended.stdout + ended.stderr)

    def number(pattern: str) -> int:
        match = re.search(pattern, output)
        return int(match[1].replace(",", "")) if match else 0

    return Found(
        calls=number(r"([\d,]+) generated"),
        operations=number(r"Selected: (\d+)/"),
        tested=number(r"Tested: (\d+)"),
        failures=number(r"(\d+) unique failure") or number(r"found (\d+)"),
        exit_status=ended.returncode,
        output=output,
        succeeded=succeeded,
        links=number(r"API Links:\s+(\d+) covered"),
    )


def successes(report: Path) -> Counter[str]:
    """Return from a report which operations had a request answered with 2xx, and how often."""
    found: Counter[str] = Counter()
    if not report.exists():
        return found
    for line in report.read_text(encoding="utf-8").splitlines():
        recorder = json.loads(line).get("ScenarioFinished", {}).get("recorder", {})
        for key, exchange in recorder.get("interactions", {}).items():
            case = recorder["cases"][key]["value"]
            if 200 <= ((exchange.get("response") or {}).get("status_code") or 0) < 300:
                found[f"{case['method'].upper()} {case['path']}"] += 1
    return found


def main() -> None:
    """Print the report and a last line of figures; exit with 1 when anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("catalogues", type=Path)
    parser.add_argument("--examples", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        shelf = copied(given.catalogues, Path(folder))
        with serving(shelf, Path(folder) / "data") as (address, _, _):
            found = run(address, given.examples, given.seed)
    print(found.output)
    print(found.line)
    raise SystemExit(0 if found.whole else 1)


if __name__ == "__main__":
    main()
