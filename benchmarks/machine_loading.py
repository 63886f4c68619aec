"""How long a machine file takes from text to a checked machine: the bound is 50 ms."""

from __future__ import annotations

import statistics
import time

from solver.machine import parse_machine, shipped_machine_names, shipped_machine_text
from solver.yamlfile import read_tree


def main() -> None:
    """Print milliseconds (median of 20) of reading the YAML, and of everything."""
    for name in shipped_machine_names():
        text = shipped_machine_text(name)
        times: dict[str, list[float]] = {"read": [], "all": []}
        for _ in range(20):
            for what, work in (("read", read_tree), ("all", parse_machine)):
                start = time.perf_counter()
                work(text, name)
                times[what].append(1e3 * (time.perf_counter() - start))
        print(f"{name:14}" + "".join(f"  {what} {statistics.median(ms):5.1f} ms" for what, ms in times.items()))


if __name__ == "__main__":
    main()
