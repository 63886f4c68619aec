"""How good diagnoses are: on freshly simulated recordings no catalogue has seen, through the whole of diagnosis."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from catalogue.answer import Diagnosis, Effort
from catalogue.calibration import calibration_error, log_loss
from catalogue.diagnosis import diagnose
from catalogue.entry import AS_NEW, HEALTHY, Hypothesis
from catalogue.errors import DiagnosisError, MeasurementError
from catalogue.learning import MatcherCache
from catalogue.measurement import Channel, Measurement
from catalogue.store import Catalogue
from solver.machines.fault import FaultState
from solver.machines.joints import TurningJoint
from solver.machines.machine import Machine
from solver.simulation.simulate import Case, History, Settings, Status, simulate_batch
from solver.spectra.sensor import sensor_signals

LEAST_REVOLUTIONS = 5.0
"""Length of a simulated recording in drive revolutions, at least."""

TOGETHER = 16
"""Cases simulated at a time: two vectors of lanes, so that histories do not fill the memory."""


@dataclass(frozen=True)
class Protocol:
    """Conditions of held-out recordings.

    Parameters
    ----------
    name : str
    sensor_noise : float
        White noise of each sensor up to half the sample rate, rms, m/s2.
    frame_noise : tuple of float
        White noise of the frame's x, y (m/s2) and theta (rad/s2), rms: vibration from elsewhere.
    gain : float
        Standard deviation of the sensors' gain errors, relative.
    clearance : tuple of float
        Radial clearances, log-uniform, m.
    speed : float
        Largest deviation of the drive speed from nominal, relative, uniform.
    friction : tuple of float
        Contact friction, uniform.
    scatter : float
        Standard deviation of the logarithms of contact stiffness and damping.
    seconds : tuple of float
        Length of a recording, uniform, s; never less than five revolutions.
    sample_rate : float
        Hz.
    """

    name: str
    sensor_noise: float = 0.02
    frame_noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gain: float = 0.0
    clearance: tuple[float, float] = (50e-6, 900e-6)
    speed: float = 0.03
    friction: tuple[float, float] = (0.01, 0.15)
    scatter: float = 0.4
    seconds: tuple[float, float] = (2.5, 5.0)
    sample_rate: float = 10_000.0


PROTOCOLS: Mapping[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol("matched"),
        Protocol("noisy", sensor_noise=0.1),
        Protocol("hard", sensor_noise=0.02, frame_noise=(0.1, 0.1, 0.5), gain=0.03),
    )
}
"""Protocols by name: clean sensors; noisy ones; vibration from elsewhere and gain errors."""


@dataclass(frozen=True)
class Truth:
    """What one held-out recording is of."""

    label: str
    clearances: Mapping[str, float]
    parameters: Mapping[str, float]
    seconds: float


@dataclass(frozen=True)
class Evaluation:
    """Quality of diagnosis on held-out recordings.

    Parameters
    ----------
    catalogue : str
        SHA-256 of its content.
    protocol : Protocol
    seed : int
    effort : str
    count : int
        Recordings diagnosed.
    failed, refused : int
        Cases that could not be simulated; recordings that were refused (their drive speed could not be found, ...).
    labels : tuple of str
        Hypotheses, the order of `confusion`.
    confusion : tuple of tuple of int
        Rows: truth; columns: most probable hypothesis.
    top1, top2 : float
        Share with the true hypothesis first; among the first two.
    log_loss : float
        Mean of -ln p(truth).
    calibration_error : float
        Expected error of the top probability, ten bins.
    clearance_median, clearance_p90 : float or None
        |estimate / truth - 1| over all worn joints where the true hypothesis came first: median and 90 % quantile.
    interval_coverage : float or None
        Share of those with the truth inside the 90 % interval.
    set_coverage, set_size : float
        Share with the truth in the candidate set; its mean size.
    unknown : float
        Share with verdict unknown.
    wrong_verdict : float
        Share called healthy that is worn, or called worn that is not.
    seconds_median, seconds_worst : float
        Of one diagnosis; the worst includes learning for a new noise level.
    """

    catalogue: str
    protocol: Protocol
    seed: int
    effort: str
    count: int
    failed: int
    refused: int
    labels: tuple[str, ...]
    confusion: tuple[tuple[int, ...], ...]
    top1: float
    top2: float
    log_loss: float
    calibration_error: float
    clearance_median: float | None
    clearance_p90: float | None
    interval_coverage: float | None
    set_coverage: float
    set_size: float
    unknown: float
    wrong_verdict: float
    seconds_median: float
    seconds_worst: float

    def content(self) -> dict[str, object]:
        """Return everything as plain data, for JSON."""
        return dataclasses.asdict(self)


def evaluate(
    catalogue: Catalogue,
    protocol: str | Protocol = "noisy",
    count: int = 120,
    seed: int = 1,
    *,
    effort: Effort = "standard",
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Measure diagnosis on recordings simulated now.

    Parameters
    ----------
    catalogue : Catalogue
        Its hypotheses are taken in turn.
    protocol : str or Protocol
        A name in :data:`PROTOCOLS`, or conditions of one's own.
    count : int
        Recordings, at least one a hypothesis.
    seed : int
        Of everything drawn.
    effort : {"fast", "standard", "thorough"}
    progress : callable, optional
        Called with the number of recordings done and their total.

    Returns
    -------
    Evaluation

    Raises
    ------
    DiagnosisError
        An unknown protocol, too few recordings, a machine without sensors, or nothing could be diagnosed.
    """
    conditions = _protocol(protocol)
    labels = catalogue.hypotheses
    if count < len(labels):
        raise DiagnosisError(f"count: {count}: must be at least {len(labels)}, one a hypothesis")
    if not catalogue.machine.sensors:
        raise DiagnosisError(f"machine {catalogue.machine.name}: has no sensors to record with")
    generator = np.random.default_rng(seed)
    hypotheses = catalogue.entries.hypotheses
    truths = [draw_truth(catalogue, hypotheses[i % len(labels)], conditions, generator) for i in range(count)]
    truths.sort(key=lambda truth: labels.index(truth.label))
    cache = MatcherCache()
    answers: list[tuple[Truth, Diagnosis, float]] = []
    failed = refused = 0
    for start in range(0, count, TOGETHER):
        batch = truths[start : start + TOGETHER]
        for truth, history in zip(batch, _simulated(catalogue.machine, conditions, batch), strict=True):
            if history.status is not Status.OK:
                failed += 1
                continue
            recording = record(catalogue.machine, history, conditions, truth.seconds, generator)
            begin = time.perf_counter()
            try:
                answer = diagnose(recording, catalogue, effort=effort, cache=cache)
            except MeasurementError:
                refused += 1
                continue
            answers.append((truth, answer, time.perf_counter() - begin))
        if progress is not None:
            progress(min(start + TOGETHER, count), count)
    if not answers:
        raise DiagnosisError(f"none of {count} recordings could be diagnosed: {failed} failed, {refused} were refused")
    return _summary(catalogue, conditions, seed, answers, failed, refused)


def draw_truth(
    catalogue: Catalogue, hypothesis: Hypothesis, protocol: Protocol, generator: np.random.Generator
) -> Truth:
    """Draw a machine of a hypothesis under the conditions of a protocol."""
    machine = catalogue.machine
    is_as_new = hypothesis == Hypothesis.as_new()
    joints = tuple(sorted(machine.turning_joints)) if is_as_new else hypothesis.joints
    as_new = catalogue.plan.as_new
    low, high = (as_new.low, as_new.high) if is_as_new else protocol.clearance
    clearances = {joint: float(math.exp(generator.uniform(math.log(low), math.log(high)))) for joint in joints}
    speed = catalogue.recipe.nominal_drive_speed * (1.0 + generator.uniform(-protocol.speed, protocol.speed))
    parameters = {"drive.speed": float(speed)}
    if joints:
        parameters["contact.friction"] = float(generator.uniform(*protocol.friction))
        for joint in joints:
            turning = machine.joints[joint]
            assert isinstance(turning, TurningJoint)
            for name in ("stiffness", "damping"):
                factor = math.exp(protocol.scatter * generator.normal())
                parameters[f"joints.{joint}.contact.{name}"] = getattr(turning.contact, name) * factor
    shortest = LEAST_REVOLUTIONS * 2.0 * math.pi / abs(speed)
    seconds = max(float(generator.uniform(*protocol.seconds)), 1.01 * shortest)
    return Truth(hypothesis.label, clearances, parameters, seconds)


def record(
    machine: Machine, history: History, protocol: Protocol, seconds: float, generator: np.random.Generator
) -> Measurement:
    """Record a simulated motion of the frame with the machine's sensors.

    Parameters
    ----------
    machine : Machine
    history : History
        Its transient is left out.
    protocol : Protocol
        Noise and gain errors.
    seconds : float
        Length of the recording.
    generator : Generator
        Draws noise and gains.
    """
    rows = np.flatnonzero(history.t >= history.transient)[: round(seconds * history.sample_rate)]
    frame = machine.links[machine.frame]
    acceleration = history.band_limited_acceleration[rows]
    acceleration = acceleration + generator.normal(size=acceleration.shape) * np.array(protocol.frame_noise)
    signal = sensor_signals(
        history.displacement[rows],
        history.velocity[rows],
        acceleration,
        [sensor.at for sensor in machine.sensors],
        [sensor.direction for sensor in machine.sensors],
        frame.cg,
    )
    gains = 1.0 + protocol.gain * generator.normal(size=signal.shape[1])
    signal = signal * gains + protocol.sensor_noise * generator.normal(size=signal.shape)
    return Measurement(
        name=f"simulated {history.case.fault.label}",
        sample_rate=history.sample_rate,
        signal=signal,
        channels=tuple(Channel(sensor.name, "m/s2", "acceleration") for sensor in machine.sensors),
        warnings=(),
        import_report=("simulated",),
        sha256=hashlib.sha256(np.ascontiguousarray(signal).tobytes()).hexdigest(),
    )


def _protocol(protocol: str | Protocol) -> Protocol:
    if isinstance(protocol, Protocol):
        return protocol
    if protocol not in PROTOCOLS:
        raise DiagnosisError(f"protocol: {protocol}: must be one of {', '.join(PROTOCOLS)}")
    return PROTOCOLS[protocol]


def _simulated(machine: Machine, protocol: Protocol, truths: Sequence[Truth]) -> list[History]:
    slowest = min(abs(truth.parameters["drive.speed"]) for truth in truths)
    fastest = max(abs(truth.parameters["drive.speed"]) for truth in truths)
    longest = max(truth.seconds for truth in truths)
    revolutions = 1.0 + longest * max(slowest, fastest) / (2.0 * math.pi)
    settings = Settings(sample_rate=protocol.sample_rate, accuracy="standard", revolutions=revolutions)
    return simulate_batch(machine, [Case(FaultState(truth.clearances), truth.parameters) for truth in truths], settings)


def _summary(
    catalogue: Catalogue,
    protocol: Protocol,
    seed: int,
    answers: Sequence[tuple[Truth, Diagnosis, float]],
    failed: int,
    refused: int,
) -> Evaluation:
    labels = catalogue.hypotheses
    truth = np.array([labels.index(known.label) for known, _, _ in answers], dtype=np.int64)
    posterior = np.array(
        [_in_order(labels, {h.label: h.probability for h in answer.hypotheses}) for _, answer, _ in answers]
    )
    rank = np.argsort(np.argsort(-posterior, axis=1, kind="stable"), axis=1, kind="stable")
    place = rank[np.arange(len(truth)), truth]
    confusion = np.zeros((len(labels), len(labels)), dtype=np.int64)
    np.add.at(confusion, (truth, posterior.argmax(axis=1)), 1)
    errors: list[float] = []
    inside: list[bool] = []
    for known, answer, _ in answers:
        best = answer.hypotheses[0]
        if best.label == known.label:
            for joint, found in best.joints.items():
                value = 1e6 * known.clearances[joint]
                errors.append(abs(found.clearance_um / value - 1.0))
                inside.append(found.interval_um[0] <= value <= found.interval_um[1])
    in_set = [known.label in answer.candidate_set for known, answer, _ in answers]
    wrong = [
        answer.verdict == ("fault" if known.label in (HEALTHY, AS_NEW) else "healthy") for known, answer, _ in answers
    ]
    seconds = np.array([spent for _, _, spent in answers])
    return Evaluation(
        catalogue=catalogue.id,
        protocol=protocol,
        seed=seed,
        effort=answers[0][1].effort,
        count=len(answers),
        failed=failed,
        refused=refused,
        labels=labels,
        confusion=tuple(tuple(int(n) for n in row) for row in confusion),
        top1=float(np.mean(place == 0)),
        top2=float(np.mean(place <= 1)),
        log_loss=log_loss(posterior, truth),
        calibration_error=calibration_error(posterior, truth),
        clearance_median=float(np.median(errors)) if errors else None,
        clearance_p90=float(np.quantile(errors, 0.9)) if errors else None,
        interval_coverage=float(np.mean(inside)) if inside else None,
        set_coverage=float(np.mean(in_set)),
        set_size=float(np.mean([len(answer.candidate_set) for _, answer, _ in answers])),
        unknown=float(np.mean([answer.verdict == "unknown" for _, answer, _ in answers])),
        wrong_verdict=float(np.mean(wrong)),
        seconds_median=float(np.median(seconds)),
        seconds_worst=float(np.max(seconds)),
    )


def _in_order(labels: Sequence[str], probability: Mapping[str, float]) -> list[float]:
    return [probability[label] for label in labels]
