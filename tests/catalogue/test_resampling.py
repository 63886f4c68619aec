"""Drives that wander: the levels of their orders are those of a drive that does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.ndimage
from levels import defined_levels

from jointplay.catalogue.measurements.drivespeed import SpeedEstimate, SpeedTrack, track_speed
from jointplay.catalogue.signals.feature_bands import usable_cuts
from jointplay.catalogue.signals.steadiness import at_mean_speed, interpolate
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import BandScheme

FS = 10_000.0


def wandering(hertz: float, seconds: float, wander: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two channels of a drive whose speed wanders, and of the same drive at its mean speed."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * FS)) / FS
    course = np.zeros(len(t))
    for _ in range(3):
        course += rng.normal() * np.sin(2 * np.pi * rng.uniform(0.25, 2.0) / seconds * t + rng.uniform(0, 2 * np.pi))
    course -= course.mean()
    course *= wander / np.abs(course).max()
    noise = rng.normal(0.0, 0.02, (len(t), 2))
    orders = np.unique(np.concatenate([np.arange(1, 25), np.arange(25, int(3500 / hertz), 7)]))
    size = rng.lognormal(0.0, 1.0, (len(orders), 2)) / orders[:, None] ** 0.3
    phase = rng.uniform(0.0, 6.0, (len(orders), 2))
    signals = []
    for angle in (np.cumsum(2 * np.pi * hertz * (1 + course)) / FS, 2 * np.pi * hertz * t):
        first, total = np.exp(1j * angle), np.zeros(noise.shape)
        wave, order = np.ones(len(t), complex), 0
        for k, factor in zip(orders, size * np.exp(1j * phase), strict=True):
            wave, order = wave * first ** (k - order), k  # by products: a cosine takes ten times as long
            total += (wave[:, None] * factor).real
        signals.append(total + noise)
    return signals[0], signals[1]


@pytest.mark.parametrize(
    ("hertz", "seconds", "wander", "plain_db", "resampled_db"),
    # Root mean square over orders 1 to 20; measured: 0.097 and 0.003, 0.248 and 0.006, 0.71 and 0.018; 0.73 and 0.009.
    [
        (2.0, 5.0, 0.003, 0.05, 0.02),
        (2.0, 5.0, 0.005, 0.15, 0.03),
        (2.0, 5.0, 0.01, 0.5, 0.06),
        (10.0, 2.5, 0.01, 0.5, 0.04),
    ],
)
def test_orders_come_out_as_without_wander(
    hertz: float, seconds: float, wander: float, plain_db: float, resampled_db: float
) -> None:
    scheme = BandScheme.for_drive(2 * math.pi * hertz)
    cuts = usable_cuts(scheme, 2 * math.pi * hertz, FS)
    plain, resampled = [], []
    for seed in range(4):
        signal, steady = wandering(hertz, seconds, wander, seed)
        track = track_speed(signal, FS, 2 * math.pi * hertz)
        assert track.estimate.speed == pytest.approx(2 * math.pi * hertz, rel=1e-3)
        assert track.estimate.wander == pytest.approx(wander, rel=0.4)
        expected = defined_levels(band_matrix(steady, FS, 2 * math.pi * hertz, scheme).power, cuts)
        for signals, errors in ((signal, plain), (at_mean_speed(signal, FS, track), resampled)):
            found = defined_levels(band_matrix(signals, FS, track.estimate.speed, scheme).power, cuts)
            errors.append((found - expected)[:40])
    assert np.sqrt(np.mean(np.square(plain))) > plain_db
    assert np.sqrt(np.mean(np.square(resampled))) < resampled_db


def test_a_steady_drive_is_left_as_it_is() -> None:
    """Flat to 0.4 of the sample rate: a shift of the speed's scale, with no wander, gives the samples back."""
    t = np.arange(20_000) / FS
    signal = np.column_stack([np.cos(2 * np.pi * f * t + 0.3) for f in (20.0, 1500.0, 4000.0)]) + 5.0
    track = SpeedTrack(np.array([0.0, 2.0]), np.array([12.0, 12.0]), SpeedEstimate(12.0, 0.0, False))
    again = at_mean_speed(signal, FS, track)
    assert np.abs(again - signal)[100:-100].max() < 2e-3


def test_high_frequencies_keep_their_power() -> None:
    """Half-way between samples cubic splines are weakest; made twice as dense they lose 0.05 dB at 0.4 of the rate."""
    t = np.arange(40_000) / FS
    track = SpeedTrack(np.array([0.0, 4.0]), np.array([12.0, 12.24]), SpeedEstimate(12.12, 0.0, False))
    for f in (100.0, 2000.0, 4000.0):
        moved = at_mean_speed(np.sin(2 * np.pi * f * t)[:, None], FS, track)[1000:-1000]
        assert 10 * math.log10(2 * float(np.mean(moved**2))) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("count", [7, 64, 1000])
def test_splines_are_those_of_scipy_to_the_last_bit(count: int) -> None:
    generator = np.random.default_rng(count)
    row, place = generator.normal(size=count), np.sort(generator.uniform(0.0, count - 1.0, 3 * count))
    place[0], place[-1] = 0.0, count - 1.0
    expected = scipy.ndimage.map_coordinates(row, [place], order=3, mode="nearest")
    assert np.array_equal(interpolate(row, place), expected)
