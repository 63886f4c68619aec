"""Modes of a frame that is no rigid body: in levels made up for it, and in recordings by the second simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from second_simulator.faults import frame_mode
from second_simulator.machine_file import read
from second_simulator.protocols import individual_of
from second_simulator.recording import recorded, stream

from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.frame_modes import KnownLevels, find_mode, mode_of
from jointplay.catalogue.measurements.measurement import Channel, Recording
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine

FloatArray = NDArray[np.float64]

EDGES = np.concatenate([np.arange(0.5, 20.0) * 5.0, 97.5 * 2.0 ** (np.arange(1, 17) / 3.0)])
BANDS, CHANNELS = len(EDGES) - 1, 3
COURSE = 20.0 * np.exp(-0.5 * ((np.arange(BANDS) - 25.0) / 8.0) ** 2)[:, None] + [0.0, 3.0, -5.0]


def machines(count: int, seed: int) -> FloatArray:
    """Levels (count, d) of machines whose impacts are louder or softer, band by band, and a little each."""
    draw = np.random.default_rng(seed)
    louder = 4.0 * draw.normal(size=(count, 1, 1)) + np.cumsum(draw.normal(size=(count, BANDS, 1)), axis=1)
    return np.asarray((COURSE + louder + 2.0 * draw.normal(size=(count, BANDS, CHANNELS))).reshape(count, -1))


KNOWN = KnownLevels.of(machines(300, 1), 300)


def response_db(frequency: float, share: float = 0.25, damping: float = 0.02) -> FloatArray:
    """What a part of the frame's mass on springs does to the levels of bands (G,), the part's own frequency given."""
    at = EDGES[:-1, None] + np.diff(EDGES)[:, None] * (np.arange(40) + 0.5) / 40
    ratio = at / frequency
    # Two masses on a spring, moved at the one that is measured, over both as one.
    swung = 1.0 - ratio**2 + 2j * damping * ratio
    response = swung / (swung + share * ratio**2)
    return np.asarray(10.0 * np.log10(np.mean(np.abs(response) ** 2, axis=1)))


def swinging(frequency: float) -> FloatArray:
    """What a part does (d,) that swings along x with this frequency, and with others along y and in turning."""
    return np.column_stack([response_db(factor * frequency) for factor in (1.0, 0.7, 1.6)]).ravel()


@pytest.mark.parametrize("frequency", [90.0, 130.0, 180.0, 250.0, 400.0])
def test_a_mode_is_found_where_it_is(frequency: float) -> None:
    found = [mode_of(KNOWN, levels, EDGES) for levels in machines(20, 2) + swinging(frequency)]
    told = [each[0] / frequency for each in found if each is not None]
    # Measured: 15 to 19 of 20, from the dip along y (0.7) to the peak of turning (1.6, and a sixth above).
    assert len(told) >= 13
    assert 0.6 < min(told) < max(told) < 1.9
    assert 0.75 < float(np.median(told)) < 1.3


def test_machines_in_order_have_none() -> None:
    assert all(mode_of(KNOWN, levels, EDGES) is None for levels in machines(100, 3))


@pytest.mark.parametrize("shift", [15.0, -15.0])
def test_a_tone_is_none_nor_is_what_was_taken_out_with_one(shift: float) -> None:
    levels = machines(1, 4)[0].reshape(BANDS, CHANNELS)
    levels[24] += shift
    assert mode_of(KNOWN, levels.ravel(), EDGES) is None


def test_below_what_frames_swing_at_there_is_none() -> None:
    assert mode_of(KNOWN, machines(1, 5)[0] + np.repeat(response_db(25.0, 0.1), CHANNELS), EDGES) is None


def test_where_the_low_orders_have_changed_too_something_else_has() -> None:
    levels = (machines(1, 6) + swinging(180.0)).reshape(BANDS, CHANNELS)
    assert mode_of(KNOWN, levels.ravel(), EDGES) is not None
    levels[2] += 12.0  # of order 3, at 15 Hz
    levels[4] -= 12.0
    assert mode_of(KNOWN, levels.ravel(), EDGES) is None


@pytest.fixture(scope="module")
def in_order(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    plan = {"name": "in order", "hypotheses": ["healthy"], "draws": {"healthy": 256}, "seconds": 1.0, "guard": 0}
    folder: Path = tmp_path_factory.mktemp("modes") / "slider-crank"
    build(shipped_machine("slider-crank"), parse_plan({**plan, "wide": {"draws": 0}}), folder, workers=0)
    return Catalogue.open(folder)


def measured(number: int, protocol: str, swings: bool) -> Recording:
    """A recording of a machine whose frame swings in itself, or does not."""

    def streams(*parts: object) -> np.random.Generator:
        return stream("modes", protocol, *parts)

    individual = individual_of(read("slider-crank"), protocol, number, streams)
    individual.revolutions = 30.0
    if swings:
        frame_mode(individual, streams("mode", number))
    columns, _ = recorded(individual, streams("recording", number))
    time = columns.pop("time")
    channels = tuple(Channel(name, "m/s2", "acceleration") for name in columns)
    values = np.column_stack([*columns.values()])
    return Recording("second simulator", 1.0 / float(time[1] - time[0]), values, channels, (), (), "0" * 64)


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "protocol", "swings"),
    [(1, "sound", True), (2, "sound", True), (3, "sound", False), (4, "sound", False), (2, "disturbed-sound", False)],
)
def test_recordings_by_another_simulator(number: int, protocol: str, swings: bool, in_order: Catalogue) -> None:
    prepared = prepare(measured(number, protocol, swings), in_order.machine, None, None, in_order.scheme)
    found = find_mode(prepared, in_order)
    if not swings:
        assert found is None
        return
    assert found is not None
    assert (found.name, found.unit) == ("mode of frame", "Hz")
    assert 60.0 < found.size < 400.0
    assert found.probability > 0.99
