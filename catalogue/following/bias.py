"""What answers are known to have wrong of a machine: recordings that others are compared with are of it in order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer
from jointplay.catalogue.following.visits import Visit
from jointplay.catalogue.matching.prior import Prior
from jointplay.solver.arrays import FloatArray

ALLOWED, MOST = -2.0, 5.0
"""ln(odds) of wear in one joint against none, less those before, that an answer may give of a machine in order without
being wrong; and by how much it is wrong at most: what is said to be in order may have been worn."""

SCATTER = 0.25
"""Variance of that between answers to one machine, as a part of that between machines: 0.4 and 0.8 squared."""


def measure_bias(visits: Sequence[Visit], joints: Sequence[str], temperature: float = 1.0) -> Mapping[str, FloatArray]:
    """Return by how much, in ln(odds) (J,), the answer of each visit speaks too much for wear in joints, by checksum.

    What answers to recordings of the machine in order say for wear they have wrong of this machine, and others have it
    wrong, too (docs/decisions/0223): those by the same catalogue that have heard the machine's past as well, or have
    not. An answer itself says which recordings are of the machine in order.

    Parameters
    ----------
    visits : sequence of Visit
    joints : sequence of str
    temperature : float
        What the evidence of these answers was divided by.
    """
    said = [
        (frozenset(visit.sha256.split()), _kind(visit.answer), _evidence(visit.answer, joints) - ALLOWED / temperature)
        for visit in visits
        if not visit.answer.sensors
    ]
    known: dict[object, FloatArray] = {}
    found = {}
    for visit in visits:
        in_order, kind = _in_order(visit.answer), _kind(visit.answer)
        if (in_order, kind) not in known:
            excess = [np.clip(own, -MOST, MOST) for of, its, own in said if its == kind and of <= in_order]
            mean = np.sum([np.zeros(len(joints)), *excess], axis=0) / (len(excess) + SCATTER)
            known[in_order, kind] = np.clip(mean, 0.0, MOST)
        found[visit.sha256] = known[in_order, kind]
    return found


def _kind(answer: Answer) -> tuple[str, bool]:
    """Catalogue of an answer, and whether it has heard how its recording differs from those of the machine in order."""
    return answer.catalogue, answer.baseline is not None and answer.baseline.heard


def _in_order(answer: Answer) -> frozenset[str]:
    """Checksums of the recordings of the machine in order that an answer's is compared with."""
    if answer.baseline is None:
        return frozenset()
    return frozenset(
        (answer.baseline.measurement_sha256, *(each.measurement_sha256 for each in answer.baseline.further))
    )


def _evidence(answer: Answer, joints: Sequence[str]) -> FloatArray:
    """ln(odds) (J,) of wear in each joint alone against none, less those before; least where either is not asked."""
    prior = Prior(answer.prior.worn, answer.prior.another, answer.prior.joints)
    most = max(len(match.joints) for match in answer.hypotheses)
    said = {
        frozenset(match.joints): math.log(
            max(match.probability, 1e-12) / prior.weight(match.joints, len(answer.joints), most)
        )
        for match in answer.hypotheses
    }
    none = said.get(frozenset(), math.inf)
    return np.array([said.get(frozenset({name}), -math.inf) - none for name in joints])
