"""Lives of machines by the second simulator of the tests: what single answers and the state of wear say, and the truth.

    PYTHONPATH=tests python -m second_simulator --protocol lives --machine slider-crank --count 180 --out recordings
    python -m benchmarks.lives recordings --catalogues DIR [--effort thorough] [--answers answers.jsonl]

Every recording is diagnosed by itself, and, with that effort, beside the first ones of its machine; answers are kept in
a file, one a line, so that judging again costs little and what was broken off goes on. Figures are those of `jointplay
evaluate --protocol lives`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from jointplay.app.tables import table
from jointplay.catalogue.diagnosing.answer import Diagnosis, Evidence
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.errors import CatalogueError
from jointplay.catalogue.evaluation.life_figures import Life, LifeVisit, figures_of_lives, judge_life
from jointplay.catalogue.evaluation.lives import BASELINES
from jointplay.catalogue.following.play import bounds_of
from jointplay.catalogue.following.visits import Inspection
from jointplay.catalogue.matching.modes import Effort
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.storage.store import Catalogue

UM = 1e-6


def told(
    folder: Path, catalogues: Path, kept: Path, only: str, effort: Effort
) -> Iterator[tuple[Catalogue, list[Life]]]:
    """Yield the lives of every machine that has a catalogue, diagnosing what has no answer yet."""
    truths = {
        name: truth for file in folder.rglob("truth.json") for name, truth in json.loads(file.read_text()).items()
    }
    answers = {}
    if kept.exists():
        answers = {line["name"]: line for line in map(json.loads, kept.read_text().splitlines())}
    machines: dict[str, list[str]] = defaultdict(list)
    for name, truth in sorted(truths.items(), key=lambda each: _place(each[1])):
        if only in name and "life" in truth and (catalogues / truth["machine"]).is_dir():
            machines[truth["machine"]].append(name)
    for machine, names in machines.items():
        catalogue = Catalogue.open(catalogues / machine)
        lives: dict[int, list[str]] = defaultdict(list)
        with kept.open("a") as out:
            for name in names:
                own = lives[truths[name]["life"]["number"]]
                own.append(name)
                if name not in answers:
                    first = [next(folder.rglob(f"{each}.npz")) for each in own[:BASELINES] if each != name]
                    answers[name] = _diagnose(name, next(folder.rglob(f"{name}.npz")), first, catalogue, effort)
                    print(json.dumps(answers[name]), file=out, flush=True)
        yield (
            catalogue,
            [
                _life(f"{machine} {number}", [truths[name] for name in each], [answers[name] for name in each])
                for number, each in lives.items()
            ],
        )


def _place(truth: Mapping[str, Any]) -> tuple[int, int]:
    """Life and visit."""
    return (truth["life"]["number"], truth["life"]["visit"]) if "life" in truth else (0, 0)


def _diagnose(name: str, file: Path, first: list[Path], catalogue: Catalogue, effort: Effort) -> dict[str, Any]:
    """One line: name, checksum, seconds, and the answers without their evidence, or why there is none."""
    began = time.perf_counter()
    found: dict[str, Any]
    recording = read_recording(file)
    baseline = [read_measurement(each) for each in first]
    try:
        alone = diagnose(recording, catalogue)
        answer = diagnose(recording, catalogue, effort=effort, baseline=baseline) if baseline else alone
        found = {
            what: each.model_copy(update={"evidence": Evidence(orders=(), bands=())}).model_dump(mode="json")
            for what, each in (("answer", answer), ("alone", alone))
        }
    except CatalogueError as error:
        found = {"answer": None, "refusal": str(error)}
    seconds = round(time.perf_counter() - began, 3)
    print(f"{name}: {seconds:.1f} s", file=sys.stderr, flush=True)
    return {"name": name, "sha256": recording.sha256, "seconds": seconds, **found}


def _life(name: str, truths: list[Mapping[str, Any]], answers: list[Mapping[str, Any]]) -> Life:
    """A life from what is written beside its recordings."""
    visits, inspections, repairs, mount = [], [], [], None
    for place, (truth, said) in enumerate(zip(truths, answers, strict=True)):
        life = truth["life"]
        visits.append(
            LifeVisit(
                at=datetime.fromisoformat(life["measured_at"]),
                sha256=said["sha256"],
                clearances={joint: UM * um for joint, um in truth["clearances_um"].items()},
                answer=None if said["answer"] is None else Diagnosis.model_validate(said["answer"]),
                arrivals=tuple(life["arrivals"]),
                alone=None if said["answer"] is None else Diagnosis.model_validate(said["alone"]),
            )
        )
        if life["repaired"]:
            repairs.append((place, life["repaired"]))
        if found := life["finding"]:
            clearance = {found["joint"]: UM * found["measured_um"]}
            inspections.append(
                Inspection(datetime.fromisoformat(found["at"]), clearance, frozenset([found["joint"]]), "finding")
            )
        mount = life["mount"]
    loosening = f"mount {mount['place']}" if mount and mount["factor"] < 1 else ""
    return Life(name, tuple(visits), tuple(inspections), tuple(repairs), loosening)


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--catalogues", type=Path, required=True, help="folder with one catalogue a machine")
    parser.add_argument("--answers", type=Path, help="file of answers; answers-EFFORT.jsonl in the folder")
    parser.add_argument("--effort", choices=("fast", "standard", "thorough"), default="standard")
    parser.add_argument("--only", default="", help="recordings with this in their name")
    given = parser.parse_args()
    kept = given.answers or given.recordings / f"answers-{given.effort}.jsonl"
    judged = []
    for catalogue, lives in told(given.recordings, given.catalogues, kept, given.only, given.effort):
        bounds = bounds_of(catalogue.machine, catalogue.machine.wearing_joints)
        judged += [judge_life(life, bounds) for life in lives]
    if judged:
        print(table(("figure", "seen", "95 %"), [each.shown() for each in figures_of_lives(judged)]))
    return 0 if judged else 1


if __name__ == "__main__":
    sys.exit(main())
