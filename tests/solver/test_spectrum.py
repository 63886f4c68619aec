"""Spectra against closed forms: sines of known rms, white noise of known level, Parseval, rigid bodies."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.band_power import band_matrix, transform_power
from jointplay.solver.spectra.bands import BandScheme
from jointplay.solver.spectra.segments import fast_length, revolution_segments
from jointplay.solver.spectra.sensor import rigid_body, sensor_signals, sensor_transform
from jointplay.solver.spectra.spectrum import convert, order_levels, rescale
from jointplay.solver.spectra.welch import cross_spectra, undo_sample_mean, welch

FS = 10_000.0
DRIVE = 2.0 * math.pi * 2.0  # two revolutions a second


def sine(frequency: float, rms: float, seconds: float = 2.5, phase: float = 0.3) -> np.ndarray:
    t = np.arange(round(seconds * FS)) / FS
    return rms * math.sqrt(2.0) * np.sin(2.0 * math.pi * frequency * t + phase)


# --- bands ------------------------------------------------------------------------------------------------------------


def test_one_order_bands_then_twelfth_octaves_up_to_four_kilohertz() -> None:
    scheme = BandScheme.for_drive(DRIVE)
    assert scheme.edges[:3] == (0.5, 1.5, 2.5)
    assert scheme.centres[0] == 1.0 and scheme.centres[39] == 40.0
    assert scheme.edges_hz(DRIVE)[-1] == pytest.approx(4000.0, rel=1e-12)
    ratios = np.diff(np.log2(scheme.edges[40:])) * 12
    assert np.allclose(ratios[:-1], 1.0) and 1 / 3 <= ratios[-1] <= 4 / 3 + 1e-9


def test_cyclic_power_of_orders_is_the_product_of_their_amplitudes() -> None:
    """Orders 3 and 4 at known phases: their product one order apart is in the band of order 3, nothing elsewhere."""
    scheme = BandScheme.for_drive(DRIVE)
    cuts, begin = scheme.third_octave_groups(), 0.8
    angle = DRIVE * np.arange(25_000) / FS + begin
    signal = np.column_stack([np.cos(3 * angle + 0.2) + 2 * np.cos(4 * angle + 1.1), 3 * np.cos(4 * angle - 0.5)])
    found = band_matrix(signal, FS, DRIVE, scheme, cuts=cuts, angle=begin).cyclic
    assert found.shape == (len(cuts) - 1, 2, 2, 2)
    # Of two cosines a b / 2; of different channels the mean of both products.
    assert found[2, 0, 0, 0] == pytest.approx(1.0 * np.exp(0.9j), abs=1e-6)
    assert found[2, 0, 0, 1] == found[2, 0, 1, 0] == pytest.approx(0.5 * 1.5 * np.exp(-0.7j), abs=1e-6)
    assert np.abs(np.delete(found, 2, axis=0)).max() < 1e-6
    assert np.abs(found[2, 1]).max() < 1e-6


def test_cyclic_power_of_noise_is_that_of_its_strength() -> None:
    """White noise times 1 + cos(angle - 1), whose square is 3/2 + 2 cos(angle - 1) + 1/2 cos(2 angle - 2)."""
    scheme, generator = BandScheme.for_drive(DRIVE), np.random.default_rng(4)
    cuts = scheme.third_octave_groups()
    angle = DRIVE * np.arange(int(60 * FS)) / FS
    signal = (1.0 + np.cos(angle - 1.0))[:, None] * generator.normal(size=(len(angle), 1))
    matrix = band_matrix(signal, FS, DRIVE, scheme, cuts=cuts)
    share = matrix.cyclic[-6:-1, :, 0, 0] / np.add.reduceat(matrix.auto_power[:, 0], cuts[:-1])[-6:-1, None]
    expected = np.array([2.0 / 3.0 * np.exp(-1j), 1.0 / 6.0 * np.exp(-2j)])
    # Five bands of at least 400 Hz over 60 s scatter by less than 0.007.
    assert np.abs(share - expected).max() < 0.025
    parts = [
        band_matrix(signal[first : first + 200_000], FS, DRIVE, scheme, cuts=cuts, angle=angle[first]).cyclic
        for first in (0, 200_123, 400_321)
    ]
    together = np.mean(parts, axis=0)[-6:-1, :, 0, 0] / np.add.reduceat(matrix.auto_power[:, 0], cuts[:-1])[-6:-1, None]
    assert np.abs(together - expected).max() < 0.025


def test_third_octave_groups_cover_every_band_once() -> None:
    for hertz in (0.5, 2.0, 5.0, 10.0, 50.0):
        scheme = BandScheme.for_drive(2.0 * math.pi * hertz)
        cuts = scheme.third_octave_groups()
        assert cuts[0] == 0 and cuts[-1] == scheme.count and all(b > a for a, b in itertools.pairwise(cuts))
        edges = np.asarray(scheme.edges)[list(cuts)]
        thirds = 3.0 * np.diff(np.log2(edges[20:]))
        assert np.all(thirds[:-1] > 0.7) and np.all(thirds < 1.6)  # whole orders cannot cut exact thirds at order 20
    assert len(BandScheme.for_drive(DRIVE).third_octave_groups()) - 1 == 40


def test_fast_drive_gets_fewer_orders() -> None:
    scheme = BandScheme.for_drive(2.0 * math.pi * 200.0)
    assert scheme.orders == 19 and scheme.edges[-1] == pytest.approx(20.0)


@pytest.mark.parametrize("edges", [(1.0,), (1.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (0.0, math.inf)])
def test_bad_edges_are_refused(edges: tuple[float, ...]) -> None:
    with pytest.raises(SettingsError):
        BandScheme(edges, 0)


def test_a_line_at_an_order_stays_in_its_band() -> None:
    scheme = BandScheme.for_drive(DRIVE)
    signal = np.column_stack([sine(2.0 * order, rms=0.1 * order) for order in (1, 3, 20)])
    power = band_matrix(signal, FS, DRIVE, scheme).auto_power
    for channel, order in enumerate((1, 3, 20)):
        assert power[order - 1, channel] == pytest.approx((0.1 * order) ** 2, rel=1e-6)
        others = np.delete(power[:, channel], order - 1)
        # Hann lines fall on zeros of the window at the true speed: nothing but rounding leaks.
        assert others.max() < 1e-9 * power[order - 1, channel]


def test_little_leaks_when_the_speed_is_a_little_wrong() -> None:
    # 0.3 % is the wander of a real drive; order 20 is then off by 0.18 lines.
    scheme = BandScheme.for_drive(DRIVE)
    power = band_matrix(sine(40.0, 1.0)[:, None], FS, DRIVE * 1.003, scheme).auto_power[:, 0]
    assert power[19] == pytest.approx(1.0, abs=0.03)
    assert np.delete(power, 19).max() < 0.02


def test_white_noise_has_its_level_and_its_scatter() -> None:
    rng = np.random.default_rng(1)
    scheme = BandScheme.for_drive(DRIVE)
    width = np.diff(scheme.edges_hz(DRIVE))
    expected = 0.2**2 / (FS / 2) * width
    matrices = [band_matrix(rng.normal(0, 0.2, (25_000, 2)), FS, DRIVE, scheme) for _ in range(60)]
    powers = np.array([m.auto_power for m in matrices])
    # 120 estimates a band: mean known to sqrt(2 / dof / 120), five standard errors allowed.
    dof = matrices[0].degrees_of_freedom
    error = np.abs(powers.mean(axis=(0, 2)) / expected - 1.0)
    assert np.all(error < 5.0 * np.sqrt(2.0 / dof / 120))
    # Variance over mean squared is 2 / dof; pooled over bands (the first two lose to the mean taken off).
    ratio = powers.var(axis=(0, 2))[2:] / expected[2:] ** 2 * dof[2:] / 2.0
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)


@settings(deadline=None, max_examples=30)
@given(
    cuts=st.lists(st.floats(0.01, 300.0), min_size=1, max_size=12, unique=True),
    speed=st.floats(8.0, 40.0),
    samples=st.integers(2400, 3100),
)
def test_bands_add_up_to_the_variance(cuts: list[float], speed: float, samples: int) -> None:
    """Parseval: any bands from zero to half the sample rate add up to the windowed mean square."""
    rate = 1000.0
    top = rate / 2 / (speed / (2 * math.pi))
    inner = sorted({c for c in cuts if c < top * 0.999})
    # Beyond the end: a window may be 0.1 % off the revolutions that its bands are counted by.
    scheme = BandScheme((0.0, *inner, 1.002 * top), 0)
    signal = np.random.default_rng(samples).normal(size=(samples, 2)) @ np.array([[1.0, 0.4], [0.0, 2.0]])
    matrix = band_matrix(signal, rate, speed, scheme)
    segmentation = revolution_segments(samples, rate, speed)
    window = scipy.signal.windows.hann(segmentation.length, sym=False)
    pieces = np.stack([signal[s : s + segmentation.length] for s in segmentation.starts])
    pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * window[:, None]
    covariance = np.einsum("sni,snj->ij", pieces, pieces) / len(pieces) / (window @ window)
    assert np.allclose(matrix.power.sum(axis=0).real, covariance, rtol=1e-9)
    assert np.all(matrix.auto_power >= 0)


def test_cross_power_is_hermitian_and_follows_a_transform() -> None:
    rng = np.random.default_rng(2)
    scheme = BandScheme.for_drive(DRIVE)
    signal = rng.normal(size=(25_000, 3))
    transform = rng.normal(size=(4, 3))
    seen = band_matrix(signal @ transform.T, FS, DRIVE, scheme)
    power = band_matrix(signal, FS, DRIVE, scheme).power
    assert np.allclose(power, power.conj().swapaxes(1, 2))
    assert np.allclose(transform_power(power, transform), seen.power, rtol=1e-9, atol=1e-15)
    assert np.allclose(transform_power(power[None], transform)[0], seen.power, rtol=1e-9, atol=1e-15)


def test_sample_means_are_undone() -> None:
    """Mean acceleration over each sample interval of a sine, in closed form, gives back the sine's level."""
    scheme = BandScheme.for_drive(DRIVE)
    for frequency in (30.0, 1000.0, 3500.0):
        t = np.arange(25_001) / FS
        means = -np.diff(np.cos(2 * math.pi * frequency * t)) * FS / (2 * math.pi * frequency)
        power = band_matrix(means[:, None], FS, DRIVE, scheme, sample_mean=True).auto_power
        assert power.sum() == pytest.approx(0.5, rel=2e-4)
    assert undo_sample_mean([0.0, FS / 2], FS) == pytest.approx([1.0, (math.pi / 2) ** 2])


def test_channels_are_differentiated_in_the_band_estimator() -> None:
    scheme = BandScheme.for_drive(DRIVE)
    signal = np.column_stack([sine(60.0, 1.0), sine(60.0, 1.0)])
    power = band_matrix(signal, FS, DRIVE, scheme, derivatives=(1, 2)).auto_power
    w = 2 * math.pi * 60.0
    # Order 30's line and its two window lines a third of an order away: (2 pi f)^2 is not linear over them.
    assert np.sqrt(power.sum(axis=0)) == pytest.approx([w, w**2], rel=1e-3)


def test_channels_are_combined_in_the_band_estimator() -> None:
    rng = np.random.default_rng(8)
    scheme = BandScheme.for_drive(DRIVE)
    signal, mix = rng.normal(size=(25_000, 4)), rng.normal(size=(3, 4))
    combined = band_matrix(signal, FS, DRIVE, scheme, combine=mix)
    mixed = band_matrix(signal @ mix.T, FS, DRIVE, scheme)
    assert np.allclose(combined.power, mixed.power) and np.allclose(combined.spread_db, mixed.spread_db)


def test_spread_is_that_of_the_windows() -> None:
    scheme = BandScheme.for_drive(DRIVE)
    signal = sine(10.0, 1.0)[:, None]
    steady = band_matrix(signal, FS, DRIVE, scheme)
    assert steady.segments == 3 and steady.spread_db[4, 0] < 1e-6
    growing = band_matrix(signal * np.linspace(1.0, 2.0, len(signal))[:, None], FS, DRIVE, scheme)
    assert growing.spread_db[4, 0] > 1.0
    single = band_matrix(signal[:15_500], FS, DRIVE, scheme)
    assert single.segments == 1 and not single.spread_db.any()


def test_bands_beyond_half_the_sample_rate_are_marked() -> None:
    scheme = BandScheme.for_drive(DRIVE)
    matrix = band_matrix(np.random.default_rng(0).normal(size=(6000, 1)), 2000.0, DRIVE, scheme)
    assert np.array_equal(matrix.covered, scheme.edges_hz(DRIVE)[1:] <= 1000.0)
    assert not matrix.auto_power[scheme.edges_hz(DRIVE)[:-1] > 1000.0].any()


def test_windows_avoid_slow_lengths() -> None:
    for target in (14_963.0, 15_013.4, 3011.0, 100.0):
        assert abs(fast_length(target) - target) <= max(0.5, 1e-3 * target)
    rest = fast_length(14_963.0)  # a prime
    for prime in (2, 3, 5, 7, 11, 13):
        while rest % prime == 0:
            rest //= prime
    assert rest == 1


@pytest.mark.parametrize(
    ("samples", "rate", "speed", "part"),
    [(25_000, 0.0, DRIVE, "sample rate"), (25_000, FS, 0.0, "drive speed"), (9_000, FS, DRIVE, "revolutions"),
     (25_000, FS, 1e6, "samples a revolution")],
)  # fmt: skip
def test_what_cannot_be_cut_is_refused(samples: int, rate: float, speed: float, part: str) -> None:
    with pytest.raises(SettingsError, match=part):
        band_matrix(np.zeros((samples, 1)), rate, speed, BandScheme.for_drive(DRIVE))


def test_what_is_not_a_number_is_refused() -> None:
    signal = np.zeros((25_000, 2))
    signal[7, 1] = math.nan
    for estimate in (
        lambda: band_matrix(signal, FS, DRIVE, BandScheme.for_drive(DRIVE)),
        lambda: welch(signal, FS, drive_speed=DRIVE, channels=("x", "y")),
    ):
        with pytest.raises(SettingsError, match="not finite"):
            estimate()


# --- spectra ----------------------------------------------------------------------------------------------------------


def test_welch_density_of_white_noise_and_its_parseval() -> None:
    signal = np.random.default_rng(5).normal(0, [0.5, 2.0], (100_000, 2))
    spectrum = welch(signal, FS, drive_speed=DRIVE, channels=("x", "theta"))
    assert spectrum.units == ("m/s2", "rad/s2") and spectrum.value_units[1] == "(rad/s2)^2/Hz"
    assert spectrum.averages == 9 and spectrum.resolution == pytest.approx(0.5)
    # The mean of 10 000 lines is known to better than 1 %; what the windows weigh less at both ends adds as much.
    assert spectrum.values.mean(axis=0) == pytest.approx([0.25 / 5000, 4.0 / 5000], rel=0.02)
    assert spectrum.values.sum(axis=0) * spectrum.resolution == pytest.approx([0.25, 4.0], rel=0.02)
    assert spectrum.orders[-1] == pytest.approx(2500.0)


def test_amplitude_scalings_of_a_sine() -> None:
    spectrum = welch(sine(50.0, 3.0)[:, None], FS, drive_speed=DRIVE, channels=("x",))
    rms = rescale(spectrum, "rms")
    assert rms.values.max() == pytest.approx(3.0, rel=1e-6)
    assert rescale(rms, "peak").values.max() == pytest.approx(3.0 * math.sqrt(2.0), rel=1e-6)
    power = rescale(spectrum, "power")
    assert power.values.max() == pytest.approx(9.0, rel=1e-6) and power.value_units == ("(m/s2)^2",)
    back = rescale(rescale(rescale(power, "peak"), "rms"), "psd")
    assert np.allclose(back.values, spectrum.values)
    assert rms.value_units == ("m/s2 rms",)


def test_quantities_convert_by_powers_of_frequency() -> None:
    w = 2 * math.pi * 50.0
    acceleration = welch(sine(50.0, w**2)[:, None], FS, drive_speed=DRIVE, channels=("x",))
    displacement = convert(acceleration, "displacement")
    assert displacement.units == ("m",) and displacement.values[0, 0] == 0.0
    line = int(np.argmin(np.abs(displacement.frequency - 50.0)))
    assert rescale(displacement, "rms").values[line, 0] == pytest.approx(1.0, rel=1e-6)
    again = convert(convert(displacement, "velocity"), "acceleration")
    assert np.allclose(again.values[1:], acceleration.values[1:]) and again.units == ("m/s2",)
    for scaling in ("power", "rms", "peak"):
        there = rescale(convert(rescale(acceleration, scaling), "velocity"), "psd")  # type: ignore[arg-type]
        assert np.allclose(there.values, convert(acceleration, "velocity").values)


def test_order_levels_of_sines() -> None:
    signal = np.column_stack([sine(2.0, 0.5) + sine(6.0, 0.2), sine(80.0, 1.5)])
    levels = order_levels(welch(signal, FS, drive_speed=DRIVE, channels=("x", "y")), [1, 2, 3, 40])
    assert levels[[0, 2], 0] == pytest.approx([0.5, 0.2], rel=1e-6)
    assert levels[3, 1] == pytest.approx(1.5, rel=1e-6)
    assert levels[1].max() < 1e-6
    with pytest.raises(SettingsError, match="beyond"):
        order_levels(welch(signal, FS, drive_speed=DRIVE, channels=("x", "y")), [2500])


def test_cross_spectra_of_a_delay() -> None:
    """A channel that follows another by d seconds: the phase of X_0 conj(X_1) is + 2 pi f d."""
    noise = np.random.default_rng(6).normal(size=60_003)
    signal = np.column_stack([noise[3:], noise[:-3]])
    cross = cross_spectra(signal, FS, drive_speed=None, channels=("a", "b"), window_length=1000)
    phase = np.unwrap(np.angle(cross.density[1:-1, 0, 1]))
    frequency = cross.auto.frequency[1:-1]
    assert np.polyfit(frequency, phase, 1)[0] == pytest.approx(2 * math.pi * 3 / FS, rel=0.01)
    assert cross.auto.drive_speed is None and cross.auto.averages == 119
    with pytest.raises(SettingsError, match="no drive speed"):
        order_levels(cross.auto, [1])


def test_the_band_estimator_agrees_with_welch() -> None:
    """Two different codes: ours with a hop of one revolution, scipy's with half a window."""
    signal = np.random.default_rng(7).normal(size=(200_000, 1))
    scheme = BandScheme.for_drive(DRIVE)
    bands = band_matrix(signal, FS, DRIVE, scheme).auto_power[:, 0]
    spectrum = welch(signal, FS, drive_speed=DRIVE, channels=("x",), revolutions_per_window=3)
    ours = np.sqrt(bands[:40])
    # Both see the same noise but weigh it differently in time: a band has some 75 degrees of freedom, its rms a
    # standard error of 8 %, most of it common to both.
    assert order_levels(spectrum, range(1, 41))[:, 0] == pytest.approx(ours, rel=0.1)


def test_shapes_that_do_not_fit_are_refused() -> None:
    for arguments in (
        {"signal": np.zeros(100), "channels": ("x",)},
        {"signal": np.zeros((100, 2)), "channels": ("x",)},
        {"signal": np.zeros((100, 1)), "channels": ("x",), "window_length": 101},
        {"signal": np.zeros((100, 1)), "channels": ("x",), "units": ("m/s2", "g")},
    ):
        with pytest.raises(SettingsError):
            welch(sample_rate=FS, drive_speed=None, **arguments)  # type: ignore[arg-type]


# --- sensors ----------------------------------------------------------------------------------------------------------

POINTS = [(0.2, -0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, 0.1)]
DIRECTIONS = [(1.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, 3.0)]


def test_transform_of_a_pure_rotation() -> None:
    transform = sensor_transform(POINTS, DIRECTIONS, (0.0, 0.0))
    # alpha x r = alpha (-ry, rx)
    assert transform @ [0.0, 0.0, 2.0] == pytest.approx([0.2, 0.4, -0.2, -0.4])
    assert transform @ [1.0, 5.0, 0.0] == pytest.approx([1.0, 5.0, 1.0, 5.0])


def test_exact_signal_of_a_spinning_frame() -> None:
    """Steady spin about the centre: a sensor along its arm sees -w^2 r at every angle, gravity nowhere."""
    t = np.linspace(0.0, 1.0, 50)
    spin = 7.0
    zero = np.zeros_like(t)
    displacement = np.column_stack([zero, zero, spin * t])
    velocity = np.column_stack([zero, zero, np.full_like(t, spin)])
    signal = sensor_signals(displacement, velocity, np.zeros((50, 3)), [(0.3, 0.4)], [(0.3, 0.4)], (0.0, 0.0))
    assert signal[:, 0] == pytest.approx(np.full(50, -(spin**2) * 0.5))


def test_exact_signal_matches_second_differences_of_the_point() -> None:
    t = np.linspace(0.0, 1.0, 20_001)
    step = t[1]
    angle, x, y = 0.3 * np.sin(5 * t), 0.01 * np.sin(9 * t), 0.02 * np.cos(7 * t)
    motion = np.column_stack([x, y, angle])
    velocity = np.column_stack([0.09 * np.cos(9 * t), -0.14 * np.sin(7 * t), 1.5 * np.cos(5 * t)])
    acceleration = np.column_stack([-0.81 * np.sin(9 * t), -0.98 * np.cos(7 * t), -7.5 * np.sin(5 * t)])
    arm, unit = np.array([0.25, -0.1]), np.array([0.6, 0.8])
    cosine, sine_ = np.cos(angle), np.sin(angle)

    def turn(v: np.ndarray) -> np.ndarray:
        return np.column_stack([cosine * v[0] - sine_ * v[1], sine_ * v[0] + cosine * v[1]])

    point = motion[:, :2] + turn(arm)
    second = (point[2:] - 2 * point[1:-1] + point[:-2]) / step**2
    expected = np.einsum("ni,ni->n", second, turn(unit)[1:-1])
    signal = sensor_signals(motion, velocity, acceleration, [arm + 1.0], [unit], (1.0, 1.0))[1:-1, 0]
    assert signal == pytest.approx(expected, abs=1e-5)  # rounding of second differences: 1e-16 / step^2


def test_least_squares_back_to_the_rigid_body() -> None:
    body = rigid_body(sensor_transform(POINTS, DIRECTIONS, (0.03, -0.02)))
    assert body.inverse is not None and body.observable
    assert body.inverse @ body.transform == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.parametrize("kept", [(0,), (0, 1), (0, 2), (0, 1, 0)])
def test_too_few_sensors_do_not_see_the_rigid_body(kept: tuple[int, ...]) -> None:
    transform = sensor_transform(POINTS, DIRECTIONS, (0.0, 0.0))
    assert not rigid_body(transform[list(kept)]).observable


def test_three_sensors_through_one_point_do_not_see_the_rotation() -> None:
    transform = sensor_transform([(0.2, 0.1)] * 3, [(1, 0), (0, 1), (1, 1)], (0.0, 0.0))
    assert not rigid_body(transform).observable


def test_blocked_motions_need_no_sensors() -> None:
    transform = sensor_transform([(0.2, 0.1), (-0.2, 0.1)], [(0, 1), (0, 1)], (0.0, 0.0))
    assert not rigid_body(transform).observable and rigid_body(transform[:, 1:]).observable


def test_a_direction_without_length_is_refused() -> None:
    with pytest.raises(SettingsError, match="length"):
        sensor_transform([(0, 0)], [(0, 0)], (0, 0))


def test_a_weak_order_beside_a_strong_one_is_seen_in_windows_that_are_a_little_off() -> None:
    """Order 3 lies 60 dB below order 2; windows of three revolutions are up to 0.1 % longer or shorter than that."""
    scheme = BandScheme.for_drive(DRIVE, 1000.0)
    lengths = set()
    for part in np.linspace(0.99, 1.01, 23):
        turn = part * DRIVE / FS * np.arange(25_000)
        signal = np.cos(2 * turn) + 1e-3 * np.cos(3 * turn + 1.0)
        power = band_matrix(signal[:, None], FS, part * DRIVE, scheme).auto_power
        lengths.add(round(revolution_segments(25_000, FS, part * DRIVE).length * part * DRIVE / FS / (6 * math.pi), 4))
        # Measured: 2.2 dB at worst, which a Hann window leaks over two lines; with edges in Hz it was 26.
        assert abs(10 * np.log10(power[2, 0] / 0.5e-6)) < 3.0
    assert max(lengths) - min(lengths) > 3e-4
