"""A large catalogue without simulating: made-up spectra of quick-return, to measure what size alone costs.

``python -m benchmarks.fake_catalogue FOLDER --entries 100000`` writes it; without ``--entries``, opening and reading it
are measured, one line a figure. Levels rise with the logarithm of the clearance in a way that each joint has to itself,
and scatter from draw to draw by some decibels, alike in neighbouring bands; keys are those of real entries.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.plans.entry import Entry, Hypothesis
from jointplay.catalogue.plans.plan import Plan, preset
from jointplay.catalogue.plans.variants import Variant
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of
from jointplay.catalogue.storage.hdf5 import encode_shard
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.sealing import seal
from jointplay.catalogue.storage.shard import OK, CaseOutcome, Shard
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import Machine, shipped_machine

CHUNK = 128


def hypotheses(machine: Machine) -> tuple[Hypothesis, ...]:
    """Healthy, every single and every pair."""
    joints = tuple(sorted(machine.turning_joints))
    faults = [Hypothesis.of(worn) for count in (1, 2) for worn in combinations(joints, count)]
    return (Hypothesis.of(()), *faults)


def shards(machine: Machine, manifest: Manifest, plan: Plan, entries: int, seed: int = 0) -> Iterator[Shard]:
    """Yield shards of `entries` made-up cases in all, the same number of each hypothesis.

    As in a real catalogue draws of two contact laws take turns, and each law has shards of its own.
    """
    known, header = hypotheses(machine), manifest.header(plan)
    generator = np.random.default_rng(seed)
    bands = manifest.recipe.scheme.count
    base = -20.0 + 15.0 * _smooth(generator, (len(known), bands, 3))
    slope = 4.0 + 2.0 * _smooth(generator, (len(known), bands, 3))
    done = 0
    for first in range(0, -(-entries // len(known)), CHUNK):
        for index, hypothesis in enumerate(known):
            draws = range(first, first + min(CHUNK, entries - done))
            if not draws:
                return
            done += len(draws)
            joints = tuple(sorted(machine.turning_joints)) if index == 1 else hypothesis.joints
            low, high = (3e-6, 2e-5) if index == 1 else (3e-5, 1e-3)
            clearance = np.exp(generator.uniform(np.log(low), np.log(high), (len(draws), len(joints))))
            wear = np.log(clearance / low).sum(axis=1) if joints else np.zeros(len(draws))
            scatter = 3.0 * _smooth(generator, (len(draws), bands, 3))
            power = _cross_power(
                10.0 ** (0.1 * (base[index] + slope[index] * wear[:, None, None] + scatter)), generator
            )
            drawn = manifest.recipe.nominal_drive_speed * generator.uniform(0.97, 1.03, len(draws))
            friction = generator.uniform(0.01, 0.15, len(draws))
            cases = [
                Entry.of(
                    machine,
                    manifest.recipe,
                    hypothesis=hypothesis,
                    joints=joints,
                    clearances=tuple(clearance[i].tolist()),
                    parameters={"drive.speed": float(drawn[i]), "contact.friction": float(friction[i])},
                    draw=draw,
                    variant=Variant("hertz" if joints and draw % 2 else "own"),
                )
                for i, draw in enumerate(draws)
            ]
            spread = np.full((bands, 3), 1.0, np.float32)
            cyclic = np.zeros((len(header.recipe.scheme.third_octave_groups()) - 1, 2, 3, 3), np.complex64)
            outcomes = [
                CaseOutcome(OK, "", case.parameters["drive.speed"], 1.0, 3, 0.0, power[i], spread, cyclic)
                for i, case in enumerate(cases)
            ]
            for law in dict.fromkeys(case.variant.law for case in cases):
                alike = [i for i, case in enumerate(cases) if case.variant.law == law]
                yield Shard.of(header, [cases[i] for i in alike], [outcomes[i] for i in alike])


def _smooth(generator: np.random.Generator, shape: tuple[int, int, int]) -> NDArray[np.float64]:
    """Normal numbers (..., bands, 3) that are alike in neighbouring bands."""
    white = generator.normal(size=(shape[0], shape[1] + 4, shape[2]))
    return np.asarray(sum(white[:, lag : lag + shape[1]] for lag in range(5)) / np.sqrt(5.0))


def _cross_power(auto: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.complex128]:
    """Matrices (n, B, 3, 3) of these diagonals whose motions are coherent by a half."""
    root = np.sqrt(auto)
    phase = np.exp(2j * np.pi * generator.random(auto.shape))
    mixed = root * phase
    power = 0.5 * mixed[..., :, None] * mixed.conj()[..., None, :]
    power[..., range(3), range(3)] = auto
    return np.asarray(power)


def write(folder: Path, entries: int, orders: int) -> None:
    """Write a catalogue of made-up entries; without waiting for the disk, as nobody will miss it."""
    machine, plan = shipped_machine("quick-return"), preset("standard")
    plan = plan.model_copy(update={"bands": plan.bands.model_copy(update={"orders": orders})})
    layout, manifest = CatalogueDirectory(folder), Manifest.of(machine, plan)
    layout.create()
    with timed("writing shards"):
        for shard in shards(machine, manifest, plan, entries):
            content = encode_shard(shard)
            layout.shard(sha256_of(content)).write_bytes(content)
    with timed("sealing (matrix and manifest)"):
        seal(layout, manifest, layout.shard_names)


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Print how long something took, and the largest memory of this process so far."""
    started = time.perf_counter()
    yield
    print(f"{what}: {time.perf_counter() - started:.3f} s, peak {peak():.0f} MB", flush=True)


def peak() -> float:
    """Largest memory of this process so far, mapped files included [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def measure(folder: Path) -> None:
    """Print what opening and reading cost; best in a process of its own."""
    print(f"before: peak {peak():.0f} MB")
    with timed("open"):
        catalogue = Catalogue.open(folder)
    with timed("map the matrix"):
        matrix = catalogue.matrix
    total = sum(path.stat().st_size for path in catalogue.layout.matrix(matrix.id).iterdir())
    count = len(matrix)
    print(f"entries: {count}; shards {catalogue.size / count:.0f} bytes an entry, matrix {total / count:.0f}")
    with timed("ranges"):
        _ = matrix.ranges
    rows = np.concatenate([matrix.rows(hypothesis.label, draws=400)[:400] for hypothesis in matrix.hypotheses])
    with timed(f"{len(rows)} rows, first time"):
        matrix.packed(rows)
    with timed("the same again"):
        matrix.packed(rows)
    with timed("their table"):
        matrix.table(rows)
    generator = np.random.default_rng(0)
    with timed("4800 rows at random"):
        matrix.packed(np.sort(generator.choice(count, min(4800, count), False)))
    with timed("one entry in full"):
        catalogue.entry(str(matrix.table(np.array([count // 2])).key[0]))
    with timed("the whole table"):
        _ = catalogue.entries
    with timed("all spectra"):
        matrix.packed(matrix.all_rows)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--entries", type=int, help="write so many; without it, measure what is there")
    parser.add_argument("--orders", type=int, default=100, help="one-order bands")
    chosen = parser.parse_args()
    if chosen.entries:
        write(chosen.folder, chosen.entries, chosen.orders)
    else:
        measure(chosen.folder)


if __name__ == "__main__":
    main()
