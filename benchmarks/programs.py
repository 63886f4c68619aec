"""Who is compared on which scene, and with which settings."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks import exudyn_model, integrators, mujoco_model, problem, scalar_dopri
from benchmarks.comparison import Program
from benchmarks.scenes import LIMITED_RATE, Scene
from jointplay.solver.cases.case import Settings, Status
from jointplay.solver.simulation.simulate import simulate_batch

Array = NDArray[np.float64]

#: Cases side by side in one run of ours: every lane is filled twice.
CASES = 16
OURS = "jointplay, sixteen cases"
#: Left out of a smoke test.
_SLOW = ("SciPy DOP853", "SciPy Radau", "MuJoCo, Runge-Kutta 4", "Exudyn, trapezoidal")
TOLERANCES = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 1e-9, 1e-10)


def _ours(scene: Scene, cases: int, method: str, setting: float) -> Array:
    """What a catalogue asks for: the signal that spectra are made of, of many cases at once."""
    settings = Settings(duration=scene.duration, sample_rate=LIMITED_RATE, motion=False)
    settings = replace(settings, rtol=setting) if method == "adaptive" else replace(settings, step=setting)
    histories = simulate_batch(scene.machine, [scene.case] * cases, settings)
    if histories[0].status is not Status.OK:
        raise RuntimeError(histories[0].message)
    return histories[0].band_limited_acceleration[:, 1]


def _in_full(scene: Scene, setting: float) -> Array:
    """Displacement, velocity and instantaneous acceleration at 20 kHz as well."""
    histories = simulate_batch(scene.machine, [scene.case] * CASES, Settings(duration=scene.duration, rtol=setting))
    if histories[0].status is not Status.OK:
        raise RuntimeError(histories[0].message)
    return histories[0].acceleration[:, 1]


def ours(scene: Scene) -> list[Program]:
    """The product: many cases, one alone, with all that a run can record, and the paper's method."""
    tolerances = TOLERANCES[:-2]
    return [
        Program(OURS, tolerances, partial(_ours, scene, CASES, "adaptive"), cases=CASES, rate=LIMITED_RATE),
        Program("jointplay, sixteen cases, all motions, 20 kHz", tolerances, partial(_in_full, scene), cases=CASES),
        Program("jointplay, one case alone", tolerances, partial(_ours, scene, 1, "adaptive"), rate=LIMITED_RATE),
        Program("jointplay, Runge-Kutta-Gill, sixteen cases", (2.5e-5, 1.25e-5, 6.25e-6),
                partial(_ours, scene, CASES, "gill"), cases=CASES, rate=LIMITED_RATE, unit=" s"),
    ]  # fmt: skip


def integrators_on(scene: Scene, equations: problem.Problem) -> list[Program]:
    """SciPy and CVODE on one compiled right-hand side."""
    end = scene.duration

    def scipy(method: str) -> partial[Array]:
        return partial(integrators.initial_value_problem, equations, method, end)

    return [
        Program("CVODE Adams, compiled throughout", TOLERANCES, partial(integrators.cvode, equations, end),
                package="scikit-sundae"),
        Program("CVODE Adams, called from Python", TOLERANCES, partial(integrators.cvode_from_python, equations, end),
                package="scikit-sundae"),
        Program("SciPy LSODA", TOLERANCES, partial(integrators.lsoda, equations, end)),
        Program("SciPy DOP853", TOLERANCES, scipy("DOP853")),
        Program("SciPy Radau", (1e-4, 1e-5, 1e-6, 1e-7), scipy("Radau")),
    ]  # fmt: skip


def _exudyn(scene: Scene, steps: tuple[float, ...]) -> Program:
    """Steps are parts of the interval between samples."""
    return Program(
        "Exudyn, trapezoidal", steps, package="exudyn", unit=" s",
        spent=lambda step: exudyn_model.run(scene.machine, scene.fault, scene.duration, step),
    )  # fmt: skip


def on_p1(scene: Scene, quick: bool) -> list[Program]:
    """Everybody, or those that take seconds; integrators on the right-hand side that was derived by hand."""
    end = scene.duration
    found = [
        *ours(scene),
        Program("scalar Numba DOPRI5 by hand, contact located", TOLERANCES,
                lambda tolerance: scalar_dopri.run(end, tolerance, True)),
        Program("scalar Numba DOPRI5 by hand", TOLERANCES, lambda tolerance: scalar_dopri.run(end, tolerance, False)),
        *integrators_on(scene, problem.by_hand()),
        Program("MuJoCo, Runge-Kutta 4", (2.5e-5, 1e-5, 5e-6, 2.5e-6), package="mujoco-core", unit=" s",
                spent=lambda step: mujoco_model.run(end, step)),
        _exudyn(scene, (2.5e-5, 1e-5, 5e-6, 2.5e-6)),
    ]  # fmt: skip
    return [program for program in found if not quick or program.name not in _SLOW]


def on_quick_return(scene: Scene, equations: problem.Problem, quick: bool) -> list[Program]:
    """Integrators on our own equations, printed as scalar code, and Exudyn with its own."""
    found = [
        *ours(scene),
        *integrators_on(scene, equations),
        Program("MuJoCo", (), absent="not modelled: a loop stays closed, and its constraints are soft"),
        _exudyn(scene, (5e-5, 2.5e-5, 1e-5, 5e-6)),
    ]
    return [program for program in found if not quick or program.name not in _SLOW]
