"""What building a large catalogue costs: cases made up (all but the simulation), real cases, and a cluster.

``python -m benchmarks.build_scale fake --entries 100000``: the builder's own work, with spectra of full size that cost
nothing to make, in this process, on SQLite or on PostgreSQL (``--index URL``). ``real --entries 2000``: processor time
a case, simulation and all, on local processes, on either. ``cluster``: the same cases on two Dask workers and on two
local processes, in turns.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.kills import free_port
from jointplay.catalogue.building.build import BuildReport, build
from jointplay.catalogue.building.chunk import Chunk
from jointplay.catalogue.building.cluster import DaskCluster
from jointplay.catalogue.building.executors import LocalProcesses
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import Plan, parse_plan
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.location import IndexLocation
from jointplay.catalogue.storage.shard import OK, CaseOutcome
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.spectra.bands import BandScheme


def plan_of(entries: int) -> Plan:
    """16 hypotheses of the quick-return: healthy, every single joint and every pair; at least so many cases."""
    draws = -(-entries // 16)
    numbers = dict.fromkeys(("healthy", "single", "pair"), draws)
    hypotheses = ["healthy", "singles", "pairs"]
    return parse_plan({"name": "scale", "hypotheses": hypotheses, "draws": numbers, "wide": {"draws": 0}})


@lru_cache
def _spectrum(scheme: BandScheme) -> tuple[NDArray[np.complex64], NDArray[np.float32], NDArray[np.complex64]]:
    generator, bands = np.random.default_rng(1), scheme.count
    root = generator.normal(size=(bands, 3, 3)) + 1j * generator.normal(size=(bands, 3, 3))
    power = (root @ root.conj().swapaxes(1, 2)).astype(np.complex64)
    cyclic = np.zeros((len(scheme.third_octave_groups()) - 1, 2, 3, 3), np.complex64)
    return power, generator.random((bands, 3)).astype(np.float32), cyclic


def made_up(chunk: Chunk) -> tuple[CaseOutcome, ...]:
    """Spectra of the right size, different from case to case, at once."""
    power, spread, cyclic = _spectrum(chunk.recipe.scheme)
    return tuple(
        CaseOutcome(OK, "", 60.0, 0.25, 4, 0.0, power * np.float32(1 + int(entry.key[:4], 16)), spread, cyclic)
        for entry in chunk.entries
    )


def processor_seconds() -> float:
    """Of this process and of those of its children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def fake(entries: int, index: str | None) -> None:
    """Time of everything but the simulation."""
    plan, machine = plan_of(entries), shipped_machine("quick-return")
    with tempfile.TemporaryDirectory(dir=options_folder()) as folder:
        began, used = time.perf_counter(), time.process_time()
        marks: list[tuple[float, float]] = []
        report = build(
            machine,
            plan,
            folder,
            workers=0,
            compute=made_up,
            index=index,
            progress=lambda state: marks.append((time.perf_counter(), time.process_time())),
        )
        wall, processor = time.perf_counter() - began, time.process_time() - used
        first, last = marks[0], marks[-1]
        database = "PostgreSQL" if index else "SQLite"
        chunks = len(CatalogueDirectory(Path(folder)).shard_names())
        print(
            f"{report.added} made-up cases, index in {database}: {wall:.1f} s, {processor:.1f} s of a core "
            f"({1e3 * processor / report.added:.2f} ms a case); before the first chunk {first[0] - began:.1f} s, "
            f"chunks {last[0] - first[0]:.1f} s ({1e3 * (last[0] - first[0]) / chunks:.1f} ms a chunk, "
            f"{1e3 * (last[1] - first[1]) / chunks:.1f} ms of a core), sealing {began + wall - last[0]:.1f} s; "
            f"{report.size / report.added:.0f} bytes a case"
        )
        clean(folder)


def real(entries: int, workers: int, keep: Path | None, index: str | None) -> None:
    """Processor time of real cases, with everything: imports, compilation, sealing."""
    with tempfile.TemporaryDirectory(dir=options_folder()) as temporary:
        folder = keep or Path(temporary)
        before, began = processor_seconds(), time.perf_counter()
        report = build(shipped_machine("quick-return"), plan_of(entries), folder, workers=workers, index=index)
        used, wall = processor_seconds() - before, time.perf_counter() - began
        said(f"{workers} local processes, index in {'PostgreSQL' if index else 'SQLite'}", report, used, wall)
        with IndexLocation.of(CatalogueDirectory(folder)).open() as opened:
            rows = opened.chunks()
        chunks = sum(row.seconds for row in rows)
        if keep is None:
            clean(temporary)
        print(f"  of that {chunks:.1f} s in chunks at workers ({1e3 * chunks / report.added:.2f} ms a case)")
        for kind in sorted({row.hypothesis for row in rows}):
            times = [row.seconds / row.entries for row in rows if row.hypothesis == kind]
            print(f"    {kind:10} {1e3 * np.mean(times):6.2f} ms a case")


def cluster(entries: int, turns: int) -> None:
    """The same real cases on two local processes and on two Dask workers, in turns; kernels are compiled before."""
    found: dict[str, list[tuple[float, float]]] = {"local": [], "dask": []}
    with tempfile.TemporaryDirectory(dir=options_folder()) as folder:
        build(shipped_machine("quick-return"), plan_of(17), folder, workers=2)
    for _ in range(turns):
        for kind, once in (("local", on_processes), ("dask", on_dask)):
            with tempfile.TemporaryDirectory(dir=options_folder()) as folder:
                found[kind].append(once(entries, folder))
    for kind, times in found.items():
        wall, processor = np.min(times, axis=0)
        print(f"{kind:6} least of {turns}: {wall:.1f} s, {processor:.1f} s of a core for {plan_entries(entries)} cases")


def on_processes(entries: int, folder: str) -> tuple[float, float]:
    """Wall and processor time on two local processes that are there already."""
    machine, plan = shipped_machine("quick-return"), plan_of(entries)
    before = processor_seconds()
    executor = LocalProcesses(2)
    for future in [executor.submit(simulate_nothing, 0.5) for _ in range(2)]:
        future.result()
    began = time.perf_counter()
    build(machine, plan, folder, executor=executor)
    wall = time.perf_counter() - began
    executor.close()
    return wall, processor_seconds() - before


def on_dask(entries: int, folder: str) -> tuple[float, float]:
    """Wall and processor time on two Dask workers that are there already; the scheduler's included."""
    machine, plan = shipped_machine("quick-return"), plan_of(entries)
    before = processor_seconds()
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    start = [sys.executable, "-m"]
    scheduler = [*start, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port)]
    worker = [*start, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
    processes = [quietly([*scheduler, "--dashboard-address", ":0"])]
    processes += [quietly([*worker, "--no-dashboard"]) for _ in range(2)]
    try:
        executor = DaskCluster(address)
        while executor.capacity < 4:
            time.sleep(0.5)
        for future in [executor.submit(simulate_nothing, 0.5) for _ in range(2)]:
            future.result()
        began = time.perf_counter()
        build(machine, plan, folder, executor=executor)
        wall = time.perf_counter() - began
        executor.close()
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()
    return wall, processor_seconds() - before


def quietly(command: list[str]) -> subprocess.Popen[bytes]:
    """Start a program."""
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def simulate_nothing(seconds: float) -> None:
    """Make sure that a worker has imported what it needs."""
    time.sleep(seconds)


def plan_entries(entries: int) -> int:
    """Cases of the plan."""
    return len(entries_of(plan_of(entries), shipped_machine("quick-return")))


def said(where: str, report: BuildReport, processor: float, wall: float) -> None:
    """Print what a build took."""
    rate = report.added / processor
    print(
        f"{report.added} cases on {where}: {wall:.1f} s, {processor:.1f} s of a core: {1e3 / rate:.2f} ms a case, "
        f"{rate:.0f} a second of a core; 100 000 in {1e5 / rate / 60:.1f} min of a core"
    )


def options_folder() -> str | None:
    """Where catalogues of this program go, made where it is not there; the system's folder by default."""
    folder = os.environ.get("JOINTPLAY_BENCH_DIR")
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
    return folder


def clean(folder: str) -> None:
    """Forget a catalogue in a database of many."""
    layout = CatalogueDirectory(Path(folder))
    location = IndexLocation.of(layout)
    if not location.is_file:
        with location.open() as index:
            index.remove_shards(list(index.shards()))


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("fake", "real", "cluster"))
    parser.add_argument("--entries", type=int, default=2000)
    parser.add_argument("--index", help="URL of PostgreSQL, for made-up and real cases")
    parser.add_argument("--keep", type=Path, help="folder for a catalogue of real cases that stays")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--turns", type=int, default=2)
    options = parser.parse_args()
    runs: dict[str, Callable[[], None]] = {
        "fake": lambda: fake(options.entries, options.index),
        "real": lambda: real(options.entries, options.workers, options.keep, options.index),
        "cluster": lambda: cluster(options.entries, options.turns),
    }
    runs[options.what]()


if __name__ == "__main__":
    main()
