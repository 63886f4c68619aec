"""What accuracy costs: harmonic error against processor time for one machine, on this computer.

Every setting runs in eight full lanes that start a rounding apart. So one batch gives the cost, the error, how well the
setting repeats itself, and whether the machine's response repeats at all.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.compiler.native import processor
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.workbench import MOTIONS, REFERENCES, TradeOffPoint, bench_of, middle
from jointplay.solver.spectra.harmonics import find_comparable, mean_difference_db

#: A response is chaotic if runs of the reference differ by more than this, dB a harmonic, from starts a rounding apart.
CHAOTIC_DB = 0.1
#: Finer steps of ``gill`` are not measured once all lanes took so long, s.
_TOO_LONG = 5.0
#: Costs that differ by less than this part are the same: processor times scatter so much.
_SAME_COST = 0.1


@dataclass(frozen=True)
class Recommendation:
    """The cheapest setting that is shown to meet what was asked (of equal cost the best), or why there is none."""

    point: TradeOffPoint | None
    reason: str


@dataclass(frozen=True)
class TradeOff:
    """Work and precision of one case.

    Attributes
    ----------
    case : Case
    frequency : float
        Of the drive, Hz.
    motion : str
        Motion of the frame that was compared: y, or the first there is of x and theta.
    compared : int
        Harmonics (or one-order bands) that stand out far enough to be compared.
    chaotic : bool
        Whether runs a rounding apart end in different spectra; errors are then those of one-order band levels.
    growth : float
        Distance of such runs in the last revolution over that at the start, median.
    difference_db : float
        How far their harmonics differ, dB.
    spread_db : float
        Of a chaotic case: standard deviation of the band levels of a single run, mean over bands, dB; else 0.
    reference_rtol, check_rtol : float
        Tolerance of the reference and of the runs that it is checked against.
    reference_error_db : float
        How far these two are apart, dB: nothing below it can be claimed.
    points : tuple of Point
        Each method from coarse to fine.
    duration, transient : float
        s of a run; what is dropped of it.
    computer : str
    preparation : float
        Processor seconds for equations and kernels of both methods, not part of any cost.
    """

    case: Case
    frequency: float
    motion: str
    compared: int
    chaotic: bool
    growth: float
    difference_db: float
    spread_db: float
    reference_rtol: float
    check_rtol: float
    reference_error_db: float
    points: tuple[TradeOffPoint, ...]
    duration: float
    transient: float
    computer: str
    preparation: float

    def pays(self, point: TradeOffPoint) -> bool:
        """Whether a finer setting than this could be told from it: not once its error is below the spread."""
        return not (self.chaotic and point.status is Status.OK and point.error_db <= self.spread_db)

    def recommend(self, wanted_db: float) -> Recommendation:
        """The cheapest setting that meets `wanted_db`, and that no finer setting of its method fails to meet.

        What a coarse setting hits by luck does not count. To a measured error belongs that of the reference.
        """
        limit = max(wanted_db, self.spread_db)
        margin = 0.0 if self.chaotic else self.reference_error_db
        if margin >= limit:
            return Recommendation(None, f"the reference itself is known to {margin:.2g} dB only")
        found: list[TradeOffPoint] = []
        for method in ("adaptive", "gill"):
            for point in reversed([p for p in self.points if p.settings.integrator == method]):
                error = point.error_db if self.chaotic else point.worst_db
                if point.status is not Status.OK or error + margin > limit:
                    break
                found.append(point)
        if not found:
            return Recommendation(None, f"none of the settings measured meets {limit:.2g} dB")
        cheapest = min(point.seconds for point in found)
        best = min(
            (point for point in found if point.seconds <= (1 + _SAME_COST) * cheapest), key=lambda point: point.error_db
        )
        if limit > wanted_db:
            reason = (
                f"single runs scatter by {self.spread_db:.2g} dB: no setting brings one closer, more revolutions would"
            )
        else:
            reason = f"the cheapest that stays within {wanted_db:g} dB"
        return Recommendation(best, reason)


def computer() -> str:
    """What the processor times belong to."""
    return f"{platform.machine()}, {processor()[0]}, {os.cpu_count()} cores"


def measure(
    machine: Machine,
    case: Case | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    rungs: Sequence[Settings] | None = None,
) -> TradeOff | History:
    """Measure every setting on one case.

    Parameters
    ----------
    machine : Machine
    case : Case, optional
        Without one, joints have the clearance that the machine's file gives them.
    progress : callable, optional
        Called with settings done and settings in all, those that may serve as the reference among them.
    rungs : sequence of Settings, optional
        What to measure instead of the usual tolerances and steps, each method from coarse to fine; ``adaptive`` by its
        `rtol`. Durations and rates are not looked at.

    Returns
    -------
    TradeOff, or History
        The history of the reference where that did not end well; its status and message say why.

    Raises
    ------
    SettingsError
        A frame that cannot move, or a drive without a constant speed or limit cycle: then there are no harmonics.
    AssemblyError, MachineError
        As :func:`jointplay.solver.simulation.simulate.simulate_batch`.
    """
    case = case or Case(Fault(machine.clearances))
    bench, preparation = bench_of(machine, case)
    rungs = bench.rungs() if rungs is None else rungs
    total = len(rungs) + len(REFERENCES)
    tell = progress or (lambda done, total: None)
    tell(0, total)
    references, failed = bench.references(lambda tried: tell(tried, total))
    if len(references) < 2:
        return failed
    (reference_rtol, finest), (check_rtol, check) = references
    lines = bench.levels(finest)
    difference = mean_difference_db(lines[1:], lines[0])
    chaotic = difference > CHAOTIC_DB
    levels, others = (bench.levels(histories, bands=chaotic) for histories in (finest, check))
    reference = middle(levels, chaotic)
    kept = find_comparable(reference)
    points: list[TradeOffPoint] = []
    for done, settings in enumerate(rungs, start=len(REFERENCES) + 1):
        histories, seconds = bench.run(settings)
        point = bench.point(settings, histories, seconds, reference, chaotic)
        if points and settings.integrator == "gill" and points[-1].step == point.step:
            points.pop()  # steps divide the sampling interval: two settings may round to one
        points.append(point)
        tell(done, total)
        if settings.integrator == "gill" and seconds * LANES > _TOO_LONG:
            break
    return TradeOff(
        case, bench.frequency, MOTIONS[bench.motion], int(kept.sum()), chaotic, bench.growth(finest), difference,
        float(np.std(levels[:, kept], axis=0, ddof=1).mean()) if chaotic else 0.0, reference_rtol, check_rtol,
        mean_difference_db(middle(others, chaotic), reference), tuple(points), bench.duration, bench.transient,
        computer(), preparation,
    )  # fmt: skip
