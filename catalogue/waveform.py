"""First look at the waveform of a channel: dead, clipped, stuck, or far off zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from catalogue.errors import MeasurementError


@dataclass(frozen=True)
class Inspection:
    """What was found: one phrase for the report, and warnings of one line each."""

    fact: str
    warnings: tuple[str, ...]


def inspect_waveform(
    signal: npt.NDArray[np.float64], source: str, channel: str, unit: str, sample_rate: float
) -> Inspection:
    """Look at one channel.

    Parameters
    ----------
    signal : (n,) array
        In SI.
    source, channel, unit : str
        For messages.
    sample_rate : float
        Hz.

    Returns
    -------
    Inspection

    Raises
    ------
    MeasurementError
        When the channel never changes.
    """
    low, high = float(signal.min()), float(signal.max())
    if low == high:
        raise MeasurementError(source, None, channel, low, "the channel never changes")
    mean = float(signal.mean())
    rms = float(np.sqrt(np.mean((signal - mean) ** 2)))
    warnings = []
    for extreme, side in ((high, "upper"), (low, "lower")):
        clipped = _clipped(signal, extreme, high - low)
        if clipped:
            warnings.append(
                f"channel {channel!r} looks clipped: {clipped} samples at its {side} end, {extreme:.4g} {unit}"
            )
    length, start = _longest_standstill(signal)
    if length > max(50, len(signal) // 100):
        warnings.append(
            f"channel {channel!r} stands still for {length} samples from {start / sample_rate:.4g} s on: a dropout?"
        )
    if abs(mean) > 3.0 * rms:
        warnings.append(
            f"channel {channel!r} has an offset of {mean:.4g} {unit}, {abs(mean) / rms:.0f} times its rms; taken off"
        )
    return Inspection(f"rms {rms:.4g}, offset {mean:.4g}, from {low:.4g} to {high:.4g} {unit}", tuple(warnings))


def _clipped(signal: npt.NDArray[np.float64], extreme: float, span: float) -> int:
    """Number of samples at an end of the range if they are a flat top, else 0.

    A flat top has runs of three and more samples, and far more samples in its outermost thousandth of the range than in
    the next: for a sine that ratio is 2.4, for impacts and noise below 1.
    """
    distance = np.abs(signal - extreme)
    at_end = distance <= 1e-3 * span
    count = int(at_end.sum())
    if count < 10 or count <= 5 * int((distance <= 2e-3 * span).sum() - count):
        return 0
    runs = at_end[2:] & at_end[1:-1] & at_end[:-2]
    return count if int(runs.sum()) >= 3 else 0


def _longest_standstill(signal: npt.NDArray[np.float64]) -> tuple[int, int]:
    """Length and start of the longest run of one value."""
    changes = np.concatenate([[0], np.flatnonzero(np.diff(signal)) + 1, [len(signal)]])
    lengths = np.diff(changes)
    longest = int(np.argmax(lengths))
    return int(lengths[longest]), int(changes[longest])
