"""Cases that ``test_device.py`` runs on the processor and, in a process of its own, under Numba's simulator of CUDA.

Short and few: the simulator is plain Python with a thread of the operating system for each thread of a device.
"""

from __future__ import annotations

import pickle
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from test_simulate import crank_at

from jointplay.solver.cases.history import Case, History, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, load_machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate_batch

Table = tuple[Machine, list[Case], Settings]

P1 = load_machine(Path(__file__).parents[1] / "data" / "reference" / "p1.yaml")
SHORT = Settings(duration=0.01, sample_rate=5000)
SLIDE = {"kind": "translation", "joint": "G", "speed": 0.1}


GONE_ON_WITH = ("P1 with clearance", "quick-return, two worn joints, every link")


def rubbing() -> Any:
    """The shipped slider-crank with friction in its guide."""
    tree = shipped_machine("slider-crank").model_dump(mode="json")
    tree["joints"]["G1"] |= {"friction": 0.1, "friction_velocity": 0.05}
    return tree


def remembering() -> Any:
    """The shipped four-bar with contacts that remember their impacts, one with powers that need a logarithm."""
    tree = shipped_machine("four-bar").model_dump(mode="json")
    laws = {
        "A": {"law": "flores", "stiffness": 1e7, "restitution": 0.5, "exponent": 1.1},
        "B": {"law": "gonthier", "stiffness": 5e8, "restitution": 0.4},
    }
    for name, law in laws.items():
        tree["joints"][name]["contact"] = law
    return tree


TABLES: dict[str, Table] = {
    "healthy slider-crank, closed loop": (
        shipped_machine("slider-crank"),
        [Case(), Case(parameters={"drive.speed": 40.0})],
        SHORT,
    ),
    "P1 with clearance": (
        P1,
        [Case(Fault({"B": 2e-4}), {"drive.speed": speed}) for speed in (30.0, 62.8)],
        replace(SHORT, duration=0.02),
    ),
    "quick-return, two worn joints, every link": (
        shipped_machine("quick-return"),
        [Case(Fault({"A": 1e-4, "F": 5e-5}))],
        replace(SHORT, links=True, accuracy="draft"),
    ),
    "spectra alone": (P1, [Case(Fault({"B": 2e-4}))], replace(SHORT, motion=False)),
    "more cases than a block has threads": (
        P1,
        [Case(parameters={"drive.speed": 20.0 + i}) for i in range(34)],
        replace(SHORT, duration=0.002, accuracy="draft"),
    ),
    "a guide that rubs, and one that jams": (
        parse_machine(rubbing()),
        [Case(parameters={"joints.G1.friction": friction}) for friction in (0.2, 3.5)],
        Settings(duration=0.05, sample_rate=1000, accuracy="draft"),
    ),
    "contacts that remember their impacts": (
        parse_machine(remembering()),
        [Case(Fault({"A": 1e-4})), Case(Fault({"A": 1e-4, "B": 5e-5}))],
        replace(SHORT, links=True, duration=0.05, sample_rate=2000, accuracy="draft"),
    ),
    "a slide driven past its reach": (
        parse_machine(crank_at(1.0, drive=SLIDE)),
        [Case(), Case(parameters={"drive.speed": -0.01})],
        Settings(duration=0.3, sample_rate=1000),
    ),
}


def histories(device: Literal["cpu", "cuda"]) -> dict[str, list[History]]:
    """All tables, simulated; the first cases of two gone on with."""
    found = {
        name: simulate_batch(machine, cases, replace(settings, device=device))
        for name, (machine, cases, settings) in TABLES.items()
    }
    for name in GONE_ON_WITH:
        machine, cases, settings = TABLES[name]
        ends = [history.end for history in found[name][:1]]
        found[f"{name}, gone on with"] = simulate_batch(
            machine, cases[:1], replace(settings, device=device), starts=ends
        )
    return found


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(pickle.dumps(histories("cuda")))
