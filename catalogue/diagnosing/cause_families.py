"""Changes other than play that a machine may have, family by family, and what each makes of the frame's motion.

A family changes what acts on the frame (:mod:`jointplay.catalogue.diagnosing.frame_forces`) or the frame and its
supports (mass, a mount, all mounts). Its members differ by a number or two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, Self

import numpy as np
from scipy.linalg.lapack import dpotrf

from jointplay.catalogue.diagnosing.baseline_levels import DECIBELS, LevelStatistics, OrderLevels
from jointplay.catalogue.diagnosing.frame_forces import FamilyWrench, Wrench, family_wrenches
from jointplay.catalogue.signals.suspension import accelerance, inverse_of
from jointplay.solver.arrays import AnyComplexArray, BoolArray, ComplexArray, FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Mount
from jointplay.solver.spectra.bands import FEATURE_ORDERS

ALL_MOUNTS = "all mounts"
#: Factors on the stiffness of all mounts by which a machine in order may differ from itself: rubber that is warmer is
#: softer.
WARMTH = (0.9, 1.1)
#: Factor on the stiffness of a mount, or the inverse of one, that is no more than a small change.
SMALL_STIFFNESS = 1.3
#: Standard deviation of the logarithm of a second factor, of damping or inertia, from what it usually is.
SECOND_FACTOR = 0.3


class Family(Protocol):
    """Changes of one kind. What is told of members is told of many at once, one a row of their numbers (n, p)."""

    @property
    def name(self) -> str:
        """As it is told."""

    @property
    def unit(self) -> str:
        """Of the size."""

    @property
    def starts(self) -> FloatArray:
        """Numbers (n, p) of the members that a search starts from."""

    @property
    def least(self) -> float:
        """Norm of the numbers of the least change that is no small one."""

    def size(self, numbers: FloatArray) -> float:
        """What one member (p,) is told by."""

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        """Numbers of frame and supports that one member (p,) has, by path."""

    def oddity(self, numbers: FloatArray) -> FloatArray:
        """Squared distances (n,) from what such changes usually have, in standard deviations."""

    def change(self, power: AnyComplexArray, numbers: FloatArray) -> ComplexArray:
        """Cross-powers (n, K, 3, 3) after a change, of those before (K, 3, 3)."""

    def add(self, numbers: FloatArray) -> ComplexArray:
        """Cross-powers (n, K, 3, 3) of what is added to the motion, by itself; zero where nothing is."""


@dataclass(frozen=True, eq=False)
class _Forces:
    """What acts on the frame besides: numbers times motions (p, K, 3) that they add to the ideal frame's own (K, 3)."""

    wrench: FamilyWrench
    motion: ComplexArray
    basis: ComplexArray

    @property
    def name(self) -> str:
        return self.wrench.name

    @property
    def unit(self) -> str:
        return self.wrench.unit

    @property
    def starts(self) -> FloatArray:
        return self.wrench.starts

    @property
    def least(self) -> float:
        return float(np.linalg.norm(self.starts, axis=1).min())

    def size(self, numbers: FloatArray) -> float:
        own = float(numbers[0]) if len(numbers) == 1 else float(np.linalg.norm(numbers))
        return self.wrench.none + own

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        return {}

    def oddity(self, numbers: FloatArray) -> FloatArray:
        return np.zeros(len(numbers))

    def change(self, power: AnyComplexArray, numbers: FloatArray) -> ComplexArray:
        # Powers are mean squares, twice |amplitude|^2.
        new = np.tensordot(numbers, self.basis, 1)
        return np.asarray(power - power_of(self.motion) + power_of(self.motion + new), np.complex128)

    def add(self, numbers: FloatArray) -> ComplexArray:
        return power_of(np.asarray(np.tensordot(numbers, self.basis, 1), np.complex128))


class _Kind(NamedTuple):
    """Unit, factors that a search starts from, the usual power of the second one, and the least that is not small."""

    unit: str
    factors: Sequence[float]
    usual: float
    small: float


#: Where a resonance lies on an order, a valley is a tenth wide, and rubber is softer by so much on a warm day. What is
#: softer damps less, and a frame that is lighter is easier to turn.
_STIFFNESS = _Kind(
    "x stiffness",
    (0.02, 0.1, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0),
    usual=0.5,
    small=SMALL_STIFFNESS,
)
_MASS = _Kind("x mass", (0.5, 0.65, 0.8, 0.9, 1.1, 1.2, 1.5, 2.0), usual=1.0, small=1.2)


@dataclass(frozen=True, eq=False)
class _Factor:
    """The frame or its supports: numbers of the machine with two factors, given by their logarithms.

    The second is usually the first to a power. What a force takes for an acceleration, the accelerance's inverse
    (K, 3, 3), is that of the file and a part more for what each factor is above 1.
    """

    name: str
    unit: str
    starts: FloatArray
    usual: float
    least: float
    numbers: Callable[[float, float], dict[str, float]]
    own: ComplexArray
    parts: tuple[ComplexArray, ComplexArray]

    @classmethod
    def of(cls, name: str, kind: _Kind, model: IdealFrame, numbers: Callable[..., dict[str, float]]) -> _Factor:
        """A family of a kind."""
        each = [inverse_of(model.with_numbers(numbers(*two))) - model.inverse for two in ((2.0, 1.0), (1.0, 2.0))]
        both = np.array([1.0, kind.usual])
        starts, least = np.log(kind.factors)[:, None] * both, math.log(kind.small) * float(np.linalg.norm(both))
        return cls(name, kind.unit, starts, kind.usual, least, numbers, model.inverse, (each[0], each[1]))

    def size(self, numbers: FloatArray) -> float:
        return math.exp(float(numbers[0]))

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        return self.numbers(*np.exp(numbers).tolist())

    def oddity(self, numbers: FloatArray) -> FloatArray:
        return np.asarray((numbers[:, 1] - self.usual * numbers[:, 0]) / SECOND_FACTOR) ** 2

    def change(self, power: AnyComplexArray, numbers: FloatArray) -> ComplexArray:
        more = np.exp(numbers) - 1.0
        passed = inverse_of(self.own + np.tensordot(more, np.array(self.parts), 1)) @ self.own
        return np.asarray(passed @ power @ passed.conj().swapaxes(-1, -2), np.complex128)

    def add(self, numbers: FloatArray) -> ComplexArray:
        return np.zeros((len(numbers), FEATURE_ORDERS, 3, 3), np.complex128)


@dataclass(frozen=True, eq=False)
class IdealFrame:
    """The machine as filed: motion (K, 3) of its ideal frame, its accelerance (K, 3, 3), and what else may act on it.

    Parameters
    ----------
    machine : Machine
    speed : float
        rad/s.
    frequency : (K,) array
        Hz.
    accelerance, inverse : (K, 3, 3) array
    motion : (K, 3) array
        m/s2 and rad/s2.
    wrenches : tuple of FamilyWrench
    """

    machine: Machine
    speed: float
    frequency: FloatArray
    accelerance: ComplexArray
    inverse: ComplexArray
    motion: ComplexArray
    wrenches: tuple[FamilyWrench, ...]

    @classmethod
    def of(cls, machine: Machine, speed: float) -> IdealFrame:
        """Set up a machine on its mounts at a speed, rad/s.

        Raises
        ------
        DiagnosisError
            The ideal machine does not come round.
        """
        inertial, wrenches = family_wrenches(machine, speed)
        frequency = np.arange(1.0, FEATURE_ORDERS + 1.0) * (abs(speed) / (2.0 * math.pi))
        own = accelerance(machine, {}, frequency)
        return cls(machine, speed, frequency, own, inverse_of(own), _move(own, inertial, speed)[0], wrenches)

    def with_numbers(self, numbers: dict[str, float]) -> ComplexArray:
        """Accelerance (K, 3, 3) of a frame and supports of other numbers."""
        return accelerance(self.machine, numbers, self.frequency)


def power_of(motion: ComplexArray) -> ComplexArray:
    """Cross-powers (..., K, 3, 3) of a motion (..., K, 3): mean squares, twice those of its complex amplitudes."""
    return np.asarray(2.0 * motion[..., :, None] * motion[..., None, :].conj(), np.complex128)


def _move(accelerance: ComplexArray, wrench: Wrench, speed: float) -> ComplexArray:
    """Motions (p, K, 3) of a frame by wrenches."""
    return np.asarray((accelerance @ wrench.at(speed)[..., None])[..., 0], np.complex128)


def families_of(model: IdealFrame) -> Iterator[Family]:
    """Yield every family that a machine may have."""
    machine = model.machine
    mounts = mounts_of(machine)
    for name, group in [*((f"mount {index}", [index]) for index in mounts), (ALL_MOUNTS, mounts)]:
        yield _Factor.of(name, _STIFFNESS, model, partial(mount_numbers, machine, group))
    yield _Factor.of(f"mass of {machine.frame}", _MASS, model, partial(_frame, machine))
    for family in model.wrenches:
        yield forces_of(model, family)


def forces_of(model: IdealFrame, family: FamilyWrench) -> Family:
    """Return what a family of further forces makes of the frame's motion."""
    return _Forces(family, model.motion, _move(model.accelerance, family.wrench, model.speed))


def mounts_of(machine: Machine) -> list[int]:
    """Return the places of mounts among the supports of a machine."""
    return [place for place, support in enumerate(machine.supports) if isinstance(support, Mount)]


def mount_numbers(
    machine: Machine, group: Sequence[int], factor: float, damping: float, own: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Return numbers of mounts whose stiffness has a factor, and whose damping another one, by path.

    On the machine's own numbers, by path, where it has some that are not those of its file.
    """
    found: dict[str, float] = {}
    for index in group:
        mount = machine.supports[index]
        assert isinstance(mount, Mount)
        for name, by, filed in (("stiffness", factor, mount.stiffness), ("damping", damping, mount.damping)):
            for axis in (0, 1):
                path = f"supports.{index}.{name}.{axis}"
                found[path] = by * (own or {}).get(path, filed[axis])
    return found


def _frame(machine: Machine, mass: float, inertia: float) -> dict[str, float]:
    """Numbers of a frame whose mass has a factor, and whose inertia another one."""
    link = machine.links[machine.frame]
    return {
        f"links.{machine.frame}.mass": mass * (link.mass or 0.0),
        f"links.{machine.frame}.inertia": inertia * (link.inertia or 0.0),
    }


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
        used = (
            np.asarray(known.deviations.std(axis=0) < MOST_SCATTER_DB)
            & (known.error_variance < MOST_SCATTER_DB**2)
            & (10.0 ** (0.1 * levels.measured) > LEAST_SIGNAL * levels.noise)
        )
        by_gain = _by_gain(levels, power)[used]
        gains = by_gain @ by_gain.T * known.gain_scatter**2
        away = (levels.measured - known.mean)[used]
        strange = _observe(levels, power - power_of(model.motion))
        before = levels.of_motion(power)
        return cls(known, used, before, away, gains, known.covariance(used) + gains, strange)

    @property
    def none(self) -> float:
        """Distance of the recording from machines that nothing has changed in; others are to be compared with it."""
        return float(np.sum(self.away * np.linalg.solve(self.covariance, self.away)))

    @property
    def unknown(self) -> float:
        """The same from machines in which something has changed that shifts no level, but makes them less sure."""
        power = np.asarray(self.known.power, np.complex128)[None]
        return float(self._distance(power, np.zeros_like(power))[0])

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
        changed = np.concatenate([family.change(self.known.power, numbers) for family, numbers in members])
        added = np.concatenate([family.add(numbers) for family, numbers in members])
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
        meeting = 2.0 * DECIBELS**2 * self.strange * _observe(levels, added) * 10.0 ** (-0.2 * after)
        less_sure = (STRANGE_DB * np.minimum(1.0, self.strange * 10.0 ** (-0.1 * self.before))) ** 2
        more = (SHIFT_ERROR * shift) ** 2 + (meeting + less_sure)[:, used]
        # One decomposition of the covariance, with what is left as a further row, makes both terms.
        size = len(self.away)
        spread = np.empty((len(left), size + 1, size + 1))
        spread[:, :size, :size] = self.covariance
        spread[:, np.arange(size), np.arange(size)] += more
        spread[:, size, :size] = spread[:, :size, size] = left
        spread[:, size, size] = 1.0 + np.sum(left**2, axis=1) / self.known.error_variance[used].min()
        root = _decompose(spread)
        determinant = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)[:, :size]), axis=1)
        own = float(np.linalg.slogdet(self.covariance)[1])
        return np.asarray(np.sum(root[:, size, :size] ** 2, axis=1) + determinant - own)


def _decompose(matrices: FloatArray) -> FloatArray:
    """Lower triangles (n, k, k) of Cholesky's decomposition in the place of matrices; what is above them stays.

    As :func:`numpy.linalg.cholesky` to the last digits, in half the time: LAPACK reads rows as columns.
    """
    for matrix in matrices:
        _, info = dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError("covariance of levels: not positive definite")
    return matrices


def _observe(levels: OrderLevels, power: AnyComplexArray) -> FloatArray:
    """What the sensors see (..., m) of a motion's cross-powers (..., K, 3, 3), without noise, at least nothing."""
    return np.asarray(np.maximum(10.0 ** (0.1 * levels.of_motion(power)) - levels.noise, 0.0))


def _by_gain(levels: OrderLevels, power: AnyComplexArray) -> FloatArray:
    """Derivatives (m, s) of levels by the gains of the sensors, dB for a unit of their logarithm."""
    small = 1e-4
    here = levels.of_motion(power)
    gains = np.exp(small * np.eye(levels.sensors))
    return np.array([(levels.of_motion(power, row) - here) / small for row in gains]).T
