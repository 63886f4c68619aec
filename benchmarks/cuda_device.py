"""P1, the slider-crank with one worn joint: cases as threads of a CUDA device beside the lanes of one core, in one run.

Says so and ends where there is no device. Numba's simulator of CUDA is refused: it measures nothing.

    python benchmarks/cuda_device.py
"""

from __future__ import annotations

import platform
import time
from pathlib import Path

import numpy as np

from jointplay.solver.cases.history import Case, History, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, load_machine
from jointplay.solver.simulation.simulate import simulate_batch

CASES = (32, 1024, 8192)
SIMULATED = 0.25  # s


def device_name() -> str:
    """Name of the device, or nothing."""
    try:
        from numba import config, cuda
    except ImportError:
        return ""
    if getattr(config, "ENABLE_CUDASIM", False) or not cuda.is_available():
        return ""
    name = cuda.get_current_device().name
    return name.decode() if isinstance(name, bytes) else str(name)


def table(count: int) -> list[Case]:
    """Cases of one model: clearances and speeds side by side."""
    rng = np.random.default_rng(1)
    draws = zip(rng.uniform(5e-5, 5e-4, count), rng.uniform(40.0, 80.0, count), strict=True)
    return [Case(Fault({"B": float(c)}), {"drive.speed": float(speed)}) for c, speed in draws]


def timed(machine: Machine, cases: list[Case], settings: Settings) -> tuple[list[History], float]:
    """Histories, and the seconds from call to return."""
    began = time.perf_counter()
    histories = simulate_batch(machine, cases, settings)
    return histories, time.perf_counter() - began


def report(name: str, histories: list[History], seconds: float) -> None:
    """One line: integration alone, and everything with preparation and filters, which the processor does."""
    integrating = sum(history.seconds for history in histories)
    simulated = SIMULATED * len(histories)
    print(f"{name:32s} {len(histories):5d} cases: integration {integrating / simulated:.2e} s, "
          f"all {seconds / simulated:.2e} s per simulated second")  # fmt: skip


def main() -> None:
    """Measure and print."""
    device = device_name()
    if not device:
        print("no CUDA device: nothing measured")
        return
    machine = load_machine(Path(__file__).parents[1] / "tests/data/reference/p1.yaml")
    print(f"{device}; {platform.processor() or platform.machine()}, Python {platform.python_version()}")
    settings = {name: Settings(duration=SIMULATED, device=name) for name in ("cpu", "cuda")}
    for name, one in settings.items():
        print(f"{name}: first case, with compilation: {timed(machine, table(1), one)[1]:.1f} s")
    lanes, seconds = timed(machine, table(CASES[0]), settings["cpu"])
    report("one core, eight lanes", lanes, seconds)
    for count in CASES:
        histories, seconds = timed(machine, table(count), settings["cuda"])
        report(device, histories, seconds)
        if count == CASES[0]:
            gaps = [
                np.abs(ours.displacement - theirs.displacement).max() / np.abs(theirs.displacement).max()
                for ours, theirs in zip(histories, lanes, strict=True)
            ]
            print(f"{'':32s} largest difference of a displacement from the lanes: {max(gaps):.1e} of its largest")


if __name__ == "__main__":
    main()
