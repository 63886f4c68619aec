"""Eight runs of one case, a rounding apart, under one setting: what :mod:`jointplay.solver.simulation.tradeoff`
measures.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.cases.preparation import model_of
from jointplay.solver.cases.rates import extent_of
from jointplay.solver.cases.reach import reach_of
from jointplay.solver.cases.start import Start
from jointplay.solver.cases.steps import SETTLING_REVOLUTIONS
from jointplay.solver.cases.turning import even_angle
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine, has_known_effort
from jointplay.solver.simulation.runs import TOLERANCES
from jointplay.solver.simulation.simulate import simulate_batch, start_of
from jointplay.solver.simulation.steady_turning import find_limit_cycle
from jointplay.solver.spectra.by_angle import resample_by_angle
from jointplay.solver.spectra.harmonics import (
    find_comparable,
    harmonic_levels,
    mean_difference_db,
    order_band_levels,
    whole_rate,
)

#: Tolerances of ``adaptive`` that are measured, and those that may serve as the reference, the tightest first.
RUNGS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
REFERENCES = (1e-11, 1e-10, 1e-9, 1e-8)
#: Steps of ``gill`` that are measured besides `draft` and `standard`, as parts of the one of `standard`.
FRACTIONS = (2, 4, 8, 16)
#: Starts differ by this part of the machine's extent from lane to lane.
ROUNDING = 1e-10
#: Revolutions after the transient.
REVOLUTIONS = 10.0
MOTIONS = ("x", "y", "theta")
_SAMPLE_RATE = 20_000.0
#: Tolerance of the limit cycle that machines start in which find their own speed, and revolutions that a record is
#: longer for them, so that slower runs have all those that are looked at.
_CYCLE, _SPARE = 1e-8, 0.5
_MOST_SAMPLES = 400_000
#: The least of so many runs is the cost; no more runs once they took so long, s.
_REPEATS = 3
_LONG = 3.0
#: Trial steps of a run, in multiples of the fixed steps of `standard`, after which it counts as stalled, and the least
#: of them: references that end well take about one (slider-crank at 600 rpm), and a user waits for each that does not.
_PATIENCE = 4
_LEAST_PATIENCE = 2_000_000
#: No other tolerance is tried as the reference once those that failed took so long, s.
_NO_REFERENCE = 20.0


@dataclass(frozen=True)
class TradeOffPoint:
    """One setting, measured.

    Attributes
    ----------
    settings : Settings
    step : float
        s; the mean of error-controlled runs.
    status : Status
        The worst of the eight runs; errors are NaN unless it is ok.
    seconds : float
        Processor seconds per simulated second of one case with all lanes filled.
    error_db : float
        Mean over the runs of the harmonic error, dB; where the response is chaotic, the error of the band levels
        averaged over the runs.
    worst_db : float
        Largest error of a single run, dB.
    repeat_db : float
        Standard deviation of levels between runs that start a rounding apart, mean over harmonics (or bands), dB.
    """

    settings: Settings
    step: float
    status: Status
    seconds: float
    error_db: float
    worst_db: float
    repeat_db: float

    @property
    def label(self) -> str:
        """``adaptive, rtol 1e-06`` or ``gill, step 1.25e-05 s``."""
        if self.settings.integrator == "adaptive":
            return f"adaptive, rtol {self.settings.rtol:g}"
        return f"gill, step {self.step:.3g} s"

    @property
    def accuracy(self) -> str:
        """The named accuracy that is this setting; empty for none."""
        if self.settings.integrator == "gill":
            return self.settings.accuracy if self.settings.step is None else ""
        return next((name for name, rtol in TOLERANCES.items() if rtol == self.settings.rtol), "")


def middle(levels: FloatArray, chaotic: bool) -> FloatArray:
    """Levels (k,) that stand for all lanes: their mean power where they differ, the first lane where they repeat."""
    return np.asarray(10 * np.log10(np.mean(10 ** (levels / 10), axis=0))) if chaotic else levels[0]


@dataclass(frozen=True)
class Bench:
    """Eight equal cases, a rounding apart, and what is looked at in their histories.

    Of a machine that finds its own speed `spare` revolutions are recorded beyond those that are looked at.
    """

    machine: Machine
    case: Case
    starts: Sequence[Start]
    motion: int
    frequency: float
    transient: float
    duration: float
    sample_rate: float
    standard_step: float
    spare: float = 0.0

    def rungs(self) -> list[Settings]:
        """The settings to measure, each method from coarse to fine."""
        adaptive = [Settings(rtol=rtol) for rtol in RUNGS]
        named = [Settings(method="gill", accuracy="draft"), Settings(method="gill")]
        return [*adaptive, *named, *(Settings(step=self.standard_step / part) for part in FRACTIONS)]

    def run(self, settings: Settings, repeats: int = _REPEATS) -> tuple[list[History], float]:
        """Histories of the eight lanes, and the processor seconds of one of them: the least of the repeats."""
        patience = max(_LEAST_PATIENCE, math.ceil(_PATIENCE * self.duration / self.standard_step))
        full = replace(settings, duration=self.duration, sample_rate=self.sample_rate, most_trials=patience, whole=True)
        least, total = math.inf, 0.0
        for _ in range(repeats):
            histories = simulate_batch(self.machine, [self.case] * LANES, full, starts=self.starts)
            spent = sum(history.seconds for history in histories)
            least, total = min(least, spent / LANES), total + spent
            if total > _LONG:
                break
        return histories, least

    def references(self, tell: Callable[[int], None]) -> tuple[list[tuple[float, list[History]]], History]:
        """The two tightest tolerances with which every lane ends well, and a history of the last that did not.

        `tell` is called with the number of tolerances tried after each. Those that fail are given up together after
        :data:`_NO_REFERENCE`.
        """
        found: list[tuple[float, list[History]]] = []
        lost = 0.0
        for tried, rtol in enumerate(REFERENCES, start=1):
            histories, seconds = self.run(Settings(rtol=rtol), repeats=1)
            tell(tried)
            worst = max(histories, key=lambda history: history.status is not Status.OK)
            if worst.status is Status.OK:
                found.append((rtol, histories))
            else:
                lost += seconds * LANES
            if len(found) == 2 or lost > _NO_REFERENCE:
                break
        return found, worst

    def point(
        self, settings: Settings, histories: Sequence[History], seconds: float, reference: FloatArray, chaotic: bool
    ) -> TradeOffPoint:
        """Errors of one setting against the reference's levels (k,)."""
        worst = max(histories, key=lambda history: history.status is not Status.OK)
        if worst.status is not Status.OK:
            return TradeOffPoint(
                settings, worst.step, worst.status, seconds / self.duration, math.nan, math.nan, math.nan
            )
        levels = self.levels(histories, bands=chaotic)
        each = [mean_difference_db(lane, reference) for lane in levels]
        error = mean_difference_db(middle(levels, True), reference) if chaotic else float(np.mean(each))
        repeat = float(np.std(levels[:, find_comparable(reference)], axis=0, ddof=1).mean())
        return TradeOffPoint(settings, histories[0].step, Status.OK, seconds / self.duration, error, max(each), repeat)

    def levels(self, histories: Sequence[History], *, bands: bool = False) -> FloatArray:
        """Levels of the harmonics, or of the one-order bands, after the transient, (lanes, k), dB."""
        estimate = order_band_levels if bands else harmonic_levels
        return np.array([estimate(self._steady(each), self.sample_rate, self.frequency) for each in histories])

    def _steady(self, history: History) -> FloatArray:
        """Acceleration after the transient; of a machine that finds its own speed as if it had turned evenly at it."""
        first = round(self.transient * self.sample_rate)
        steady = slice(first, len(history.band_limited_acceleration))
        signal = history.band_limited_acceleration[steady, self.motion]
        if history.turning is None:
            return signal
        angle = even_angle(history.t[steady], history.turning.angle[steady])
        samples = round(self.sample_rate / self.frequency)
        return resample_by_angle(signal[:, None], angle, samples)[0][:, 0]

    def growth(self, histories: Sequence[History]) -> float:
        """Distance of the runs in the last revolution over that at the start, median."""
        last = round(self.sample_rate / self.frequency)
        paths = np.array([history.displacement[:, self.motion] for history in histories])
        distances = np.abs(paths[1:] - paths[0])
        return float(np.median(distances[:, -last:].max(axis=1) / distances[:, 0]))


def bench_of(machine: Machine, case: Case) -> tuple[Bench, float]:
    """The eight cases, and the processor seconds that equations and kernels took."""
    began = time.process_time()
    reach = reach_of(machine)
    machine, case = reach.machine, reach.case(case)
    if machine.decoupled:
        rule = "runs differ by where the frame is, which its machine does not feel"
        raise SettingsError(f"{machine.name}: decoupled: {rule}: costs are measured of the whole machine")
    if machine.driven_link == machine.frame:
        rule = "runs differ by where the frame is, which its drive prescribes"
        raise SettingsError(f"{machine.name}: drive.link: {machine.frame}: {rule}")
    start = start_of(machine, case)
    short = [
        simulate_batch(machine, [case], Settings(duration=0.01, method=method))[0] for method in ("adaptive", "gill")
    ]
    preparation = time.process_time() - began
    speed, transient, spare = short[0].drive_speed, short[0].transient, 0.0
    frame = model_of(machine, case.fault.joints, ()).frame_indices
    motion = next((motion for motion in (1, 0, 2) if frame[motion] is not None), None)
    if motion is None:
        raise SettingsError(f"{machine.name}: its frame is fixed: it has no vibration to compare")
    if has_known_effort(machine):
        cycle = find_limit_cycle(machine, case, Settings(rtol=_CYCLE))
        assert cycle.end is not None
        start, speed, spare = cycle.end, cycle.drive_speed, _SPARE
        transient = SETTLING_REVOLUTIONS * 2 * math.pi / abs(speed)
    frequency = repeating_frequency(machine, speed)
    away = np.zeros_like(start.z)
    away[frame[motion]] = ROUNDING * (1.0 if MOTIONS[motion] == "theta" else extent_of(machine))
    starts = [replace(start, z=start.z + lane * away) for lane in range(LANES)]
    duration = transient + (REVOLUTIONS + spare) / frequency
    # A slow drive needs few samples a second for its harmonics, and records must fit into memory.
    rate = whole_rate(frequency, min(_SAMPLE_RATE, max(_MOST_SAMPLES / duration, 1000 * frequency)))
    bench = Bench(machine, case, starts, motion, frequency, transient, duration, rate, short[1].step, spare)
    return bench, preparation
