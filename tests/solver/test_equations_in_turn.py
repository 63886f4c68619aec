"""Threads that simulate: one at a time at equations, all at once in compiled code."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from jointplay.solver.cases import preparation
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.equations.turns import alone, aside
from jointplay.solver.integrators import adaptive
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import load_machine
from jointplay.solver.simulation.simulate import simulate_batch

COUNT = 3
WAITS_S = 60.0


def simulate(number: int) -> Status:
    """A machine whose model no process has kept, as its name is part of it."""
    machine = load_machine("slider-crank").model_copy(update={"name": f"turns-{number}"})
    return simulate_batch(machine, [Case(Fault({"A": 1e-4}))], Settings(duration=0.001))[0].status


def test_equations_wait_for_their_turn_and_compiled_code_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """CasADi crashes where two threads build models at the same time."""
    building: list[int] = []
    most: list[int] = []
    build, integrate = preparation.build_model, adaptive.integrate
    together = threading.Barrier(COUNT)

    def slowly(*asked: Any) -> Any:
        building.append(1)
        time.sleep(0.05)
        most.append(len(building))
        model = build(*asked)
        building.pop()
        return model

    def side_by_side(*asked: Any) -> Any:
        if not together.broken:
            together.wait(WAITS_S)  # for all others: broken where one of them waits for this one
        return integrate(*asked)

    monkeypatch.setattr(preparation, "build_model", slowly)
    monkeypatch.setattr(adaptive, "integrate", side_by_side)
    with ThreadPoolExecutor(COUNT) as threads:
        found = list(threads.map(simulate, range(COUNT)))
    assert found == [Status.OK] * COUNT
    assert len(most) >= COUNT and set(most) == {1}


@pytest.mark.parametrize("within", [alone, aside])
def test_a_turn_is_given_back_whatever_happens(within: Callable[[], Any]) -> None:
    with pytest.raises(ZeroDivisionError), alone(), within():
        raise ZeroDivisionError
    with ThreadPoolExecutor(1) as other, alone(), aside():
        other.submit(simulate, COUNT).result(WAITS_S)
