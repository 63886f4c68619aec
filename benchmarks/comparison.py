"""Cost of simulated time at equal harmonic error: every program at its own cheapest setting."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.computer import installed
from benchmarks.scenes import RATE, Scene

Array = NDArray[np.float64]

#: Harmonic error at which costs are compared, dB.
LIMIT_DB = 0.1
#: A single run longer than this is not repeated, s.
_LONG = 2.0


@dataclass(frozen=True)
class Program:
    """A way to simulate a scene.

    Attributes
    ----------
    name : str
    settings : tuple of float
        Tolerances or steps, the loosest first.
    run : callable
        Setting -> the frame's y acceleration at `rate`.
    spent : callable, optional
        Setting -> (that acceleration, processor seconds), for programs that know their time without the set-up.
    rate : int
        Hz; instantaneous values at 20 kHz unless it is the product's own signal for spectra.
    cases : int
        That one run simulates; costs are of one of them.
    package : str, optional
        What must be installed.
    unit : str
        Of the settings: a tolerance has none.
    absent : str
        Why it is not here at all.
    """

    name: str
    settings: tuple[float, ...]
    run: Callable[[float], Array] | None = None
    spent: Callable[[float], tuple[Array, float]] | None = None
    rate: int = RATE
    cases: int = 1
    package: str | None = None
    unit: str = ""
    absent: str = ""

    def measure(self, setting: float) -> tuple[Array, float]:
        """Acceleration, and processor seconds of one case."""
        if self.spent is not None:
            return self.spent(setting)
        assert self.run is not None
        began = time.process_time()
        acceleration = self.run(setting)
        return acceleration, (time.process_time() - began) / self.cases


@dataclass
class Point:
    """One program at one setting: processor seconds per simulated second, harmonic error in dB."""

    setting: float
    cost: float
    error: float


@dataclass
class Curve:
    """A program's points, loose to tight, and the cost at equal error; ``missing`` says why there are none."""

    program: str
    unit: str
    points: list[Point] = field(default_factory=list)
    cost: float | None = None
    setting: float | None = None
    error: float | None = None
    missing: str = ""


def cost_at(points: Sequence[Point], limit: float) -> float | None:
    """Cost at an error of `limit` dB, from points that are sorted loose to tight.

    The first setting that meets the limit, or between it and the one before by logarithms: costs of programs with few
    settings are not decided by where these happen to lie. ``None`` where no setting meets it.
    """
    passing = next((k for k, point in enumerate(points) if point.error <= limit), None)
    if passing is None:
        return None
    here = points[passing]
    if passing == 0:
        return here.cost
    before = points[passing - 1]
    part = math.log(before.error / limit) / math.log(before.error / max(here.error, 1e-6))
    between = before.cost * (here.cost / before.cost) ** part
    return float(min(here.cost, between))


def sweep(scene: Scene, program: Program, say: Callable[[str], None]) -> Curve:
    """From the loosest setting to the first that meets the limit, and one more where that is cheap."""
    curve = Curve(program.name, program.unit)
    if program.absent or (program.package is not None and installed(program.package) is None):
        curve.missing = program.absent or f"{program.package} is not installed"
        say(f"{scene.name}: {program.name}: missing: {curve.missing}")
        return curve
    try:
        passed = False
        for setting in program.settings:
            began = time.monotonic()
            acceleration, spent = program.measure(setting)
            if not curve.points and time.monotonic() - began < _LONG:
                acceleration, spent = program.measure(setting)  # the first one compiled
            point = Point(setting, spent / scene.duration, scene.error(acceleration, program.rate))
            curve.points.append(point)
            say(f"{scene.name}: {program.name}, {setting:g}{program.unit}: "
                f"{point.cost:.4g} s/s, {point.error:.3g} dB")  # fmt: skip
            if passed:
                break
            passed = point.error <= LIMIT_DB
            if passed and spent * program.cases > _LONG:
                break
    except (RuntimeError, ValueError, AttributeError, ImportError, OSError) as error:
        curve.missing = f"failed: {error}"
        say(f"{scene.name}: {program.name}: {curve.missing}")
    return curve


def _deciding(curve: Curve) -> list[Point]:
    """The point that meets the limit and the one before it."""
    passing = next((k for k, point in enumerate(curve.points) if point.error <= LIMIT_DB), None)
    return [] if passing is None else curve.points[max(0, passing - 1) : passing + 1]


def compare(
    scene: Scene, programs: Sequence[Program], rounds: int, say: Callable[[str], None]
) -> list[dict[str, object]]:
    """Sweep all programs, then measure what decides again in rounds through all of them.

    The least of the rounds counts, and the rounds go through all programs in turn: a noisy minute meets them all.
    """
    curves = [sweep(scene, program, say) for program in programs]
    for k in range(rounds):
        say(f"{scene.name}: round {k + 1} of {rounds}")
        for program, curve in zip(programs, curves, strict=True):
            for point in _deciding(curve):
                if point.cost * scene.duration * program.cases < _LONG:
                    point.cost = min(point.cost, program.measure(point.setting)[1] / scene.duration)
    for curve in curves:
        deciding = _deciding(curve)
        if deciding:
            curve.cost = cost_at(curve.points, LIMIT_DB)
            curve.setting, curve.error = deciding[-1].setting, deciding[-1].error
        elif curve.points and not curve.missing:
            curve.missing = f"no setting tried reaches {LIMIT_DB} dB"
    return [asdict(curve) for curve in curves]
