"""Finds worn joints of planar machines from the vibration of their frame.

What most programs need is imported from here, when it is asked for::

    import jointplay as jp

    machine = jp.load_machine("slider-crank")
    history = jp.simulate(machine, {"B": 200e-6})
    history.spectrum()

Everything else is in :mod:`jointplay.solver`, :mod:`jointplay.catalogue` and :mod:`jointplay.app`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from jointplay.version import __version__

if TYPE_CHECKING:
    from jointplay.app.figures.plot import plot
    from jointplay.catalogue.building.build import build
    from jointplay.catalogue.diagnosing.diagnosis import diagnose
    from jointplay.catalogue.diagnosing.together import diagnose_together
    from jointplay.catalogue.evaluation.study import evaluate
    from jointplay.catalogue.measurements.measured_spectrum import read_recording
    from jointplay.catalogue.measurements.measurement import Recording
    from jointplay.catalogue.plans.plan import Plan, load_plan
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.cases.case import Case, Settings
    from jointplay.solver.machines.fault import Fault
    from jointplay.solver.machines.machine import Machine, load_machine
    from jointplay.solver.simulation.simulate import simulate

__all__ = [
    "Case",
    "Catalogue",
    "Fault",
    "Machine",
    "Plan",
    "Recording",
    "Settings",
    "__version__",
    "build",
    "diagnose",
    "diagnose_together",
    "evaluate",
    "load_machine",
    "load_plan",
    "plot",
    "read_recording",
    "simulate",
]

_HOMES = {
    "app.figures.plot": ("plot",),
    "catalogue.building.build": ("build",),
    "catalogue.diagnosing.diagnosis": ("diagnose",),
    "catalogue.diagnosing.together": ("diagnose_together",),
    "catalogue.evaluation.study": ("evaluate",),
    "catalogue.measurements.measured_spectrum": ("read_recording",),
    "catalogue.measurements.measurement": ("Recording",),
    "catalogue.plans.plan": ("Plan", "load_plan"),
    "catalogue.storage.store": ("Catalogue",),
    "solver.cases.case": ("Case", "Settings"),
    "solver.machines.fault": ("Fault",),
    "solver.machines.machine": ("Machine", "load_machine"),
    "solver.simulation.simulate": ("simulate",),
}


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            found: object = getattr(import_module(f"{__name__}.{home}"), name)
            globals()[name] = found  # the next time it is simply there
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
