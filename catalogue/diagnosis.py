"""From a recording and a catalogue to ranked hypotheses, with how sure, how well they fit, and why."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping

import numpy as np

import solver
from catalogue.answer import (
    BandEvidence,
    Diagnosis,
    Effort,
    Evidence,
    GoodnessOfFit,
    Hypothesis,
    JointClearance,
    MatcherIdentity,
    Provenance,
    Verdict,
)
from catalogue.entry import AS_NEW, HEALTHY
from catalogue.errors import DiagnosisError
from catalogue.feature_bands import joined
from catalogue.features import PreparedMeasurement, prepare
from catalogue.gaussian import GaussianAlongClearance
from catalogue.learning import Learning, MatcherCache
from catalogue.matching import BoolArray, FloatArray, HypothesisMatch, Matcher, MatchResult
from catalogue.measurement import Measurement
from catalogue.nearest import NearestEntry
from catalogue.observation import Sensing, rounded_up
from catalogue.store import Catalogue

UNKNOWN_BELOW = 0.02
"""P-value below which a hypothesis does not explain a recording."""

NOISE_STEP_DB = 3.0
"""Steps a noise floor is rounded up to, so that a learned model serves all recordings of about the same noise."""

LEAST_NOISE_DENSITY = 2e-10
"""Acceleration noise, (m/s2)^2/Hz, a recording is taken to have at least (1 mm/s2 up to 5 kHz): no simulation and no
sensor is cleaner, and what lies below says nothing about joints."""

WATCHED_ORDERS = 10
"""Orders checked one by one, besides the overall distance."""

EDGE = 0.02
"""Share of the catalogue's clearance range, at either end, in which an estimate is warned of."""

_CACHE = MatcherCache()


def diagnose(
    measurement: Measurement,
    catalogue: Catalogue,
    *,
    speed: float | None = None,
    effort: Effort = "standard",
    mapping: Mapping[str, str] | None = None,
    coverage: float = 0.95,
    matcher: Matcher | None = None,
    cache: MatcherCache = _CACHE,
) -> Diagnosis:
    """Say which joints are worn, by how much, and how sure that is.

    Parameters
    ----------
    measurement : Measurement
        Recording of sensors on the frame.
    catalogue : Catalogue
        Of the same machine.
    speed : float, optional
        Drive speed, rad/s; estimated from the recording where it is not given.
    effort : {"fast", "standard", "thorough"}
        ``fast`` compares with the nearest entries, ``standard`` is the full method. ``thorough`` is answered as
        ``standard``, and the result says so.
    mapping : mapping of str to str, optional
        Sensor of each column, for columns not named like their sensor.
    coverage : float
        Probability the candidate set is to hold, in (0, 1).
    matcher : Matcher, optional
        In place of the one that `effort` stands for.
    cache : MatcherCache, optional
        Keeps what was learned for the next recording.

    Returns
    -------
    Diagnosis

    Raises
    ------
    MeasurementError
        The recording cannot be compared: no column is a sensor, too short, no drive speed to be found.
    DiagnosisError
        A setting breaks a rule, or the catalogue holds too little.
    """
    if not 0.0 < coverage < 1.0:
        raise DiagnosisError(f"coverage: {coverage}: must be between 0 and 1")
    if effort not in ("fast", "standard", "thorough"):
        raise DiagnosisError(f"effort: {effort}: must be fast, standard or thorough")
    used: Effort = "fast" if effort == "fast" else "standard"
    method = matcher or (NearestEntry() if used == "fast" else GaussianAlongClearance())
    prepared = prepare(measurement, catalogue.machine, mapping, speed, catalogue.scheme)
    sensing = canonical_sensing(prepared, catalogue)
    feature = measured_levels(prepared, sensing)
    result = cache.fitted(catalogue, sensing, watched(prepared), method, Learning()).match(feature)
    warnings = [*prepared.warnings, *_speed_warnings(prepared, catalogue), *_edge_warnings(result, catalogue)]
    if effort != used:
        warnings.append(f"effort {effort} does no more than {used} yet: {used} was used")
    p_value, verdict = judged(result, coverage)
    provenance = Provenance(
        measurement=measurement.name,
        measurement_sha256=measurement.sha256,
        catalogue_sha256=catalogue.id,
        machine_sha256=catalogue.machine.content_key,
        solver_version=solver.__version__,
        catalogue_solver_version=catalogue.manifest.solver_version,
        matcher=MatcherIdentity(name=method.name, version=method.version),
        recipes=_recipes(prepared, sensing),
    )
    question = (provenance.model_dump(mode="json"), prepared.drive_speed, used, dict(mapping or {}), coverage)
    content = {
        "id": _digest(question)[:32],
        "machine": catalogue.machine.name,
        "catalogue": catalogue.path.name,
        "drive_speed_rpm": prepared.drive_speed * 30.0 / math.pi,
        "effort": used,
        "verdict": verdict,
        "hypotheses": tuple(_hypothesis(match) for match in result.hypotheses),
        "joint_probabilities": result.joint_probabilities(),
        "candidate_set": result.candidate_set(coverage),
        "coverage": coverage,
        "goodness_of_fit": GoodnessOfFit(p_value=p_value),
        "evidence": _evidence(prepared, result.best, feature),
        "warnings": tuple(dict.fromkeys(warnings)),
        "provenance": provenance,
    }
    unsigned = Diagnosis.model_validate({**content, "hash": ""})
    return unsigned.model_copy(update={"hash": _digest(unsigned.model_dump(mode="json", exclude={"hash"}))})


def canonical_sensing(prepared: PreparedMeasurement, catalogue: Catalogue) -> Sensing:
    """Return how the sensors of a recording see entries, with noise and length rounded to a few values.

    The loudest column's noise is rounded up to steps of 3 dB, the others lie whole steps below it; the effective length
    is rounded down to steps of 3 dB. Both are taken at the nominal drive speed. So recordings made in the same way
    share a learned model.
    """
    nominal = catalogue.recipe.nominal_drive_speed
    edges = catalogue.scheme.edges_hz(nominal)
    sensors = prepared.sensing
    floor = prepared.floor
    density = np.maximum(floor.density, 1e-30)
    loudest = np.array([density[np.equal(sensors.derivatives, kind)].max() for kind in sensors.derivatives])
    density = rounded_up(loudest, NOISE_STEP_DB) * rounded_up(density / loudest, NOISE_STEP_DB)
    recorded = type(floor)(density, floor.sample_rate).band_power(edges, sensors.derivatives)
    least = rounded_up(np.array(LEAST_NOISE_DENSITY), NOISE_STEP_DB) * np.diff(edges)[:, None]
    noise = np.maximum(recorded, least) @ (sensors.channels**2).T
    width = np.diff(catalogue.scheme.edges_hz(prepared.drive_speed)[list(prepared.cuts)])
    # Two degrees of freedom for each independent cell: the widest band says how long the recording is in effect.
    seconds = float(prepared.group_degrees_of_freedom[-1] / (2.0 * width[-1]))
    shorter = 1.0 / float(rounded_up(np.array(1.0 / seconds), NOISE_STEP_DB))
    cells = np.maximum(1.0, shorter * np.diff(edges[list(prepared.cuts)]))
    return Sensing(sensors.transform, sensors.channels, prepared.cuts, joined(noise, prepared.cuts), 2.0 * cells)


def measured_levels(prepared: PreparedMeasurement, sensing: Sensing) -> FloatArray:
    """Return the feature vector (d,) of a recording, its noise filled up to that of `sensing`."""
    missing = np.maximum(sensing.noise - prepared.group_noise, 0.0)
    return sensing.levels(prepared.group_power + missing).ravel()


def watched(prepared: PreparedMeasurement) -> BoolArray:
    """Return which features (d,) are single orders low enough to show foreign forces."""
    axes = prepared.axes
    return np.array([axis.single_order and axis.low_order < WATCHED_ORDERS for axis in axes], dtype=bool)


def judged(result: MatchResult, coverage: float) -> tuple[float, Verdict]:
    """Return the p-value of the explanation, and the verdict.

    The p-value is that of the best fitting hypothesis of the candidate set: a recording is explained if any likely
    cause explains it. Below :data:`UNKNOWN_BELOW` the verdict is unknown; else the likelier one of healthy (the
    healthy and the as-new machine together) and fault.
    """
    likely = result.candidate_set(coverage)
    p_value = max(match.p_value for match in result.hypotheses if match.label in likely)
    if p_value < UNKNOWN_BELOW:
        return p_value, "unknown"
    healthy = result.probability(HEALTHY) + result.probability(AS_NEW)
    return p_value, "healthy" if healthy >= 0.5 else "fault"


def _hypothesis(match: HypothesisMatch) -> Hypothesis:
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


def _evidence(prepared: PreparedMeasurement, best: HypothesisMatch, feature: FloatArray) -> Evidence:
    orders: list[BandEvidence] = []
    bands: list[BandEvidence] = []
    rows = zip(prepared.axes, feature, best.predicted, best.spread, strict=True)
    for axis, measured, predicted, spread in rows:
        low, high = axis.low_order, axis.high_order
        item = BandEvidence(
            order=0.5 * (low + high) if axis.single_order else math.sqrt(low * high),
            low_hz=axis.low_hz,
            high_hz=axis.high_hz,
            channel=axis.channel,
            measured_db=float(measured),
            predicted_db=float(predicted),
            spread_db=float(spread),
            z=float((measured - predicted) / spread),
        )
        (orders if axis.single_order else bands).append(item)
    return Evidence(orders=tuple(orders), bands=tuple(bands))


def _speed_warnings(prepared: PreparedMeasurement, catalogue: Catalogue) -> list[str]:
    speeds = np.abs(catalogue.entries.drive_speed) * 30.0 / math.pi
    rpm = prepared.drive_speed * 30.0 / math.pi
    low, high = float(speeds.min()), float(speeds.max())
    if 0.999 * low <= rpm <= 1.001 * high:
        return []
    return [f"drive speed {rpm:.4g} rpm lies outside the catalogue's {low:.4g} to {high:.4g} rpm"]


def _edge_warnings(result: MatchResult, catalogue: Catalogue) -> list[str]:
    worn = catalogue.entries.clearance[catalogue.entries.clearance > 0.0]
    if not worn.size or not result.best.clearances:
        return []
    low, high = math.log(float(worn.min())), math.log(float(worn.max()))
    margin = EDGE * (high - low)
    warnings = []
    for found in result.best.clearances:
        for bound, beyond, value in ((low, "smallest", found.low), (high, "largest", found.high)):
            if abs(math.log(value) - bound) <= margin:
                um = 1e6 * math.exp(bound)
                warnings.append(f"clearance of {found.joint} reaches the catalogue's {beyond}, {um:.3g} um")
    return warnings


def _recipes(prepared: PreparedMeasurement, sensing: Sensing) -> tuple[str, ...]:
    sensors = ", ".join(prepared.sensing.sensors)
    how = "given" if prepared.speed.given else "estimated from the recording"
    lines = [f"{line.frequency:.2f} Hz" for line in prepared.lines]
    rms = ", ".join(f"{value:.2g}" for value in prepared.floor.rms)
    return (
        f"columns as sensors {sensors}",
        f"drive speed {how}",
        f"hum taken out: {', '.join(lines) or 'none found'}",
        f"noise of the columns, rms to half the sample rate: {rms}",
        f"compared: {', '.join(prepared.channels)} in {len(sensing.cuts) - 1} bands",
        f"noise rounded up to steps of {NOISE_STEP_DB:g} dB",
    )


def _digest(content: object) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
