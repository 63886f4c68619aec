"""The computer that measures: what it is, what is installed, how busy it was."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
import time
from collections.abc import Callable
from datetime import date
from pathlib import Path

from jointplay.solver.compiler.native import processor

#: Packages whose versions matter to what is measured; the last ones are the peers.
PACKAGES = ("jointplay", "numpy", "numba", "llvmlite", "casadi", "scipy", "scikit-sundae", "exudyn", "mujoco-core")


def installed(package: str) -> str | None:
    """Its version, or ``None``."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _model_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def description() -> dict[str, object]:
    """For the head of the page."""
    name, features = processor()
    vectors = "AVX-512" if "+avx512f" in features else "AVX2" if "+avx2" in features else "SSE2 or other"
    return {
        "date": date.today().isoformat(),
        "processor": _model_name(),
        "architecture": f"{name}, {vectors}",
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "load": [round(x, 2) for x in os.getloadavg()],
        "versions": {package: installed(package) for package in PACKAGES},
    }


def peak_memory() -> float:
    """Of this process, MB; of an operating system that does not tell, NaN.

    Not ``getrusage``: its peak of a child starts with what the parent had.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return math.nan
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), math.nan)


def processor_seconds(work: Callable[[], object], rounds: int = 1) -> float:
    """Least processor time of several rounds: other work on the machine only ever adds to it."""
    least = float("inf")
    for _ in range(rounds):
        began = time.process_time()
        work()
        least = min(least, time.process_time() - began)
    return least
