"""Lives of simulated machines, visit by visit: what the state of wear makes of them.

What machines are like follows from seed and number; what is drawn in a life is told in the docs of protocols.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.errors import DiagnosisError, MeasurementError
from jointplay.catalogue.evaluation.life_figures import Life, LifeFigure, LifeVisit, figures_of_lives, judge_life
from jointplay.catalogue.evaluation.protocols import PROTOCOLS, draw_truth
from jointplay.catalogue.evaluation.recordings import Recordings, recorded
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.catalogue.following.play import bounds_of
from jointplay.catalogue.following.visits import Inspection
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.plans.driving import at_speed, nominal_drive_speed
from jointplay.catalogue.plans.entry import Hypothesis, seed_from
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Mount

NAME = "lives"
VISITS = 30
"""Recordings of a machine."""

BASELINES = 3
"""Recordings that all others are compared with, the first ones: what is done when a machine is taken into service."""

_DAYS = 1095.0
_WORN = (1, 2, 0, 3, 1)
_END = (150e-6, 800e-6)
_PROTOCOL = replace(PROTOCOLS["hard"], name=NAME)

LAWS: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "even": lambda age: age,
    "faster": lambda age: age**3,
    "running-in": lambda age: 0.2 * -np.expm1(-age / 0.06) + 0.2 * age + 0.6 * age**5,
    "steps": lambda age: 0.9 * np.floor(4.0 * age) / 4.0 + 0.1 * age,
}
"""Part of its wear that a joint has after a part of its time."""


@dataclass(frozen=True)
class LifeStudy:
    """Figures of lives.

    Parameters
    ----------
    machine, catalogue : str
        Its name; SHA-256 of the catalogue's content.
    seed, count : int
        Of what was drawn; machines.
    figures : tuple of LifeFigure
    """

    machine: str
    catalogue: str
    seed: int
    count: int
    figures: tuple[LifeFigure, ...]

    def content(self) -> dict[str, object]:
        """Return everything as plain data, for JSON; null where a figure has no cases."""
        found = dataclasses.asdict(self)
        for figure in found["figures"]:
            numbers = [each if math.isfinite(each) else None for each in (figure["value"], *figure["interval"])]
            figure["value"], figure["interval"] = numbers[0], numbers[1:]
        return found


@dataclass(frozen=True)
class DrawnLife:
    """A machine's life before it is recorded: `truths` of its visits, and all else that is true.

    `life` has visits without answers.
    """

    truths: tuple[Truth, ...]
    life: Life


def evaluate_lives(
    catalogue: Catalogue,
    count: int = 200,
    seed: int = 1,
    *,
    recordings: Recordings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LifeStudy:
    """Diagnose machines over their lives, follow them, and compare with the truth.

    Parameters
    ----------
    catalogue : Catalogue
    count : int
        Machines, of 30 recordings each.
    seed : int
        Of everything drawn.
    recordings : Recordings, optional
        Where simulations are kept; nowhere without it.
    progress : callable, optional
        Called with the number of recordings done and their total.

    Raises
    ------
    DiagnosisError
        A machine without sensors or without joints that wear, or nothing could be diagnosed.
    """
    machine = catalogue.machine
    if not machine.sensors or not machine.wearing_joints:
        raise DiagnosisError(f"machine {machine.name}: has no {'joints that wear' if machine.sensors else 'sensors'}")
    bounds = bounds_of(machine, sorted(machine.wearing_joints))
    kept = recordings or Recordings()
    judged = []
    for number in range(1, count + 1):
        drawn = draw_life(machine, seed, number)
        signals = dict(kept.ideal(_PROTOCOL, drawn.truths))
        made = [
            None if (signal := signals[place]) is None else recorded(_PROTOCOL, truth, signal)
            for place, truth in enumerate(drawn.truths)
        ]
        visits = _hear(drawn.life.visits, made, catalogue)
        judged.append(judge_life(replace(drawn.life, visits=visits), bounds))
        if progress is not None:
            progress(number * VISITS, count * VISITS)
    figures = figures_of_lives(judged)
    if not figures[0].right:
        raise DiagnosisError(f"none of {count * VISITS} recordings of protocol {NAME} could be diagnosed")
    return LifeStudy(machine.name, catalogue.id, seed, count, figures)


def _hear(visits: Sequence[LifeVisit], made: Sequence[Recording | None], catalogue: Catalogue) -> tuple[LifeVisit, ...]:
    """The visits with their answers, alone and beside the first recordings; as they were where one is refused."""
    alone: dict[int, Answer] = {}
    for place, recording in enumerate(made):
        with suppress(MeasurementError):
            if recording is not None:
                alone[place] = diagnose(recording, catalogue)
    past = [each for place, each in enumerate(made[:BASELINES]) if each is not None and place in alone]
    heard = list(visits)
    for place, said in alone.items():
        recording = made[place]
        assert recording is not None
        before = [each for each in past if each is not recording]
        answer = diagnose(recording, catalogue, baseline=before) if before else said
        heard[place] = replace(visits[place], sha256=recording.sha256, answer=answer, alone=said)
    return tuple(heard)


def draw_life(machine: Machine, seed: int, number: int) -> DrawnLife:
    """Return the life of a machine; its number, from 1, says how many joints wear and whether a mount loosens."""
    draws = np.random.default_rng(seed_from(NAME, seed, number))
    new = draw_truth(machine, Hypothesis.of(()), _PROTOCOL, seed, number)
    gaps = draws.gamma(2.0, size=VISITS - 1)
    ages = np.concatenate([[0.0], np.cumsum(gaps / gaps.sum())])
    at = [datetime(2024, 1, 1, tzinfo=UTC) + timedelta(days=float(_DAYS * age)) for age in ages]
    course = {joint: np.full(VISITS, clearance) for joint, clearance in new.clearances.items()}
    count = min(_WORN[(number - 1) % len(_WORN)], len(course))
    names = [str(each) for each in draws.choice(sorted(course), count, replace=False)]
    for joint in names:
        _wear(course, joint, ages, draws.uniform(0.0, 0.6), draws)
    repairs, inspections = _repair(course, names, at, draws)
    mount, stiffness = _loosen(machine, number, ages, draws)
    gains = 1.0 + draws.uniform(-0.05, 0.05, (len(machine.sensors), 2))  # before and after sensors are moved
    moved = int(draws.integers(3, VISITS)) if draws.random() < 1 / 3 else VISITS
    order = np.argsort(np.arange(VISITS) + (draws.random(VISITS) < 0.1) * (0.5 + draws.integers(1, 5, VISITS)))
    arrivals: list[list[int]] = [[] for _ in range(VISITS)]
    for place, visit in enumerate(order.tolist()):
        arrivals[visit].append(2 * place)
        if draws.random() < 0.05:
            arrivals[visit].append(2 * place + 7)  # odd: no other file has this place
    truths, visits = [], []
    for place in range(VISITS):
        speed = nominal_drive_speed(machine) * (1.0 + float(draws.uniform(-0.02, 0.02)))
        clearances = {joint: float(each[place]) for joint, each in course.items()}
        oil = float(math.exp(draws.normal(0.0, 0.1)))
        day = {path: value * oil for path, value in new.parameters.items() if path.endswith(("friction", "viscosity"))}
        soft = _softened(machine, mount, float(stiffness[place]))
        truths.append(
            replace(
                new,
                clearances=clearances,
                parameters={**new.parameters, **at_speed(machine, speed), **day, **soft},
                gains=tuple(gains[:, int(place >= moved)].tolist()),
                seed=seed_from(NAME, "noise", seed, number, place),
            )
        )
        visits.append(LifeVisit(at[place], f"visit {place + 1}", clearances, None, tuple(arrivals[place])))
    loosening = f"mount {mount}" if mount is not None else ""
    return DrawnLife(
        tuple(truths), Life(f"{machine.name} {number}", tuple(visits), inspections, tuple(repairs), loosening)
    )


def _wear(
    course: dict[str, FloatArray], joint: str, ages: FloatArray, onset: float, draws: np.random.Generator
) -> None:
    """Let a joint wear from an age on, by a law that is drawn."""
    law = LAWS[str(draws.choice(list(LAWS)))]
    end, fit = math.exp(draws.uniform(*np.log(_END))), course[joint][-1]
    part = law(np.clip((ages - onset) / (1.0 - onset), 0.0, 1.0))
    course[joint] = np.where(ages > onset, fit + (end - fit) * part, course[joint])


def _repair(
    course: dict[str, FloatArray],
    names: Sequence[str],
    at: Sequence[datetime],
    draws: np.random.Generator,
) -> tuple[list[tuple[int, str]], tuple[Inspection, ...]]:
    """Give the most worn joint a new fit in most lives; half of the repairs are told, with what was found before."""
    most = np.max([course[name] for name in names], axis=0) if names else np.zeros(VISITS)
    ripe = [place for place in range(VISITS // 3, VISITS - 3) if most[place - 1] > 0.5 * _END[0]]
    if not ripe or draws.random() > 0.7:
        return [], ()
    place = int(draws.choice(ripe))
    joint = max(names, key=lambda name: float(course[name][place - 1]))
    before = float(course[joint][place - 1])
    course[joint] = course[joint].copy()
    course[joint][place:] = math.exp(draws.uniform(*np.log(_PROTOCOL.fits)))
    if draws.random() < 0.5:
        return [(place, joint)], ()
    found = max(before * (1.0 + 0.05 * draws.normal()) + 3e-6 * draws.normal(), 1e-6)
    halfway = at[place - 1] + (at[place] - at[place - 1]) / 2
    return [(place, joint)], (Inspection(halfway, {joint: found}, frozenset([joint]), "found"),)


def _loosen(
    machine: Machine, number: int, ages: FloatArray, draws: np.random.Generator
) -> tuple[int | None, FloatArray]:
    """Place of a mount that loosens in every third life, and its stiffness over time as a part of what it was."""
    mounts = [place for place, support in enumerate(machine.supports) if isinstance(support, Mount)]
    if number % 3 != 2 or not mounts:
        return None, np.ones(VISITS)
    onset = float(draws.uniform(0.0, 0.5))
    return int(draws.choice(mounts)), 1.0 - 0.5 * np.clip((ages - onset) / (1.0 - onset), 0.0, 1.0)


def _softened(machine: Machine, place: int | None, factor: float) -> dict[str, float]:
    """Numbers of a mount whose stiffness has a factor, and whose damping its root."""
    if place is None:
        return {}
    mount = machine.supports[place]
    assert isinstance(mount, Mount)
    found = {
        f"supports.{place}.stiffness.{axis}": factor * value for axis, value in enumerate(mount.stiffness) if value
    }
    root = math.sqrt(factor)
    return found | {
        f"supports.{place}.damping.{axis}": root * value for axis, value in enumerate(mount.damping) if value
    }
