"""Lives of machines: how their joints wear from visit to visit, what is repaired, and what else changes meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from second_simulator.faults import soften
from second_simulator.individual import AS_NEW, Individual, log_uniform, recorded_anew
from second_simulator.machine import Array
from second_simulator.process import loaded

#: Visits of a life, and the days between the first and the last, a fifth more or less.
VISITS, DAYS = 30, 1095.0
#: Radial clearance [m] of a worn joint at the last visit, or when it is repaired.
END = (150e-6, 800e-6)
#: Worn joints of the lives in a row of five, and which of three has a mount that loosens; other things by their odds.
WORN_JOINTS, LOOSENS = (1, 2, 0, 3, 1), 1
REPAIRED, FOUND, MOVED, LATE, DOUBLED = 0.7, 0.5, 1 / 3, 0.1, 0.05
#: Stiffness of a loosening mount at the last visit, as a part of what it was.
LOOSE = 0.5
#: Standard deviation of ln(stiffness) of all mounts from day to day: rubber is softer when it is warm.
WARMTH = 0.05
#: Error of a clearance that an inspection measures: part, and metres.
INSPECTION = (0.05, 3e-6)

#: Part of all its wear that a joint has after a part of its time, from 0 to 1.
Law = Callable[[Array, np.random.Generator], Array]
Stream = Callable[..., np.random.Generator]


def _even(age: Array, draw: np.random.Generator) -> Array:
    del draw
    return age


def _growing_faster(age: Array, draw: np.random.Generator) -> Array:
    rate = draw.uniform(2.0, 5.0)
    return np.asarray(np.expm1(rate * age) / np.expm1(rate))


def _running_in(age: Array, draw: np.random.Generator) -> Array:
    """Fast as long as it is new, then slow, then fast."""
    first, second = draw.uniform(0.08, 0.2, 2)
    return np.asarray(first * -np.expm1(-age / 0.06) + second * age + (1 - first - second) * age**5)


def _in_steps(age: Array, draw: np.random.Generator) -> Array:
    """A few jumps, and next to nothing between them."""
    count = int(draw.integers(3, 7))
    at, sizes = draw.uniform(0, 0.95, count), draw.dirichlet(np.full(count, 2.0))
    return np.asarray(0.9 * ((age[:, None] >= at) @ sizes) + 0.1 * age)


LAWS: dict[str, Law] = {
    "even": _even,
    "growing-faster": _growing_faster,
    "running-in": _running_in,
    "steps": _in_steps,
}


@dataclass(frozen=True)
class Finding:
    """An inspection between two visits: when, and the measured clearance [m] of a joint that is then repaired."""

    at: datetime
    joint: str
    measured: float


@dataclass(eq=False)
class Life:
    """What a machine goes through.

    ``clearances`` [m] by joint, (VISITS,); ``repairs`` and ``findings`` by place of the visit that comes next;
    ``mount`` is the place of one that loosens, or -1, ``stiffness`` (VISITS,) its factor; ``arrivals`` are places of
    visits in the order in which their files come, late ones later, doubled ones twice.
    """

    at: list[datetime]
    clearances: dict[str, Array]
    laws: dict[str, str] = field(default_factory=dict)
    repairs: dict[int, str] = field(default_factory=dict)
    findings: dict[int, Finding] = field(default_factory=dict)
    mount: int = -1
    stiffness: Array = field(default_factory=lambda: np.ones(VISITS))
    moved: int = VISITS
    arrivals: list[int] = field(default_factory=list)


def drawn_life(individual: Individual, number: int, draw: np.random.Generator) -> Life:
    """The life of a machine by its number, which says how many joints wear and whether a mount loosens."""
    gaps = draw.gamma(2.0, size=VISITS - 1)
    ages = np.concatenate([[0.0], np.cumsum(gaps / gaps.sum())])
    days = ages * DAYS * draw.uniform(0.8, 1.2)
    began = datetime(2024, 1, 1, 6, tzinfo=UTC) + timedelta(days=float(draw.uniform(0, 200)))
    life = Life(
        at=[(began + timedelta(days=float(day))).replace(microsecond=0) for day in days],
        clearances={name: np.full(VISITS, each) for name, each in individual.clearances.items()},
    )
    joints = list(individual.filed.pins)
    count = min(WORN_JOINTS[(number - 1) % len(WORN_JOINTS)], len(joints))
    for joint in sorted(str(each) for each in draw.choice(joints, count, replace=False)):
        _wear(life, joint, ages, draw.uniform(0.0, 0.6), draw)
    if count and draw.random() < REPAIRED:
        _repair(life, ages, draw)
    if (number - 1) % 3 == LOOSENS:
        onset = draw.uniform(0.0, 0.5)
        life.mount = int(draw.integers(len(individual.machine.mounts)))
        life.stiffness = 1 - (1 - LOOSE) * np.clip((ages - onset) / (1 - onset), 0, 1)
    if draw.random() < MOVED:
        life.moved = int(draw.integers(3, VISITS - 3))
    life.arrivals = _arrivals(draw)
    return life


def _wear(life: Life, joint: str, ages: Array, onset: float, draw: np.random.Generator) -> None:
    """Let a joint wear from an age on."""
    name = str(draw.choice(list(LAWS)))
    fit, end = life.clearances[joint][-1], log_uniform(draw, *END)
    part = LAWS[name](np.clip((ages - onset) / (1 - onset), 0, 1), draw)
    life.clearances[joint] = np.where(ages > onset, fit + (end - fit) * part, life.clearances[joint])
    life.laws[joint] = name


def _repair(life: Life, ages: Array, draw: np.random.Generator) -> None:
    """Give the most worn joint a new fit at some visit, if it is worn enough; it wears anew in half of the cases."""
    most = np.max([life.clearances[name] for name in life.laws], axis=0)
    ripe = [visit for visit in range(VISITS // 3, VISITS - 3) if most[visit - 1] > END[0] / 2]
    if not ripe:
        return
    visit = int(draw.choice(ripe))
    joint = max(life.laws, key=lambda name: float(life.clearances[name][visit - 1]))
    before = float(life.clearances[joint][visit - 1])
    life.repairs[visit] = joint
    life.clearances[joint][visit:] = log_uniform(draw, *AS_NEW)
    if draw.random() < 0.5:
        _wear(life, joint, ages, float(draw.uniform(ages[visit], 0.5 + 0.5 * ages[visit])), draw)
    if draw.random() < FOUND:
        part, length = INSPECTION
        measured = before * (1 + part * draw.normal()) + length * draw.normal()
        halfway = life.at[visit - 1] + (life.at[visit] - life.at[visit - 1]) / 2
        life.findings[visit] = Finding(halfway.replace(microsecond=0), joint, max(measured, 1e-6))


def _arrivals(draw: np.random.Generator) -> list[int]:
    """Places of visits in the order of their files: some come one to four visits late, some twice."""
    order = [(float(place), place) for place in range(VISITS)]
    for place in range(VISITS):
        if draw.random() < LATE:
            order[place] = (place + draw.integers(1, 5) + 0.5, place)
        if draw.random() < DOUBLED:
            order.append((place + draw.integers(0, 5) + 0.6, place))
    return [place for _, place in sorted(order)]


def live(individual: Individual, number: int, draw: np.random.Generator, streams: Stream) -> None:
    """Put a machine into the state it has at the visit of a recording, and record it by the day's speed and noise."""
    which, visit = divmod(number - 1, VISITS)
    life = drawn_life(individual, which + 1, streams("life", which + 1))
    now = {name: float(each[visit]) for name, each in life.clearances.items()}
    individual.clearances.update(now)
    individual.worn.update({name: each for name, each in now.items() if each > AS_NEW[1]})
    if life.mount >= 0:
        individual.machine = soften(individual.machine, life.mount, float(life.stiffness[visit]))
        if life.stiffness[visit] < 1:
            individual.blame("mount", str(life.mount), float(life.stiffness[visit]), "x stiffness")
    if visit >= life.moved:
        _move_sensor(individual, streams("moved", which + 1))
    recorded_anew(individual, draw)
    _have_a_day(individual, draw)
    individual.notes["life"] = _note(life, which + 1, visit)


def _move_sensor(individual: Individual, draw: np.random.Generator) -> None:
    """Sensors of one point go 1 to 5 cm from there, and all have other gains."""
    sensors = individual.machine.sensors
    at = sensors[int(draw.integers(len(sensors)))].at
    angle, way = draw.uniform(0, 2 * math.pi), draw.uniform(0.01, 0.05)
    there = (at[0] + way * math.cos(angle), at[1] + way * math.sin(angle))
    moved = tuple(replace(each, at=there) if each.at == at else each for each in sensors)
    individual.machine = replace(individual.machine, sensors=moved)
    spread = max(abs(each - 1) for each in individual.chain.gains.values())
    gains = {name: float(1 + draw.uniform(-1, 1) * max(spread, 0.05)) for name in individual.chain.gains}
    individual.chain = replace(individual.chain, gains=gains)


def _have_a_day(individual: Individual, draw: np.random.Generator) -> None:
    """The oil is warmer or colder, the output a little loaded, and the rubber of all mounts warmer or colder."""
    slippery, force = float(np.exp(draw.normal(0, 0.1))), float(draw.normal(0, 5.0))
    stiff = float(np.exp(draw.normal(0, WARMTH)))
    contacts = {
        name: replace(each, friction=each.friction * slippery) for name, each in individual.machine.contacts.items()
    }
    individual.machine = loaded(replace(individual.machine, contacts=contacts), force)
    for place in range(len(individual.machine.mounts)):
        individual.machine = soften(individual.machine, place, stiff)
    individual.notes["day"] = {
        "friction_factor": round(slippery, 4),
        "load_n": round(force, 2),
        "mounts_factor": round(stiff, 4),
    }


def _note(life: Life, number: int, visit: int) -> dict[str, Any]:
    """What is true of one visit."""
    found = life.findings.get(visit)
    return {
        "number": number,
        "visit": visit + 1,
        "measured_at": life.at[visit].isoformat(),
        "laws": life.laws,
        "repaired": life.repairs.get(visit),
        "finding": found
        and {"at": found.at.isoformat(), "joint": found.joint, "measured_um": round(1e6 * found.measured, 2)},
        "mount": {"place": life.mount, "factor": round(float(life.stiffness[visit]), 4)} if life.mount >= 0 else None,
        "sensors_moved": visit == life.moved,
        "arrivals": [place + 1 for place, each in enumerate(life.arrivals) if each == visit],
    }
