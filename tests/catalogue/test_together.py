"""Several recordings of one machine: the arithmetic of their common answer, and answers from end to end."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from recordings import RECORDINGS
from scipy.special import ndtr

from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.diagnosing.heard import Heard
from jointplay.catalogue.diagnosing.hearing import hear
from jointplay.catalogue.diagnosing.question import MOST_TOGETHER, Question
from jointplay.catalogue.diagnosing.together import _causes, conclude, diagnose_together
from jointplay.catalogue.errors import DiagnosisError, MeasurementError
from jointplay.catalogue.matching.matcher import ClearanceEstimate, HypothesisMatch, MatchResult
from jointplay.catalogue.matching.model_library import library_of
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import SLIP, Likeness, match_together
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.storage.store import Catalogue

EDGES = np.linspace(math.log(20e-6), math.log(2e-3), 2001)
PRIOR = np.array([0.25, 0.4, 0.35])
APART = Likeness(0.0, 0.0)


def said(probabilities: tuple[float, float, float], centres_um: tuple[float, float], width: float = 0.2) -> MatchResult:
    """What one recording says of three hypotheses; clearances have normal laws of ln c."""
    nothing = np.zeros(0)
    found = [HypothesisMatch("healthy", (), probabilities[0], (), 1.0, 0.5, nothing, nothing)]
    for joint, probability, centre in zip("AB", probabilities[1:], centres_um, strict=True):
        below = ndtr((EDGES - math.log(1e-6 * centre)) / width)
        below = (below - below[0]) / (below[-1] - below[0])
        low, median, high = np.exp(np.interp([0.05, 0.5, 0.95], below, EDGES)).tolist()
        clearance = ClearanceEstimate(joint, median, low, high, (EDGES, below))
        found.append(HypothesisMatch(joint, (joint,), probability, (clearance,), 2.0, 0.4, nothing, nothing))
    return MatchResult(tuple(found), trusted_p_value=0.4)


def test_weights_are_those_of_equally_correlated_errors() -> None:
    likeness = Likeness(0.6, 0.25)
    for count in (1, 2, 5):
        assert likeness.weights([1.0] * count) == pytest.approx(np.full(count, 1 / (1 + 0.6 * (count - 1))))
        assert likeness.weights([0.5 + k for k in range(count)]).sum() == pytest.approx(
            count / (1 + 0.25 * (count - 1))
        )


def test_a_recording_more_never_takes_anything_away() -> None:
    draw = np.random.default_rng(1)
    for _ in range(50):
        likeness = Likeness(*np.sort(draw.uniform(0, 0.95, 2))[::-1])
        speeds: list[float] = []
        total = 0.0
        for speed in draw.choice([0.8, 1.0, 1.2], 8):
            speeds.append(float(speed))
            weights = likeness.weights(speeds)
            assert weights.min() > 0.0
            assert weights.sum() >= total - 1e-12
            total = weights.sum()


def test_independent_recordings_multiply() -> None:
    """Normal laws of equal width about 100 and 120 um: about their geometric mean, narrower by the root of two."""
    one, other = said((0.1, 0.6, 0.3), (100, 300)), said((0.2, 0.5, 0.3), (120, 300))
    joined = match_together([one, other], PRIOR, [1.0, 1.2], APART).result
    ((clearance,),) = [match.clearances for match in joined.hypotheses if match.label == "A"]
    # A law that is nowhere below a fiftieth of what was likely before is a little wider than the product.
    assert clearance.median == pytest.approx(math.sqrt(100e-6 * 120e-6), rel=0.005)
    assert math.log(clearance.high / clearance.low) == pytest.approx(2 * 1.645 * 0.2 / math.sqrt(2), rel=0.02)
    width, span = 0.2, EDGES[-1] - EDGES[0]
    agree = [
        span / math.sqrt(4 * math.pi) / width * math.exp(-0.25 * (math.log(b / a) / width) ** 2)
        for a, b in ((100, 120), (300, 300))
    ]
    weight = np.array([0.1 * 0.2, 0.6 * 0.5 * agree[0], 0.3 * 0.3 * agree[1]]) / PRIOR
    expected = weight / weight.sum()
    found = [joined.probability(label) for label in ("healthy", "A", "B")]
    assert found == pytest.approx(expected.tolist(), rel=0.03)


def test_clearances_that_agree_tell() -> None:
    """Both recordings think A as likely as B, but only of B are they of one size."""
    one, other = said((0.02, 0.49, 0.49), (60, 300)), said((0.02, 0.49, 0.49), (600, 310))
    joined = match_together([one, other], PRIOR, [1.0, 0.8], APART).result
    assert joined.best.label == "B"
    assert joined.best.probability > 0.99


def test_a_recording_that_says_nothing_changes_nothing() -> None:
    one, nothing = said((0.1, 0.6, 0.3), (100, 300)), said((0.25, 0.4, 0.35), (200, 200), width=100.0)
    joined = match_together([one, nothing], PRIOR, [1.0, 1.2], APART)
    for label in ("healthy", "A", "B"):
        assert joined.result.probability(label) == pytest.approx(one.probability(label), abs=3 * SLIP)
    assert joined.for_one_machine == pytest.approx([0.0, 0.0], abs=0.05)


def test_alike_recordings_count_less() -> None:
    """Of one speed, as alike as can be, two say what one says."""
    one = said((0.1, 0.6, 0.3), (100, 300))
    joined = match_together([one, one], PRIOR, [1.0, 1.0], Likeness(0.999, 0.3)).result
    assert joined.probability("A") == pytest.approx(0.6, abs=0.01)
    clearance = next(match for match in joined.hypotheses if match.label == "A").clearances[0]
    assert math.log(clearance.high / clearance.low) == pytest.approx(2 * 1.645 * 0.2, rel=0.05)


@pytest.mark.parametrize("beside", [False, True])
def test_the_order_does_not_matter(beside: bool) -> None:
    parts = [said((0.1, 0.6, 0.3), (100, 300)), said((0.2, 0.5, 0.3), (120, 300)), said((0.3, 0.3, 0.4), (90, 500))]
    parts = [replace(part, beside=beside) for part in parts]
    forth = match_together(parts, PRIOR, [1.0, 1.0, 1.2])
    back = match_together(parts[::-1], PRIOR, [1.2, 1.0, 1.0])
    assert back.weights[::-1] == pytest.approx(forth.weights)
    for label in ("healthy", "A", "B"):
        assert back.result.probability(label) == pytest.approx(forth.result.probability(label), rel=1e-9)


@pytest.mark.parametrize("beside", [False, True])
def test_one_that_contradicts_stands_out(beside: bool) -> None:
    told = said((0.0, 1.0, 0.0), (200, 200)), said((0.0, 0.0, 1.0), (200, 200))
    worn, other = (replace(each, beside=beside) for each in told)
    joined = match_together([worn, worn, worn, other], PRIOR, [0.8, 1.0, 1.2, 1.0])
    assert joined.result.best.label == "A"
    assert joined.for_one_machine[3] < math.log(0.05)
    assert (joined.for_one_machine[:3] > 0.0).all()


def test_a_load_that_holds_joints_shut_says_nothing_of_them() -> None:
    """Beside a load that no file holds, a machine looks in order and is not as filed; without it, A is worn."""
    shut = replace(said((0.998, 0.001, 0.001), (200, 200)), trusted_p_value=1e-6)
    free = said((0.001, 0.998, 0.001), (200, 300))
    both = match_together([shut, free], PRIOR, [1.0, 1.0])
    joined = both.result
    assert joined.best.label == "A" and joined.best.probability > 0.9
    assert both.held_shut == (("A",), ())
    assert joined.trusted_p_value == pytest.approx(0.4)
    clearance = joined.best.clearances[0]
    assert clearance.median == pytest.approx(200e-6, rel=0.01)
    # Machines in order do not look worn because of a load: two to one, they stay in order.
    sound = match_together([shut, shut, said((0.4, 0.4, 0.2), (200, 300))], PRIOR, [1.0, 1.0, 1.0]).result
    assert sound.best.label == "healthy" and sound.trusted_p_value < 1e-5


def test_a_state_that_a_load_may_hide_is_explained_as_it_then_looks() -> None:
    """The first recording may be of A, by its levels only of a machine in order: with A held shut that is one state."""
    free = said((0.001, 0.998, 0.001), (200, 300))
    for in_order, expected in ((0.2, 2 * 0.2), (1e-6, 2e-6)):
        healthy, worn, other = said((0.3, 0.6, 0.1), (200, 200)).hypotheses
        held = replace(free, hypotheses=(replace(healthy, p_value=in_order), replace(worn, p_value=1e-6), other))
        best = match_together([held, free], PRIOR, [1.0, 1.0]).result.best
        assert best.label == "A" and best.p_value == pytest.approx(expected)
        # A joint that none of the recordings shows is not explained by being hidden in all.
        both = match_together([held, held], PRIOR, [1.0, 1.0]).result.best
        assert both.label == "A" and both.p_value == pytest.approx(2e-6)


def test_a_common_answer_has_heard_the_past_if_all_recordings_were() -> None:
    one = said((0.2, 0.7, 0.1), (200, 300))
    for heard in ((True, True), (True, False), (False, False)):
        results = [replace(one, beside=each) for each in heard]
        assert match_together(results, PRIOR, [1.0, 1.2]).result.beside is all(heard)


def test_beside_the_past_what_is_worn_is_told_anew_and_how_much_is_not() -> None:
    """At another speed the odds of the joints nearly multiply, at the same one less, and least without the past."""
    one = said((0.2, 0.5, 0.3), (150, 150))
    odds = (0.5 / 0.4) / (0.3 / 0.35)
    widths = []
    for beside, speed, counts in ((True, 1.2, 2.0 / 1.1), (True, 1.0, 2.0 / 1.3), (False, 1.2, 2.0 / 1.4)):
        both = match_together([replace(one, beside=beside)] * 2, PRIOR, [1.0, speed])
        assert both.weights == pytest.approx([0.5 * counts] * 2)
        found = both.result.probability("A") / both.result.probability("B")
        assert found == pytest.approx(odds**counts * 0.4 / 0.35, rel=0.01)
        (clearance,) = next(match for match in both.result.hypotheses if match.label == "A").clearances
        widths.append(math.log(clearance.high / clearance.low))
    # As of measurements whose errors have the correlations 0.4, 0.7 and 0.4.
    expected = [2 * 1.645 * 0.2 * math.sqrt(0.5 * (1.0 + alike)) for alike in (0.4, 0.7, 0.4)]
    assert widths == pytest.approx(expected, rel=0.02)


def test_what_is_heard_by_itself_takes_nothing_from_what_is_heard_beside_the_past() -> None:
    """What those still have wrong is another thing than what these have: either kind counts as if alone."""
    one = said((0.1, 0.6, 0.3), (100, 300))
    heard, other = replace(one, beside=True), one
    for results, speeds, weights in (
        ((heard, heard, other), [0.8, 1.0, 1.2], [1 / 1.1, 1 / 1.1, 1.0]),
        ((heard, heard, other), [1.0, 1.0, 1.0], [1 / 1.3, 1 / 1.3, 1.0]),
        ((other, heard, other), [0.8, 1.0, 1.2], [1 / 1.4, 1.0, 1 / 1.4]),
    ):
        both = match_together(results, PRIOR, speeds)
        assert both.weights == pytest.approx(weights)
        alone = match_together([other, other], PRIOR, [0.8, 1.2]).result.probability("A")
        assert both.result.probability("A") > alone


def recording(number: int) -> Recording:
    return read_measurement(RECORDINGS / f"slider-crank-{number:02}.csv.gz")


def part(whole: Recording, number: int) -> Recording:
    """The first or second half of a recording."""
    half = len(whole.signal) // 2
    signal = np.ascontiguousarray(whole.signal[number * half : (number + 1) * half])
    return replace(whole, name=f"{whole.name} {number}", signal=signal, sha256=hashlib.sha256(signal).hexdigest())


@pytest.fixture(scope="module")
def halves(small_catalogue: Catalogue) -> Diagnosis:
    return diagnose_together([part(recording(2), 0), part(recording(2), 1)], small_catalogue)


def test_two_halves_of_a_recording(halves: Diagnosis, small_catalogue: Catalogue) -> None:
    whole = diagnose(recording(2), small_catalogue)
    assert halves.verdict == whole.verdict == "worn"
    assert halves.hypotheses[0].label == whole.hypotheses[0].label
    assert [share.alone for share in halves.recordings] == [halves.hypotheses[0].label] * 2
    assert all(share.one_machine > 1.0 and not share.contradicts and not share.left_out for share in halves.recordings)
    assert 1.0 < sum(share.weight for share in halves.recordings) < 2.0
    assert halves.id != whole.id
    assert Diagnosis.model_validate_json(halves.to_json()) == halves


def test_the_same_file_twice_counts_once(small_catalogue: Catalogue) -> None:
    once, twice = (diagnose_together([recording(2)] * count, small_catalogue) for count in (1, 2))
    assert once == diagnose(recording(2), small_catalogue)
    assert twice.hypotheses == once.hypotheses
    three = diagnose_together([part(recording(2), 0), part(recording(2), 1), part(recording(2), 1)], small_catalogue)
    assert len(three.recordings) == 2
    assert "1 given twice: counted once" in three.warnings


def test_columns_may_be_named_otherwise_in_each(halves: Diagnosis, small_catalogue: Catalogue) -> None:
    one, other = part(recording(2), 0), part(recording(2), 1)
    channels = (replace(other.channels[0], name="Kanal 1"), *other.channels[1:])
    renamed = replace(other, channels=channels, sha256="0" * 64)
    mapped = diagnose_together([one, renamed], small_catalogue, mapping={"Kanal 1": other.channels[0].name})
    assert mapped.hypotheses == halves.hypotheses
    with pytest.raises(MeasurementError, match="'Kanal 2': is mapped but not in the recording"):
        diagnose_together([one, renamed], small_catalogue, mapping={"Kanal 2": other.channels[0].name})


def test_recordings_of_two_machines_contradict(small_catalogue: Catalogue) -> None:
    """Two halves with one worn joint, and a recording of a machine with another."""
    odd = recording(3)
    answer = diagnose_together([part(recording(2), 0), part(recording(2), 1), odd], small_catalogue)
    shares = {share.measurement: share for share in answer.recordings}
    assert shares[odd.name].contradicts
    assert shares[odd.name].without == diagnose(recording(2), small_catalogue).hypotheses[0].label
    assert any(line.startswith(f"{odd.name}: contradicts the others") for line in answer.warnings)


def test_that_a_cause_has_come_since_is_what_most_say() -> None:
    """Whichever is the first."""
    told = [NamedCause("mount 1", 0.6, "x stiffness", 0.9, since=since) for since in (True, True, False)]
    for order in (told, told[::-1]):
        (cause,) = _causes([cast(Heard, SimpleNamespace(causes=(each,))) for each in order])
        assert cause.since
    one_of_two = _causes([cast(Heard, SimpleNamespace(causes=(each,))) for each in told[1:]])
    assert not one_of_two[0].since


def test_what_only_a_load_reconciles_is_said(small_catalogue: Catalogue) -> None:
    """It may as well be older than the wear, or newer than a repair: that the recordings do not say."""
    in_order, worn = recording(1), recording(2)
    answer = diagnose_together([in_order, worn], small_catalogue, effort="fast")
    assert answer.hypotheses[0].label == "B"
    assert [share.held_shut for share in answer.recordings] == [("B",), ()]
    said = f"{in_order.name}: looks to have B in order; it agrees if a load held B shut, not if it was made before the"
    assert any(line.startswith(said) for line in answer.warnings)


def test_one_that_is_spoiled_is_left_out(halves: Diagnosis, small_catalogue: Catalogue) -> None:
    """A foreign force in the low orders: nothing that the catalogue knows explains it, the others are explained."""
    whole = part(recording(2), 1)
    time = np.arange(len(whole.signal)) / whole.sample_rate
    signal = whole.signal + 10.0 * np.sin(2 * math.pi * 1.0 * halves.drive_speed_rpm / 60.0 * time)[:, None]
    spoiled = replace(whole, name="spoiled", signal=signal, sha256=hashlib.sha256(signal).hexdigest())
    two = [part(recording(2), 0), whole]
    answer = diagnose_together([*two, spoiled], small_catalogue)
    share = answer.recordings[2]
    assert share.left_out
    assert share.weight == 0.0
    assert answer.verdict == halves.verdict
    assert answer.hypotheses == halves.hypotheses


def test_what_is_changed_alone_is_not_in_order_together(small_catalogue: Catalogue) -> None:
    library, question = library_of(small_catalogue), Question()
    scale = (small_catalogue.scheme, small_catalogue.recipe.nominal_drive_speed)
    told = {}
    for number in (1, 2):
        heard = []
        for half in (part(recording(number), 0), part(recording(number), 1)):
            prepared = prepare(half, small_catalogue.machine, None, None, *scale)
            heard.append(hear(prepared, half.sha256, small_catalogue, question, library))
        for verdicts in (("changed", "changed"), (heard[0].verdict, "changed"), (heard[0].verdict, heard[1].verdict)):
            seen = [replace(each, verdict=verdict) for each, verdict in zip(heard, verdicts, strict=True)]
            told[number, verdicts.count("changed")] = conclude(seen, small_catalogue, question, library).verdict
    assert [told[1, count] for count in (0, 1, 2)] == ["in_order", "changed", "changed"]
    assert [told[2, count] for count in (0, 1, 2)] == ["worn", "worn", "worn"]  # nearly sure


def test_the_same_bytes_read_otherwise_are_refused(small_catalogue: Catalogue) -> None:
    one = recording(2)
    with pytest.raises(DiagnosisError, match="is given twice, and something else is said of it"):
        diagnose_together([one, replace(one, signal=2.0 * one.signal)], small_catalogue)


def test_joints_of_the_prior_are_checked(small_catalogue: Catalogue) -> None:
    with pytest.raises(DiagnosisError, match=r"prior\.joints\.Z: must be one of the joints A, B, O"):
        diagnose_together([part(recording(2), 0), part(recording(2), 1)], small_catalogue, prior=Prior(joints={"Z": 2}))


@pytest.mark.parametrize(
    ("count", "speeds", "message"),
    [
        (0, None, r"measurements: 0: must be 1 to 20"),
        (MOST_TOGETHER + 1, None, r"measurements: 21: must be 1 to 20"),
        (2, [60.0], r"speed: 1 for 2 measurements: must be one for each, or none"),
    ],
)
def test_refusals(count: int, speeds: list[float] | None, message: str, small_catalogue: Catalogue) -> None:
    with pytest.raises(DiagnosisError, match=message):
        diagnose_together([recording(2)] * count, small_catalogue, speeds=speeds)
