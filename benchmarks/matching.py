"""What matching one recording costs with a large catalogue: ``python -m benchmarks.matching --entries 100000``.

The catalogue is a made-up one of :mod:`benchmarks.fake_catalogue` (``--catalogue`` takes one that is there). Sensors,
noise and length are those of the demonstration's recordings, the spectra those of entries of the catalogue; linear
algebra has one thread. Printed are medians and worst cases, in a process that has done nothing before; then how long
``jointplay serve`` takes until it is ready, and until its first answers to a recording of the demonstration.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import httpx
import numpy as np

from benchmarks.fake_catalogue import peak
from jointplay.catalogue.building.network_building import train_networks
from jointplay.catalogue.diagnosing.diagnosis import answer
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.spectra.band_power import transform_power

RECORDINGS = Path(__file__).resolve().parents[1] / "app" / "demo" / "recordings"
RECORDED = 60
"""Recordings that are answered."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

START_LIMIT = 60.0
"""How long a server may take before this gives up [s]."""

T = TypeVar("T")


Cost = tuple[float, float]
"""Time [ms], and time of a processor in this process [ms]: less where others wait for the same processor."""


def timed(task: Callable[[], T]) -> tuple[Cost, T]:
    """Return what a task costs, and what it returns."""
    started, used = time.perf_counter(), time.process_time()
    result = task()
    return (1e3 * (time.perf_counter() - started), 1e3 * (time.process_time() - used)), result


def measure(folder: Path, models: Path) -> None:
    """Print what opening, preparing and answering take."""
    opening, catalogue = timed(lambda: Catalogue.open(folder))
    mapping, matrix = timed(lambda: catalogue.matrix)
    print(f"{len(matrix)} entries of {len(matrix.hypotheses)} hypotheses")
    say("open", opening)
    say("map the matrix", mapping)
    files = sorted(RECORDINGS.glob("*.csv.gz"))
    read = [read_measurement(file.read_bytes(), name=file.name) for file in files]
    tasks = [partial(prepare, each, catalogue.machine, scheme=catalogue.scheme) for each in read]
    costs, prepared = zip(*map(timed, tasks), strict=True)
    say("preparation of a recording", *costs)
    rows = matrix.all_rows[len(matrix) // (2 * RECORDED) :: len(matrix) // RECORDED][:RECORDED]
    recordings = [like(prepared[i % len(prepared)], catalogue, int(row)) for i, row in enumerate(rows)]
    first = recordings[: len(prepared)]

    def costs_of(
        effort: Effort, mode: ModeAsked, library: ModelLibrary, asked: list[PreparedMeasurement]
    ) -> list[Cost]:
        question, suggesting = Question(effort, mode), effort != "fast"
        ask = partial(answer, sha256="0" * 64, catalogue=catalogue, question=question, suggesting=suggesting)
        return [timed(partial(ask, each, library=library))[0] for each in asked]

    trained, _ = timed(lambda: train_networks(folder, workers=2))
    say("networks of both modes, trained side by side", trained)
    networks = NetworkShelf.of(catalogue)
    library = ModelLibrary(matrix, models, networks)
    say("fast, trusted, its model is fitted", *costs_of("fast", "trusted", library, first))
    say("fast, robust, its model is fitted", *costs_of("fast", "robust", library, first))
    say("fast, trusted, its model is read", *costs_of("fast", "trusted", ModelLibrary(matrix, models, networks), first))
    costs_of("fast", "auto", library, recordings)
    for effort in ("fast", "standard"):
        for mode in ("trusted", "robust", "auto"):
            say(f"{effort}, {mode}", *costs_of(effort, mode, library, recordings))
    print(f"peak memory of this process: {peak():.0f} MB", flush=True)


def like(prepared: PreparedMeasurement, catalogue: Catalogue, row: int) -> PreparedMeasurement:
    """Return a recording of an entry's machine by the sensors of another recording, as noisy as that."""
    ((entry, outcome),) = catalogue.cases(np.array([row]))
    assert outcome.power is not None
    bands = prepared.sensor_bands
    power = transform_power(outcome.power[: len(bands.power)], prepared.sensing.transform)
    edges = bands.scheme.edges_hz(prepared.drive_speed)
    noise = prepared.floor.band_power(edges, prepared.sensing.derivatives)
    power = power + noise[: len(power), :, None] * np.eye(power.shape[-1])
    return replace(prepared, name=entry.hypothesis.label, sensor_bands=replace(bands, power=power))


def say(what: str, *costs: Cost) -> None:
    """Print one line: median and worst."""
    shown = (f"median {statistics.median(each):.1f}, worst {max(each):.1f}" for each in zip(*costs, strict=True))
    print(f"{what} [ms]: {'; processor '.join(shown)}", flush=True)


@contextmanager
def server(folder: Path, data: Path) -> Iterator[str]:
    """Start ``jointplay serve`` in a process of its own and return its address; it is ended in the end."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "jointplay.app.cli", "serve", "--no-keys", "--port", str(port)]
    command += ["--catalogues", str(folder), "--data", str(data), "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


def measure_server(folder: Path, data: Path) -> None:
    """Print how long a server takes until it is ready, and what its first requests take."""
    started = time.perf_counter()
    with server(folder, data) as address, httpx.Client(base_url=address, timeout=START_LIMIT) as client:
        while True:
            try:
                if client.get("/readyz").status_code == httpx.codes.OK:
                    break
            except httpx.TransportError:
                if time.perf_counter() - started > START_LIMIT:
                    raise
            time.sleep(0.01)
        print(f"jointplay serve until /readyz says yes: {time.perf_counter() - started:.2f} s", flush=True)
        file = sorted(RECORDINGS.glob("*.csv.gz"))[0]
        cost, reply = timed(lambda: client.post("/api/v1/measurements", files={"file": (file.name, file.read_bytes())}))
        reply.raise_for_status()
        print(f"first upload: {cost[0]:.0f} ms", flush=True)
        asked = {"measurement": reply.json()["id"], "catalogue": folder.name, "effort": "fast"}
        for what in ("first", "second"):
            cost, reply = timed(lambda: client.post("/api/v1/diagnoses", json=asked))
            reply.raise_for_status()
            print(f"{what} diagnosis over HTTP, fast: {cost[0]:.0f} ms", flush=True)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--entries", type=int, default=100_000, help="of the made-up catalogue")
    parser.add_argument("--catalogue", type=Path, help="measure this one of quick-return in place of a made-up one")
    chosen = parser.parse_args()
    if any(os.environ.get(name) != "1" for name in THREADS):  # read when libraries are loaded: begin again
        command = [sys.executable, "-m", "benchmarks.matching", *sys.argv[1:]]
        os.execve(sys.executable, command, os.environ | dict.fromkeys(THREADS, "1"))
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.catalogue
        if folder is None:
            folder = Path(scratch) / "made-up"
            command = [sys.executable, "-m", "benchmarks.fake_catalogue", str(folder)]
            subprocess.run([*command, "--entries", str(chosen.entries)], check=True)  # a process of its own: its memory
        measure(folder, Path(scratch) / "models")
        measure_server(folder, Path(scratch) / "data")


if __name__ == "__main__":
    main()
