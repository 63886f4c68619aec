"""What one shard holds: the table of its cases and the spectra of those that went well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.plans.entry import Entry, Hypothesis, Recipe, Stratum
from jointplay.catalogue.plans.variants import Variant
from jointplay.catalogue.storage.cross_power import CYCLIC, pack, pack_cyclic, unpack, unpack_cyclic
from jointplay.solver.arrays import AnyComplexArray, FloatArray
from jointplay.solver.spectra.bands import FEATURE_ORDERS

OK = "ok"
"""Status of a case whose spectrum is stored."""


@dataclass(frozen=True, eq=False)
class CaseOutcome:
    """What became of one case.

    Parameters
    ----------
    status : str
        :data:`OK`, or what went wrong.
    message : str
        Details, one line; with status ok a remark, mostly empty.
    drive_speed : float
        rad/s.
    transient : float
        Start-up time left out of the estimate [s].
    segments : int
        Windows averaged; 0 without a spectrum.
    seconds : float
        Processor time of the simulation [s]; not stored with the case, so that equal cases give equal files.
    power : ndarray of complex, shape (B, 3, 3), optional
        Cross-power of the frame's acceleration in bands; only with status ok.
    spread_db : ndarray, shape (B, 3), optional
        Standard deviation of the band levels over the windows [dB]; only with status ok.
    cyclic : ndarray of complex, shape (G, k, 3, 3), optional
        Cyclic cross-power of the frame's acceleration in feature bands, phases against the drive's angle; only with
        status ok.
    guard_db : float, optional
        Mean difference of the band levels from those of the same case computed more finely [dB]; for the cases that
        were computed twice.
    period : int
        Revolutions after which the motion was seen to repeat: the spectrum then is that of one period. 0 where it
        was not: the spectrum is a mean, known as well as `spread_db` and `segments` say.
    """

    status: str
    message: str
    drive_speed: float
    transient: float
    segments: int
    seconds: float
    power: AnyComplexArray | None = None
    spread_db: NDArray[np.floating] | None = None
    cyclic: AnyComplexArray | None = None
    guard_db: float | None = None
    period: int = 0


@dataclass(frozen=True)
class ShardHeader:
    """What all cases of a shard have in common; enough to make a catalogue of a single shard.

    Parameters
    ----------
    machine : str
        Canonical JSON of the machine.
    recipe : Recipe
        How the cases were computed.
    plan : mapping
        The plan that asked for them, as plain data.
    numbers_version : int
        :data:`jointplay.solver.NUMBERS_VERSION` of the program that computed them.
    versions : mapping of str to str
        Versions of Python, of this program and of the packages that shape the numbers.
    """

    machine: str
    recipe: Recipe
    plan: Mapping[str, Any]
    numbers_version: int
    versions: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Shard:
    """Cases of one hypothesis, stratum and variant, with the same joints and the same parameter names.

    Parameters
    ----------
    header : ShardHeader
    hypothesis : Hypothesis
    stratum : {"trusted", "wide"}
    variant : Variant
    speed : float
        Factor on the drive speed that the plan asked for.
    joints : tuple of str
        Joints with clearance, in alphabetical order.
    parameter_names : tuple of str
        Paths of the numbers that differ from the machine's file, in alphabetical order.
    key, status, message : tuple of str
        One a case.
    clearance : ndarray, shape (n, len(joints))
        Radial clearances [m].
    parameters : ndarray, shape (n, len(parameter_names))
        SI.
    draw, segments, period, row : ndarray of int, shape (n,)
        Number of the draw; windows averaged; revolutions after which the motion repeats, or 0; where
        the spectrum stands in `power`, -1 if there is none.
    drive_speed, transient, guard_db : ndarray, shape (n,)
        rad/s; s; dB, NaN for a case that was not computed twice.
    power : ndarray of float32, shape (m, B, 9)
        Packed by :func:`jointplay.catalogue.storage.cross_power.pack`.
    spread_db : ndarray of float32, shape (m, B, 3)
    cyclic : ndarray of float32, shape (m, G, 24)
        Packed by :func:`jointplay.catalogue.storage.cross_power.pack_cyclic`.
    """

    header: ShardHeader
    hypothesis: Hypothesis
    stratum: Stratum
    variant: Variant
    speed: float
    joints: tuple[str, ...]
    parameter_names: tuple[str, ...]
    key: tuple[str, ...]
    status: tuple[str, ...]
    message: tuple[str, ...]
    clearance: FloatArray
    parameters: FloatArray
    draw: NDArray[np.int32]
    segments: NDArray[np.int32]
    period: NDArray[np.int32]
    row: NDArray[np.int32]
    drive_speed: FloatArray
    transient: FloatArray
    guard_db: FloatArray
    power: NDArray[np.float32]
    spread_db: NDArray[np.float32]
    cyclic: NDArray[np.float32]

    @classmethod
    def of(cls, header: ShardHeader, entries: Sequence[Entry], outcomes: Sequence[CaseOutcome]) -> Shard:
        """Put cases and what became of them together; all entries have in common what a shard has."""
        joints, names = entries[0].joints, tuple(sorted(entries[0].parameters))
        good = [outcome.power is not None for outcome in outcomes]
        bands, groups = header.recipe.scheme.count, len(header.recipe.scheme.third_octave_groups(FEATURE_ORDERS)) - 1
        power = [pack(np.asarray(outcome.power)) for outcome in outcomes if outcome.power is not None]
        cyclic = [pack_cyclic(np.asarray(outcome.cyclic)) for outcome in outcomes if outcome.cyclic is not None]
        spread = [np.asarray(outcome.spread_db, np.float32) for outcome in outcomes if outcome.spread_db is not None]
        return cls(
            header=header,
            hypothesis=entries[0].hypothesis,
            stratum=entries[0].stratum,
            variant=entries[0].variant,
            speed=entries[0].speed,
            joints=joints,
            parameter_names=names,
            key=tuple(entry.key for entry in entries),
            status=tuple(outcome.status for outcome in outcomes),
            message=tuple(outcome.message for outcome in outcomes),
            clearance=np.array([entry.clearances for entry in entries], np.float64).reshape(len(entries), len(joints)),
            parameters=np.array([[entry.parameters[name] for name in names] for entry in entries], np.float64).reshape(
                len(entries), len(names)
            ),
            draw=np.array([entry.draw for entry in entries], np.int32),
            segments=np.array([outcome.segments for outcome in outcomes], np.int32),
            period=np.array([outcome.period for outcome in outcomes], np.int32),
            row=np.where(good, np.cumsum(good) - 1, -1).astype(np.int32),
            drive_speed=np.array([outcome.drive_speed for outcome in outcomes], np.float64),
            transient=np.array([outcome.transient for outcome in outcomes], np.float64),
            guard_db=np.array([outcome.guard_db for outcome in outcomes], np.float64),  # None becomes NaN
            power=np.array(power, np.float32).reshape(-1, bands, 9),
            spread_db=np.array(spread, np.float32).reshape(-1, bands, 3),
            cyclic=np.array(cyclic, np.float32).reshape(-1, groups, len(CYCLIC)),
        )

    def outcome(self, position: int) -> CaseOutcome:
        """What became of the case at a position; the processor time is not known."""
        row, guard = int(self.row[position]), float(self.guard_db[position])
        return CaseOutcome(
            status=self.status[position],
            message=self.message[position],
            drive_speed=float(self.drive_speed[position]),
            transient=float(self.transient[position]),
            segments=int(self.segments[position]),
            seconds=0.0,
            power=unpack(self.power[row]) if row >= 0 else None,
            spread_db=self.spread_db[row] if row >= 0 else None,
            cyclic=unpack_cyclic(self.cyclic[row]) if row >= 0 else None,
            guard_db=None if np.isnan(guard) else guard,
            period=int(self.period[position]),
        )

    @property
    def count(self) -> int:
        """Number of cases."""
        return len(self.key)

    def entry(self, position: int) -> Entry:
        """The case at a position of the table, with the key that was stored."""
        return Entry(
            key=self.key[position],
            hypothesis=self.hypothesis,
            joints=self.joints,
            clearances=tuple(self.clearance[position].tolist()),
            parameters=dict(zip(self.parameter_names, self.parameters[position].tolist(), strict=True)),
            draw=int(self.draw[position]),
            stratum=self.stratum,
            variant=self.variant,
            speed=self.speed,
            guarded=not np.isnan(self.guard_db[position]),
        )
