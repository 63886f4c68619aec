"""A stand-in for the simulation of a chunk: spectra that follow from the key alone, at once, with trouble on demand.

Trouble comes through environment variables, so that it reaches worker processes: ``FAKE_SECONDS`` (time of a chunk),
``FAKE_LOG`` (file to which computed keys are appended), ``FAKE_DEADLY`` (beginning of the key whose case kills the
worker), ``FAKE_RAISES`` (the same, by an exception).

Run as a program it builds a catalogue in the folder that is its argument, and prints a line after every chunk;
``FAKE_SCHEDULER`` (address of a Dask cluster to compute on), ``FAKE_INDEX`` (URL of the index), ``FAKE_LEASE`` (s).
"""

from __future__ import annotations

import os
import signal
import sys
import time

import fake_simulator
import numpy as np

from jointplay.catalogue.building.build import Progress, build
from jointplay.catalogue.building.chunk import Chunk
from jointplay.catalogue.building.cluster import DaskCluster
from jointplay.catalogue.plans.plan import Plan, parse_plan
from jointplay.catalogue.storage.shard import OK, CaseOutcome
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.spectra.bands import BandScheme

MACHINE = shipped_machine("slider-crank")

PLAN: Plan = parse_plan(
    {
        "name": "small",
        "clearance": {"low": "50 um", "high": "0.5 mm"},
        "draws": {"healthy": 6, "single": 12},
        "fits": {"silent": 0},
        "laws": {"own": 1},
        "bands": {"orders": 5, "per_octave": 3, "f_max": "500 Hz"},
    }
)


def diverges(key: str) -> bool:
    """One case in eight fails."""
    return key.startswith(("7", "c"))


def compute(chunk: Chunk) -> tuple[CaseOutcome, ...]:
    """Make up one outcome a case."""
    time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
    outcomes = tuple(_outcome(entry.key, chunk.recipe.scheme) for entry in chunk.entries)
    if "FAKE_LOG" in os.environ:
        with open(os.environ["FAKE_LOG"], "a", encoding="ascii") as log:
            log.writelines(f"{entry.key}\n" for entry in chunk.entries)
    return outcomes


def _outcome(key: str, scheme: BandScheme) -> CaseOutcome:
    if key.startswith(os.environ.get("FAKE_DEADLY", "none")):
        os.kill(os.getpid(), signal.SIGKILL)
    if key.startswith(os.environ.get("FAKE_RAISES", "none")):
        raise ArithmeticError(f"case {key[:8]}\nis too hard")
    if diverges(key):
        return CaseOutcome("diverged", "left the range at t = 0.1 s", 60.0, 0.0, 0, 0.5)
    random, bands = np.random.default_rng(int(key[:8], 16)), scheme.count
    root = random.normal(size=(bands, 3, 3)) + 1j * random.normal(size=(bands, 3, 3))
    power = (root @ root.conj().swapaxes(1, 2)).astype(np.complex64)
    spread = random.random((bands, 3)).astype(np.float32)
    half = random.normal(size=(len(scheme.third_octave_groups()) - 1, 2, 3, 3)).astype(np.complex64)
    return CaseOutcome(OK, "", 60.0, 0.25, 4, 0.5, power, spread, half + half.swapaxes(2, 3))


def _tell(progress: Progress) -> None:
    print(progress.done, progress.total, progress.failed, progress.lost, flush=True)


if __name__ == "__main__":
    scheduler = os.environ.get("FAKE_SCHEDULER")
    cluster = DaskCluster(scheduler, wait=60.0, first_wait=60.0) if scheduler else None
    report = build(
        MACHINE,
        PLAN,
        sys.argv[1],
        workers=2,
        executor=cluster,
        compute=fake_simulator.compute,  # of the module, not of the program: workers import it
        chunk_size=4,
        progress=_tell,
        index=os.environ.get("FAKE_INDEX"),
        lease=float(os.environ.get("FAKE_LEASE", "60")),
    )
    print(f"added {report.added} lost {len(report.lost)} workers {report.workers_lost}", flush=True)
    if cluster is not None:
        cluster.close()
