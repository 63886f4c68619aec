"""``python -m benchmarks.attacks --catalogues DIR``: what clients that mean no good, or do not mean it, do to others.

Each row starts a service of its own on this computer, attacks it for some seconds from this process, and prints what
others see meanwhile. ``--source FOLDER`` measures another checkout of the program (its folder ``src``), for figures of
before and after; ``--only`` some rows. Catalogues hold one of the slider-crank.
"""

from __future__ import annotations

import argparse
import asyncio
import gzip
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

PROBE_LIMIT_S = 20.0
RECORDING = Path(__file__).parents[1] / "tests" / "data" / "recordings" / "slider-crank-02.csv.gz"


@dataclass(frozen=True)
class Attacked:
    """A service under attack.

    Parameters
    ----------
    port : int
    pid : int
    log : Path
    """

    port: int
    pid: int
    log: Path

    @property
    def address(self) -> str:
        """Where it answers."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def processor_s(self) -> float:
        """Processor time of the server, without its workers [s]."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def service(options: argparse.Namespace, descriptors: int = 4096, **settings: str) -> Iterator[Attacked]:
    """Start a service, in processes of its own."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        serve = [sys.executable, "-m", "jointplay.app.cli", "serve", "--port", "0", "--no-keys"]
        serve += ["--catalogues", str(options.catalogues), "--data", folder]
        source = {"PYTHONPATH": str(options.source / "src")} if options.source else {}
        given = {f"JOINTPLAY_{name.upper()}": value for name, value in settings.items()}
        limited = ["sh", "-c", f'ulimit -n {descriptors}; exec "$0" "$@"', *serve]
        environment = {**os.environ, **source, **given, "JOINTPLAY_LOG_LEVEL": "debug"}
        with log.open("w") as file, subprocess.Popen(limited, stderr=file, env=environment) as process:
            try:
                workers = int(settings.get("workers", "2"))
                while log.read_text().count("task warm has ended") < workers:
                    if process.poll() is not None:
                        raise RuntimeError(log.read_text())
                    time.sleep(0.2)
                found = re.search(r"serving http://127\.0\.0\.1:(\d+)", log.read_text())
                assert found is not None
                yield Attacked(int(found[1]), process.pid, log)
            finally:
                process.kill()


def ask(attacked: Attacked, path: str) -> bool:
    """Ask for a page by a connection of its own; return whether it came."""
    request = f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()
    try:
        with socket.create_connection(("127.0.0.1", attacked.port), PROBE_LIMIT_S) as connection:
            connection.sendall(request)
            return connection.recv(65536).startswith(b"HTTP/1.1 200 ")
    except OSError:
        return False


async def watch(attacked: Attacked, seconds: float, path: str = "/healthz") -> list[float]:
    """Ask for a page again and again; return times of answers, or the limit [s].

    In a thread: who connects and then lets 500 others connect before it asks is one of them.
    """
    times = []
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        began = time.monotonic()
        came = await asyncio.to_thread(ask, attacked, path)
        times.append(time.monotonic() - began if came else PROBE_LIMIT_S)
        await asyncio.sleep(0.2)
    return times


def say(quiet: list[float], times: list[float]) -> dict[str, float]:
    """Return how long answers took, before and during an attack [s]."""
    half, most = float(np.median(times)), max(times)
    unanswered = sum(each >= PROBE_LIMIT_S for each in times)
    before = {"quiet_s": float(np.median(quiet)), "quiet_longest_s": max(quiet)}
    return {**before, "median_s": half, "longest_s": most, "unanswered": unanswered, "probes": len(times)}


async def hold(attacked: Attacked, sent: bytes, byte: bytes, seconds: float) -> bool:
    """Hold a connection open, sending a byte every 5 s where there is one; return whether it stands at the end."""
    until = time.monotonic() + seconds
    try:
        reader, writer = await asyncio.open_connection("127.0.0.1", attacked.port)
    except OSError:
        return False
    try:
        writer.write(sent)
        while (left := until - time.monotonic()) > 0:
            try:
                async with asyncio.timeout(min(5.0, left)):
                    if not await reader.read(65536):
                        return False
            except TimeoutError:
                writer.write(byte)
                await writer.drain()
        return True
    except OSError:
        return False
    finally:
        writer.close()


async def idle(options: argparse.Namespace) -> dict[str, Any]:
    """500 connections without a request, half of them dripping one, to a service of 300 descriptors."""
    with service(options, descriptors=300) as attacked:
        quiet = await watch(attacked, 5.0)
        size, spent = attacked.log.stat().st_size, attacked.processor_s
        attack = [asyncio.create_task(hold(attacked, b"G" * (k % 2), b"E" * (k % 2), 30.0)) for k in range(500)]
        times = await watch(attacked, 30.0)
        standing = sum(await asyncio.gather(*attack))
        grown = attacked.log.stat().st_size - size
        used = attacked.processor_s - spent
    return {**say(quiet, times), "standing": standing, "log_kb_a_minute": 2 * grown / 1000, "server_processor_s": used}


async def sign_in(options: argparse.Namespace) -> dict[str, Any]:
    """Four clients that send forms of 990 kB to be signed in."""
    with service(options) as attacked:

        async def send() -> int:
            count = 0
            async with httpx.AsyncClient(timeout=60) as client:
                while time.monotonic() < until:
                    head = {"Content-Type": "application/x-www-form-urlencoded"}
                    with suppress(httpx.HTTPError):
                        await client.post(f"{attacked.address}/sign-in", content=b"a=1&" * 247_500, headers=head)
                    count += 1
            return count

        quiet, spent = await watch(attacked, 5.0), attacked.processor_s
        until = time.monotonic() + 15.0
        attack = [asyncio.create_task(send()) for _ in range(4)]
        times = await watch(attacked, 15.0)
        sent = sum(await asyncio.gather(*attack))
        used = attacked.processor_s - spent
    return {**say(quiet, times), "forms": sent, "server_processor_s_a_form": used / sent}


async def listen(options: argparse.Namespace) -> dict[str, Any]:
    """300 listeners to the events of one build, six addresses with 50 each, which never read."""
    with service(options, builds="0") as attacked:
        order = {"machine": "slider-crank", "plan": "quick", "catalogue": "made"}
        place = httpx.post(f"{attacked.address}/api/v1/builds", json=order, timeout=60).headers["location"]
        quiet = await watch(attacked, 5.0, "/api/v1/machines/quick-return")
        writers = []
        for k in range(300):
            _, writer = await asyncio.open_connection(
                "127.0.0.1", attacked.port, local_addr=(f"127.0.0.{2 + k % 6}", 0)
            )
            writer.write(f"GET {place}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            writers.append(writer)
        await asyncio.sleep(2.0)
        spent = attacked.processor_s
        times = await watch(attacked, 15.0, "/api/v1/machines/quick-return")
        used = attacked.processor_s - spent
        for writer in writers:
            writer.close()
    return {**say(quiet, times), "server_processor_s": used}


async def diagnosis(address: str, measurement: str, source: str) -> tuple[int, float]:
    """Ask for a diagnosis from an address; return status and time [s]."""
    began = time.monotonic()
    asked = {"measurement": measurement, "catalogue": "slider-crank", "effort": "fast"}
    transport = httpx.AsyncHTTPTransport(local_address=source)
    async with httpx.AsyncClient(transport=transport, timeout=600) as client:
        answer = await client.post(f"{address}/api/v1/diagnoses", json=asked)
    return answer.status_code, time.monotonic() - began


async def store(attacked: Attacked) -> str:
    """Store a recording; return its id."""
    async with httpx.AsyncClient(timeout=600) as client:
        sent = {"file": ("worn.csv.gz", RECORDING.read_bytes())}
        answer = await client.post(f"{attacked.address}/api/v1/measurements", files=sent)
    return str(answer.json()["id"])


async def fifty(options: argparse.Namespace) -> dict[str, Any]:
    """One client asks for 50 diagnoses at once, another for one a second later; all of them may wait."""
    with service(options, queue_limit="100") as attacked:
        measurement = await store(attacked)
        _, alone = await diagnosis(attacked.address, measurement, "127.0.0.3")
        many = [asyncio.create_task(diagnosis(attacked.address, measurement, "127.0.0.2")) for _ in range(50)]
        await asyncio.sleep(1.0)
        status, beside = await diagnosis(attacked.address, measurement, "127.0.0.3")
        ends = [seconds for _, seconds in await asyncio.gather(*many)]
    return {"alone_s": alone, "status": status, "beside_fifty_s": beside, "last_of_fifty_s": max(ends)}


def row_of(links: int) -> dict[str, Any]:
    """Four-bar loops in a row: a machine file with so many links."""
    crank, ground, height = "crank", {"fixed": True}, 0.1
    made: dict[str, Any] = {"base": ground, crank: {"mass": "1 kg", "inertia": 0.001, "cg": [0, height / 2]}}
    joints: dict[str, Any] = {"O": {"kind": "turning", "links": [crank, "base"], "at": [0, 0]}}
    last, tip = crank, (0.0, height)
    for k in range((links - 2) // 2):
        x = 0.4 * (k + 1)
        bar, rocker = f"c{k}", f"r{k}"
        made[bar] = {"mass": "1 kg", "inertia": 0.01, "cg": [(tip[0] + x) / 2, (tip[1] + 0.25) / 2]}
        made[rocker] = {"mass": "1 kg", "inertia": 0.01, "cg": [x, 0.12]}
        joints[f"A{k}"] = {"kind": "turning", "links": [bar, last], "at": list(tip)}
        joints[f"B{k}"] = {"kind": "turning", "links": [rocker, bar], "at": [x, 0.25]}
        joints[f"G{k}"] = {"kind": "turning", "links": [rocker, "base"], "at": [x, 0]}
        last, tip = rocker, (x, 0.15)
    drive = {"kind": "rotation", "joint": "O", "speed": "120 rpm"}
    return {"name": "row", "links": made, "joints": joints, "drive": drive}


async def gone(options: argparse.Namespace) -> dict[str, Any]:
    """A machine of many links is checked by the one worker there is, its client goes after 1 s; then that again."""
    found: dict[str, Any] = {}
    with service(options, workers="1") as attacked:
        measurement = await store(attacked)
        _, found["diagnosis_alone_s"] = await diagnosis(attacked.address, measurement, "127.0.0.3")
        for turn in ("first", "second"):
            with suppress(httpx.TimeoutException):
                async with httpx.AsyncClient(timeout=1.0) as client:
                    await client.post(f"{attacked.address}/api/v1/machines/check", json=row_of(64))
            _, found[f"next_diagnosis_s_{turn}"] = await diagnosis(attacked.address, measurement, "127.0.0.3")
            until = time.monotonic() + 150.0  # for the spare worker
            while attacked.log.read_text().count("task warm has ended") < 3 and time.monotonic() < until:
                await asyncio.sleep(0.5)
        began = time.monotonic()
        async with httpx.AsyncClient(timeout=600.0) as client:
            answer = await client.put(f"{attacked.address}/api/v1/machines/row", json=row_of(300))
        found["links_300"] = {"status": answer.status_code, "seconds": time.monotonic() - began}
    return found


async def refused(options: argparse.Namespace) -> dict[str, Any]:
    """521 diagnoses of recordings that are too short, each of another one, by eight clients; what stays of them."""
    head, *rows = gzip.decompress(RECORDING.read_bytes()).split(b"\n")
    short = b"\n".join([head, *rows[: len(rows) // 20]])
    statuses: dict[int, int] = {}
    with service(options) as attacked:
        folder = attacked.log.parent

        def kept() -> int:
            files = [path for path in folder.rglob("*") if path.is_file() and path != attacked.log]
            return sum(path.stat().st_size for path in files)

        async def ask(client: httpx.AsyncClient, numbers: Iterator[int]) -> None:
            for number in numbers:
                sent = {"file": (f"{number}.csv", short + b"\n" * number)}
                asked = {"catalogue": "slider-crank", "effort": "fast"}
                answer = await client.post(f"{attacked.address}/api/v1/diagnoses", files=sent, data=asked)
                statuses[answer.status_code] = statuses.get(answer.status_code, 0) + 1
                said.add(answer.json()["detail"])

        before, numbers, said = kept(), iter(range(521)), set[str]()
        async with httpx.AsyncClient(timeout=600) as client:
            await asyncio.gather(*(ask(client, numbers) for _ in range(8)))
        left = kept() - before
    sent_mb = 521 * len(short) / 1e6
    return {"statuses": statuses, "said": sorted(said)[0], "sent_mb": round(sent_mb, 1), "kept_mb": left / 1e6}


async def bombs(options: argparse.Namespace) -> dict[str, Any]:
    """Two clients send what unpacks to a line of 100 million commas, again and again; a third one diagnoses."""
    bomb = gzip.compress(b"," * 100_000_000, 9)
    statuses: dict[int, int] = {}

    async def send(source: str) -> None:
        transport = httpx.AsyncHTTPTransport(local_address=source)
        async with httpx.AsyncClient(transport=transport, timeout=600) as client:
            while not over.is_set():
                answer = await client.post(
                    f"{attacked.address}/api/v1/measurements", files={"file": ("bomb.csv.gz", bomb)}
                )
                statuses[answer.status_code] = statuses.get(answer.status_code, 0) + 1

    with service(options) as attacked:
        measurement, over = await store(attacked), asyncio.Event()
        alone = [(await diagnosis(attacked.address, measurement, "127.0.0.9"))[1] for _ in range(8)]
        attack = [asyncio.create_task(send(source)) for source in ("127.0.0.2", "127.0.0.3")]
        await asyncio.sleep(1.0)
        beside = [(await diagnosis(attacked.address, measurement, "127.0.0.9"))[1] for _ in range(8)]
        over.set()
        await asyncio.gather(*attack)
    found = {"alone_s": float(np.median(alone)), "beside_s": float(np.median(beside)), "longest_s": max(beside)}
    return {**found, "bombs": statuses, "bomb_kb": len(bomb) / 1000}


ROWS: dict[str, Callable[[argparse.Namespace], Coroutine[Any, Any, dict[str, Any]]]] = {
    "idle": idle,
    "sign-in": sign_in,
    "listeners": listen,
    "fifty": fifty,
    "gone": gone,
    "refused": refused,
    "bombs": bombs,
}


def main() -> None:
    """Print every row as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--catalogues", type=Path, required=True)
    parser.add_argument("--source", type=Path)
    parser.add_argument("--only", nargs="*", choices=ROWS, default=list(ROWS))
    options = parser.parse_args()
    for name in options.only:
        found = asyncio.run(ROWS[name](options))
        print(json.dumps({name: found, "load": os.getloadavg()[0]}), flush=True)


if __name__ == "__main__":
    main()
