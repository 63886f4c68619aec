"""Numbers of a machine and gains of sensors by least squares, with what was believed of them before."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.baseline_levels import LevelStatistics, OrderLevels
from jointplay.catalogue.diagnosing.healthy_machine import STEP, HealthyMachine, Motion
from jointplay.catalogue.errors import DiagnosisError
from jointplay.solver.arrays import BoolArray, FloatArray

#: Standard deviation of the logarithm of a sensor's gain, before anything was measured.
GAIN_SCATTER = 0.03
#: Steps at most from each of the best starts, and the gain in squared distance after which there is none more.
MOST_STEPS = 8
SETTLED = 0.05
STARTS = 2
#: Where to begin (ln of the factors on each stiffness), and what a level counts at most there [standard deviations].
START_STIFFNESSES = (-0.45, -0.22, 0.0, 0.22, 0.45)
FAR_OFF = 4.0


@dataclass(frozen=True, eq=False)
class Fit:
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


def fitted_numbers(levels: OrderLevels, model: HealthyMachine, known: LevelStatistics, steps: int) -> Fit:
    """Fit numbers of the machine, and gains, to the levels of a recording.

    Parameters
    ----------
    levels : OrderLevels
    model : HealthyMachine
    known : LevelStatistics
        Of the condition the machine was in.
    steps : int
        At most, from each of two starts.

    Raises
    ------
    DiagnosisError
        Too few levels stand out of the noise, or a case cannot be simulated.
    """
    count = len(model.quantities)
    believed = np.array([*(quantity.scatter for quantity in model.quantities), *([GAIN_SCATTER] * levels.sensors)])
    points = _starts(model)
    nearby = levels.of_motion(model.powers(points))
    nominal = nearby[0]
    # What play adds to the levels of the machine without it is kept while its numbers change.
    offset = known.mean - nominal
    used = known.usable(nominal)
    if used.sum() < len(believed):
        raise DiagnosisError(f"baseline {levels.name}: only {int(used.sum())} levels stand out of noise and scatter")
    noise = known.covariance(used)
    weight = np.asarray(np.linalg.inv(noise), dtype=np.float64)
    misfit = (levels.measured - offset - nearby)[:, used] / np.sqrt(np.diag(noise))
    # Levels jump where a number moves a resonance across an order: single ones must not decide where to begin.
    order = np.argsort(np.minimum(np.square(misfit), FAR_OFF**2).sum(axis=1))
    starts = [np.concatenate([points[index], np.zeros(levels.sensors)]) for index in order[:STARTS]]
    problem = _Problem(levels, model, offset, used, weight, believed)
    found, motion, residual = min((problem.solved(start, steps) for start in starts), key=problem.cost)
    jacobian = _jacobian(levels, motion, found[count:])[used]
    first = (levels.measured - nominal - offset)[used]
    return Fit(
        found=found,
        scatter=np.sqrt(np.diag(np.linalg.inv(jacobian.T @ weight @ jacobian + np.diag(believed**-2)))),
        p_before=known.p_value(float(first @ weight @ first), used, np.zeros_like(noise)),
        p_after=known.p_value(problem.cost((found, motion, residual)), used, (jacobian * believed**2) @ jacobian.T),
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


_Point = tuple[FloatArray, Motion, FloatArray]
"""Numbers and gains (ln), the motion there, and what it leaves of the measured levels, dB."""


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares with what was believed before (Levenberg 1944, Marquardt 1963)."""

    levels: OrderLevels
    model: HealthyMachine
    offset: FloatArray
    used: BoolArray
    weight: FloatArray
    believed: FloatArray

    def cost(self, point: _Point) -> float:
        """Squared distance of the levels, and of the numbers from what was believed."""
        found, _, residual = point
        return float(residual @ self.weight @ residual + np.square(found / self.believed).sum())

    def at(self, found: FloatArray) -> _Point:
        """Simulate the machine with these numbers."""
        count = len(self.model.quantities)
        motion = self.model.at(found[:count])
        predicted = self.levels.of_motion(motion.power, np.exp(found[count:])) + self.offset
        return found, motion, (self.levels.measured - predicted)[self.used]

    def solved(self, start: FloatArray, steps: int) -> _Point:
        """Go downhill from here."""
        here, damping = self.at(start), 0.0
        for _ in range(steps):
            found, motion, residual = here
            jacobian = _jacobian(self.levels, motion, found[len(self.model.quantities) :])[self.used]
            normal = jacobian.T @ self.weight @ jacobian + np.diag(self.believed**-2)
            right = jacobian.T @ self.weight @ residual - found / self.believed**2
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
