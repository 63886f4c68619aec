"""Accelerations without aliases from velocities."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.solver.spectra.sampling import PASS, STOP, band_limited_acceleration, phases, reach

FS = 10_000.0


def _tone(frequency: float, oversampling: int, samples: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration amplitude 1 at a frequency: what comes out, and the exact values."""
    rate = FS * oversampling
    count = (samples - 1) * oversampling + reach(oversampling) + 1
    t = np.arange(count) / rate
    w = 2 * np.pi * frequency
    out = band_limited_acceleration(phases((-np.cos(w * t) / w)[None], oversampling), rate, samples)[0]
    return out, np.sin(w * np.arange(samples) / FS)


@pytest.mark.parametrize("oversampling", [2, 3, 4])
@pytest.mark.parametrize("part", [0.001, 0.1, 0.3, 0.39])
def test_flat_and_in_phase_in_the_pass_band(oversampling: int, part: float) -> None:
    out, exact = _tone(part * FS, oversampling)
    assert len(out) == len(exact)
    # The filter is designed for 90 dB; away from the start, where nothing was known before, the error is its ripple.
    assert np.abs(out - exact)[100:].max() < 5e-4


@pytest.mark.parametrize("oversampling", [2, 4])
def test_what_would_fold_into_the_pass_band_is_stopped(oversampling: int) -> None:
    assert PASS + STOP == pytest.approx(1.0)
    for part in np.linspace(STOP, oversampling / 2 * 0.999, 9):
        out, _ = _tone(part * FS, oversampling)
        assert np.abs(out[100:]).max() < 5e-4, part


@pytest.mark.parametrize(("part", "most"), [(1.599, 0.26), (1.8, 0.12), (1.95, 0.03), (2.05, 0.03), (2.4, 0.17)])
def test_what_lies_above_the_recorded_rate_is_dimmed_by_the_mean_alone(part: float, most: float) -> None:
    """Two velocities a sample: what the module says of it, no more and not much less."""
    out, _ = _tone(part * FS, 2)
    assert 0.7 * most < np.abs(out[100:]).max() < most


def test_constant_acceleration_is_exact_from_the_first_sample() -> None:
    velocity = phases(3.0 * np.arange(500)[None] / (2 * FS), 2)
    assert band_limited_acceleration(velocity, 2 * FS, 230) == pytest.approx(3.0, rel=1e-6)
