"""Lives of machines by the second simulator of the tests: what single answers and the state of wear say, and the truth.

    PYTHONPATH=tests python -m second_simulator --protocol lives --machine slider-crank --count 180 --out recordings
    python -m benchmarks.lives answers.jsonl --recordings recordings --catalogues DIR --effort thorough
    python -m benchmarks.lives tests/data/lives.jsonl.gz [--alone thorough]

Every recording is diagnosed by itself with the effort `--alone`, and beside the first ones of its machine with
`--effort`, the first ones beside each other with `standard`. Answers are kept in a file, one a line with what is true
beside it, so that what was broken off goes on, answers of a further effort are added, and another state of wear is
judged by the same answers in seconds. Figures are those of `jointplay evaluate --protocol lives`.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
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
from jointplay.solver.errors import SolverError
from jointplay.solver.machines.machine import shipped_machine

UM = 1e-6

Line = Mapping[str, Any]
"""Name and checksum of a recording, its truth, and the answers to it or why there is none.

`answer` is beside the first recordings; `alone` has those to the recording by itself, by their effort.
"""


def read_lines(answers: Path) -> list[Line]:
    """Return the lines of a file of answers, compressed or not: of each recording the last.

    Raises
    ------
    SystemExit
        A line has no truth, as those of earlier versions.
    """
    content = answers.read_bytes()
    content = gzip.decompress(content) if answers.suffix == ".gz" else content
    lines = [json.loads(line) for line in content.splitlines()]
    for line in lines:
        if "truth" not in line:
            raise SystemExit(f"{answers}: {line['name']}: no truth: must stand beside the answer; diagnose again")
    return list({line["name"]: line for line in lines}.values())


def lives_of(lines: Sequence[Line], alone: Effort = "standard") -> dict[str, list[Life]]:
    """Return the lives of each machine, by its name, that have single answers of that effort; tell what has none."""
    grouped: dict[tuple[str, int], list[Line]] = defaultdict(list)
    for line in sorted(lines, key=lambda each: _place(each["truth"])):
        grouped[line["truth"]["machine"], line["truth"]["life"]["number"]].append(line)
    lives: dict[str, list[Life]] = defaultdict(list)
    for (machine, number), own in grouped.items():
        if lacking := [line["name"] for line in own if line["answer"] and alone not in line["alone"]]:
            said = f"{lacking[0]} has no single answer of effort {alone}"
            print(f"left out: {machine} {number}: {said}", file=sys.stderr)
            continue
        lives[machine].append(_life(f"{machine} {number}", own, alone))
    return lives


def answer_all(folder: Path, catalogues: Path, answers: Path, effort: Effort, alone: Effort) -> None:
    """Diagnose recordings in a folder that lack an answer and whose machine has a catalogue.

    A life counts as soon as the recordings that are its baseline are there.

    Raises
    ------
    SystemExit
        The file has answers of other recordings of these names, or of another effort.
    """
    truths = {
        name: truth
        for file in folder.rglob("truth.json")
        for name, truth in json.loads(file.read_text()).items()
        if "life" in truth
    }
    answers.touch()
    known = {line["name"]: line for line in read_lines(answers)}
    lives: dict[tuple[str, int], list[str]] = defaultdict(list)
    for name, truth in sorted(truths.items(), key=lambda each: _place(each[1])):
        if (catalogues / truth["machine"]).is_dir():
            lives[truth["machine"], truth["life"]["number"]].append(name)
    for (machine, _), own in lives.items():
        catalogue = Catalogue.open(catalogues / machine)
        baselines = [name for name in own if truths[name]["life"]["visit"] <= BASELINES]
        if len(baselines) < BASELINES:
            continue
        files = {name: next(folder.rglob(f"{name}.npz")) for name in own}
        for name in own:
            # Each of the baselines has another past, whose machine effort thorough would simulate for it alone.
            asked: Effort = "standard" if name in baselines else effort
            line = known.get(name, {"truth": truths[name], "name": name})
            if name in known:
                _check(line, truths[name], asked, answers)
                if line["answer"] is None or alone in line["alone"]:
                    continue
            past = [files[each] for each in baselines if each != name]
            line = _diagnose(line, files[name], past, catalogue, asked, alone)
            with answers.open("a") as out:
                out.write(json.dumps(line) + "\n")


def _check(line: Line, truth: Mapping[str, Any], effort: Effort, answers: Path) -> None:
    """Refuse an answer that is not what would be asked for."""
    if not _agree(line["truth"], truth):
        raise SystemExit(f"{answers}: {line['name']}: is of another recording of this name")
    if line["answer"] and line["answer"]["effort"] != effort:
        raise SystemExit(f"{answers}: {line['name']}: effort: {line['answer']['effort']}: must be {effort}, as asked")


def _agree(one: Any, other: Any) -> bool:
    """Whether values from JSON are the same but for how a processor rounds."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_agree(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_agree, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-9)
    return bool(one == other)


def _place(truth: Mapping[str, Any]) -> tuple[int, int]:
    """Life and visit."""
    return truth["life"]["number"], truth["life"]["visit"]


def _diagnose(
    line: Line, file: Path, past: Sequence[Path], catalogue: Catalogue, effort: Effort, alone: Effort
) -> dict[str, Any]:
    """A line with the answers that it lacks."""
    began = time.perf_counter()
    recording = read_recording(file)
    found = {"alone": {}, **line, "sha256": recording.sha256}
    try:
        found["alone"] = {**found["alone"], alone: _brief(diagnose(recording, catalogue, effort=alone))}
        if "answer" not in found:
            baseline = [read_measurement(each) for each in past]
            found["answer"] = _brief(diagnose(recording, catalogue, effort=effort, baseline=baseline))
    except CatalogueError as error:
        # An answer that is there stays.
        found = {"answer": None, "alone": {}, "refusal": str(error), **line, "sha256": recording.sha256}
    print(f"{line['name']}: {time.perf_counter() - began:.1f} s", file=sys.stderr, flush=True)
    return found


def _brief(answer: Diagnosis) -> Any:
    """An answer as a line has it: without its evidence, suggestions and warnings, and to six digits."""
    bare = {"evidence": Evidence(orders=(), bands=()), "suggestions": (), "warnings": ()}
    text = answer.model_copy(update=bare).model_dump_json()
    return json.loads(text, parse_float=lambda digits: float(f"{float(digits):.6g}"))


def _life(name: str, lines: Sequence[Line], effort: Effort) -> Life:
    """A life from the lines of its visits, in the order of time."""
    visits, inspections, repairs, mount = [], [], [], None
    for place, line in enumerate(lines):
        truth, life = line["truth"], line["truth"]["life"]
        told = (line["answer"], line["alone"][effort]) if line["answer"] else (None, None)
        answer, alone = (Diagnosis.model_validate(each) if each else None for each in told)
        visits.append(
            LifeVisit(
                at=datetime.fromisoformat(life["measured_at"]),
                sha256=line["sha256"],
                clearances={joint: UM * um for joint, um in truth["clearances_um"].items()},
                answer=answer,
                arrivals=tuple(life["arrivals"]),
                alone=alone,
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
    parser.add_argument("answers", type=Path, help="file of answers, one a line")
    parser.add_argument("--recordings", type=Path, help="folder; those that have no answer are diagnosed first")
    parser.add_argument("--catalogues", type=Path, help="folder with one catalogue a machine")
    efforts = ("fast", "standard", "thorough")
    parser.add_argument("--effort", choices=efforts, default="standard", help="of answers beside the first ones")
    parser.add_argument("--alone", choices=efforts, default="standard", help="effort of answers to recordings alone")
    given = parser.parse_args()
    if given.recordings:
        if not given.catalogues or given.answers.suffix == ".gz":
            parser.error("--recordings: needs --catalogues, and a file of answers that is not compressed")
        answer_all(given.recordings, given.catalogues, given.answers, given.effort, given.alone)
    elif not given.answers.exists():
        parser.error(f"answers: {given.answers}: no such file")
    judged = []
    for name, lives in lives_of(read_lines(given.answers), given.alone).items():
        machine = Catalogue.open(given.catalogues / name).machine if given.catalogues else shipped_machine(name)
        judged += [judge_life(life, bounds_of(machine, machine.wearing_joints)) for life in lives]
    if not judged:
        parser.error(f"answers: {given.answers}: no life in it")
    print(table(("figure", "seen", "95 %"), [each.shown() for each in figures_of_lives(judged)]))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (CatalogueError, SolverError) as error:
        sys.exit(f"error: {error}")
