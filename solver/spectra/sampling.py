"""Alias-free accelerations from simulated velocities.

The mean acceleration over an interval is the difference of two velocities divided by it: exact, whatever impacts
happened in between. The mean's known sinc is undone and the rate reduced by one filter.

What is left of aliases: nothing from below oversampling - 0.4 sample rates (the filter stops 90 dB). From there up
the mean itself is all that stands in the way; with two velocities a sample it lets -12 dB through from 1.6 sample rates
(to 0.4 of the sample rate) and -32 dB from 1.95 (to 0.05). Impacts hold little up there: bands of a slider-crank with a
worn joint, at 10 kHz, are 0.06 dB off at most up to 3 kHz and 0.2 dB up to 4 kHz.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.compiler.native import compiled

#: Pass band ends, and stop band begins, at these parts of the sample rate: what folds lands above PASS.
PASS, STOP = 0.4, 0.6
_ATTENUATION_DB = 90.0
#: What a polynomial through the samples around a place is made of: binomial coefficients with changing signs, and the
#: first of the samples.
_NODES = np.array([1.0, -7.0, 21.0, -35.0, 35.0, -21.0, 7.0, -1.0])
_FIRST_NODE = -3
#: Results computed together: they, and the values they need, stay in the first cache.
_BLOCK = 1024


@cache
def _filter(oversampling: int) -> FloatArray:
    """Low-pass with the inverse sinc in its pass band; even length, so that it centres between two samples."""
    from scipy import signal  # takes half a second to load, which a server can begin without

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


def head(oversampling: int) -> int:
    """Places left free before the first velocity of each phase, see :func:`phases`."""
    return -(-reach(oversampling) // oversampling)


def phases(velocity: FloatArray, oversampling: int) -> FloatArray:
    """Velocities as the filter takes them: every `oversampling`-th one, from the first on, then from the second on ...

    Parameters
    ----------
    velocity : (c, m) array

    Returns
    -------
    (c, oversampling, head + k) array
        After :func:`head` free places; what is missing of the last k is the last velocity again.
    """
    free, count = head(oversampling), -(-velocity.shape[1] // oversampling)
    out = np.zeros((len(velocity), oversampling, free + count))
    filled = np.pad(velocity, ((0, 0), (0, count * oversampling - velocity.shape[1])), mode="edge")
    out[:, :, free:] = filled.reshape(len(velocity), count, oversampling).swapaxes(1, 2)
    return out


def band_limited_acceleration(
    velocity: FloatArray, rate: float, count: int, out: FloatArray | None = None, *, first: int = 0
) -> FloatArray:
    """Acceleration at the reduced rate, flat to 0.4 of it; for aliases see the module.

    Parameters
    ----------
    velocity : (c, oversampling, head + k) array
        At `rate`, from the first instant wanted on, as :func:`phases` has it, at least 2 velocities a reduced sample.
        The free places are filled here: before the first velocity the machine is taken to have kept its first mean
        acceleration.
    rate : float
        Rate of the velocities, Hz.
    count : int
        Results up to the last one wanted, which needs :func:`reach` velocities after its instant.
    out : (c, count - first) array, optional
        Room for them.
    first : int
        So many results are not wanted.

    Returns
    -------
    (c, count - first) array
        At every first of a phase: instants 0, oversampling, 2 oversampling ... of the velocities, without the `first`.
    """
    oversampling = velocity.shape[1]
    taps, half, free = _filter(oversampling), reach(oversampling), head(oversampling)
    before = free * oversampling
    start, next_one = velocity[:, 0, free], velocity[:, 1, free]
    for i in range(1, half + 1):
        place = before - i
        velocity[:, place % oversampling, place // oversampling] = start - (next_one - start) * i
    if out is None:
        out = np.empty((len(velocity), count - first))
    # Means between velocities, then taps: together the differences of the taps on the velocities.
    weights = -np.diff(taps, prepend=0.0, append=0.0) * rate
    _decimate(velocity, weights, before - half + first * oversampling, np.empty(_BLOCK), out)
    return out


@partial(compiled, fastmath={"contract", "nsz"})
def _add(weight: float, values: FloatArray, sums: FloatArray) -> None:
    """Add weighted values to sums."""
    for k in range(sums.size):
        sums[k] += weight * values[k]


@partial(compiled, fastmath={"contract", "nsz"})
def _add_four(
    w0: float,
    w1: float,
    w2: float,
    w3: float,
    x0: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    x3: FloatArray,
    sums: FloatArray,
) -> None:
    """Add four weighted rows to sums: fewer passes over them than one at a time."""
    for k in range(sums.size):
        sums[k] += (w0 * x0[k] + w1 * x1[k]) + (w2 * x2[k] + w3 * x3[k])


@compiled
def _decimate(velocity: FloatArray, weights: FloatArray, offset: int, room: FloatArray, out: FloatArray) -> None:
    """Scalar products of the weights with every window, which begin at `offset`, a block of them at a time."""
    step, count, fours = velocity.shape[1], out.shape[1], weights.size - weights.size % 4
    for row in range(out.shape[0]):
        for start in range(0, count, room.size):
            size = min(room.size, count - start)
            sums = room[:size]
            sums[:] = 0.0
            for i in range(0, fours, 4):
                a, b, c, d = offset + i, offset + i + 1, offset + i + 2, offset + i + 3
                _add_four(
                    weights[i], weights[i + 1], weights[i + 2], weights[i + 3],
                    velocity[row, a % step, start + a // step : start + a // step + size],
                    velocity[row, b % step, start + b // step : start + b // step + size],
                    velocity[row, c % step, start + c // step : start + c // step + size],
                    velocity[row, d % step, start + d // step : start + d // step + size],
                    sums,
                )  # fmt: skip
            for i in range(fours, weights.size):
                a = offset + i
                _add(weights[i], velocity[row, a % step, start + a // step : start + a // step + size], sums)
            out[row, start : start + size] = sums


def interpolate(values: FloatArray, at: FloatArray) -> FloatArray:
    """Values (c, n) between their samples, by polynomials through eight of them.

    Up to a tenth of the rate of the values they are 1e-5 off, and 0.5 % (0.04 dB) at a fifth.

    Parameters
    ----------
    values : (c, n) array
        n >= 8.
    at : (m,) array
        In samples. Beyond the middle of the first or last eight their polynomial holds.

    Returns
    -------
    (c, m) array

    Notes
    -----
    Lagrange's polynomials in barycentric form: J.-P. Berrut and L. N. Trefethen, SIAM Review 46 (2004) 501.
    """
    out = np.empty((len(values), at.size))
    _interpolate(np.ascontiguousarray(values), at, out)
    return out


@compiled
def _interpolate(values: FloatArray, at: FloatArray, out: FloatArray) -> None:
    weights = np.empty(_NODES.size)
    for k in range(at.size):
        first = min(max(int(np.floor(at[k])) + _FIRST_NODE, 0), values.shape[1] - weights.size)
        total, hit = 0.0, -1
        for node in range(weights.size):
            away = at[k] - (first + node)
            if away == 0.0:
                hit = node
            else:
                weights[node] = _NODES[node] / away
                total += weights[node]
        for row in range(out.shape[0]):
            if hit >= 0:
                out[row, k] = values[row, first + hit]
                continue
            found = 0.0
            for node in range(weights.size):
                found += weights[node] * values[row, first + node]
            out[row, k] = found / total
