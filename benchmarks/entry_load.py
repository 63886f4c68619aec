"""How many cached entries a second the service gives: ``python -m benchmarks.entry_load CATALOGUES [--seconds 10]``.

It starts a server of its own over a directory of catalogues, and asks for entries over kept connections, from this
process: server and client share the computer. The client speaks bare HTTP/1.1, so that the server is what is measured.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np

ENTRIES = 64
ADDRESS = re.compile(r"serving (http://127\.0\.0\.1:(\d+))")


@dataclass
class Seen:
    """What clients saw: seconds of every answer, number of bytes and of answers of another status than wanted."""

    seconds: list[float] = field(default_factory=list)
    size: int = 0
    wrong: int = 0


async def client(port: int, requests: list[bytes], wanted: bytes, until: float, seen: Seen) -> None:
    """Ask for one entry after the other over one connection until a moment."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    number = 0
    while (begun := time.perf_counter()) < until:
        writer.write(requests[number % len(requests)])
        head = await reader.readuntil(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", head)
        body = await reader.readexactly(int(length[1]) if length else 0)
        seen.size += len(body)
        seen.seconds.append(time.perf_counter() - begun)
        seen.wrong += not head.startswith(b"HTTP/1.1 " + wanted)
        number += 1
    writer.close()
    with suppress(ConnectionError):
        await writer.wait_closed()


async def load(port: int, requests: list[bytes], wanted: bytes, clients: int, seconds: float) -> Seen:
    """Let several clients ask at once."""
    seen = Seen()
    until = time.perf_counter() + seconds
    shifted = [requests[first % len(requests) :] + requests[: first % len(requests)] for first in range(clients)]
    await asyncio.gather(*(client(port, each, wanted, until, seen) for each in shifted))
    return seen


def processor_seconds(pid: int) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(address: str, port: int, pid: int, clients: int, seconds: float) -> None:
    """Print a line for each form, and one for answers that the client holds already.

    Beside the rate stands the processor time of an answer: on a computer that others use, too, it says what the rate
    would be on a quiet one.
    """
    with urlopen(f"{address}/api/v1/catalogues?limit=1") as answer:
        name = json.load(answer)["items"][0]["name"]
    place = f"/api/v1/catalogues/{name}/entries"
    with urlopen(f"{address}{place}?limit={ENTRIES}") as answer:
        keys = [item["key"] for item in json.load(answer)["items"]]
    print(f"{name}, {len(keys)} entries, {clients} connections, load average {os.getloadavg()[0]:.1f}")
    kinds = ("application/json", "text/csv", "application/x-hdf5", "application/x-npy")
    for label, accept, held in [*((kind, kind, "") for kind in kinds), ("304", "application/json", "*")]:
        more = f"If-None-Match: {held}\r\n" if held else ""
        requests = [
            f"GET {place}/{key} HTTP/1.1\r\nHost: 127.0.0.1\r\nAccept: {accept}\r\n{more}\r\n".encode() for key in keys
        ]
        wanted = b"304" if held else b"200"
        for key in keys:  # everything is in memory from here on
            urlopen(Request(f"{address}{place}/{key}", headers={"Accept": accept})).close()
        before = processor_seconds(pid), time.process_time()
        seen = asyncio.run(load(port, requests, wanted, clients, seconds))
        after = processor_seconds(pid), time.process_time()
        server, own = (1e3 * (b - a) / len(seen.seconds) for a, b in zip(before, after, strict=True))
        p50, p99 = np.quantile(seen.seconds, [0.5, 0.99]) * 1e3
        print(
            f"{label:20} {len(seen.seconds) / seconds:7.0f} GET/s  {seen.size / seconds / 1e6:6.1f} MB/s"
            f"  p50 {p50:5.1f} ms  p99 {p99:5.1f} ms  errors {seen.wrong}"
            f"  processor: server {server:.2f} ms, client {own:.2f} ms an answer"
        )


@contextmanager
def serving(catalogues: Path, data: Path) -> Iterator[tuple[str, int, int]]:
    """Run a server of one worker that carries no builds out; gives its address, port and process."""
    command = [sys.executable, "-m", "jointplay.app.cli", "serve", "--no-keys", "--port", "0", "--workers", "1"]
    command += ["--catalogues", str(catalogues), "--data", str(data)]
    told = {"JOINTPLAY_RATE_LIMIT_PER_S": "1e6", "JOINTPLAY_RATE_BURST": "1e6", "JOINTPLAY_BUILDS": "0"}
    data.mkdir(parents=True, exist_ok=True)
    log = data / "server.log"  # a file, because a pipe that nobody reads fills up
    with log.open("wb") as target:
        server = subprocess.Popen(command, stdout=target, stderr=target, env={**os.environ, **told})
        try:
            while (found := ADDRESS.search(log.read_text())) is None:
                if server.poll() is not None:
                    raise SystemExit(f"the server did not start: {log.read_text()}")
                time.sleep(0.1)
            yield found[1], int(found[2]), server.pid
        finally:
            server.terminate()
            server.wait(60)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("catalogues", type=Path)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--clients", type=int, default=8)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as data, serving(given.catalogues, Path(data)) as (address, port, pid):
        time.sleep(5.0)  # its worker loads what diagnoses need, with a core of its own
        measure(address, port, pid, given.clients, given.seconds)


if __name__ == "__main__":
    main()
