"""A mode of the frame: a part that sits softly on the rest takes from some bands of the spectrum and gives to others.

What a frame that is not rigid does to a recording is local: within a few neighbouring bands, levels do not lie where
all other bands say that those of a machine in order lie. So does a tone from outside, or one that was taken out with
something else; but these only raise levels, or only lower them, while a mode does both: the part swings with the rest
below its resonance and against it above, and in between they cancel (antiresonance; D. J. Ewins, Modal Testing, 2nd ed.
(2000), chapter 2). And below a mode the frame is as rigid as before: where its low orders are not those of a machine in
order either, loads, ripple or mounts are what has changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import expit

from jointplay.catalogue.diagnosing.causes import LEAST_GAIN, NamedCause
from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.matching.transfer import RandomTransfer
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import on_mounts
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray

#: Draws of machines in order, at least; and fewest entries that they are made of.
DRAWS, LEAST_ENTRIES = 500, 60
#: What speaks for levels that scatter independently of each other, in entries a level.
SHRINKAGE = 0.1
#: What a level is not better known to than [dB], as of the low orders.
MODEL_DB = 0.4
#: Neighbouring bands that a mode shows in, at most.
MOST_BANDS = 3
#: Lowest frequency [Hz] of a mode, as of those that are drawn: frames are rigid below, and what is local is one order.
LOWEST = RandomTransfer().frequency[0]
#: Evidence (ln) that an open level costs: all others tell it to 1 or 2 dB, and it could be anything within 15.
OPEN = 1.5
#: What the levels that are raised, and those that are lowered, have to say of it each (ln): 1.7 standard deviations.
LEAST_EACH = 1.5
#: Levels below are no further off than so many times what those of machines in order are on average: with a mode they
#: are 0.1 to 0.7 of it, with other changes 1.6 to 80.
MOST_BELOW = 1.5


@dataclass(frozen=True, eq=False)
class KnownLevels:
    """How levels (d,) [dB] of machines of one kind lie: mean, inverse of the covariance, and its ln determinant."""

    mean: FloatArray
    precision: FloatArray
    log_determinant: float

    @classmethod
    def of(cls, drawn: FloatArray, entries: int) -> Self:
        """Levels as draws (n, d) have them, made of so many entries."""
        own = entries / (entries + SHRINKAGE * drawn.shape[1])
        covariance = np.cov(drawn.T)
        spread = own * covariance + np.diag((1.0 - own) * np.diag(covariance) + MODEL_DB**2)
        return cls(drawn.mean(axis=0), np.linalg.inv(spread), float(np.linalg.slogdet(spread)[1]))

    def misfit(self, measured: FloatArray, first: int) -> float:
        """Squared distance of the first so many levels, whatever the others are, by what it is on average."""
        if not first:
            return 0.0
        away = (measured - self.mean)[:first]
        own = self.precision[:first, :first]
        across = self.precision[:first, first:]
        # Of some levels by themselves, the inverse covariance is a Schur complement.
        marginal = own - across @ np.linalg.solve(self.precision[first:, first:], across.T)
        return float(away @ marginal @ away) / first

    def likelihood(self, measured: FloatArray) -> float:
        """Logarithm of the density of levels (d,), but for a constant."""
        away = measured - self.mean
        return -0.5 * float(away @ self.precision @ away) - 0.5 * self.log_determinant


def find_mode(prepared: PreparedMeasurement, catalogue: Catalogue) -> NamedCause | None:
    """Say whether a machine without wear has a mode of its frame that is not in its file.

    Parameters
    ----------
    prepared : PreparedMeasurement
    catalogue : Catalogue

    Returns
    -------
    NamedCause or None
        "mode of" the frame, with the frequency where it shows, Hz.
    """
    if not on_mounts(catalogue.machine):
        return None
    sensing = exact_sensing(prepared)
    edges = np.array(catalogue.matrix.edges) * (abs(prepared.drive_speed) / (2.0 * math.pi))
    kinds = [_levels(catalogue, rows, sensing, edges) for rows in _kinds(catalogue, prepared.drive_speed)]
    if not kinds:
        return None
    measured = features_of(prepared, sensing)[: sensing.noise.size]
    nearest = max(kinds, key=lambda kind: kind.likelihood(measured))
    found = mode_of(nearest, measured, edges[: sensing.bands + 1])
    if found is None:
        return None
    frequency, evidence = found
    return NamedCause(f"mode of {catalogue.machine.frame}", frequency, "Hz", float(expit(evidence)))


def mode_of(known: KnownLevels, measured: FloatArray, edges: FloatArray) -> tuple[float, float] | None:
    """Say where levels differ from those of machines that are known as by a mode of the frame.

    Parameters
    ----------
    known : KnownLevels
    measured : (G c,) array
        dB, band by band, the channels of a band side by side.
    edges : (G + 1,) array
        Of the bands, Hz.

    Returns
    -------
    (float, float) or None
        Frequency [Hz] of the middle of the bands that differ, and how much likelier (ln) that is than no difference.
    """
    # The first band that a mode may show in, and the one before it, which its dip may reach.
    channels = len(measured) // (len(edges) - 1)
    low = channels * max(0, int(np.searchsorted(edges, LOWEST)) - 1)
    if known.misfit(measured, low) > MOST_BELOW:
        return None
    found = max(_open(known, measured, edges), default=None)
    if found is None or found[0] < LEAST_GAIN or min(found[1:3]) < LEAST_EACH:
        return None
    evidence, _, _, frequency = found
    return frequency, evidence


def _open(known: KnownLevels, measured: FloatArray, edges: FloatArray) -> Iterator[tuple[float, float, float, float]]:
    """Evidence for neighbouring bands being open, what raised and lowered levels have of it, and the middle, Hz."""
    bands = len(edges) - 1
    channels = len(measured) // bands
    pull = known.precision @ (measured - known.mean)
    for count in range(1, MOST_BANDS + 1):
        for first in range(int(np.searchsorted(edges, LOWEST)), bands - count + 1):
            place = slice(first * channels, (first + count) * channels)
            block = np.linalg.inv(known.precision[place, place])
            # What the levels are above where all others put them, and in standard deviations.
            away = block @ pull[place]
            score = away / np.sqrt(np.diag(block))
            evidence = 0.5 * float(pull[place] @ away) - OPEN * len(away)
            raised, lowered = (0.5 * float(np.max(np.maximum(sign * score, 0.0))) ** 2 for sign in (1.0, -1.0))
            yield evidence, raised, lowered, math.sqrt(edges[first] * edges[first + count])


def _levels(catalogue: Catalogue, rows: IntArray, sensing: Sensing, edges: FloatArray) -> KnownLevels:
    """Levels of entries as the sensors of a recording would report them."""
    copies = np.full(len(rows), math.ceil(DRAWS / len(rows)), dtype=np.int64)
    drawn = observe(catalogue.matrix.packed(rows), sensing, Discrepancy(), copies, 0, edges)[0]
    return KnownLevels.of(drawn[:, : sensing.noise.size], len(rows))


def _kinds(catalogue: Catalogue, speed: float) -> list[IntArray]:
    """Rows of machines in order at about a speed: of those with play, and of those without, which lie far from them."""
    rows = catalogue.matrix.rows("healthy", "trusted", speed=speed)
    has_play = np.any(np.nan_to_num(catalogue.matrix.clearance(rows)) > 0.0, axis=1)
    return [kind for kind in (rows[has_play], rows[~has_play]) if len(kind) >= LEAST_ENTRIES]
