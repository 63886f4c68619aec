"""The time column of a recording: even, rising, without gaps - or refused with the place where it is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from jointplay.catalogue.errors import MeasurementError

#: Deviation of a sample interval from the mean up to which a recording counts as evenly sampled.
JITTER = 0.01

#: Neighbouring times looked at for how many decimals are printed.
_LOOKED_AT = 1000


@dataclass(frozen=True)
class TimeBase:
    """Sample rate [Hz], and what there is to say about it."""

    sample_rate: float
    facts: tuple[str, ...]
    warnings: tuple[str, ...]


def even_time_base(
    time: npt.NDArray[np.float64],
    factor: float,
    source: str,
    column: str,
    line_of: Callable[[int], int | None],
) -> TimeBase:
    """Sample rate from a time column.

    Parameters
    ----------
    time : (n,) array
        As the file has it.
    factor : float
        Seconds a unit.
    source, column : str
        For messages.
    line_of : callable
        Line of the file of a sample.

    Returns
    -------
    TimeBase

    Raises
    ------
    MeasurementError
        Naming the line where time stands still, goes back, jumps (a dropout) or is uneven by more than 1 % - what the
        rounding of the printed times explains does not count.
    """
    steps = np.diff(time)
    step = float(np.median(steps))
    quantum = _printed_quantum(time)
    if not step > 0 or quantum > step * (1.0 + 1e-9):
        mean = float(time[-1] - time[0]) / len(steps)
        if mean > 0 and quantum > mean:
            rule = f"times are printed to {quantum * factor:g} s only, more than a sample interval"
            raise MeasurementError(source, line_of(0), column, rule=rule)
        step = mean
    back = np.flatnonzero(steps <= 0)
    if back.size:
        at = int(back[0]) + 1
        raise MeasurementError(source, line_of(at), column, float(time[at]), "time does not rise")
    slack = JITTER * step + quantum * (1.0 + 1e-6)
    gaps = np.flatnonzero(steps > 1.5 * step + quantum)
    if gaps.size:
        at = int(gaps[0])
        missing = round(float(steps[at]) / step) - 1
        more = f" ({gaps.size} gaps in all)" if gaps.size > 1 else ""
        rule = f"dropout: some {missing} samples are missing after {time[at] * factor:.6g} s{more}"
        raise MeasurementError(source, line_of(at + 1), column, float(time[at + 1]), rule)
    uneven = np.abs(steps - step)
    if float(uneven.max()) > slack:
        at = int(np.argmax(uneven > slack))
        rule = f"uneven sampling: an interval of {steps[at] * factor:.6g} s among intervals of {step * factor:.6g} s"
        raise MeasurementError(source, line_of(at + 1), column, float(time[at + 1]), rule)
    interval = float(time[-1] - time[0]) / len(steps) * factor
    # Rounding of the first and last time alone makes the rate uncertain by this much; say 10000, not 9999.99998.
    rate = 1.0 / interval
    rounded = round(rate)
    if rounded and abs(rate - rounded) <= max(rate * 2.0 * quantum * factor / (interval * len(steps)), 1e-9 * rate):
        rate = float(rounded)
    fact = f"{len(time)} samples at {rate:.8g} Hz (time column), {len(time) / rate:.4g} s"
    return TimeBase(rate, (fact,), ())


def _printed_quantum(time: npt.NDArray[np.float64]) -> float:
    """Last printed digit of the times, 0 when they have more than nine decimals.

    Looked at in neighbouring times of both ends: every tenth time of a recording has one decimal less than all of them,
    and a file of so many significant digits has fewer decimals at its end.
    """
    return max(_quantum_of(time[:_LOOKED_AT]), _quantum_of(time[-_LOOKED_AT:]))


def _quantum_of(time: npt.NDArray[np.float64]) -> float:
    for digits in range(10):
        scaled = time * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-4 + 1e-12 * np.abs(scaled)):
            return float(10.0**-digits)
    return 0.0
