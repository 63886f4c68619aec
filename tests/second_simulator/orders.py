"""Levels of orders: how recordings are compared."""

from __future__ import annotations

import numpy as np

from second_simulator.machine import Array


def order_levels(values: Array, rate: float, turns_per_second: float, orders: int = 20) -> Array:
    """Mean square in dB within half an order of each whole one, (orders, columns), of a signal (n, columns)."""
    window = np.hanning(len(values))[:, None]
    power = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)) ** 2 * 2 / (window**2).sum()
    order = np.fft.rfftfreq(len(values), 1 / rate) / turns_per_second
    bands = [(order >= k - 0.5) & (order < k + 0.5) for k in range(1, orders + 1)]
    return np.array([10 * np.log10(power[band].sum(axis=0) / len(values)) for band in bands])
