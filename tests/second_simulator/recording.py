"""Recordings as files, and the truth about them beside."""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from second_simulator.individual import Individual, recorded_anew
from second_simulator.machine import Array, Machine
from second_simulator.protocols import individual_before, individual_of
from second_simulator.sensors import FINE_RATE, RATE, decimated, logged, point_accelerations
from second_simulator.simulation import STEPS, Run, run

EDGE = 200  # samples at either end that the filter has not filled


def stream(*parts: object) -> np.random.Generator:
    """Random numbers that belong to some names and numbers alone."""
    return np.random.default_rng([zlib.crc32(str(part).encode()) for part in parts])


def recorded(individual: Individual, draw: np.random.Generator, steps: int = STEPS) -> tuple[dict[str, Array], Run]:
    """Columns at RATE, `time` first, of one individual machine; and the run they were made of."""
    if math.isfinite(individual.longest):
        individual.longest += 2 * EDGE / RATE
    motion = run(individual, draw, steps)
    fine = point_accelerations(individual.machine, motion.motion, FINE_RATE)
    columns = logged({name: decimated(each) for name, each in fine.items()}, individual.chain, draw)
    kept = {name: each[EDGE:-EDGE] for name, each in columns.items()}
    time = np.round(np.arange(len(next(iter(kept.values())))) / RATE, 6)
    return {"time": time, **kept}, motion


def truth_of(individual: Individual, made: Run) -> dict[str, Any]:
    """All that is true of a recording, as plain data."""
    contact = next(iter(individual.machine.contacts.values()))
    frame, filed = (each.bodies[each.frame] for each in (individual.machine, individual.filed))
    return {
        "machine": individual.filed.name,
        "worn_um": {name: round(1e6 * each, 2) for name, each in individual.worn.items()},
        "clearances_um": {name: round(1e6 * each, 2) for name, each in individual.clearances.items()},
        "causes": individual.causes,
        "disturbance": individual.disturbance,
        "speed_rpm": round(made.mean_speed * 30 / math.pi, 4),
        "wander_max": round(float(individual.wander[:, 0].sum()), 6),
        "ripple": [vars(each) for each in individual.ripple],
        "contact": vars(contact),
        "frame_mass_factor": round(frame.mass / filed.mass, 4),
        "noise_rms": individual.chain.noise,
        "hum_amplitude": individual.chain.hum,
        "gain": {name: round(each, 4) for name, each in individual.chain.gains.items()},
        **individual.notes,
    }


def write(
    machine: Machine,
    protocol: str,
    number: int,
    seed: int,
    folder: Path,
    *,
    before: bool = False,
    factor: float = 1.0,
    course: Sequence[tuple[float, float]] = (),
    model_errors: bool = False,
) -> tuple[str, bool]:
    """Make one recording where it is not there yet; return its name, and whether it was made.

    With ``before``, of the same machine when nothing was the matter with it yet; with a ``factor``, of the same machine
    in the same state, recorded once more at so many times its drive speed; with a ``course`` of times and factors, once
    more while its speed changes. With ``model_errors`` machines and sensors err as those of the protocol of that name,
    whatever the protocol.
    """
    folder.mkdir(parents=True, exist_ok=True)
    first = f"{machine.name}-{protocol}-{number:02d}"
    name = first if factor == 1.0 else f"{first}-at-{factor:g}"
    if course:
        name = f"{first}-over-{'-'.join(f'{number:g}' for point in course for number in point)}"
    truth_file, file = folder / "truth.json", folder / f"{name}.npz"
    truths = json.loads(truth_file.read_text()) if truth_file.exists() else {}
    if name in truths and file.exists():
        return name, False
    of = individual_before if before else individual_of
    individual = of(
        machine,
        protocol,
        number,
        lambda *parts: stream(seed, machine.name, protocol, *parts),
        model_errors=model_errors,
    )
    again: dict[str, Any] = {}
    visit: list[object] = ["before" if before else "recording"]
    if factor != 1.0:
        again, visit = {"of": first, "speed_factor": factor}, [*visit, factor]
        recorded_anew(individual, stream(seed, machine.name, protocol, number, "visit", factor))
        individual.speed *= factor
    if course:
        again, visit = {"of": first, "course": [list(point) for point in course]}, [*visit, name]
        recorded_anew(individual, stream(seed, machine.name, protocol, number, "visit", name))
        individual.course = course
        if individual.shaking is not None or factor != 1.0:
            raise ValueError("a course goes with neither disturbances nor a factor")
    draw = stream(seed, machine.name, protocol, number, *visit)
    columns, made = recorded(individual, draw)
    columns = _dropped(columns, individual, draw)
    units = json.dumps({name: "s" if name == "time" else "m/s2" for name in columns})
    small = {key: each if key == "time" else each.astype(np.float32) for key, each in columns.items()}
    said = {key: individual.notes["life"][key] for key in ("measured_at",) if "life" in individual.notes}
    unfinished = file.with_suffix(".part")
    with unfinished.open("wb") as stream_out:
        np.savez_compressed(stream_out, units=np.array(units), attributes=np.array(json.dumps(said)), **small)  # type: ignore[arg-type]
    os.replace(unfinished, file)
    truths = json.loads(truth_file.read_text()) if truth_file.exists() else {}
    truths[name] = {
        **truth_of(individual, made),
        **again,
        "model_errors": model_errors,
        "seed": seed,
        "duration_s": float(columns["time"][-1]),
    }
    unfinished = truth_file.with_suffix(".part")
    unfinished.write_text(json.dumps(truths, indent=1))
    os.replace(unfinished, truth_file)
    return name, True


def _dropped(columns: dict[str, Array], individual: Individual, draw: np.random.Generator) -> dict[str, Array]:
    """The columns with the drop-out that an individual's notes ask for: rows missing, not a number, held or zero."""
    said = individual.notes.get("drop_out")
    if not said:
        return columns
    count = len(columns["time"])
    length = round(said["length_s"] * RATE)
    first = int(draw.integers(count // 5, 4 * count // 5 - length))
    said["at_s"] = float(columns["time"][first])
    gone = slice(first, first + length)
    if said["kind"] == "rows":
        return {name: np.delete(each, gone) for name, each in columns.items()}
    for name, each in columns.items():
        if name != "time":
            each[gone] = {"nan": math.nan, "held": each[first - 1], "zero": 0.0}[said["kind"]]
    return columns
