"""How far the levels of a recording lie from what changes would make of machines of a catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from jointplay.catalogue.diagnosing.baseline_levels import DECIBELS, LevelStatistics, OrderLevels
from jointplay.catalogue.diagnosing.cause_families import Family, IdealFrame, power_of
from jointplay.solver.arrays import AnyComplexArray, BoolArray, ComplexArray, FloatArray

#: Standard deviation, relative, of a sensor's gain.
GAIN_SCATTER = 0.03
#: What a change that shifts a level is not better known to than, as a part of the shift.
SHIFT_ERROR = 0.1
#: What a level is not better known to after a change, dB, as far as the ideal machine does not explain it before: links
#: that move with a frame that moves, and play, do not go with its motion as forces on a rigid body do.
STRANGE_DB = 3.0
#: A level counts where entries scatter by no more than this [dB], and it has this many times the power of the noise: a
#: load raises by 20 to 50 dB what play alone makes, and that scatters by 5 to 10 dB.
MOST_SCATTER_DB = 10.0
LEAST_SIGNAL = 2.0


@dataclass(frozen=True, eq=False)
class Misfit:
    """Levels of a recording less those of machines of a catalogue, and what a change makes of both.

    Parameters
    ----------
    known : LevelStatistics
        Of the machines.
    used : (m,) bool array
        Levels that say something of the change.
    before : (m,) array
        Levels of their cross-powers, averaged, dB.
    away : (u,) array
        What the recording's used levels are above those of the machines, dB.
    gains : (u, u) array
        Covariance by the gains of sensors, dB^2.
    covariance : (u, u) array
        By all that levels scatter by where nothing has changed, dB^2.
    strange : (m,) array
        Power that the ideal machine does not explain.
    """

    known: LevelStatistics
    used: BoolArray
    before: FloatArray
    away: FloatArray
    gains: FloatArray
    covariance: FloatArray
    strange: FloatArray

    @classmethod
    def of(cls, known: LevelStatistics, model: IdealFrame) -> Self:
        """Compare a recording with machines of some statistics."""
        levels, power = known.levels, known.power
        # With no change, and with changes that move single levels far: levels that noise hides say nothing of either.
        used = np.asarray(known.deviations.std(axis=0) < MOST_SCATTER_DB) & (
            10.0 ** (0.1 * levels.measured) > LEAST_SIGNAL * levels.noise
        )
        by_gain = _by_gain(levels, power)[used]
        gains = by_gain @ by_gain.T * GAIN_SCATTER**2
        away = (levels.measured - known.mean)[used]
        strange = _seen(levels, power - power_of(model.motion))
        before = levels.of_motion(power)
        return cls(known, used, before, away, gains, known.covariance(used) + gains, strange)

    @property
    def none(self) -> float:
        """Distance of the recording from machines that nothing has changed in; others are to be compared with it."""
        return float(np.sum(self.away * np.linalg.solve(self.covariance, self.away)))

    def in_order(self) -> FloatArray:
        """Distances (n,) of machines in order from each other."""
        return self.known.distances(self.used, self.gains)

    def of_members(self, members: Sequence[tuple[Family, FloatArray]], odd: bool = True) -> list[FloatArray]:
        """Distances (n,) of the recording from machines changed by members of families, given by numbers (n, p).

        Parameters
        ----------
        members : sequence of (Family, (n, p) array)
        odd : bool
            Whether members count as further off that are not as such changes usually are.

        Returns
        -------
        list of (n,) array
            Squared, and by how much larger (ln) the determinant of the covariance is than without a change.
        """
        changed = np.concatenate([family.changed(self.known.power, numbers) for family, numbers in members])
        added = np.concatenate([family.added(numbers) for family, numbers in members])
        found = np.split(self._distance(changed, added), np.cumsum([len(numbers) for _, numbers in members])[:-1])
        if not odd:
            return found
        return [far + family.oddity(numbers) for far, (family, numbers) in zip(found, members, strict=True)]

    def _distance(self, changed: ComplexArray, added: ComplexArray) -> FloatArray:
        levels, used = self.known.levels, self.used
        after = levels.of_motion(changed)
        shift = (after - self.before)[:, used]
        left = self.away - shift
        # What the ideal machine does not explain of the motion meets what is added at a phase that nobody knows.
        meeting = 2.0 * DECIBELS**2 * self.strange * _seen(levels, added) * 10.0 ** (-0.2 * after)
        less_sure = (STRANGE_DB * np.minimum(1.0, self.strange * 10.0 ** (-0.1 * self.before))) ** 2
        more = (SHIFT_ERROR * shift) ** 2 + (meeting + less_sure)[:, used]
        # One decomposition of the covariance, with what is left as a further row, makes both terms.
        size = len(self.away)
        spread = np.empty((len(left), size + 1, size + 1))
        spread[:, :size, :size] = self.covariance
        spread[:, np.arange(size), np.arange(size)] += more
        spread[:, size, :size] = spread[:, :size, size] = left
        spread[:, size, size] = 1.0 + np.sum(left**2, axis=1) / self.known.error_variance[used].min()
        root = np.linalg.cholesky(spread)
        determinant = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)[:, :size]), axis=1)
        own = float(np.linalg.slogdet(self.covariance)[1])
        return np.asarray(np.sum(root[:, size, :size] ** 2, axis=1) + determinant - own)


def _seen(levels: OrderLevels, power: AnyComplexArray) -> FloatArray:
    """What the sensors see (..., m) of a motion's cross-powers (..., K, 3, 3), without noise, at least nothing."""
    return np.asarray(np.maximum(10.0 ** (0.1 * levels.of_motion(power)) - levels.noise, 0.0))


def _by_gain(levels: OrderLevels, power: AnyComplexArray) -> FloatArray:
    """Derivatives (m, s) of levels by the gains of the sensors, dB for a unit of their logarithm."""
    small = 1e-4
    here = levels.of_motion(power)
    gains = np.exp(small * np.eye(levels.sensors))
    return np.array([(levels.of_motion(power, row) - here) / small for row in gains]).T
