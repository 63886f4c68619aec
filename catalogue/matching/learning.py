"""Training sets from catalogues: which entries, seen through which sensors, with what added."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, Self

import numpy as np

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.matcher import DrawnFeatures, TrainingSet
from jointplay.catalogue.matching.modes import Mode
from jointplay.catalogue.matching.observation import PackedArray, Sensing, observe
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.transfer import RandomTransfer
from jointplay.catalogue.plans.entry import Hypothesis, Stratum
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray


class SpectraSource(Protocol):
    """What is learned from: :class:`jointplay.catalogue.storage.matrix.FeatureMatrix`, or anything that answers like
    it.
    """

    @property
    def id(self) -> str:
        """Of the state of the catalogue."""

    @property
    def cuts(self) -> tuple[int, ...]:
        """Edges of the feature bands in stored bands."""

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of the feature bands, orders of the drive."""

    nominal_speed: float
    """Drive speed of the machine's file, rad/s."""

    @property
    def speeds(self) -> tuple[float, ...]:
        """Factors on that speed which it has spectra at, rising."""

    def nearest_speed(self, speed: float) -> float:
        """The one of them that is nearest to a drive speed, rad/s."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Turning joints, the columns of :meth:`clearance`."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Those it has spectra of."""

    def rows(
        self, label: str, stratum: Stratum | None = None, *, draws: int | None = None, speed: float | None = None
    ) -> IntArray:
        """Rows of a hypothesis."""

    def individuals(self, rows: IntArray) -> IntArray:
        """Which machine each of some rows is of, (m,): entries at several speeds may be of one."""

    def in_order(self, rows: IntArray) -> IntArray:
        """Rows of the same machines in order on another day, (m,); -1 where there is none."""

    def packed(self, rows: IntArray) -> PackedArray:
        """Spectra of rows, (m, G, 33): :data:`jointplay.catalogue.storage.cross_power.COLUMNS`."""

    def clearance(self, rows: IntArray) -> FloatArray:
        """Radial clearances of rows, (m, joints), m."""


def band_widths(spectra: SpectraSource) -> FloatArray:
    """Return the widths (G,) of the feature bands at the machine's own drive speed, Hz."""
    widths: FloatArray = np.diff(spectra.edges) * abs(spectra.nominal_speed) / (2.0 * np.pi)
    return widths


WIDE_SHARE = 2.0 / 3.0
"""Part of the draws of the robust mode that come from machines whose own data are uncertain, where there are such."""


@dataclass(frozen=True)
class Learning:
    """How a training set is made of a catalogue.

    Parameters
    ----------
    mode : {"trusted", "robust"}
        Whether the model is believed, see :meth:`of`.
    discrepancy : Discrepancy
        What is drawn on every copy of an entry.
    rows : int
        Rows of a hypothesis, at least: hypotheses with few entries get more copies of each.
    most : int
        Entries of a hypothesis that are learned from, at most: the first draws, which fill its range evenly.
    reach : int
        Entries of a hypothesis that a refit chooses from, at most: it takes those near the recording.
    without : tuple of str
        Hypotheses that are left out.
    seed : int
        Of everything drawn.
    subject : {"hypotheses", "since", "strata"}
        What a network learns to tell apart: hypotheses, by a recording alone or beside the machine's own past; or
        machines that are as in their file from those that are not.
    """

    mode: Mode = "trusted"
    discrepancy: Discrepancy = field(default_factory=Discrepancy)
    rows: int = 500
    most: int = 800
    # Models that are looked up do not depend on it, nor do their keys, which are made of what is shown.
    reach: int = field(default=8000, repr=False)
    without: tuple[str, ...] = ()
    seed: int = 0
    subject: Literal["hypotheses", "since", "strata"] = field(default="hypotheses", repr=False)

    @classmethod
    def of(cls, mode: Mode, *, without: tuple[str, ...] = (), most: int | None = None) -> Self:
        """How each mode learns.

        The trusted one believes the simulation to a decibel and the sensors to 3 %. The robust one learns from machines
        whose own data are uncertain, too, believes two decibels, and draws flexible modes that the rigid model does not
        have. With `most`, neither a looked-up model nor a refit sees any but the first draws, as if there were no more.
        """
        seen, reach = (cls.most, cls.reach) if most is None else (most, most)
        if mode == "trusted":
            return cls(mode, without=without, most=seen, reach=reach)
        robust = replace(
            Discrepancy(), gain=0.06, level_db=2.0, rigid_level_db=1.0, cyclic=0.1, transfer=RandomTransfer()
        )
        return cls(mode, robust, rows=800, without=without, most=seen, reach=reach)


def rows_of(matrix: SpectraSource, label: str, learning: Learning, speed: float | None = None) -> IntArray:
    """Return the rows of a hypothesis that are learned from, at the stored speed next to `speed` (rad/s)."""
    trusted = matrix.rows(label, "trusted", draws=learning.most, speed=speed)
    if learning.mode == "trusted":
        return trusted if len(trusted) else matrix.rows(label, "wide", draws=learning.most, speed=speed)
    wide = matrix.rows(label, "wide", draws=round(learning.most * WIDE_SHARE), speed=speed)
    if len(wide):
        trusted = trusted[: math.ceil(len(wide) * (1.0 / WIDE_SHARE - 1.0))]
    return np.concatenate([trusted, wide])


def training_set(
    matrix: SpectraSource,
    sensing: Sensing,
    watched: BoolArray,
    learning: Learning,
    *,
    rows: Mapping[str, IntArray] | None = None,
    speed: float | None = None,
    weights: FloatArray | None = None,
) -> TrainingSet:
    """Turn entries of a catalogue into feature vectors as the sensors would report them.

    Parameters
    ----------
    matrix : SpectraSource
    sensing : Sensing
        Of the measurement that is to be compared.
    watched : ndarray of bool, shape (features,)
        Features checked one by one, see :class:`TrainingSet`.
    learning : Learning
    rows : mapping of str to ndarray of int, optional
        Rows by hypothesis; only these hypotheses then. Those of :func:`rows_of` unless given.
    speed : float, optional
        Drive speed of the measurement, rad/s: which of the stored speeds is learned from, where there are several.
    weights : ndarray, shape (rows of the matrix,), optional
        How much each counts, > 0.

    Raises
    ------
    DiagnosisError
        The catalogue has no entry, or fewer than three of some hypothesis.
    """
    hypotheses = [known for known in matrix.hypotheses if known.label not in learning.without]
    if rows is not None:
        hypotheses = [known for known in hypotheses if known.label in rows]
    if not hypotheses:
        raise DiagnosisError("catalogue: holds no spectrum yet")
    edges_hz = np.array(matrix.edges) * abs(matrix.nominal_speed) / (2.0 * math.pi)
    most = max(len(known.joints) for known in matrix.hypotheses)
    sets = []
    for known in hypotheses:
        chosen = rows_of(matrix, known.label, learning, speed) if rows is None else rows[known.label]
        if sensing.past:
            chosen = with_past(matrix, chosen)
        if len(chosen) < 3:
            raise DiagnosisError(f"catalogue: {len(chosen)} entries of hypothesis {known.label}: at least 3 needed")
        copies = np.full(len(chosen), math.ceil(learning.rows / len(chosen)), dtype=np.int64)
        # What is drawn for one hypothesis does not depend on which others there are.
        seed = (learning.seed, zlib.crc32(known.label.encode()))
        past = matrix.packed(matrix.in_order(chosen)) if sensing.past else None
        features, entry = observe(
            matrix.packed(chosen), sensing, learning.discrepancy, copies, seed, edges_hz, past=past
        )
        weight = None if weights is None else weights[chosen[entry]]
        log_clearance = _log_clearance(matrix, known.joints, chosen)[entry]
        prior = Prior().weight(known.joints, len(matrix.joints), most)
        machine = matrix.individuals(chosen)[entry]
        sets.append(DrawnFeatures(known.label, known.joints, features, log_clearance, machine, prior, weight))
    return TrainingSet(tuple(sets), watched, sensing.plain_count)


def with_past(matrix: SpectraSource, rows: IntArray) -> IntArray:
    """Return those of some rows whose machines were simulated in order, too."""
    return rows[matrix.in_order(rows) >= 0]


def _log_clearance(matrix: SpectraSource, joints: Sequence[str], rows: IntArray) -> FloatArray:
    columns = [matrix.joints.index(joint) for joint in joints]
    found: FloatArray = np.log(matrix.clearance(rows)[:, columns])
    return found
