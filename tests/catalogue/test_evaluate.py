"""Evaluation on held-out simulations."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from catalogue.entry import Hypothesis
from catalogue.errors import DiagnosisError
from catalogue.evaluate import PROTOCOLS, Protocol, draw_truth, evaluate, record
from catalogue.store import Catalogue
from solver.machines.fault import FaultState
from solver.simulation.simulate import Case, Settings, simulate

SHORT = replace(PROTOCOLS["matched"], seconds=(1.0, 1.2), clearance=(80e-6, 700e-6))


def test_most_held_out_faults_are_found(small_catalogue: Catalogue) -> None:
    seen: list[tuple[int, int]] = []
    found = evaluate(small_catalogue, SHORT, 16, seed=3, progress=lambda done, total: seen.append((done, total)))
    assert found.count == 16
    assert found.failed == found.refused == 0
    assert found.labels == ("healthy", "A", "B", "O")
    assert [sum(row) for row in found.confusion] == [4, 4, 4, 4]
    assert found.top1 >= 14 / 16
    assert found.top2 >= found.top1
    assert found.log_loss < 0.6
    assert found.clearance_median is not None
    assert found.clearance_median < 0.2
    assert 0.0 <= found.calibration_error <= 1.0
    assert found.set_coverage >= found.top1
    assert found.wrong_verdict <= 2 / 16
    assert seen[-1] == (16, 16)
    content = found.content()
    assert json.loads(json.dumps(content))["protocol"]["name"] == "matched"


def test_truth_follows_from_the_seed_and_stays_within_the_protocol(small_catalogue: Catalogue) -> None:
    protocol = PROTOCOLS["hard"]
    first = [draw_truth(small_catalogue, Hypothesis.of("A"), protocol, np.random.default_rng(5)) for _ in range(2)]
    assert first[0] == first[1]
    generator = np.random.default_rng(6)
    for _ in range(50):
        truth = draw_truth(small_catalogue, Hypothesis.of("B"), protocol, generator)
        assert list(truth.clearances) == ["B"]
        assert protocol.clearance[0] <= truth.clearances["B"] <= protocol.clearance[1]
        nominal = small_catalogue.recipe.nominal_drive_speed
        assert abs(truth.parameters["drive.speed"] / nominal - 1.0) <= protocol.speed
        assert protocol.friction[0] <= truth.parameters["contact.friction"] <= protocol.friction[1]
        assert truth.seconds >= 2.5
    assert list(draw_truth(small_catalogue, Hypothesis.of("AB"), protocol, generator).clearances) == ["A", "B"]
    new = draw_truth(small_catalogue, Hypothesis.as_new(), protocol, generator)
    assert list(new.clearances) == ["A", "B", "O"]
    assert max(new.clearances.values()) <= small_catalogue.plan.as_new.high
    assert draw_truth(small_catalogue, Hypothesis.of(""), protocol, generator).clearances == {}


def test_recordings_carry_the_noise_and_gains_of_the_protocol(small_catalogue: Catalogue) -> None:
    machine = small_catalogue.machine
    history = simulate(machine, Case(FaultState({})), Settings(sample_rate=5000.0, revolutions=10))
    clean = record(machine, history, Protocol("none", sensor_noise=0.0), 0.5, np.random.default_rng(1))
    assert clean.signal.shape == (2500, 4)
    assert clean.channel_names == tuple(sensor.name for sensor in machine.sensors)
    noisy = record(machine, history, Protocol("noise", sensor_noise=0.1), 0.5, np.random.default_rng(1))
    assert (noisy.signal - clean.signal).std(axis=0) == pytest.approx(0.1, rel=0.1)
    assert noisy.sha256 != clean.sha256
    quiet = Protocol("gain", sensor_noise=0.0, gain=0.05)
    gains = record(machine, history, quiet, 0.5, np.random.default_rng(1)).signal / clean.signal
    assert np.allclose(gains, gains[0])
    assert 0.005 < np.abs(gains[0] - 1.0).max() < 0.25


def test_refuses_what_it_cannot_do(small_catalogue: Catalogue) -> None:
    with pytest.raises(DiagnosisError, match="protocol: easy: must be one of matched, noisy, hard"):
        evaluate(small_catalogue, "easy")
    with pytest.raises(DiagnosisError, match="count: 3: must be at least 4"):
        evaluate(small_catalogue, "matched", 3)
