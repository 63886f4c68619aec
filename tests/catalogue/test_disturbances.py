"""Shocks from outside cost their time, not the diagnosis; what a worn machine does itself is no shock."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from levels import levels_of
from recordings import RECORDINGS, TRUTH

from jointplay.catalogue.measurements.drivespeed import SpeedEstimate, SpeedTrack, rough_track
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.signals.disturbances import find_shocks, patch, stretches_of
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.spectra.sensor import sensor_transform

USED = [name for name in TRUTH if (RECORDINGS / f"{name}.csv.gz").exists()]


@cache
def recording(name: str) -> tuple[Recording, Machine]:
    return read_measurement(RECORDINGS / f"{name}.csv.gz"), shipped_machine(TRUTH[name]["machine"])


def with_shocks(name: str, times: tuple[float, ...], *sizes: float, width: float = 0.004) -> PreparedMeasurement:
    """Blows on the frame, which then rings at 25 Hz; a size for each, or for all, in units of the recording's rms."""
    measurement, machine = recording(name)
    chosen = [next(s for s in machine.sensors if s.name == each) for each in measurement.channel_names]
    centre = machine.links[machine.frame].cg
    transform = sensor_transform([s.at for s in chosen], [s.direction for s in chosen], centre)
    t = np.arange(len(measurement.signal)) / measurement.sample_rate
    added = np.zeros(len(t))
    for start, size in zip(times, sizes if len(sizes) > 1 else sizes * len(times), strict=True):
        after = np.maximum(t - start, 0.0)
        added += size * np.where(after < width, np.sin(math.pi * after / width), 0.0)
        added -= 0.2 * size * np.exp(-25.0 * after) * np.sin(2 * math.pi * 25.0 * after)
    blow = measurement.signal.std() * np.outer(added, transform @ [0.8, 0.6, 2.0])
    return prepare(dataclasses.replace(measurement, signal=measurement.signal + blow), machine)


@pytest.mark.parametrize("name", USED)
def test_machines_do_not_shock_themselves(name: str) -> None:
    measurement, machine = recording(name)
    prepared = prepare(measurement, machine)
    assert [each for each in prepared.disturbances if each.kind == "shock"] == [] and prepared.left_out == 0.0
    assert prepared.steps[2].name == "disturbances" and prepared.steps[2].found == "none found"


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("quick-return-01", 10),
        ("slider-crank-05", 20),
        ("slider-crank-01", 10),
        ("four-bar-01", 10),
        ("four-bar-03", 10),
    ],
)
def test_shocks_cost_their_time(name: str, size: float) -> None:
    measurement, machine = recording(name)
    before = prepare(measurement, machine)
    disturbed = with_shocks(name, (0.4, 1.9), size)
    shocks = [each for each in disturbed.disturbances if each.kind == "shock"]
    assert [each.begin for each in shocks] == [pytest.approx(0.4, abs=0.03), pytest.approx(1.9, abs=0.03)]
    assert 0.0 < disturbed.left_out < 0.4
    assert any(each.startswith("shock from outside 2 times, at") for each in disturbed.warnings)
    off = np.sqrt(np.mean((levels_of(disturbed) - levels_of(before)) ** 2))
    assert off < 1.5


@pytest.mark.parametrize(("name", "faint"), [("quick-return-01", 2.8), ("quick-return-08", 1.0)])
def test_shocks_that_stand_out_less_are_looked_for_where_there_are_others(name: str, faint: float) -> None:
    alone, beside = with_shocks(name, (1.9,), faint), with_shocks(name, (0.4, 1.9), 10.0, faint)
    assert not [each for each in alone.disturbances if each.kind == "shock"]
    shocks = [each.begin for each in beside.disturbances if each.kind == "shock"]
    assert shocks == [pytest.approx(0.4, abs=0.03), pytest.approx(1.9, abs=0.03)]


def test_steady_lines_are_told_as_disturbances() -> None:
    measurement, machine = recording("slider-crank-02")
    t = np.arange(len(measurement.signal)) / measurement.sample_rate
    hum = 0.2 * np.outer(np.sin(2 * math.pi * 24.27 * t), [1.0, -0.5, 0.7, 0.3])
    prepared = prepare(dataclasses.replace(measurement, signal=measurement.signal + hum), machine)
    lines = [each for each in prepared.disturbances if each.kind == "line"]
    assert any(each.frequency == pytest.approx(24.27, abs=0.02) for each in lines) and prepared.left_out == 0.0
    before = prepare(measurement, machine)
    assert np.sqrt(np.mean((levels_of(prepared) - levels_of(before)) ** 2)) < 0.3


# --- the pieces -------------------------------------------------------------------------------------------------------

FS = 2000.0
TRACK = SpeedTrack(np.array([0.0]), np.array([10 * math.pi]), SpeedEstimate(10 * math.pi, 0.0, True))


def periodic(seconds: float = 4.0) -> np.ndarray:
    t = np.arange(round(seconds * FS)) / FS
    return np.column_stack(
        [np.sin(10 * math.pi * t * k) + 0.01 * np.random.default_rng(k).normal(size=len(t)) for k in (1, 3)]
    )


def test_patches_are_of_the_same_angle() -> None:
    signal = periodic()
    bad = np.zeros(len(signal), dtype=bool)
    bad[1000:1900] = bad[:30] = bad[-7:] = True
    spoilt = np.where(bad[:, None], 99.0, signal)
    values, left = patch(spoilt, FS, TRACK, bad)
    assert not left.any() and np.abs(values - signal).max() < 0.1
    assert np.array_equal(values[100:900], signal[100:900])
    values, left = patch(spoilt, FS, TRACK, np.ones(len(signal), dtype=bool))
    assert left.all() and np.array_equal(values, spoilt)


def test_a_shock_is_found_where_it_is() -> None:
    signal = periodic()
    none = np.zeros(len(signal), dtype=bool)
    assert not find_shocks(signal, FS, TRACK, none).any()
    signal[3010:3030] += 5.0
    found = find_shocks(signal, FS, TRACK, none)
    assert found[3010:3030].all() and found.sum() < 150
    missing = none.copy()
    missing[3000:3050] = True
    assert not find_shocks(signal, FS, TRACK, missing).any()
    assert not find_shocks(signal[:1000], FS, TRACK, none[:1000]).any()


def test_blows_hide_orders_but_not_in_every_window() -> None:
    measurement, machine = recording("slider-crank-02")
    rng = np.random.default_rng(0)
    signal = measurement.signal.copy()
    for start in (2000, 6000):
        signal[start : start + 2000] += 300 * rng.normal(size=(2000, 1)) * np.exp(-np.arange(2000) / 300)[:, None]
    rough = rough_track(signal, measurement.sample_rate, 20 * math.pi)
    assert rough is not None
    assert rough.estimate.speed * 30 / math.pi == pytest.approx(TRUTH["slider-crank-02"]["speed_rpm"], rel=0.01)
    prepared = prepare(dataclasses.replace(measurement, signal=signal), machine)
    (shock,) = (each for each in prepared.disturbances if each.kind == "shock")
    assert 0.15 < shock.begin < 0.35 and 0.6 < shock.end < 1.2
    assert rough_track(rng.normal(size=(25_000, 4)), measurement.sample_rate, 10 * math.pi) is None


def test_stretches() -> None:
    assert stretches_of(np.array([True, False, True, True])) == [(0, 1), (2, 4)]
    assert stretches_of(np.zeros(3, dtype=bool)) == []
