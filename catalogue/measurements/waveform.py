"""First looks at what was sampled: channels dead, clipped, stuck, or far off zero."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.solver.arrays import BoolArray, FloatArray

#: A channel that keeps one value for so long [s], for so many samples, and for so many times as long as it usually does
#: (coarse numbers stay the same for a while), has dropped out.
STANDSTILL = 0.005
LEAST_STANDSTILL = 20
UNUSUAL_STANDSTILL = 20.0


@dataclass(frozen=True)
class ChannelFlaw:
    """Something wrong with a channel.

    Parameters
    ----------
    channel : str
    kind : {"clipped", "dropout", "offset"}
    first, last : int
        Samples ``first`` to ``last - 1`` of a dropout; of clipped samples the first and the one after the last.
    """

    channel: str
    kind: Literal["clipped", "dropout", "offset"]
    first: int
    last: int


@dataclass(frozen=True)
class Inspection:
    """What was found: one phrase for the report, warnings of one line each, and the flaws they speak of."""

    fact: str
    warnings: tuple[str, ...]
    flaws: tuple[ChannelFlaw, ...] = ()


def inspect_waveform(signal: FloatArray, source: str, channel: str, unit: str, sample_rate: float) -> Inspection:
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
        rule = f"the channel never changes: if it is no sensor, leave it out by ignore: [{channel}] in a profile"
        raise MeasurementError(source, None, channel, low, rule, field="profile")
    mean = float(signal.mean())
    rms = float(np.sqrt(np.mean((signal - mean) ** 2)))
    warnings, flaws = [], []
    standstills = _standstills(signal, sample_rate)
    for mask, extreme, side in _flat_tops(signal, standstills):
        at_end = np.flatnonzero(mask)
        warnings.append(
            f"channel {channel!r} looks clipped: {len(at_end)} samples at its {side} end, {extreme:.4g} {unit}"
        )
        flaws.append(ChannelFlaw(channel, "clipped", int(at_end[0]), int(at_end[-1]) + 1))
    for start, length in standstills:
        warnings.append(
            f"channel {channel!r} stands still for {length} samples from {start / sample_rate:.4g} s on: a dropout?"
        )
        flaws.append(ChannelFlaw(channel, "dropout", start, start + length))
    if abs(mean) > 3.0 * rms:
        warnings.append(
            f"channel {channel!r} has an offset of {mean:.4g} {unit}, {abs(mean) / rms:.0f} times its rms; taken off"
        )
        flaws.append(ChannelFlaw(channel, "offset", 0, len(signal)))
    fact = f"rms {rms:.4g}, offset {mean:.4g}, from {low:.4g} to {high:.4g} {unit}"
    return Inspection(fact, tuple(warnings), tuple(flaws))


def find_clipped(signal: FloatArray, sample_rate: float) -> BoolArray:
    """Samples of flat tops at either end of the range, (n,)."""
    found = np.zeros(len(signal), dtype=bool)
    for mask, _, _ in _flat_tops(signal, _standstills(signal, sample_rate)):
        found |= mask
    return found


def _flat_tops(signal: FloatArray, standstills: list[tuple[int, int]]) -> Iterator[tuple[BoolArray, float, str]]:
    """Samples of flat tops, their level and side; what stands still for long belongs to none."""
    kept = np.ones(len(signal), dtype=bool)
    for start, length in standstills:
        kept[start : start + length] = False
    rest = signal[kept]
    if not rest.size:
        return
    low, high = float(rest.min()), float(rest.max())
    for extreme, side in ((high, "upper"), (low, "lower")):
        if high > low and _count_clipped(rest, extreme, high - low):
            yield kept & (np.abs(signal - extreme) <= 1e-3 * (high - low)), extreme, side


def _count_clipped(signal: FloatArray, extreme: float, span: float) -> int:
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


def _standstills(signal: FloatArray, sample_rate: float) -> list[tuple[int, int]]:
    """Start and length of every long run of one value, but for flat tops of clipping."""
    changes = np.concatenate([[0], np.flatnonzero(np.diff(signal)) + 1, [len(signal)]])
    lengths = np.diff(changes)
    usual = float(np.median(lengths))
    least = max(STANDSTILL * sample_rate, LEAST_STANDSTILL, UNUSUAL_STANDSTILL * usual)
    long = lengths >= least
    for extreme in (signal.min(), signal.max()):
        there = signal[changes[:-1]] == extreme
        if lengths[there & long].sum() <= 0.5 * lengths[there].sum():
            long &= ~there  # most of it is short: a flat top
    return [(int(changes[run]), int(lengths[run])) for run in np.flatnonzero(long)]
