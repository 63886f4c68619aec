"""What is added to a catalogue entry before it is compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from levels import defined_levels

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.coherence import SCALE, common_noise, compose, decompose, noise_alike, with_more_noise
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.observation import Sensing, group, observe, round_sensing, round_up
from jointplay.catalogue.matching.transfer import RandomTransfer
from jointplay.catalogue.storage.cross_power import pack, pack_cyclic
from jointplay.solver.spectra.sensor import rigid_body, sensor_transform

NOTHING = Discrepancy(gain=0.0, level_db=0.0, noise_level_db=0.0, delay=0.0, phase=0.0, cyclic=0.0)
TRANSFORM = sensor_transform(
    [[0.2, -0.1], [0.2, -0.1], [-0.2, 0.1], [-0.2, 0.1]], [[1, 0], [0, 1], [1, 0], [0, 1]], [0.0, 0.0]
)
INVERSE = rigid_body(TRANSFORM).inverse
assert INVERSE is not None
CUTS = (0, 1, 2, 4, 7)
BODY = Sensing(TRANSFORM, INVERSE, CUTS, np.full((4, 3), 1e-12), np.full(4, 40.0))
LEVELS = BODY.noise.size


def entries(count: int = 5, bands: int = 8) -> np.ndarray:
    generator = np.random.default_rng(1)
    motion = generator.normal(size=(count, bands, 3, 6)) + 1j * generator.normal(size=(count, bands, 3, 6))
    power: np.ndarray = (motion @ np.swapaxes(motion.conj(), -1, -2)).astype(np.complex64)
    return power


def locked(power: np.ndarray) -> np.ndarray:
    """Cyclic powers (n, G, 2, 3, 3) of motions that have some of their power in common with themselves an order on."""
    joined = np.add.reduceat(power[:, : CUTS[-1]], CUTS[:-1], axis=1)
    phases = np.exp(1j * np.random.default_rng(2).uniform(0.0, 6.0, (*joined.shape[:2], 2)))
    shares = 0.5 * phases[..., None, None] * joined[:, :, None].real
    found: np.ndarray = 0.5 * (shares + shares.swapaxes(-1, -2))
    return found


def stored(power: np.ndarray) -> np.ndarray:
    joined: np.ndarray = np.concatenate([group(pack(power), CUTS), pack_cyclic(locked(power))], axis=2)
    return joined


def test_without_noise_and_discrepancy_it_is_the_levels() -> None:
    power = entries()
    features, entry = observe(stored(power), BODY, NOTHING, np.ones(5, np.int64))
    assert list(entry) == [0, 1, 2, 3, 4]
    assert np.allclose(features[:, :LEVELS], defined_levels(power, CUTS), atol=1e-3)
    joint = np.add.reduceat(power[:, : CUTS[-1]], CUTS[:-1], axis=1)
    root = np.sqrt(np.einsum("ngii->ngi", joint).real)
    for place, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        expected = joint[..., i, j] / (root[..., i] * root[..., j])
        parts = features[:, LEVELS : LEVELS + 24].reshape(5, 2, 4, 3)[..., place] / SCALE
        assert np.allclose(parts[:, 0] + 1j * parts[:, 1], expected, atol=1e-4)
    own = np.diagonal(locked(power)[:, :, 0], axis1=2, axis2=3)
    auto = root**2
    beside = np.array([1, 2, 3, 3])  # single orders, of which the last has none above it
    expected = own / np.sqrt(auto * auto[:, beside])
    angle = np.angle(expected.sum(axis=(1, 2)))[:, None, None]
    parts = features[:, LEVELS + 24 :].reshape(5, 2, 4, 3) / SCALE
    assert np.allclose(parts[:, 0] + 1j * parts[:, 1], expected * np.exp(-1j * angle), atol=1e-4)
    assert features.shape[1] == BODY.features_count
    corner = Sensing(TRANSFORM[:2], np.eye(2), CUTS, np.full((4, 2), 1e-12), np.full(4, 40.0))
    features, _ = observe(stored(power), corner, NOTHING, np.ones(5, np.int64))
    assert np.allclose(features[:, :8], defined_levels(power, CUTS, TRANSFORM[:2]), atol=1e-3)
    without, _ = observe(stored(power), replace(corner, phases=False), NOTHING, np.ones(5, np.int64))
    assert np.allclose(without, features[:, :8], atol=2e-3)


def test_noise_has_the_stated_mean_and_scatter() -> None:
    power = entries(1)
    noisy = replace(BODY, noise=np.full((4, 3), 20.0))
    features, _ = observe(stored(power), noisy, NOTHING, np.array([20_000]))
    clean, cross = noisy.powers(stored(power))
    clean = clean[0].ravel()
    measured = 10.0 ** (0.1 * features[:, :LEVELS])
    # Clipping lifts what falls below the noise; with these powers next to nothing does.
    assert np.allclose(measured.mean(axis=0), clean + 20.0, rtol=0.02)
    expected = np.sqrt((20.0**2 + 2.0 * clean * 20.0) / 20.0)
    assert np.allclose(measured.std(axis=0), expected, rtol=0.1)
    assert features[:, :LEVELS].min() >= 10.0 * np.log10(20.0) - 1e-9
    # Cross-powers keep their mean but for what noise of the same sensors has in common.
    _, seen, _ = decompose(features, 4, 3)
    assert seen is not None
    assert cross is not None
    expected = cross[0] + common_noise(noisy.noise, noisy.alike)
    assert np.abs(seen.mean(axis=0) - expected).max() < 0.03 * np.abs(expected).max()
    # Noise knows nothing of the crank: cyclic powers stay, as long as it does not hide where a revolution begins.
    faint = replace(BODY, noise=np.full((4, 3), 0.1))
    features, _ = observe(stored(power), faint, NOTHING, np.array([20_000]))
    _, _, own = decompose(features, 4, 3)
    assert own is not None
    expected = np.abs(faint.cyclic_powers(stored(power))[0])
    assert np.allclose(np.abs(own.mean(axis=0)), expected, rtol=0.02, atol=0.02)


def test_where_a_recording_begins_does_not_matter() -> None:
    power = entries(3)
    there, later = stored(power), stored(power)
    turned = locked(power) * np.exp(1j * 0.7 * np.array([1, 2]))[:, None, None]
    later[..., 9:] = pack_cyclic(turned)
    first, second = (observe(each, BODY, NOTHING, np.ones(3, np.int64))[0] for each in (there, later))
    assert not np.allclose(there, later)
    assert np.allclose(first, second, atol=1e-3)


def test_noise_of_channels_made_of_the_same_sensors_is_alike() -> None:
    generator = np.random.default_rng(1)
    channels = INVERSE @ generator.normal(size=(4, 200_000))
    expected = np.corrcoef(channels)[[0, 0, 1], [1, 2, 2]]
    assert np.allclose(noise_alike(INVERSE), expected, atol=0.01)


def test_noise_added_later_is_noise_that_was_there() -> None:
    power = entries(3)
    quiet, _ = observe(stored(power), BODY, NOTHING, np.ones(3, np.int64))
    more = np.linspace(1.0, 30.0, 12).reshape(4, 3)
    clean, cross = BODY.powers(stored(power))
    assert cross is not None
    cyclic = BODY.cyclic_powers(stored(power))
    scale = BODY.cyclic.scale(clean)
    whole = compose(
        clean + more,
        cross + common_noise(more, BODY.alike),
        BODY.cyclic.from_crank(cyclic / scale) * scale,
    )
    assert np.allclose(with_more_noise(quiet, more, BODY.alike), whole, atol=1e-3)
    assert with_more_noise(quiet, np.zeros((4, 3)), BODY.alike) is quiet


def test_delays_and_phase_errors_turn_coherences_and_leave_levels() -> None:
    power, edges = stored(entries(1)), np.array([5.0, 20.0, 200.0, 700.0, 3000.0])
    plain, _ = observe(power, BODY, NOTHING, np.array([1]), edges_hz=edges)
    late, _ = observe(power, BODY, replace(NOTHING, delay=1e-5), np.array([4000]), edges_hz=edges)
    assert np.allclose(late[:, :LEVELS], plain[:, :LEVELS], atol=1e-3)
    (_, first, _), (_, turned, _) = decompose(plain, 4, 3), decompose(late, 4, 3)
    assert first is not None
    assert turned is not None
    angle = np.angle(turned / first).std(axis=0)
    # Two channels err: twice the variance of one.
    expected = 2.0 * np.pi * 1e-5 * np.sqrt(2.0) * 0.5 * (edges[:-1] + edges[1:])
    assert np.allclose(angle, expected[:, None], rtol=0.1)
    smooth, _ = observe(power, BODY, replace(NOTHING, phase=0.1), np.array([4000]))
    _, turned, _ = decompose(smooth, 4, 3)
    assert turned is not None
    assert np.angle(turned / first).std() == pytest.approx(0.1 * np.sqrt(2.0), rel=0.1)


def test_gain_errors_of_sensors_leak_into_rotation() -> None:
    power = np.zeros((1, 8, 3, 3), np.complex64)
    power[..., 0, 0] = 1.0  # the frame moves along x only
    exact, _ = observe(stored(power), BODY, NOTHING, np.array([1]))
    off, _ = observe(stored(power), BODY, replace(NOTHING, gain=0.03), np.array([500]))
    x, theta = slice(0, LEVELS, 3), slice(2, LEVELS, 3)
    assert exact[:, theta].max() < -110.0
    assert np.median(off[:, theta]) > -32.0
    assert off[:, x].std(axis=0).max() < 0.5


def test_level_errors_are_smooth_and_as_large_as_stated() -> None:
    errors = Discrepancy(level_db=1.5).levels(np.random.default_rng(2), (4000, 30, 3))
    assert errors.std() == pytest.approx(1.5, rel=0.05)
    flat = errors[:, :, 0]
    near = np.mean(flat[:, 10] * flat[:, 11]) / 1.5**2
    far = np.mean(flat[:, 5] * flat[:, 25]) / 1.5**2
    across = np.mean(errors[:, 10, 0] * errors[:, 10, 2]) / 1.5**2
    assert near > 0.85
    assert abs(far) < 0.1
    assert across == pytest.approx(0.5, abs=0.08)


def test_same_seed_same_draws() -> None:
    power, copies = entries(), np.full(5, 3)
    first = observe(stored(power), BODY, Discrepancy(), copies, seed=4)
    again = observe(stored(power), BODY, Discrepancy(), copies, seed=4)
    other = observe(stored(power), BODY, Discrepancy(), copies, seed=5)
    assert np.array_equal(first[0], again[0])
    assert np.array_equal(first[1], np.repeat(np.arange(5), 3))
    assert not np.array_equal(first[0], other[0])


def test_rounding_up_is_to_whole_steps() -> None:
    values = np.array([1.0, 1.0000001, 1.9, 2.1, 1e-9])
    rounded = round_up(values, 3.0)
    assert (rounded >= values * (1 - 1e-9)).all()
    assert (rounded < values * 10**0.3 * (1 + 1e-9)).all()
    assert rounded[0] == 1.0
    assert np.array_equal(round_up(rounded, 3.0), rounded)


def test_refuses_what_does_not_fit_together() -> None:
    with pytest.raises(DiagnosisError, match="channels of 4 sensors: 2 are there"):
        Sensing(TRANSFORM[:2], INVERSE, CUTS, BODY.noise, BODY.degrees_of_freedom)
    with pytest.raises(DiagnosisError, match="must be \\(bands, channels\\)"):
        replace(BODY, noise=np.ones((3, 3)))
    with pytest.raises(DiagnosisError, match="greater than 0"):
        replace(BODY, noise=np.zeros((4, 3)))


def test_rounded_sensing_serves_recordings_of_about_the_same_noise() -> None:
    width = np.array([1.0, 1.0, 2.0, 3.0])
    sensing = replace(
        BODY, noise=0.8e-6 * width[:, None] * np.array([1.0, 2.0, 4.0]), degrees_of_freedom=2.0 * 9.0 * width
    )
    step = round_sensing(sensing, width, 3.0)
    for factor in (0.95, 1.05):
        other = replace(sensing, noise=factor * sensing.noise, degrees_of_freedom=sensing.degrees_of_freedom / factor)
        assert round_sensing(other, width, 3.0).digest == step.digest
    ratio = step.noise / sensing.noise
    assert (ratio >= 1.0).all()
    assert (ratio < 10**0.3).all()
    assert (step.degrees_of_freedom <= sensing.degrees_of_freedom).all()
    # A floor that rises towards low bands keeps its course, in steps of 6 dB.
    rising = sensing.noise * np.array([20.0, 1.0, 1.0, 1.0])[:, None]
    course = round_sensing(replace(sensing, noise=rising), width, 3.0).noise / width[:, None]
    assert np.allclose(course[0] / course[1], 10**1.8)
    assert np.allclose(course[1:], (step.noise / width[:, None])[1:])


def test_transfer_functions_are_drawn_where_asked_for() -> None:
    power, edges = stored(entries()), np.array([5.0, 20.0, 200.0, 700.0, 3000.0])
    plain, _ = observe(power, BODY, NOTHING, np.full(5, 100))
    bent, _ = observe(power, BODY, replace(NOTHING, transfer=RandomTransfer()), np.full(5, 100), edges_hz=edges)
    difference = (bent - plain)[:, :LEVELS].reshape(500, 4, 3)
    # Below all modes the frame is rigid; above them it is not.
    assert np.abs(difference[:, 0]).mean() < 1.0
    assert difference[:, 2].std() > 2.0
    with pytest.raises(DiagnosisError, match="edges of the bands"):
        observe(power, BODY, replace(NOTHING, transfer=RandomTransfer()), np.full(5, 1))
