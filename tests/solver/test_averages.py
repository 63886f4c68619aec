"""Averages over members and blocks whose scatter is known."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.solver.simulation.averages import Average, has_settled, overall, spread_db, standard_error_db
from jointplay.solver.simulation.blocks import BlockSpectra

RANDOM = np.random.default_rng(1)
BANDS, CHANNELS = 400, 3


def chi_square(*shape: int, freedom: int = 20) -> np.ndarray:
    return RANDOM.chisquare(freedom, (*shape, BANDS, CHANNELS)) / freedom


def test_spread_and_error_of_independent_powers() -> None:
    """Power of 20 degrees of freedom has a relative standard deviation of sqrt(2 / 20): 1.4 dB."""
    power = chi_square(8, 6)
    expected = 10 / np.log(10) * np.sqrt(2 / 20)
    assert np.sqrt(np.mean(spread_db(power[:, 0]) ** 2)) == pytest.approx(expected, rel=0.1)
    error = overall(standard_error_db(power), power.mean(axis=(0, 1)))
    assert expected / np.sqrt(48) < error < 1.35 * expected / np.sqrt(48)  # the larger of two estimates


def test_members_that_resemble_each_other_do_not_count_twice() -> None:
    power = np.repeat(chi_square(1, 6), 8, axis=0)
    expected = 10 / np.log(10) * np.sqrt(2 / 20 / 6)
    assert overall(standard_error_db(power), power.mean(axis=(0, 1))) == pytest.approx(expected, rel=0.1)


def test_blocks_that_resemble_each_other_do_not_count_twice() -> None:
    power = np.repeat(chi_square(8, 1), 6, axis=1)
    expected = 10 / np.log(10) * np.sqrt(2 / 20 / 8)
    assert overall(standard_error_db(power), power.mean(axis=(0, 1))) == pytest.approx(expected, rel=0.1)


def test_overall_takes_the_worst_channel_and_leaves_out_what_is_far_below() -> None:
    values = np.array([[1.0, 3.0], [1.0, 3.0], [50.0, 3.0]])
    power = np.array([[1.0, 1.0], [0.1, 1.0], [1e-9, 1.0]])
    assert overall(values, power) == pytest.approx(3.0)
    assert overall(values[:, :1], power[:, :1]) == pytest.approx(1.0)
    assert overall(values, np.zeros_like(power)) == 0.0


def test_a_transient_is_told_from_scatter() -> None:
    before, after = chi_square(8), chi_square(8)
    assert has_settled(before, after, 0.1)
    assert not has_settled(before * 1.5, after, 0.1)  # 1.8 dB, where scatter explains 0.7 dB
    assert has_settled(before * 1.5, after, 2.0)


def block(members: tuple[int, ...], factor: float = 1.0) -> BlockSpectra:
    return BlockSpectra(members, factor * chi_square(len(members)), np.ones((len(members), 5, CHANNELS)))


def test_the_first_blocks_are_left_out_until_two_agree() -> None:
    average = Average(0.1)
    for factor in (4.0, 2.0, 1.0, 1.0, 1.0):
        average.take(block((0, 1, 2, 3), factor))
    assert average.finish()
    assert (average.dropped, average.blocks, average.seen) == (2, 3, 5)
    assert average.psd == pytest.approx(np.ones((4, 5, CHANNELS)))
    waiting = Average(0.1)
    waiting.take(block((0, 1)))
    assert waiting.error() == np.inf
    assert not waiting.finish()
    assert waiting.blocks == 1


def test_a_member_that_fails_leaves_every_block() -> None:
    average = Average(0.1)
    for members in ((0, 1, 2, 3), (0, 1, 2, 3), (0, 2, 3)):
        average.take(block(members))
    assert average.bands.shape == (3, 3, BANDS, CHANNELS)
    assert average.psd.shape == (3, 5, CHANNELS)
    early = Average(0.1)
    for members in ((0, 1, 2, 3), (1, 2)):
        early.take(block(members))
    assert early.bands.shape == (2, 2, BANDS, CHANNELS)
