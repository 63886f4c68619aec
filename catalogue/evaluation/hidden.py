"""Wear that does not show: a joint that is never opened shakes the frame like one without play."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.evaluation.elsewhere import transform_of
from jointplay.catalogue.evaluation.protocols import Protocol
from jointplay.catalogue.evaluation.recordings import Recordings
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.solver.arrays import FloatArray

SEEN_FROM = 0.1
"""Wear shows if it changes the signals by at least this part of their noise (rms): a hundredth of its power."""


def hidden(
    protocol: Protocol, truths: Sequence[Truth], signals: dict[int, FloatArray], recordings: Recordings
) -> frozenset[int]:
    """Return the numbers of the recordings of worn machines that nobody could tell from the same machine in order.

    Only a load can press a joint together throughout, so only protocols with one are looked at.

    Parameters
    ----------
    protocol : Protocol
    truths : sequence of Truth
    signals : dict of int to ndarray
        What ideal sensors report of each truth.
    recordings : Recordings
        Of the machines in order, simulated for the comparison.
    """
    if "load" not in protocol.differences:
        return frozenset()
    worn = [number for number in sorted(signals) if truths[number].hypothesis.joints]
    found = set()
    for place, ordered in recordings.ideal(protocol, [_in_order(truths[number]) for number in worn]):
        number = worn[place]
        if ordered is not None:
            length = min(len(ordered), len(signals[number]))
            change = signals[number][:length] - ordered[:length]
            if float(np.sqrt(np.mean(change**2))) < SEEN_FROM * _noise(protocol, truths[number]):
                found.add(number)
    return frozenset(found)


def _in_order(truth: Truth) -> Truth:
    """The same machine without play: what its contacts are like is gone with it."""
    kept = {path: value for path, value in truth.parameters.items() if "contact" not in path.split(".")}
    return replace(truth, clearances={}, parameters=kept)


def _noise(protocol: Protocol, truth: Truth) -> float:
    """Root mean square of the noise of all sensors, m/s2."""
    power = (transform_of(truth.machine) * np.array(protocol.frame_noise)) ** 2
    return float(np.sqrt(np.mean(power.sum(axis=1) + protocol.sensor_noise**2)))
