"""What speaks for an answer: levels band by band, and warnings of what a catalogue does not cover."""

from __future__ import annotations

import math

from jointplay.catalogue.diagnosing.answer import BandEvidence, Evidence, Hypothesis, JointClearance
from jointplay.catalogue.diagnosing.baseline import Baseline
from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray


def hypothesis_shown(match: HypothesisMatch) -> Hypothesis:
    """Return a hypothesis as the answer shows it."""
    return Hypothesis(
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
