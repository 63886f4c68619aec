"""Kill -9 any part of an installation while clients write to it; what it acknowledged must be there, and once.

``python -m benchmarks.mixed_kills --kills 200 --writes 500``: a server with two workers and a builder, a PostgreSQL of
its own (a file of SQLite where none is installed), a Dask scheduler with two workers. Clients store recordings, put
assets, ask for diagnoses and for builds; what is not acknowledged they send again with the same Idempotency-Key.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import itertools
import json
import os
import random
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil

from benchmarks.kills import Process, Site, end, free_port
from benchmarks.watching import recording
from jointplay.catalogue.building.build import build
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine

API = "/api/v1"
JOINTPLAY = (sys.executable, "-m", "jointplay.app.cli")
RECORDING = Path(__file__).parents[1] / "tests" / "data" / "recordings" / "slider-crank-02.csv.gz"
PLAN = {
    "name": "kills",
    "clearance": {"low": "30 um", "high": "0.8 mm"},
    "draws": {"healthy": 36, "single": 36},
    "laws": {"own": 1},
    "seconds": 1.0,
}
KINDS = ("server", "worker", "builder", "database", "dask scheduler", "dask worker")
BROKEN = {409, 425, 429, 500, 502, 503, 504}
"""Statuses after which the same request is sent again: 409 while the first one holds its Idempotency-Key."""
PATIENCE_S = 600.0
"""For one write, whose servers may be killed again and again."""


class Postgres:
    """A PostgreSQL of its own in a folder."""

    def __init__(self, folder: Path) -> None:
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
        self.programs = found[-1].parent if found else None
        self._data, self._port = folder / "postgres", free_port()
        self._user: dict[str, Any] = {"user": "postgres", "group": "postgres"} if os.geteuid() == 0 else {}
        self.process: Process | None = None
        self.url = f"postgresql://postgres@127.0.0.1:{self._port}/postgres" if found else ""
        if self.programs:
            self._data.mkdir()
            if self._user:
                shutil.chown(self._data, **self._user)
            made = [str(self.programs / "initdb"), "-D", str(self._data), "-U", "postgres", "-A", "trust"]
            subprocess.run(made, check=True, stdout=subprocess.DEVNULL, cwd="/", **self._user)
            self.start()

    def start(self) -> None:
        """Start, as soon as all of the one before have ended."""
        assert self.programs is not None
        options = [
            "-D",
            str(self._data),
            "-p",
            str(self._port),
            "-k",
            str(self._data),
            "-c",
            "listen_addresses=127.0.0.1",
        ]
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:  # the memory that those of before share is in the way until all have ended
            self.process = subprocess.Popen(
                [str(self.programs / "postgres"), *options],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True, cwd="/", **self._user,
            )  # fmt: skip
            while self.process.poll() is None:
                if self._answers():
                    return
                time.sleep(0.2)
        raise RuntimeError("PostgreSQL does not start")

    def _answers(self) -> bool:
        assert self.programs is not None
        asked = [str(self.programs / "pg_isready"), "-q", "-h", "127.0.0.1", "-p", str(self._port)]
        return subprocess.run(asked, check=False).returncode == 0

    def kill(self) -> None:
        """Kill the process of all others, which then end; and start again."""
        if self.process is not None:
            end(self.process)
            self.start()

    def close(self) -> None:
        """End."""
        if self.process is not None:
            end(self.process)


class Installation:
    """A whole installation; its processes end with the block."""

    def __init__(self, folder: Path, port: int) -> None:
        self._folder, self._port = folder, port
        self.address = f"http://127.0.0.1:{port}"
        self.postgres = Postgres(folder)
        self.site = Site(folder / "site", dask=True)
        self.server: Process | None = None
        self.log = (folder / "log").open("a")

    def __enter__(self) -> Installation:
        self.site.__enter__()
        self.start_server()
        return self

    def __exit__(self, *ending: object) -> None:
        if self.server is not None:
            end(self.server)
        self.site.__exit__(*ending)
        self.postgres.close()
        self.log.close()

    def environment(self) -> dict[str, str]:
        """Settings of the server, and of commands on what it keeps."""
        known = {"DATABASE": self.postgres.url, "SCHEDULER": self.site.address, "BUILD_LEASE_S": "2"}
        return {**os.environ, **{f"JOINTPLAY_{name}": value for name, value in known.items() if value}}

    def folders(self) -> list[str]:
        """Options of the server, and of commands on what it keeps."""
        return ["--catalogues", str(self._folder / "catalogues"), "--data", str(self._folder / "data")]

    def start_server(self) -> None:
        """Start it, always at the same port."""
        command = [*JOINTPLAY, "serve", "--no-keys", "--port", str(self._port), *self.folders()]
        self.server = subprocess.Popen(command, stderr=self.log, text=True, env=self.environment())

    def kill(self, kind: str, choice: random.Random) -> bool:
        """Kill one of a kind and start what whoever runs it would; return whether there was one."""
        if kind == "server":
            assert self.server is not None
            end(self.server)
            self.start_server()
        elif kind == "database":
            self.postgres.kill()
            return self.postgres.process is not None
        elif kind.startswith("dask"):
            self.site.kill(kind.removeprefix("dask "), choice)
        else:
            found = list(self.children(builder=kind == "builder"))
            if not found:
                return False
            with contextlib.suppress(ProcessLookupError):
                os.kill(choice.choice(found), signal.SIGKILL)
        return True

    def children(self, *, builder: bool) -> Iterator[int]:
        """Processes of the server: a builder is the one with a connection to the scheduler."""
        assert self.server is not None
        scheduler = int(self.site.address.rpartition(":")[2])
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in psutil.Process(self.server.pid).children():
                with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                    if "spawn_main" in " ".join(child.cmdline()):
                        ends = [each.raddr.port for each in child.net_connections("tcp") if each.raddr]
                        if (scheduler in ends) == builder:
                            yield child.pid


class Clients:
    """Write, again where it was not acknowledged, and remember what was.

    Parameters
    ----------
    address : str
    most : int
        How many requests there are at a time; those that wait for the first with their key to be given up are more.
    """

    def __init__(self, address: str, most: int) -> None:
        self._address, self._turns = address, threading.Semaphore(most)
        self._numbers, self._lock = itertools.count(), threading.Lock()
        self.stop = threading.Event()
        self.measurements: dict[str, str] = {}
        self.assets: dict[str, str] = {}
        self.diagnoses: dict[str, str] = {}
        self.builds: dict[str, str] = {}
        self.again: Counter[str] = Counter()
        self.wrong: list[str] = []

    @property
    def acknowledged(self) -> int:
        """Number of writes."""
        return sum(map(len, (self.measurements, self.assets, self.diagnoses, self.builds)))

    def ask(self, method: str, path: str, **sent: Any) -> dict[str, Any]:
        """Ask until it is acknowledged."""
        headers = {"Idempotency-Key": secrets.token_hex(16)} if method == "POST" else {}
        until = time.monotonic() + PATIENCE_S
        said = ""
        while time.monotonic() < until:
            pause = 0.3
            try:
                with self._turns, httpx.Client(base_url=self._address, timeout=180) as client:
                    answer = client.request(method, f"{API}{path}", headers=headers, **sent)
                if answer.status_code < 300:
                    found: dict[str, Any] = answer.json()
                    return found
                said = f"{answer.status_code} {answer.text[:300]}"
                if answer.status_code == 500 and "worker-died" not in said:
                    print(f"  {method} {path}: {said}", flush=True)
                if answer.status_code not in BROKEN:
                    break
                self.again[str(answer.status_code)] += 1
                pause = 5.0 if answer.status_code == 409 else pause
            except httpx.TransportError as error:
                said = type(error).__name__
                self.again[said] += 1
            time.sleep(pause)
        raise RuntimeError(f"{method} {path}: {said}")

    def write(self) -> None:
        """Write until told to stop."""
        with self.noting():
            while not self.stop.is_set():
                with self._lock:
                    number = next(self._numbers)
                if number % 4 == 1:
                    name, notes = f"asset-{number}", secrets.token_hex(8)
                    self.ask("PUT", f"/assets/{name}", json={"machine": "slider-crank", "notes": notes})
                    self.assets[name] = notes
                    continue
                content = RECORDING.read_bytes() if number % 4 == 3 else recording(number)
                told = {"asset": f"machine-{number}"} if number % 4 == 3 else {}
                if told:
                    self.ask("PUT", f"/assets/{told['asset']}", json={"machine": "slider-crank"})
                    self.assets[told["asset"]] = ""
                name = f"{number}.csv.gz" if told else f"{number}.csv"
                found = self.ask("POST", "/measurements", files={"file": (name, content)}, data=told)
                self.measurements[found["id"]] = hashlib.sha256(content).hexdigest()
                if told:
                    asked = {"measurement": found["id"], "catalogue": "undisturbed", "effort": "fast"}
                    self.diagnoses[self.ask("POST", "/diagnoses", json=asked)["id"]] = found["id"]

    def order(self) -> None:
        """Ask for one build after the other, each once more where it was given up."""
        with self.noting():
            for number in itertools.count():
                if self.stop.is_set():
                    return
                name, state = f"made-{number}", "worker_lost"
                while state == "worker_lost":
                    asked = {"machine": "slider-crank", "plan": PLAN, "catalogue": name, "workers": 1}
                    build_id = self.ask("POST", "/builds", json=asked)["id"]
                    while (state := self.ask("GET", f"/builds/{build_id}")["state"]) in ("queued", "running"):
                        time.sleep(0.5)
                    self.again["build"] += state == "worker_lost"
                    self.builds[build_id] = state

    @contextlib.contextmanager
    def noting(self) -> Iterator[None]:
        """Keep what went wrong in a thread."""
        try:
            yield
        except Exception as error:
            self.wrong.append(f"{type(error).__name__}: {error}")

    def listed(self, what: str) -> list[dict[str, Any]]:
        """All of a list."""
        found: list[dict[str, Any]] = []
        cursor = ""
        while True:
            page = self.ask("GET", f"/{what}?limit=200{cursor}")
            found += page["items"]
            if not page["next_cursor"]:
                return found
            cursor = f"&cursor={page['next_cursor']}"

    def missing(self, wanted: str) -> Iterator[str]:
        """What was acknowledged and is not there, or is another thing, or is there twice."""
        yield from self.wrong
        there = {each["id"]: each for each in self.listed("measurements")}
        for key, sha256 in self.measurements.items():
            if there.get(key, {}).get("sha256") != sha256:
                yield f"measurement {key}: lost"
        for file, count in Counter((each["sha256"], each["name"]) for each in there.values()).items():
            if count > 1:
                yield f"measurement {file}: {count} times"
        if unasked := there.keys() - self.measurements.keys():
            yield f"measurements that nobody got acknowledged: {unasked}"
        assets = {each["external_id"]: each["notes"] for each in self.listed("assets")}
        yield from (f"asset {name}: lost" for name, notes in self.assets.items() if assets.get(name) != notes)
        if len(assets) != len(self.assets):
            yield f"{len(assets)} assets, not {len(self.assets)}"
        diagnoses = {each["id"]: each["measurement"] for each in self.listed("diagnoses")}
        if diagnoses != self.diagnoses:
            yield f"diagnoses: {len(diagnoses)}, not the {len(self.diagnoses)} acknowledged ones"
        builds = {each["id"]: each for each in self.listed("builds")}
        if builds.keys() != self.builds.keys():
            yield f"builds: {len(builds)}, not the {len(self.builds)} acknowledged ones"
        for key, state in self.builds.items():
            row = builds.get(key, {})
            if row.get("state") != state or (state == "done" and row["catalogue_id"] != wanted):
                yield f"build {key}: {row.get('state')} {row.get('catalogue_id')} {row.get('message')}"
            if state not in ("done", "worker_lost"):
                yield f"build {key}: {state}: {row.get('message')}"


def disturb(installation: Installation, clients: Clients, options: argparse.Namespace) -> Counter[str]:
    """Kill, one after the other, until there were enough kills and enough was written; return whom."""
    choice, killed = random.Random(options.seed), Counter[str]()
    while killed.total() < options.kills or clients.acknowledged < options.writes:
        wanted = clients.acknowledged + choice.randrange(5)
        until = time.monotonic() + 60.0
        while clients.acknowledged < wanted and time.monotonic() < until and not clients.wrong:
            time.sleep(0.05)
        time.sleep(choice.uniform(0.0, options.pause))
        if clients.wrong:
            return killed
        if killed.total() < options.kills:
            kind = choice.choice(KINDS)
            if choice.random() < 0.3 and any(installation.children(builder=True)):
                kind = "builder"  # which is seldom there
            killed[kind] += installation.kill(kind, choice)
            if killed.total() % 10 == 0:
                print(f"  {killed.total()} kills, {clients.acknowledged} acknowledged writes", flush=True)
    return killed


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--writes", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pause", type=float, default=2.0, help="longest wait before a kill [s]")
    parser.add_argument("--clients", type=int, default=4)
    parser.add_argument("--port", type=int, default=free_port())
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o711)  # for the user of PostgreSQL
        build(shipped_machine("slider-crank"), parse_plan(PLAN), folder / "catalogues/undisturbed", workers=0)
        wanted = Catalogue.open(folder / "catalogues/undisturbed").id
        print(f"undisturbed: {wanted[:16]}", flush=True)
        with Installation(folder, options.port) as installation:
            began, clients = time.monotonic(), Clients(installation.address, options.clients)
            threads = [threading.Thread(target=clients.write, daemon=True) for _ in range(8 * options.clients)]
            threads.append(threading.Thread(target=clients.order, daemon=True))
            for thread in threads:
                thread.start()
            killed = disturb(installation, clients, options)
            clients.stop.set()
            for thread in threads:
                thread.join(2 * PATIENCE_S)
            wrong = list(clients.missing(wanted))
            command = [*JOINTPLAY, "verify", *installation.folders(), "--repeat", "20"]
            checked = subprocess.run(
                command, env=installation.environment(), capture_output=True, text=True, check=False
            )
            if checked.returncode:
                wrong.append(f"verify --data: {checked.stdout[-1000:]} {checked.stderr[-1000:]}")
            log = (folder / "log").read_text()
        counts = [f"{len(getattr(clients, what))} {what}" for what in ("measurements", "assets", "diagnoses", "builds")]
        kind = "PostgreSQL" if installation.postgres.url else "SQLite"
        print(
            f"{killed.total()} kills ({', '.join(f'{count} {each}' for each, count in sorted(killed.items()))}; {kind})"
            f" in {time.monotonic() - began:.0f} s: {clients.acknowledged} acknowledged writes ({', '.join(counts)}),"
            f" sent again {json.dumps(clients.again)}, {len(wrong)} wrong; tracebacks in the log:"
        )
        for ending, count in Counter(
            re.findall(r"^Traceback .*\n(?:[ ].*\n|\n)*(.{1,160})", log, re.MULTILINE)
        ).most_common(12):
            print(f"  {count} times {ending}")
        if wrong:
            sys.exit("\n".join(wrong[:50]))


if __name__ == "__main__":
    main()
