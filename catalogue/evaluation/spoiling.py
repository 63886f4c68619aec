"""What spoils a recording of a machine that is as its model: vibration from elsewhere, flawed sensors, missing samples.

Everything here is put on top of a simulation, which does not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation.truth import Blows, Bursts, Tones, Truth, Wrench
from jointplay.catalogue.plans.driving import speed_of
from jointplay.catalogue.plans.entry import seed_from
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine

Spoiling = Callable[[Truth, np.random.Generator], Truth]
"""Draws what spoils a recording, and returns the truth with it."""

SHORT_GAP, LONG_GAP = 0.025, 0.5
"""Samples that are missing [s]."""

NEIGHBOUR_HARMONICS = 5
"""Tones of another machine."""


@dataclass(frozen=True)
class FlawedSensors:
    """Two sensors that are swapped, or one that is inverted or dead.

    Parameters
    ----------
    sensors : tuple of str
    kind : {"swapped", "inverted", "dead"}
    noise : float
        Of a dead sensor: what its cable picks up, as a share of the recording's rms.
    seed : int
        Of that noise.
    """

    sensors: tuple[str, ...]
    kind: Literal["swapped", "inverted", "dead"]
    noise: float = 0.01
    seed: int = 0

    def of(self, names: tuple[str, ...], sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what is recorded of a signal (n, s) of sensors of these names."""
        found = signal.copy()
        columns = [names.index(name) for name in self.sensors]
        if self.kind == "swapped":
            found[:, columns] = signal[:, columns[::-1]]
        elif self.kind == "inverted":
            found[:, columns] = -signal[:, columns]
        else:
            noise = np.random.default_rng(self.seed).normal(size=(len(signal), len(columns)))
            found[:, columns] = self.noise * float(signal.std()) * noise
        return found


@dataclass(frozen=True)
class Clipped:
    """A full scale that is too small, the same for all sensors.

    Parameters
    ----------
    share : float
        Of all samples, that are beyond it.
    """

    share: float
    sensors: tuple[str, ...] = ()

    def of(self, names: tuple[str, ...], sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what is recorded of a signal (n, s) of sensors of these names."""
        full = float(np.quantile(np.abs(signal), 1.0 - self.share))
        return np.clip(signal, -full, full)


@dataclass(frozen=True)
class DropOut:
    """Samples that the recorder has lost, of all sensors at once.

    Parameters
    ----------
    begin : float
        As a share of the recording.
    seconds : float
    filled : {"held", "zero", "nan"}
        What stands in their place: the last value before, zero, or no number.
    """

    begin: float
    seconds: float
    filled: Literal["held", "zero", "nan"]
    sensors: tuple[str, ...] = ()

    def of(self, names: tuple[str, ...], sample_rate: float, signal: FloatArray) -> FloatArray:
        """Return what is recorded of a signal (n, s) of sensors of these names."""
        found = signal.copy()
        first = max(1, round(self.begin * len(signal)))
        last = first + round(self.seconds * sample_rate)
        found[first:last] = {"held": signal[first - 1], "zero": 0.0, "nan": np.nan}[self.filled]
        return found


def with_spoiling(truth: Truth, name: str, seed: int, number: int) -> Truth:
    """Return a truth with one of :data:`SPOILINGS`, drawn from a seed of its own; with none where `name` is empty."""
    if not name:
        return truth
    draws = np.random.default_rng(seed_from("spoiling", name, seed, truth.hypothesis.label, number))
    return SPOILINGS[name](truth, draws)


def _shocks(truth: Truth, draws: np.random.Generator) -> Truth:
    """Two to five blows of 2 to 6 ms, the largest of 5 to 20 times the recording's rms."""
    count = int(draws.integers(2, 6))
    sizes = draws.uniform(0.4, 1.0, count)
    blows = Blows(
        times=tuple(np.sort(draws.uniform(0.02, 0.98, count)).tolist()),
        sizes=tuple((sizes / sizes.max()).tolist()),
        width=float(draws.uniform(0.002, 0.006)),
        wrench=_draw_wrench(truth.machine, draws),
        peak=math.exp(draws.uniform(math.log(5.0), math.log(20.0))),
    )
    return replace(truth, disturbance=blows)


def _neighbour(truth: Truth, draws: np.random.Generator) -> Truth:
    """Five harmonics of another machine, 0.55 to 0.95 or 1.05 to 1.8 times as fast, of 0.3 to 1 times the rms."""
    factor = float(draws.uniform(0.55, 0.95) if draws.uniform() < 0.5 else draws.uniform(1.05, 1.8))
    frequency = factor * _turn(truth)
    harmonics = range(1, NEIGHBOUR_HARMONICS + 1)
    sizes = tuple(float(draws.uniform(0.3, 1.0)) / k for k in harmonics)
    return _with_tones(truth, tuple(k * frequency for k in harmonics), sizes, draws)


def _gear_mesh(truth: Truth, draws: np.random.Generator) -> Truth:
    """Teeth of a gear on the drive's shaft, 17 to 41, of 0.3 to 1 times the rms: their order, its double, sidebands."""
    teeth = int(draws.integers(17, 42))
    orders = (teeth, 2 * teeth, teeth - 1, teeth + 1, 2 * teeth - 1, 2 * teeth + 1)
    sizes = (1.0, 0.5, 0.3, 0.3, 0.15, 0.15)
    return _with_tones(truth, tuple(order * _turn(truth) for order in orders), sizes, draws)


def _bursts(truth: Truth, draws: np.random.Generator) -> Truth:
    """Ringing of 1.2 to 3.5 kHz, 2.2 to 7.8 times a revolution and never a whole number, of 0.3 to 1 times the rms."""
    order = int(draws.integers(2, 8)) + float(draws.uniform(0.2, 0.8))
    every = 1.0 / (order * _turn(truth))
    bursts = Bursts(
        every=every,
        first=float(draws.uniform(0.0, every)),
        frequency=float(draws.uniform(1200.0, 3500.0)),
        damping=float(draws.uniform(0.02, 0.05)),
        wrench=_draw_wrench(truth.machine, draws),
        rms=_loudness(draws),
    )
    return replace(truth, disturbance=bursts)


def _clipping(truth: Truth, draws: np.random.Generator) -> Truth:
    """A full scale that 0.1 to 2 % of all samples are beyond."""
    return replace(truth, flaw=Clipped(math.exp(draws.uniform(math.log(0.001), math.log(0.02)))))


def _swap(truth: Truth, draws: np.random.Generator) -> Truth:
    """Two sensors that changed places."""
    return replace(truth, flaw=FlawedSensors(_some_sensors(truth, 2, draws), "swapped"))


def _invert(truth: Truth, draws: np.random.Generator) -> Truth:
    """A sensor the wrong way round."""
    return replace(truth, flaw=FlawedSensors(_some_sensors(truth, 1, draws), "inverted"))


def _dead(truth: Truth, draws: np.random.Generator) -> Truth:
    """A sensor of which only the noise of its cable is left."""
    flaw = FlawedSensors(_some_sensors(truth, 1, draws), "dead", seed=int(draws.integers(2**32)))
    return replace(truth, flaw=flaw)


def _short_gap(truth: Truth, draws: np.random.Generator) -> Truth:
    """25 ms without samples."""
    return replace(truth, flaw=_draw_gap(SHORT_GAP, draws))


def _long_gap(truth: Truth, draws: np.random.Generator) -> Truth:
    """Half a second without samples."""
    return replace(truth, flaw=_draw_gap(LONG_GAP, draws))


def _draw_gap(seconds: float, draws: np.random.Generator) -> DropOut:
    filled: tuple[Literal["held", "zero", "nan"], ...] = ("held", "zero", "nan")
    return DropOut(float(draws.uniform(0.1, 0.8)), seconds, filled[int(draws.integers(len(filled)))])


def _with_tones(
    truth: Truth, frequencies: tuple[float, ...], sizes: tuple[float, ...], draws: np.random.Generator
) -> Truth:
    phases = tuple(draws.uniform(0.0, 2.0 * math.pi, len(sizes)).tolist())
    wrench = _draw_wrench(truth.machine, draws)
    return replace(truth, disturbance=Tones(frequencies, sizes, phases, wrench, _loudness(draws)))


def _loudness(draws: np.random.Generator) -> float:
    """Of what goes on all the time, as a multiple of the recording's rms."""
    return math.exp(draws.uniform(math.log(0.3), math.log(1.0)))


def _draw_wrench(machine: Machine, draws: np.random.Generator) -> Wrench:
    """A unit force of any direction at a point of the frame that lies no further out than its sensors."""
    angle = float(draws.uniform(0.0, 2.0 * math.pi))
    cg = machine.links[machine.frame].cg
    reach = np.max(np.abs([(sensor.at[0] - cg[0], sensor.at[1] - cg[1]) for sensor in machine.sensors]), axis=0)
    x, y = (draws.uniform(-1.0, 1.0, 2) * reach).tolist()
    force = (math.cos(angle), math.sin(angle))
    return force[0], force[1], x * force[1] - y * force[0]


def _some_sensors(truth: Truth, count: int, draws: np.random.Generator) -> tuple[str, ...]:
    names = [sensor.name for sensor in truth.machine.sensors]
    if len(names) < count:
        raise DiagnosisError(
            f"machine {truth.machine.name}: {len(names)} sensors: must be at least {count} to be swapped"
        )
    return tuple(names[place] for place in draws.choice(len(names), count, replace=False))


def _turn(truth: Truth) -> float:
    """Revolutions a second."""
    return abs(speed_of(truth.machine, truth.parameters)) / (2.0 * math.pi)


SPOILINGS: Mapping[str, Spoiling] = {
    "shocks": _shocks,
    "neighbour": _neighbour,
    "gear-mesh": _gear_mesh,
    "bursts": _bursts,
    "clipping": _clipping,
    "swapped": _swap,
    "inverted": _invert,
    "dead": _dead,
    "short-gap": _short_gap,
    "long-gap": _long_gap,
}
"""What spoils a recording, by name."""
