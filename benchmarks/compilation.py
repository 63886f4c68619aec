"""What a new process pays before its first result, and what the caches on disk save."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from typing import Any

#: The integrators are compiled at the first run of any machine; a four-bar takes that upon itself.
_PROGRAM = """
import json, sys, time
began = time.process_time()
from benchmarks.computer import peak_memory
from benchmarks.scenes import p1, quick_return
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.simulate import simulate_batch
spent = {"import_s": time.process_time() - began}
scene = {"P1": p1, "QR": quick_return}[sys.argv[1]]()
short = Settings(duration=0.01)
for name, machine, case in (("other_s", shipped_machine("four-bar"), Case()), ("first_s", scene.machine, scene.case)):
    began = time.process_time()
    simulate_batch(machine, [case], short)
    spent[name] = time.process_time() - began
simulate_batch(scene.machine, [scene.case] * int(sys.argv[2]), Settings(duration=scene.duration))
spent["peak_mb"] = peak_memory()
print(json.dumps(spent))
"""


def _run(scene: str, cases: int, folder: str) -> dict[str, Any]:
    """In a process of its own, with both caches (kernels, and Numba's of the integrators) in `folder`."""
    environment = {**os.environ, "JOINTPLAY_CACHE_DIR": folder, "NUMBA_CACHE_DIR": folder}
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, scene, str(cases)], env=environment, check=True, capture_output=True, text=True
    )
    return dict(json.loads(done.stdout))


def measure(quick: bool, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """P1 and QR, each with empty caches, then with what that left."""
    rows = []
    for scene in ("P1", "QR"):
        with tempfile.TemporaryDirectory() as folder:
            for cache in ("empty", "filled"):
                row = {"scene": scene, "cache": cache, **_run(scene, 8, folder)}
                rows.append(row)
                say(f"compilation: {scene}, caches {cache}: another machine first {row['other_s']:.2f} s, "
                    f"then this one {row['first_s']:.2f} s")  # fmt: skip
            if not quick and scene == "P1":
                rows.append({"scene": "P1, 200 cases", "cache": "filled", **_run("P1", 200, folder)})
    return rows
