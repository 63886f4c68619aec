"""The definition of harmonic error on signals whose lines are known."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.harmonics import (
    count_of,
    find_comparable,
    harmonic_error,
    harmonic_levels,
    mean_difference_db,
    order_band_levels,
    whole_rate,
)

RATE, DRIVE = 10_000.0, 10.0
TIME = np.arange(5500) / RATE  # five revolutions and a half


def lines(amplitudes: dict[int, float]) -> np.ndarray:
    return np.sum([a * np.sin(2 * np.pi * k * DRIVE * TIME + k) for k, a in amplitudes.items()], axis=0)


def test_levels_of_known_lines() -> None:
    levels = harmonic_levels(lines({1: 1.0, 3: 0.1, 200: 0.5}), RATE, DRIVE)
    assert levels.shape == (200,)
    assert levels[[0, 2, 199]] == pytest.approx([0.0, -20.0, 20 * np.log10(0.5)], abs=1e-9)
    assert levels[1] < -250  # rounding


def test_error_is_the_mean_over_lines_that_stand_out() -> None:
    reference = lines({1: 1.0, 2: 0.1, 3: 1e-6})
    found = lines({1: 1.0, 2: 0.2, 3: 1e-3})
    assert find_comparable(harmonic_levels(reference, RATE, DRIVE)).sum() == 2
    assert harmonic_error(found, reference, RATE, DRIVE) == pytest.approx(20 * np.log10(2) / 2, abs=1e-9)
    assert harmonic_error(found[:3000], reference, RATE, DRIVE) == pytest.approx(20 * np.log10(2) / 2, abs=1e-9)


def test_mean_difference_of_several_runs() -> None:
    assert mean_difference_db([[1.0, 2.0], [3.0, -90.0]], [0.0, 0.0]) == pytest.approx(24.0)


@pytest.mark.parametrize(("frequency", "count"), [(2.0, 200), (10.0, 200), (20.0, 100), (1999.0, 1), (5000.0, 1)])
def test_first_200_or_all_below_2_khz(frequency: float, count: int) -> None:
    assert count_of(frequency) == count


def test_bands_hold_the_power_of_their_order() -> None:
    levels = order_band_levels(lines({1: 1.0, 7: 0.1}), RATE, DRIVE)
    assert levels[[0, 6]] == pytest.approx(10 * np.log10([0.5, 0.005]), abs=1e-6)


def test_rates_hold_whole_revolutions() -> None:
    assert whole_rate(3.0, 10_000) == 3 * 3334
    assert whole_rate(10.0, 10_000) == 10_000


@pytest.mark.parametrize(("length", "rate"), [(900, RATE), (5500, 9999.0), (5500, 4000.0)])
def test_refusals(length: int, rate: float) -> None:
    with pytest.raises(SettingsError):
        harmonic_levels(TIME[:length], rate, DRIVE)
