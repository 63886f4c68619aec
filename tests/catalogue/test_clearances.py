"""Laws of clearances from likelihoods on grids, and what held-out draws say of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from jointplay.catalogue.matching.clearances import SCALES, Laws, Ranks, laws_of

FloatArray = NDArray[np.float64]

NORMAL_90 = 1.6449


def normal_likelihood(axes: list[FloatArray], middle: FloatArray, spread: FloatArray) -> FloatArray:
    """Of middles (m, k): log likelihoods (m, f) at the points of a grid."""
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    found: FloatArray = -0.5 * np.sum(((points[None] - middle[:, None]) / spread) ** 2, axis=2)
    return found


@pytest.mark.parametrize("points", [(93,), (19, 19), (6, 6, 6)])
def test_laws_are_as_wide_as_the_likelihood_though_points_are_further_apart(points: tuple[int, ...]) -> None:
    axes = [np.linspace(-10.5, -6.0, count) for count in points]
    middle = np.random.default_rng(1).uniform(-8.7, -7.8, (20, len(points)))
    spread = np.array([0.4, 0.5, 0.45])[: len(points)]
    laws = laws_of(normal_likelihood(axes, middle, spread), axes, temperature=2.0)
    for law, own, true in zip(laws, middle.T, spread * np.sqrt(2.0), strict=True):
        assert law.below[:, 0] == pytest.approx(0.0) and law.below[:, -1] == pytest.approx(1.0)
        # The ends of the grid cut off a per cent; the points of three joints are 0.9 apart.
        assert law.quantile(0.5) == pytest.approx(own, abs=0.06)
        width = law.quantile(0.95) - law.quantile(0.05)
        assert width == pytest.approx(np.full(20, 2.0 * NORMAL_90 * true), rel=0.08)
        assert law.ranks(law.quantile(0.3)) == pytest.approx(np.full(20, 0.3))


def test_one_point_is_a_law_too() -> None:
    (law,) = laws_of(np.zeros((2, 1)), [np.array([-9.0])], 1.0)
    assert law.quantile(0.05) == pytest.approx([-9.0, -9.0]) and law.quantile(0.95) == pytest.approx([-9.0, -9.0])


def drawn_laws(true: FloatArray, spread: FloatArray, told: float, generator: np.random.Generator) -> Laws:
    """Normal laws of a spread `told`, about middles that really are `spread` off."""
    axis = np.linspace(-12.0, -4.0, 400)
    middle = true + spread * generator.normal(size=len(true))
    (laws,) = laws_of(normal_likelihood([axis], middle[:, None], np.array([told])), [axis], 1.0)
    return laws


@pytest.mark.parametrize("told", [0.25, 0.3, 0.45])
def test_corrected_intervals_hold_where_clearances_are_known_well_and_where_not(told: float) -> None:
    generator = np.random.default_rng(2)

    def spread(true: FloatArray) -> FloatArray:
        return np.where(true < -8.0, 0.4, 0.2)

    learned, asked = generator.uniform(-10.0, -6.0, (2, 2000))
    ranks = Ranks.of([(drawn_laws(learned, spread(learned), told, generator), learned, np.ones(2000))])
    laws = drawn_laws(asked, spread(asked), told, generator)
    medians = laws.quantile(0.5)
    held, widths = [], []
    for below, median, true in zip(laws.below, medians, asked, strict=True):
        low, high = np.interp([0.05, 0.95], ranks.corrected(below, float(median)), laws.edges)
        held.append(low <= true <= high)
        widths.append(high - low)
    for part, width in ((asked < -8.7, 0.4), (asked > -7.3, 0.2)):
        # Of 700 intervals; a scale is off where that of the other part is within reach.
        assert 0.86 <= np.mean(np.array(held)[part]) <= 0.94
        assert np.median(np.array(widths)[part]) == pytest.approx(2.0 * NORMAL_90 * width, rel=0.12)


def test_laws_stay_as_they_are_where_nothing_is_known() -> None:
    below = np.linspace(0.0, 1.0, 11)
    assert Ranks.of([]).scale(-9.0) == 1.0
    assert Ranks.of([]).corrected(below, -9.0) == pytest.approx(below)


def test_scales_have_limits() -> None:
    generator = np.random.default_rng(3)
    true = generator.uniform(-10.0, -6.0, 500)
    for told, expected in ((0.02, SCALES[1]), (2.0, SCALES[0])):
        laws = drawn_laws(true, np.full(500, 0.2), told, generator)
        assert Ranks.of([(laws, true, np.ones(500))]).scale(-8.0) == pytest.approx(expected)
