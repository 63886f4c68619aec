"""Held-out recordings: simulated on demand, kept on disk by content, then given noise, gains and a structure.

What is kept is what ideal sensors on a rigid frame would report. Noise, gains, the structure's transfer function, and
what spoils recordings are put on top in the computer's memory, so that protocols which differ only in those share their
simulations.
"""

from __future__ import annotations

import os
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointplay import solver
from jointplay.catalogue.evaluation.protocols import EvaluationProtocol
from jointplay.catalogue.evaluation.truth import Truth, transform_of
from jointplay.catalogue.measurements.measurement import Recording, measurement_of
from jointplay.catalogue.measurements.readers import RawRecording
from jointplay.catalogue.measurements.readers.raw import RawColumn
from jointplay.catalogue.plans.entry import content_digest
from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import simulate_batch

TOGETHER = 16
"""Cases simulated at a time: two vectors of lanes, so that histories do not fill the memory."""


_UNFINISHED = ".tmp"


@dataclass(frozen=True)
class Recordings:
    """Simulations kept in a folder, least recently used ones dropped beyond a limit.

    Parameters
    ----------
    folder : Path, optional
        Nothing is kept without one.
    limit : int
        Bytes kept; a recording of 8 s with four sensors has 1.3 MB.
    """

    folder: Path | None = None
    limit: int = 2_000_000_000

    def ideal(self, protocol: EvaluationProtocol, truths: Sequence[Truth]) -> Iterator[tuple[int, FloatArray | None]]:
        """Yield the number and the ideal sensors' signals (n, s), m/s2, of every truth; None for one that failed.

        Those that are kept come first, the others as they are simulated.
        """
        missing: dict[Machine, list[int]] = defaultdict(list)
        for index, truth in enumerate(truths):
            kept = self._recall(self.key(protocol, truth))
            if kept is None:
                missing[truth.machine].append(index)
            else:
                yield index, kept
        for machine, indices in missing.items():
            # Cases of the same joints next to each other share a compiled model.
            indices.sort(key=lambda index: truths[index].joints)
            for start in range(0, len(indices), TOGETHER):
                batch = indices[start : start + TOGETHER]
                cases = [Case(Fault(truths[i].clearances), truths[i].parameters) for i in batch]
                histories = simulate_batch(machine, cases, _settings(protocol))
                for index, history in zip(batch, histories, strict=True):
                    signal = _ideal(machine, history, truths[index].seconds)
                    if signal is not None:
                        # As it will come out of its file: figures do not depend on what was kept.
                        signal = signal.astype(np.float32).astype(np.float64)
                        self._keep(self.key(protocol, truths[index]), signal)
                    yield index, signal
        self._drop()

    def key(self, protocol: EvaluationProtocol, truth: Truth) -> str:
        """Return what a simulation is kept under: a digest of everything that determines it."""
        settings = _settings(protocol)
        return content_digest(
            {
                "machine": truth.machine.content_key,
                "fault": dict(truth.clearances),
                "parameters": dict(truth.parameters),
                "settings": [settings.accuracy, settings.sample_rate, settings.revolutions],
                "seconds": truth.seconds,
                "numbers_version": solver.NUMBERS_VERSION,
            }
        )

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{key}.npy"

    def _recall(self, key: str) -> FloatArray | None:
        if self.folder is None or not self._path(key).exists():
            return None
        try:
            found = np.load(self._path(key), allow_pickle=False).astype(np.float64)
            os.utime(self._path(key))
        except (OSError, EOFError, ValueError):  # dropped by another process, or damaged: simulated again
            return None
        return np.asarray(found, dtype=np.float64)

    def _keep(self, key: str, signal: FloatArray) -> None:
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=self.folder, suffix=_UNFINISHED)
        temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as stream:
                np.save(stream, signal.astype(np.float32))
            temporary.replace(self._path(key))
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise

    def _drop(self) -> None:
        if self.folder is None or not self.folder.is_dir():
            return
        kept = []
        # Files that a process left unfinished when it was killed grow old like the others.
        for path in (*self.folder.glob("*.npy"), *self.folder.glob(f"*{_UNFINISHED}")):
            try:
                found = path.stat()
            except FileNotFoundError:
                continue
            kept.append((found.st_mtime, found.st_size, path))
        total = sum(size for _, size, _ in kept)
        for _, size, path in sorted(kept):
            if total <= self.limit:
                return
            path.unlink(missing_ok=True)
            total -= size


def _settings(protocol: EvaluationProtocol) -> Settings:
    # Every machine's own revolutions, and a little more, so that the last sample is there.
    revolutions = 0.1 + protocol.least_revolutions
    return Settings(sample_rate=protocol.sample_rate, accuracy="standard", revolutions=revolutions)


def _ideal(machine: Machine, history: History, seconds: float) -> FloatArray | None:
    if history.status is not Status.OK or (history.turning is not None and not history.turning.is_steady):
        return None
    first = int(np.searchsorted(history.t, history.transient))
    return history.at_sensors(machine, slice(first, first + round(seconds * history.sample_rate)))


def recorded(protocol: EvaluationProtocol, truth: Truth, ideal: FloatArray) -> Recording:
    """Return what the real sensors of a protocol record.

    Parameters
    ----------
    protocol : EvaluationProtocol
    truth : Truth
    ideal : ndarray, shape (n, s)
        Of ideal sensors on a rigid frame, m/s2.

    Raises
    ------
    MeasurementError
        A file with such samples would be refused.
    """
    machine, rate, draws = truth.machine, protocol.sample_rate, np.random.default_rng(truth.seed)
    elsewhere = draws.normal(size=(len(ideal), 3)) * np.array(protocol.frame_noise)
    signal = truth.response.of(ideal, rate) + elsewhere @ transform_of(machine).T
    if truth.disturbance is not None:
        signal = signal + truth.disturbance.of(machine, rate, ideal)
    signal = signal * np.array(truth.gains) + protocol.sensor_noise * draws.normal(size=signal.shape)
    names = tuple(sensor.name for sensor in machine.sensors)
    if truth.flaw is not None:
        signal = truth.flaw.of(names, rate, signal)
    # Judged as a file is: what dropped out or is clipped has to be seen, and what is no number is refused.
    columns = tuple(RawColumn(name, name, "m/s2", f"sensor {name}") for name in names)
    return measurement_of(RawRecording(f"simulated {truth.hypothesis.label}", columns, signal, rate, ("simulated",)))


SEEN_FROM = 0.1
"""Wear shows if it changes the signals by at least this part of their noise (rms): a hundredth of its power."""


def hidden(
    protocol: EvaluationProtocol, truths: Sequence[Truth], signals: dict[int, FloatArray], recordings: Recordings
) -> frozenset[int]:
    """Return the numbers of the recordings of worn machines that nobody could tell from the same machine in order.

    Only a load can press a joint together throughout, so only protocols with one are looked at.

    Parameters
    ----------
    protocol : EvaluationProtocol
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


def _noise(protocol: EvaluationProtocol, truth: Truth) -> float:
    """Root mean square of the noise of all sensors, m/s2."""
    power = (transform_of(truth.machine) * np.array(protocol.frame_noise)) ** 2
    return float(np.sqrt(np.mean(power.sum(axis=1) + protocol.sensor_noise**2)))
