"""Sensors that are swapped, inverted, dead or off: named by the recording itself where a rigid frame allows."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from levels import levels_of
from recordings import RECORDINGS, TRUTH

from jointplay.catalogue.evaluation.truth import Response
from jointplay.catalogue.measurements.measurement import Channel, Recording, read_measurement
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.solver.machines.machine import Machine, shipped_machine

NAMES = ("s1-x", "s1-y", "s2-x", "s2-y")
#: Each recording once: other formats hold the same numbers.
USED = [name for name in TRUTH if (RECORDINGS / f"{name}.csv.gz").exists()]
SWAPPED = {"x and y of a point": (1, 0, 2, 3), "x and y of two points": (3, 1, 2, 0), "x of both points": (2, 1, 0, 3)}


@cache
def recording(name: str) -> tuple[Recording, Machine]:
    return read_measurement(RECORDINGS / f"{name}.csv.gz"), shipped_machine(TRUTH[name]["machine"])


def changed(name: str, matrix: np.ndarray, used: tuple[int, ...] = (0, 1, 2, 3)) -> PreparedMeasurement:
    """A recording whose columns were mixed, its noise as it was; some of its columns."""
    measurement, machine = recording(name)
    signal = (measurement.signal @ np.asarray(matrix, dtype=float).T)[:, used]
    channels = tuple(measurement.channels[column] for column in used)
    return prepare(dataclasses.replace(measurement, signal=signal, channels=channels), machine)


@pytest.mark.parametrize("name", USED)
def test_sensors_in_order_do_not_contradict_each_other(name: str) -> None:
    prepared = changed(name, np.eye(4))
    assert prepared.flaws == ()
    assert prepared.steps[-1].name == "sensors checked" and prepared.steps[-1].found.startswith("agree")


@pytest.mark.parametrize("name", ["quick-return-05", "slider-crank-01", "four-bar-02"])
@pytest.mark.parametrize("sensor", range(4))
def test_inverted_sensors_are_named(name: str, sensor: int) -> None:
    signs = np.ones(4)
    signs[sensor] = -1.0
    prepared = changed(name, np.diag(signs))
    (flaw,) = prepared.flaws
    assert (flaw.kind, flaw.sensors) == ("inverted", (NAMES[sensor],))
    text = f"the sensors contradict each other as parts of one rigid frame, unless {NAMES[sensor]} is inverted"
    assert flaw.text == text and text in prepared.warnings and prepared.steps[-1].found == text
    # Nothing is put right on the quiet: the levels are those of the recording.
    assert np.abs(levels_of(prepared) - levels_of(changed(name, np.eye(4)))).max() > 1.0


@pytest.mark.parametrize("name", ["quick-return-03", "slider-crank-02", "four-bar-03"])
@pytest.mark.parametrize("how", SWAPPED)
def test_swapped_sensors_are_named(name: str, how: str) -> None:
    order = SWAPPED[how]
    (flaw,) = changed(name, np.eye(4)[list(order)]).flaws
    pair = tuple(NAMES[index] for index in range(4) if order[index] != index)
    assert flaw.kind == "swapped" and set(pair) <= set(flaw.sensors)
    assert f"{pair[0]} and {pair[1]} are swapped" in flaw.text
    if how == "x of both points":
        # The distance of two points stays the same: that says no more than that either both x or both y changed places.
        assert set(flaw.sensors) == set(NAMES) and ", or s" in flaw.text
    else:
        assert flaw.sensors == pair


@pytest.mark.parametrize(
    ("factor", "told"), [(9.81, "is 9.9 times as"), (0.1, "is 0.1 times as"), (-2.0, "is inverted and 2 times as")]
)
def test_wrong_gains_are_named(factor: float, told: str) -> None:
    (flaw,) = changed("four-bar-04", np.diag([1.0, 1.0, factor, 1.0])).flaws
    assert flaw.kind == "gain" and flaw.sensors == ("s2-x",)
    assert told in flaw.text


def test_gains_that_are_a_little_off_are_nobodys_fault() -> None:
    for factors in ([1.15, 0.85, 1.15, 1.0], [0.85, 1.15, 1.15, 0.85]):
        assert changed("four-bar-04", np.diag(factors)).flaws == ()


@pytest.mark.parametrize("used", [(0, 1, 2, 3), (0, 1, 2), (1, 2)])
def test_dead_sensors_are_named_whatever_else_there_is(used: tuple[int, ...]) -> None:
    measurement, machine = recording("quick-return-02")
    signal = measurement.signal.copy()
    signal[:, 2] = np.round(np.random.default_rng(0).normal(0, 0.3, len(signal))) * 1e-3
    signal, channels = signal[:, used], tuple(Channel(NAMES[each], "m/s2", "acceleration") for each in used)
    prepared = prepare(dataclasses.replace(measurement, signal=signal, channels=channels, flaws=()), machine)
    (flaw,) = prepared.flaws
    assert (flaw.kind, flaw.sensors) == ("dead", ("s2-x",))
    assert "sensor s2-x is dead: it shows nothing of the machine's motion" in prepared.warnings


def test_what_no_single_change_explains_is_a_contradiction() -> None:
    (flaw,) = changed("four-bar-02", np.diag([-1.0, -1.0, 1.0, 1.0])).flaws
    assert (flaw.kind, flaw.sensors) == ("contradicts", NAMES)
    assert "no single change explains it" in flaw.text


def test_three_sensors_have_nothing_to_be_checked_by() -> None:
    prepared = changed("four-bar-02", np.diag([-1.0, 1.0, 1.0, 1.0]), used=(0, 1, 2))
    assert prepared.flaws == () and "nothing to check them by" in prepared.steps[-1].found


@pytest.mark.parametrize("frequency", [150.0, 250.0, 400.0])
def test_a_flexible_mode_is_no_sensor_flaw(frequency: float) -> None:
    for name in ("slider-crank-03", "quick-return-07"):
        measurement, machine = recording(name)
        passed = Response(frequency, 0.01, (1.0, -0.6, 0.3, 0.8)).of(measurement.signal, measurement.sample_rate)
        assert prepare(dataclasses.replace(measurement, signal=passed), machine).flaws == ()


def test_one_sensor_alone_is_not_checked() -> None:
    assert changed("four-bar-01", np.eye(4), used=(0,)).flaws == ()
