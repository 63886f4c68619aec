"""Diagnoses of recordings made by other code, beside what they were made with: tests/data/recordings.

    jointplay build quick-return --catalogue cat/quick-return --plan standard    (and slider-crank, four-bar)
    python -m benchmarks.samples cat

Files in other clothes (WAV, UFF, MAT, TDMS, decimal commas, a spectrum) stand below: each must say what
the plain one does.

Exit status 1 where a rule is broken: every single worn joint is the first hypothesis, the joints of double faults are
within the first two, a loosened mount is a change or unknown, machines in order are in order.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from jointplay.app.tables import table
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.storage.store import Catalogue

#: The same data as the plain file of that number.
OTHER_CLOTHES = (
    "four-bar-02-decimal-comma.csv.gz",
    "four-bar-02-spectrum.csv.gz",
    "slider-crank-02.wav.gz",
    "slider-crank-03.uff.gz",
    "slider-crank-04.mat.gz",
    "slider-crank-05.tdms.gz",
)
RECORDINGS = Path(__file__).parents[1] / "tests" / "data" / "recordings"


@dataclass(frozen=True)
class Judged:
    """One recording: what it is of, what was answered, and whether that is right."""

    name: str
    truth: Mapping[str, Any]
    answer: Diagnosis
    right: bool


def is_right(truth: Mapping[str, Any], answer: Diagnosis) -> bool:
    """Say whether an answer keeps the rules above."""
    worn = frozenset(truth["worn_um"])
    if truth["other_cause"]:
        return answer.verdict in ("changed", "unknown")
    if not worn:
        return answer.verdict == "in_order"
    if len(worn) == 1:
        return answer.verdict == "worn" and frozenset(answer.hypotheses[0].joints) == worn
    named = [frozenset(hypothesis.joints) for hypothesis in answer.hypotheses[:2]]
    return answer.verdict == "worn" and worn <= frozenset().union(*named)


def judged(catalogues: Path, machine: str | None, effort: Effort, mode: ModeAsked) -> list[Judged]:
    """Diagnose all recordings of the machines that have a catalogue."""
    found = []
    opened: dict[str, Catalogue] = {}
    for name, truth in json.loads((RECORDINGS / "truth.json").read_text()).items():
        folder = catalogues / truth["machine"]
        if not folder.is_dir() or machine not in (None, truth["machine"]):
            continue
        catalogue = opened.setdefault(truth["machine"], Catalogue.open(folder)) if folder else None
        assert catalogue is not None
        answer = diagnose(read_recording(RECORDINGS / f"{name}.csv.gz"), catalogue, effort=effort, mode=mode)
        found.append(Judged(name, truth, answer, is_right(truth, answer)))
        for other in (file for file in OTHER_CLOTHES if file.startswith(name)):
            again = diagnose(read_recording(RECORDINGS / other), catalogue, effort=effort, mode=mode)
            found.append(Judged(other.removesuffix(".gz"), truth, again, says_the_same(answer, again)))
    return found


def says_the_same(plain: Diagnosis, other: Diagnosis) -> bool:
    """Say whether two answers name the same verdict and joints, and clearances within each other's intervals."""
    first, second = plain.hypotheses[0].joints, other.hypotheses[0].joints
    return (
        plain.verdict == other.verdict
        and set(first) == set(second)
        and all(
            second[joint].interval_um[0] <= each.clearance_um <= second[joint].interval_um[1]
            for joint, each in first.items()
        )
    )


def row(item: Judged) -> tuple[str, ...]:
    """Return one line of the table."""
    answer, truth = item.answer, item.truth
    worn = ", ".join(f"{joint} {um:.0f}" for joint, um in truth["worn_um"].items())
    first = answer.hypotheses[0]
    ranking = ", ".join(f"{each.label} {each.probability:.3f}" for each in answer.hypotheses[:3])
    found = ", ".join(f"{joint} {each.clearance_um:.0f}" for joint, each in first.joints.items())
    trusted = answer.mode.trusted_p_value
    return (
        item.name,
        worn or truth["other_cause"] or "in order",
        truth["contact"]["law"],
        "yes" if item.right else "NO",
        answer.verdict,
        ranking,
        found or "-",
        answer.mode.used,
        "-" if trusted is None else f"{trusted:.3f}",
        f"{answer.goodness_of_fit.p_value:.3f}",
        str(answer.effort_spent.simulations),
    )


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("catalogues", type=Path, help="folder with one catalogue a machine, named like it")
    parser.add_argument("--machine", help="only this one")
    parser.add_argument("--effort", choices=("fast", "standard", "thorough"), default="standard")
    parser.add_argument("--mode", choices=("auto", "trusted", "robust"), default="auto")
    given = parser.parse_args()
    found = judged(given.catalogues, given.machine, cast(Effort, given.effort), cast(ModeAsked, given.mode))
    head = ("recording", "truth [um]", "contact", "right", "verdict", "first three", "clearance [um]")
    head += ("mode", "trusted p", "p", "simulated")  # type: ignore[assignment]
    print(table(head, [row(item) for item in found]))
    right = sum(item.right for item in found)
    print(f"{right} of {len(found)} right")
    return 0 if found and right == len(found) else 1


if __name__ == "__main__":
    sys.exit(main())
