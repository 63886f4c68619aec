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

    def gradient(self, z: FloatArray, p: Sequence[float]) -> FloatArray:
        """Derivatives (n,) of its position by coordinates z (n,)."""
        return np.asarray(evaluate(self._gradient, 0.0, z, np.zeros(self._size), p)[0][0])

    def at(self, z: FloatArray, p: Sequence[float]) -> float:
        """Position at coordinates z (n,)."""
        return float(evaluate(self._function, 0.0, z, np.zeros(self._size), p)[0][0, 0])

    def position(self, run: Run, recorded: Sequence[int], samples: slice = slice(None)) -> FloatArray:
        """Position (n,) of the driver at samples of a run, rad or m."""
        assert run.z is not None
        z = np.zeros((self._size, run.z[:, samples].shape[1]))
        for i in self.coordinates:
            z[i] = run.z[recorded.index(i), samples]
        p = np.repeat(np.array(run.case.vector).reshape(-1, 1), z.shape[1], axis=1)
        return np.asarray(self._function(0.0, z, np.zeros_like(z), p).full()[0])


@dataclass
class _RunUp:
    """A case on its way: where it stands, and the driver so far."""

    drawn: Prepared
    now: Prepared
    near: bool
    seconds: float = 0.0
    t: list[FloatArray] = field(default_factory=list)
    position: list[FloatArray] = field(default_factory=list)

    def add(self, run: Run, driver: Driver, recorded: Sequence[int], rate: float) -> None:
        """Take the run of a stage, to its end."""
        assert run.z is not None
        count = run.z.shape[1]
        self.t.append(run.case.begin + np.arange(count) / rate)
        self.position.append(driver.position(run, recorded))
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
) -> list[Prepared]:  # fmt: skip
    """Let cases of a machine with a known effort run up; those that reach a limit cycle start there.

    The others start as drawn, and the remark says why; where only a settled motion is asked for, they are next to
    nothing long. A case that fails on its way is given so long that it fails again, recorded.

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
    """
    rate = min(_COARSE, settings.sample_rate)
    coarse = replace(settings, sample_rate=rate, motion=True, links=False)
    waiting = {case.index: _RunUp(case, case, near=case.speed != 0.0) for case in ready}
    ended: list[Prepared] = []
    while waiting:
        for up in waiting.values():
            first = _NEAR_REVOLUTIONS * 2 * math.pi / abs(up.drawn.speed) if up.near else _FIRST
            length = max(first, up.drawn.transient, _FURTHER * up.now.begin)
            duration = min(length, max(LONGEST - up.now.begin, 1 / rate))
            up.now = replace(up.now, duration=duration, sample_rate=rate)
        for run in runs(machine, model, varying, [up.now for up in waiting.values()], recorded, coarse):
            up = waiting[run.case.index]
            up.add(run, driver, recorded, rate)
            case = _next(up, run, driver, settings)
            if case is not None:
                ended.append(replace(case, spent=up.drawn.spent + up.seconds))
                del waiting[run.case.index]
    return ended


def _next(up: _RunUp, run: Run, driver: Driver, settings: Settings) -> Prepared | None:
    """The case as it is to be recorded, once that is known."""
    if run.status is not Status.OK:
        return replace(up.drawn, duration=max(up.drawn.duration, up.now.begin + up.now.duration))
    sections = up.sections(driver.rotates)
    why = why_unsteady(sections)
    if not why:
        last = sections[-(len(sections) // 3) :]
        speed = 2 * math.pi * (len(last) - 1) / (last[-1] - last[0])
        backwards = driver.rotates and up.position[-1][-1] < up.position[0][0]
        return _started(up, -speed if backwards else speed, settings)
    if up.now.begin < LONGEST and len(sections) < MOST_REVOLUTIONS:
        return None
    duration = 1 / settings.sample_rate if settings.settled else up.drawn.duration
    return replace(up.drawn, unsteady=f"{why}, after {up.now.begin:.3g} s", duration=duration)


def _started(up: _RunUp, speed: float, settings: Settings) -> Prepared:
    """A case in its limit cycle, but for what the suspension does yet."""
    case = turning_at(replace(up.now, sample_rate=settings.sample_rate), speed, settings)
    revolution = 2 * math.pi / abs(speed)
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
    transient, frame = case.begin + case.transient, np.hstack([displacement, velocity])
    found = turning_of(t, driver.position(run, recorded, samples), driver.rotates, frame, transient, case.unsteady)
    if found.is_steady and case.speed and abs(found.speed / case.speed - 1) > _LEFT:
        now, then = (abs(speed) * 30 / math.pi for speed in (found.speed, case.speed))
        return replace(found, reason=f"{then:.4g} rpm were steady, and became {now:.4g} rpm")
    return found
