"""Runs of shipped machines with every link's motion, and what tests of physics ask of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from oracle.state import State

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.equations.links import LinkMotion
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

Array = NDArray[np.float64]
Tree = dict[str, Any]


def tree_of(name: str, *, gravity: float = 9.81, **contact: float) -> Tree:
    """A shipped machine as a tree, with these contact numbers at every turning joint."""
    tree: Tree = shipped_machine(name).model_dump(mode="json")
    tree["gravity"] = gravity
    for joint in tree["joints"].values():
        if joint["kind"] == "turning":
            joint["contact"] |= contact
    return tree


def run(machine: Machine, fault: dict[str, float], **settings: Any) -> tuple[History, LinkMotion]:
    history = simulate(machine, Case(Fault(fault)), Settings(links=True, **settings))
    assert history.status is Status.OK
    assert history.links is not None
    return history, history.links


def drawn(machine: Machine) -> Array:
    return np.array([(*link.cg, 0.0) for link in machine.links.values()])


def states(machine: Machine, motion: LinkMotion, every: int = 1) -> list[State]:
    places, rates = motion.displacement[::every] + drawn(machine), motion.velocity[::every]
    return [State(machine, place, rate) for place, rate in zip(places, rates, strict=True)]


def impacts(motion: LinkMotion, joint: str) -> int:
    pressed = motion.reactions[f"force_{joint}_on_pin"].any(axis=1)
    return int(np.count_nonzero(np.diff(pressed.astype(int)) > 0))
