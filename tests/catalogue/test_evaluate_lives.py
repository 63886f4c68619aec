"""Lives that are simulated and judged: what is drawn, and figures of cases whose right answer is known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import timedelta
from itertools import pairwise

import numpy as np
import pytest
from lives import BEGIN, BOUNDS, JOINTS, answer

from jointplay.catalogue.diagnosing.answer import Cause, JointState
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation import lives
from jointplay.catalogue.evaluation.life_figures import (
    JudgedLife,
    Life,
    LifeVisit,
    detected,
    figures_of_lives,
    judge_life,
    least_ratio_of_detection,
    ratio_of_detection,
)
from jointplay.catalogue.evaluation.lives import LAWS, VISITS, draw_life, evaluate_lives
from jointplay.catalogue.following.visits import Inspection
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine

MACHINE = shipped_machine("slider-crank")
FIT = 8e-6


def visit(place: int, clearances: dict[str, float], *, causes: tuple[Cause, ...] = ()) -> LifeVisit:
    """A recording whose answer is right: sure from 30 um on, and sure of nothing below."""
    said = {joint: 6.0 if each > 30e-6 else -6.0 for joint, each in clearances.items()}
    sizes = {joint: max(each, 26e-6) for joint, each in clearances.items()}
    made = answer(said, sizes, causes=causes)
    states = {
        joint: JointState(
            condition="worn" if each > 30e-6 else "in_order",
            p_worn=1.0 / (1.0 + math.exp(-said[joint])),
            p_over_limit=0.0,
            limit_um=200.0,
            clearance_um=1e6 * each,
            interval_um=(0.8e6 * each, 1.25e6 * each),
            bound="none",
            detectable_from_um=30.0,
        )
        for joint, each in clearances.items()
    }
    return LifeVisit(
        BEGIN + timedelta(days=30 * place),
        f"visit {place}",
        clearances,
        made.model_copy(update={"joints": states}),
        (2 * place,),
    )


def life(
    course: list[float],
    *,
    repairs: tuple[tuple[int, str], ...] = (),
    loosening: str = "",
    name: str = "B",
    since: bool = True,
) -> Life:
    """A life in which one joint has these clearances [m], and the others fits; causes are told as they are."""
    cause = (Cause(name=loosening, size=1.0, unit="x stiffness", probability=0.99, since=since),) if loosening else ()
    visits = []
    for place, clearance in enumerate(course):
        told = tuple(each.model_copy(update={"size": 1.0 - 0.02 * place}) for each in cause)
        visits.append(visit(place, {**dict.fromkeys(JOINTS, FIT), name: clearance}, causes=told))
    return Life("made up", tuple(visits), (), repairs, loosening)


WEARS = [FIT] * 6 + [FIT + 1e-5 * place for place in range(1, 25)]


def share(judged: JudgedLife, name: str) -> float:
    right, of = judged.counts[name]
    return right / of


def test_right_answers_are_judged_right() -> None:
    judged = judge_life(life(WEARS), BOUNDS)
    assert judged.counts["visits answered"] == (30, 30)
    for name in ("single answer", "filter"):
        assert share(judged, f"90 % interval of worn joints holds: {name}") >= 0.9
        assert share(judged, f"worn joints exactly right at the last visit: {name}") == 1.0
    assert share(judged, "90 % interval of the next visit holds") > 0.8
    # 8 um and 30 visits of 30 days: 200 um are reached between the visits of 198 and 208 um, and foretold.
    assert judged.counts["date of reaching the limit: 90 % interval holds"][1] == 18
    assert share(judged, "date of reaching the limit: 90 % interval holds") > 0.6
    assert share(judged, "late and doubled files change nothing") == 1.0
    assert share(judged, "lives with a repair told that there was not") == 0.0
    assert max(judged.losses["single"]) == pytest.approx(-math.log(1 / (1 + math.exp(6.0))), rel=1e-6)  # from 28 um
    assert "repairs seen within two visits" not in judged.counts


def test_repairs_are_seen_without_being_told() -> None:
    mended = [*WEARS[:22], *[FIT] * 8]
    told = Inspection(BEGIN + timedelta(days=30 * 21 + 9), {"B": WEARS[21]}, frozenset(["B"]))
    judged = judge_life(replace(life(mended, repairs=((22, "B"),)), inspections=(told,)), BOUNDS)
    assert judged.counts["repairs seen within two visits"][1] == 1
    never = judge_life(life(WEARS, repairs=((22, "B"),)), BOUNDS)
    assert share(never, "repairs seen within two visits") == 0.0


def test_a_loosening_mount_is_told_from_wear() -> None:
    name = "loosening mount: told from wear"
    assert share(judge_life(life([FIT] * 20, loosening="mount 1"), BOUNDS), name) == 1.0
    unnamed = replace(life([FIT] * 20, loosening="mount 1"), loosening="mount 0")
    assert share(judge_life(unnamed, BOUNDS), name) == 0.0
    for since in (True, False):
        blamed = judge_life(replace(life([FIT] * 20, loosening="mount 1", since=since), loosening=""), BOUNDS)
        assert share(blamed, "a cause told where there is none") == 1.0
        assert share(blamed, "a cause told to have come since the baseline where none has") == since


def judged_of(calm: list[float], p_worn: dict[str, list[float]], sizes: list[float]) -> JudgedLife:
    found = JudgedLife()
    for name in ("filter", "single"):
        found.unworn[name] = calm
        found.growing[name] = [(np.array(p_worn[name]), np.array(sizes))]
    return found


def test_first_sure_detection_is_compared_at_equal_false_alarms() -> None:
    """400 visits: two false alarms are allowed, so that 0.8 is the threshold and 0.9 is above it."""
    calm = [0.1] * 397 + [0.8, 0.95, 0.99]
    one = judged_of(calm, {"filter": [0.5, 0.9, 1.0], "single": [0.5, 0.7, 0.9]}, [1e-4, 2e-4, 4e-4])
    assert detected("filter", [one]) == [2e-4]
    assert detected("single", [one]) == [4e-4]
    assert ratio_of_detection([one]) == pytest.approx(0.5)
    assert least_ratio_of_detection([one]) == pytest.approx(0.25)
    never = judged_of(calm, {"filter": [0.5], "single": [0.5]}, [1e-4])
    assert math.isnan(ratio_of_detection([never]))
    assert ratio_of_detection([one, never]) == pytest.approx(0.5)
    assert least_ratio_of_detection([never]) == 0.0, "a single answer is never sure of it"


def test_intervals_are_over_lives() -> None:
    """Ten lives of ten visits each, all right or all wrong: as uncertain as ten cases, not as a hundred."""
    ten = [JudgedLife(counts={"some": (10 * (k < 5), 10)}) for k in range(10)]
    found = next(each for each in figures_of_lives(ten) if each.name == "some")
    assert (found.right, found.of, found.value) == (50, 100, 0.5)
    assert found.interval == pytest.approx((0.2, 0.8), abs=0.11)
    assert found.shown() == ("some", "50 of 100, 0.50", f"{found.interval[0]:.2g} to {found.interval[1]:.2g}")


def test_lives_are_drawn() -> None:
    drawn = [draw_life(MACHINE, 1, number) for number in range(1, 16)]
    again = draw_life(MACHINE, 1, 3)
    assert again == drawn[2] != draw_life(MACHINE, 2, 3)
    worn = []
    for each in drawn:
        visits = each.life.visits
        assert len(visits) == len(each.truths) == VISITS
        assert all(earlier.at < later.at for earlier, later in pairwise(visits))
        assert len({place for visit in visits for place in visit.arrivals}) == sum(len(v.arrivals) for v in visits)
        wears = set()
        for joint in sorted(MACHINE.wearing_joints):
            course = [truth.clearances[joint] for truth in each.truths]
            falls = [place for place in range(1, VISITS) if course[place] < course[place - 1]]
            assert falls == [place for place, repaired in each.life.repairs if repaired == joint]
            if max(course) > 15e-6:
                wears.add(joint)
        worn.append(len(wears))
        factors = [truth.parameters.get("supports.0.stiffness.0", 2e5) for truth in each.truths]
        factors += [truth.parameters.get("supports.1.stiffness.0", 2e5) for truth in each.truths]
        assert min(factors) == pytest.approx(1e5 if each.life.loosening else 2e5)
    assert sorted(worn[:5]) == [0, 1, 1, 2, 3]
    assert sum(bool(each.life.loosening) for each in drawn) == 5
    assert any(each.life.inspections for each in drawn)
    assert any(len({truth.gains for truth in each.truths}) == 2 for each in drawn)


def test_laws_of_wear_rise() -> None:
    age = np.linspace(0.0, 1.0, 101)
    for law in LAWS.values():
        part = law(age)
        assert (np.diff(part) >= 0.0).all()
        assert (part[0], part[-1]) == (0.0, pytest.approx(1.0, abs=1e-6))


@pytest.mark.long
def test_lives_are_evaluated(small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lives, "VISITS", 8)
    monkeypatch.setattr(lives, "_PROTOCOL", replace(lives._PROTOCOL, revolutions=10.0))
    seen: list[tuple[int, int]] = []
    study = evaluate_lives(small_catalogue, 1, 1, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(8, 8)]
    figures = {each.name: each for each in study.figures}
    assert (figures["visits answered"].right, figures["visits answered"].of) == (8, 8)
    assert figures["late and doubled files change nothing"].value == 1.0
    document = json.loads(json.dumps(study.content(), allow_nan=False))
    assert [each["name"] for each in document["figures"]] == list(figures)


def test_machines_that_cannot_live_are_refused(small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Catalogue, "machine", small_catalogue.machine.model_copy(update={"sensors": ()}))
    with pytest.raises(DiagnosisError, match="machine slider-crank: has no sensors"):
        evaluate_lives(small_catalogue, 1)
