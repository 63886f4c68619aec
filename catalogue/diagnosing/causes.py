"""Causes other than play, each a family of one size: which of them explains the low orders of a recording, and how big.

A family changes what acts on the frame (unbalance, process load, ripple of the drive, mass of a link) or the frame and
its supports (mass, a mount, all mounts). What a change makes of the low orders of the catalogue's machines in order,
or of those that are worn as the recording's seems to be, is put beside the recording: levels of orders 1 to 20, with
what they scatter by, gains of sensors included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import logsumexp

from catalogue.diagnosing.baseline_levels import LevelStatistics, OrderLevels, class_statistics
from catalogue.diagnosing.frame_forces import Revolution, wrench_orders
from catalogue.plans.variants import output_load
from catalogue.signals.prepared import PreparedMeasurement
from catalogue.signals.suspension import accelerance, on_mounts
from catalogue.storage.feature_bands import FEATURE_ORDERS
from catalogue.storage.store import Catalogue
from solver.machines.joints import TurningJoint
from solver.machines.machine import Machine
from solver.machines.parts import Mount

__all__ = ["NamedCause", "name_causes"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ComplexArray = npt.NDArray[np.complex128]

#: Factors on the stiffness of mounts that a search starts from.
STIFFNESSES = (0.02, 0.1, 0.3, 0.5, 0.7, 1.3, 2.0)
#: Factors on a mass that a search starts from.
MASSES = (0.5, 0.65, 0.8, 1.2, 1.5, 2.0)
#: Mass times radius that turns with the drive, as a part of the moving mass times the length of the driven link.
UNBALANCES = (0.02, 0.1, 0.5)
#: Process loads, as multiples of the weight of the moving links.
LOADS = (-8.0, -2.0, -0.5, 0.5, 2.0, 8.0)
#: Orders and amplitudes [rad] of a ripple of the drive.
RIPPLE_ORDERS, RIPPLES = (1, 2, 3, 4, 6, 8, 12), (5e-4, 3e-3, 2e-2)
#: Phases of what turns or swings with the drive, which the recording does not know.
PHASES = 2.0 * math.pi * np.arange(6) / 6
#: Standard deviation of the logarithm of a second factor, of damping or inertia, from what it usually is.
SECOND_FACTOR = 0.3
#: Standard deviation, relative, of a sensor's gain.
GAIN_SCATTER = 0.03
#: What a change that shifts a level is not better known to than, as a part of the shift.
SHIFT_ERROR = 0.1
#: What evidence is divided by, as a logarithm: the forces on a rigid frame are no simulation of a machine with play,
#: and levels that err together are not as many as they look.
TEMPERATURE = 2.0
#: A cause is named where it has this probability, and is so much likelier than none (ln),
LEAST_PROBABILITY = 0.05
LEAST_GAIN = 8.0
#: and where it leaves no more than this part of what the machine as filed leaves unexplained, or fits as well as this.
MOST_LEFT = 0.35
EXPLAINED = 0.01
#: Families that are searched beyond their starts: the best so many.
SEARCHED = 5
#: Entries of a worn hypothesis that stand for the recording's machine: those nearest in clearance.
NEAREST = 80
#: A level counts where entries scatter by no more than this [dB], and it has this many times the power of the noise.
MOST_SCATTER_DB = 4.0
LEAST_SIGNAL = 2.0
#: Fewest levels that a change is told from others by.
LEAST_LEVELS = 12


@dataclass(frozen=True)
class NamedCause:
    """A cause other than play.

    Parameters
    ----------
    name : str
        "mount 1", "unbalance", "load" ...
    size : float
    unit : str
        What the size is in: "x stiffness", "kg m", "N" ...
    probability : float
        Among the families that were tried, nothing at all among them.
    suspension : mapping of str to float
        Numbers of frame and supports as they then are, by path; empty where forces are the cause.
    """

    name: str
    size: float
    unit: str
    probability: float
    suspension: Mapping[str, float] = field(default_factory=dict)


class _Family(Protocol):
    """Changes of one kind."""

    @property
    def name(self) -> str:
        """As it is told."""

    @property
    def unit(self) -> str:
        """Of the size."""

    @property
    def starts(self) -> FloatArray:
        """Numbers (n, p) of the members that a search starts from."""

    def size(self, numbers: FloatArray) -> float:
        """What a member is told by."""

    def oddity(self, numbers: FloatArray) -> float:
        """Squared distance of its numbers from what such a change usually has, in standard deviations."""

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        """Numbers of frame and supports that a member has, by path."""

    def changed(self, power: ComplexArray, motion: ComplexArray, numbers: FloatArray) -> ComplexArray:
        """Cross-powers (K, 3, 3) after a change, of those before and of the ideal frame's motion (K, 3)."""


@dataclass(frozen=True, eq=False)
class _Forces:
    """What acts on the frame besides: numbers (p,) times motions (p, K, 3) that they add."""

    name: str
    unit: str
    starts: FloatArray
    basis: ComplexArray

    def size(self, numbers: FloatArray) -> float:
        return float(numbers[0]) if len(numbers) == 1 else float(np.linalg.norm(numbers))

    def oddity(self, numbers: FloatArray) -> float:
        return 0.0

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        return {}

    def changed(self, power: ComplexArray, motion: ComplexArray, numbers: FloatArray) -> ComplexArray:
        # Powers are mean squares, twice |amplitude|^2.
        new, own = np.tensordot(numbers, self.basis, 1)[:, :, None], motion[:, :, None]
        cross = own @ new.conj().swapaxes(1, 2)
        return np.asarray(power + 2.0 * (cross + cross.conj().swapaxes(1, 2) + new @ new.conj().swapaxes(1, 2)))


@dataclass(frozen=True, eq=False)
class _Factor:
    """The frame or its supports: numbers of the machine with two factors, given by their logarithms.

    The second is usually the first to a power.
    """

    name: str
    unit: str
    starts: FloatArray
    model: _Model
    usual: float
    numbers: Callable[[float, float], dict[str, float]]

    def size(self, numbers: FloatArray) -> float:
        return math.exp(float(numbers[0]))

    def oddity(self, numbers: FloatArray) -> float:
        return float((numbers[1] - self.usual * numbers[0]) / SECOND_FACTOR) ** 2

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        return self.numbers(*np.exp(numbers).tolist())

    def changed(self, power: ComplexArray, motion: ComplexArray, numbers: FloatArray) -> ComplexArray:
        model = self.model
        passed = accelerance(model.machine, self.suspension(numbers), model.frequency) @ model.inverse
        return np.asarray(passed @ power @ passed.conj().swapaxes(1, 2))


def name_causes(
    prepared: PreparedMeasurement, catalogue: Catalogue, worn: Sequence[tuple[str, IntArray]] = ()
) -> tuple[NamedCause, ...]:
    """Say which change other than play explains the low orders of a recording.

    Parameters
    ----------
    prepared : PreparedMeasurement
    catalogue : Catalogue
    worn : sequence of (label, rows)
        Worn machines that the recording's may be, besides those in order: hypothesis and nearest entries.

    Returns
    -------
    tuple of NamedCause
        Most probable first; empty where nothing but play is needed, or no family explains them.

    Raises
    ------
    DiagnosisError
        The ideal machine does not come round at this speed.
    """
    machine = catalogue.machine
    if not on_mounts(machine):
        return ()
    levels = OrderLevels.of(prepared)
    model = _Model.of(machine, math.copysign(prepared.drive_speed, catalogue.recipe.nominal_drive_speed))
    families = tuple(_families(machine, model))
    scored: list[_Scored] = []
    for label, rows in (("healthy", None), *worn):
        known = class_statistics(catalogue, levels, label, rows)
        if known is not None:
            chosen = catalogue.matrix.rows(label, "trusted") if rows is None else rows
            power = catalogue.matrix.cross_power(chosen)[:, :FEATURE_ORDERS].mean(axis=0)
            scored += _scored(known, power, model, families)
    return _ranked(scored)


@dataclass(frozen=True, eq=False)
class _Model:
    """The machine as filed: motion (K, 3) of its ideal frame, its accelerance (K, 3, 3), and a revolution of links."""

    machine: Machine
    revolution: Revolution
    frequency: FloatArray
    accelerance: ComplexArray
    inverse: ComplexArray
    motion: ComplexArray

    @classmethod
    def of(cls, machine: Machine, speed: float) -> _Model:
        revolution = Revolution.of(machine, speed)
        frequency = np.arange(1.0, FEATURE_ORDERS + 1.0) * (abs(speed) / (2.0 * math.pi))
        own = accelerance(machine, {}, frequency)
        motion = _moved(own, revolution.inertial())
        return cls(machine, revolution, frequency, own, np.asarray(np.linalg.inv(own), np.complex128), motion)

    def added(self, wrench: FloatArray) -> ComplexArray:
        """What a further wrench (n, 3) adds to the frame's motion."""
        return _moved(self.accelerance, wrench)


def _moved(accelerance: ComplexArray, wrench: FloatArray) -> ComplexArray:
    return np.asarray(np.einsum("kij,kj->ki", accelerance, wrench_orders(wrench, len(accelerance))), np.complex128)


def _families(machine: Machine, model: _Model) -> Iterator[_Family]:
    # Rubber that is softer damps less, and a frame that is lighter is easier to turn.
    stiffnesses = np.log(STIFFNESSES)[:, None] * [1.0, 0.5]
    masses = np.log(MASSES)[:, None] * [1.0, 1.0]
    mounts = [index for index, support in enumerate(machine.supports) if isinstance(support, Mount)]
    for name, group in [*((f"mount {index}", [index]) for index in mounts), ("all mounts", mounts)]:
        yield _Factor(name, "x stiffness", stiffnesses, model, 0.5, partial(_mounts, machine, group))
    yield _Factor(f"mass of {machine.frame}", "x mass", masses, model, 1.0, partial(_frame, machine))
    revolution = model.revolution
    own = revolution.inertial()
    for link in revolution.links:
        if link == _driven(machine):
            continue  # a heavier crank is unbalance
        one = model.added(revolution.inertial({link: 2.0}) - own)
        yield _Mass(f"mass of {link}", "x mass", np.array(MASSES)[:, None] - 1.0, one[None])
    yield from _unbalances(machine, model)
    yield from _loads(machine, model)
    small = 1e-4
    starts = _turned(RIPPLES)
    for order in RIPPLE_ORDERS:
        parts = [model.added(revolution.rippled(order, *each)) - model.motion for each in ((small, 0.0), (0.0, small))]
        yield _Forces(f"ripple of the drive, order {order}", "rad", starts, np.array(parts) / small)


class _Mass(_Forces):
    """Mass of a link: the number is what its factor is above 1."""

    def size(self, numbers: FloatArray) -> float:
        return 1.0 + float(numbers[0])


def _turned(sizes: Sequence[float]) -> FloatArray:
    """Sine and cosine parts (n, 2) of every size with every phase."""
    return np.array([[size * math.sin(phase), size * math.cos(phase)] for size in sizes for phase in PHASES])


def _mounts(machine: Machine, group: Sequence[int], factor: float, damping: float) -> dict[str, float]:
    """Numbers of mounts whose stiffness has a factor, and whose damping another one."""
    found: dict[str, float] = {}
    for index in group:
        mount = machine.supports[index]
        assert isinstance(mount, Mount)
        for axis in (0, 1):
            found[f"supports.{index}.stiffness.{axis}"] = factor * mount.stiffness[axis]
            found[f"supports.{index}.damping.{axis}"] = damping * mount.damping[axis]
    return found


def _frame(machine: Machine, mass: float, inertia: float) -> dict[str, float]:
    """Numbers of a frame whose mass has a factor, and whose inertia another one."""
    link = machine.links[machine.frame]
    return {
        f"links.{machine.frame}.mass": mass * (link.mass or 0.0),
        f"links.{machine.frame}.inertia": inertia * (link.inertia or 0.0),
    }


def _driven(machine: Machine) -> str:
    """Link that turns on the frame with the drive; empty where what turns does not turn on the frame."""
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    others = [name for name in joint.links if name != machine.frame]
    return others[0] if len(others) == 1 else ""


def _unbalances(machine: Machine, model: _Model) -> Iterator[_Family]:
    driven = _driven(machine)
    if not driven:
        return
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    others = [each.at for each in machine.joints.values() if isinstance(each, TurningJoint) and driven in each.links]
    length = max(math.dist(joint.at, at) for at in others)
    product = length * sum(machine.links[name].mass or 0.0 for name in model.revolution.links)
    parts = [model.added(model.revolution.rotating(joint.at, 1.0, phase)) for phase in (0.0, 0.5 * math.pi)]
    yield _Forces("unbalance", "kg m", product * _turned(UNBALANCES), np.array(parts))


def _loads(machine: Machine, model: _Model) -> Iterator[_Family]:
    """Loads of the process on the output link: constant, and over either half of its way.

    On a link that turns, both a torque and a force across the end of its arm.
    """
    place = output_load(machine)
    if place is None:
        return
    revolution = model.revolution
    weight = 9.81 * sum(machine.links[name].mass or 0.0 for name in revolution.links)
    forward = revolution.velocity(place.link, place.direction) > 0.0
    courses = {"load": np.ones(len(forward)), "load on one stroke": 1.0 * forward, "load on the other": 1.0 * ~forward}
    along = np.broadcast_to(place.direction, (len(forward), 2))
    ways = [(place.at, along, place.arm)]
    ends = [each.at for each in machine.joints.values() if place.link in each.links and each.at != place.at]
    if place.direction == (0.0, 0.0) and ends:
        end = max(ends, key=lambda at: math.dist(place.at, at))
        ways.append((end, revolution.across(place.link, place.at, end), 0.0))
    starts = weight * np.array(LOADS)[:, None]
    for name, course in courses.items():
        for at, direction, arm in ways:
            force, torque = np.asarray(course[:, None] * direction, np.float64), np.asarray(course * arm, np.float64)
            added = model.added(revolution.force(place.link, at, force, torque))
            yield _Forces(name.replace("the other", "one stroke"), "N", starts, added[None])


@dataclass(frozen=True, eq=False)
class _Scored:
    """The best member of a family, and whether it may be named; no family where nothing was changed."""

    family: _Family | None
    evidence: float
    numbers: FloatArray
    named: bool = False


def _scored(
    known: LevelStatistics, power: ComplexArray, model: _Model, families: Sequence[_Family]
) -> Iterator[_Scored]:
    """Score every family, and no change at all, for machines of some cross-powers (K, 3, 3)."""
    levels = known.levels
    # With no change, and with changes that move single levels far: levels that noise hides say nothing of either.
    used = np.asarray(known.deviations.std(axis=0) < MOST_SCATTER_DB) & (
        10.0 ** (0.1 * levels.measured) > LEAST_SIGNAL * levels.noise
    )
    if used.sum() < LEAST_LEVELS:
        return
    by_gain = _by_gain(levels, power)[used]
    more = by_gain @ by_gain.T * GAIN_SCATTER**2
    covariance = known.covariance(used) + more
    own_size = float(np.linalg.slogdet(covariance)[1])
    before = levels.of_motion(power)
    away = (levels.measured - known.mean)[used]

    def distance(changed: ComplexArray) -> FloatArray:
        shift = (levels.of_motion(changed) - before)[..., used]
        left = away - shift
        spread = covariance + (SHIFT_ERROR * shift[..., None]) ** 2 * np.eye(len(away))
        size = np.linalg.slogdet(spread)[1] - own_size
        return np.asarray(np.sum(left * np.linalg.solve(spread, left[..., None])[..., 0], axis=-1) + size)

    none = float(distance(power))
    penalty = 0.5 * math.log(float(used.sum()))
    yield _Scored(None, -0.5 * none / TEMPERATURE, np.zeros(0))
    starts = []
    for family in families:
        every = distance(np.array([family.changed(power, model.motion, numbers) for numbers in family.starts]))
        best = int(np.argmin(every))
        starts.append((float(every[best]), family, family.starts[best]))
    starts.sort(key=lambda start: start[0])
    for rank, (found, family, numbers) in enumerate(starts):
        if rank < SEARCHED:
            off = _Misfit(family, power, model.motion, distance)
            least = 1e-3 * float(np.abs(numbers).max())
            searched = minimize(
                off, numbers, method="Nelder-Mead", options={"xatol": least, "fatol": 0.1, "maxfev": 120}
            )
            found, numbers = float(searched.fun), np.asarray(searched.x, np.float64)
        explained = found <= MOST_LEFT * none or known.p_value(found, used, more) >= EXPLAINED
        gain = 0.5 * (none - found) / TEMPERATURE - penalty * len(numbers)
        evidence = gain - 0.5 * none / TEMPERATURE
        yield _Scored(family, evidence, numbers, explained and gain >= LEAST_GAIN)


@dataclass(frozen=True, eq=False)
class _Misfit:
    """How far off the members of a family are, as a function of their numbers."""

    family: _Family
    power: ComplexArray
    motion: ComplexArray
    distance: Callable[[ComplexArray], FloatArray]

    def __call__(self, numbers: FloatArray) -> float:
        changed = self.family.changed(self.power, self.motion, numbers)
        return float(self.distance(changed)) + self.family.oddity(numbers)


def _by_gain(levels: OrderLevels, power: ComplexArray) -> FloatArray:
    """Derivatives (m, s) of levels by the gains of the sensors, dB for a unit of their logarithm."""
    small = 1e-4
    here = levels.of_motion(power)
    gains = np.exp(small * np.eye(levels.sensors))
    return np.array([(levels.of_motion(power, row) - here) / small for row in gains]).T


def _ranked(scored: Sequence[_Scored]) -> tuple[NamedCause, ...]:
    """Causes that are named, by probability; of those of one name the best counts."""
    best: dict[str, _Scored] = {}
    for each in scored:
        name = each.family.name if each.family else ""
        if name not in best or each.evidence > best[name].evidence:
            best[name] = each
    evidences = np.array([each.evidence for each in best.values()])
    share = np.exp(evidences - logsumexp(evidences)) if len(evidences) else evidences
    found = []
    for (name, each), probability in zip(best.items(), share.tolist(), strict=True):
        family = each.family
        if family and each.named and probability >= LEAST_PROBABILITY:
            size, suspension = family.size(each.numbers), family.suspension(each.numbers)
            found.append(NamedCause(name, size, family.unit, probability, suspension))
    return tuple(sorted(found, key=lambda cause: -cause.probability))
