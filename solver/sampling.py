"""Alias-free accelerations from simulated velocities.

The mean acceleration over an interval is the difference of two velocities divided by it: exact, whatever impacts
happened in between. The mean's known sinc is undone and the rate reduced by one filter.

What is left of aliases: nothing from below oversampling - 0.4 sample rates (the filter stops 90 dB). From there up
the mean itself is all that stands in the way; with two velocities a sample it lets -12 dB through from 1.6 sample rates
(to 0.4 of the sample rate) and -32 dB from 1.95 (to 0.05). Impacts hold little up there: bands of a slider-crank with a
worn joint, at 10 kHz, are 0.06 dB off at most up to 3 kHz and 0.2 dB up to 4 kHz.
"""

from __future__ import annotations

import threading
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from solver.compiled import compiled

Array = NDArray[np.float64]

#: Pass band ends, and stop band begins, at these parts of the sample rate: what folds lands above PASS.
PASS, STOP = 0.4, 0.6
_ATTENUATION_DB = 90.0
#: Results computed together: they, and the values they need, stay in the first cache.
_BLOCK = 512


@cache
def _filter(oversampling: int) -> Array:
    """Low-pass with the inverse sinc in its pass band; even length, so that it centres between two samples."""
    width = (STOP - PASS) * 2 / oversampling
    taps, beta = signal.kaiserord(_ATTENUATION_DB, width)
    taps += taps % 2
    # Ideal edge half way; the window spreads it over the band between PASS and STOP.
    edge = (PASS + STOP) / 2 / oversampling
    frequency = np.linspace(0.0, edge, 257)
    grid = np.concatenate([2 * frequency, [2 * edge, 1.0]])
    gain = np.concatenate([1 / np.sinc(frequency), [0.0, 0.0]])
    found = signal.firwin2(taps, grid, gain, nfreqs=8193, window=("kaiser", beta))
    return np.asarray(found / found.sum())


def reach(oversampling: int) -> int:
    """Velocities beyond the last instant wanted that the filter needs."""
    return len(_filter(oversampling)) // 2


_scratch = threading.local()


def _room(size: int) -> Array:
    """Scratch memory of this thread, kept: fresh memory costs as much as the filter."""
    kept: Array | None = getattr(_scratch, "room", None)
    if kept is None or kept.size < size:
        kept = _scratch.room = np.empty(size)
    return kept[:size]


def band_limited_acceleration(velocity: Array, rate: float, oversampling: int, out: Array | None = None) -> Array:
    """Acceleration at the reduced rate, flat to 0.4 of it; for aliases see the module.

    Parameters
    ----------
    velocity : (c, reach + m) array
        At `rate`, from the first instant wanted on, after :func:`reach` places that are filled here: before the first
        velocity the machine is taken to have kept its first mean acceleration.
    rate : float
        Rate of the velocities, Hz.
    oversampling : int
        Velocities per reduced sample, at least 2.
    out : (c, k) array, optional
        Room for the first k results.

    Returns
    -------
    (c, k) array
        At instants 0, oversampling, 2 oversampling ... of the input for as long as the filter has what it needs.
    """
    taps, half = _filter(oversampling), reach(oversampling)
    first = velocity[:, half : half + 1]
    velocity[:, :half] = first - (velocity[:, half + 1 : half + 2] - first) * np.arange(half, 0, -1)
    if out is None:
        out = np.empty((len(velocity), max(0, (velocity.shape[1] - 2 * half - 1) // oversampling + 1)))
    # Means between velocities, then taps: together the differences of the taps on the velocities.
    weights = -np.diff(taps, prepend=0.0, append=0.0) * rate
    weights = np.pad(weights, (0, -len(weights) % 4))
    phases = _room(oversampling * (out.shape[1] + len(weights) + _BLOCK))
    _decimate(velocity, weights, oversampling, phases, np.empty(_BLOCK), out)
    return out


@partial(compiled, fastmath={"contract", "nsz"})
def _add(w0: float, w1: float, w2: float, w3: float, x0: Array, x1: Array, x2: Array, x3: Array, sums: Array) -> None:
    """Add four weighted rows to sums: fewer passes over them than one at a time."""
    for k in range(sums.size):
        sums[k] += (w0 * x0[k] + w1 * x1[k]) + (w2 * x2[k] + w3 * x3[k])


@partial(compiled, fastmath={"contract", "nsz"})
def _decimate(signals: Array, weights: Array, step: int, phases: Array, sums: Array, out: Array) -> None:
    """Scalar products of the weights with every `step`-th window, a block of them (`sums`) at a time.

    `phases` is room for every `step`-th value of a signal, from the first on, then from the second on ...; there are
    four weights, or a multiple.
    """
    count, room, block = out.shape[1], phases.size // step, sums.size
    for row in range(out.shape[0]):
        for phase in range(step):
            length = min((signals.shape[1] - phase + step - 1) // step, room)
            for k in range(length):
                phases[phase * room + k] = signals[row, phase + k * step]
            for k in range(length, room):
                phases[phase * room + k] = 0.0
        for start in range(0, count, block):
            sums[:] = 0.0
            for i in range(0, weights.size, 4):
                a = (i % step) * room + i // step + start
                b = ((i + 1) % step) * room + (i + 1) // step + start
                c = ((i + 2) % step) * room + (i + 2) // step + start
                d = ((i + 3) % step) * room + (i + 3) // step + start
                _add(
                    weights[i], weights[i + 1], weights[i + 2], weights[i + 3], phases[a : a + block],
                    phases[b : b + block], phases[c : c + block], phases[d : d + block], sums,
                )  # fmt: skip
            for k in range(min(block, count - start)):
                out[row, start + k] = sums[k]
