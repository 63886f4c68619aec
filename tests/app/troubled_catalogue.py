"""A catalogue that is there at once, a part of whose cases failed: its spectra are made up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jointplay.catalogue.building.build import build
from jointplay.catalogue.building.chunk import Chunk
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.shard import OK, CaseOutcome
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.spectra.bands import BandScheme

PLAN = parse_plan({"name": "made up", "draws": {"healthy": 6, "single": 12}, "fits": {"silent": 0}, "laws": {"own": 1}})
MESSAGE = "left <the range> at t = 0.1 s"


def fails(key: str) -> bool:
    """One case in eight."""
    return key.startswith(("7", "c"))


def compute(chunk: Chunk) -> tuple[CaseOutcome, ...]:
    """Make up the outcomes of some cases; they follow from the keys."""
    return tuple(outcome(entry.key, chunk.recipe.scheme) for entry in chunk.entries)


def outcome(key: str, scheme: BandScheme) -> CaseOutcome:
    if fails(key):
        return CaseOutcome("diverged", MESSAGE, 60.0, 0.0, 0, 0.5)
    random, bands = np.random.default_rng(int(key[:8], 16)), scheme.count
    cyclic = np.zeros((len(scheme.third_octave_groups()) - 1, 2, 3, 3), np.complex64)
    root = random.normal(size=(bands, 3, 3)) + 1j * random.normal(size=(bands, 3, 3))
    power = (root @ root.conj().swapaxes(1, 2)).astype(np.complex64)
    return CaseOutcome(OK, "", 60.0, 0.25, 4, 0.5, power, random.random((bands, 3)).astype(np.float32), cyclic)


def make(folder: Path) -> tuple[int, int]:
    """Make the catalogue; returns how many cases it has, and how many of them failed."""
    machine = shipped_machine("slider-crank")
    report = build(machine, PLAN, folder, workers=0, compute=compute)
    failed = sum(fails(entry.key) for entry in entries_of(PLAN, machine))
    assert 0 < failed == sum(report.failed.values())
    return len(entries_of(PLAN, machine)), failed
