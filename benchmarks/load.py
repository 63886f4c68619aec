"""``python -m benchmarks.load --catalogues DIR``: many clients ask one service for diagnoses of recordings of 5 s.

Server and clients share this computer. Every recording is another one: a shipped one whose samples begin elsewhere,
under a name of its own, so that no answer can be one that was given before. Printed are the rate, times of answers,
errors, memory, descriptors and disk of the service with its workers as they go, the processor time that a diagnosis
takes of server, workers and clients, and the load of the computer: others may be working on it, and then the processor
time is what counts. ``--seconds 3600`` is an hour's soak.
"""

from __future__ import annotations

import argparse
import asyncio
import gzip
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

BOUNDARY = b"a-boundary-that-no-recording-contains"
VARIANTS = 64


@dataclass
class Tally:
    """What the clients met.

    Parameters
    ----------
    seconds : list of float
        Time of each answer.
    statuses : Counter
        Answers by status.
    bytes_sent : int
    """

    seconds: list[float] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)
    bytes_sent: int = 0


def bodies(columns: int) -> list[bytes]:
    """Return recordings of 5 s at 10 kHz as CSV, with some of the four columns of the shipped ones."""
    made = []
    for name in ("quick-return-01", "quick-return-03", "quick-return-05"):
        packed = resources.files("jointplay.app.demo").joinpath("recordings", f"{name}.csv.gz").read_bytes()
        head, *rows = gzip.decompress(packed).split(b"\n")
        kept = [row.split(b",")[: columns + 1] for row in (head, *rows) if row]
        times = [row[0] for row in kept[1:]]
        samples = [b",".join(row[1:]) for row in kept[1:]]
        for shift in range(0, 40 * (VARIANTS // 3 + 1), 40):
            turned = samples[shift:] + samples[:shift]
            lines = (b",".join(pair) for pair in zip(times, turned, strict=True))
            made.append(b",".join(kept[0]) + b"\n" + b"\n".join(lines) + b"\n")
    return made


def request_of(content: bytes, number: int, catalogue: str, host: str) -> bytes:
    """Return a whole request that sends a recording and asks for its diagnosis."""
    parts = [(b"catalogue", catalogue.encode()), (b"effort", b"fast")]
    body = b"".join(
        b'--%s\r\nContent-Disposition: form-data; name="%s"\r\n\r\n%s\r\n' % (BOUNDARY, name, value)
        for name, value in parts
    )
    named = f"load-{number}.csv".encode()
    body += b'--%s\r\nContent-Disposition: form-data; name="file"; filename="%s"\r\n\r\n' % (BOUNDARY, named)
    body += content + b"\r\n--%s--\r\n" % BOUNDARY
    head = (
        f"POST /api/v1/diagnoses HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(body)}\r\n"
        f"Content-Type: multipart/form-data; boundary={BOUNDARY.decode()}\r\n\r\n"
    )
    return head.encode() + body


async def client(
    host: str, port: int, contents: list[bytes], numbers: Iterator[int], catalogue: str, until: float, tally: Tally
) -> None:
    """Ask again and again over one connection until the time is over."""
    reader, writer = await asyncio.open_connection(host, port)
    try:
        while time.monotonic() < until:
            number = next(numbers)
            request = request_of(contents[number % len(contents)], number, catalogue, f"{host}:{port}")
            started = time.monotonic()
            writer.write(request)
            await writer.drain()
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
            length = next(line for line in head.split("\r\n") if line.startswith("content-length:"))
            body = await reader.readexactly(int(length.split(":")[1]))
            tally.seconds.append(time.monotonic() - started)
            status = int(head.split(" ", 2)[1])
            if status != 201 and not tally.statuses[status]:
                print(f"  status {status}: {body[:300].decode()}", flush=True)
            tally.statuses[status] += 1
            tally.bytes_sent += len(request)
    finally:
        writer.close()


def processor_seconds(pid: int) -> tuple[float, float]:
    """Return the processor time of a process, and of all below it [s]."""
    own = sum(map(int, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]))
    below = sum(sum(processor_seconds(child)) for child in children(pid))
    return own / os.sysconf("SC_CLK_TCK"), below


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def resident(pid: int) -> int:
    """Return the memory of a process and all below it [bytes]; what several map is shared out among them."""
    total = 0
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            total = int(line.split()[1]) * 1024
    return total + sum(resident(child) for child in children(pid))


def descriptors(pid: int) -> int:
    """Return how many files and sockets a process and all below it have open."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir())) + sum(map(descriptors, children(pid)))


def occupied(folder: Path) -> int:
    """Return what the files of a folder take on the disk [bytes]; one may vanish meanwhile."""
    total = 0
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            total += path.stat().st_blocks * 512
    return total


@contextmanager
def service(catalogues: Path, data: Path, workers: int) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Start a service in processes of its own; gives it and its port."""
    command = [sys.executable, "-m", "jointplay.app.cli", "serve", "--no-keys", "--port", "0"]
    command += ["--catalogues", str(catalogues), "--data", str(data), "--workers", str(workers)]
    with (data / "log").open("w") as log, subprocess.Popen(command, stderr=log, text=True) as process:
        try:
            while "serving" not in (data / "log").read_text():
                if process.poll() is not None:
                    raise RuntimeError((data / "log").read_text())
                time.sleep(0.1)
            line = next(line for line in (data / "log").read_text().splitlines() if "serving" in line)
            yield process, int(line.split()[-1].rpartition(":")[2])
        finally:
            process.terminate()
            process.wait(30)


async def measure(options: argparse.Namespace, pid: int, port: int, data: Path) -> dict[str, object]:
    """Let the clients work and return what they met."""
    contents = bodies(options.columns)
    numbers = itertools.count()
    before = Tally()
    warm_until = time.monotonic() + options.warm
    asked = ("127.0.0.1", port, contents, numbers, options.catalogue)
    await asyncio.gather(*(client(*asked, warm_until, before) for _ in range(options.workers)))
    tally, loads = Tally(), []
    held = [(resident(pid), descriptors(pid), occupied(data))]
    started, spent = time.monotonic(), (*processor_seconds(pid), time.process_time())

    async def watch() -> None:
        while True:
            await asyncio.sleep(10)
            held.append((resident(pid), descriptors(pid), await asyncio.to_thread(occupied, data)))
            loads.append(os.getloadavg()[0])
            memory, opened, disk = held[-1]
            print(
                f"  {len(tally.seconds)} answers, {memory / 1e6:.0f} MB, {opened} descriptors, {disk / 1e6:.0f} MB of"
                f" disk, load {loads[-1]:.1f}",
                flush=True,
            )

    watching = asyncio.create_task(watch())
    until = started + options.seconds
    await asyncio.gather(*(client(*asked, until, tally) for _ in range(options.clients)))
    elapsed = time.monotonic() - started
    watching.cancel()
    each = [
        round(1000 * (after - before) / len(tally.seconds), 1)
        for after, before in zip((*processor_seconds(pid), time.process_time()), spent, strict=True)
    ]
    median, late = np.quantile(tally.seconds, (0.5, 0.99))
    return {
        "clients": options.clients,
        "answers": len(tally.seconds),
        "diagnoses_per_s": round(len(tally.seconds) / elapsed, 2),
        "median_s": round(float(median), 3),
        "p99_s": round(float(late), 3),
        "longest_s": round(max(tally.seconds), 3),
        "statuses": dict(tally.statuses),
        "megabytes_sent": round(tally.bytes_sent / 1e6),
        "processor_ms_each": dict(zip(("server", "workers", "clients"), each, strict=True)),
        "memory_mb": [round(memory / 1e6) for memory, _, _ in held],
        "descriptors": [opened for _, opened, _ in held],
        "disk_mb": [round(disk / 1e6) for _, _, disk in held],
        "load_average": [round(load, 1) for load in loads],
        "processors": os.cpu_count(),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--catalogues", type=Path, required=True)
    parser.add_argument("--catalogue", default="quick-return")
    parser.add_argument("--clients", type=int, default=32)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=300)
    parser.add_argument("--warm", type=float, default=10)
    parser.add_argument("--columns", type=int, choices=(2, 4), default=4, help="columns of a recording")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, service(options.catalogues, Path(folder), options.workers) as running:
        print(json.dumps(asyncio.run(measure(options, running[0].pid, running[1], Path(folder))), indent=1))


if __name__ == "__main__":
    main()
