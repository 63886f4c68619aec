"""Ten thousand revolutions of a machine that nothing drives or slows: what error control leaves of its energy.

Closures over as many revolutions: tests/solver/test_convergence.py.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from extremes.scenes import framed
from laws import run, states, tree_of

from jointplay.solver.machines.machine import parse_machine


@pytest.mark.long
@pytest.mark.parametrize(
    # Measured: 1.1e-8 and 5e-9 of the energy at 1e-10; a hundred times the tolerance loses 4e-7 and 1.6e-6.
    ("name", "duration"), [("four-bar", 1000.0), ("slider-crank", 1700.0)],
)  # fmt: skip
def test_energy_over_ten_thousand_revolutions(name: str, duration: float) -> None:
    tree = framed({"fixed": True}, tree_of(name, gravity=0.0), supports=[], sensors=[], drive=None)
    machine = parse_machine(tree | {"initial": {"velocities": {"crank": {"omega": 60.0}}}})
    _, motion = run(machine, {}, duration=duration, sample_rate=10, rtol=1e-10)
    turned = motion.displacement[-1, motion.links.index("crank"), 2]
    assert turned > 10_000 * 2 * math.pi
    energy = np.array([state.energy({}) for state in states(machine, motion, every=100)])
    assert np.abs(energy / energy[0] - 1).max() < 3e-8
