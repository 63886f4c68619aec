"""Which recordings of a machine in order others are compared with, by which sensors, and what is said of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import RECORDINGS

from jointplay.catalogue.diagnosing.past_recordings import (
    InOrder,
    prepare_past,
    recordings_in_order,
    sensors_by_column,
)
from jointplay.catalogue.errors import DiagnosisError, MeasurementError
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue

NAMES = ("s1-x", "s1-y", "s2-x", "s2-y")


@pytest.fixture(scope="module")
def healthy() -> Recording:
    return read_measurement(RECORDINGS / "slider-crank-01.csv.gz")


def called(recording: Recording, names: tuple[str, ...], key: str = "", **members: Any) -> Recording:
    """A recording with its columns called so, those that are left over taken away."""
    channels = tuple(replace(each, name=name) for each, name in zip(recording.channels, names, strict=False))
    changed = replace(recording, channels=channels, signal=recording.signal[:, : len(names)], **members)
    return replace(changed, sha256=key * 64, name=key) if key else changed


def past_of(
    catalogue: Catalogue, *in_order: Recording | InOrder, used: tuple[str, ...] = NAMES, **mapping: str
) -> tuple[list[PreparedMeasurement], list[str]]:
    """What a recording with these columns, sensors by a mapping or by their names, is compared with."""
    diagnosed = {name: mapping.get(name, name) for name in used}

    def own(recording: Recording) -> dict[str, str]:
        return {name: said for name, said in mapping.items() if name in recording.channel_names}

    found, said = prepare_past(recordings_in_order(in_order), own, [diagnosed], set(diagnosed.values()), catalogue)
    return list(found.values()), said


def test_a_past_by_the_same_sensors_is_as_it_is(small_catalogue: Catalogue, healthy: Recording) -> None:
    (found,), said = past_of(small_catalogue, healthy, healthy)
    assert found.sensing.sensors == NAMES
    assert said == [f"baseline {healthy.name}: {line}" for line in found.warnings]


def test_each_is_read_once_by_its_own_sensors(small_catalogue: Catalogue, healthy: Recording) -> None:
    """Columns may be called like sensors that they are not, in the past, in what is diagnosed, or in both."""
    ((as_is,), _) = past_of(small_catalogue, healthy)
    swapped = called(healthy, ("s1-y", "s1-x", "s2-x", "s2-y"))
    mapping = {"s1-x": "s1-y", "s1-y": "s1-x"}
    for given, said_of_all in ((swapped, mapping), (InOrder(swapped, mapping), mapping)):
        (found,), said = past_of(small_catalogue, given, **said_of_all)
        np.testing.assert_array_equal(found.group_power, as_is.group_power)
        assert not any("another sensor" in line for line in said)
    # What is diagnosed is plugged otherwise since, and its mapping is not that of the past.
    for own in (InOrder(healthy, {}), InOrder(swapped, mapping)):
        (found,), said = past_of(small_catalogue, own, **({} if own.mapping else mapping))
        np.testing.assert_array_equal(found.group_power, as_is.group_power)
        assert f"baseline {healthy.name}: column s1-x, s1-y: is another sensor there" in said[0].replace(
            "s1-y, s1-x", "s1-x, s1-y"
        )


def test_sensors_that_are_not_used_now_are_left_out(small_catalogue: Catalogue, healthy: Recording) -> None:
    (found,), said = past_of(small_catalogue, healthy, used=NAMES[:3])
    assert found.sensing.sensors == NAMES[:3]
    assert said == [f"baseline {healthy.name}: {line}" for line in found.warnings]
    assert not any("not used" in line for line in said)
    unlike, _ = past_of(small_catalogue, healthy, used=("s9-x",))
    assert unlike[0].sensing.sensors == NAMES


def test_what_nobody_said_of_a_column_is_as_it_is_in_what_is_compared(
    small_catalogue: Catalogue, healthy: Recording
) -> None:
    """That a recording was diagnosed by the names of its columns says nothing of those that are no sensor's."""
    half = called(healthy, ("s1-x", "s1-y", "ch3", "ch4"))
    used = ("s1-x", "s1-y", "ch3", "ch4")
    (found,), said = past_of(small_catalogue, InOrder(half, {}), used=used, ch3="s2-x", ch4="s2-y")
    assert found.sensing.sensors == NAMES and not any("sensor" in line for line in said)


def test_one_that_lacks_a_sensor_is_left_out_unless_all_do(small_catalogue: Catalogue, healthy: Recording) -> None:
    fewer = called(healthy, NAMES[:3], "a")
    found, said = past_of(small_catalogue, fewer, healthy)
    assert [each.name for each in found] == [healthy.name]
    assert "baseline a: has other sensors than s1-x, s1-y, s2-x, s2-y: left out" in said
    found, said = past_of(small_catalogue, fewer, called(healthy, NAMES[:2], "b"))
    assert [each.name for each in found] == ["a"]
    assert "baseline a: has other sensors than s1-x, s1-y, s2-x, s2-y: not compared with as such" in said
    assert "baseline b: has other sensors than s1-x, s1-y, s2-x: left out" in said


def test_what_is_said_of_several_is_said_once(small_catalogue: Catalogue, healthy: Recording) -> None:
    """Those whose sensors contradict each other are left out."""
    wrong = called(healthy, NAMES, "w")
    wrong = replace(wrong, signal=healthy.signal * [-1.0, -1.0, 1.0, 1.0])
    short = [replace(called(healthy, NAMES, key), signal=healthy.signal[:5000]) for key in ("c", "d")]
    found, said = past_of(small_catalogue, wrong, *short)
    assert [each.name for each in found] == ["c", "d"]
    assert any(line.startswith("baseline c, d: only ") and "revolutions" in line for line in said)
    (told,) = (line for line in said if line.endswith("left out"))
    assert told.startswith("baseline w: sensors s1-x, s1-y")
    assert past_of(small_catalogue, wrong)[0] == []


def test_a_speed_that_is_known_is_not_sought(small_catalogue: Catalogue, healthy: Recording) -> None:
    quiet = replace(healthy, signal=np.random.default_rng(1).normal(0.0, 0.01, healthy.signal.shape))
    with pytest.raises(MeasurementError, match="speed"):
        past_of(small_catalogue, quiet)
    (found,), _ = past_of(small_catalogue, InOrder(quiet, speed=62.0))
    assert found.drive_speed == pytest.approx(62.0, rel=1e-3)


def test_there_are_not_too_many(healthy: Recording) -> None:
    many = [called(healthy, NAMES, chr(97 + place)) for place in range(26)]
    with pytest.raises(DiagnosisError, match=r"^baseline: 26: must be at most"):
        recordings_in_order(many)


def test_columns_are_sensors_by_name_or_as_they_are_mapped(small_catalogue: Catalogue, healthy: Recording) -> None:
    other = called(healthy, ("S1 X", "s1-y", "spare", "s2-y"))
    machine = small_catalogue.machine
    assert sensors_by_column(other, machine, {}) == {"S1 X": "s1-x", "s1-y": "s1-y", "s2-y": "s2-y"}
    mapped = sensors_by_column(other, machine, {"spare": "s2-x", "s1-y": ""})
    assert mapped == {"S1 X": "s1-x", "spare": "s2-x", "s2-y": "s2-y"}
