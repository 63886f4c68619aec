"""Diagnoses of recordings by the second simulator of the tests, which shares no code with the product, and the truth.

    PYTHONPATH=tests python -m second_simulator --protocol singles --machine four-bar --count 12 --out recordings
    python -m benchmarks.real_machines recordings --catalogues DIR [--before DIR] [--together] [--keep answers.json]

Recordings are named MACHINE-PROTOCOL-NUMBER; those of the same machines before anything was the matter, which the
second simulator makes with --before, have the same names in another folder and serve as baselines; those of the same
machines at other speeds (--factor), or at another load (held-shut), have one answer with --together. Every figure is a
count with its 95 % interval (Wilson 1927).
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from jointplay.app.tables import table
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.together import diagnose_together
from jointplay.catalogue.errors import CatalogueError
from jointplay.catalogue.matching.modes import Effort
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.storage.store import Catalogue


@dataclass(frozen=True)
class Judged:
    """One recording: protocol, what it is of, and what was answered; None where the answer was a refusal."""

    name: str
    protocol: str
    truth: Mapping[str, Any]
    answer: Mapping[str, Any] | None
    refusal: str = ""

    @property
    def worn(self) -> frozenset[str]:
        """Worn joints."""
        return frozenset(self.truth["worn_um"])

    @property
    def verdict(self) -> str:
        """Of the answer; a refusal counts as unknown."""
        return self.answer["verdict"] if self.answer else "unknown"

    def named(self, place: int) -> frozenset[str]:
        """Joints of the hypothesis at a place of the ranking."""
        if self.answer is None or place >= len(self.answer["hypotheses"]):
            return frozenset()
        return frozenset(self.answer["hypotheses"][place]["joints"])

    @property
    def exact(self) -> bool:
        """Whether the worn joints are named, and no other."""
        return self.verdict == "worn" and self.named(0) == self.worn

    @property
    def cause(self) -> str:
        """Name of what else is the matter."""
        names = [f"{cause['name']} {cause['target']}".strip() for cause in self.truth["causes"]]
        return ", ".join(names)


def judge(
    folder: Path, catalogues: Path, effort: Effort, only: str, before: Path | None = None, *, together: bool = False
) -> Iterable[Judged]:
    """Diagnose all recordings of a folder whose machines have a catalogue, beside what was recorded before.

    Each by itself, or those of one machine together.
    """
    opened: dict[str, Catalogue] = {}
    for truth_file in sorted(folder.rglob("truth.json")):
        groups: dict[str, list[tuple[Path, Mapping[str, Any]]]] = defaultdict(list)
        for name, truth in sorted(json.loads(truth_file.read_text()).items()):
            file = truth_file.with_name(f"{name}.npz")
            if only in name and file.exists() and (catalogues / truth["machine"]).is_dir():
                groups[truth.get("of", name) if together else name].append((file, truth))
        for name, recorded in groups.items():
            truth = recorded[0][1]
            machine = truth["machine"]
            protocol = truth.get("of", name).removeprefix(f"{machine}-").rpartition("-")[0]
            catalogue = opened.setdefault(machine, Catalogue.open(catalogues / machine))
            earlier = [] if before is None else [recorded_before(before, file.name) for file, _ in recorded]
            baseline = [read_measurement(file) for file in earlier] or None
            try:
                recordings = [read_recording(file) for file, _ in recorded]
                answer: Diagnosis = diagnose_together(recordings, catalogue, effort=effort, baseline=baseline)
            except CatalogueError as error:
                yield Judged(name, protocol, truth, None, str(error))
                continue
            content = answer.model_dump(mode="json", exclude={"evidence"})
            yield Judged(name, protocol, truth, content)


def recorded_before(folder: Path, name: str) -> Path:
    """Return the recording of that name from before; ends the program where there is none."""
    found = next(folder.rglob(name), None)
    if found is None:
        raise SystemExit(f"--before: {folder}: has no {name}")
    return found


def interval(right: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if not count:
        return 0.0, 1.0
    z, share = 1.96, right / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return middle - half, middle + half


Rule = Callable[[Judged], bool]


def never_worn(item: Judged) -> bool:
    """No joint of a machine without wear is called worn."""
    return item.verdict != "worn"


def no_sound_joint(item: Judged) -> bool:
    """No joint that is not worn is named."""
    return item.verdict != "worn" or item.named(0) <= item.worn


def all_worn_named(item: Judged) -> bool:
    """Every worn joint is named, others besides or not."""
    return item.verdict == "worn" and item.worn <= item.named(0)


def within_two(item: Judged) -> bool:
    """The worn joints are the first or the second hypothesis."""
    return item.verdict == "worn" and item.worn in (item.named(0), item.named(1))


def worn_or_unknown(item: Judged) -> bool:
    """The right joints, or no answer (with its reason)."""
    return item.exact or item.verdict in ("unknown", "changed")


def neither(item: Judged) -> bool:
    """Neither in order nor worn."""
    return item.verdict in ("changed", "unknown")


def cause_named(item: Judged) -> bool:
    """The first cause that is named is the true one."""
    told = (item.answer or {}).get("causes") or [{"name": ""}]
    true = item.truth["causes"][0]
    wanted = {"mount": f"mount {true['target']}", "mounts": "all mounts", "mass": f"mass of {true['target']}"}
    return str(told[0]["name"]).startswith(wanted.get(true["name"], true["name"].partition("-")[0]))


def at_least(item: Judged) -> bool:
    """The right joint, and "at least"."""
    if not item.exact or item.answer is None:
        return False
    return all(item.answer["joints"][joint]["bound"] == "at_least" for joint in item.worn)


def flaw_named(item: Judged) -> bool:
    """Every flawed sensor is named."""
    told = " ".join(json.dumps(each) for each in [*(item.answer or {}).get("sensors", []), item.refusal])
    return all(target in told for cause in item.truth["causes"] for target in cause["target"].split("+"))


RULES: Mapping[str, Sequence[tuple[str, Rule]]] = {
    "sound": (("called in order", lambda item: item.verdict == "in_order"), ("never worn", never_worn)),
    "singles": (("exactly right", lambda item: item.exact), ("no sound joint named", no_sound_joint)),
    "pairs": (("exactly right", lambda item: item.exact), ("within the first two", within_two)),
    "triples": (("exactly right", lambda item: item.exact), ("within the first two", within_two)),
    "small": (("exactly right", lambda item: item.exact), ("no sound joint named", no_sound_joint)),
    "disturbed-sound": (("never worn", never_worn), ("called in order", lambda item: item.verdict == "in_order")),
    "disturbed-worn": (("right, or not answered", worn_or_unknown), ("exactly right", lambda item: item.exact)),
    "cyclic-load": (("sound never worn, worn right or not answered", lambda item: worn_or_unknown(item) if item.worn
                     else never_worn(item)),),
    "other-cause": (("neither in order nor worn", neither), ("named", cause_named)),
    "beyond-range": (("right joint", lambda item: item.exact), ("and at least", at_least)),
    "sensor-flaws": (("named", flaw_named), ("no wrong joint", no_sound_joint)),
    "drop-outs": (("right, or not answered", lambda item: worn_or_unknown(item) if item.worn else never_worn(item)),),
    "model-errors": (("exactly right", lambda item: item.exact), ("no sound joint named", no_sound_joint)),
    "held-shut": (("all worn joints seen", all_worn_named), ("exactly right", lambda item: item.exact),
                  ("no sound joint named", no_sound_joint)),
    "growing": (("exactly right", lambda item: item.exact), ("no sound joint named", no_sound_joint)),
}  # fmt: skip


def figures(found: Sequence[Judged]) -> list[tuple[str, ...]]:
    """One row a protocol, machine and rule."""
    groups: dict[tuple[str, str], list[Judged]] = defaultdict(list)
    for item in found:
        groups[item.protocol, item.truth["machine"]].append(item)
        groups[item.protocol, "all"].append(item)
    rows: list[tuple[str, ...]] = []
    for (protocol, machine), items in sorted(groups.items()):
        for said, rule in RULES.get(protocol, ()):
            right = sum(rule(item) for item in items)
            low, high = interval(right, len(items))
            rows.append((protocol, machine, said, f"{right} of {len(items)}", f"{low:.2f} to {high:.2f}"))
    return rows


def intervals_held(found: Sequence[Judged]) -> tuple[int, int]:
    """How many 90 % intervals of worn joints hold, of exactly right answers within the catalogue's range."""
    held = count = 0
    for item in found:
        if not item.exact or item.answer is None or item.protocol == "beyond-range":
            continue
        for joint, um in item.truth["worn_um"].items():
            low, high = item.answer["hypotheses"][0]["joints"][joint]["interval_um"]
            held, count = held + (low <= um <= high), count + 1
    return held, count


def first_seen(found: Sequence[Judged]) -> dict[str, float]:
    """Clearance [um] from which on growing wear is always seen, by machine and series; infinite where it never is."""
    series: dict[str, list[tuple[float, bool]]] = defaultdict(list)
    for item in found:
        if item.protocol == "growing":
            name = f"{item.truth['machine']} {item.truth['series']['number']}"
            series[name].append((sum(item.truth["worn_um"].values()), all_worn_named(item)))
    return {
        name: min(
            (um for um, _ in itertools.takewhile(lambda each: each[1], sorted(each, reverse=True))), default=math.inf
        )
        for name, each in series.items()
    }


def sets_held(found: Sequence[Judged]) -> tuple[int, int]:
    """How many candidate sets hold what is worn, of all answers that have a set and are of nothing but wear."""
    told = [item for item in found if item.answer and item.answer["candidate_set"] and not item.truth["causes"]]
    held = sum(
        ("+".join(sorted(item.worn)) or "healthy") in item.answer["candidate_set"] for item in told if item.answer
    )
    return held, len(told)


def log_loss(found: Sequence[Judged]) -> tuple[float, int]:
    """Mean of -ln P of what is true of each joint, worn or not; and how many joints."""
    losses = []
    for item in found:
        for joint, probability in ((item.answer or {}).get("joint_probabilities") or {}).items():
            right = probability if joint in item.worn else 1.0 - probability
            losses.append(-math.log(max(right, 1e-6)))
    return (sum(losses) / len(losses) if losses else math.nan), len(losses)


def log_loss_of_sets(found: Sequence[Judged]) -> float:
    """Mean of -ln P of the set of worn joints, over all answers."""
    losses = []
    for item in found:
        ranked = (item.answer or {}).get("hypotheses") or []
        own = sum(each["probability"] for each in ranked if frozenset(each["joints"]) == item.worn)
        losses += [-math.log(max(own, 1e-6))] if ranked else []
    return sum(losses) / len(losses) if losses else math.nan


def shown(item: Judged) -> tuple[str, ...]:
    """One line of the list of answers."""
    worn = ", ".join(f"{joint} {um:.0f}" for joint, um in item.truth["worn_um"].items()) or "-"
    if item.answer is None:
        return item.name, worn, item.cause, "refused", item.refusal[:60], "", "", ""
    ranking = ", ".join(f"{each['label']} {each['probability']:.2f}" for each in item.answer["hypotheses"][:3])
    first = item.answer["hypotheses"][0]["joints"]
    clearances = ", ".join(f"{joint} {each['clearance_um']:.0f}" for joint, each in first.items())
    causes = ", ".join(f"{each['name']} {each['size']:.2g}" for each in item.answer.get("causes", [])[:2])
    trusted = item.answer["mode"]["trusted_p_value"]
    p_values = (
        f"{item.answer['mode']['used'][0]} {item.answer['goodness_of_fit']['p_value']:.1g}, trusted {trusted or 0:.1g}"
    )
    return item.name, worn, item.cause, item.verdict, ranking, clearances, causes, p_values


def main() -> int:
    """Print the list and the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--catalogues", type=Path, required=True, help="folder with one catalogue a machine")
    parser.add_argument("--effort", choices=("fast", "standard", "thorough"), default="standard")
    parser.add_argument("--only", default="", help="recordings with this in their name")
    parser.add_argument("--before", type=Path, help="folder of recordings of the same machines before")
    parser.add_argument("--together", action="store_true", help="one answer to all recordings of a machine")
    parser.add_argument("--keep", type=Path, help="file for truths and answers")
    given = parser.parse_args()
    effort = cast(Effort, given.effort)
    asked = (given.recordings, given.catalogues, effort, given.only, given.before)
    found = list(judge(*asked, together=given.together))
    head = ("recording", "worn [um]", "else", "verdict", "first three", "clearance [um]", "causes", "p")
    print(table(head, [shown(item) for item in found]))
    print(table(("protocol", "machine", "rule", "seen", "95 %"), figures(found)))
    held, count = intervals_held(found)
    loss, joints = log_loss(found)
    print(f"90 % intervals hold {held} of {count}; log-loss of P(worn) {loss:.3f} over {joints} joints")
    print(f"log-loss of the set of worn joints {log_loss_of_sets(found):.3f}")
    print("candidate sets hold {} of {}".format(*sets_held(found)))
    for series, size in first_seen(found).items():
        print(f"growing wear, {series}: seen from {size:.0f} um on")
    if given.keep:
        given.keep.write_text(json.dumps([vars(item) for item in found], indent=1))
    return 0 if found else 1


if __name__ == "__main__":
    sys.exit(main())
