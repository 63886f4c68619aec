"""``python -m benchmarks.signal_views``: a recording of a minute, four channels at 10 kHz, as a page looks at it.

A service on this computer is sent the recording as CSV and asked for what its page asks for: all views at once, the
first time and again, and then the waveform in a hundred windows that move along. Others may be working on the computer:
beside the seconds stands what they are of the time that reading the file takes by itself.
"""

from __future__ import annotations

import asyncio
import io
import tempfile
import threading
import time
from pathlib import Path

import httpx
import numpy as np
import uvicorn

from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.measurements.measured_spectrum import read_recording

RATE, SECONDS, CHANNELS, PANS = 10_000, 60, 4, 100
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


async def ask(client: httpx.AsyncClient, key: str, **asked: str | float) -> float:
    """Return how long one answer takes [s]."""
    begin = time.perf_counter()
    (await client.get(f"/api/v1/measurements/{key}/signal", params=asked)).raise_for_status()
    return time.perf_counter() - begin


async def page(client: httpx.AsyncClient, key: str, **more: str) -> float:
    """Return how long it takes until all views are there that a page asks for at once [s]."""
    begin = time.perf_counter()
    await asyncio.gather(*(ask(client, key, view=view, speed="600 rpm", **more) for view in VIEWS))
    return time.perf_counter() - begin


async def measure(address: str, content: bytes) -> list[tuple[str, float]]:
    """Return what was asked, and how long it took [s]."""
    async with httpx.AsyncClient(base_url=address, timeout=300) as client:
        begin = time.perf_counter()
        sent = await client.post("/api/v1/measurements", files={"file": ("minute.csv", content)})
        key = sent.json()["id"]
        found = [("upload", time.perf_counter() - begin), ("first opening, all views", await page(client, key))]
        again = [await page(client, key) for _ in range(3)]
        found.append(("opened again, all views", min(again)))
        found += [
            (f"{view}", min([await ask(client, key, view=view, speed="600 rpm") for _ in range(3)])) for view in VIEWS
        ]
        for unit in ("m/s2", "mm/s"):
            begins = np.linspace(0, SECONDS - 3, PANS).tolist()
            pans = [await ask(client, key, unit=unit, points=3600, **{"from": at, "to": at + 3}) for at in begins]
            found.append((f"a pan of the waveform, {unit}, median", float(np.median(pans))))
            found.append((f"a pan of the waveform, {unit}, slowest", max(pans)))
        return found


def main() -> None:
    """Measure and print."""
    content = recording()
    begin = time.perf_counter()
    read_recording(content, name="minute.csv")
    alone = time.perf_counter() - begin
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        application = create_app(
            ServiceSettings(catalogues=folder / "none", data=folder / "data", workers=2, keys="off", max_upload_mb=200),
            warm=True,
        )
        server = uvicorn.Server(uvicorn.Config(application, port=0, log_level="warning"))
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.05)
        time.sleep(15)  # its workers load what they need
        place = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
        found = asyncio.run(measure(place, content))
        memory = [largest_memory(pid) for _, pid in application.state.service.pool.processes()]
        server.should_exit = True
        thread.join(30)
    print(f"{len(content) / 1e6:.1f} MB of CSV; read by itself in {alone:.2f} s")
    for what, seconds in found:
        print(f"{what}: {seconds:.3f} s, {seconds / alone:.2f} times reading it")
    print(f"largest memory of a worker: {max(memory):.0f} MB")


if __name__ == "__main__":
    main()
