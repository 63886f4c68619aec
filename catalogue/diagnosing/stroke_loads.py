"""A load of the process as two sizes, one for either stroke of the output link: on the rigid frame, and simulated.

It acts along the way of the output link: along its slide, or across the end of its arm, with which it turns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from jointplay.catalogue.diagnosing.baseline_levels import OrderLevels, class_statistics
from jointplay.catalogue.diagnosing.cause_families import Family, IdealFrame, Misfit, forces_of
from jointplay.catalogue.diagnosing.causes import TEMPERATURE, NamedCause
from jointplay.catalogue.diagnosing.frame_forces import FamilyWrench, Revolution, drive_angle, output_forces, split
from jointplay.catalogue.plans.driving import WEIGHT, load_scale
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import on_mounts
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import ForceDrive, Load

EDGE = math.radians(15.0)
"""Turn of the drive over which a load comes and goes: none begins at once."""

TABLE_ERROR = 0.01
"""Largest error of a table of unit forces: every row costs operations."""


@dataclass(frozen=True, eq=False)
class StrokeLoads:
    """Unit forces on the output link.

    Parameters
    ----------
    link : str
    at : (float, float)
        Where they act [m], in the drawing.
    angle : (n,) array
        Angles of the drive over one revolution, rising [rad].
    force : (2, n, 2) array
        On the stroke forward, and on that back [N].
    wrench : FamilyWrench
        What they do to the frame.
    """

    link: str
    at: tuple[float, float]
    angle: FloatArray
    force: FloatArray
    wrench: FamilyWrench

    @classmethod
    def of(cls, machine: Machine, speed: float) -> StrokeLoads | None:
        """Of a machine at a speed [rad/s]; None where no process loads it.

        Raises
        ------
        DiagnosisError
            The ideal machine does not come round.
        """
        slow = Revolution.of(machine, speed)
        found = output_forces(slow)
        if found is None:
            return None
        link, at, along, forward = found
        ahead = _soften(forward)[:, None] * along
        force = np.array([ahead, along - ahead])
        one, other = (
            np.array([revolution.force(link, at, each) for each in force])
            for revolution in (slow, replace(slow, speed=2.0 * speed))
        )
        family = FamilyWrench("load", "N", np.zeros((0, 2)), split(one, other, speed))
        angle = drive_angle(slow)
        order = np.argsort(angle)
        return cls(link, at, angle[order], force[:, order], family)

    def machine(self, base: Machine) -> Machine:
        """The machine with both loads behind its own, as tables whose factors are their sizes [N]."""
        loads = []
        for force in self.force:
            rows = _table(self.angle, force)
            loads.append(Load(link=self.link, at=self.at, over_angle=tuple((a, x, y, 0.0) for a, x, y in rows)))
        return base.model_copy(update={"loads": (*base.loads, *loads)})


def _soften(course: FloatArray) -> FloatArray:
    """A course (n,) over one revolution with edges that take their time."""
    width = max(1, round(EDGE / (2.0 * math.pi) * len(course)))
    window = np.zeros(len(course))
    window[np.arange(width) - width // 2] = 1.0 / width
    return np.asarray(np.fft.irfft(np.fft.rfft(course) * np.fft.rfft(window), len(course)))


def _table(angle: FloatArray, force: FloatArray) -> list[tuple[float, ...]]:
    """The fewest rows (angle, x, y) whose straight lines are a force (n, 2) over one revolution, as near as asked."""
    chosen, last = [0], len(angle) - 1
    while chosen[-1] < last:
        begin, end = chosen[-1], chosen[-1] + 1
        while end < last and _bend(angle[begin : end + 2], force[begin : end + 2]) < TABLE_ERROR:
            end += 1
        chosen.append(end)
    return [(float(angle[i]), *map(float, force[i])) for i in chosen]


def _bend(angle: FloatArray, force: FloatArray) -> float:
    """How far a force is from the straight line between its ends."""
    part = ((angle - angle[0]) / (angle[-1] - angle[0]))[:, None]
    return float(np.abs(force[0] + part * (force[-1] - force[0]) - force).max())


#: What loads usually are (standard deviation), as a multiple of the weight of the moving links, and in machines that
#: move slowly no more than so large a part of the force that plans compare loads with: nothing else is known of a
#: constant force along a slide. And the largest that is looked for, in these standard deviations.
USUAL_LOAD, PART_OF_PLANS, MOST_LOAD = 4.0, 0.5, 2.5
#: What the sizes on both strokes have in common, and by how much the one forward is larger.
COMMON, DIFFERENCE = np.array([0.5, 0.5]), np.array([1.0, -1.0])
#: Sizes on either stroke that are looked at, and how often again, more closely around the likely ones.
GRID, ZOOMS = 17, 5
#: How much wider loads are drawn than a rigid frame says, as a factor and as a part of them: play moves it, too.
WIDER, SHARE = 1.5, 0.1
#: A load is told from so many standard deviations on.
SURELY = 3.0


@dataclass(frozen=True, eq=False)
class FoundLoad:
    """What recordings say of the loads on both strokes: a normal law.

    Parameters
    ----------
    loads : StrokeLoads
    paths : (str, str)
        Of their sizes in the machine that carries them.
    mean : (2,) array
        N.
    covariance : (2, 2) array
        N^2.
    wider : float
        How much wider loads are drawn, as a factor.
    """

    loads: StrokeLoads
    paths: tuple[str, str]
    mean: FloatArray
    covariance: FloatArray
    wider: float = WIDER

    def machine(self, base: Machine) -> Machine:
        """The machine with both loads."""
        return self.loads.machine(base)

    def draw(self, normal: FloatArray) -> FloatArray:
        """Sizes (2,) [N] for two standard normal numbers."""
        spread = self.wider**2 * self.covariance + np.diag((SHARE * self.mean) ** 2)
        return np.asarray(self.mean + np.linalg.cholesky(spread) @ normal)

    def cause(self, probability: float) -> NamedCause | None:
        """It as a cause; None where it may be none at all.

        On a slide only the difference of the strokes shakes the frame: a force on one of them cannot be told from the
        opposite one on the other.
        """
        for name, parts in (("load on one stroke", DIFFERENCE), ("load", COMMON)):
            size, variance = float(parts @ self.mean), float(parts @ self.covariance @ parts)
            if size**2 > SURELY**2 * variance:
                return NamedCause(name, size, "N", probability)
        return None


def find_load(
    catalogue: Catalogue,
    shown: Sequence[tuple[PreparedMeasurement, str, float]],
    speed: float,
    *,
    takes_work: bool = False,
) -> FoundLoad | None:
    """Fit a load to the low orders of recordings, beside the wear that each is likely of.

    Parameters
    ----------
    catalogue : Catalogue
    shown : sequence of (PreparedMeasurement, str, float)
        Recordings, hypotheses whose machines of the catalogue the load acts on, and what each counts.
    speed : float
        Drive speed that the machine with the load is simulated at, rad/s.
    takes_work : bool
        Whether a load that would give work to the drive is none: levels can hardly tell one from its opposite.

    Returns
    -------
    FoundLoad or None
        None where the machine has no output, stands on more than mounts, or is driven by a force or by a motor that
        bears no load.

    Raises
    ------
    DiagnosisError
        The ideal machine does not come round at a recording's speed.
    """
    machine = catalogue.machine
    if not on_mounts(machine) or isinstance(machine.drive, ForceDrive):
        return None
    found = StrokeLoads.of(machine, speed)
    weight = WEIGHT * sum(link.mass or 0.0 for name, link in machine.links.items() if name != machine.frame)
    usual = min(USUAL_LOAD * weight, PART_OF_PLANS * load_scale(machine))
    if found is None or not usual:
        return None
    total, mean, square = 0.0, np.zeros(2), np.zeros((2, 2))
    for prepared, label, share in shown:
        levels, own = OrderLevels.of(prepared), math.copysign(prepared.drive_speed, speed)
        loads, known = StrokeLoads.of(machine, own), class_statistics(catalogue, levels, label)
        if loads is not None and known is not None:
            model = IdealFrame.of(machine, own)
            middle, spread = _fit(Misfit.of(known, model), forces_of(model, loads.wrench), usual, takes_work=takes_work)
            total += share
            mean = mean + share * middle
            square = square + share * (spread + np.outer(middle, middle))
    if not total:
        return None
    mean, first = mean / total, len(machine.loads)
    paths = (f"loads.{first}.over_angle", f"loads.{first + 1}.over_angle")
    return FoundLoad(found, paths, mean, square / total - np.outer(mean, mean))


def _fit(misfit: Misfit, family: Family, usual: float, *, takes_work: bool) -> tuple[FloatArray, FloatArray]:
    """Mean (2,) and covariance (2, 2) of the loads that explain a recording, which usually are so large [N]."""
    axis = np.linspace(-1.0, 1.0, GRID)
    offsets = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    # One of the two may be known much better than the other, so that the grid has their axes.
    to_sizes = np.linalg.inv(np.array([COMMON, DIFFERENCE]))
    middle, half = np.zeros(2), np.full(2, MOST_LOAD * usual)
    points, share = offsets, np.zeros(len(offsets))
    for _ in range(ZOOMS):
        points = middle + half * offsets
        sizes = points @ to_sizes.T
        off = np.concatenate([misfit.of_members([(family, part)])[0] for part in np.array_split(sizes, 4)])
        gives = np.where(takes_work & (points[:, 1] > 0.0), np.inf, 0.0)
        share = softmax(-0.5 * (off / TEMPERATURE + np.sum((sizes / usual) ** 2, axis=1)) - gives)
        middle = share @ points
        half = np.clip(4.0 * np.sqrt(share @ (points - middle) ** 2), 2.0 * half / (GRID - 1), half)
    away = (points - middle) @ to_sizes.T
    return to_sizes @ middle, (share[:, None] * away).T @ away
