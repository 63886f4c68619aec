"""What a catalogue with three speeds costs beside one with a single speed: processor seconds, and their ratios.

``python -m benchmarks.three_speeds [--machine slider-crank] [--draws 192] [--folder DIR]``

Both have the same draws of the machine in order, of single worn joints and of pairs. Each is built in new processes:
with a few draws, for which kernels are compiled; with all others; then its networks are trained. One thread.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.matching import THREADS
from jointplay.catalogue.building.build import build
from jointplay.catalogue.building.network_building import train_networks
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.solver.machines.machine import shipped_machine

SPEEDS = {"one": [1.0], "three": [0.8, 1.0, 1.2]}
FEW = 8
PARTS = ("kernels, and a few cases", "all other cases", "networks")


def spend(machine: str, plan: str, folder: str) -> list[float]:
    """Go on with a catalogue; return the processor seconds of its cases, and of its networks where there are such."""
    used = [time.process_time()]
    build(shipped_machine(machine), parse_plan(json.loads(plan)), folder, workers=0)
    used.append(time.process_time())
    train_networks(Path(folder))
    used.append(time.process_time())
    return [then - before for before, then in itertools.pairwise(used)]


def measured(machine: str, name: str, draws: int, folder: Path) -> list[float]:
    """Processor seconds of each part for a plan with some speeds."""
    found: list[float] = []
    for count in (FEW, draws):
        plan = {
            "name": name,
            "hypotheses": ["healthy", "singles", "pairs"],
            "draws": {"healthy": count, "single": count, "pair": count},
            "speeds": SPEEDS[name],
            "sample_rate": "12 kHz",  # what the bands of the fastest speed need
        }
        asked = [sys.executable, "-m", "benchmarks.three_speeds", "--machine", machine, "--build", json.dumps(plan)]
        own = dict.fromkeys(THREADS, "1") | {"JOINTPLAY_CACHE_DIR": str(folder / f"kernels-{name}")}
        told = subprocess.run(
            [*asked, "--folder", str(folder / name)], check=True, env=os.environ | own, stdout=subprocess.PIPE
        )
        found += json.loads(told.stdout)
    few, _, others, networks = found  # a few cases train no networks
    return [few, others, networks]


def main() -> None:
    """Print what each part takes with one speed and with three, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="slider-crank", help="a shipped one")
    parser.add_argument("--draws", type=int, default=192, help="of each hypothesis")
    parser.add_argument("--folder", type=Path, help="where the catalogues stay; nowhere without it")
    parser.add_argument("--build", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.build:
        print(json.dumps(spend(given.machine, given.build, str(given.folder))))
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        one, three = (measured(given.machine, name, given.draws, folder) for name in SPEEDS)
    for part, each, all_three in zip(("whole", *PARTS), (sum(one), *one), (sum(three), *three), strict=True):
        print(f"{part}: one speed {each:.1f} s, three {all_three:.1f} s: x {all_three / each:.2f}")


if __name__ == "__main__":
    main()
