"""Feature bands: single orders, then third octaves, as far as a sample rate reaches."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.spectra.bands import FEATURE_ORDERS, BandScheme

#: Part of the sample rate up to which a recording is used. Anti-alias filters and simulated spectra are flat to 0.4;
#: the little more lets a drive 3 % above nominal keep its last third octave.
USABLE = 0.4 * 1.035


@dataclass(frozen=True)
class FeatureAxis:
    """What one number of a feature vector is.

    Parameters
    ----------
    channel : str
        "x", "y", "theta" or a sensor.
    low_order, high_order : float
        Edges of the band in orders.
    low_hz, high_hz : float
        At the speed of the recording.
    single_order : bool
        True for a band on one order.
    """

    channel: str
    low_order: float
    high_order: float
    low_hz: float
    high_hz: float
    single_order: bool


def usable_cuts(scheme: BandScheme, drive_speed: float, sample_rate: float) -> tuple[int, ...]:
    """Feature bands of a scheme that a sample rate covers, as cuts between its bands.

    Parameters
    ----------
    scheme : BandScheme
    drive_speed : float
        rad/s.
    sample_rate : float
        Hz.

    Returns
    -------
    tuple of int, (G + 1,)
    """
    edges = scheme.edges_hz(drive_speed)
    cuts = scheme.third_octave_groups(FEATURE_ORDERS)
    return tuple(cut for cut in cuts if edges[cut] <= USABLE * sample_rate)


def feature_axes(
    scheme: BandScheme, cuts: tuple[int, ...], channels: tuple[str, ...], drive_speed: float
) -> tuple[FeatureAxis, ...]:
    """Describe the levels of a feature vector, number by number: the channels of a band between `cuts` side by side."""
    orders, hertz = np.asarray(scheme.edges), scheme.edges_hz(drive_speed)
    return tuple(
        FeatureAxis(
            channel,
            float(orders[low]),
            float(orders[high]),
            float(hertz[low]),
            float(hertz[high]),
            high == low + 1 and low < scheme.orders,
        )
        for low, high in itertools.pairwise(cuts)
        for channel in channels
    )


def join_bands(values: FloatArray, cuts: tuple[int, ...]) -> FloatArray:
    """Sum bands (..., B, c) into feature bands (..., G, c)."""
    return np.asarray(np.add.reduceat(values[..., : cuts[-1], :], cuts[:-1], axis=-2), dtype=np.float64)
