"""Causes other than play: which family of them explains the low orders of a recording, and with what size.

What a change makes of the low orders of the catalogue's machines in order,
or of those that are worn as the recording's seems to be, is put beside the recording: levels of orders 1 to 20, with
what they scatter by, gains of sensors included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import logsumexp

from catalogue.diagnosing.baseline_levels import DECIBELS, LevelStatistics, OrderLevels, class_statistics
from catalogue.diagnosing.cause_families import Family, IdealFrame, families_of, power_of
from catalogue.signals.prepared import PreparedMeasurement
from catalogue.signals.suspension import on_mounts
from catalogue.storage.feature_bands import FEATURE_ORDERS
from catalogue.storage.store import Catalogue

__all__ = ["NamedCause", "name_causes"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ComplexArray = npt.NDArray[np.complex128]

#: Standard deviation, relative, of a sensor's gain.
GAIN_SCATTER = 0.03
#: What a change that shifts a level is not better known to than, as a part of the shift.
SHIFT_ERROR = 0.1
#: What a level is not better known to after a change, dB, as far as the ideal machine does not explain it before: links
#: that move with a frame that moves, and play, do not go with its motion as forces on a rigid body do.
STRANGE_DB = 3.0
#: What evidence is divided by, as a logarithm: the forces on a rigid frame are no simulation of a machine with play,
#: and levels that err together are not as many as they look.
TEMPERATURE = 2.0
#: A cause is named where it has this probability,
LEAST_PROBABILITY = 0.05
#: and where it leaves no more than this part of what the machine as filed leaves unexplained, or fits as well as this.
MOST_LEFT = 0.35
EXPLAINED = 0.01
#: Families that are searched beyond their starts: the best so many,
SEARCHED = 5
#: where one of the starts is no more than so much less likely (ln) than no change: half of the time of a recording of a
#: machine as filed, and the answers to eighteen of machines that had changed were the same without it.
HOPELESS = 5.0
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


def name_causes(
    prepared: PreparedMeasurement,
    catalogue: Catalogue,
    worn: Sequence[tuple[str, IntArray]] = (),
    *,
    least_gain: float,
    small: bool,
) -> tuple[NamedCause, ...]:
    """Say which change other than play explains the low orders of a recording.

    Parameters
    ----------
    prepared : PreparedMeasurement
    catalogue : Catalogue
    worn : sequence of (label, rows)
        Worn machines that the recording's may be, besides those in order: hypothesis and nearest entries.
    least_gain : float
        How much likelier than none (ln) a cause must be.
    small : bool
        Whether anything is named where what explains best is a change smaller than any that a search starts from.

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
    model = IdealFrame.of(machine, math.copysign(prepared.drive_speed, catalogue.recipe.nominal_drive_speed))
    families = tuple(families_of(machine, model))
    scored: list[_Scored] = []
    for label, rows in (("healthy", None), *worn):
        known = class_statistics(catalogue, levels, label, rows)
        if known is not None:
            chosen = catalogue.matrix.rows(label, "trusted") if rows is None else rows
            power = catalogue.matrix.cross_power(chosen)[:, :FEATURE_ORDERS].mean(axis=0)
            scored += _scored(known, power, model, families, least_gain)
    best = max(scored, key=lambda each: each.evidence, default=None)
    return () if best is not None and best.is_small and not small else _ranked(scored)


@dataclass(frozen=True, eq=False)
class _Scored:
    """The best member of a family, and whether it may be named; no family where nothing was changed."""

    family: Family | None
    evidence: float
    numbers: FloatArray
    named: bool = False

    @property
    def is_small(self) -> bool:
        """Whether this is a change, and less of one than the smallest that a search starts from."""
        if self.family is None:
            return False
        return bool(np.linalg.norm(self.numbers) < np.linalg.norm(self.family.starts, axis=1).min())


def _scored(
    known: LevelStatistics, power: ComplexArray, model: IdealFrame, families: Sequence[Family], least_gain: float
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
    strange = _seen(levels, power - power_of(model.motion))
    unsure = (STRANGE_DB * np.minimum(1.0, strange * 10.0 ** (-0.1 * before))) ** 2

    def distance(changed: ComplexArray, added: ComplexArray, less_sure: FloatArray = unsure) -> FloatArray:
        after = levels.of_motion(changed)
        shift = (after - before)[..., used]
        left = away - shift
        # What the ideal machine does not explain of the motion meets what is added at a phase that nobody knows.
        meeting = 2.0 * DECIBELS**2 * strange * _seen(levels, added) * 10.0 ** (-0.2 * after)
        spread = covariance + ((SHIFT_ERROR * shift) ** 2 + (meeting + less_sure)[..., used])[..., None] * np.eye(
            len(away)
        )
        size = np.linalg.slogdet(spread)[1] - own_size
        return np.asarray(np.sum(left * np.linalg.solve(spread, left[..., None])[..., 0], axis=-1) + size)

    none = float(distance(power, np.zeros_like(power), np.zeros_like(unsure)))
    penalty = 0.5 * math.log(float(used.sum()))
    yield _Scored(None, -0.5 * none / TEMPERATURE, np.zeros(0))
    starts = []
    for family in families:
        every = distance(
            np.array([family.changed(power, model.motion, numbers) for numbers in family.starts]),
            np.array([family.added(numbers) for numbers in family.starts]),
        )
        best = int(np.argmin(every))
        starts.append((float(every[best]), family, family.starts[best]))
    starts.sort(key=lambda start: start[0])
    if starts[0][0] > none + 2.0 * TEMPERATURE * HOPELESS:
        return
    for rank, (found, family, numbers) in enumerate(starts):
        if rank < SEARCHED:
            off = _Misfit(family, power, model.motion, distance)
            least = 1e-3 * float(np.abs(numbers).max())
            searched = minimize(
                off, numbers, method="Nelder-Mead", options={"xatol": least, "fatol": 0.1, "maxfev": 120}
            )
            found, numbers = float(searched.fun), np.asarray(searched.x, np.float64)
        gain = 0.5 * (none - found) / TEMPERATURE - penalty * len(numbers)
        named = gain >= least_gain and (found <= MOST_LEFT * none or known.p_value(found, used, more) >= EXPLAINED)
        yield _Scored(family, gain - 0.5 * none / TEMPERATURE, numbers, named)


@dataclass(frozen=True, eq=False)
class _Misfit:
    """How far off the members of a family are, as a function of their numbers."""

    family: Family
    power: ComplexArray
    motion: ComplexArray
    distance: Callable[[ComplexArray, ComplexArray], FloatArray]

    def __call__(self, numbers: FloatArray) -> float:
        changed = self.family.changed(self.power, self.motion, numbers)
        return float(self.distance(changed, self.family.added(numbers))) + self.family.oddity(numbers)


def _seen(levels: OrderLevels, power: ComplexArray) -> FloatArray:
    """What the sensors see (..., m) of a motion's cross-powers (..., K, 3, 3), without noise, at least nothing."""
    return np.asarray(np.maximum(10.0 ** (0.1 * levels.of_motion(power)) - levels.noise, 0.0))


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
