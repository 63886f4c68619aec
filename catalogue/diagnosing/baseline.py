"""A healthy recording of the same machine: is the model right, which numbers of it are off, and which sensor gains?

Masses, inertias and stiffnesses of machine files are estimates, and so are the gains of sensors. A recording made when
the machine was known to be in order tells them apart from faults. Levels of orders 1 to 20 are compared with those of
simulations of the healthy machine, and the numbers fitted by damped Gauss-Newton steps with what was believed before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jointplay.catalogue.diagnosing.answer_of_baseline import FittedNumber
from jointplay.catalogue.diagnosing.baseline_fit import BaselineFit, fit_numbers
from jointplay.catalogue.diagnosing.baseline_levels import OrderLevels, class_statistics
from jointplay.catalogue.diagnosing.healthy_machine import HealthyMachine, quantities
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.entry import HEALTHY
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import with_filed_suspension
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.machine import Machine

#: Steps of a fit at most, from each of the best starts.
MOST_STEPS = 8
#: P-value below which a healthy machine does not explain the recording, whatever its numbers. The p-value is cautious,
#: as it allows for errors of a model that simulations do not have: recordings of machines in order had 0.86 and more.
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
        Of the recording, or of several.
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
        """Whether a healthy machine explains the recording; no number or gain of the baseline is used otherwise."""
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


def fit_baseline(
    prepared: PreparedMeasurement | Sequence[PreparedMeasurement], catalogue: Catalogue, *, steps: int = MOST_STEPS
) -> Baseline:
    """Check and fit the model of a machine by one or several recordings of it in order.

    Parameters
    ----------
    prepared : PreparedMeasurement or sequence of PreparedMeasurement
        Of the healthy machine, by the sensors that are used for diagnosis; several at any speeds, by the same sensors:
        numbers and gains are common to them.
    catalogue : Catalogue
        Of the same machine, with the hypothesis healthy: says what scatters even when all numbers are right.
    steps : int
        Steps at most, >= 1, from each of two starts; each simulates the machine once for every number that can be
        corrected, and once more, at the speed of every recording.

    Returns
    -------
    Baseline

    Raises
    ------
    DiagnosisError
        The catalogue holds no such machines, the healthy machine cannot be simulated at this speed, or recordings are
        by different sensors.
    """
    if steps < 1:
        raise DiagnosisError(f"baseline steps: {steps}: must be at least 1")
    recordings = [prepared] if isinstance(prepared, PreparedMeasurement) else list(prepared)
    known = []
    for each in recordings:
        if each.sensing.sensors != recordings[0].sensing.sensors:
            raise DiagnosisError(f"baseline {each.name}: its sensors are not those of {recordings[0].name}")
        levels = OrderLevels.of(each)
        statistics = class_statistics(catalogue, levels, HEALTHY, as_filed=True)
        if statistics is None:
            raise DiagnosisError(f"catalogue {catalogue.path}: holds too few machines that are healthy")
        model = HealthyMachine(catalogue, quantities(catalogue.machine), each.drive_speed)
        known.append((levels, model, statistics))
    fit = fit_numbers(known, steps)
    first, model, _ = known[0]
    simulations = sum(each.simulations for _, each, _ in known)
    return _answer(", ".join(each.name for each in recordings), first, model, fit, simulations)


def _answer(name: str, levels: OrderLevels, model: HealthyMachine, fit: BaselineFit, simulations: int) -> Baseline:
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
            f"baseline {name}: no healthy machine explains it (p {fit.p_after:.2g}): what was fitted to it was not used"
        )
    else:
        for what, group, least in (("", numbers, NOTEWORTHY), ("gain of ", gains, NOTEWORTHY_GAIN)):
            warnings += [
                f"baseline: {what}{path} is {estimate.factor:.3g} times what it should be"
                f" (+- {100 * estimate.scatter:.2g} %)"
                for path, estimate in group.items()
                if abs(math.log(estimate.factor)) > max(least, 2.0 * estimate.scatter)
            ]
    return Baseline(
        name=name,
        numbers=numbers,
        gains=gains,
        p_before=fit.p_before,
        p_after=fit.p_after,
        parameters=model.parameters(fit.found[:count]),
        warnings=tuple(warnings),
        simulations=simulations,
        paths={quantity.name: quantity.paths for quantity in model.quantities},
    )
