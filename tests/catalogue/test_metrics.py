"""Figures of merit against values worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointplay.catalogue.evaluation.metrics import Answered, auroc, count_rejected, figures, joint_scores, reliability

JOINTS = {"healthy": frozenset[str](), "A": frozenset("A"), "B": frozenset("B"), "A+B": frozenset("AB")}


def answered(
    label: str, worn: str, *probabilities: float, p_value: float = 0.5, trusted: float | None = None
) -> Answered:
    by_label = dict(zip(JOINTS, probabilities, strict=True))
    joints = {joint: sum(by_label[name] for name in JOINTS if joint in JOINTS[name]) for joint in "AB"}
    first = max(by_label, key=lambda name: by_label[name])
    return Answered(
        label=label,
        worn=frozenset(worn),
        clearances_um=dict.fromkeys(worn, 100.0),
        probabilities=by_label,
        joint_probabilities=joints,
        found=dict.fromkeys(sorted(JOINTS[first]), (110.0, 90.0, 120.0)),
        candidates=(first,),
        verdict="worn" if JOINTS[first] else "in_order",
        p_value=p_value,
        trusted_p_value=trusted,
        seconds=0.1,
        simulations=0,
    )


ANSWERS = (
    answered("A", "A", 0.0, 0.8, 0.1, 0.1),
    answered("A", "A", 0.1, 0.3, 0.0, 0.6),
    answered("healthy", "", 0.9, 0.1, 0.0, 0.0),
    answered("A+B", "AB", 0.0, 0.5, 0.4, 0.1),
)


def test_ranks_sets_and_verdicts() -> None:
    found = figures(ANSWERS, JOINTS)
    assert found.count == 4
    assert (found.top1, found.top2) == (0.5, 0.75)
    assert found.exact_set == 0.5
    assert found.joints_in_top2 == 1.0  # the last one is called A, then B: both joints are among the first two
    assert found.log_loss == pytest.approx(-np.mean(np.log([0.8, 0.3, 0.9, 0.1])))
    assert found.set_coverage == 0.5
    assert found.set_size == 1.0
    assert (found.unknown, found.changed, found.in_order, found.wrong_verdict) == (0.0, 0.0, 0.25, 0.0)
    assert found.labels == ("healthy", "A", "A+B")
    assert found.confusion == ((1, 0, 0, 0), (0, 1, 0, 1), (0, 1, 0, 0))
    assert found.clearance_median == pytest.approx(0.1)
    assert found.interval_coverage == 1.0
    assert found.auroc_deciding is found.auroc_trusted is found.rejected is None


def test_play_of_fits_is_no_wear() -> None:
    """Every joint of every machine has clearance; what counts are those that are worn."""
    fits = {"A": 8.0, "B": 8.0}
    plain = figures(ANSWERS, JOINTS)
    assert figures([replace(each, clearances_um={**fits, **each.clearances_um}) for each in ANSWERS], JOINTS) == plain
    found = figures([replace(ANSWERS[2], clearances_um=fits)], JOINTS)
    assert (found.top1, found.exact_set, found.wrong_verdict) == (1.0, 1.0, 0.0)
    assert found.confusion == ((1, 0, 0, 0),)


def test_truths_that_no_catalogue_holds_count_by_joints_only() -> None:
    found = figures([replace(ANSWERS[3], label="A+B+C", worn=frozenset("ABC"))], JOINTS)
    assert found.top1 is found.log_loss is found.set_coverage is None
    assert found.exact_set == 0.0


def test_what_is_not_listed_is_judged_by_the_p_value_that_decides_and_by_the_trusted_one() -> None:
    # A robust answer explains what the trusted model does not: its p-value decides, and is the larger one.
    foreign = [answered("A", "A", 0.0, 0.8, 0.1, 0.1, p_value=p, trusted=0.001) for p in (0.02, 0.07, 0.5, 0.9)]
    steps = [n / 20 for n in range(1, 21)]
    listed = [answered("A", "A", 0.0, 0.8, 0.1, 0.1, p_value=p, trusted=p) for p in steps]
    found = figures(foreign, JOINTS, listed)
    assert found.auroc_trusted == 1.0
    # Smaller than 20, 19, 10.5 (with a tie) and 2.5 of the 20 listed ones.
    assert found.auroc_deciding == pytest.approx((20 + 19 + 10.5 + 2.5) / 80)
    assert found.rejected == 0.5  # below 0.1, which one of 20 is below
    robust = [replace(answer, trusted_p_value=None) for answer in foreign]
    assert figures(robust, JOINTS, listed).auroc_trusted is None


def test_false_alarms_are_at_most_what_is_asked() -> None:
    generator = np.random.default_rng(3)
    for count in (1, 7, 19, 20, 60, 100):
        listed = generator.random(count).tolist()
        found = count_rejected(listed, listed)
        assert found == pytest.approx(np.floor(0.05 * count) / count)
    assert count_rejected([0.1, 0.3], [0.1] * 40) == 0.0
    assert count_rejected([0.1], []) is count_rejected([], [0.1]) is None


def test_area_under_the_curve_is_the_share_of_pairs_in_order() -> None:
    generator = np.random.default_rng(1)
    positive, negative = generator.integers(0, 9, 40).tolist(), generator.integers(2, 12, 30).tolist()
    pairs = [1.0 if p > n else 0.5 if p == n else 0.0 for p in positive for n in negative]
    assert auroc(positive, negative) == pytest.approx(np.mean(pairs))
    assert auroc([], [1.0]) is None


def test_joint_scores() -> None:
    a, b = joint_scores(ANSWERS)
    assert (a.joint, b.joint) == ("A", "B")
    # A: probabilities 0.9, 0.9, 0.1, 0.6, worn in the first two and the last. B: 0.2, 0.6, 0, 0.5, worn in the last.
    assert (a.precision, a.recall, a.f1) == (1.0, 1.0, 1.0)
    assert (b.precision, b.recall, b.f1) == (0.0, 0.0, 0.0)


def test_reliability_bins() -> None:
    bins = reliability(np.array([0.55, 0.95, 0.99, 1.0]), np.array([False, True, True, False]))
    assert len(bins) == 10
    assert (bins[5].count, bins[5].right) == (1, 0.0)
    assert bins[9].count == 3
    assert bins[9].confidence == pytest.approx(0.98)
    assert bins[9].right == pytest.approx(2 / 3)
    assert bins[0].confidence is bins[0].right is None
