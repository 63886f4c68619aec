"""Motions that repeat are told from those that do not, and one period of them says all."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.preparation import NEVER, Prepared
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.repeating import Repetition, fold, periodic_acceleration, watch
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import BandScheme
from jointplay.solver.spectra.sampling import phases

#: 10 revolutions a second: 400 samples of the results each, which is a length whose transform is cheap already.
RATE, SAMPLES = 4000.0, 800
LONG = Settings(sample_rate=RATE, accuracy="draft", motion=False, transient=False, settled=True, revolutions=12.01)
LOOKING = replace(LONG, repeating=True)
#: Motions that repeat with every revolution, with every second one, and not at all, as long runs show.
KEPT, PAIRS, NEVER_AGAIN = {"B": 2e-4}, {"A": 2e-4, "B": 5e-6, "O": 5e-5}, {"A": 2e-4, "B": 2e-4, "O": 5e-5}


@cache
def machine() -> Machine:
    return shipped_machine("slider-crank")


def prepared(decay: float = 1e3) -> Prepared:
    """A case of which only its rates count: a drive of 10 Hz, a suspension that loses `decay` parts a second."""
    case = next(groups(machine(), [Case(Fault(KEPT), {"drive.speed": 20 * math.pi})], LONG)).ready[0]
    return watch(replace(case, suspension=(complex(-decay, 1.0),)))


def seen(signal: FloatArray, case: Prepared | None = None) -> int:
    """Period that is found in the last revolutions of a motion of one coordinate, 800 samples each."""
    repeated = Repetition(case or prepared())
    assert repeated.samples == SAMPLES
    found = repeated.look(phases(signal[None], 2)[:, :, -(signal.size // 2) :], signal.size)
    assert found == bool(repeated.period)
    return repeated.period


def turns(count: int) -> FloatArray:
    """Revolutions since the start, one a sample."""
    return np.arange(count * SAMPLES) / SAMPLES


def wave(turn: FloatArray) -> FloatArray:
    """Velocities with all orders up to 150."""
    orders = np.arange(1, 151)
    return np.sum(np.sin(2 * np.pi * np.outer(turn, orders) + orders**2) / orders, axis=1)


def test_what_comes_back_with_every_revolution_has_a_period_of_one() -> None:
    assert seen(wave(turns(3))) == 1


def test_what_comes_back_with_every_second_revolution_has_a_period_of_two() -> None:
    halves = wave(turns(5)) * (1 + 0.1 * np.cos(np.pi * turns(5)))
    assert seen(halves) == 2
    assert seen(halves[: 4 * SAMPLES]) == 0  # two pairs that begin a revolution apart need five


def test_noise_has_none_and_little_of_it_does_not_matter() -> None:
    noise = np.random.default_rng(1).normal(size=5 * SAMPLES)
    assert seen(noise) == 0
    assert seen(wave(turns(5)) + 1e-1 * noise) == 0
    assert seen(wave(turns(5)) + 1e-5 * noise) == 1


def test_phases_that_drift_are_no_period_though_levels_stay() -> None:
    assert seen(wave(1.02 * turns(5))) == 0


def test_what_still_decays_is_no_period() -> None:
    turn = turns(5)
    assert seen(wave(turn) * (1 + 2.0 * np.exp(-0.3 * turn))) == 0
    assert seen(wave(turn) * (1 + 0.5 * np.exp(-4 * turn))) == 1


def test_a_suspension_that_decays_slowly_is_waited_for() -> None:
    # 2 % a revolution are left of a swing that loses a hundredth of itself in one: ten times that is to come.
    drifting = wave(turns(3)) * (1 + 0.02 * turns(3))
    assert seen(drifting, prepared(decay=1e3)) == 1
    assert seen(drifting, prepared(decay=0.1)) == 0


def test_a_suspension_of_which_nothing_is_left_after_a_revolution_is_no_hindrance() -> None:
    assert seen(wave(turns(3)), prepared(decay=1e5)) == 1


def motor(ends: FloatArray, count: int) -> Repetition:
    """Of a case that is meant to turn 10 times a second, whose revolutions end at `ends` (s), of `count` results."""
    case = replace(prepared(), sample_rate=RATE, look=NEVER, ends=lambda _: (ends * RATE, 0.3))
    repeated = Repetition(watch(case))
    angle = np.interp(np.arange(2 * count) / (2 * RATE), ends, np.arange(len(ends)))
    repeated.look(phases(wave(angle)[None], 2)[:, :, -count:], 2 * count, np.zeros((1, count)))
    return repeated


def test_a_motors_revolutions_are_known_by_their_ends() -> None:
    """10.3 a second, no whole number of samples in any of them; the period is what one of them holds."""
    time = 1 / 10.3
    found = motor(0.01 + time * np.arange(5), 2000).found
    assert found is not None and found.ends is not None
    assert found.revolutions == 1 and found.angle == 0.3
    assert found.begin == pytest.approx(0.01 + 2 * time)
    samples = found.velocity.shape[1] // 2
    assert found.rate == pytest.approx(samples / time) and RATE <= found.rate < 1.04 * RATE
    # Lines of the plain wave, but for a polynomial through eight samples: seen 1e-6 up to a twentieth of their rate.
    lines = np.fft.rfft(found.velocity[0])[1:40] / samples
    orders = np.arange(1, 40)
    np.testing.assert_allclose(lines, np.exp(1j * (orders**2 - 0.5 * np.pi)) / orders, rtol=1e-4)


def test_a_motors_cycle_may_take_two_revolutions() -> None:
    """Of unequal length: neither of them keeps the speed of the other, both together do."""
    found = motor(np.cumsum([0.01, *(0.1, 0.102) * 3]), 2500).found
    assert found is not None and found.revolutions == 2
    nearly = motor(np.cumsum([0.01, *(0.1, 0.10001) * 3]), 2500).found
    assert nearly is not None and nearly.revolutions == 1


@pytest.mark.parametrize("growth", [1e-3, -1e-3])
def test_a_motor_that_still_runs_up_or_down_is_not_at_its_end(growth: float) -> None:
    """Over each revolution the motion is the same; it takes another thousandth of its time each."""
    times = 0.1 * (1 + growth * np.arange(6))
    assert motor(np.cumsum([0.01, *times]), 2600).found is None
    settling = 0.1 * (1 + growth * 0.1 ** np.arange(6))
    assert motor(np.cumsum([0.01, *settling]), 2600).found is not None


def pushed() -> Machine:
    """A slider that is pushed the way it goes, a flywheel, a crank that resists."""
    content = machine().model_dump(mode="json")
    guide = next(name for name, joint in content["joints"].items() if joint["kind"] == "sliding")
    content["drive"] = {"kind": "force", "joint": guide, "curve": [[-1, -40], [1, 40]]}
    crank = content["joints"]["O"]["links"][0]
    content["links"][crank]["inertia"] += 0.02
    content["joints"]["O"]["viscous"] = 0.05
    content["initial"] = {"velocities": {crank: {"omega": 20.0}}}
    return parse_machine(json.dumps(content), "pushed")


def test_a_force_drive_ends_as_well() -> None:
    short, long = (
        simulate_batch(pushed(), [Case(Fault({"B": 1e-4}))], replace(settings, revolutions=16.01))[0]
        for settings in (LOOKING, LONG)
    )
    assert short.turning is not None and short.turning.is_steady
    assert short.period == 1 and long.period == 0
    assert short.drive_speed == pytest.approx(long.drive_speed, rel=2e-4)
    signal, rate, angle = long.by_revolutions(long.band_limited_acceleration)
    scheme = BandScheme.for_drive(long.drive_speed, 0.4 * RATE, 20, 3)
    power = 10 * np.log10(band_matrix(signal, rate, long.drive_speed, scheme, angle=angle).auto_power)
    counts = power > power.max(axis=0) - 60
    assert np.abs(levels(short) - power)[counts].mean() < 0.15


def test_a_fold_leaves_what_repeats_and_differentiates_exactly() -> None:
    turn = turns(4)
    velocity = np.cos(2 * np.pi * 7 * turn + 0.3)
    period = fold(phases(velocity[None], 2)[:, :, -2 * SAMPLES :], 3 * SAMPLES, SAMPLES)
    np.testing.assert_allclose(period[0], velocity[:SAMPLES], atol=1e-12)
    acceleration = periodic_acceleration(period, RATE)
    expected = -np.sin(2 * np.pi * 7 * turn[:SAMPLES:2] + 0.3) * 2 * np.pi * 70
    np.testing.assert_allclose(acceleration[0], expected, rtol=1e-10, atol=1e-8)


def test_nothing_above_half_the_rate_is_left_and_nothing_folds_down() -> None:
    velocity = np.sin(2 * np.pi * 333 * turns(2)) + np.sin(2 * np.pi * 3 * turns(2))
    acceleration = periodic_acceleration(fold(phases(velocity[None], 2)[:, :, -SAMPLES:], 2 * SAMPLES, SAMPLES), RATE)
    lines = np.abs(np.fft.rfft(acceleration[0]))
    assert np.flatnonzero(lines > 1e-9 * lines.max()).tolist() == [3]


@cache
def histories(settings: Settings) -> list[History]:
    cases = [Case(Fault(fault), {"drive.speed": 20 * math.pi}) for fault in (KEPT, PAIRS, NEVER_AGAIN)]
    return simulate_batch(machine(), cases, settings)


def levels(history: History) -> FloatArray:
    """Of the frame in bands, dB."""
    scheme = BandScheme.for_drive(history.drive_speed, 0.4 * RATE, 20, 3)
    signal = history.band_limited_acceleration
    bands = band_matrix(signal, history.sample_rate, history.drive_speed, scheme, period=history.period)
    return 10 * np.log10(bands.auto_power)


def test_a_run_ends_with_the_period_that_a_long_one_has() -> None:
    for period in (1, 2):
        short, long = histories(LOOKING)[period - 1], histories(LONG)[period - 1]
        assert short.period == period and len(short.t) == 400 * period and short.t[-1] < 0.8 < long.t[-1]
        assert short.t[0] == pytest.approx(round(10 * short.t[0]) / 10, abs=1e-12)  # phases count from there
        power = levels(long)
        counts = power > power.max(axis=0) - 60
        # 0.9 dB from one revolution to the next, and less to come.
        assert np.abs(levels(short) - power)[counts].mean() < 0.15, period


def test_looking_changes_nothing_of_a_run_that_does_not_repeat() -> None:
    looked, plain = histories(LOOKING)[2], histories(LONG)[2]
    assert looked.period == 0 and looked.sample_rate == RATE
    np.testing.assert_array_equal(looked.band_limited_acceleration, plain.band_limited_acceleration)


def test_how_a_case_ends_does_not_depend_on_its_neighbours() -> None:
    alone = simulate_batch(machine(), [Case(Fault(KEPT), {"drive.speed": 20 * math.pi})], LOOKING)[0]
    np.testing.assert_array_equal(alone.band_limited_acceleration, histories(LOOKING)[0].band_limited_acceleration)


def test_samples_are_a_whole_number_a_revolution() -> None:
    case = next(groups(machine(), [Case(Fault(KEPT), {"drive.speed": 61.7})], LONG)).ready[0]
    watched = watch(case)
    samples = watched.sample_rate * 2 * math.pi / 61.7
    assert samples == pytest.approx(round(samples), rel=1e-12) and case.look == NEVER
    assert RATE <= watched.sample_rate < 1.04 * RATE


def test_machines_that_do_not_come_round_are_not_looked_at() -> None:
    content = machine().model_dump(mode="json")
    content["drive"]["ripple"] = [{"order": 1.5, "amplitude": 0.01, "phase": 0.0}]
    odd = parse_machine(json.dumps(content), "odd")
    found = simulate_batch(odd, [Case(Fault(KEPT))], replace(LOOKING, revolutions=3.01))[0]
    assert found.status == "ok" and found.period == 0 and found.sample_rate == RATE


@pytest.mark.parametrize("other", [{"motion": True}, {"duration": 1.0}, {"method": "gill"}, {"links": True}])
def test_what_cannot_be_ended_early_is_refused(other: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=r"^repeating: needs method adaptive without motion, links and duration$"):
        replace(LOOKING, **other)  # type: ignore[arg-type]
