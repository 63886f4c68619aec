"""One entry of a catalogue with all that is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.spectra.bands import BandScheme


@dataclass(frozen=True, eq=False)
class StoredEntry:
    """One entry with all that is known of it.

    Parameters
    ----------
    key, hypothesis, status, message : str
    clearances : mapping of str to float
        Radial clearance [m] of the joints that have one.
    parameters : mapping of str to float
        Numbers that differ from the machine's file, by path, SI.
    draw : int
    drive_speed : float
        rad/s.
    segments : int
        Windows averaged.
    transient : float
        Start-up time left out [s].
    guard_db : float or None
        Mean difference from the same case computed more finely [dB]; None if it was not.
    worn : tuple of str
        The worn joints; others with clearance have the play of their fits.
    stratum, law : str
        How much of the machine was uncertain ("trusted", "wide"); contact law, "own" being that of the machine file.
    scheme : BandScheme
        Bands of the spectrum, in orders of `drive_speed`.
    power : ndarray of complex64, shape (B, 3, 3), or None
        Cross-power of the frame's acceleration (x, y in m/s2; theta in rad/s2) at its centre of gravity, integrated
        over each band; None if the case failed.
    spread_db : ndarray of float32, shape (B, 3), or None
        Standard deviation of the band levels over the averaged windows [dB].
    """

    key: str
    hypothesis: str
    status: str
    message: str
    clearances: Mapping[str, float]
    parameters: Mapping[str, float]
    draw: int
    drive_speed: float
    segments: int
    transient: float
    guard_db: float | None
    worn: tuple[str, ...]
    stratum: str
    law: str
    scheme: BandScheme
    power: NDArray[np.complex64] | None
    spread_db: NDArray[np.float32] | None
