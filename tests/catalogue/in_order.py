"""Simulated recordings of machines whose numbers, and whose sensors' gains, are known to be off."""

from __future__ import annotations

import math

import numpy as np

from jointplay.catalogue.diagnosing.healthy_machine import quantities
from jointplay.catalogue.measurements.measurement import Channel, Recording
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.sensor import sensor_transform

FS = 10_000.0
GAINS = (1.04, 0.97, 1.0, 0.95)
#: Play of the joints of a machine in order, m.
FITS = {"A": 7e-6, "B": 5e-6, "O": 9e-6}


def recordings(
    catalogue: Catalogue, cases: list[Case], gains: tuple[float, ...] = GAINS, machine: Machine | None = None
) -> list[PreparedMeasurement]:
    """2.5 s of a machine each, with 0.05 m/s2 of noise, by sensors with these gains."""
    made_of = machine or catalogue.machine
    sensors = made_of.sensors
    transform = sensor_transform(
        [s.at for s in sensors], [s.direction for s in sensors], made_of.links[made_of.frame].cg
    )
    channels = tuple(Channel(s.name, "m/s2", "acceleration") for s in sensors)
    settings = Settings(sample_rate=FS, accuracy="standard", revolutions=26.0, motion=False)
    rng = np.random.default_rng(0)
    found = []
    for history in simulate_batch(made_of, cases, settings):
        motion = history.band_limited_acceleration[history.t >= history.transient][:25_000]
        signal = motion @ transform.T * np.array(gains) + rng.normal(0.0, 0.05, (len(motion), len(sensors)))
        recording = Recording("baseline", FS, signal, channels, (), (), "0" * 64)
        found.append(prepare(recording, made_of, scheme=catalogue.scheme))
    return found


def off_by(catalogue: Catalogue, factors: tuple[float, ...], speed: float = 1.01) -> Case:
    found: dict[str, float] = {}
    for quantity, factor in zip(quantities(catalogue.machine), factors, strict=True):
        found |= quantity.parameters(math.log(factor))
    return Case(Fault(FITS), {**found, "drive.speed": catalogue.recipe.nominal_drive_speed * speed})
