"""A machine beside its own past: what has not changed is not told, what has is, by its name and size."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from in_order import FITS, off_by, recordings

from jointplay.catalogue.diagnosing import hearing, hearing_anew, verdict
from jointplay.catalogue.diagnosing.as_found import Refined
from jointplay.catalogue.diagnosing.baseline_levels import OrderLevels
from jointplay.catalogue.diagnosing.causes import NamedCause, explain_as_well, name_causes, name_changes
from jointplay.catalogue.diagnosing.comparison import beside_past, exact_sensing, features_of, watched_levels
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past import PastComparison, compare_with_past, expect_worn
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.verdict import OTHERWISE_BELOW, find_causes
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.plans.parameters import LOAD, MachineNumbers
from jointplay.catalogue.plans.variants import Variant, output_load
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.cases.case import Case
from jointplay.solver.machines.fault import Fault

#: A machine that is not as its file says: mass and inertia of the frame, stiffness in x and y, damping.
OFF = (1.04, 0.96, 0.93, 1.05, 1.1)
#: Numbers that change: the stiffness of a mount, and a mass on the crank, which moves its centre of gravity.
SOFTER = {"supports.1.stiffness.0": 0.85, "supports.1.stiffness.1": 0.85}
#: What the process asks of a machine in order on six days, as factors on its speed and N on its slider.
DAYS = ((1.0, 4.0), (1.012, -5.0), (0.99, 1.0), (1.006, -2.0), (0.994, 6.0), (1.003, -7.0))


def changed(catalogue: Catalogue, speed: float, factors: dict[str, float]) -> Case:
    case = off_by(catalogue, OFF, speed)
    numbers = {path: case.parameters[path] * factor for path, factor in factors.items()}
    return dataclasses.replace(case, parameters={**case.parameters, **numbers})


@pytest.fixture(scope="module")
def visits(small_catalogue: Catalogue) -> dict[str, PreparedMeasurement]:
    """One machine, three times in order at other speeds, and with a softer mount, little and much."""
    cases = [changed(small_catalogue, speed, {}) for speed in (1.0, 1.012, 0.99)]
    softest = {path: factor**3 for path, factor in SOFTER.items()}
    made = recordings(small_catalogue, [*cases, *(changed(small_catalogue, 1.006, each) for each in (SOFTER, softest))])
    return dict(zip(("first", "second", "third", "softer", "softest"), made, strict=True))


@pytest.fixture(scope="module")
def days(small_catalogue: Catalogue) -> list[PreparedMeasurement]:
    """One machine in order under another small load each day: its contacts settle to other motions."""
    output = output_load(small_catalogue.machine)
    assert output is not None
    machine = Variant(load=output.link).machine(small_catalogue.machine)
    (force,) = MachineNumbers(machine).targets(LOAD)
    cases = []
    for speed, load in DAYS:
        case = off_by(small_catalogue, OFF, speed)
        cases.append(dataclasses.replace(case, parameters={**case.parameters, force.path: force.share * load}))
    return recordings(small_catalogue, cases, machine=machine)


def beside(catalogue: Catalogue, now: PreparedMeasurement, *before: PreparedMeasurement) -> PastComparison:
    found = compare_with_past(now, before, catalogue)
    assert found is not None
    return found


def test_a_machine_as_it_was(small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement]) -> None:
    for now, before in (("second", "first"), ("first", "second"), ("third", "second")):
        found = beside(small_catalogue, visits[now], visits[before])
        assert found.p_value > 0.05
        assert name_changes(found.expected, small_catalogue) == ()


@pytest.mark.parametrize("known", [1, 3])
def test_another_load_of_the_day_is_no_change(
    small_catalogue: Catalogue, days: list[PreparedMeasurement], known: int
) -> None:
    for now in days[known:]:
        found = beside(small_catalogue, now, *days[:known])
        assert found.p_value > 0.05
        assert name_changes(found.expected, small_catalogue) == ()


def test_levels_that_differ_from_day_to_day_are_known_to_do_so(
    small_catalogue: Catalogue, days: list[PreparedMeasurement], visits: dict[str, PreparedMeasurement]
) -> None:
    """What is usual of each level is learned from the machine's own recordings, and of that level alone."""
    steady = [visits[name] for name in ("first", "second", "third")]
    beside_days, beside_steady = (beside(small_catalogue, past[0], *past[1:3]).expected for past in (days, steady))
    wider = beside_days.deviations.std(axis=0) / beside_steady.deviations.std(axis=0)
    second, third = (OrderLevels.of(each).measured for each in days[1:3])
    assert wider[np.argmax(np.abs(second - third))] > 1.5
    assert np.median(wider) < 1.1


def test_a_mount_that_is_little_softer_is_named(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement]
) -> None:
    """Beside other machines it is one of many that are not quite as filed; beside itself it is a mount at 0.85."""
    found = beside(small_catalogue, visits["softer"], visits["first"])
    first = name_changes(found.expected, small_catalogue)[0]
    assert isinstance(first, NamedCause)
    assert first.name == "mount 1" and first.size == pytest.approx(0.85, abs=0.05) and first.probability > 0.9
    steady = [visits[name] for name in ("first", "second", "third")]
    # Beside one recording, all mounts as on a warm day explain it nearly as well.
    assert found.p_value < 0.25
    assert beside(small_catalogue, visits["softer"], *steady).p_value < 0.05
    assert beside(small_catalogue, visits["softest"], *steady).p_value < OTHERWISE_BELOW
    told = found.changed[0]
    assert abs(told.difference_db) > 3.0 * told.usual_db and told.low_order < 5.0
    assert not any(cause.name == "mount 1" for cause in name_causes(visits["softer"], small_catalogue, small=True))


def on_a_day(catalogue: Catalogue, speed: float, mounts: float = 1.0) -> Case:
    """A machine as filed, all its mounts softer or stiffer by a factor."""
    case = off_by(catalogue, (1.0,) * len(OFF), speed)
    paths = [f"supports.{place}.stiffness.{axis}" for place in (0, 1) for axis in (0, 1)]
    return dataclasses.replace(
        case, parameters={**case.parameters, **{path: mounts * case.parameters[path] for path in paths}}
    )


def test_warm_mounts_are_named(small_catalogue: Catalogue) -> None:
    """Between nothing and the next of few starts lies a valley: a link that is heavier by a half was named."""
    before, after = recordings(
        small_catalogue, [on_a_day(small_catalogue, 1.0), on_a_day(small_catalogue, 1.006, 0.87)]
    )
    cause = name_changes(beside(small_catalogue, after, before).expected, small_catalogue)[0]
    assert cause.name == "all mounts" and cause.size == pytest.approx(0.87, abs=0.05) and cause.probability > 0.9


def test_mounts_as_on_another_day_are_no_change(small_catalogue: Catalogue) -> None:
    """A few per cent softer or stiffer, all of them: rubber is so when it is warm or cold."""
    days = [(1.0, 1.0), (0.99, 1.0), (1.012, 1.0), (1.006, 0.93), (1.006, 1.07)]
    *steady, warm, cold = recordings(small_catalogue, [on_a_day(small_catalogue, *each) for each in days])
    named: list[NamedCause] = []
    for now in (warm, cold):
        found = beside(small_catalogue, now, *steady)
        assert found.p_value > 0.05
        named += name_changes(found.expected, small_catalogue)
        assert find_causes(now, small_catalogue, by_itself(small_catalogue, now, p_worn=0.1), found) == ()
    assert named and all(cause.is_warmth for cause in named)


def test_a_mount_that_loosens_is_told_beside_wear(small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what worn machines of the catalogue differ by from themselves in order; wear by itself is no such change."""
    matrix = small_catalogue.matrix
    worn = [
        dataclasses.replace(each, fault=Fault({**FITS, "O": 300e-6}))
        for each in (off_by(small_catalogue, OFF, 1.006), changed(small_catalogue, 1.006, dict.fromkeys(SOFTER, 0.6)))
    ]
    before, firm, loose = recordings(small_catalogue, [off_by(small_catalogue, OFF), *worn])
    rows = matrix.rows("O", "trusted")
    near = rows[np.argsort(np.abs(np.log(matrix.clearance(rows)[:, matrix.joints.index("O")] / 300e-6)))[:80]]
    told = []
    for now in (firm, loose):
        expected = expect_worn(beside(small_catalogue, now, before).expected, small_catalogue, "O", near)
        assert expected is not None
        told.append(name_changes(expected, small_catalogue))
    assert told[0] == ()
    assert told[1][0].name == "mount 1" and told[1][0].size == pytest.approx(0.6, abs=0.06)
    result = by_itself(small_catalogue, loose, p_worn=0.9)
    past = beside(small_catalogue, loose, before)
    found = find_causes(loose, small_catalogue, result, past)[0]
    assert found.since and found.name == "mount 1" and found.size == pytest.approx(told[1][0].size, rel=0.05)
    monkeypatch.setattr(verdict, "expect_worn", lambda *_: None)  # as in catalogues of earlier draws
    assert not any(cause.since for cause in find_causes(loose, small_catalogue, result, past))
    few = near[:10]
    assert expect_worn(beside(small_catalogue, firm, before).expected, small_catalogue, "O", few) is None


def by_itself(catalogue: Catalogue, now: PreparedMeasurement, p_worn: float) -> MatchResult:
    """What the catalogue says of a recording by itself, worn joints being as probable as told."""
    sensing = exact_sensing(now)
    result = ModelLibrary(catalogue.matrix).answer(
        sensing, features_of(now, sensing), watched_levels(now), "fast", "trusted", speed=now.drive_speed
    )
    share = {True: p_worn / result.p_worn, False: (1.0 - p_worn) / (1.0 - result.p_worn)}
    matches = [
        dataclasses.replace(match, probability=match.probability * share[bool(match.joints)])
        for match in result.hypotheses
    ]
    return dataclasses.replace(result, hypotheses=tuple(sorted(matches, key=lambda match: -match.probability)))


def test_several_recordings_narrow_what_is_expected(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement]
) -> None:
    one = beside(small_catalogue, visits["softer"], visits["first"]).expected
    three = beside(small_catalogue, visits["softer"], *(visits[name] for name in ("first", "second", "third"))).expected
    assert np.median(three.error_variance / one.error_variance) < 0.9


def test_recordings_by_other_sensors_are_not_compared(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement]
) -> None:
    now, before = visits["second"], visits["first"]
    fewer = dataclasses.replace(now.sensing, sensors=now.sensing.sensors[:3])
    assert compare_with_past(now, [dataclasses.replace(before, sensing=fewer)], small_catalogue) is None
    assert compare_with_past(now, [], small_catalogue) is None


class Listening(ModelLibrary):
    """Has learned nothing beside a machine's past, and notes what it is asked."""

    def hears_past(self, sensing: Sensing, speed: float) -> bool:
        """Whatever it would answer."""
        return True

    def answer(
        self, sensing: Sensing, feature: FloatArray, watched: BoolArray, *args: Any, **kwargs: Any
    ) -> MatchResult:
        """Answer by the recording alone."""
        self.asked = getattr(self, "asked", (sensing, feature, kwargs["weights"]))  # again if a mount is softer
        alone = dataclasses.replace(sensing, past=False)
        found = super().answer(alone, feature[: sensing.own_count], watched, *args, **kwargs)
        return dataclasses.replace(found, beside=sensing.past)


def test_features_of_the_past_are_heard_behind_the_recording_s_own(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement]
) -> None:
    past = {"a": visits["first"], "b": visits["second"]}
    known = KnownMachine.of(past, small_catalogue)
    library = Listening(small_catalogue.matrix)
    heard = hearing.hear(visits["softer"], "c", small_catalogue, Question(), library, known=known)
    sensing, feature, weights = library.asked
    assert sensing.past and weights is None
    assert feature.shape == (sensing.features_count,)
    # As a machine as filed would have made them, all of them, and with the same noise.
    straight = [known.baseline.correct(each, small_catalogue.machine) for each in (visits["softer"], *past.values())]
    own = dataclasses.replace(sensing, past=False)
    now, *before = (features_of(each, own) for each in straight)
    np.testing.assert_allclose(feature, np.concatenate([now, np.mean(before, axis=0)]))
    assert (sensing.noise >= [exact_sensing(each).noise for each in straight]).all()
    # What is shown of the answer is the recording's own.
    assert heard.feature.shape == (own.own_count,) and not heard.sensing.past
    assert heard.result.beside and known.describe(heard=True).heard
    assert not hearing.hear(visits["softer"], "c", small_catalogue, Question(), library).result.beside


def test_the_machine_as_found_is_simulated_beside_the_past_too(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was heard of the past goes into it; a load that it has always had makes no change of a machine in order."""

    def simulated(*args: Any, **kwargs: Any) -> Refined:
        assert args[2].beside
        return Refined(args[2], 7, 1, "simulated", NamedCause("load on one stroke", 30.0, "N", 0.99))

    monkeypatch.setattr(hearing_anew, "refine_known", simulated)
    known = KnownMachine.of({"a": visits["first"]}, small_catalogue)
    library = Listening(small_catalogue.matrix)
    heard = hearing.hear(visits["second"], "c", small_catalogue, Question("thorough"), library, known=known)
    assert heard.spent.note == "simulated" and heard.result.beside
    assert heard.verdict == "in_order" and not heard.causes


def test_what_the_baseline_has_as_well_is_no_cause(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement]
) -> None:
    """A mount that was soft when the machine was in order is its own; beside another past it is a cause."""
    now = visits["softest"]
    asked = exact_sensing(now)
    result = ModelLibrary(small_catalogue.matrix).answer(
        asked, features_of(now, asked), watched_levels(now), "fast", "trusted", speed=now.drive_speed
    )
    found = find_causes(now, small_catalogue, result)
    assert found and found[0].name == "mount 1"
    assert find_causes(now, small_catalogue, result, None, [visits["first"]])[0].name == "mount 1"
    assert "mount 1" not in {cause.name for cause in find_causes(now, small_catalogue, result, None, [now])}
    # One that was a little soft, and is much softer now, has changed.
    assert find_causes(now, small_catalogue, result, None, [visits["softer"]])[0].name == "mount 1"


def test_what_explains_the_baseline_as_well_is_its_own_unless_it_is_much_more_or_the_other_way(
    small_catalogue: Catalogue, visits: dict[str, PreparedMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of several causes that explain one machine in order, another one may be the best that day."""
    before, result = visits["softest"], by_itself(small_catalogue, visits["first"], p_worn=0.9)
    could = explain_as_well(before, small_catalogue)
    (named, *_) = name_causes(before, small_catalogue, small=True)
    assert named.name in {each.name for each in could} and len({each.name for each in could}) > 1
    assert explain_as_well(visits["first"], small_catalogue) == ()
    for one in could:
        for times, kept in ((0.5, ()), (4.9, ()), (5.1, (one.name,)), (-1.0, (one.name,))):
            size = one.size**times if one.unit.startswith("x ") else one.size * times
            cause = dataclasses.replace(one, size=size)
            assert cause.extent == pytest.approx(times * one.extent)
            monkeypatch.setattr(verdict, "name_causes", lambda *_, cause=cause, **__: (cause,))
            alone = [each for each in could if each.name == one.name] == [one]
            found = find_causes(visits["first"], small_catalogue, result, None, [visits["second"], before])
            assert not alone or tuple(each.name for each in found) == kept


def test_a_past_by_other_sensors_is_not_heard(visits: dict[str, PreparedMeasurement]) -> None:
    now, before = visits["softer"], visits["first"]
    assert beside_past(now, [before]) is not None
    fewer = dataclasses.replace(before, cuts=before.cuts[:-1])
    assert beside_past(now, [fewer]) is None
    both = beside_past(now, [fewer, before])
    alone = beside_past(now, [before])
    assert both is not None and alone is not None
    np.testing.assert_array_equal(both[1], alone[1])
