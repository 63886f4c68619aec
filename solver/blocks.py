"""Members of an ensemble side by side: advanced together, their motion cut into blocks, a spectrum of each block."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.bands import BandScheme, band_matrix
from solver.errors import SettingsError
from solver.history import Case, History, Settings, Status
from solver.machine import Machine
from solver.pose import Start
from solver.sampling import PASS
from solver.segments import FloatArray, revolution_segments
from solver.simulate import simulate_batch
from solver.spectrum import frame_units, sensor_signals

MOTIONS = ("x", "y", "theta")
#: Highest order with a band of its own, if the sample rate allows.
HIGHEST_ORDER = 200
#: Revolutions from one block to the next, and those that a block looks at: four windows of three, two of four.
BLOCK, SEEN = 4, 6
#: Windows may be a little longer than their revolutions, see :data:`solver.segments.LENGTH_TOLERANCE`.
_SLACK = 0.02
_WINDOW = 4.0


@dataclass(frozen=True)
class BlockSpectra:
    """Of one block: who is in it, their powers in one-order bands, (m, k, c), and their densities, (m, n, c)."""

    members: tuple[int, ...]
    bands: FloatArray
    psd: FloatArray

    def of(self, members: Sequence[int]) -> BlockSpectra:
        """Only of these members, which must be among those here."""
        rows = [self.members.index(member) for member in members]
        return BlockSpectra(tuple(members), self.bands[rows], self.psd[rows])


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

    def __init__(self, machine: Machine, case: Case, settings: Settings, starts: Sequence[Start], speed: float) -> None:
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
        self._machine, self._case, self._settings = machine, case, settings
        self._states = list(starts)

    def blocks(self, skipped: float, count: int) -> list[BlockSpectra]:
        """Advance all members, leave out `skipped` revolutions, and give the spectra of `count` blocks.

        A member that fails on the way is in none of them and takes no further part; there are none without two left.
        """
        histories = self._advance(skipped + (count - 1) * BLOCK + SEEN + _SLACK)
        if len(histories) < 2:
            return []
        return [self._spectra(histories, skipped + block * BLOCK) for block in range(count)]

    def _advance(self, revolutions: float) -> list[History]:
        duration = revolutions * 2 * math.pi / self.speed
        # Sensors see where the frame stands; its centre of gravity needs accelerations only.
        seen = bool(self._machine.sensors)
        settings = replace(self._settings, duration=duration, links=False, motion=seen)
        cases = [self._case] * len(self.alive)
        found = simulate_batch(self._machine, cases, settings, starts=[self._states[i] for i in self.alive])
        self.revolutions += revolutions
        self.seconds += sum(history.seconds for history in found)
        kept = []
        for member, history in zip(list(self.alive), found, strict=True):
            if history.status is Status.OK and history.end is not None:
                self._states[member] = history.end
                kept.append(history)
            else:
                self.failures[member] = history
                self.alive.remove(member)
        return kept

    def _spectra(self, histories: Sequence[History], first: float) -> BlockSpectra:
        """Spectra of the block that begins `first` revolutions after the start of these histories."""
        rate = self._settings.sample_rate
        samples = rate * 2 * math.pi / self.speed
        here = slice(round(first * samples), round((first + SEEN + _SLACK) * samples) + 1)
        bands, densities = [], []
        for history in histories:
            signal = self._signal(history, here)
            bands.append(band_matrix(signal, rate, self.speed, self._scheme).auto_power)
            windows = revolution_segments(len(signal), rate, self.speed, _WINDOW, _WINDOW / 2)
            frequency = windows.frequency
            self.frequency = frequency[frequency <= PASS * rate]
            lines = windows.coefficients(signal, len(self.frequency))
            densities.append(np.mean(lines.real**2 + lines.imag**2, axis=0).T / windows.resolution)
        return BlockSpectra(tuple(self.alive), np.array(bands), np.array(densities))

    def _signal(self, history: History, here: slice) -> FloatArray:
        """Alias-free accelerations of the frame and at the sensors, (n, c)."""
        machine = self._machine
        frame = history.band_limited_acceleration[here]
        if not machine.sensors:
            return frame
        seen = sensor_signals(
            history.displacement[here], history.velocity[here], frame, [sensor.at for sensor in machine.sensors],
            [sensor.direction for sensor in machine.sensors], machine.links[machine.frame].cg,
        )  # fmt: skip
        return np.hstack([frame, seen])
