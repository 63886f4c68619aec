"""Starts in the healthy machine's steady state."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.groups import groups
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.simulation.averages import PHASES, healthy_revolution, starts_at
from jointplay.solver.simulation.simulate import simulate, simulate_batch
from jointplay.solver.spectra.harmonics import harmonic_levels, mean_difference_db

CASES = [("slider-crank", {"B": 2e-4}), ("quick-return", {"F": 2e-4}), ("four-bar", {"A": 1e-4})]


def case_of(name: str, fault: dict[str, float]) -> tuple[Machine, Case]:
    return shipped_machine(name), Case(Fault(fault))


@pytest.mark.parametrize(("name", "fault"), CASES)
def test_starts_close_and_keep_the_frame(name: str, fault: dict[str, float]) -> None:
    machine, case = case_of(name, fault)
    healthy = healthy_revolution(machine, case, Settings())
    assert len(healthy.t) == PHASES
    phases = [0, 77, 300]
    starts = starts_at(machine, case, Settings(), phases, healthy.displacement[phases], healthy.velocity[phases])
    group = next(groups(machine, [case], Settings()))
    model = group.model
    frame = list(model.frame_indices)
    revolution = 2 * math.pi / abs(healthy.drive_speed)
    for phase, start in zip(phases, starts, strict=True):
        assert start.t == pytest.approx(phase / PHASES * revolution)
        gaps, jacobian, drift = model.constraint(start.t, start.z, start.v, group.ready[0].vector)
        assert np.abs(gaps.full()).max() < 1e-11  # closures, and pins concentric
        assert np.abs(jacobian.full() @ start.v + drift.full()[:, 0]).max() < 1e-8  # and staying so
        assert start.z[frame] == pytest.approx(healthy.displacement[phase], abs=1e-15)
        assert start.v[frame] == pytest.approx(healthy.velocity[phase], abs=1e-9)


def test_the_healthy_machine_repeats() -> None:
    """What is left of its start is a ten-thousandth; the last revolution is the one before."""
    machine, case = case_of("slider-crank", {})
    once = healthy_revolution(machine, case, Settings())
    later = simulate(machine, case, Settings(duration=4.0, sample_rate=PHASES * 10))
    swing = np.ptp(later.displacement[-PHASES - 1 : -1, 1])
    assert np.abs(once.displacement[:, 1] - later.displacement[-PHASES - 1 : -1, 1]).max() < 1e-3 * swing


@pytest.mark.parametrize(("name", "fault"), CASES[:2])
def test_the_transient_is_shorter(name: str, fault: dict[str, float]) -> None:
    """Revolutions until one is within 0.2 dB of the steady state: measured 2 from there, 7 and 4 as drawn."""
    machine, case = case_of(name, fault)
    healthy = healthy_revolution(machine, case, Settings())
    frequency = abs(healthy.drive_speed) / (2 * math.pi)
    samples = 2000
    settings = Settings(duration=20 / frequency, sample_rate=samples * frequency, accuracy="reference")
    start = starts_at(machine, case, settings, [0], healthy.displacement[:1], healthy.velocity[:1])[0]
    waits = []
    histories = simulate_batch(machine, [case, case], settings, starts=[start, None])
    for history in histories:
        signal = history.band_limited_acceleration[:-1, 1].reshape(20, samples)
        levels = [harmonic_levels(one, history.sample_rate, frequency) for one in signal]
        away = [mean_difference_db(level, levels[-1]) for level in levels]
        waits.append(next(k for k in range(20) if max(away[k:]) < 0.2))
    assert waits[0] <= 2
    assert waits[1] >= 2 * waits[0]


def test_no_steady_state_where_nothing_comes_round() -> None:
    machine, case = case_of("slider-crank", {})
    with pytest.raises(SettingsError, match="constant speed"):
        healthy_revolution(machine, replace(case, parameters={"drive.speed": 0.0}), Settings())
