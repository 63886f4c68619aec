"""What is concluded - wear, none, something else, or nothing that is known - and what speaks for it, band by band.

Warnings say what a catalogue does not cover.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jointplay.catalogue.diagnosing.answer import BandEvidence, Evidence, JointClearance, RankedHypothesis, Verdict
from jointplay.catalogue.diagnosing.baseline import Baseline
from jointplay.catalogue.diagnosing.causes import NEAREST, NamedCause, explain_as_well, name_causes, name_changes
from jointplay.catalogue.diagnosing.frame_modes import find_mode
from jointplay.catalogue.diagnosing.past import PastComparison, expect_worn
from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult
from jointplay.catalogue.matching.modes import UNKNOWN_BELOW
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.sensor_flaws import SensorContradiction
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray

CHANGED_BELOW = 1e-3
"""P-value of the trusted mode below which a machine is not as its file says: 15 of 15 other causes were so, and none of
268 machines as filed."""

SURE_ABOVE, SURE_P_VALUE = 0.9, 0.05
"""Probability of wear that is called worn where the model is doubted; also where the machine is not as its file says,
if the robust mode has this p-value."""

OTHERWISE_BELOW = 0.005
"""P-value of a recording beside the machine's own past below which it is not as it was."""

AS_BEFORE = 0.1
"""The same from which on it is as it was: then no cause is looked for beside other machines."""

ALWAYS = 5.0
"""Extent of a cause, as a multiple of what explains a recording of the machine in order, up to which it is not told.

Beside wear sizes err by much: of loads and ripple that slider-cranks always had up to 4.0 times as much was told as
explained recordings of them in order, of a load that had come 10.6 times."""

NAMED_ABOVE = 0.8
"""Probability from which on a cause is what has changed."""


def needs_cause(result: MatchResult) -> bool:
    """Whether the machine is not as its file says, so that something other than play is to be looked for."""
    return result.trusted_p_value is not None and result.trusted_p_value < CHANGED_BELOW


def judge(
    result: MatchResult,
    coverage: float,
    causes: Sequence[NamedCause] = (),
    flaws: Sequence[SensorContradiction] = (),
    p_since: float | None = None,
) -> tuple[float, Verdict]:
    """Return the p-value of the explanation, and the verdict.

    The p-value is that of the best fitting hypothesis of the candidate set: a recording is explained if any likely
    cause explains it. Below :data:`UNKNOWN_BELOW`, or where the set is empty, the verdict is unknown, unless a cause
    other than play was found. A machine that is not as its file says (:func:`needs_cause`) is never in order, and worn
    only where nothing else is found and that is nearly sure; one that could be as filed, but has a cause, is not in
    order either, and neither is one that is not as it was: beside its own past it has a p-value `p_since` below
    :data:`OTHERWISE_BELOW`, or a cause explains the difference. What is neither nearly surely worn, nor in order rather
    than not, is unknown where the machine is doubted. So is what sensors say that are not what the file says of them.
    A machine that is as it was when it was in order, `p_since` no less than that, is judged as one that is as filed,
    whatever its file says: if no wear is likelier than none, it is in order. Where what is worn was told by how the
    machine differs from its own past, what else its file has wrong is no reason against wear that is nearly
    sure, even if it looks like a cause.
    """
    p_value = result.p_value_within(coverage)
    if flaws:
        return p_value, "unknown"
    in_order = result.p_worn <= 0.5
    as_before = p_since is not None and p_since >= OTHERWISE_BELOW
    explained = (p_value >= UNKNOWN_BELOW and bool(result.set(coverage).labels)) or (as_before and in_order)
    is_worn = result.p_worn >= SURE_ABOVE if result.is_doubted else not in_order and bool(result.best.joints)
    found = bool(causes) and causes[0].probability >= NAMED_ABOVE
    if needs_cause(result) and not as_before:
        if explained and is_worn and (result.beside or (not found and p_value >= SURE_P_VALUE)):
            return p_value, "worn"
        return p_value, "changed" if explained or found else "unknown"
    if found and not (explained and is_worn):
        return p_value, "changed"
    if not explained or not (in_order or is_worn):
        return p_value, "unknown"
    if not in_order:
        return p_value, "worn"
    was_otherwise = (p_since is not None and not as_before) or any(cause.since for cause in causes)
    return p_value, "changed" if was_otherwise else "in_order"


def find_causes(
    prepared: PreparedMeasurement,
    catalogue: Catalogue,
    result: MatchResult,
    past: PastComparison | None = None,
    earlier: Sequence[PreparedMeasurement] = (),
) -> tuple[NamedCause, ...]:
    """Return the causes other than play that may be, beside wear as the recording seems to have it or without any.

    What has changed since recordings of the machine in order is told by these, if it explains the difference; what
    explains one of these `earlier` ones as well, the same way and up to :data:`ALWAYS` times as much, is none: the
    machine has always had it. At a speed that the catalogue has not seen every level is off, and what explains that
    best is no cause.
    """
    if speed_warnings(prepared, catalogue):
        return ()
    is_worn = result.p_worn > 0.5
    looks = [match for match in result.hypotheses if match.joints or not is_worn][:1]
    worn = [(match.label, _nearest(catalogue, match, prepared.drive_speed)) for match in looks if match.joints]
    if past is not None:
        expected = expect_worn(past.expected, catalogue, *worn[0]) if is_worn else past.expected
        if expected is not None and (changes := name_changes(expected, catalogue)):
            return () if changes[0].is_warmth else changes
        if not is_worn and past.p_value >= (OTHERWISE_BELOW if needs_cause(result) else AS_BEFORE):
            # What tells it from other machines, or from its file, it had when it was in order.
            return ()
    found = name_causes(prepared, catalogue, worn, small=needs_cause(result))
    if found:
        steady = [each for each in earlier if not speed_warnings(each, catalogue)]
        had = [cause for each in steady for cause in explain_as_well(each, catalogue)]
        return tuple(cause for cause in found if not any(_is_like(cause, each) for each in had))
    # Beside wear it has not been measured.
    mode = None if worn else find_mode(prepared, catalogue)
    return (mode,) if mode else ()


def _is_like(cause: NamedCause, earlier: NamedCause) -> bool:
    """Return whether a cause may be what the machine had earlier: the same, that way, and not so much more of it."""
    one, other = cause.extent, earlier.extent
    return cause.name == earlier.name and one * other > 0.0 and abs(one) <= ALWAYS * abs(other)


def _nearest(catalogue: Catalogue, match: HypothesisMatch, speed: float) -> IntArray:
    """Rows of a hypothesis at about a drive speed whose clearances are next to those found."""
    rows = catalogue.matrix.rows(match.label, "trusted", speed=speed)
    columns = [catalogue.matrix.joints.index(found.joint) for found in match.clearances]
    away = np.log(catalogue.matrix.clearance(rows)[:, columns]) - np.log([found.median for found in match.clearances])
    return rows[np.sort(np.argsort(np.sum(away**2, axis=1), kind="stable")[:NEAREST])]


def hypothesis_shown(match: HypothesisMatch) -> RankedHypothesis:
    """Return a hypothesis as the answer shows it."""
    return RankedHypothesis(
        label=match.label,
        joints={
            found.joint: JointClearance(
                clearance_um=1e6 * found.median, interval_um=(1e6 * found.low, 1e6 * found.high)
            )
            for found in match.clearances
        },
        probability=min(1.0, match.probability),
        distance_db=match.distance_db,
    )


def rival_of(result: MatchResult) -> HypothesisMatch | None:
    """Return the most probable hypothesis with other worn joints than the best has; None where there is none."""
    return next((match for match in result.hypotheses if set(match.joints) != set(result.best.joints)), None)


def evidence(
    prepared: PreparedMeasurement, best: HypothesisMatch, feature: FloatArray, rival: HypothesisMatch | None = None
) -> Evidence:
    """Return measured against predicted levels of a hypothesis, number by number of the feature vector.

    Parameters
    ----------
    prepared : PreparedMeasurement
    best : HypothesisMatch
        Its levels are the predicted ones.
    feature : (d,) array
        Measured levels, dB.
    rival : HypothesisMatch, optional
        What every band decides against.
    """
    orders: list[BandEvidence] = []
    bands: list[BandEvidence] = []
    against = rival or best
    rows = zip(prepared.axes, feature, best.predicted, best.spread, against.predicted, against.spread, strict=True)
    for axis, measured, predicted, spread, other, other_spread in rows:
        z, other_z = (measured - predicted) / spread, (measured - other) / other_spread
        low, high = axis.low_order, axis.high_order
        item = BandEvidence(
            order=0.5 * (low + high) if axis.single_order else math.sqrt(low * high),
            low_hz=axis.low_hz,
            high_hz=axis.high_hz,
            channel=axis.channel,
            measured_db=float(measured),
            predicted_db=float(predicted),
            spread_db=float(spread),
            z=float(z),
            rival_db=float(other) if rival else None,
            favours_best=float(0.5 * (other_z**2 - z**2) + math.log(other_spread / spread)) if rival else None,
        )
        (orders if axis.single_order else bands).append(item)
    return Evidence(orders=tuple(orders), bands=tuple(bands), rival=rival.label if rival else None)


def speed_warnings(prepared: PreparedMeasurement, catalogue: Catalogue) -> list[str]:
    """Warn of a drive speed the catalogue has not seen."""
    low, high = (bound * 30.0 / math.pi for bound in catalogue.matrix.ranges.speed)
    rpm = prepared.drive_speed * 30.0 / math.pi
    if 0.999 * low <= rpm <= 1.001 * high:
        return []
    return [f"drive speed {rpm:.4g} rpm lies outside the catalogue's {low:.4g} to {high:.4g} rpm"]


def number_warnings(baseline: Baseline, catalogue: Catalogue) -> list[str]:
    """Warn of fitted numbers of the machine that lie outside of what the catalogue's entries have."""
    ranges = catalogue.matrix.ranges.parameters
    warnings = []
    for name, estimate in baseline.numbers.items():
        drawn = [bound / own for path, own in baseline.paths[name].items() for bound in ranges.get(path, ())]
        if drawn and not min(drawn) <= estimate.factor <= max(drawn):
            warnings.append(
                f"baseline: {name}, {estimate.factor:.3g} times the file's, lies outside the catalogue's"
                f" {min(drawn):.3g} to {max(drawn):.3g}"
            )
    return warnings
