"""One case step by step, as plain Python: what a device's thread does between two returns to the host."""

from __future__ import annotations

from typing import Any

import numpy as np

from jointplay.solver.cases.start import start_pose, start_velocity
from jointplay.solver.compiler.scalar import SCALAR
from jointplay.solver.equations.model import build_model
from jointplay.solver.integrators import stepper
from jointplay.solver.integrators.control import OK, RUNNING
from jointplay.solver.integrators.dopri import StepRows
from jointplay.solver.integrators.kernel import adaptive_code
from jointplay.solver.machines.machine import shipped_machine

SAMPLES, INTERVAL, FIRST = 120, 1e-4, 1e-4


class Run:
    """Slider-crank with a worn joint from rest, 12 ms: flights and impacts."""

    def __init__(self, most: int = 10**6) -> None:
        self.model = build_model(shipped_machine("slider-crank"), ("A",))
        n, recorded = self.model.size, (0, 1)
        code = adaptive_code(self.model, [1.0] * n, recorded, SCALAR)
        rows = StepRows(code.layout, 1, recorded)
        self.begin, self.advance = stepper.case_functions(code, rows, (), lambda function: function)
        self.w, self.s = np.zeros(code.layout.total), np.zeros(stepper.state_length(1))
        p = np.array(self.model.vector({"joints.A.clearance": 1e-4}))
        z = start_pose(self.model, list(p))
        layout = code.layout
        for start, column in ((layout.z, z), (layout.v, start_velocity(self.model, list(p), z)), (layout.p, p)):
            self.w[start : start + len(column)] = column
        self.records = [np.zeros((2, SAMPLES)) for _ in range(3)]
        self.s[: stepper.OUTCOME] = [0.0, 1e-7, 0.05, FIRST, 1e-3, SAMPLES, most, 1e-9]
        self.begin(self.w, self.s)

    def go(self, count: int) -> None:
        self.advance(self.w, self.s, count, INTERVAL, 1, np.array([0, 1]), *self.records, np.zeros((0, 0)))


def finished(**limits: Any) -> Run:
    run = Run(**limits)
    run.go(10**6)
    return run


def test_a_run_may_be_left_after_any_trial_step() -> None:
    whole, parts = finished(), Run()
    calls = 0
    while parts.s[stepper.OUTCOME] == RUNNING:
        parts.w, parts.s = parts.w.copy(), parts.s.copy()  # nothing else is kept
        parts.go(1)
        calls += 1
    assert calls == whole.s[stepper.TRIALS] > 50
    assert whole.s[stepper.OUTCOME] == OK
    assert np.array_equal(parts.s, whole.s)
    for ours, theirs in zip(parts.records, whole.records, strict=True):
        assert np.array_equal(ours, theirs)


def test_too_many_trials_stall() -> None:
    run = finished(most=20)
    assert run.s[stepper.OUTCOME] == stepper.STALLED
    assert run.s[stepper.TRIALS] < 40
    assert 0 < run.s[stepper.SAMPLE] < SAMPLES
