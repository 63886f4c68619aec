"""Sensors that contradict each other: swapped, inverted, dead or of wrong gain, told by what a rigid frame allows.

More sensors than the frame has motions are redundant: some of their combinations must stay silent whatever the frame
does. What is left in them after gains that are a little off, noise, and a frame that is not quite rigid is laid at the
door of one sensor, or of two that changed places, where that alone explains it. Nothing is corrected here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from jointplay.catalogue.signals.hum import MAINS, MULTIPLES
from jointplay.catalogue.signals.noise import NoiseFloor
from jointplay.catalogue.signals.sensors import SensorMap
from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.spectra.band_power import BandMatrix
from jointplay.solver.spectra.bands import FEATURE_ORDERS

FlawKind = Literal["swapped", "inverted", "dead", "gain", "contradicts"]

#: Usual relative error of a sensor's gain.
GAIN = 0.05
#: What a frame is not rigid by: a share of the amplitude, and more with the square of the frequency up to its first
#: flexible mode, taken to lie here [Hz].
UNRIGID = 0.02
FLEXIBLE_FROM = 200.0
#: Misfit beyond that of noise (1 a band) from which sensors contradict each other. Recordings of sensors in order reach
#: 2; single sensors inverted or two changed 100 and more.
LIMIT = 20.0
#: Explanations whose misfit is no more than this above the best are told, too.
AS_GOOD = 10.0
#: Correction of a sensor's amplitude that is taken for an inversion, at the most and at the least.
INVERTED = (-1.5, -0.65)
#: A gain that is off by no more than this factor is not told: it may be that of four sensors, each a little off, and
#: a baseline tells it better.
LITTLE_OFF = 1.5
#: Least bands that decide when those next to mains frequencies are left out.
LEAST_BANDS = 5
#: A sensor is dead when no order stands out of its noise by more than this factor while the others are louder by the
#: second (power, a sensor in order is never below a sixth), or when its orders are weaker than theirs by the third.
SILENT = 4.0
WEAKER = 1e-2
FAR_WEAKER = 1e-4


@dataclass(frozen=True)
class SensorContradiction:
    """A sensor, or several, that cannot be as the machine file has them.

    Parameters
    ----------
    kind : {"swapped", "inverted", "dead", "gain", "contradicts"}
        The last where sensors contradict each other and no single change explains it.
    sensors : tuple of str
        All that are concerned; where two explanations are as good, those of both.
    text : str
        What is wrong, one line.
    """

    kind: FlawKind
    sensors: tuple[str, ...]
    text: str


@dataclass(frozen=True, eq=False)
class _Change:
    """What may be wrong: columns in another order, or one of unknown amplitude."""

    order: tuple[int, ...]
    free: int | None = None


@dataclass(frozen=True, eq=False)
class _Explained:
    change: _Change
    misfit: float
    correction: float


def find_sensor_flaws(sensing: SensorMap, bands: BandMatrix, floor: NoiseFloor) -> tuple[SensorContradiction, ...]:
    """Find sensors that contradict each other on orders 1 to 20.

    Parameters
    ----------
    sensing : SensorMap
    bands : BandMatrix
        Cross-powers of the sensors, as accelerations.
    floor : NoiseFloor
        Of the sensors, as recorded.

    Returns
    -------
    tuple of SensorContradiction
        Empty where all is well, or nothing can be told: as many sensors as motions have no redundancy, and only a
        dead one shows.

    Notes
    -----
    With combinations n that are silent for a rigid frame (the left null space of the sensors' transform), measured
    cross-powers P and corrections c of the amplitudes, the misfit is the sum over orders and combinations of
    ``(c n)' P (c n) / s^2`` plus ``|c - 1|^2 / gain^2`` at its minimum over c, a linear problem; s^2 is what noise and
    a frame that is not rigid leave. Two sensors that changed places are two columns of P that did; a sensor that is
    inverted or of wrong gain has a c without its second term. The same residual decides in modal analysis whether
    a structure moves as a rigid body, D. J. Ewins, Modal Testing, 2nd ed. (2000), chapter 3.
    """
    count = len(sensing.sensors)
    if count < 2 or not sensing.phases:
        return ()
    turn = bands.drive_speed / (2.0 * math.pi)
    power = bands.power[:FEATURE_ORDERS].real
    noise = floor.band_power(bands.scheme.edges_hz(bands.drive_speed), sensing.derivatives)[:FEATURE_ORDERS]
    used = _away_from_mains(turn, len(power))
    power, noise = power[used], noise[used]
    own = np.diagonal(power, axis1=1, axis2=2)
    frequency = turn * (1.0 + np.flatnonzero(used))
    dead = tuple(_dead(sensing.sensors[each]) for each in np.flatnonzero(_nothing_heard(own, noise)))
    if dead:
        return dead
    left, singular, _ = np.linalg.svd(sensing.transform)
    rank = int(np.sum(singular > 1e-6 * singular[0]))
    silent = left[:, rank:]
    if not silent.shape[1]:
        return ()
    unrigid = UNRIGID**2 + (frequency / FLEXIBLE_FROM) ** 4
    judge = _Judge(power, (noise + unrigid[:, None] * own) @ silent**2, silent)
    least = LIMIT + silent.shape[1] * len(power)
    whole = judge.explain(_Change(tuple(range(count))))
    candidates = sorted((judge.explain(change) for change in _changes(count)), key=lambda each: each.misfit)
    best = candidates[0].misfit
    little = candidates[0].change.free is not None and 1.0 / LITTLE_OFF < candidates[0].correction < LITTLE_OFF
    if (whole.misfit < least and whole.misfit - best < LIMIT) or (best < least and little):
        return ()
    if best > least:
        names = ", ".join(sensing.sensors)
        text = f"sensors {names} contradict each other as parts of one rigid frame: no single change explains it"
        return (SensorContradiction("contradicts", sensing.sensors, text),)
    return (_choose([each for each in candidates if each.misfit < best + AS_GOOD], sensing.sensors),)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Misfit of changes.

    Parameters
    ----------
    power : (b, s, s) array
    allowed : (b, k) array
        Power of each silent combination that noise and an unrigid frame explain.
    silent : (s, k) array
    """

    power: FloatArray
    allowed: FloatArray
    silent: FloatArray

    def explain(self, change: _Change) -> _Explained:
        """Misfit of a recording after a change, and how much amplitude the changed sensor lacks."""
        order = list(change.order)
        power = self.power[:, order][:, :, order]
        weight = 1.0 / np.maximum(self.allowed, np.finfo(np.float64).tiny)
        form = np.einsum("bk,ik,bij,jk->ij", weight, self.silent, power, self.silent)
        prior = np.full(len(form), 1.0 / GAIN**2)
        if change.free is not None:
            prior[change.free] = 1e-9 * prior[change.free]
        correction = np.linalg.solve(form + np.diag(prior), prior)
        misfit = float(correction @ form @ correction + prior @ (correction - 1.0) ** 2)
        return _Explained(change, misfit, 1.0 if change.free is None else float(correction[change.free]))


def _changes(count: int) -> Iterator[_Change]:
    """Return single changes: one sensor of unknown amplitude, two that changed places."""
    for index in range(count):
        yield _Change(tuple(range(count)), index)
    for one, other in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[one], order[other] = other, one
        yield _Change(tuple(order))


def _choose(found: list[_Explained], names: tuple[str, ...]) -> SensorContradiction:
    """Explanations that are as good as each other in one flaw, of the kind of the best."""
    kinds: list[FlawKind] = []
    texts, concerned = [], []
    for each in found:
        free, order = each.change.free, each.change.order
        if free is None:
            pair = [name for index, name in enumerate(names) if order[index] != index]
            kinds.append("swapped")
            texts.append(f"{pair[0]} and {pair[1]} are swapped")
            concerned += pair
            continue
        concerned.append(names[free])
        if INVERTED[0] < each.correction < INVERTED[1]:
            kinds.append("inverted")
            texts.append(f"{names[free]} is inverted")
        else:
            kinds.append("gain")
            factor = 1.0 / each.correction if each.correction else math.inf
            sign = "inverted and " if factor < 0 else ""
            texts.append(f"{names[free]} is {sign}{abs(factor):.2g} times as large as it should be")
    text = f"the sensors contradict each other as parts of one rigid frame, unless {', or '.join(texts)}"
    return SensorContradiction(kinds[0], tuple(dict.fromkeys(concerned)), text)


def _dead(name: str) -> SensorContradiction:
    return SensorContradiction("dead", (name,), f"sensor {name} is dead: it shows nothing of the machine's motion")


def _nothing_heard(own: FloatArray, noise: FloatArray) -> BoolArray:
    """Sensors that show no order while the others do, (s,)."""
    total = own.sum(axis=0)
    others = np.median(total)
    found: BoolArray = (own < SILENT * noise).all(axis=0) & (total < WEAKER * others) | (total < FAR_WEAKER * others)
    return found


def _away_from_mains(turn: float, orders: int) -> BoolArray:
    """Orders whose bands hold no mains line: what a cable picks up obeys no rigid body."""
    frequency = turn * np.arange(1, orders + 1)
    mains = np.array([each * multiple for each in MAINS for multiple in range(1, MULTIPLES + 1)])
    away = np.abs(frequency[:, None] - mains).min(axis=1) > 0.5 * turn
    low = frequency < FLEXIBLE_FROM
    return away if (away & low).sum() >= LEAST_BANDS else np.ones(orders, dtype=bool)
