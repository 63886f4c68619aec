"""What curves of hypotheses are worth, by draws they have not learned from: temperatures, tails, and sets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from jointplay.catalogue.matching.calibration import (
    TEMPERATURES,
    Tail,
    fit_shares,
    fit_temperature,
    probabilities,
    row_weights,
)
from jointplay.catalogue.matching.clearances import Ranks, laws_of
from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.curves import CurveModel, average
from jointplay.catalogue.matching.matcher import TrainingSet
from jointplay.catalogue.matching.network import Opinion
from jointplay.catalogue.matching.sightings import Sightings
from jointplay.solver.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Calibration:
    """What was fitted on held-out draws.

    Parameters
    ----------
    temperature : float
        Of the hypothesis probabilities.
    clearance_temperatures : tuple of float
        Of the clearance posteriors of hypotheses with one, two, ... clearances.
    clearance_ranks : tuple of Ranks
        Of true clearances in these, likewise.
    distances, orders : tuple of Tail
        Per hypothesis: full-space distance, and mean of the largest watched z.
    conformal : Conformal
    doubts : tuple of Tail
        Per hypothesis: how much rather a machine seems to differ from its file; empty where no network says so.
    share : float
        Exponent of a network's opinion beside them, whose own is 1 / `temperature`; 0 where there is none.
    sightings : Sightings
        What was seen of each joint; None where the clearances of the draws are not known.
    """

    temperature: float
    clearance_temperatures: tuple[float, ...]
    clearance_ranks: tuple[Ranks, ...]
    distances: tuple[Tail, ...]
    orders: tuple[Tail, ...]
    conformal: Conformal
    share: float = 0.0
    doubts: tuple[Tail, ...] = ()
    sightings: Sightings | None = None


def calibrate(
    pairs: Iterable[tuple[CurveModel, TrainingSet]], opinion: Opinion | None = None, witness: Opinion | None = None
) -> Calibration:
    """Calibrate on pairs of what was learned and what was held out of it, by the network of an opinion, too.

    A witness is the opinion of a network of strata.
    """
    evidence: list[FloatArray] = []
    opinions: list[FloatArray] = []
    truth: list[IntArray] = []
    worn: list[FloatArray] = []
    distances: list[list[FloatArray]] = []
    orders: list[list[FloatArray]] = []
    doubts: list[list[FloatArray]] = []
    own: dict[int, list[_Held]] = {}
    for model, held in pairs:
        features, index = held.stack()
        whitened = features @ model.projection
        columns = []
        distances = distances or [[] for _ in held.hypotheses]
        orders = orders or [[] for _ in held.hypotheses]
        doubts = doubts or [[] for _ in held.hypotheses]
        for h, draws in enumerate(held.hypotheses):
            likelihood = model.log_likelihood(whitened, h)
            columns.append(average(likelihood))
            curve = likelihood[index == h]
            distance, order = model.curves[h].surprise(
                draws.features, curve.argmax(axis=1).astype(np.int64), model.watched
            )
            distances[h].append(distance)
            orders[h].append(order)
            if witness is not None:
                doubts[h].append(witness.doubts(draws.features))
            if draws.log_clearance.shape[1]:
                place = model.curves[h].grid.index(draws.log_clearance)
                rows = np.flatnonzero(index == h) + sum(map(len, truth))
                own.setdefault(draws.log_clearance.shape[1], []).append(
                    _Held(curve, place, model.curves[h].grid.axes, draws.log_clearance, rows)
                )
        evidence.append(np.stack(columns, axis=1))
        if opinion is not None:
            opinions.append(opinion.log_evidences(features, held.labels))
        truth.append(index)
        worn.append(held.log_clearances())
    stacked = np.concatenate(truth)
    weights = row_weights(stacked)
    joined = np.concatenate(evidence)
    if opinions:
        second = np.concatenate(opinions)
        first, share = fit_shares(joined, second, stacked, weights)
        temperature, scaled = 1.0 / first, first * joined + share * second
    else:
        temperature, share = fit_temperature(joined, stacked, weights), 0.0
        scaled = joined / temperature
    posterior = probabilities(scaled + np.log([draws.prior for draws in held.hypotheses]))
    named = posterior[np.arange(len(stacked)), stacked]
    temperatures = tuple(_clearance_temperature(own.get(k + 1, [])) for k in range(max(own, default=0)))
    return Calibration(
        temperature,
        temperatures,
        tuple(_clearance_ranks(own.get(k + 1, []), each, named) for k, each in enumerate(temperatures)),
        tuple(Tail.of(np.concatenate(values)) for values in distances),
        tuple(Tail.of(np.concatenate(values)) for values in orders),
        Conformal.fit(posterior, stacked, weights),
        share,
        () if witness is None else tuple(Tail.of(np.concatenate(values)) for values in doubts),
        Sightings.of(
            held.joints, [draws.joints for draws in held.hypotheses], np.concatenate(worn), posterior, weights
        ),
    )


@dataclass(frozen=True, eq=False)
class _Held:
    """Held-out draws of a hypothesis: likelihood (m, f) along its curve, the point (m,) next to the true clearances.

    `rows` are theirs among all draws.
    """

    curve: FloatArray
    place: IntArray
    axes: tuple[FloatArray, ...]
    log_clearance: FloatArray
    rows: IntArray


def _clearance_ranks(own: Sequence[_Held], temperature: float, named: FloatArray) -> Ranks:
    """Ranks of the true clearances of held-out draws whose hypotheses were given the probabilities `named`."""
    return Ranks.of(
        [
            (laws, true, named[held.rows])
            for held in own
            for laws, true in zip(laws_of(held.curve, held.axes, temperature), held.log_clearance.T, strict=True)
        ]
    )


def _clearance_temperature(own: Sequence[_Held]) -> float:
    """Return the temperature with the least mean -ln density at the true clearance of held-out draws."""
    if not own:
        return 1.0

    def loss(log_temperature: float) -> float:
        scale = float(np.exp(-log_temperature))
        total = 0.0
        for held in own:
            scaled = held.curve * scale
            total += float(np.sum(logsumexp(scaled, axis=1) - scaled[np.arange(len(held.place)), held.place]))
        return total

    low, high = np.log(TEMPERATURES)
    found = minimize_scalar(loss, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-2})
    return float(np.exp(found.x))
