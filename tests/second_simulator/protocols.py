"""Protocols: what is the matter with the machines of a set of recordings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from second_simulator.disturbances import DISTURBANCES, inertia_force
from second_simulator.faults import FAULTS, soften
from second_simulator.individual import (
    WORN,
    Individual,
    drawn_contact,
    drawn_individual,
    erred,
    log_uniform,
    recorded_anew,
    scattered_contacts,
)
from second_simulator.lives import VISITS, live
from second_simulator.machine import Machine
from second_simulator.process import loaded
from second_simulator.turning import Ripple

#: Random numbers that belong to given names and numbers.
Stream = Callable[..., np.random.Generator]
Change = Callable[[Individual, int, np.random.Generator, Stream], None]

#: Radial clearances [m]: beyond what catalogues hold; small; of a joint that grows, and in how many recordings.
BEYOND, SMALL, GROWING, GROWN = (2.1e-3, 3e-3), (30e-6, 500e-6), (25e-6, 600e-6), 16
#: By machine: a load on the output, in root mean squares of the force by which the moving parts shake the frame, and
#: the joints that it holds shut: what their wear then adds above 300 Hz is within 4 dB of noise of 0.1 m/s2.
HOLDS = {
    "slider-crank": (-2.5, ("O", "A", "B")),
    "four-bar": (-4.0, ("O", "A", "B")),
    "quick-return": (4.0, ("O", "C", "E", "F")),
}

#: Recordings of one machine, of protocols that have several.
SERIES = {"growing": GROWN, "held-shut": 2, "lives": VISITS}


def _worn(count: int, span: tuple[float, float] = WORN) -> Change:
    """So many worn joints; the sets come in an order of their own, each before any comes again."""

    def change(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
        _wear_some(individual, list(individual.filed.pins), count, span, number, draw, streams)

    return change


def _wear_some(
    individual: Individual,
    joints: Sequence[str],
    count: int,
    span: tuple[float, float],
    number: int,
    draw: np.random.Generator,
    streams: Stream,
) -> None:
    """The set of worn joints that is a recording's turn."""
    sets = list(combinations(joints, count))
    order = streams("sets").permutation(len(sets))
    names = sets[order[(number - 1) % len(sets)]]
    individual.wear({name: log_uniform(draw, *span) for name in names})


def _sound(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    del individual, number, draw, streams


def _any_joints(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    del number, streams
    count = int(draw.integers(1, min(3, len(individual.filed.pins)) + 1))
    names = draw.choice(list(individual.filed.pins), count, replace=False)
    individual.wear({str(name): log_uniform(draw, *SMALL) for name in sorted(names)})


def _every_other(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    """The second, fourth ... recording has a worn joint."""
    if number % 2 == 0:
        _worn(1)(individual, number // 2, draw, streams)


def _growing(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    series, place = divmod(number - 1, GROWN)
    names = list(individual.filed.pins)
    joint = names[streams("sets").permutation(len(names))[series % len(names)]]
    low, high = GROWING
    individual.wear({joint: low * (high / low) ** (place / (GROWN - 1))})
    individual.notes["series"] = {"number": series + 1, "place": place + 1}
    recorded_anew(individual, draw)


def _disturbed(wear: Change) -> Change:
    def change(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
        wear(individual, number, draw, streams)
        name = list(DISTURBANCES)[(number - 1) % len(DISTURBANCES)]
        individual.disturbance, individual.shaking = name, DISTURBANCES[name]
        if name == "clipping":
            individual.chain = replace(individual.chain, clipped=log_uniform(draw, 5e-4, 2e-2))

    return change


def _ripples(individual: Individual, draw: np.random.Generator) -> None:
    """Unevenness of the drive at orders 6 and 12, up to 1 % and 0.5 % of its speed."""
    for order, share in ((6, 0.01), (12, 0.005)):
        amplitude = float(draw.uniform(0.3, 1.0)) * share / order
        individual.ripple.append(Ripple(order, amplitude, float(draw.uniform(0, 2 * math.pi))))


def _cyclic_load(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    _every_other(individual, number, draw, streams)
    force, part = float(draw.uniform(120, 150)), float(draw.uniform(0.1, 0.3))
    individual.machine = loaded(individual.machine, -part * force, force, int(draw.choice([-1, 1])))
    individual.notes["load_n"] = {"constant": -part * force, "stroke": force}
    _ripples(individual, draw)


def _other_cause(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    order = streams("faults").permutation(len(FAULTS))
    FAULTS[order[(number - 1) % len(FAULTS)]](individual, draw)


def _sensor_flaws(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    _every_other(individual, number + (number - 1) // 4, draw, streams)
    one, other = (str(name) for name in draw.choice(list(individual.chain.gains), 2, replace=False))
    kind = ("swapped", "inverted", "dead", "half")[(number - 1) % 4]
    flaws = {one: other, other: one} if kind == "swapped" else {one: kind}
    individual.chain = replace(individual.chain, flaws=flaws)
    individual.blame(f"sensor-{kind}", "+".join(flaws))


def _held_shut(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    """One or two worn joints: a load holds them shut in the first recording of two, and not in the second."""
    pair, again = divmod(number - 1, 2)
    if individual.filed.name not in HOLDS:
        raise ValueError(f"{individual.filed.name}: no load is known that holds its joints shut")
    multiple, joints = HOLDS[individual.filed.name]
    once = streams("pair", pair)
    _wear_some(individual, joints, 1 + pair % 2, WORN, pair // 2 + 1, once, streams)
    force = multiple * inertia_force(individual.machine, abs(individual.speed))
    if again:  # nothing, or a little the other way
        force *= -float(once.choice([0.0, 0.15]))
        recorded_anew(individual, draw)
        individual.notes["of"] = f"{individual.filed.name}-held-shut-{number - 1:02d}"
    individual.machine = loaded(individual.machine, force)
    individual.notes["load_n"] = {"constant": force, "stroke": 0.0}


def _drop_outs(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    fours = (number - 1) // 4
    _every_other(individual, number + fours, draw, streams)
    short = ((number - 1) // 2 + fours) % 2 == 0
    if short:
        individual.longest = 3.0
    kind = ("rows", "nan", "held", "zero")[(number - 1) % 4]
    individual.notes["drop_out"] = {"kind": kind, "length_s": 0.025 if short else 0.5}


def _model_errors(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    _worn(2)(individual, number, draw, streams)
    err(individual, draw)


def err(individual: Individual, draw: np.random.Generator) -> None:
    """All errors of model and sensors at once, on a machine that nothing else was done to yet."""
    machine = scattered_contacts(erred(individual.filed, draw), drawn_contact(draw, 1.6), draw)
    frame, (heavier, lazier) = machine.bodies[machine.frame], draw.uniform(0.9, 1.1, 2)
    machine = machine.with_body(machine.frame, mass=frame.mass * heavier, inertia=frame.inertia * lazier)
    for place in range(len(machine.mounts)):
        machine = soften(machine, place, float(draw.uniform(0.9, 1.1)))
    constant, stroke = float(draw.uniform(-40, 40)), float(draw.uniform(0, 60))
    individual.machine = loaded(machine, constant, stroke, int(draw.choice([-1, 1])))
    individual.notes["load_n"] = {"constant": constant, "stroke": stroke}
    gains = {name: float(1 + draw.uniform(-0.1, 0.1)) for name in individual.chain.gains}
    individual.chain = replace(individual.chain, gains=gains)
    _ripples(individual, draw)


PROTOCOLS: Mapping[str, Change] = {
    "sound": _sound,
    "singles": _worn(1),
    "pairs": _worn(2),
    "triples": _worn(3),
    "beyond-range": _worn(1, BEYOND),
    "growing": _growing,
    "small": _any_joints,
    "disturbed-sound": _disturbed(_sound),
    "disturbed-worn": _disturbed(_worn(1)),
    "cyclic-load": _cyclic_load,
    "other-cause": _other_cause,
    "sensor-flaws": _sensor_flaws,
    "drop-outs": _drop_outs,
    "model-errors": _model_errors,
    "held-shut": _held_shut,
    "lives": live,
}


def individual_of(
    filed: Machine, protocol: str, number: int, streams: Stream, *, model_errors: bool = False
) -> Individual:
    """The machine of a recording: of growing wear and of lives, one machine for all recordings of a series."""
    individual = _alone(filed, protocol, number, streams, model_errors)
    PROTOCOLS[protocol](individual, number, streams("change", number), streams)
    return individual


def individual_before(
    filed: Machine, protocol: str, number: int, streams: Stream, *, model_errors: bool = False
) -> Individual:
    """The same machine on another day, when nothing was the matter with it yet."""
    individual = _alone(filed, protocol, number, streams, model_errors)
    recorded_anew(individual, streams("before", number))
    return individual


def _alone(filed: Machine, protocol: str, number: int, streams: Stream, model_errors: bool) -> Individual:
    """The machine of a recording as it was when it was new, by the number of the machine."""
    whose = (number - 1) // SERIES[protocol] if protocol in SERIES else number
    individual = drawn_individual(filed, streams("individual", whose))
    if model_errors:
        err(individual, streams("errors", whose))
    return individual
