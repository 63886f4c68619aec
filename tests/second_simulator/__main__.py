"""``python -m second_simulator --protocol singles --machine four-bar --count 12 --out recordings``: make recordings.

What is there already is kept, so that the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from second_simulator.machine_file import read
from second_simulator.protocols import PROTOCOLS
from second_simulator.recording import write


def main() -> None:
    """Write recordings and their truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--protocol", choices=[*PROTOCOLS], required=True)
    parser.add_argument("--machine", required=True, help="name of a shipped machine, or a machine file")
    parser.add_argument("--count", type=int, default=1, help="recordings; 16 of growing wear are a series, 30 a life")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--before", action="store_true", help="of the same machines, before anything was the matter")
    parser.add_argument("--factor", type=float, default=1.0, help="on the drive speed, of the same machines once more")
    parser.add_argument(
        "--course", default="", help="of the same machines once more, times [s] and factors: 0:0.7,30:1.3"
    )
    parser.add_argument("--model-errors", action="store_true", help="all errors of model and sensors at once")
    given = parser.parse_args()
    course = [
        (float(at), float(factor))
        for at, _, factor in (each.partition(":") for each in given.course.split(",") if each)
    ]
    if not 0.1 <= given.factor <= 10.0:
        parser.error(f"--factor: {given.factor:g}: must be from 0.1 to 10")
    machine = read(given.machine)
    for number in range(1, given.count + 1):
        began = time.perf_counter()
        asked = (machine, given.protocol, number, given.seed, given.out)
        name, made = write(
            *asked, before=given.before, factor=given.factor, course=course, model_errors=given.model_errors
        )
        print(f"{name}: {f'{time.perf_counter() - began:.1f} s' if made else 'kept'}", flush=True)


if __name__ == "__main__":
    main()
