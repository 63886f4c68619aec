"""Signals over angle: what is periodic in the angle is a line there, whatever the speed does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.by_angle import cascade, resample_by_angle

RATE = 20_000.0
TIME = np.arange(0, 6, 1 / RATE)


def test_a_swinging_speed_spreads_nothing() -> None:
    """Nothing but the one order is there, 0.04 % too strong; seen at 0.35 of the sample rate: 0.3 % too weak."""
    angle = 2 * math.pi * 10 * TIME + 0.3 * np.sin(2 * math.pi * 10 * TIME)
    even, samples = resample_by_angle(np.sqrt(2) * np.sin(40 * angle)[:, None], angle)
    lines = np.abs(np.fft.rfft(even[: 50 * samples, 0])) / (50 * samples) * math.sqrt(2)
    assert lines[40 * 50] == pytest.approx(1.0, abs=1e-3)
    lines[40 * 50] = 0.0
    assert lines.max() < 1e-3
    fast, _ = resample_by_angle(np.sqrt(2) * np.sin(2 * math.pi * 0.35 * RATE * TIME)[:, None], angle)
    assert np.sqrt(np.mean(fast**2)) == pytest.approx(1.0, abs=5e-3)


def test_a_cascade_gives_each_order_its_level_at_each_speed() -> None:
    """An order as strong as the speed, one of constant strength; nothing in between. Also clockwise."""
    angle, speed = 20 * TIME + 4 * TIME**2, 20 + 8 * TIME
    signal = np.sqrt(2) * np.column_stack([np.sin(7 * angle) * speed, np.sin(60 * angle)])
    found, backwards = (cascade(TIME, signal, way * angle, RATE) for way in (1, -1))
    assert found.level == pytest.approx(backwards.level)
    assert found.speed[0] < 25 < 66 < found.speed[-1]
    assert found.level[:, 6, 0] / found.speed == pytest.approx(1.0, abs=0.02)  # it grows within the window
    assert found.level[:, 59, 1] == pytest.approx(1.0, abs=2e-3)
    assert (found.level[:, [5, 7], 0] / found.speed[:, None]).max() < 0.01


def test_orders_that_the_sample_rate_has_not_are_no_numbers() -> None:
    angle = 2 * math.pi * (10 * TIME + 5 * TIME**2)  # 10 to 70 Hz at 10 kHz: 100 orders until 40 Hz
    found = cascade(TIME[::2], np.sin(angle)[::2, None], angle[::2], RATE / 2)
    missing = np.isnan(found.level[:, -1, 0])
    assert len(found.orders) == 100
    assert np.array_equal(missing, found.speed > 0.4 * RATE / 2 / 100.5 * 2 * math.pi)
    assert missing.any() and not missing.all()


def test_what_does_not_turn_has_no_orders() -> None:
    rocking = np.sin(TIME)
    with pytest.raises(SettingsError, match="revolutions"):
        resample_by_angle(TIME[:, None], rocking)
    with pytest.raises(SettingsError, match="no four of them"):
        cascade(TIME, TIME[:, None], rocking, RATE)
