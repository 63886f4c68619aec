"""Cells of a table without a number: filled from the rows beside them, within the limits that hold for missing rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.raw import RawRecording
from jointplay.catalogue.measurements.time_base import FILLED, SPOILED, even_samples, gaps_of, spoiled_by
from jointplay.solver.arrays import BoolArray, FloatArray

#: Gaps may come at equal distances: so many samples are tried.
_MOVES = 60
_CURE = "leave it out by ignore in a profile"


@dataclass(frozen=True, eq=False)
class FilledChannel:
    """A channel without gaps.

    Parameters
    ----------
    signal : (n,) array
    warnings : tuple of str
        What was filled, and how much of it may be wrong.
    dropouts : tuple of (int, int)
        First row without a number, and the one after the last, of gaps that are too long to be filled.
    """

    signal: FloatArray
    warnings: tuple[str, ...] = ()
    dropouts: tuple[tuple[int, int], ...] = ()


def fill_cells(signal: FloatArray, source: str, channel: str) -> FilledChannel:
    """Fill the gaps of a channel: by a spline through the rows, by straight lines over dropouts.

    Parameters
    ----------
    signal : (n,) array
        NaN where a row has no number.
    source, channel : str
        For messages.

    Raises
    ------
    MeasurementError
        More rows have none than have one, or too much of the channel would be wrong.
    """
    rows = np.flatnonzero(np.isfinite(signal))
    missing = len(signal) - len(rows)
    if not missing:
        return FilledChannel(signal)
    if missing > len(rows):
        rule = f"{missing} of {len(signal)} cells have no number, more than have one: {_CURE}"
        raise MeasurementError(source, None, channel, rule=rule, field="profile")
    first, last = int(rows[0]), int(rows[-1])
    places, there = (rows - first).astype(np.float64), signal[rows, None]
    told = ""
    if np.ptp(there) > 0.0:
        wrong = float(spoiled_by(places, there, _move_of(np.isnan(signal[first : last + 1])))[0])
        if not wrong <= SPOILED:
            rule = f"{missing} cells have no number: filled, {wrong:.0%} of its rms would be wrong, more than"
            raise MeasurementError(source, None, channel, rule=f"{rule} {SPOILED:.0%}: {_CURE}", field="profile")
        told = f", at most {wrong:.1%} of its rms is wrong"
    ends = [(0, first), (last + 1, len(signal))]
    dropouts = [(first + begin, first + end) for begin, end in gaps_of(places)]
    dropouts += [(begin, end) for begin, end in ends if end - begin > FILLED]
    filled = np.pad(even_samples(places, there)[:, 0], (first, len(signal) - 1 - last), mode="edge")
    wide = f"; {len(dropouts)} gaps of more than {FILLED} are dropouts" if dropouts else ""
    cells = "1 cell has" if missing == 1 else f"{missing} cells have"
    warning = f"channel {channel!r}: {cells} no number: filled from the rows beside{told}{wide}"
    return FilledChannel(filled, (warning,), tuple(dropouts))


def _move_of(missing: BoolArray) -> int:
    """Return by how much to move a channel, about half its length, so that what is tried is least what was filled."""
    half = len(missing) // 2
    return min(range(half, half + _MOVES), key=lambda by: int(np.count_nonzero(missing & np.roll(missing, by))))


def refuse_missing(raw: RawRecording, index: int, why: str) -> None:
    """Refuse a column whose gaps cannot be filled.

    Parameters
    ----------
    raw : RawRecording
    index : int
        Of the column.
    why : str
        The rule, as a phrase.

    Raises
    ------
    MeasurementError
    """
    rows = np.flatnonzero(np.isnan(raw.values[:, index]))
    if len(rows):
        rule = f"has no number: {why}"
        raise MeasurementError(
            raw.source, raw.line_of(int(rows[0])), raw.columns[index].name, rule=rule, field="profile"
        )
