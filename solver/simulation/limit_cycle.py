"""Machines that no motion is prescribed to, to their limit cycle: they run up until the mean speed has come to rest.

The run-up is simulated in stages, all cases of a model side by side, recorded coarsely and of the driver alone. What a
history is to show starts where the last stage ended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Settings, Status
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.cases.steps import BETWEEN_IMPACTS, SETTLING_REVOLUTIONS, STEP_RULES, response
from jointplay.solver.cases.turning import Turning, cycles, turning_of, why_unsteady
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.runs import Run

#: The longest run-up, s, and the most revolutions of one.
LONGEST, MOST_REVOLUTIONS = 120.0, 3000
#: The first stage lasts so long at least, s, and the others so many times what went before.
_FIRST, _FURTHER = 1.0, 0.5
#: A case that starts near its limit cycle is judged after so many revolutions, but for this first part of them.
_NEAR_REVOLUTIONS, _NEAR_PART = 16, 1 / 3
#: A mean speed that changes by more than this part of itself was not that of a limit cycle.
_LEFT = 0.01
#: Sample rate of the run-up, Hz: the driver's angle is a coordinate and needs few samples.
_COARSE = 2000.0


class Driver:
    """What the drive of a machine moves, as a number of the motion.

    Parameters
    ----------
    model : Model
        Of a machine with a torque or a force.

    Attributes
    ----------
    rotates : bool
    coordinates : tuple of int
        That its position follows from.
    """

    def __init__(self, model: Model) -> None:
        joint = model.machine.joints[model.machine.driven_joint]
        self.rotates = isinstance(joint, TurningJoint)
        position = model.kinematics.position(joint)
        self.coordinates = tuple(np.flatnonzero(ca.which_depends(position, model.z, 1, False)).tolist())
        self._function, self._size = model.function("driver", position), model.size
        self._gradient = model.function("driver_gradient", ca.jacobian(position, model.z))
        self._linear = not any(ca.which_depends(position, model.z, 2, False))

    def gradient(self, z: FloatArray, p: Sequence[float]) -> FloatArray:
        """Derivatives (n,) of its position by coordinates z (n,)."""
        return np.asarray(evaluate(self._gradient, 0.0, z, np.zeros(self._size), p)[0][0])

    def at(self, z: FloatArray, p: Sequence[float]) -> float:
        """Position at coordinates z (n,)."""
        return float(evaluate(self._function, 0.0, z, np.zeros(self._size), p)[0][0, 0])

    def position(self, recorded: Sequence[int], motion: FloatArray, p: Sequence[float]) -> FloatArray:
        """Position (n,) of the driver, rad or m, where the coordinates `recorded` were `motion` (r, n)."""
        z = np.zeros((self._size, motion.shape[1]))
        for i in self.coordinates:
            z[i] = motion[recorded.index(i)]
        if self._linear:  # a fiftieth of the time that symbols take, which is a third of a case's
            at_rest = np.zeros(self._size)
            return np.asarray(self.at(at_rest, p) + self.gradient(at_rest, p) @ z)
        return np.asarray(self._function(0.0, z, 0.0, p).full()[0])

    def ends(self, recorded: Sequence[int], p: Sequence[float], motion: FloatArray) -> tuple[FloatArray, float]:
        """Ends of the last revolutions that `motion` (r, n) has, in samples, and the angle there.

        Of a driver that rotates they are where it last was in the same direction as at the last sample; else as of
        :func:`jointplay.solver.cases.turning.cycles`. The angle is even within each revolution, and positive.
        """
        position = self.position(recorded, motion, p)
        samples = np.arange(len(position), dtype=np.float64)
        whole, _ = cycles(samples, position, self.rotates)
        if not self.rotates:
            return whole, 0.0
        ends, _ = cycles(samples, position - position[-1], rotates=True)
        if not len(whole) or len(ends) < 2:
            return ends, 0.0
        return ends, 2 * math.pi * float((ends[-1] - whole[-1]) / (ends[-1] - ends[-2]))


@dataclass
class _RunUp:
    """A case on its way: where it stands, and the driver so far."""

    drawn: Prepared
    now: Prepared
    near: bool
    seconds: float = 0.0
    t: list[FloatArray] = field(default_factory=list)
    position: list[FloatArray] = field(default_factory=list)

    def add(self, run: Run, driver: Driver, recorded: Sequence[int]) -> None:
        """Take the run of a stage, to its end."""
        assert run.z is not None
        count = run.z.shape[1]
        self.t.append(run.case.begin + np.arange(count) / run.case.sample_rate)
        self.position.append(driver.position(recorded, run.z, run.case.vector))
        self.seconds += run.seconds
        n = self.now.z.size
        z, v, memory = np.split(run.final[1:], [n, 2 * n])
        self.now = replace(self.now, z=z, v=v, memory=memory, begin=float(run.final[0]))

    def sections(self, rotates: bool) -> FloatArray:
        """Ends of revolutions in the later half of the run-up, or later part of a short one, s."""
        found, _ = cycles(np.concatenate(self.t), np.concatenate(self.position), rotates)
        return found[found >= (_NEAR_PART if self.near else 0.5) * self.now.begin]


def reach_limit_cycle(
    machine: Machine, model: Model, varying: tuple[str, ...], driver: Driver, recorded: Sequence[int],
    ready: Sequence[Prepared], settings: Settings, runs: Callable[..., Iterator[Run]],
    watched: Callable[[Prepared], Prepared] = lambda case: case,
) -> Iterator[Prepared | Run]:  # fmt: skip
    """Let cases of a machine with a known effort run up; those that reach a limit cycle start there.

    A case that starts near its limit cycle is recorded on its way, and its run is what comes. The others start as
    drawn, and the remark says why; where only a settled motion is asked for, they are next to nothing long. A case that
    fails on its way is given so long that it fails again, recorded.

    Parameters
    ----------
    machine : Machine
    model : Model
        Of the cases.
    varying : tuple of str
        As :func:`jointplay.solver.cases.preparation.model_of`.
    driver : Driver
    recorded : sequence of int
        Coordinates to record, the driver's among them.
    ready : sequence of Prepared
        As drawn; those with a speed start near their limit cycle, see
        :mod:`jointplay.solver.simulation.turning_starts`.
    settings : Settings
    runs : callable
        As for :func:`jointplay.solver.simulation.simulate.settle`.
    watched : callable
        Has a case that starts near its limit cycle looked whether it repeats, where that is wanted and it can.

    Yields
    ------
    Prepared or Run
        A run is to be used before the next one is asked for.
    """
    for near in (True, False):
        waiting = {case.index: _RunUp(case, case, near) for case in ready if (case.speed != 0.0) == near}
        first = near
        while waiting:
            rate = settings.sample_rate if first else min(_COARSE, settings.sample_rate)
            asked = replace(settings, sample_rate=rate, motion=True, links=False, repeating=False)
            for up in waiting.values():
                up.now = replace(up.now, duration=_stage(up, rate, settings), sample_rate=rate)
            stages = [watched(up.now) if first else up.now for up in waiting.values()]
            for run in runs(machine, model, varying, stages, recorded, asked):
                up = waiting[run.case.index]
                if run.period:
                    reached: Prepared | Run | None = replace(run, case=replace(run.case, unsteady=""))
                else:
                    up.add(run, driver, recorded)
                    reached = _next(up, run, driver, settings, first)
                if reached is not None:
                    yield reached
                    del waiting[run.case.index]
            first = False


def _stage(up: _RunUp, rate: float, settings: Settings) -> float:
    """How long a case runs until it is judged, or judged again, s."""
    first = _FIRST
    if up.near:
        revolutions = max(_NEAR_REVOLUTIONS, settings.revolutions / (1 - _NEAR_PART))
        first = revolutions * 2 * math.pi / abs(up.drawn.speed)
    length = max(first, up.drawn.transient, _FURTHER * up.now.begin)
    return min(length, max(LONGEST - up.now.begin, 1 / rate))


def _next(up: _RunUp, run: Run, driver: Driver, settings: Settings, recorded: bool) -> Prepared | Run | None:
    """The case as it is to be recorded, or its run if it was, once that is known."""
    spent = up.drawn.spent + up.seconds
    if run.status is not Status.OK:
        return replace(up.drawn, duration=max(up.drawn.duration, up.now.begin + up.now.duration), spent=spent)
    sections = up.sections(driver.rotates)
    why = why_unsteady(sections)
    if not why:
        last = sections[-(len(sections) // 3) :]
        speed = 2 * math.pi * (len(last) - 1) / (last[-1] - last[0])
        backwards = driver.rotates and up.position[-1][-1] < up.position[0][0]
        case = turning_at(replace(up.now, sample_rate=settings.sample_rate), -speed if backwards else speed, settings)
        if recorded:
            shown = min(settings.revolutions * 2 * math.pi / speed, run.case.duration)
            return replace(
                run, case=replace(run.case, speed=case.speed, unsteady="", transient=run.case.duration - shown)
            )
        return replace(_started(up, case, settings), spent=spent)
    if up.now.begin < LONGEST and len(sections) < MOST_REVOLUTIONS:
        return None
    duration = 1 / settings.sample_rate if settings.settled else up.drawn.duration
    return replace(up.drawn, unsteady=f"{why}, after {up.now.begin:.3g} s", duration=duration, spent=spent)


def _started(up: _RunUp, case: Prepared, settings: Settings) -> Prepared:
    """A case in its limit cycle, but for what the suspension does yet."""
    revolution = 2 * math.pi / abs(case.speed)
    swinging = 0.0 if up.near else up.drawn.transient
    revolutions = max(SETTLING_REVOLUTIONS, math.ceil(swinging / revolution - 1e-9))
    return replace(
        case, unsteady="", before=case.begin, transient=revolutions * revolution,
        duration=(revolutions + settings.revolutions) * revolution,
    )  # fmt: skip


def turning_at(case: Prepared, speed: float, settings: Settings) -> Prepared:
    """A case with steps for a driver that turns at a speed, rad/s."""
    revolution, rule = 2 * math.pi / abs(speed), STEP_RULES[case.accuracy]
    return replace(
        case, speed=speed, pace=min(case.pace, 1 / abs(speed)), response=response(case.suspension, speed),
        smooth_step=min(case.smooth_step, revolution / BETWEEN_IMPACTS.per_revolution),
        longest_step=settings.step or min(case.longest_step, revolution / rule.per_revolution),
    )  # fmt: skip


def turning_in(
    run: Run, driver: Driver, recorded: Sequence[int], samples: slice, t: FloatArray, displacement: FloatArray,
    velocity: FloatArray,
) -> Turning:  # fmt: skip
    """How the driver turned in samples of a run, at `t` (n,), where the frame moved as given, (n, 3) each."""
    case = run.case
    if run.ends is not None:
        way, speeds = math.copysign(1.0, case.speed), 2 * math.pi / np.diff(run.ends)
        speed = way * 2 * math.pi * len(speeds) / (run.ends[-1] - run.ends[0])
        angle = way * (run.angle + abs(speed) * (t - t[0]))
        found = Turning(angle, speed, float(np.std(speeds, ddof=1) / abs(speed)), len(speeds), run.period, math.inf, "")
    else:
        assert run.z is not None
        position = driver.position(recorded, run.z[:, samples], case.vector)
        transient, frame = case.begin + case.transient, np.hstack([displacement, velocity])
        found = turning_of(t, position, driver.rotates, frame, transient, case.unsteady)
    if found.is_steady and not run.period and case.speed and abs(found.speed / case.speed - 1) > _LEFT:
        now, then = (abs(speed) * 30 / math.pi for speed in (found.speed, case.speed))
        return replace(found, reason=f"{then:.4g} rpm were steady, and became {now:.4g} rpm")
    return found
