"""A recording as it is looked at: tones and knocks of which everything is known in closed form."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.shown_contact import lay_over
from jointplay.catalogue.signals.shown_units import UNITS
from jointplay.catalogue.signals.shown_views import show_signal
from jointplay.catalogue.signals.signal_question import SignalAxis, SignalQuestion, SignalView, UnitShown
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.spectra.sensor import sensor_transform
from jointplay.solver.spectra.spectrum import DERIVATIVES, Scaling

RATE = 10_000.0
TONE, AMPLITUDE = 80.0, 3.0
OMEGA = 2 * math.pi * TONE
UNIT_NAMES = list(UNITS)
SPEED = 2 * math.pi * 10.0


def recorded(signal: FloatArray, unit: str = "m/s2", names: tuple[str, ...] = ("a",)) -> Recording:
    return Recording.from_arrays(np.reshape(signal, (len(signal), -1)), RATE, names, unit=unit)


def tone(seconds: float = 4.0, frequency: float = TONE) -> FloatArray:
    return np.asarray(AMPLITUDE * np.sin(2 * math.pi * frequency * np.arange(round(seconds * RATE)) / RATE + 0.3))


def amplitude_in(unit: UnitShown, measured: str = "acceleration", frequency: float = TONE) -> float:
    """What a tone of AMPLITUDE in SI has in a unit."""
    times = DERIVATIVES[UNITS[unit].quantity] - DERIVATIVES[measured]  # type: ignore[index]
    return AMPLITUDE * (2 * math.pi * frequency) ** times * UNITS[unit].factor


@pytest.mark.parametrize("unit", UNIT_NAMES)
@pytest.mark.parametrize("scaling", ["rms", "peak", "power", "psd"])
def test_a_tone_is_a_line_of_its_height_in_every_unit(unit: UnitShown, scaling: Scaling) -> None:
    shown = show_signal(recorded(tone()), SignalQuestion("spectrum", unit, scaling=scaling, points=200_000))
    (line,) = shown.lines
    peak = int(np.argmax(line.values))
    assert shown.at[peak] == pytest.approx(TONE, abs=1e-9)
    amplitude = amplitude_in(unit)
    assert shown.resolution is not None
    bandwidth = 1.5 * shown.resolution
    wanted = {"rms": amplitude / 2**0.5, "peak": amplitude, "power": amplitude**2 / 2}
    assert line.values[peak] == pytest.approx(wanted.get(scaling, amplitude**2 / 2 / bandwidth), rel=1e-6)


@pytest.mark.parametrize("unit", UNIT_NAMES)
@pytest.mark.parametrize("frequency", [TONE, 83.7])
def test_a_tone_over_time_has_its_rms_in_every_unit(unit: UnitShown, frequency: float) -> None:
    shown = show_signal(recorded(tone(frequency=frequency)), SignalQuestion("waveform", unit, points=50_000))
    (line,) = shown.lines
    middle = line.values[5_000:35_000]  # what lies beyond its ends is not known, which an integral tells there
    assert np.sqrt(np.mean(middle**2)) == pytest.approx(amplitude_in(unit, frequency=frequency) / 2**0.5, rel=0.01)
    if shown.high_pass is not None:
        assert shown.high_pass == 10.0
    assert (shown.high_pass is None) == (unit in ("m/s2", "g"))


@pytest.mark.parametrize("unit", UNIT_NAMES)
@pytest.mark.parametrize("frequency", [20.0, 40.0, 80.0])
def test_with_a_speed_orders_are_right_to_the_ends(unit: UnitShown, frequency: float) -> None:
    whole = recorded(tone(seconds=3.96, frequency=frequency))
    shown = show_signal(whole, SignalQuestion("waveform", unit, points=50_000, speed=SPEED))
    wanted = amplitude_in(unit, frequency=frequency)
    assert np.abs(shown.lines[0].values).max() == pytest.approx(wanted, rel=0.01)
    assert np.abs(shown.lines[0].values[-500:]).max() == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize(("measured", "text"), [("velocity", "m/s"), ("displacement", "m")])
def test_what_other_sensors_measure_is_shown_alike(measured: str, text: str) -> None:
    for unit in UNITS:
        wanted = amplitude_in(unit, measured)
        of_spectrum = show_signal(recorded(tone(), text), SignalQuestion("spectrum", unit, scaling="peak"))
        assert of_spectrum.lines[0].values.max() == pytest.approx(wanted, rel=1e-6)
        over_time = show_signal(recorded(tone(), text), SignalQuestion("waveform", unit, points=50_000))
        assert np.abs(over_time.lines[0].values[10_000:-10_000]).max() == pytest.approx(wanted, rel=1e-3)


def test_slow_drift_is_not_integrated_below_the_high_pass() -> None:
    signal = tone() + 5.0 + 0.5 * np.sin(2 * math.pi * 0.5 * np.arange(40_000) / RATE)
    shown = show_signal(recorded(signal), SignalQuestion("waveform", "um", points=50_000))
    assert np.abs(shown.lines[0].values[10_000:-10_000]).max() == pytest.approx(amplitude_in("um"), rel=0.02)
    by_speed = show_signal(recorded(signal), SignalQuestion("waveform", "um", speed=2 * math.pi * 30))
    assert by_speed.high_pass == pytest.approx(15.0)


def test_the_envelope_keeps_the_extremes() -> None:
    rng = np.random.default_rng(1)
    signal = rng.normal(size=(600_000, 2))
    signal[314_159, 0], signal[271_828, 1] = 40.0, -50.0
    shown = show_signal(recorded(signal, names=("a", "b")), SignalQuestion("waveform", points=500))
    lines = {(line.name, line.kind): line.values for line in shown.lines}
    assert {len(values) for values in lines.values()} == {500} and len(shown.at) == 500
    assert lines["a", "high"].max() == 40.0 and lines["b", "low"].min() == -50.0
    assert shown.at[np.argmax(lines["a", "high"])] == pytest.approx(31.4159, abs=60 / 500)
    assert shown.ends == (0.0, 599_999 / RATE)
    edges = np.linspace(0, 600_000, 501).astype(int)
    for place in (0, 17, 499):
        part = signal[edges[place] : edges[place + 1], 1]
        assert (lines["b", "low"][place], lines["b", "high"][place]) == (part.min(), part.max())


def test_a_window_of_time_is_shown_sample_by_sample() -> None:
    rng = np.random.default_rng(2)
    signal = rng.normal(size=100_000)
    shown = show_signal(recorded(signal), SignalQuestion("waveform", start=2.0, end=2.05, points=1000))
    assert shown.lines[0].kind == "value"
    np.testing.assert_array_equal(shown.lines[0].values, signal[20_000:20_501])
    assert shown.at[0] == 2.0 and shown.at[-1] == pytest.approx(2.05)
    # A window of an integral is cut out of the integral of the whole.
    whole = show_signal(recorded(signal), SignalQuestion("waveform", "mm/s", points=100_000)).lines[0].values
    part = show_signal(recorded(signal), SignalQuestion("waveform", "mm/s", start=2.0, end=2.05)).lines[0].values
    np.testing.assert_allclose(part, whole[20_000:20_501], atol=0.02 * np.abs(whole).max())


def test_a_spectrum_of_few_points_keeps_its_peaks_where_they_are() -> None:
    signal = tone(20.0) + 0.01 * np.random.default_rng(3).normal(size=200_000)
    fine = show_signal(recorded(signal), SignalQuestion("spectrum", points=200_000))
    coarse = show_signal(recorded(signal), SignalQuestion("spectrum", points=200))
    assert len(coarse.at) == 200 and len(fine.at) > 5000
    assert coarse.lines[0].values.max() == fine.lines[0].values.max()
    assert coarse.at[np.argmax(coarse.lines[0].values)] == pytest.approx(TONE)
    near = show_signal(recorded(signal), SignalQuestion("spectrum", start=70.0, end=90.0, points=200))
    assert 69 <= near.at[0] <= 70 and 90 <= near.at[-1] <= 91 and near.ends == fine.ends


def test_orders_are_multiples_of_the_drive() -> None:
    shown = show_signal(recorded(tone()), SignalQuestion("spectrum", axis="order", speed=SPEED, points=9999))
    assert shown.axis == "order"
    assert shown.at[np.argmax(shown.lines[0].values)] == pytest.approx(8.0, abs=1e-3)
    assert shown.lines[0].values.max() == pytest.approx(AMPLITUDE / 2**0.5, rel=1e-3)


def knocks(angle: float, pulses: bool, wander: float = 0.0) -> Recording:
    """Ten seconds at ten revolutions a second with a blow at an angle [deg] of each."""
    time = np.arange(100_000) / RATE
    turned = 10 * time + wander * np.sin(2 * math.pi * 0.2 * time) / (2 * math.pi * 0.2) * 10
    since = ((turned - angle / 360) % 1.0) / 10
    signal = 20 * np.exp(-since / 0.002) * np.sin(2 * math.pi * 1500 * since) + np.sin(2 * math.pi * turned)
    found = recorded(signal)
    turns = np.interp(np.arange(math.floor(turned[-1]) + 1), turned, np.arange(100_000))
    return replace(found, turns=turns) if pulses else found


@pytest.mark.parametrize("angle", [12.0, 137.0, 301.0])
@pytest.mark.parametrize(("pulses", "wander"), [(True, 0.02), (False, 0.0), (False, 0.01)])
def test_knocks_are_seen_at_their_angle(angle: float, pulses: bool, wander: float) -> None:
    shown = show_signal(knocks(angle, pulses, wander), SignalQuestion("revolution", speed=SPEED))
    rms = {line.kind: line.values for line in shown.lines}["rms"]
    assert len(rms) == 360
    # The wander of the last case begins faster than the mean: its zero is that of the recording all the same.
    off = (shown.at[np.argmax(rms)] - angle + 180) % 360 - 180
    assert -1 <= off <= 6
    assert rms.max() > 8 * np.median(rms)
    assert shown.ends == (0.0, 360.0)


def test_a_spectrogram_shows_when_and_where() -> None:
    time = np.arange(100_000) / RATE
    signal = np.where(time < 5, np.sin(2 * math.pi * 200 * time), np.sin(2 * math.pi * 400 * time))
    shown = show_signal(recorded(signal), SignalQuestion("spectrogram", axis="order", speed=SPEED))
    assert shown.rows is not None and shown.levels is not None
    assert shown.levels.shape == (len(shown.rows), len(shown.at)) and shown.levels.size <= 240 * 120
    assert shown.axis == "revolution" and 95 < shown.at[-1] <= 100
    loudest = shown.rows[np.argmax(shown.levels, axis=0)]
    assert np.all(np.abs(loudest[shown.at < 46] - 20) <= 0.5) and np.all(np.abs(loudest[shown.at > 54] - 40) <= 0.5)
    assert shown.levels.max() == pytest.approx(20 * math.log10(1 / 2**0.5), abs=1.0)  # neighbouring rows have a part
    part = show_signal(recorded(signal), SignalQuestion("spectrogram", start=4.0, end=6.0))
    assert part.axis == "time" and 3.9 <= part.at[0] and part.at[-1] <= 6.1


@pytest.mark.parametrize("unit", UNIT_NAMES)
def test_the_overall_velocity_is_that_of_its_band(unit: UnitShown) -> None:
    time = np.arange(40_000) / RATE
    outside = 50 * np.sin(2 * math.pi * 2000 * time) + 0.5 * np.sin(2 * math.pi * 3 * time)
    (row,) = show_signal(recorded(tone() + outside), SignalQuestion("overall", unit, speed=2 * math.pi * 100)).overall
    assert row.velocity_rms == pytest.approx(1e3 * AMPLITUDE / OMEGA / 2**0.5, rel=0.01)
    slow = show_signal(Recording.from_arrays(tone()[::10, None], 1000.0, ["a"]), SignalQuestion("overall"))
    assert slow.band == (10.0, 400.0) and slow.notes
    assert slow.overall[0].velocity_rms == pytest.approx(1e3 * AMPLITUDE / OMEGA / 2**0.5, rel=0.01)


@pytest.mark.parametrize("unit", UNIT_NAMES)
def test_the_frames_motion_is_what_its_sensors_see(unit: UnitShown) -> None:
    machine = shipped_machine("slider-crank")
    centre = machine.links[machine.frame].cg
    seen = sensor_transform([s.at for s in machine.sensors], [s.direction for s in machine.sensors], centre)
    moved = np.column_stack([tone(), 2 * tone(), 10 * tone()])
    recording = recorded(moved @ seen.T, names=tuple(s.name for s in machine.sensors))
    shown = show_signal(recording, SignalQuestion("spectrum", unit, of="frame", scaling="peak"), machine)
    assert [line.name for line in shown.lines] == ["x", "y", "theta"]
    peaks = [float(line.values.max()) for line in shown.lines]
    wanted = amplitude_in(unit)
    turning = AMPLITUDE * 10 * UNITS[unit].rotation_factor * wanted / (AMPLITUDE * UNITS[unit].factor)
    assert peaks == pytest.approx([wanted, 2 * wanted, turning], rel=1e-6)
    assert shown.lines[2].unit == f"{UNITS[unit].rotation} peak"


@pytest.mark.parametrize("view", ["waveform", "spectrum", "spectrogram", "revolution", "overall"])
@pytest.mark.parametrize("speed", [1e-9, 0.3, SPEED, 1.5e4])
@pytest.mark.parametrize(("rate", "count"), [(1.0, 256), (RATE, 300), (RATE, 40_000)])
@pytest.mark.parametrize(("start", "end"), [(None, None), (0.001, 0.002), (1e6, 1e7)])
def test_odd_questions_are_answered_with_numbers_or_refused(
    view: SignalView, speed: float, rate: float, count: int, start: float | None, end: float | None
) -> None:
    refused: set[str] = set()
    signal = np.random.default_rng(6).normal(size=(count, 2))
    recording = Recording.from_arrays(signal, rate, ["a", "b"])
    for unit, axis in itertools.product(UNIT_NAMES[1::2], get_args(SignalAxis)):
        question = SignalQuestion(view, unit, axis=axis, speed=speed, start=start, end=end, points=50)
        try:
            shown = show_signal(recording, question)
        except MeasurementError as error:
            refused.add(error.field)
            continue
        lines = [line.values for line in shown.lines if view != "spectrogram"]
        assert all(len(values) == len(shown.at) <= 101 and np.isfinite(values).all() for values in lines)
        assert shown.levels is None or np.isfinite(shown.levels).all()
        assert all(math.isfinite(row.rms) and math.isfinite(row.peak) for row in shown.overall)
    assert refused <= {"speed", "from"}


def test_a_revolution_is_turned_until_it_lies_over_another() -> None:
    one = np.random.default_rng(5).normal(size=(3, 360))
    shift, alike = lay_over(np.roll(one, 77, axis=1), 5 * one)
    assert shift == 77
    assert alike == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("question", "field"),
    [
        (SignalQuestion("spectrum", axis="order"), "speed"),
        (SignalQuestion("revolution"), "speed"),
        (SignalQuestion("spectrum", of="frame"), "diagnosis"),
        (SignalQuestion("spectrogram", channel="b"), "channel"),
        (SignalQuestion("waveform", start=9.0, end=9.1), "from"),
        (SignalQuestion("revolution", speed=1e6), "speed"),
    ],
)
def test_what_cannot_be_shown_is_refused_by_its_field(question: SignalQuestion, field: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        show_signal(recorded(tone()), question)
    assert caught.value.field == field
