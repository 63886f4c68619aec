"""Ensembles: one case from several starts side by side, until the average of its spectra is known well enough.

Impacts can make a response chaotic. Then no single spectrum is right; the average is, and it comes with its spread.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.decoupling import decouple
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.rates import extent_of
from jointplay.solver.cases.reach import reach_of
from jointplay.solver.cases.start import Start
from jointplay.solver.cases.steps import SETTLING_REVOLUTIONS
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, has_known_effort
from jointplay.solver.simulation.averages import (
    PHASES,
    Average,
    healthy_revolution,
    overall,
    spread_db,
    standard_error_db,
    starts_at,
)
from jointplay.solver.simulation.blocks import BLOCK, MOTIONS, SEEN, Members, check_memory
from jointplay.solver.simulation.steady_turning import find_limit_cycle, samples_of_angle, starts_in
from jointplay.solver.simulation.tradeoff import CHAOTIC_DB

EnsembleKind = Literal["perturbation", "phase"]
#: Blocks that are the least to judge by.
FEWEST = 2


@dataclass(frozen=True)
class Ensemble:
    """What starts, and when to stop.

    Attributes
    ----------
    starts : int
        Members; eight fill the lanes.
    kind : str
        ``perturbation``: all at drive angle 0, their frames a millionth of the machine's extent apart. ``phase``:
        spread evenly over a revolution of the drive.
    converged_db : float or None
        Stop when the averaged levels are known this well: root mean square over the one-order bands of their standard
        error, worst motion of the frame. None for the duration that the settings ask for.
    most_revolutions : float
        Stop there in any case.
    seed : int
        Of the perturbations, or of where in the revolution the first start is.
    healthy_start : bool
        Start in the steady state of the healthy machine instead of as drawn.
    """

    starts: int = 8
    kind: EnsembleKind = "perturbation"
    converged_db: float | None = 0.2
    most_revolutions: float = 400.0
    seed: int = 0
    healthy_start: bool = True

    def __post_init__(self) -> None:
        if not 2 <= self.starts <= 1000:
            raise SettingsError(f"starts: {self.starts}: must be 2 to 1000; a spread needs two")
        if self.kind not in ("perturbation", "phase"):
            raise SettingsError(f"kind: {self.kind}: must be perturbation or phase")
        if self.converged_db is not None and not 0 < self.converged_db < math.inf:
            raise SettingsError(f"converged: {self.converged_db}: must be a finite number of dB greater than 0")
        least = SETTLING_REVOLUTIONS + (FEWEST - 1) * BLOCK + SEEN
        if not least <= self.most_revolutions < math.inf:
            raise SettingsError(f"most revolutions: {self.most_revolutions:g}: must be a number of at least {least}")
        if self.seed < 0:
            raise SettingsError(f"seed: {self.seed}: must be 0 or more")


@dataclass(frozen=True)
class Member:
    """One start: the drive angle (rad) it began at, and how its run ended."""

    angle: float
    status: Status
    message: str


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """Averaged spectra of a case with their spread.

    Attributes
    ----------
    case : Case
    ensemble : Ensemble
    members : tuple of Member
        Those whose status is not ok are in no average.
    status : Status
        ok if two members at least are.
    message : str
        Why it stopped where it was not converged; remarks.
    channels, units : tuple of str
        x, y, theta of the frame and the machine's sensors; m/s2 and rad/s2.
    frequency : (n,) array
        Hz.
    psd, psd_spread_db : (n, c) arrays
        Mean power spectral density, and the standard deviation of the members' levels, dB.
    orders : (k,) array
    level : (k, c) array
        Rms in the one-order band, of the mean power.
    spread_db, error_db : (k, c) arrays
        Standard deviation of the members' levels over the whole time; standard error of the mean level,
        infinite where there is one block only.
    error : float
        What `converged_db` bounds, dB; infinite where it is not known, because no block resembled the one before.
    converged : bool
        Whether it does; of no meaning where nothing was asked.
    revolutions : int
        That each member was averaged over.
    transient : float
        Revolutions dropped from each member's start.
    drive_speed, sample_rate : float
        rad/s, Hz.
    from_healthy : bool
        Whether members began in the healthy machine's steady state.
    seconds : float
        Processor time of the integration.
    from_limit_cycle : bool
        Whether members began in the limit cycle of a machine whose drive is a torque or a force.
    """

    case: Case
    ensemble: Ensemble
    members: tuple[Member, ...]
    status: Status
    message: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    frequency: FloatArray
    psd: FloatArray
    psd_spread_db: FloatArray
    orders: FloatArray
    level: FloatArray
    spread_db: FloatArray
    error_db: FloatArray
    error: float
    converged: bool
    revolutions: int
    transient: float
    drive_speed: float
    sample_rate: float
    from_healthy: bool
    seconds: float
    from_limit_cycle: bool = False

    @property
    def overall_spread(self) -> float:
        """Root mean square of `spread_db` over bands, worst motion of the frame, dB."""
        frame = slice(0, len(MOTIONS))
        return overall(self.spread_db[:, frame], self.level[:, frame] ** 2)


#: Frames start this part of the machine's extent apart.
PERTURBATION = 1e-6
#: Successive blocks that differ by no more than this, dB, are settled where no other number was asked for.
_SETTLED_DB = 0.2


def simulate_ensemble(
    machine: Machine, case: Case | None = None, ensemble: Ensemble | None = None, settings: Settings | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> EnsembleResult:  # fmt: skip
    """Simulate a case from several starts and average its spectra.

    Parameters
    ----------
    machine : Machine
    case : Case, optional
        Without one, joints have the clearance that the machine's file gives them.
    ensemble : Ensemble, optional
    settings : Settings, optional
        Accuracy, method, sample rate; `duration` (or `revolutions`) only where the ensemble asks for no convergence.
    progress : callable, optional
        Called with the revolutions done and those it may take yet.

    Returns
    -------
    EnsembleResult

    Raises
    ------
    SettingsError
        A drive without a constant speed or limit cycle, or a load that does not repeat, so that there is no steady
        state; a frame that cannot move; fewer revolutions allowed than the transient takes; spectra that no memory
        would hold.
    AssemblyError, MachineError
        As :func:`jointplay.solver.simulation.simulate.start_of`.
    """
    case = case or Case(Fault(machine.clearances))
    ensemble, settings = ensemble or Ensemble(), settings or Settings()
    if settings.integrator not in ("adaptive", "rosenbrock", "gill"):
        raise SettingsError(f"method: {settings.integrator}: several starts are run by adaptive, rosenbrock or gill")
    reach = reach_of(machine, settings.whole)
    asked, told = case, reach.remark(case)
    case = reach.case(case)
    machine, remark = decouple(reach.machine, settings)
    if machine.response is not None:
        raise SettingsError(f"{machine.name}: response: several starts are averaged of frames without one")
    if machine.driven_link == machine.frame:
        rule = "starts differ by where the frame is, which its drive prescribes"
        raise SettingsError(f"{machine.name}: drive.link: {machine.frame}: {rule}")
    if not machine.decoupled:
        settings = replace(settings, whole=True)  # negligible or not: members differ by where their frames are
    elif ensemble.kind == "perturbation":
        rule = "starts differ by where the frame is, which a decoupled frame's machine does not feel; take phase"
        raise SettingsError(f"kind: perturbation: {rule}")
    told = "; ".join(filter(None, (told, "" if has_known_effort(machine) else remark)))  # a limit cycle says it
    group = next(groups(machine, [case], settings))
    for _, error in group.failed:
        raise error
    prepared, speed, cycle = group.ready[0], group.ready[0].speed, None
    coordinates = group.model.frame_indices
    if has_known_effort(machine) and any(index is not None for index in coordinates):
        cycle = find_limit_cycle(machine, case, settings)
        speed = cycle.drive_speed
    frequency = repeating_frequency(machine, speed)
    if all(index is None for index in coordinates):
        raise SettingsError(f"{machine.name}: its frame is fixed: it has no spectrum")
    check_memory(machine, ensemble.starts, settings.sample_rate, speed)
    if cycle is not None:
        starts, angles = _starts_in_cycle(machine, case, ensemble, settings, cycle, coordinates)
        remark, from_healthy = cycle.message, False
    else:
        starts, angles, remark = _starts(machine, case, ensemble, settings)
        from_healthy = ensemble.healthy_start and not remark
    settled = from_healthy or cycle is not None
    skipped = float(SETTLING_REVOLUTIONS) if settled else float(round(prepared.transient * frequency))
    fixed = None
    if ensemble.converged_db is None:
        span = settings.revolutions if settings.duration is None else settings.duration * frequency - skipped
        # Less a hair: a span of whole blocks may come out of its units a rounding longer.
        fixed = max(FEWEST, math.ceil(span / BLOCK - 1e-6))
    elif ensemble.most_revolutions < skipped + SEEN:
        least = f"must be at least {skipped + SEEN:g} here, {skipped:g} of them the transient"
        raise SettingsError(f"most revolutions: {ensemble.most_revolutions:g}: {least}")
    by_angle = None if cycle is None else samples_of_angle(cycle)
    members = Members(machine, case, settings, starts, speed, by_angle)
    average = Average(ensemble.converged_db or _SETTLED_DB)
    left_out = skipped
    while True:
        count, reason = _next(average, members, ensemble, fixed, left_out)
        if not count:
            break
        for block in members.blocks(left_out, count):
            average.take(block)
        left_out = 0.0
        if progress is not None:
            progress(members.revolutions, ensemble.most_revolutions)
    if average.seen and not average.finish():
        reason = reason or "one block did not resemble the one before: the transient may not be over"
    ran = ""
    if fixed is not None and settings.duration is not None:
        seconds = members.revolutions / frequency
        ran = f"ran {seconds:.3g} s for the {settings.duration:g} s asked for: blocks of {BLOCK} revolutions are whole"
    message = "; ".join(filter(None, (told, remark, reason, ran)))
    found = _result(asked, ensemble, members, average, angles, message, skipped, settings, from_healthy)
    if cycle is None or found.status is not Status.OK:
        return found
    chaos = "" if ensemble.kind == "phase" else _say_chaos(found.overall_spread)
    return replace(found, from_limit_cycle=True, message="; ".join(filter(None, (found.message, chaos))))


def _say_chaos(spread: float) -> str:
    """Whether members that started a little apart end in the same spectrum."""
    told = "the response is chaotic" if spread > CHAOTIC_DB else "the response repeats"
    return f"members that start {PERTURBATION:g} of the machine apart differ by {spread:.2g} dB: {told}"


def _next(average: Average, members: Members, ensemble: Ensemble, fixed: int | None, skipped: float) -> tuple[int, str]:
    """How many blocks to run next, or 0 and the reason if it is not that all is done.

    The standard error falls with the square root of the blocks, which says how many are missing; of these no more are
    run than there are already before looking again.
    """
    if len(members.alive) < 2:
        return 0, f"{len(members.alive)} of {ensemble.starts} members did not fail"
    if fixed is not None:
        return min(fixed - average.seen, members.at_once(skipped)), ""
    assert ensemble.converged_db is not None
    error = average.error()
    if error <= ensemble.converged_db:
        return 0, ""
    room = math.floor((ensemble.most_revolutions - members.revolutions - skipped - SEEN) / BLOCK) + 1
    if room < 1:
        known = "" if error == math.inf else f": the mean levels are known to {error:.2g} dB"
        return 0, (
            f"not converged to {ensemble.converged_db:g} dB within the {ensemble.most_revolutions:g} revolutions that "
            f"were allowed{known}"
        )
    if average.blocks < FEWEST:
        missing = FEWEST if not average.seen else 1
    else:
        missing = math.ceil(average.blocks * ((error / ensemble.converged_db) ** 2 - 1))
        missing = max(1, min(missing, average.blocks))
    return min(missing, room, members.at_once(skipped)), ""


def _starts(
    machine: Machine, case: Case, ensemble: Ensemble, settings: Settings
) -> tuple[list[Start], list[float], str]:
    """Where the members start, the drive angles (rad) there, and why it is not the healthy machine's steady state."""
    generator = np.random.default_rng(ensemble.seed)
    count = ensemble.starts
    displacement, velocity = (np.zeros((count, 3 + len(machine.modes))) for _ in range(2))
    phases = [0] * count
    if ensemble.kind == "phase":
        first = int(generator.integers(PHASES))
        phases = [(first + i * PHASES // count) % PHASES for i in range(count)]
    else:
        extent = extent_of(machine)
        displacement[:, :3] += generator.normal(size=(count, 3)) * PERTURBATION * np.array([extent, extent, 1.0])
    remark = ""
    if ensemble.healthy_start:
        healthy = healthy_revolution(machine, case, settings)
        if healthy.status is Status.OK:
            displacement[:, :3] += healthy.displacement[phases]
            velocity[:, :3] += healthy.velocity[phases]
            if healthy.modes is not None:
                displacement[:, 3:] += healthy.modes.displacement[phases]
                velocity[:, 3:] += healthy.modes.velocity[phases]
        else:
            remark = f"started as drawn: the healthy machine has no steady state ({healthy.status}: {healthy.message})"
    angles = [2 * math.pi * phase / PHASES for phase in phases]
    return starts_at(machine, case, settings, phases, displacement, velocity), angles, remark


def _starts_in_cycle(
    machine: Machine, case: Case, ensemble: Ensemble, settings: Settings, cycle: History,
    coordinates: Sequence[int | None],
) -> tuple[list[Start], list[float]]:  # fmt: skip
    """Where the members start in a limit cycle, and their drive angles (rad) from there on."""
    generator, count = np.random.default_rng(ensemble.seed), ensemble.starts
    phases, displacement = [0.0] * count, np.zeros((count, 3))
    if ensemble.kind == "phase":
        first = float(generator.random()) / count
        phases = [first + i / count for i in range(count)]
    else:
        extent = extent_of(machine)
        displacement += generator.normal(size=(count, 3)) * PERTURBATION * np.array([extent, extent, 1.0])
    starts = starts_in(machine, case, settings, cycle, phases, displacement, coordinates)
    return starts, [2 * math.pi * phase for phase in phases]


def _result(
    case: Case, ensemble: Ensemble, members: Members, average: Average, angles: list[float], message: str,
    transient: float, settings: Settings, from_healthy: bool,
) -> EnsembleResult:  # fmt: skip
    ended = []
    for i, angle in enumerate(angles):
        failed = members.failures.get(i)
        ended.append(Member(angle, failed.status, failed.message) if failed else Member(angle, Status.OK, ""))
    width = len(members.channels)
    psd = level = spread = error = psd_spread = np.zeros((0, width))
    enough = len(members.alive) >= 2 and average.blocks > 0
    if enough:
        bands, densities = average.bands, average.psd
        psd, psd_spread = densities.mean(axis=0), spread_db(densities)
        level, spread = np.sqrt(bands.mean(axis=(0, 1))), spread_db(bands.mean(axis=1))
        error = standard_error_db(bands) if average.blocks > 1 else np.full_like(level, math.inf)
    status = Status.OK if enough else next(member.status for member in ended if member.status is not Status.OK)
    known = average.error() if enough else math.inf
    return EnsembleResult(
        case, ensemble, tuple(ended), status, message, members.channels, members.units,
        members.frequency if enough else np.zeros(0), psd, psd_spread, members.orders if enough else np.zeros(0), level,
        spread, error, known, known <= (ensemble.converged_db or 0.0), average.blocks * BLOCK,
        transient + average.dropped * BLOCK, members.speed, settings.sample_rate, from_healthy, members.seconds,
    )  # fmt: skip
