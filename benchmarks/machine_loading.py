"""How long a machine file takes from text to a checked machine: the bound is 50 ms."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from jointplay.solver.machines.machine import parse_machine, shipped_machine_text
from jointplay.solver.machines.yamlfile import read_tree


def measure(quick: bool, say: Callable[[str], None]) -> list[dict[str, object]]:
    """Milliseconds (median of 20) of reading the YAML, and of everything."""
    rows = []
    for name in ("four-bar", "quick-return", "slider-crank"):
        text = shipped_machine_text(name)
        row: dict[str, object] = {"machine": name}
        for what, work in (("read", read_tree), ("all", parse_machine)):
            times = []
            for _ in range(5 if quick else 20):
                start = time.perf_counter()
                work(text, name)
                times.append(1e3 * (time.perf_counter() - start))
            row[what] = statistics.median(times)
        rows.append(row)
        say(f"loading: {name}: {row['all']:.1f} ms")
    return rows
