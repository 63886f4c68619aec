"""Members of an ensemble: where they start, and mean, spread and standard error of their spectra over blocks of time.

They start in the steady state of the healthy machine, which is cheap to simulate. A worn machine that starts there has
the motion of its suspension already, but for what the wear itself changes; what is left to wait for is the contact's
own transient.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.start import Start, start_with_frame, walk
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.machines.fault import HEALTHY
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.blocks import MOTIONS, BlockSpectra
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.harmonics import FLOOR_DB

#: dB per part by which a power changes.
_DB_PER_PART = 10 / math.log(10)
_TINY = np.finfo(np.float64).tiny
#: Blocks differ by more than their scatter explains if by this many times what it makes expect.
_BEYOND_SCATTER = 1.5


def decibels(power: FloatArray) -> FloatArray:
    """10 log10, with a floor instead of minus infinity."""
    return np.asarray(10 * np.log10(np.maximum(power, _TINY)))


def spread_db(power: FloatArray) -> FloatArray:
    """Standard deviation over members, along the first axis, of levels, dB."""
    return np.asarray(np.std(decibels(power), axis=0, ddof=1))


def standard_error_db(power: FloatArray) -> FloatArray:
    """Standard error of the mean power of members and blocks, as a level, dB.

    Parameters
    ----------
    power : (m, b, k, c) array
        Of `m` members in `b` blocks of time, at least two of each.

    Returns
    -------
    (k, c) array
        The larger of two estimates: between members over all blocks, which holds where one block resembles the next,
        and between blocks over all members, which holds where one member resembles the other.
    """
    members, blocks = power.shape[:2]
    mean = np.maximum(power.mean(axis=(0, 1)), _TINY)
    between_members = power.mean(axis=1).std(axis=0, ddof=1) / math.sqrt(members)
    between_blocks = power.mean(axis=0).std(axis=0, ddof=1) / math.sqrt(blocks)
    return np.asarray(_DB_PER_PART * np.maximum(between_members, between_blocks) / mean)


def overall(values_db: FloatArray, power: FloatArray) -> float:
    """Root mean square over bands (k, c) of the channel in which it is largest, dB; 0 where nothing moves.

    Bands far below the strongest of their channel are left out, as in :mod:`jointplay.solver.spectra.harmonics`.
    """
    largest = 0.0
    for column, levels in zip(values_db.T, power.T, strict=True):
        strongest = levels.max(initial=0.0)
        if strongest > 0:
            kept = levels > strongest * 10 ** (-FLOOR_DB / 10)
            largest = max(largest, float(np.sqrt(np.mean(column[kept] ** 2))))
    return largest


def has_settled(before: FloatArray, after: FloatArray, allowed_db: float) -> bool:
    """Whether the earlier of two successive blocks shows nothing more of a transient.

    Parameters
    ----------
    before, after : (m, k, c) arrays
        Powers of the members in either block.
    allowed_db : float
        Difference of the mean levels that is allowed in any case.
    """
    first, second = before.mean(axis=0), after.mean(axis=0)
    change = overall(decibels(first) - decibels(second), second)
    scatter = np.hypot(
        before.std(axis=0, ddof=1) / np.maximum(first, _TINY), after.std(axis=0, ddof=1) / np.maximum(second, _TINY)
    )
    expected = overall(_DB_PER_PART * scatter / math.sqrt(len(before)), second)
    return change <= max(allowed_db, _BEYOND_SCATTER * expected)


class Average:
    """Blocks of an ensemble as they come: the first are left out until one resembles the next.

    Parameters
    ----------
    allowed_db : float
        As for :func:`has_settled`.

    Attributes
    ----------
    dropped : int
        Blocks left out so far.
    """

    def __init__(self, allowed_db: float) -> None:
        self.dropped = 0
        self._allowed = allowed_db
        self._waiting: BlockSpectra | None = None
        self._members: tuple[int, ...] = ()
        self._bands: list[FloatArray] = []
        self._psd = np.zeros(0)

    @property
    def blocks(self) -> int:
        """Blocks averaged."""
        return len(self._bands)

    @property
    def seen(self) -> int:
        """Blocks taken: averaged, left out, or waiting for another like it."""
        return self.blocks + self.dropped + (self._waiting is not None)

    @property
    def bands(self) -> FloatArray:
        """Powers in bands, (members, blocks, k, c)."""
        return np.stack(self._bands, axis=1)

    @property
    def psd(self) -> FloatArray:
        """Mean densities of the members, (members, n, c)."""
        return self._psd / len(self._bands)

    def error(self) -> float:
        """Standard error of the levels of the frame's motions, see :func:`overall`; infinite before there are two."""
        if self.blocks < 2:
            return math.inf
        bands = self.bands[..., : len(MOTIONS)]
        return overall(standard_error_db(bands), bands.mean(axis=(0, 1)))

    def take(self, block: BlockSpectra) -> None:
        """Take the next block; members that are not in it are left out of the earlier ones too."""
        if self._members and block.members != self._members:
            rows = [self._members.index(member) for member in block.members]
            self._bands = [bands[rows] for bands in self._bands]
            self._psd = self._psd[rows] if self._bands else self._psd
            self._waiting = self._waiting and self._waiting.of(block.members)
        self._members = block.members
        if self._bands:
            self._add(block)
        elif self._waiting is None:
            self._waiting = block
        elif has_settled(self._waiting.bands[..., : len(MOTIONS)], block.bands[..., : len(MOTIONS)], self._allowed):
            self._add(self._waiting)
            self._add(block)
            self._waiting = None
        else:
            self.dropped += 1
            self._waiting = block

    def finish(self) -> bool:
        """Take what still waits for another block like it; whether nothing did."""
        if self._waiting is None:
            return True
        self._add(self._waiting)
        self._waiting = None
        return False

    def _add(self, block: BlockSpectra) -> None:
        self._psd = self._psd + block.psd if self._bands else block.psd
        self._bands.append(block.bands)


#: Samples of the healthy machine in a revolution: phases are met to a degree.
PHASES = 360
#: The healthy machine runs for so many times its transient, so that a ten-thousandth of that is left.
_PATIENCE = 2.0


def healthy_revolution(machine: Machine, case: Case, settings: Settings) -> History:
    """The last revolution of the healthy machine, :data:`PHASES` samples, after its transient.

    Parameters
    ----------
    machine : Machine
    case : Case
        Its fault is left out; its parameters count.
    settings : Settings
        Accuracy and method.

    Returns
    -------
    History
        Of status ok, or of the one that says why there is no steady state.

    Raises
    ------
    SettingsError
        A machine that does not come round.
    """
    healthy = replace(case, fault=HEALTHY)
    short = simulate(machine, healthy, replace(settings, duration=1e-3, links=False))
    if short.status is not Status.OK:
        return short
    revolution = 1 / repeating_frequency(machine, short.drive_speed)
    revolutions = math.ceil(_PATIENCE * short.transient / revolution - 1e-9) + 1
    found = simulate(
        machine, healthy,
        replace(settings, duration=revolutions * revolution, sample_rate=PHASES / revolution, links=False, step=None),
    )  # fmt: skip
    last = slice(-PHASES - 1, -1)
    return replace(
        found, t=found.t[last], displacement=found.displacement[last], velocity=found.velocity[last],
        acceleration=found.acceleration[last], band_limited_acceleration=found.band_limited_acceleration[last],
        modes=found.modes and found.modes[last],
    )  # fmt: skip


def starts_at(
    machine: Machine,
    case: Case,
    settings: Settings,
    phases: Sequence[int],
    displacement: FloatArray,
    velocity: FloatArray,
) -> list[Start]:
    """Starts of a worn machine at given angles of its drive with its frame moving as given.

    Pins are concentric, and velocities the least mass-weighted that fulfil closures and drive.

    Parameters
    ----------
    machine : Machine
    case : Case
    settings : Settings
    phases : (m,) sequence of int
        Where in the revolution, in parts of :data:`PHASES`; the start's time is that part of the first revolution.
    displacement, velocity : (m, 3 or more) arrays
        Of the frame (m, m, rad), then of its modes.

    Raises
    ------
    AssemblyError
        The machine does not close there.
    """
    group = next(groups(machine, [case], settings))
    for _, error in group.failed:
        raise error
    model, prepared = group.model, group.ready[0]
    poses = walk(model, prepared.vector, prepared.speed, PHASES)
    indices = (*model.frame_indices, *model.kinematics.modes)
    held = [column for column, index in enumerate(indices) if index is not None]
    return [
        start_with_frame(model, prepared.vector, *poses[phase], displacement[i, held], velocity[i, held])
        for i, phase in enumerate(phases)
    ]
