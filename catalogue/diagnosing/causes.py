"""Causes other than play, each a family of one size: which of them explains the low orders of a recording, and how big.

A family changes what acts on the frame (unbalance, process load, ripple of the drive, mass of a link) or the frame and
its supports (mass, a mount, all mounts). What a change makes of the low orders of the catalogue's machines in order,
or of those that are worn as the recording's seems to be, is put beside the recording: levels of orders 1 to 20, with
what they scatter by, gains of sensors included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
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

#: Factors on the stiffness of mounts, from loose to twice as stiff; those next to 1 are within what rubber differs by.
STIFFNESSES = (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.3, 1.6, 2.0)
#: Factors on a mass.
MASSES = (0.5, 0.65, 0.8, 0.9, 1.1, 1.2, 1.35, 1.5, 2.0)
#: Mass times radius that turns with the drive, as a part of the moving mass times the length of the driven link.
UNBALANCES = tuple(np.geomspace(0.01, 1.0, 10).tolist())
#: Process loads, as multiples of the weight of the moving links.
LOADS = tuple(np.geomspace(0.2, 20.0, 12).tolist())
#: Orders and amplitudes [rad] of a ripple of the drive.
RIPPLES = ((1, 2, 3, 4, 6, 8, 12), tuple(np.geomspace(5e-4, 2e-2, 8).tolist()))
#: Phases of what turns or swings with the drive: what the recording does not know.
PHASES = tuple((2.0 * math.pi * np.arange(12) / 12).tolist())
#: Standard deviation, relative, of a sensor's gain.
GAIN_SCATTER = 0.03
#: P-value below which no family is named: none of them explains the low orders.
UNEXPLAINED = 0.01
#: What a family's evidence is divided by, as a logarithm: the forces on a rigid frame are no simulation of a machine
#: with play, and levels that err together are not as many as they look.
TEMPERATURE = 2.0
#: Probability below which a cause is not worth a line.
LEAST_PROBABILITY = 0.05
#: Entries of a worn hypothesis that stand for the recording's machine: those nearest in clearance.
NEAREST = 80


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
    """

    name: str
    size: float
    unit: str
    probability: float


@dataclass(frozen=True, eq=False)
class _Change:
    """One member of a family: the frame's motion before and after, orders (K, 3, 3), and what is added to it (K, 3)."""

    family: str
    size: float
    unit: str
    passed: ComplexArray | None = None
    added: ComplexArray | None = None


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
    speed = math.copysign(prepared.drive_speed, catalogue.recipe.nominal_drive_speed)
    model = _Model.of(machine, speed)
    changes = list(_changes(machine, model))
    scored: list[tuple[float, float, _Change | None]] = []
    for label, rows in (("healthy", None), *worn):
        known = class_statistics(catalogue, levels, label, rows)
        if known is not None:
            scored += _scored(catalogue, known, label, rows, model, changes)
    if not scored or max(p for _, p, _ in scored) < UNEXPLAINED:
        return ()
    return _ranked(scored)


@dataclass(frozen=True, eq=False)
class _Model:
    """The machine as filed: motion (K, 3) of its ideal frame, its accelerance (K, 3, 3), and a revolution of links."""

    revolution: Revolution
    frequency: FloatArray
    accelerance: ComplexArray
    motion: ComplexArray

    @classmethod
    def of(cls, machine: Machine, speed: float) -> _Model:
        revolution = Revolution.of(machine, speed)
        frequency = np.arange(1.0, FEATURE_ORDERS + 1.0) * (abs(speed) / (2.0 * math.pi))
        own = accelerance(machine, {}, frequency)
        return cls(revolution, frequency, own, _moved(own, revolution.inertial()))

    def added(self, wrench: FloatArray) -> ComplexArray:
        """What a further wrench (n, 3) adds to the frame's motion."""
        return _moved(self.accelerance, wrench)


def _moved(accelerance: ComplexArray, wrench: FloatArray) -> ComplexArray:
    return np.asarray(np.einsum("kij,kj->ki", accelerance, wrench_orders(wrench, len(accelerance))), np.complex128)


def _changes(machine: Machine, model: _Model) -> Iterator[_Change]:
    """All members of all families."""
    inverse = np.linalg.inv(model.accelerance)
    mounts = [index for index, support in enumerate(machine.supports) if isinstance(support, Mount)]
    for name, group in [*((f"mount {index}", [index]) for index in mounts), ("all mounts", mounts)]:
        for factor in STIFFNESSES:
            changed = accelerance(machine, _mounts(machine, group, factor), model.frequency)
            yield _Change(name, factor, "x stiffness", passed=changed @ inverse)
    for factor in MASSES:
        numbers = {
            f"links.{machine.frame}.{part}": factor * (getattr(machine.links[machine.frame], part) or 0.0)
            for part in ("mass", "inertia")
        }
        changed = accelerance(machine, numbers, model.frequency)
        yield _Change(f"mass of {machine.frame}", factor, "x mass", passed=changed @ inverse)
    revolution = model.revolution
    own = revolution.inertial()
    for link in revolution.links:
        for factor in MASSES:
            added = model.added(revolution.inertial({link: factor}) - own)
            yield _Change(f"mass of {link}", factor, "x mass", added=added)
    yield from _unbalances(machine, model)
    yield from _loads(machine, model)
    orders, amplitudes = RIPPLES
    small = 1e-4
    for order in orders:
        sine = (model.added(revolution.rippled(order, small, 0.0)) - model.motion) / small
        cosine = (model.added(revolution.rippled(order, 0.0, small)) - model.motion) / small
        for amplitude in amplitudes:
            for phase in PHASES:
                added = amplitude * (math.sin(phase) * sine + math.cos(phase) * cosine)
                yield _Change(f"ripple of the drive, order {order}", amplitude, "rad", added=added)


def _mounts(machine: Machine, group: Sequence[int], factor: float) -> dict[str, float]:
    """Numbers of mounts whose stiffness has a factor, and whose damping has its root."""
    found: dict[str, float] = {}
    for index in group:
        mount = machine.supports[index]
        assert isinstance(mount, Mount)
        for axis in (0, 1):
            found[f"supports.{index}.stiffness.{axis}"] = factor * mount.stiffness[axis]
            found[f"supports.{index}.damping.{axis}"] = math.sqrt(factor) * mount.damping[axis]
    return found


def _unbalances(machine: Machine, model: _Model) -> Iterator[_Change]:
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    driven = next((name for name in joint.links if name != machine.frame), None)
    if machine.frame not in joint.links or driven is None:
        return  # what turns does not turn on the frame
    others = [each.at for each in machine.joints.values() if isinstance(each, TurningJoint) and driven in each.links]
    length = max(math.dist(joint.at, at) for at in others)
    moving = sum(machine.links[name].mass or 0.0 for name in model.revolution.links)
    for share in UNBALANCES:
        for phase in PHASES:
            product = share * moving * length
            added = model.added(model.revolution.rotating(joint.at, product, phase))
            yield _Change("unbalance", product, "kg m", added=added)


def _loads(machine: Machine, model: _Model) -> Iterator[_Change]:
    """Loads of the process on the output link: constant, and over either half of its way."""
    place = output_load(machine)
    if place is None:
        return
    revolution = model.revolution
    weight = 9.81 * sum(machine.links[name].mass or 0.0 for name in revolution.links)
    forward = revolution.velocity(place.link, place.direction) > 0.0
    courses = {"load": np.ones(len(forward)), "load on one stroke": 1.0 * forward, "load on the other": 1.0 * ~forward}
    for name, course in courses.items():
        for multiple in LOADS:
            for size in (multiple * weight, -multiple * weight):
                force = size * course[:, None] * np.array(place.direction)
                torque = size * course * place.arm
                added = model.added(revolution.force(place.link, place.at, force, torque))
                yield _Change(name.replace("the other", "one stroke"), size, "N", added=added)


def _scored(
    catalogue: Catalogue,
    known: LevelStatistics,
    label: str,
    rows: IntArray | None,
    model: _Model,
    changes: Sequence[_Change],
) -> list[tuple[float, float, _Change | None]]:
    """Log evidence, p-value and change of every member, and of no change at all, for machines of one hypothesis."""
    levels = known.levels
    chosen = catalogue.matrix.rows(label, "trusted") if rows is None else rows
    power = catalogue.matrix.cross_power(chosen)[:, :FEATURE_ORDERS].mean(axis=0)
    before = levels.of_motion(power)
    # With no change, and with changes that move single levels far: levels that noise hides say nothing of either.
    used = np.asarray(known.deviations.std(axis=0) < MOST_SCATTER_DB) & (
        10.0 ** (0.1 * levels.measured) > LEAST_SIGNAL * levels.noise
    )
    if used.sum() < LEAST_LEVELS:
        return []
    by_gain = _by_gain(levels, power)[used]
    more = by_gain @ by_gain.T * GAIN_SCATTER**2
    weight = np.linalg.inv(known.covariance(used) + more)
    found: list[tuple[float, float, _Change | None]] = []
    for change in (None, *changes):
        shift = np.zeros_like(before) if change is None else levels.of_motion(_changed(power, model, change)) - before
        away = (levels.measured - known.mean - shift)[used]
        found.append((float(away @ weight @ away), 0.0, change))
    best = min(range(len(found)), key=lambda place: found[place][0])
    p_value = known.p_value(found[best][0], used, more)
    return [(-0.5 * distance / TEMPERATURE, p_value, change) for distance, _, change in found]


#: A level counts where entries scatter by no more than this [dB], and it has this many times the power of the noise.
MOST_SCATTER_DB = 4.0
LEAST_SIGNAL = 2.0
#: Fewest levels that a change is told from others by.
LEAST_LEVELS = 12


def _changed(power: ComplexArray, model: _Model, change: _Change) -> ComplexArray:
    """Cross-powers (K, 3, 3) of the frame's motion after a change; powers are mean squares, twice |amplitude|^2."""
    if change.added is not None:
        new, own = change.added[:, :, None], model.motion[:, :, None]
        cross = own @ new.conj().swapaxes(1, 2)
        power = power + 2.0 * (cross + cross.conj().swapaxes(1, 2) + new @ new.conj().swapaxes(1, 2))
    if change.passed is not None:
        power = change.passed @ power @ change.passed.conj().swapaxes(1, 2)
    return power


def _by_gain(levels: OrderLevels, power: ComplexArray) -> FloatArray:
    """Derivatives (m, s) of levels by the gains of the sensors, dB for a unit of their logarithm."""
    small = 1e-4
    here = levels.of_motion(power)
    gains = np.exp(small * np.eye(levels.sensors))
    return np.array([(levels.of_motion(power, row) - here) / small for row in gains]).T


def _ranked(scored: Sequence[tuple[float, float, _Change | None]]) -> tuple[NamedCause, ...]:
    """Families by probability: members of a family share its weight, and no change has that of a family."""
    families: dict[str, list[tuple[float, _Change | None]]] = {}
    for evidence, _, change in scored:
        families.setdefault(change.family if change else "", []).append((evidence, change))
    names = list(families)
    evidences = np.array(
        [logsumexp([each for each, _ in families[name]]) - math.log(len(families[name])) for name in names]
    )
    share = np.exp(evidences - logsumexp(evidences))
    found = []
    for name, probability in zip(names, share.tolist(), strict=True):
        _, best = max(families[name], key=lambda member: member[0])
        if best is not None and probability >= LEAST_PROBABILITY:
            found.append(NamedCause(name, best.size, best.unit, probability))
    return tuple(sorted(found, key=lambda cause: -cause.probability))
