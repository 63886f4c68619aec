"""``python -m benchmarks.signal_views``: a recording of a minute, four channels at 10 kHz, as a page looks at it.

A service on this computer is sent the recording as CSV and asked for what its page asks for: all views at once, the
first time and again, and then the waveform in a hundred windows that move along; of several times the median. Others
may be working on the computer: beside the seconds by the clock stands the processor time of the whole service, its
workers, the server and the asking together, and what that is of reading the file. Nothing of it waits for anything but
a processor: on one idle core the clock shows no more than that.
"""

from __future__ import annotations

import asyncio
import io
import statistics
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import httpx
import numpy as np
import uvicorn

from benchmarks.load import processor_seconds
from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.measurements.measured_spectrum import read_recording

RATE, SECONDS, CHANNELS, PANS, TIMES = 10_000, 60, 4, 100, 7
VIEWS = ("overall", "waveform", "spectrum", "revolution", "spectrogram")


def recording() -> bytes:
    """Return a machine at 600 rpm with a knock in each revolution, in noise, as CSV."""
    rng = np.random.default_rng(1)
    moment = np.arange(RATE * SECONDS) / RATE
    since = (10 * moment) % 1.0 / 10
    knock = 20 * np.exp(-since / 0.002) * np.sin(2 * np.pi * 1500 * since)
    columns = [moment]
    columns += [
        knock / (1 + k) + np.sin(20 * np.pi * moment + k) + rng.normal(size=len(moment)) for k in range(CHANNELS)
    ]
    text = io.StringIO()
    text.write("t [s]," + ",".join(f"s{k + 1} [m/s2]" for k in range(CHANNELS)) + "\n")
    np.savetxt(text, np.column_stack(columns), "%.6g", ",")
    return text.getvalue().encode()


def largest_memory(pid: int) -> float:
    """Return the most memory that a process has held, MB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024


class Asker:
    """Asks a service on this computer for what a page shows, and notes what that takes.

    Parameters
    ----------
    client : httpx.AsyncClient
    workers : callable
        Gives the ids of the service's worker processes.
    """

    def __init__(self, client: httpx.AsyncClient, workers: Callable[[], list[int]]) -> None:
        self._client, self._workers = client, workers
        self.key = ""

    def processor(self) -> float:
        """Return the processor time of the workers, the server and this so far [s]."""
        return time.process_time() + sum(sum(processor_seconds(pid)) for pid in self._workers())

    async def upload(self, content: bytes) -> None:
        """Send the recording."""
        sent = await self._client.post("/api/v1/measurements", files={"file": ("minute.csv", content)})
        self.key = sent.raise_for_status().json()["id"]

    async def ask(self, **asked: str | float) -> None:
        """Ask for one view."""
        answer = await self._client.get(f"/api/v1/measurements/{self.key}/signal", params=asked)
        answer.raise_for_status()

    async def page(self) -> None:
        """Ask for all views at once, as the page does."""
        await asyncio.gather(*(self.ask(view=view, speed="600 rpm") for view in VIEWS))

    async def pan(self, unit: str) -> None:
        """Ask for one window of the waveform after the other."""
        for at in np.linspace(0, SECONDS - 3, PANS).tolist():
            await self.ask(unit=unit, points=3600, **{"from": at, "to": at + 3})

    async def timed(self, what: Awaitable[None], times: int = 1) -> tuple[float, float]:
        """Return seconds by the clock, and of processors, for each of some times."""
        begin, before = time.perf_counter(), self.processor()
        await what
        return (time.perf_counter() - begin) / times, (self.processor() - before) / times


def median(found: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the median by the clock, and that of processors."""
    clock, used = (statistics.median(each) for each in zip(*found, strict=True))
    return clock, used


async def measure(
    address: str, content: bytes, workers: Callable[[], list[int]]
) -> list[tuple[str, tuple[float, float]]]:
    """Return what was asked, and what it took."""
    async with httpx.AsyncClient(base_url=address, timeout=300) as client:
        asker = Asker(client, workers)
        found = [("upload", await asker.timed(asker.upload(content)))]
        found.append(("first opening, all views", await asker.timed(asker.page())))
        found.append(("opened again, all views", median([await asker.timed(asker.page()) for _ in range(TIMES)])))
        for view in VIEWS:
            each = [await asker.timed(asker.ask(view=view, speed="600 rpm")) for _ in range(TIMES)]
            found.append((f"of that, {view}", median(each)))
        for unit in ("m/s2", "mm/s"):
            found.append((f"a pan of the waveform, {unit}", await asker.timed(asker.pan(unit), PANS)))
        return found


def main() -> None:
    """Measure and print."""
    content = recording()
    begin, before = time.perf_counter(), time.process_time()
    read_recording(content, name="minute.csv")
    alone, processor = time.perf_counter() - begin, time.process_time() - before
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        application = create_app(
            ServiceSettings(catalogues=folder / "none", data=folder / "data", workers=2, keys="off", max_upload_mb=200),
            warm=True,
        )
        server = uvicorn.Server(uvicorn.Config(application, port=0, log_level="warning", proxy_headers=False))
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.05)
        time.sleep(15)  # its workers load what they need
        place = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
        pool = application.state.service.pool
        found = asyncio.run(measure(place, content, lambda: [pid for _, pid in pool.processes()]))
        memory = [largest_memory(pid) for _, pid in pool.processes()]
        server.should_exit = True
        thread.join(30)
    print(f"{len(content) / 1e6:.1f} MB of CSV; read by itself: {alone:.2f} s, {processor:.2f} s of a processor")
    for what, (seconds, used) in found:
        print(f"{what}: {seconds:.3f} s, {used:.3f} s of a processor, {used / processor:.3f} of reading it")
    print(f"largest memory of a worker: {max(memory):.0f} MB")


if __name__ == "__main__":
    main()
