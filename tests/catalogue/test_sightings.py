"""What held-out draws show of each joint: against draws whose curve of detection is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import expit, softmax

from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.sightings import ALIKE, SEEN_SHARE, Sightings

FloatArray = NDArray[np.float64]

LOW, HIGH = float(np.log(30e-6)), float(np.log(1e-3))
STEEP = 9.0  # of the true curve, over ln(clearance): three quarters of what is expected of it
SURE = float(np.log(SEEN_SHARE / (1.0 - SEEN_SHARE)))


def sightings(joints: str, clearances: list[dict[str, FloatArray]], seen: list[dict[str, FloatArray]]) -> Sightings:
    """Blocks of draws, each with ln(clearance) of its worn joints and whether they were seen."""
    rows = [len(next(iter(block.values()))) for block in clearances]
    log_clearance = np.full((sum(rows), len(joints)), np.nan)
    p_worn = np.full((sum(rows), len(joints)), 0.01)
    start = 0
    for count, block, shown in zip(rows, clearances, seen, strict=True):
        for joint, values in block.items():
            log_clearance[start : start + count, joints.index(joint)] = values
            p_worn[start : start + count, joints.index(joint)] = np.where(shown[joint], 0.98, 0.03)
        start += count
    return Sightings(tuple(joints), log_clearance, p_worn, Conformal(np.array([0.5]), np.array([0.5])))


def of_one_joint(x: FloatArray, seen: FloatArray) -> Sightings:
    return sightings("AB", [{"A": x}], [{"A": seen}])


def drawn(count: int, middle: float | FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Clearances, and whether each was seen: half of them at the middle."""
    generator = np.random.default_rng(seed)
    x = generator.uniform(LOW, HIGH, count)
    return x, generator.uniform(size=count) < expit(STEEP * (x - middle))


def scatter_of_limit(x: FloatArray, middle: float) -> float:
    """Standard deviation of ln(limit) that no unbiased estimate from draws at x can be below (Fisher's information)."""
    p = expit(STEEP * (x - middle))
    design = np.column_stack([np.ones(len(x)), x - middle])
    covariance = np.linalg.inv((design * (p * (1.0 - p))[:, None]).T @ design)
    slope = np.array([-1.0 / STEEP, -SURE / STEEP**2])
    return float(np.sqrt(slope @ covariance @ slope))


@pytest.mark.parametrize("count", [150, 1200])
def test_limit_of_detection_is_found_within_what_its_draws_allow(count: int) -> None:
    middle = float(np.log(120e-6))
    off = []
    for seed in range(60):
        x, seen = drawn(count, middle, seed)
        found = of_one_joint(x, seen).detectable_from("A", {})
        assert found is not None
        off.append((np.log(found) - middle - SURE / STEEP) / scatter_of_limit(x, middle))
    # What is known of slopes beforehand makes the estimate a little better than its draws alone.
    assert 0.6 < np.std(off) < 1.2
    assert abs(np.mean(off)) < 0.4
    assert np.abs(off).max() < 4.0  # 3.7: steep curves have few draws on them, and the estimate a long tail


def test_nothing_seen_has_no_limit_and_all_seen_the_least_clearance() -> None:
    x, _ = drawn(300, 0.0, 3)
    assert of_one_joint(x, np.zeros(300, dtype=bool)).detectable_from("A", {}) is None
    found = of_one_joint(x, np.ones(300, dtype=bool)).detectable_from("A", {})
    # One draw is supposed unseen below all of them, so that a single seen one is not taken for a law.
    assert found == pytest.approx(np.exp(x.min()), rel=0.05)
    few = of_one_joint(x[:3], np.ones(3, dtype=bool)).detectable_from("A", {})
    assert few is None or few > 1.05 * np.exp(x[:3].min()) > 1.04 * found


def test_what_is_seen_too_seldom_at_the_largest_clearance_has_no_limit() -> None:
    x, seen = drawn(2000, HIGH, 4)
    assert of_one_joint(x, seen).detectable_from("A", {}) is None
    # Half of them seen, whatever the clearance.
    even = np.arange(2000) % 2 == 0
    assert of_one_joint(x, even).detectable_from("A", {}) is None


def test_a_joint_that_no_draw_has_worn_has_no_limit() -> None:
    x, seen = drawn(100, float(np.log(100e-6)), 5)
    assert of_one_joint(x, seen).detectable_from("B", {}) is None


def test_clearances_of_other_worn_joints_matter() -> None:
    generator = np.random.default_rng(6)
    single, seen_alone = drawn(800, float(np.log(60e-6)), 7)
    other = generator.uniform(LOW, HIGH, 4000)
    # The larger the other clearance, the more of this one it hides: half seen at a half of the other.
    beside, seen_beside = drawn(4000, other + np.log(0.5), 8)
    found = sightings(
        "AB",
        [{"A": single}, {"A": beside, "B": other}],
        [{"A": seen_alone}, {"A": seen_beside, "B": np.ones(4000, dtype=bool)}],
    )
    assert found.detectable_from("A", {}) == pytest.approx(60e-6 * np.exp(SURE / STEEP), rel=0.1)
    # Draws of other machines that are like this one count, too, which makes the curve as much less steep.
    blurred = np.hypot(1.0 / STEEP, ALIKE * np.sqrt(3.0) / np.pi)
    for clearance in (100e-6, 300e-6):
        limit = 0.5 * clearance * np.exp(SURE * blurred)
        assert found.detectable_from("A", {"B": clearance}) == pytest.approx(limit, rel=0.1)
    # A joint is no other of itself.
    assert found.detectable_from("A", {"A": 1e-3}) == found.detectable_from("A", {})


def test_the_smallest_other_joints_are_left_aside_where_no_draw_has_them_all() -> None:
    generator = np.random.default_rng(9)
    single, seen_alone = drawn(400, float(np.log(60e-6)), 10)
    beside, seen_beside = drawn(400, float(np.log(200e-6)), 11)
    other, all_seen = generator.uniform(LOW, HIGH, 400), np.ones(400, dtype=bool)
    found = sightings(
        "ABC", [{"A": single}, {"A": beside, "B": other}], [{"A": seen_alone}, {"A": seen_beside, "B": all_seen}]
    )
    with_large = found.detectable_from("A", {"B": 300e-6})
    assert found.detectable_from("A", {"B": 300e-6, "C": 40e-6}) == with_large
    # Of B and a larger C the larger one stays as long as there are draws of it, and there are none.
    assert found.detectable_from("A", {"B": 40e-6, "C": 300e-6}) == found.detectable_from("A", {})


WORN = [(), ("A",), ("B",), ("A", "B")]


def judged(count: int, sharpness: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Clearances, posteriors, and weights of draws; what is claimed is `sharpness` times what is known."""
    generator = np.random.default_rng(seed)
    truth = np.arange(count) % len(WORN)
    log_clearance = np.full((count, 2), np.nan)
    for column, joint in enumerate("AB"):
        worn = np.array([joint in WORN[each] for each in truth])
        log_clearance[worn, column] = generator.uniform(LOW, HIGH, int(worn.sum()))
    score = generator.normal(size=(count, len(WORN))) + 2.5 * np.eye(len(WORN))[truth]
    return log_clearance, softmax(2.5 * sharpness * score, axis=1), np.full(count, 1.0 / count)


@pytest.mark.parametrize("coverage", [0.8, 0.9, 0.95])
@pytest.mark.parametrize("sharpness", [0.3, 1.0, 3.0])
def test_conditions_hold_as_often_as_promised_on_fresh_draws(coverage: float, sharpness: float) -> None:
    clearances, posterior, weights = judged(4000, sharpness, 12)
    found = Sightings.of("AB", WORN, clearances, posterior, weights)
    assert found is not None
    fresh, said, _ = judged(8000, sharpness, 13)
    p_worn = np.stack([said[:, 1] + said[:, 3], said[:, 2] + said[:, 3]], axis=1)
    right, wrong = 0, 0
    for p, is_worn in zip(p_worn.ravel(), np.isfinite(fresh).ravel(), strict=True):
        condition = found.condition(float(p), coverage)
        right += condition is not None and condition == is_worn
        wrong += condition is not None and condition != is_worn
    # Joints of one draw go together: 8000 draws are known to 0.3 %, the 4000 learned from to 0.4 %.
    assert wrong / p_worn.size < 1.0 - coverage + 0.012
    # Most are told: what is held back are the doubtful ones.
    assert right / p_worn.size > 0.75


def test_a_joint_of_which_both_or_neither_is_left_is_open() -> None:
    clearances, posterior, weights = judged(4000, 1.0, 14)
    found = Sightings.of("AB", WORN, clearances, posterior, weights)
    assert found is not None
    assert found.condition(0.999, 0.9) is True
    assert found.condition(0.001, 0.9) is False
    assert found.condition(0.5, 0.9) is None
    # Next to certainty nothing is left out.
    assert found.condition(0.9, 1.0 - 1e-9) is None


def test_nothing_is_learned_where_no_joint_is_worn() -> None:
    nothing = np.full((8, 2), np.nan)
    posterior = np.full((8, 4), 0.25)
    assert Sightings.of("AB", WORN, nothing, posterior, np.full(8, 0.125)) is None
    assert Sightings.of("", [()], np.zeros((8, 0)), np.ones((8, 1)), np.full(8, 0.125)) is None
