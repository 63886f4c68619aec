"""What a common answer to recordings of one machine costs beside single ones: processor seconds, models in memory.

    python -m second_simulator --protocol pairs --machine slider-crank --count 3 --out recordings [--factor 0.8]
    python -m benchmarks.together recordings --catalogue DIR [--effort fast]

Of each machine that has several recordings the common answer, the single ones, and its ratio to their mean; of four
askings the least counts, and the first are not measured.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from jointplay.catalogue.diagnosing.together import diagnose_together
from jointplay.catalogue.matching.modes import Effort
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum, read_recording
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.storage.store import Catalogue

ASKED = 4


def seconds(recordings: Sequence[Recording | MeasuredSpectrum], catalogue: Catalogue, effort: Effort) -> float:
    """Processor seconds of an answer whose models are in memory."""
    found = []
    for _ in range(1 + ASKED):
        began = time.process_time()
        diagnose_together(recordings, catalogue, effort=effort)
        found.append(time.process_time() - began)
    return min(found[1:])


def main() -> None:
    """Print one line a machine, and the ratio of all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--catalogue", type=Path, required=True)
    parser.add_argument("--effort", default="standard", choices=["fast", "standard", "thorough"])
    given = parser.parse_args()
    catalogue = Catalogue.open(given.catalogue)
    machines: dict[str, list[Path]] = defaultdict(list)
    for name, truth in sorted(json.loads((given.recordings / "truth.json").read_text()).items()):
        machines[truth.get("of") or name].append(given.recordings / f"{name}.npz")
    every = []
    for name, files in machines.items():
        read = [read_recording(file) for file in files]
        single = [seconds([each], catalogue, given.effort) for each in read]
        common = seconds(read, catalogue, given.effort)
        every.append((common, statistics.mean(single)))
        told = ", ".join(f"{each:.2f}" for each in single)
        print(f"{name}: {common:.2f} s together, {told} s alone: x {common / every[-1][1]:.2f}", flush=True)
    print(f"all: x {sum(common for common, _ in every) / sum(mean for _, mean in every):.2f}")


if __name__ == "__main__":
    main()
