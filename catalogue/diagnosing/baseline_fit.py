"""Numbers of a machine, and gains of its sensors, fitted to recordings of it in order, at the speed of each.

Damped Gauss-Newton steps against simulations of the machine without play.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.baseline_levels import GAIN_SCATTER, LevelStatistics, OrderLevels
from jointplay.catalogue.diagnosing.healthy_machine import STEP, HealthyMachine, Motion
from jointplay.catalogue.errors import DiagnosisError
from jointplay.solver.arrays import BoolArray, FloatArray

#: Gain in squared distance after which there is no step more, and how many of the best starts are followed.
SETTLED = 0.05
STARTS = 2
#: Where to begin (ln of the factors on each stiffness), and what a level counts at most there [standard deviations].
START_STIFFNESSES = (-0.45, -0.22, 0.0, 0.22, 0.45)
FAR_OFF = 4.0


@dataclass(frozen=True, eq=False)
class BaselineFit:
    """What was fitted, and how well.

    Parameters
    ----------
    found : (k + s,) array
        Logarithms of the factors on k numbers and of s gains.
    scatter : (k + s,) array
        Their standard deviations.
    p_before, p_after : float
        Without and with them, see :meth:`LevelStatistics.p_value`.
    """

    found: FloatArray
    scatter: FloatArray
    p_before: float
    p_after: float


@dataclass(frozen=True, eq=False)
class _InOrder:
    """One recording of the machine in order: its levels, the machine at its speed, and what is compared of both.

    What play adds to the levels of the machine without it is kept while its numbers change.
    """

    levels: OrderLevels
    model: HealthyMachine
    known: LevelStatistics
    nominal: FloatArray
    used: BoolArray
    noise: FloatArray
    weight: FloatArray

    @classmethod
    def of(cls, levels: OrderLevels, model: HealthyMachine, known: LevelStatistics, nominal: FloatArray) -> _InOrder:
        used = known.usable(nominal)
        fewest = len(model.quantities) + levels.sensors
        if used.sum() < fewest:
            raise DiagnosisError(
                f"baseline {levels.name}: only {int(used.sum())} levels stand out of noise and scatter"
            )
        noise = known.covariance(used)
        return cls(levels, model, known, nominal, used, noise, np.asarray(np.linalg.inv(noise), dtype=np.float64))

    def left(self, predicted: FloatArray) -> FloatArray:
        """What levels (..., m) of the machine without play leave of the measured ones, of those used, dB."""
        return np.asarray((self.levels.measured - self.known.mean + self.nominal - predicted)[..., self.used])

    def p_value(self, left: FloatArray, more: FloatArray) -> float:
        """Share of machines in order that leave more."""
        return self.known.p_value(float(left @ self.weight @ left), self.used, more)


def fit_numbers(recordings: Sequence[tuple[OrderLevels, HealthyMachine, LevelStatistics]], steps: int) -> BaselineFit:
    """Fit numbers of the machine, and gains, to the levels of recordings of it.

    Parameters
    ----------
    recordings : sequence of (OrderLevels, HealthyMachine, LevelStatistics)
        By the same sensors; the machine at the speed of each, and machines in the condition it was in.
    steps : int
        At most, from each of two starts.

    Returns
    -------
    BaselineFit
        P-values of several are the least, by Bonferroni's bound.

    Raises
    ------
    DiagnosisError
        Too few levels stand out of the noise, or a case cannot be simulated.
    """
    first, model, _ = recordings[0]
    sensors = first.sensors
    believed = np.array([*(quantity.scatter for quantity in model.quantities), *([GAIN_SCATTER] * sensors)])
    points = _starts(model)
    parts, far = [], np.zeros(len(points))
    for levels, machine, known in recordings:
        nearby = levels.of_motion(machine.powers(points))
        part = _InOrder.of(levels, machine, known, nearby[0])
        misfit = part.left(nearby) / np.sqrt(np.diag(part.noise))
        # Levels jump where a number moves a resonance across an order: single ones must not decide where to begin.
        far += np.minimum(np.square(misfit), FAR_OFF**2).sum(axis=1)
        parts.append(part)
    starts = [np.concatenate([points[index], np.zeros(sensors)]) for index in np.argsort(far)[:STARTS]]
    problem = _FitProblem(tuple(parts), believed)
    best = min((problem.solve(start, steps) for start in starts), key=problem.cost)
    found, _, residuals = best
    jacobians = problem.jacobians(best)
    normal = sum(each.T @ part.weight @ each for each, part in zip(jacobians, parts, strict=True))
    before = [part.p_value(part.left(part.nominal), np.zeros_like(part.noise)) for part in parts]
    after = [
        part.p_value(left, (each * believed**2) @ each.T)
        for part, left, each in zip(parts, residuals, jacobians, strict=True)
    ]
    return BaselineFit(
        found=found,
        scatter=np.sqrt(np.diag(np.linalg.inv(normal + np.diag(believed**-2)))),
        p_before=min(1.0, len(parts) * min(before)),
        p_after=min(1.0, len(parts) * min(after)),
    )


def _starts(model: HealthyMachine) -> list[FloatArray]:
    """The numbers of the file, then other stiffnesses: a resonance next to an order leaves several minima."""
    points = [np.zeros(len(model.quantities))]
    stiff = [index for index, quantity in enumerate(model.quantities) if "stiffness" in quantity.name]
    for factors in itertools.product(START_STIFFNESSES, repeat=len(stiff)):
        if any(factors):
            point = np.zeros(len(model.quantities))
            point[stiff] = factors
            points.append(point)
    return points


_Point = tuple[FloatArray, tuple[Motion, ...], tuple[FloatArray, ...]]
"""Numbers and gains (ln), the motion there at each recording's speed, and what it leaves of its levels, dB."""


@dataclass(frozen=True, eq=False)
class _FitProblem:
    """Least squares with what was believed before (Levenberg 1944, Marquardt 1963)."""

    recordings: tuple[_InOrder, ...]
    believed: FloatArray

    def cost(self, point: _Point) -> float:
        """Squared distance of the levels, and of the numbers from what was believed."""
        found, _, residuals = point
        far = sum(left @ part.weight @ left for left, part in zip(residuals, self.recordings, strict=True))
        return float(far + np.square(found / self.believed).sum())

    def at(self, found: FloatArray) -> _Point:
        """Simulate the machine with these numbers."""
        count = len(self.recordings[0].model.quantities)
        motions = tuple(part.model.at(found[:count]) for part in self.recordings)
        residuals = tuple(
            part.left(part.levels.of_motion(motion.power, np.exp(found[count:])))
            for part, motion in zip(self.recordings, motions, strict=True)
        )
        return found, motions, residuals

    def jacobians(self, point: _Point) -> list[FloatArray]:
        """Derivatives (u, k + s) of each recording's levels that are used."""
        found, motions, _ = point
        gains = found[len(self.recordings[0].model.quantities) :]
        return [
            _jacobian(part.levels, motion, gains)[part.used]
            for part, motion in zip(self.recordings, motions, strict=True)
        ]

    def solve(self, start: FloatArray, steps: int) -> _Point:
        """Go downhill from here."""
        here, damping = self.at(start), 0.0
        for _ in range(steps):
            found, _, residuals = here
            normal, right = np.diag(self.believed**-2), -found / self.believed**2
            for part, jacobian, left in zip(self.recordings, self.jacobians(here), residuals, strict=True):
                normal = normal + jacobian.T @ part.weight @ jacobian
                right = right + jacobian.T @ part.weight @ left
            change = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)
            # What was believed to be the usual error is as far as derivatives are to be trusted.
            there = self.at(found + np.clip(change, -self.believed, self.believed))
            gained = self.cost(here) - self.cost(there)
            if gained > 0.0:
                here, damping = there, 0.1 * damping
            else:
                damping = max(10.0 * damping, 0.3)
            if 0.0 <= gained < SETTLED:
                break
        return here


def _jacobian(levels: OrderLevels, motion: Motion, log_gains: FloatArray) -> FloatArray:
    """Derivatives (m, k + s) of the levels by the numbers and by the gains, dB for a unit of their logarithms."""
    gains = np.exp(log_gains)
    here = levels.of_motion(motion.power, gains)
    numbers = (levels.of_motion(motion.shifted, gains) - here) / STEP
    small = 1e-4
    factors = gains * np.exp(small * np.eye(len(gains)))
    by_gain = np.array([(levels.of_motion(motion.power, row) - here) / small for row in factors])
    return np.vstack([numbers, by_gain]).T
