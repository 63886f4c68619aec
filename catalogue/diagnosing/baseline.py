"""A healthy recording of the same machine: is the model right, which numbers of it are off, and which sensor gains?

Masses, inertias and stiffnesses of machine files are estimates, and so are the gains of sensors. A recording made when
the machine was known to be in order tells them apart from faults. Levels of orders 1 to 20 are compared with those of
simulations of the healthy machine, and the numbers fitted by damped Gauss-Newton steps with what was believed before.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jointplay.catalogue.diagnosing.answer import FittedNumber
from jointplay.catalogue.diagnosing.baseline_levels import GAIN_SCATTER, LevelStatistics, OrderLevels, class_statistics
from jointplay.catalogue.diagnosing.healthy_machine import STEP, HealthyMachine, Motion, quantities
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.entry import HEALTHY
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import with_filed_suspension
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray
from jointplay.solver.machines.machine import Machine

#: Steps at most from each of the best starts, and the gain in squared distance after which there is none more.
MOST_STEPS = 8
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


def fit_numbers(levels: OrderLevels, model: HealthyMachine, known: LevelStatistics, steps: int) -> BaselineFit:
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
    problem = _FitProblem(levels, model, offset, used, weight, believed)
    found, motion, residual = min((problem.solve(start, steps) for start in starts), key=problem.cost)
    jacobian = _jacobian(levels, motion, found[count:])[used]
    first = (levels.measured - nominal - offset)[used]
    return BaselineFit(
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
class _FitProblem:
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

    def solve(self, start: FloatArray, steps: int) -> _Point:
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


#: P-value below which a healthy machine does not explain the recording, whatever its numbers. The p-value is cautious,
#: as it allows for errors of a model that simulations do not have: recordings of machines in order had 0.74 and more.
UNEXPLAINED = 0.1
#: Factor on a number of the machine file, or a gain, that is said.
NOTEWORTHY = 0.15
NOTEWORTHY_GAIN = 0.05
#: Standard deviation, ln, within which catalogue entries count as being of the machine that was found, and the fewest
#: of a hypothesis, in effect, that are left to speak.
KERNEL = 0.1
LEAST_EFFECTIVE = 100.0
#: Least weight of an entry, of at most 1: matching asks for weights above 0.
LEAST_WEIGHT = 1e-6


@dataclass(frozen=True)
class Baseline:
    """What a healthy recording says of a machine and its sensors.

    Parameters
    ----------
    name : str
        Of the recording.
    numbers : mapping of str to FittedNumber
        By path as in a plan: "frame.mass".
    gains : mapping of str to FittedNumber
        By sensor: what it multiplies accelerations by.
    p_before, p_after : float
        Share of simulated recordings of the machine that fit worse than this one: with the numbers of the file and
        gains of 1, and with those that were fitted.
    parameters : mapping of str to float
        The fitted numbers as parameters of a case, SI.
    warnings : tuple of str
    simulations : int
        How many it took.
    paths : mapping of str to mapping of str to float
        Numbers of the machine file behind each of `numbers`, as they are there.
    """

    name: str
    numbers: Mapping[str, FittedNumber]
    gains: Mapping[str, FittedNumber]
    p_before: float
    p_after: float
    parameters: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    simulations: int = 0
    paths: Mapping[str, Mapping[str, float]] = field(default_factory=dict, repr=False)

    @property
    def explained(self) -> bool:
        """Whether a healthy machine explains the recording; nothing of the baseline is used otherwise."""
        return self.p_after >= UNEXPLAINED

    def correct(self, prepared: PreparedMeasurement, machine: Machine) -> PreparedMeasurement:
        """Return a recording by the same sensors as if gains, frame and supports were what they should be.

        Parameters
        ----------
        prepared : PreparedMeasurement
            Of the machine, whatever its condition.
        machine : Machine
            As in its file.

        Returns
        -------
        PreparedMeasurement
            Gains divided out, and the motion converted where all of it is seen; two more steps of the recipe say so. As
            it is where the baseline was not explained.
        """
        if not self.explained:
            return prepared
        straight = prepared.with_gains({sensor: gain.factor for sensor, gain in self.gains.items()})
        return with_filed_suspension(straight, machine, self.parameters)

    def weights(self, drawn: Mapping[str, FloatArray], hypotheses: Sequence[IntArray]) -> FloatArray:
        """How much entries of a catalogue are of this machine.

        Parameters
        ----------
        drawn : mapping of str to (n,) array
            Numbers of the entries by path, SI; what is not there is as in the machine file.
        hypotheses : sequence of (m,) int arrays
            Rows of the entries of each hypothesis; together all n.

        Returns
        -------
        (n,) array
            Gaussian in the logarithm of the fitted numbers, at most 1. It is widened, hypothesis by hypothesis, until
            there are 100 draws in effect, (sum w)^2 / sum w^2, or all of them. All 1 where nothing was explained.
        """
        count = sum(len(rows) for rows in hypotheses)
        if not self.explained:
            return np.ones(count)
        distance = np.zeros(count)
        for name, estimate in self.numbers.items():
            logs = [np.log(drawn[path] / own) for path, own in self.paths[name].items() if path in drawn]
            if logs:
                spread = math.hypot(KERNEL, estimate.scatter)
                distance += ((np.mean(logs, axis=0) - math.log(estimate.factor)) / spread) ** 2
        weights = np.ones(count)
        for rows in hypotheses:
            # What all entries of a hypothesis are away by says nothing about which of them are nearer.
            away = distance[rows] - distance[rows].min()
            wanted = min(LEAST_EFFECTIVE, 0.5 * len(rows))
            for widening in 2.0 ** np.arange(0.0, 12.0, 0.5):
                weights[rows] = np.exp(-0.5 * away / widening**2)
                if weights[rows].sum() ** 2 / np.square(weights[rows]).sum() >= wanted:
                    break
        return np.maximum(weights, LEAST_WEIGHT)


def fit_baseline(prepared: PreparedMeasurement, catalogue: Catalogue, *, steps: int = MOST_STEPS) -> Baseline:
    """Check and fit the model of a machine by a recording of it in order.

    Parameters
    ----------
    prepared : PreparedMeasurement
        Of the healthy machine, by the sensors that are used for diagnosis.
    catalogue : Catalogue
        Of the same machine, with the hypothesis healthy: says what scatters even when all numbers are right.
    steps : int
        Steps at most, >= 1, from each of two starts; each simulates the machine once for every number that can be
        corrected, and once more.

    Returns
    -------
    Baseline

    Raises
    ------
    DiagnosisError
        The catalogue holds no such machines, or the healthy machine cannot be simulated at this speed.
    """
    if steps < 1:
        raise DiagnosisError(f"baseline steps: {steps}: must be at least 1")
    levels = OrderLevels.of(prepared)
    known = class_statistics(catalogue, levels, HEALTHY, as_filed=True)
    if known is None:
        raise DiagnosisError(f"catalogue {catalogue.path}: holds too few machines that are healthy")
    model = HealthyMachine(catalogue, quantities(catalogue.machine), prepared.drive_speed)
    return _answer(levels, model, fit_numbers(levels, model, known, steps))


def _answer(levels: OrderLevels, model: HealthyMachine, fit: BaselineFit) -> Baseline:
    count = len(model.quantities)
    estimates = [
        FittedNumber(factor=math.exp(x), scatter=float(sd)) for x, sd in zip(fit.found, fit.scatter, strict=True)
    ]
    names = [quantity.name for quantity in model.quantities]
    numbers = dict(zip(names, estimates[:count], strict=True))
    gains = dict(zip(levels.prepared.sensing.sensors, estimates[count:], strict=True))
    warnings = []
    if fit.p_after < UNEXPLAINED:
        warnings.append(
            f"baseline {levels.name}: no healthy machine explains it (p {fit.p_after:.2g}): nothing of it was used"
        )
    else:
        for what, group, least in (("", numbers, NOTEWORTHY), ("gain of ", gains, NOTEWORTHY_GAIN)):
            warnings += [
                f"baseline: {what}{name} is {estimate.factor:.3g} times what it should be"
                f" (+- {100 * estimate.scatter:.2g} %)"
                for name, estimate in group.items()
                if abs(math.log(estimate.factor)) > max(least, 2.0 * estimate.scatter)
            ]
    return Baseline(
        name=levels.name,
        numbers=numbers,
        gains=gains,
        p_before=fit.p_before,
        p_after=fit.p_after,
        parameters=model.parameters(fit.found[:count]),
        warnings=tuple(warnings),
        simulations=model.simulations,
        paths={quantity.name: quantity.paths for quantity in model.quantities},
    )
