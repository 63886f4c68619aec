"""Random modes between joints and sensors."""

from __future__ import annotations

import numpy as np

from jointplay.catalogue.matching.transfer import RandomTransfer


def test_one_mode_of_full_gain_is_the_second_order_system() -> None:
    one = RandomTransfer(modes=(1, 1), frequency=(300.0, 300.0), damping=(0.05, 0.05), gain=(1.0, 1.0))
    edges = np.array([10.0, 10.1, 299.9, 300.1, 2999.0, 3001.0])
    drawn, product, mean = one.draw(np.random.default_rng(1), 3, edges, 2)
    ratio = np.array([10.05, 300.0, 3000.0]) / 300.0
    # 1 + r^2 / (1 - r^2 + 2 i z r) = (1 + 2 i z r) / (1 - r^2 + 2 i z r): the transmissibility.
    expected = np.abs((1 + 2j * 0.05 * ratio) / (1 - ratio**2 + 2j * 0.05 * ratio)) ** 2
    assert np.allclose(drawn[:, [0, 2, 4]], expected[None, :, None], rtol=2e-3)
    assert np.allclose(drawn[0], drawn[2])
    whole = (1 + 2j * 0.05 * ratio) / (1 - ratio**2 + 2j * 0.05 * ratio)
    assert np.allclose(mean[:, [0, 2, 4]], whole[None, :, None], rtol=2e-3)
    # Both channels go all the way through the same mode: what they do stays the same.
    assert np.allclose(product[..., 0], drawn[..., 0], rtol=1e-5)


def test_a_resonance_within_a_wide_band_raises_its_mean() -> None:
    narrow = RandomTransfer(modes=(1, 1), frequency=(450.0, 550.0), damping=(0.02, 0.02), gain=(1.0, 1.0))
    drawn, _, _ = narrow.draw(np.random.default_rng(2), 200, np.array([400.0, 600.0]), 1)
    fine = np.linspace(400.0, 600.0, 20001)
    ratio = fine / 500.0
    exact = np.mean(np.abs((1 + 0.04j * ratio) / (1 - ratio**2 + 0.04j * ratio)) ** 2)
    # Sampled at eight points a band, so single draws scatter; their mean does not.
    assert 0.8 < drawn.mean() / exact < 1.25


def test_draws_depend_on_the_seed_alone() -> None:
    edges = np.geomspace(20.0, 4000.0, 20)
    first, product, _ = RandomTransfer().draw(np.random.default_rng(3), 300, edges, 3)
    again, _, _ = RandomTransfer().draw(np.random.default_rng(3), 300, edges, 3)
    assert first.shape == (300, 19, 3)
    assert np.array_equal(first, again)
    assert (first > 0.0).all()
    assert not np.allclose(first[:, :, 0], first[:, :, 1])
    # No more in common than there is, and phases between channels where modes move them differently.
    assert (np.abs(product[..., 0]) <= np.sqrt(first[..., 0] * first[..., 1]) * (1 + 1e-5)).all()
    assert np.abs(np.angle(product)).max() > 1.0
