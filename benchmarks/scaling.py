"""Cost against the number of links, and against clearances open at once."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.arithmetic import casadi_operations, nanoseconds
from benchmarks.computer import processor_seconds
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.equations.model import build_model
from jointplay.solver.integrators.kernel import compile_model
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate_batch

Row = dict[str, Any]

LOOPS = (2, 5, 10, 20, 40)
#: The dense equations are solved at one state; beyond this many loops they take too long to be worth it.
_DENSE_LOOPS = 40
_CLEARANCE = 2e-4
#: Joints in the order in which they are opened.
_OPENED = {"four-bar": ("O", "A", "B", "D"), "quick-return": ("C", "E", "F", "A", "O")}


def chain(loops: int) -> Machine:
    """Four-bar loops in a row on one sprung frame: 2 `loops` + 1 moving links."""
    links: dict[str, Any] = {"frame": {"mass": 50, "inertia": 5, "cg": [0, 0]}}
    joints: dict[str, Any] = {}
    for i in range(loops + 1):
        links[f"post{i}"] = {"mass": 1, "inertia": 0.08, "cg": [i, 0.5]}
        joints[f"O{i}"] = {"kind": "turning", "links": [f"post{i}", "frame"], "at": [i, 0]}
    for i in range(loops):
        links[f"bar{i}"] = {"mass": 1, "inertia": 0.08, "cg": [i + 0.5, 1]}
        joints[f"A{i}"] = {"kind": "turning", "links": [f"bar{i}", f"post{i}"], "at": [i, 1]}
        joints[f"B{i}"] = {"kind": "turning", "links": [f"bar{i}", f"post{i + 1}"], "at": [i + 1, 1]}
    mounts = [
        {"kind": "mount", "link": "frame", "at": [x, 0], "stiffness": [2e5, 4e5], "damping": [200, 300]}
        for x in (-0.5, loops + 0.5)
    ]
    drive = {"kind": "rotation", "joint": "O0", "speed": 10.0}
    return parse_machine({"name": "chain", "links": links, "joints": joints, "supports": mounts, "drive": drive})


def _dense_seconds(machine: Machine) -> float:
    """The paper's equations in full, by the dense solver that judges ours in the tests."""
    tests = str(Path(__file__).parents[1] / "tests")
    if tests not in sys.path:
        sys.path.append(tests)
    from oracle.dense import solve

    places = np.array([(*link.cg, 0.0) for link in machine.links.values()])
    with threadpool_limits(1):
        return processor_seconds(lambda: solve(machine, {}, 0.0, places, np.zeros_like(places)), 3)


def links(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Operations, compilation and nanoseconds of chains; compilation with an empty cache."""
    rows = []
    kept = os.environ.get("JOINTPLAY_CACHE_DIR")
    for loops in LOOPS[:3] if quick else LOOPS:
        machine = chain(loops)
        with tempfile.TemporaryDirectory() as empty:
            os.environ["JOINTPLAY_CACHE_DIR"] = empty
            try:
                began = time.process_time()
                model = build_model(machine, ())
                equations = time.process_time() - began
                began = time.process_time()
                compile_model(model)
                compiled = time.process_time() - began
                ns, kernel, _ = nanoseconds(machine, {})
            finally:
                if kept is None:
                    del os.environ["JOINTPLAY_CACHE_DIR"]
                else:
                    os.environ["JOINTPLAY_CACHE_DIR"] = kept
        row: Row = {
            "moving": len(machine.links) - 1, "unknowns": 3 * len(machine.links) + 2 * len(machine.joints),
            "symbols": casadi_operations(model), "operations": kernel.operations, "equations_s": equations,
            "compile_s": compiled, "ns": ns,
        }  # fmt: skip
        if loops <= _DENSE_LOOPS:
            row["dense_ms"] = 1e3 * _dense_seconds(machine)
        rows.append(row)
        say(f"links: {row['moving']} moving, {row['operations']} operations, {ns:.0f} ns, compiled in {compiled:.1f} s")
    return rows


def clearances(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Shipped machines with none to all of their turning joints open."""
    rows = []
    for name, order in _OPENED.items():
        machine = shipped_machine(name)
        for count in range(len(order) + 1):
            worn = dict.fromkeys(order[:count], _CLEARANCE)
            ns, kernel, model = nanoseconds(machine, worn)
            cases = [Case(Fault(worn))] * 8
            settings = Settings(duration=0.5 if quick else 2.0)
            simulate_batch(machine, cases, Settings(duration=0.01))
            spent = processor_seconds(lambda: simulate_batch(machine, cases, settings), 2)  # noqa: B023
            cost = spent / len(cases) / (settings.duration or 1.0)
            rows.append({"machine": name, "open": count, "coordinates": model.size, "operations": kernel.operations,
                         "ns": ns, "cost": cost})  # fmt: skip
            say(f"clearances: {name}, {count} open: {kernel.operations} operations, {ns:.1f} ns, {cost:.4f} s/s")
    return rows
