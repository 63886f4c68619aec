"""Damaged recordings by the thousand: `make fuzz-readers`, or `PYTHONPATH=tests python -m fuzz.readers --count 10000`.

Every file must be read as what it is or refused in one line; never a crash, never longer than its time, and what is
accepted is finite, of a positive sample rate, and, of a file that was cut, as long as it says; text and universal
files excepted, whose end nobody can miss.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

import numpy as np
from fuzz.files import MUTATIONS, SIGNAL, cut, whole_files

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.measurements.readers import Limits

LIMITS = Limits(file_bytes=5_000_000, decoded_bytes=20_000_000, reader_memory=400_000_000, reader_seconds=5.0)
#: Kinds whose end can be missing without anybody being able to tell: lines of text, records of a universal file.
OPEN_ENDED = (".csv", ".uff")


def ending(name: str, data: bytes, mutation: str, longest_s: float = float("inf")) -> str:
    """Read one file and say how that ended: read, refused, or what is wrong with that.

    How long it took is judged only by who has the computer to itself: on a busy one a time says nothing.
    """
    given = {"units": {"ch1": "g", "ch2": "g"}} if name == "FLOAT.wav" else {}
    profile = ImportProfile(full_scale="8 g") if name == "PCM_16.wav" else None
    began = time.monotonic()
    try:
        found = read_measurement(data, name=name, limits=LIMITS, profile=profile, **given)  # type: ignore[arg-type]
    except MeasurementError as error:
        text = str(error)
        verdict = "refused" if "\n" not in text and len(text) > len(name) else f"WRONG refusal: {text!r}"
    except Exception as error:
        verdict = f"WRONG crash: {type(error).__name__}: {error}"
    else:
        verdict = "read"
        if not (np.isfinite(found.signal).all() and len(found.signal) >= LIMITS.min_samples):
            verdict = "WRONG: not finite, or too short"
        elif not (np.isfinite(found.sample_rate) and found.sample_rate > 0):
            verdict = "WRONG: sample rate"
        elif found.signal.nbytes > LIMITS.decoded_bytes:
            verdict = "WRONG: larger than is read"
        elif mutation == cut.__name__ and not name.endswith(OPEN_ENDED) and len(found.signal) != len(SIGNAL):
            verdict = f"WRONG: {len(found.signal)} samples of a file that was cut"
    if time.monotonic() - began > longest_s:
        verdict = f"WRONG: took {time.monotonic() - began:.1f} s"
    return verdict


def campaign(count: int, seed: int, seconds: float = float("inf"), longest_s: float = float("inf")) -> Counter[str]:
    """Read `count` damaged files, or as many as the time allows; return how often each ending came up."""
    files, random = whole_files(), np.random.default_rng(seed)
    names = list(files)
    found: Counter[str] = Counter()
    until = time.monotonic() + seconds
    for number in range(count):
        if time.monotonic() > until:
            break
        name = names[number % len(names)]
        mutation = MUTATIONS[random.integers(0, len(MUTATIONS))]
        data = mutation(random, files[name])
        verdict = ending(name, data, mutation.__name__, longest_s)
        found[verdict if verdict in ("read", "refused") else f"{verdict} ({name}, {mutation.__name__}, {number})"] += 1
    return found


def main() -> int:
    """Run a campaign, print its endings, return 1 if one of them is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    longest_s = LIMITS.reader_seconds + 3.0
    parser.add_argument("--longest", type=float, default=longest_s, help="longest time for one file, in seconds")
    given = parser.parse_args()
    began = time.monotonic()
    found = campaign(given.count, given.seed, given.seconds, given.longest)
    for verdict, times in found.most_common():
        print(f"{times:6d}  {verdict}")
    print(f"{found.total()} files in {time.monotonic() - began:.0f} s, seed {given.seed}")
    return int(any(verdict.startswith("WRONG") for verdict in found))


if __name__ == "__main__":
    sys.exit(main())
