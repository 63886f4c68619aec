"""How far order levels of a machine whose speed changes are from those at the speeds that it passes.

    python -m benchmarks.sweeps [MACHINE]

The machine without wear runs up and down through 15 % about its speed, at rates at which an order is swept by a number
of half-power widths of a suspension mode within that mode's decay time, with its dampers as they are and weaker ones.
Levels of orders 1 to 20 at all sensors within 3 % of its speed are compared with those of steady runs, window by window
of three revolutions.
"""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np

from jointplay.app.tables import table
from jointplay.catalogue.signals import speedpieces
from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import HEALTHY
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.machines.parts import Mount, RotationDrive
from jointplay.solver.simulation.simulate import simulate

WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
DAMPING = (1.0, 0.3)
ORDERS = 20
RATE = 10_000.0
#: Samples a revolution, and revolutions a window.
DENSE, WINDOW = 256, 3
#: What is less than this part of the loudest order's power is, without wear, what windows let through.
FLOOR = 1e-4


def levels(signal: FloatArray, angle: FloatArray, centres: FloatArray) -> FloatArray:
    """Power (w, orders, sensors) in windows about some revolutions, each order with half an order to either side."""
    window = np.hanning(WINDOW * DENSE)[:, None]
    order = np.arange(WINDOW * DENSE // 2 + 1) / WINDOW
    bands = np.array([np.abs(order - k) <= 0.5 for k in range(1, ORDERS + 1)], float)
    found = []
    for centre in centres:
        at = 2 * math.pi * (centre + (np.arange(WINDOW * DENSE) / DENSE - 0.5 * WINDOW))
        even = np.column_stack([np.interp(at, angle, column) for column in signal.T])
        found.append(bands @ np.abs(np.fft.rfft((even - even.mean(axis=0)) * window, axis=0)) ** 2)
    return np.array(found)


def run(machine: Machine, speed: float | tuple[tuple[float, float], ...], duration: float) -> FloatArray:
    """Accelerations (n, s) of the sensors."""
    assert isinstance(machine.drive, RotationDrive)
    turning = machine.model_copy(update={"drive": machine.drive.model_copy(update={"speed": speed})})
    history = simulate(turning, Case(HEALTHY), Settings(duration=duration, sample_rate=RATE))
    return history.at_sensors(machine)


def deviation(
    machine: Machine, nominal: float, rate: float, side: float, steady: dict[float, FloatArray]
) -> tuple[float, float]:
    """Rms and largest of the differences [dB] over orders and sensors, of a sweep at a rate [1/s] up or down."""
    low, high = nominal * (1 - 0.15 * side), nominal * (1 + 0.15 * side)
    wait, length = 3.0, 0.30 / rate
    signal = run(machine, ((0.0, low), (wait, low), (wait + length, high)), wait + length)
    time = np.arange(len(signal)) / RATE
    speed = np.interp(time, [wait, wait + length], [low, high])
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) / RATE])
    inside = angle[np.abs(speed / nominal - 1) <= speedpieces.COVERED] / (2 * math.pi)
    centres = np.arange(inside[0] + 0.5 * WINDOW, max(inside[-1] - 0.5 * WINDOW, inside[0] + 0.5 * WINDOW + 0.1))
    at = np.interp(2 * math.pi * centres, angle, speed) / nominal
    found = levels(signal, angle, centres).mean(axis=0)
    speeds = np.array(sorted(steady))
    known = np.log(np.array([steady[each] for each in speeds])).reshape(len(speeds), -1)
    expected = np.array([[np.interp(each, speeds, column) for column in known.T] for each in at])
    should = np.exp(expected).mean(axis=0)
    floor = FLOOR * should.max()
    away = 10 * np.log10((found.ravel() + floor) / (should + floor))
    return float(np.sqrt(np.mean(away**2))), float(np.abs(away).max())


def main() -> int:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machine", nargs="?", default="slider-crank")
    filed = shipped_machine(parser.parse_args().machine)
    assert isinstance(filed.drive, RotationDrive) and isinstance(filed.drive.speed, float)
    nominal, rows = filed.drive.speed, []
    for factor in DAMPING:
        supports = tuple(
            each.model_copy(update={"damping": tuple(factor * one for one in each.damping)})
            if isinstance(each, Mount) else each for each in filed.supports
        )  # fmt: skip
        machine = filed.model_copy(update={"supports": supports})
        change, decay = speedpieces.fastest_change(machine)
        steady = {}
        for relative in np.linspace(0.96, 1.04, 17):
            turns = 12
            duration = 8 * decay + turns * 2 * math.pi / nominal / relative
            signal = run(machine, float(relative * nominal), duration)
            angle = relative * nominal * np.arange(len(signal)) / RATE
            last = angle[-1] / (2 * math.pi)
            steady[float(relative)] = levels(signal, angle, last - WINDOW - np.arange(6.0)).mean(axis=0)
        for widths in WIDTHS:
            rate = change * widths / speedpieces.QUASI_STEADY
            passed = 2 * speedpieces.COVERED / rate * nominal / (2 * math.pi)
            if passed < WINDOW:
                continue
            up, down = (deviation(machine, nominal, rate, side, steady) for side in (1.0, -1.0))
            rows.append((f"{factor:g}", f"{widths:g}", f"{100 * rate:.3g} %/s", f"{passed:.0f}",
                         f"{up[0]:.2f} ({up[1]:.1f})", f"{down[0]:.2f} ({down[1]:.1f})"))  # fmt: skip
            print(rows[-1], file=sys.stderr, flush=True)
    head = ("dampers", "half-power widths a decay", "change of speed", "revolutions", "up: rms (largest) dB", "down")
    print(table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
