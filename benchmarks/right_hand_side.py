"""P1, the slider-crank with one worn joint: our lanes beside SciPy on the same right-hand side, in one run.

Prints the cost of a right-hand side and of simulated time. SciPy integrates the same compiled code, one case at a time
(its lane repeated eight times, which costs it nothing: one lane takes as long), so the ratio is what lanes and
a compiled integrator bring, not what another model would.

    python benchmarks/right_hand_side.py
"""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from solver import gill
from solver.fault import FaultState
from solver.ir import LANES
from solver.kernel import Kernel, compile_model
from solver.machine import load_machine
from solver.model import Model, build_model
from solver.pose import start_velocity

CLEARANCE = 2e-4
STEP = 1e-5
RHS_CALLS = 40_000
ROUNDS = 7
SIMULATED = 0.2  # s


def work_array(model: Model, kernel: Kernel, fault: FaultState) -> np.ndarray:
    """All lanes at the start of the same case."""
    values = {f"joints.{joint}.clearance": clearance for joint, clearance in fault.items()}
    p = model.vector(values)
    z = np.zeros(model.size)
    v = start_velocity(model, p, z)
    work = kernel.work_array()
    layout = kernel.layout
    for start, column in ((layout.z, z), (layout.v, v), (layout.p, p)):
        for i, value in enumerate(column):
            work[start + LANES * i : start + LANES * (i + 1)] = value
    return work


def processor_seconds(function: Callable[[], object]) -> float:
    """Median processor time of several rounds, after one that does not count."""
    function()
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return statistics.median(times)


@njit
def derivative(kernel: tuple[int, int, int, int], work: np.ndarray, n: int, t: float, y: np.ndarray) -> np.ndarray:
    """State derivative of lane 0 for SciPy."""
    for lane in range(LANES):
        work[lane] = t
        for i in range(2 * n):
            work[LANES * (2 + i) + lane] = y[i]
    gill.call(kernel[1], work)
    out = np.empty(2 * n)
    for i in range(n):
        out[i] = y[n + i]
        out[n + i] = work[LANES * (2 + 2 * n + i)]
    return out


def main() -> None:
    """Measure and print."""
    machine = load_machine(Path(__file__).parents[1] / "tests/data/reference/p1.yaml")
    fault = FaultState({"B": CLEARANCE})
    model = build_model(machine, fault.joints)
    began = time.perf_counter()
    kernel = compile_model(model)
    compiled = time.perf_counter() - began
    start = work_array(model, kernel, fault)
    n = model.size
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    print(f"P1, B = {CLEARANCE * 1e3:g} mm: {n} coordinates, {kernel.operations} vector operations, "
          f"compiled or loaded in {compiled:.2f} s")  # fmt: skip

    work = start.copy()
    per_call = processor_seconds(lambda: gill.repeat(kernel.functions, work, RHS_CALLS)) / RHS_CALLS
    print(f"right-hand side, {LANES} lanes: {per_call / LANES * 1e9:6.1f} ns per lane")

    steps = round(SIMULATED / STEP)
    out = np.zeros((LANES, 3, steps // 5 + 1))
    record = np.array(kernel.layout.rows(kernel.layout.z, 3), dtype=np.int64)
    broken, counts = np.zeros(LANES, dtype=np.int64), np.full(LANES, out.shape[2])
    finals, begins = np.zeros((LANES, 2 + 2 * n)), np.zeros(LANES)

    def lanes() -> None:
        work[:] = start
        gill.integrate(kernel.functions, work, n, begins, STEP, 5, record, out, broken, kernel.jam, counts, finals)

    ours = processor_seconds(lanes) / LANES / SIMULATED
    evaluation = ours * STEP / 4
    print(f"Runge-Kutta-Gill, h = {STEP:g} s:   {evaluation * 1e9:6.1f} ns per right-hand side and lane with its step, "
          f"{ours:.4f} s of processor per simulated second")  # fmt: skip

    y0 = np.concatenate([start[kernel.layout.rows(start_row, n)] for start_row in (kernel.layout.z, kernel.layout.v)])
    gill.repeat(kernel.functions, work, 1)
    derivative(kernel.functions, work, n, 0.0, y0)
    for method, rtol in (("RK45", 1e-6), ("DOP853", 1e-6), ("LSODA", 1e-6), ("Radau", 1e-6)):
        calls = 0

        def function(t: float, y: np.ndarray) -> np.ndarray:
            nonlocal calls
            calls += 1
            return derivative(kernel.functions, work, n, t, y)

        began = time.process_time()
        solution = solve_ivp(function, (0.0, SIMULATED), y0, method=method, rtol=rtol, atol=1e-12)
        spent = (time.process_time() - began) / SIMULATED
        assert solution.success, solution.message
        print(f"solve_ivp {method:6s} rtol {rtol:g}:   {spent / calls * SIMULATED * 1e9:6.0f} ns per right-hand side, "
              f"{spent:.4f} s of processor per simulated second: {spent / ours:6.0f} times ours")  # fmt: skip


if __name__ == "__main__":
    main()
