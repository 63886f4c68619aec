"""Members of an ensemble side by side: advanced together, their motion cut into blocks, a spectrum of each block."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.cases.start import Start
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine, has_known_effort
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import BandScheme
from jointplay.solver.spectra.by_angle import resample_by_angle
from jointplay.solver.spectra.sampling import PASS
from jointplay.solver.spectra.segments import revolution_segments
from jointplay.solver.spectra.spectrum import frame_units

MOTIONS = ("x", "y", "theta")
#: Highest order with a band of its own, if the sample rate allows.
HIGHEST_ORDER = 200
#: Revolutions from one block to the next, and those that a block looks at: four windows of three, two of four.
BLOCK, SEEN = 4, 6
#: Windows may be a little longer than their revolutions:
#: :data:`jointplay.solver.spectra.segments.LENGTH_TOLERANCE`.
_SLACK = 0.02
#: Members of a machine that finds its own speed may be slower than the mean by this part.
_SLOWER = 0.01
_WINDOW = 4.0
#: Memory for histories at once and for the densities of one block, bytes: sums, spreads and the block that waits hold
#: some six times the latter.
HISTORY_BYTES, DENSITY_BYTES = 1.5e9, 0.5e9
#: Most blocks at once.
_TOGETHER = 16
#: Numbers that a run keeps for each sample of its history: time, four motions of the frame, records of three more of
#: which velocities are at twice the rate; or, where only spectra are wanted, one motion and the record of velocities.
#: Of each mode of the frame a third of that.
_WITH_MOTION, _WITHOUT_MOTION = 25, 10


def check_memory(machine: Machine, starts: int, sample_rate: float, speed: float) -> None:
    """Refuse an ensemble whose spectra or histories no memory would hold.

    Parameters
    ----------
    machine : Machine
    starts : int
    sample_rate : float
        Hz.
    speed : float
        Of the drive, rad/s.

    Raises
    ------
    SettingsError
        Names starts, or sample rate, and the bound.
    """
    revolution = 2 * math.pi / abs(speed)
    lines, channels = PASS * sample_rate * _WINDOW * revolution, len(MOTIONS) + len(machine.sensors)
    needed = 8 * lines * channels
    if 2 * needed > DENSITY_BYTES or SEEN * sample_rate * revolution * _bytes_a_sample(machine) > HISTORY_BYTES:
        what = f"too many samples, {sample_rate * revolution:.3g} a revolution, for spectra in orders"
        raise SettingsError(f"sample rate: {sample_rate:g} Hz: {what}; take a lower one")
    if starts * needed > DENSITY_BYTES:
        what = f"spectra of {lines:.3g} lines in {channels} channels each need over {DENSITY_BYTES / 1e9:g} GB"
        most = math.floor(DENSITY_BYTES / needed)
        raise SettingsError(f"starts: {starts}: {what}; take at most {most}, or a lower sample rate")


def _bytes_a_sample(machine: Machine) -> int:
    # Sensors see where the frame stands, and drivers where they stand; its centre of gravity needs accelerations only.
    with_motion = machine.sensors or has_known_effort(machine)
    return 8 * (_WITH_MOTION if with_motion else _WITHOUT_MOTION) * (3 + len(machine.modes)) // 3


@dataclass(frozen=True, eq=False)
class BlockSpectra:
    """Of one block: who is in it, their powers in one-order bands, (m, k, c), and their densities, (m, n, c)."""

    members: tuple[int, ...]
    bands: FloatArray
    psd: FloatArray

    def of(self, members: Sequence[int]) -> BlockSpectra:
        """Only of these members, which must be among those here."""
        rows = [self.members.index(member) for member in members]
        return BlockSpectra(tuple(members), self.bands[rows], self.psd[rows])


class _BlockSpectra(NamedTuple):
    """Of one member in one block: powers in bands, (k, c), and densities, (n, c)."""

    bands: FloatArray
    psd: FloatArray


class Members:
    """Runs of one case that go on from where they stood.

    Parameters
    ----------
    machine : Machine
    case : Case
    settings : Settings
    starts : sequence of Start
    speed : float
        Of the drive, rad/s.
    by_angle : int, optional
        Samples of a revolution, where orders are by each member's own angle of its driver.

    Attributes
    ----------
    alive : list of int
        Members that have not failed.
    failures : dict of int to History
    revolutions : float
        That each of them has run.
    seconds : float
        Processor time.
    """

    def __init__(
        self, machine: Machine, case: Case, settings: Settings, starts: Sequence[Start], speed: float,
        by_angle: int | None = None,
    ) -> None:  # fmt: skip
        self.alive = list(range(len(starts)))
        self.failures: dict[int, History] = {}
        self.revolutions = 0.0
        self.seconds = 0.0
        self.speed = abs(speed)
        base = self.speed / (2 * math.pi)
        count = min(HIGHEST_ORDER, math.floor(PASS * settings.sample_rate / base - 0.5))
        if count < 1:
            raise SettingsError(f"sample rate: {settings.sample_rate:g} Hz: too low for orders of a {base:g} Hz drive")
        self.orders = np.arange(1, count + 1, dtype=np.float64)
        self.channels = (*MOTIONS, *(sensor.name for sensor in machine.sensors))
        self.units = (*frame_units(MOTIONS, "acceleration"), *("m/s2" for _ in machine.sensors))
        self.frequency = np.zeros(0)
        self._scheme = BandScheme(tuple(order + 0.5 for order in range(count + 1)), count)
        self._machine, self._case = machine, case
        self._settings = replace(settings, links=False, motion=bool(machine.sensors))
        self._bytes = _bytes_a_sample(machine) * settings.sample_rate * 2 * math.pi / self.speed  # of a revolution
        self._states = list(starts)
        self._by_angle = by_angle

    def blocks(self, skipped: float, count: int) -> list[BlockSpectra]:
        """Advance all members, leave out `skipped` revolutions, and give the spectra of `count` blocks.

        A member that fails on the way is in none of them and takes no further part; there are none without two left.
        Histories live only until their spectra are taken: members run in groups that memory holds.
        """
        revolutions = skipped + (count - 1) * BLOCK + SEEN + _SLACK
        group = max(1, int(HISTORY_BYTES / (self._bytes * revolutions)))
        if group > LANES:
            group -= group % LANES
        everyone = list(self.alive)
        spectra: list[list[_BlockSpectra]] = [[] for _ in range(count)]
        for first in range(0, len(everyone), group):
            for history in self._advance(everyone[first : first + group], revolutions):
                for block, found in enumerate(spectra):
                    found.append(self._spectra(history, skipped + block * BLOCK))
        self.revolutions += revolutions
        if len(self.alive) < 2:
            return []
        return [
            BlockSpectra(
                tuple(self.alive), np.array([one.bands for one in found]), np.array([one.psd for one in found])
            )
            for found in spectra
        ]

    def at_once(self, skipped: float) -> int:
        """Most blocks to ask :meth:`blocks` for: memory holds their densities, and histories that fill the lanes."""
        revolutions = HISTORY_BYTES / (self._bytes * min(len(self.alive), LANES))
        lines = PASS * self._settings.sample_rate * _WINDOW * 2 * math.pi / self.speed
        densities = DENSITY_BYTES / (8 * lines * len(self.channels) * max(1, len(self.alive)))
        return max(1, min(_TOGETHER, int(densities), int((revolutions - skipped - SEEN - _SLACK) / BLOCK) + 1))

    def _advance(self, group: Sequence[int], revolutions: float) -> Iterator[History]:
        """Histories of those of the group that do not fail; where they stand then is kept."""
        slack = 1.0 + _SLOWER * (self._by_angle is not None)
        settings = replace(self._settings, duration=slack * revolutions * 2 * math.pi / self.speed)
        starts = [self._states[i] for i in group]
        found = simulate_batch(self._machine, [self._case] * len(group), settings, starts=starts)
        for member, history in zip(group, found, strict=True):
            self.seconds += history.seconds
            if history.status is Status.OK and history.end is not None:
                self._states[member] = history.end
                yield history
            else:
                self.failures[member] = history
                self.alive.remove(member)

    def _spectra(self, history: History, first: float) -> _BlockSpectra:
        """Spectra of the block that begins `first` revolutions after the start of a history."""
        rate = self._settings.sample_rate
        samples = rate * 2 * math.pi / self.speed
        here = slice(round(first * samples), round((first + SEEN + _SLACK) * samples) + 1)
        if self._by_angle is None:
            signal = self._signal(history, here)
            bands = band_matrix(signal, rate, self.speed, self._scheme).auto_power
        else:
            assert history.turning is not None
            angle = np.abs(history.turning.angle - history.turning.angle[0])
            begin, end = np.searchsorted(angle / (2 * math.pi), [first, first + SEEN + _SLACK])
            here = slice(max(0, int(begin) - 1), int(end) + 1)
            signal = self._signal(history, here)
            even, count = resample_by_angle(signal, angle[here], self._by_angle)
            bands = band_matrix(even, count * self.speed / (2 * math.pi), self.speed, self._scheme).auto_power
        windows = revolution_segments(len(signal), rate, self.speed, _WINDOW, _WINDOW / 2)
        self.frequency = windows.frequency[windows.frequency <= PASS * rate]
        lines = windows.coefficients(signal, len(self.frequency))
        return _BlockSpectra(bands, np.mean(lines.real**2 + lines.imag**2, axis=0).T / windows.resolution)

    def _signal(self, history: History, here: slice) -> FloatArray:
        """Alias-free accelerations of the frame and at the sensors, (n, c)."""
        return np.hstack([history.band_limited_acceleration[here], history.at_sensors(self._machine, here)])
