"""How often promises of suggestions come true: a recording at another speed or load, and what both together then say.

    python -m second_simulator --protocol pairs --machine slider-crank --count 8 --out recordings [--factor 0.8]
    python -m second_simulator --protocol held-shut --machine slider-crank --count 24 --out recordings
    python -m benchmarks.promises recordings --catalogues DIR [--before DIR]

Every recording of a machine that has some at several speeds or loads is answered by itself; for each of these that it
suggests, of which there is a recording, the promise (share of mistakes) is compared with whether the common answer
names the worn joints, and with how probable that answer holds them. Recordings from before, of the same names, serve as
baselines.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.real_machines import interval, recorded_before
from jointplay.app.tables import table
from jointplay.catalogue.diagnosing.answer import Suggestion
from jointplay.catalogue.diagnosing.heard import Heard
from jointplay.catalogue.diagnosing.hearing import hear
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.telling import tell
from jointplay.catalogue.diagnosing.together import conclude
from jointplay.catalogue.matching.model_library import library_of
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum, read_recording
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.plans.day_load import DayLoad, loads_held
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue

QUESTION = Question()
#: Ends of the classes of promised probabilities of being right.
CLASSES = (0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


class Promise(NamedTuple):
    """Promised and then held probability of the answer, probability of the truth, and whether it is the answer."""

    name: str
    now: float
    promised: float
    held: float
    true: float
    right_now: bool
    right: bool


def promises(folder: Path, catalogues: Path, before: Path | None = None) -> list[Promise]:
    """Ask each recording for another speed or load, and take it; beside what was recorded before.

    Ends the program where one of these is missing.
    """
    opened: dict[str, Catalogue] = {}
    found = []
    for truth_file in sorted(folder.rglob("truth.json")):
        machines: dict[str, list[str]] = defaultdict(list)
        truths = json.loads(truth_file.read_text())
        for name, truth in sorted(truths.items()):
            if truth_file.with_name(f"{name}.npz").exists() and (catalogues / truth["machine"]).is_dir():
                machines[truth.get("of", name)].append(name)
        for names in machines.values():
            worn = frozenset(truths[names[0]]["worn_um"])
            machine = truths[names[0]]["machine"]
            catalogue = opened.setdefault(machine, Catalogue.open(catalogues / machine))
            earlier = [] if before is None else [recorded_before(before, f"{name}.npz") for name in names]
            past = {each.sha256: _prepared(each, catalogue) for each in map(read_measurement, earlier)}
            known = KnownMachine.of(past, catalogue) if past else None
            heard = {name: _heard(truth_file.with_name(f"{name}.npz"), catalogue, known) for name in names}
            for name, other in itertools.permutations(names, 2):
                alone = tell(heard[name], catalogue, QUESTION, library_of(catalogue), suggesting=True)
                asked = [each for each in alone.suggestions if is_of(each, truths[other])]
                if not asked:
                    continue
                # With fast nothing more is suggested, which would cost as much again.
                both = conclude([heard[name], heard[other]], catalogue, Question("fast"), library_of(catalogue))
                true = sum(each.probability for each in both.hypotheses if frozenset(each.joints) == worn)
                first, then = alone.hypotheses[0], both.hypotheses[0]
                now, right = frozenset(first.joints) == worn, frozenset(then.joints) == worn
                row = (1 - asked[0].error_now, 1 - asked[0].error, then.probability, true)
                found.append(Promise(f"{name} + {other}", *row, now, right))
                print(found[-1], file=sys.stderr, flush=True)
    return found


def _prepared(recording: Recording | MeasuredSpectrum, catalogue: Catalogue) -> PreparedMeasurement:
    """Prepare a recording for a catalogue of its machine."""
    scale = (catalogue.scheme, catalogue.recipe.nominal_drive_speed, catalogue.drive_speeds)
    return prepare(recording, catalogue.machine, None, None, *scale)


def _heard(file: Path, catalogue: Catalogue, known: KnownMachine | None) -> Heard:
    recording = read_recording(file)
    library = library_of(catalogue)
    return hear(_prepared(recording, catalogue), recording.sha256, catalogue, QUESTION, library, known=known)


def is_of(suggestion: Suggestion, truth: Mapping[str, Any]) -> bool:
    """Whether a recording is at the suggested speed, or under the suggested load."""
    if suggestion.kind == "speed":
        return abs(math.log(float(suggestion.what.removesuffix(" rpm")) / truth["speed_rpm"])) < 0.05
    load = truth.get("load_n")
    if suggestion.kind == "load" and isinstance(load, Mapping):
        unit = "torque" if suggestion.what.endswith("m") else "force"
        asked = DayLoad.model_validate({unit: suggestion.what})
        return int(loads_held([asked], np.array([float(load["constant"])]))[0]) == 0
    return False


def main() -> int:
    """Print promises by class."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--catalogues", type=Path, required=True, help="folder with one catalogue a machine")
    parser.add_argument("--before", type=Path, help="recordings of the same names from before, as baselines")
    given = parser.parse_args()
    found = promises(given.recordings, given.catalogues, given.before)
    rows = []
    for low, high in [*itertools.pairwise(CLASSES), (0.0, 1.0)]:
        inside = [each for each in found if low < each.promised <= high]
        if inside:
            right = sum(each.right for each in inside)
            seen = interval(right, len(inside))
            means = [f"{np.mean([getattr(each, name) for each in inside]):.3f}" for name in ("now", "promised", "held")]
            loss = -np.mean([math.log(max(each.true, 1e-6)) for each in inside])
            before = sum(each.right_now for each in inside)
            rows.append((f"{low:g} to {high:g}", *means, f"{before} of {len(inside)}", f"{right} of {len(inside)}",
                         f"{seen[0]:.2f} to {seen[1]:.2f}", f"{loss:.3f}"))  # fmt: skip
    head = (
        "promised",
        "mean now",
        "promised",
        "then held",
        "right before",
        "right then",
        "95 %",
        "log-loss of the set",
    )
    print(table(head, rows))
    return 0 if found else 1


if __name__ == "__main__":
    sys.exit(main())
