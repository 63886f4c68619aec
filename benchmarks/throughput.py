"""A table of a thousand cases of P1 on one core: cases per second, and how busy the lanes were."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import LIMITED_RATE, p1
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.machines.fault import Fault
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.harmonics import harmonic_error

Array = NDArray[np.float64]

#: Radial clearances of the table, m, spread evenly by their logarithm.
CLEARANCES = (2e-5, 1e-3)
TOLERANCE = 1e-5
#: A queue of so many cases is simulated at a time, so that the histories need not all be kept.
_TOGETHER = 128
_CHECKED = 8


def busy_part(steps: list[float]) -> float:
    """Part of the lanes' time that is spent on cases, if each lane takes the next case when its own has ended.

    Parameters
    ----------
    steps : list of float
        Of every case, in the order of the queue.
    """
    ends = [0.0] * LANES
    for count in steps:
        heapq.heapreplace(ends, ends[0] + count)
    return sum(steps) / (LANES * max(ends))


def measure(quick: bool, say: Callable[[str], None]) -> dict[str, object]:
    """Run the table, and some of its cases again with a tolerance of 1e-9 for the error."""
    scene = p1()
    count = 64 if quick else 1000
    clearances = np.geomspace(*CLEARANCES, count)[np.random.default_rng(1).permutation(count)]
    cases = [Case(Fault({"B": float(c)})) for c in clearances]
    settings = Settings(duration=scene.duration, rtol=TOLERANCE, sample_rate=LIMITED_RATE, motion=False)
    simulate_batch(scene.machine, cases[:LANES], replace(settings, duration=0.01))
    spent, integrating, failed, busy = 0.0, 0.0, 0, []
    kept: list[tuple[Case, Array]] = []
    for first in range(0, count, _TOGETHER):
        began = time.process_time()
        histories = simulate_batch(scene.machine, cases[first : first + _TOGETHER], settings)
        spent += time.process_time() - began
        integrating += sum(history.seconds for history in histories)
        failed += sum(history.status is not Status.OK for history in histories)
        busy.append(busy_part([scene.duration / history.step for history in histories]))
        if not kept:
            kept = [(history.case, history.band_limited_acceleration[:, 1]) for history in histories[:_CHECKED]]
        say(f"throughput: {first + len(histories)} of {count} cases")
    exact = simulate_batch(scene.machine, [case for case, _ in kept], replace(settings, rtol=1e-9))
    start = round(scene.after * LIMITED_RATE)
    errors = [
        harmonic_error(found[start:-1], history.band_limited_acceleration[start:-1, 1], LIMITED_RATE, scene.drive_hz)
        for (_, found), history in zip(kept, exact, strict=True)
    ]
    return {
        "cases": count, "failed": failed, "tolerance": TOLERANCE,
        "seconds": spent, "integrating": integrating / spent, "per_second": count / spent,
        "busy": float(np.mean(busy)), "error_median": float(np.median(errors)), "error_worst": max(errors),
    }  # fmt: skip
