"""Numbers of a machine that recordings of it in order tell, by simulations of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointplay.catalogue.diagnosing import hearing, hearing_anew, known_machine, told_numbers
from jointplay.catalogue.diagnosing.as_found import Refined
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.diagnosis import answer
from jointplay.catalogue.diagnosing.found_cases import ALIKE, CONTACT_DOUBT, DOUBT, draw_cases
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.kept_cases import simulate_once
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past import PastComparison
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.stroke_loads import COMMON, DIFFERENCE, StrokeLoads, find_load
from jointplay.catalogue.diagnosing.told import ToldContacts, ToldNumbers, geometric_mean, of_joints
from jointplay.catalogue.diagnosing.told_numbers import covariance_of, regress, tell_numbers
from jointplay.catalogue.evaluation.protocols import PROTOCOLS, draw_truth
from jointplay.catalogue.evaluation.recordings import Recordings, recorded
from jointplay.catalogue.matching.matcher import MatchResult, rank
from jointplay.catalogue.matching.model_library import Observed, library_of
from jointplay.catalogue.plans.entry import HEALTHY, Entry, Hypothesis
from jointplay.catalogue.plans.plan_parts import STIFFNESS_SCATTER
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Ripple

SHORT = replace(PROTOCOLS["matched"], revolutions=12.0)
LOADS = (-70.0, 10.0)
"""Of a machine that does work on its stroke forward, N: 80 less than on that back, 30 N in the mean."""
RIPPLE = Ripple(order=6, amplitude=1.5e-3, phase=0.5)
MOUNT = "supports.0.stiffness.1"


def recording_of(catalogue: Catalogue, worn: list[str]) -> PreparedMeasurement:
    """Of a machine that has what its file has not."""
    truth = draw_truth(catalogue.machine, Hypothesis.of(worn), SHORT, 5, 1)
    found = StrokeLoads.of(catalogue.machine, catalogue.recipe.nominal_drive_speed)
    assert found is not None
    machine = found.machine(truth.machine)
    machine = machine.model_copy(update={"drive": machine.drive.model_copy(update={"ripple": (RIPPLE,)})})
    own = {f"loads.{place}.over_angle": size for place, size in enumerate(LOADS)}
    own[MOUNT] = 1.15 * catalogue.machine.supports[0].stiffness[1]
    truth = replace(truth, machine=machine, parameters={**truth.parameters, **own})
    ((_, ideal),) = Recordings().ideal(SHORT, [truth])
    assert ideal is not None
    return prepare(recorded(SHORT, truth, ideal), catalogue.machine, scheme=catalogue.scheme)


def with_p_worn(
    result: MatchResult, p_worn: float, p_value: float | None, trusted_p_value: float | None
) -> MatchResult:
    """An answer with another probability of wear, and other p-values where some are given."""
    shares = {True: p_worn / result.p_worn, False: (1.0 - p_worn) / (1.0 - result.p_worn)}
    matches = [
        replace(
            each,
            probability=each.probability * shares[bool(each.joints)],
            p_value=each.p_value if p_value is None else p_value,
        )
        for each in result.hypotheses
    ]
    found = rank(matches)
    return found if trusted_p_value is None else replace(found, trusted_p_value=trusted_p_value)


@pytest.fixture(scope="module")
def in_order(small_catalogue: Catalogue) -> PreparedMeasurement:
    return recording_of(small_catalogue, [])


@pytest.mark.long
def test_a_machine_in_order_tells_what_its_file_has_not(
    small_catalogue: Catalogue, in_order: PreparedMeasurement
) -> None:
    """The load, constant part and all, the ripple and a mount, within three errors; and better than nothing."""
    load, numbers = tell_numbers([in_order], small_catalogue)
    assert load is not None
    assert numbers is not None
    for part, least in ((COMMON, 30.0), (DIFFERENCE, 12.0)):
        error = math.sqrt(float(part @ load.covariance @ part))
        assert error < least
        assert abs(float(part @ (load.mean - LOADS))) < 3.0 * error + 0.1 * abs(float(part @ np.array(LOADS)))
    own = dict(zip(numbers.paths, zip(numbers.mean, numbers.error, strict=True), strict=True))
    for place, true in ((8, math.cos(RIPPLE.phase)), (9, math.sin(RIPPLE.phase))):
        mean, error = own[f"drive.ripple.{place}.amplitude"]
        assert abs(mean - RIPPLE.amplitude * true) < 3.0 * error
        assert error < 0.5e-3  # of 0.6e-3 before
    place = numbers.paths.index(MOUNT)
    other = numbers.paths.index(MOUNT.removesuffix("1") + "0")
    both = numbers.covariance[np.ix_([place, other], [place, other])]
    assert both[0, 1] == pytest.approx(both[0, 0]) == pytest.approx(both[1, 1])  # one number of a draw
    assert numbers.contacts is not None
    assert sum(numbers.contacts.laws.values()) == pytest.approx(1.0)
    contacts = numbers.contacts.numbers["own"]
    place = contacts.paths.index("contact.stiffness")
    assert contacts.error[place] < 0.5 * CONTACT_DOUBT * STIFFNESS_SCATTER
    stiffness = [small_catalogue.machine.joints[joint].contact.stiffness for joint in small_catalogue.matrix.joints]
    assert abs(contacts.mean[place] - np.log(stiffness).mean()) < 3.0 * contacts.error[place]
    mean, error = own[MOUNT]
    assert error < 0.08  # of 0.1 before
    assert abs(mean - math.log(1.15 * small_catalogue.machine.supports[0].stiffness[1])) < 3.0 * error


def test_mounts_are_told_as_they_are_when_it_is_neither_warm_nor_cold(
    small_catalogue: Catalogue, in_order: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is simulated is of days; what is told, of the machine."""
    simulated: list[Entry] = []
    told: list[FloatArray] = []

    def simulate(catalogue: Catalogue, machine: Machine, cases: Sequence[Entry], *told: Any) -> FoundSpectra:
        found = simulate_once(catalogue, machine, cases, *told)
        simulated.extend(found.entries)
        return found

    def tell(features: FloatArray, numbers: FloatArray, _: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        told.append(numbers)
        return numbers.mean(axis=0), numbers.std(axis=0), numbers - numbers.mean(axis=0)

    monkeypatch.setattr(told_numbers, "CASES", 16)
    monkeypatch.setattr(told_numbers, "simulate_once", simulate)
    monkeypatch.setattr(told_numbers, "regress", tell)
    _, numbers = tell_numbers([in_order], small_catalogue)
    assert numbers is not None
    place = numbers.paths.index(MOUNT)
    own = told[0][:, -len(numbers.paths) :]
    off = np.log([entry.parameters[MOUNT] for entry in simulated]) - own[:, place]
    assert (np.log(0.9) <= off).all() and (off <= np.log(1.1)).all()
    assert off.std() > 0.03
    mass = numbers.paths.index("links.frame.mass")
    same = np.log([entry.parameters["links.frame.mass"] for entry in simulated])
    np.testing.assert_allclose(own[:, mass], same)


def test_a_load_that_takes_work_is_not_taken_for_its_opposite(
    small_catalogue: Catalogue, in_order: PreparedMeasurement
) -> None:
    speed = small_catalogue.recipe.nominal_drive_speed
    load = find_load(small_catalogue, [(in_order, HEALTHY, 1.0)], speed, takes_work=True)
    assert load is not None
    assert float(DIFFERENCE @ load.mean) == pytest.approx(LOADS[0] - LOADS[1], abs=40.0)


def test_a_number_is_told_as_far_as_features_show_it() -> None:
    """What bends with them, to its noise; what does not go with them stays what it was."""
    generator = np.random.default_rng(1)
    features = generator.normal(size=(400, 12))
    bent = np.sin(features[:, 0]) + 0.3 * features[:, 1] ** 2 + 0.05 * generator.normal(size=400)
    numbers = np.column_stack([bent, generator.normal(5.0, 2.0, 400)])
    shown = np.zeros(12)
    shown[:2] = 0.8, -1.0
    mean, error, left = regress(features, numbers, shown)
    assert mean[0] == pytest.approx(math.sin(0.8) + 0.3, abs=3.0 * error[0])
    assert error[0] < 0.5 * bent.std()
    assert mean[1] == pytest.approx(numbers[:, 1].mean(), abs=0.6)
    assert error[1] == pytest.approx(2.0, rel=0.15)
    np.testing.assert_allclose(np.sqrt(np.mean(left**2, axis=0)), error, rtol=0.1)
    _, far, _ = regress(features, numbers, np.array([4.0, -4.0] * 6))
    assert far[0] > 0.8 * bent.std() > error[0]
    assert regress(features, numbers[:, :0], shown)[0].shape == (0,)


def test_a_number_that_one_feature_shows_is_told_beside_many_that_vary_together() -> None:
    """As an order that ripple shakes is one of hundreds."""
    generator = np.random.default_rng(1)
    together = generator.normal(size=(400, 90)) @ generator.normal(size=(90, 200))
    numbers = generator.normal(size=(400, 1))
    own = numbers + 0.1 * generator.normal(size=(400, 1))
    mean, error, _ = regress(np.hstack([together, own]), numbers, np.append(together[3], 1.0))
    assert mean[0] == pytest.approx(1.0, abs=3.0 * error[0])
    assert error[0] < 0.3  # of 1, which 60 principal components leave at 0.76


def test_errors_go_together_as_those_of_cases_do() -> None:
    """As large as they are said to be; a number that no case draws anew, as damping that is 0, is certain."""
    generator = np.random.default_rng(1)
    one, two = generator.normal(size=(2, 500))
    covariance = covariance_of(
        np.column_stack([one, -3.0 * one, one + two, np.zeros(500)]), np.array([1, 2, 3, 1e-300])
    )
    assert np.sqrt(np.diag(covariance)) == pytest.approx([1.0, 2.0, 3.0, 0.0])
    assert covariance[0, 1] == pytest.approx(-2.0)
    assert covariance[0, 2] / 3.0 == pytest.approx(math.sqrt(0.5), abs=0.06)
    told = ToldNumbers(("a", "b", "c", "d"), np.array([0.0, 0.0, 0.0, 0.5]), covariance, np.full(4, False))
    drawn = np.array([[*told.draw(number).values()] for number in range(300)])
    assert (drawn[:, 3] == 0.5).all()
    np.testing.assert_allclose(drawn[:, 1], -2.0 * drawn[:, 0], atol=1e-3)
    np.testing.assert_allclose(drawn.std(axis=0), [1.0, 2.0, 3.0, 0.0], rtol=0.15)


def test_what_is_told_is_the_same_in_every_set(small_catalogue: Catalogue) -> None:
    """A draw is one machine whatever is worn; what is not told is as doubtful as the file of such a machine."""
    speed = small_catalogue.recipe.nominal_drive_speed
    paths = ("links.frame.mass", "drive.ripple.0.amplitude")
    told = ToldNumbers(paths, np.array([math.log(9.0), 2e-4]), np.diag([0.02**2, 1e-8]), np.array([True, False]))
    machine, drawn = draw_cases(small_catalogue, speed, [("A",), ("A", "B")], None, 64, doubted=True, told=told)
    assert machine == small_catalogue.machine
    by_set = {label: [entry for entry in drawn if entry.hypothesis.label == label] for label in ("A", "A+B")}
    for one, two in zip(*by_set.values(), strict=True):
        assert all(one.parameters[path] == two.parameters[path] for path in paths)
    alike = ToldNumbers(paths, told.mean, np.array([[4e-4, 2e-6], [2e-6, 1e-8]]), told.logarithmic)
    both = np.array([[math.log(each[paths[0]]), each[paths[1]]] for each in map(alike.draw, range(200))])
    assert np.corrcoef(both.T)[0, 1] > 0.999
    mass = np.log([entry.parameters["links.frame.mass"] for entry in drawn])
    assert mass.mean() == pytest.approx(math.log(9.0), abs=0.01)
    assert 0.01 < mass.std() < 0.03
    plain = draw_cases(small_catalogue, speed, [("A",)], None, 64)[1]
    scatter = [np.log([entry.parameters[MOUNT] for entry in cases]).std() for cases in (plain, by_set["A"])]
    assert scatter[1] == pytest.approx(DOUBT * scatter[0], rel=0.1)  # of other draws: there are more numbers
    assert not any("ripple" in path for entry in plain for path in entry.parameters)


def test_contacts_are_told_of_all_joints_together(small_catalogue: Catalogue) -> None:
    """Their geometric mean is what was told; joints differ as they were drawn to, and laws come as often as told."""
    speed = small_catalogue.recipe.nominal_drive_speed
    law, path = "own", "contact.stiffness"
    of_all = ToldNumbers((path,), np.array([math.log(3e7)]), np.array([[0.1**2]]), np.array([True]))
    told = ToldNumbers(
        (),
        np.empty(0),
        np.empty((0, 0)),
        np.empty(0, bool),
        ToldContacts({law: 0.75, "hertz": 0.25}, {law: of_all, "hertz": of_all}),
    )
    usual, drawn = (
        draw_cases(small_catalogue, speed, [("A",)], None, 128, doubted=True, told=each)[1] for each in (None, told)
    )
    for some, share in ((usual, 0.5), (drawn, 0.75)):
        assert np.mean([entry.variant.law == law for entry in some]) == pytest.approx(share, abs=0.05)
    mean = np.log([geometric_mean(of_joints(entry.parameters, path)) for entry in drawn])
    assert mean == pytest.approx(math.log(3e7), abs=0.4)
    assert 0.07 < mean.std() < 0.13
    frame = [of_all.draw(number)[path] for number in range(len(drawn))]  # as the first of the other numbers is drawn
    assert abs(np.corrcoef(np.log(frame), mean)[0, 1]) < 0.3
    for number, one in enumerate(drawn):
        own = of_joints(one.parameters, path)
        assert geometric_mean(own) == pytest.approx(of_all.draw(number, "contacts")[path])
        if usual[number].variant.law == law:  # where it is the likelier one, it still is
            before = of_joints(usual[number].parameters, path)
            ratios = [own[name] / before[name] for name in own]
            assert ratios == pytest.approx([ratios[0]] * len(ratios))
            assert one.parameters["joints.A.contact.damping"] == usual[number].parameters["joints.A.contact.damping"]
    scatter = np.log([[*of_joints(entry.parameters, path).values()] for entry in usual if entry.variant.law == law])
    assert scatter.std(axis=0) == pytest.approx(CONTACT_DOUBT * STIFFNESS_SCATTER, rel=0.15)
    assert np.corrcoef(scatter.T)[0, 1] == pytest.approx(ALIKE, abs=0.1)


def test_what_is_told_of_a_machine_is_told_once(
    small_catalogue: Catalogue, in_order: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often it is asked."""
    asked: list[list[str]] = []

    def tell(recordings: list[PreparedMeasurement], *_: Any) -> tuple[None, None]:
        asked.append([each.name for each in recordings])
        return None, None

    monkeypatch.setattr(known_machine, "tell_numbers", tell)
    known = KnownMachine.of({"one": in_order}, small_catalogue)
    assert known.tell(small_catalogue) == known.tell(small_catalogue) == (None, None)
    assert asked == [[in_order.name]]


@pytest.mark.long
def test_a_doubted_machine_is_asked_for_its_numbers(
    small_catalogue: Catalogue, in_order: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With effort thorough, whatever it may have had; a load that has come since is looked for in the recording."""
    told: list[int] = []

    def tell(recordings: list[PreparedMeasurement], *_: Any) -> tuple[None, None]:
        told.append(len(recordings))
        return None, None

    monkeypatch.setattr(known_machine, "tell_numbers", tell)
    worn = recording_of(small_catalogue, ["B"])
    question = Question(effort="thorough", cases=1)
    load, ripple = NamedCause("load on one stroke", -80.0, "N", 0.9), NamedCause("ripple, order 6", 1e-3, "rad", 0.9)
    other = "the machine is not as its file says"
    for causes, count, is_simulated in (((), 1, True), ((load,), 1, True), ((ripple,), 2, False)):
        monkeypatch.setattr(hearing, "find_causes", lambda *_, causes=causes: causes)
        known = KnownMachine.of({"one": in_order}, small_catalogue)
        shown, _ = answer(worn, "0" * 64, small_catalogue, question, known=known)
        assert (shown.effort_spent.simulations > 0, shown.effort_spent.note == other) == (
            is_simulated,
            not is_simulated,
        )
        assert len(told) == count
    # Without one in order another cause than a load is left at that.
    shown, _ = answer(worn, "0" * 64, small_catalogue, question)
    assert shown.effort_spent.note == other
    assert len(told) == 2


@pytest.mark.parametrize(
    ("p_since", "p_worn", "is_its_own", "since", "named", "verdict"),
    [
        (0.5, 0.1, False, False, 0, "in_order"),
        (0.5, 0.9, False, False, 1, "changed"),
        (0.001, 0.1, False, False, 1, "changed"),
        (0.001, 0.1, True, False, 1, "changed"),
        (0.001, 0.95, True, False, 0, "worn"),
        (0.001, 0.95, True, True, 1, "worn"),
        (None, 0.95, False, False, 1, "changed"),
        (None, 0.1, True, False, 0, "in_order"),
    ],
)
def test_what_was_looked_for_beside_wear_goes_with_it(
    small_catalogue: Catalogue,
    in_order: PreparedMeasurement,
    monkeypatch: pytest.MonkeyPatch,
    p_since: float | None,
    p_worn: float,
    is_its_own: bool,
    since: bool,
    named: int,
    verdict: str,
) -> None:
    """Where the machine as found is not worn, and as it was, what its file has wrong is no cause.

    Nor is it where the machine as its past has shown it explains the recording, unless it is not worn and otherwise, or
    that has come since.
    """

    def refine(_: object, __: object, result: MatchResult, *_others: object, **____: object) -> Refined:
        fit = (0.5, 0.5) if is_its_own else (None, None)
        return Refined(with_p_worn(result, p_worn, *fit), 1, 1, "simulated", told=is_its_own)

    def compare_with_past(*given: Any) -> PastComparison | None:
        found = compare(*given)
        return None if found is None or p_since is None else replace(found, p_value=p_since)

    compare = hearing.compare_with_past
    ripple = NamedCause("ripple, order 6", 1e-3, "rad", 0.9, since=since)
    monkeypatch.setattr(hearing, "find_causes", lambda *_: (ripple,))
    monkeypatch.setattr(hearing_anew, "refine_known", refine)
    monkeypatch.setattr(hearing, "compare_with_past", compare_with_past)
    known = KnownMachine.of({"one": in_order}, small_catalogue)
    worn = recording_of(small_catalogue, ["B"])
    shown, _ = answer(worn, "0" * 64, small_catalogue, Question(effort="thorough"), known=known)
    assert shown.effort_spent.note == "simulated"
    assert (len(shown.causes), shown.verdict) == (named, verdict)
    assert all(cause.since == since for cause in shown.causes)


@pytest.mark.parametrize(
    ("p_since", "p_worn", "named", "verdict"),
    [
        (0.5, 0.1, [], "in_order"),
        (0.001, 0.1, ["unbalance", "mount 0"], "changed"),
        (0.001, 0.95, ["unbalance", "mount 0"], "worn"),
    ],
)
def test_a_loose_mount_is_what_a_search_took_for_the_frame(
    small_catalogue: Catalogue,
    in_order: PreparedMeasurement,
    monkeypatch: pytest.MonkeyPatch,
    p_since: float,
    p_worn: float,
    named: list[str],
    verdict: str,
) -> None:
    """Forces that have come since are told beside it; and what was converted is compared as it was recorded."""
    mass = NamedCause("mass of frame", 1.4, "x mass", 0.99, {"links.frame.mass": 9.0}, since=True)
    unbalance = NamedCause("unbalance", 0.01, "kg m", 0.9, since=True)
    mount = NamedCause("mount 0", 0.7, "x stiffness", 0.7, since=True)
    asked: list[Observed] = []

    def refine(observed: Observed, _: object, result: MatchResult, *_others: object, **how: Any) -> Refined:
        asked.append(observed)
        assert how["is_otherwise"] == (p_since < 0.005)
        return Refined(with_p_worn(result, p_worn, 0.5, 0.5), 1, 1, "simulated", mount, told=True)

    monkeypatch.setattr(hearing_anew, "refine_known", refine)
    known = KnownMachine.of({"one": in_order}, small_catalogue)
    worn = recording_of(small_catalogue, ["B"])
    heard = hearing.hear(worn, "0" * 64, small_catalogue, Question(), library_of(small_catalogue), known=known)
    assert heard.past is not None
    heard = replace(heard, causes=(mass, unbalance), past=replace(heard.past, p_value=p_since))
    converted = replace(heard, feature=heard.feature + 1.0, prepared=in_order, as_recorded=heard)
    found = hearing_anew.hear_anew(converted, small_catalogue, Question(effort="thorough"))
    assert asked[0].feature is heard.feature
    assert found.prepared is heard.prepared and found.feature is heard.feature
    assert ([cause.name for cause in found.causes], found.verdict) == (named, verdict)


@pytest.mark.parametrize(("p_worn", "verdict", "p_value"), [(0.95, "worn", 0.4), (0.85, "unknown", 0.001)])
def test_wear_that_catalogue_and_simulation_are_sure_of_is_worn(
    small_catalogue: Catalogue,
    in_order: PreparedMeasurement,
    monkeypatch: pytest.MonkeyPatch,
    p_worn: float,
    verdict: str,
    p_value: float,
) -> None:
    """Also where the simulated machine does not explain the recording, as the catalogue's machines do."""

    def refine(_: object, __: object, result: MatchResult, *_others: object, **____: object) -> Refined:
        return Refined(with_p_worn(result, p_worn, 0.001, 0.01), 1, 1, "simulated", told=True)

    monkeypatch.setattr(hearing_anew, "refine_known", refine)
    known = KnownMachine.of({"one": in_order}, small_catalogue)
    worn = recording_of(small_catalogue, ["B"])
    heard = hearing.hear(worn, "0" * 64, small_catalogue, Question(), library_of(small_catalogue), known=known)
    sure = replace(heard, causes=(), verdict="worn", p_value=0.4)
    found = hearing_anew.hear_anew(sure, small_catalogue, Question(effort="thorough"))
    assert (found.verdict, found.p_value) == (verdict, p_value)


def test_nothing_is_told_by_too_few_cases(
    small_catalogue: Catalogue, in_order: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where most of them cannot be simulated."""
    simulate = told_numbers.simulate_once
    monkeypatch.setattr(told_numbers, "CASES", 16)
    monkeypatch.setattr(
        told_numbers,
        "simulate_once",
        lambda catalogue, machine, cases, *told: simulate(catalogue, machine, cases[:7], *told),
    )
    told: list[tuple[int, int]] = []
    assert tell_numbers([in_order], small_catalogue, lambda *done: told.append(done)) == (None, None)
    assert told == sorted(told) and told[-1] == (7, 16)
