"""Measure, keep the results, write the page: ``python -m benchmarks [--quick] [--only SECTION ...] [--out FOLDER]``.

Results are kept as JSON beside the page, section by section, so that one section can be measured again alone; the page
and its plots are written from that file and nothing else.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import arithmetic, compilation, integrators, machine_loading, page, problem, scaling, throughput
from benchmarks.comparison import compare
from benchmarks.computer import description, installed
from benchmarks.programs import on_p1, on_quick_return
from benchmarks.scenes import p1, quick_return

Say = Callable[[str], None]

_DOCS = Path(__file__).parents[1] / "docs" / "measured"


def rounds(quick: bool) -> int:
    """Of the comparisons."""
    return 1 if quick else 5


def _p1(quick: bool, say: Say) -> Any:
    scene = p1()
    return compare(scene, on_p1(scene, quick), rounds(quick), say)


def _quick_return(quick: bool, say: Say) -> Any:
    scene = quick_return()
    tight = integrators.cvode if installed("scikit-sundae") else integrators.lsoda
    equations = problem.from_equations(scene)
    confirmed = scene.error(tight(equations, scene.duration, 1e-12))
    say(f"QR: reference confirmed to {confirmed:.2g} dB")
    return {
        "confirmed": confirmed,
        "curves": compare(scene, on_quick_return(scene, equations, quick), rounds(quick), say),
    }


SECTIONS: dict[str, Callable[[bool, Say], Any]] = {
    "p1": _p1,
    "qr": _quick_return,
    "throughput": throughput.measure,
    "arithmetic": arithmetic.measure,
    "links": scaling.links,
    "clearances": scaling.clearances,
    "compilation": compilation.measure,
    "loading": machine_loading.measure,
}


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measures cost and accuracy.")
    parser.add_argument("--quick", action="store_true", help="a smoke test: few cases, cheap peers, nothing kept")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--out", type=Path, default=_DOCS, help="folder of the page (default: docs/measured)")
    parser.add_argument("--page", action="store_true", help="measure nothing, write the page from the kept results")
    options = parser.parse_args()
    kept = options.out / "benchmarks" / "results.json"
    results: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() and not options.quick else {}
    began = time.monotonic()

    def say(line: str) -> None:
        print(f"[{time.monotonic() - began:5.0f} s] {line}", flush=True)

    wanted = [] if options.page else options.only or list(SECTIONS)
    for name in wanted:
        say(f"== {name}")
        results[name] = {"computer": description(), "found": SECTIONS[name](options.quick, say)}
        if not options.quick:
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n")
    if options.quick:
        print("\n".join(page.lines(results)))
    else:
        page.write(results, options.out)
        say(f"written: {options.out / 'benchmarks.md'}")


if __name__ == "__main__":
    main()
