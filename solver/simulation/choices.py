"""What each choice of the model costs, and what it changes in the frame's spectrum: friction, contacts, what is left
out, sampling, length of the record, beside the tolerances of :mod:`jointplay.solver.simulation.tradeoff`.

A choice is compared with the machine as its file has it, both at the tolerance of `reference`, so that nothing but the
choice differs; it costs what it costs at `standard`. Below what runs of the machine itself differ by when they start a
rounding apart, nothing is told.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.machines.equal_contact import equal_contact
from jointplay.solver.machines.friction import FRICTION_CHOICES, FRICTION_NUMBERS, DryFriction, FrictionLaw
from jointplay.solver.machines.joints import Contact, Joint, SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.tradeoff import CHAOTIC_DB
from jointplay.solver.simulation.workbench import Bench, bench_of, middle
from jointplay.solver.spectra.harmonics import find_comparable, mean_difference_db, whole_rate

#: Laws of friction that are tried, each with its number (m, m/s); a coefficient of 0 is one more.
FRICTIONS: tuple[tuple[FrictionLaw, float], ...] = (
    ("bristle", 3e-9), ("bristle", 1e-7), ("tanh", 1e-4), ("tanh", 1e-3), ("tanh", 1e-2), ("threshold", 1e-3),
)  # fmt: skip
#: Sample rates, Hz, and revolutions of the record that are tried.
SAMPLE_RATES = (5000.0, 10_000.0, 40_000.0)
LENGTHS = (2, 5)
_COST, _FINE = Settings(accuracy="standard"), Settings(accuracy="reference")


@dataclass(frozen=True)
class ModelChoice:
    """One choice, measured.

    Attributes
    ----------
    kind, name : str
        What is chosen (``friction``, ``contact``, ``sampling``, ``record``) and how, as one would write it in a file or
        as an option.
    status : Status
        The worst of its runs.
    seconds : float
        Processor seconds per simulated second of a case at `standard`, of a shorter record per second of the whole one.
    difference_db : float
        Mean |dB| of harmonics (one-order bands where the response is chaotic) from the machine as filed; NaN unless ok.
    """

    kind: str
    name: str
    status: Status
    seconds: float
    difference_db: float


@dataclass(frozen=True)
class ModelChoices:
    """All choices of one case.

    Attributes
    ----------
    seconds : float
        Of the machine as filed, as :attr:`ModelChoice.seconds`.
    floor_db : float
        What runs of the machine as filed differ by, dB: no smaller difference says anything.
    chaotic : bool
        Whether bands, means over the runs, are compared in place of harmonics.
    choices : tuple of ModelChoice
    """

    seconds: float
    floor_db: float
    chaotic: bool
    choices: tuple[ModelChoice, ...]


def measure_choices(machine: Machine, case: Case) -> ModelChoices | History:
    """Measure all choices that differ from the machine as filed; the history of the first that failed, where it does.

    Raises
    ------
    SettingsError, AssemblyError, MachineError
        As :func:`jointplay.solver.simulation.tradeoff.measure`.
    """
    bench, _ = bench_of(machine, case)
    finest, _ = bench.run(_FINE, repeats=1)
    for history in finest:
        if history.status is not Status.OK:
            return history
    lines = bench.levels(finest)
    chaotic = mean_difference_db(lines[1:], lines[0]) > CHAOTIC_DB
    levels = bench.levels(finest, bands=chaotic)
    reference, kept = middle(levels, chaotic), find_comparable(middle(levels, chaotic))
    spread = float(np.std(levels[:, kept], axis=0, ddof=1).mean())
    _, cost = bench.run(_COST)
    found = []
    for kind, name, other in _machines(machine, case):
        own, _ = bench_of(other, _without_numbers_of_friction(case, other))
        found.append(_compared(kind, name, own, bench, reference, chaotic))
    for rate in SAMPLE_RATES:
        if abs(rate - bench.sample_rate) > 1.0:
            other_rate = replace(bench, sample_rate=whole_rate(bench.frequency, rate))
            found.append(_compared("sampling", f"--sample-rate {rate:g}Hz", other_rate, bench, reference, chaotic))
    for count in LENGTHS:
        found.append(_shortened(count, bench, finest, cost, reference, chaotic))
    floor = spread / math.sqrt(LANES) if chaotic else spread
    return ModelChoices(cost / bench.duration, floor, chaotic, tuple(found))


def _compared(kind: str, name: str, own: Bench, bench: Bench, reference: FloatArray, chaotic: bool) -> ModelChoice:
    """A choice as its own bench has it, against the levels of the machine as filed, over the same revolutions."""
    own = replace(own, transient=bench.transient, duration=bench.duration)
    fine, _ = own.run(_FINE, repeats=1)
    quick, cost = own.run(_COST)
    worst = max((*fine, *quick), key=lambda history: history.status is not Status.OK)
    if worst.status is not Status.OK:
        return ModelChoice(kind, name, worst.status, math.nan, math.nan)
    levels = middle(own.levels(fine, bands=chaotic), chaotic)
    both = min(len(levels), len(reference))
    difference = mean_difference_db(levels[:both], reference[:both])
    return ModelChoice(kind, name, Status.OK, cost / own.duration, difference)


def _shortened(
    count: int, bench: Bench, finest: Sequence[History], cost: float, reference: FloatArray, chaotic: bool
) -> ModelChoice:
    """The first revolutions of the record in place of all; what they would cost is in proportion."""
    part = bench.transient + (count + bench.spare) / bench.frequency
    samples = round(part * bench.sample_rate)
    cut = [replace(h, band_limited_acceleration=h.band_limited_acceleration[:samples]) for h in finest]
    levels = middle(bench.levels(cut, bands=chaotic), chaotic)
    difference = mean_difference_db(levels, reference)
    return ModelChoice("record", f"{count} revolutions", Status.OK, cost * part / bench.duration**2, difference)


def _machines(machine: Machine, case: Case) -> Iterator[tuple[str, str, Machine]]:
    """The machine with other laws: kind, name and file of each that is not the file's own."""
    rubbing = [part for part in _rubbing(machine, case) if part.friction]
    for law, value in FRICTIONS if rubbing else ():
        (number,) = FRICTION_NUMBERS[law]
        said = {"friction_law": law, number: value}
        if any(part.friction_law != law or getattr(part, number) != value for part in rubbing):
            yield "friction", f"{{friction_law: {law}, {number}: {value:g}}}", _with_friction(machine, said)
    if rubbing:
        yield "friction", "{friction: 0}", _with_friction(machine, {"friction": 0.0})
    for form in ("linear", "hertz"):
        if any(machine.joints[name].contact.law != form for name in case.fault.joints):
            joints = dict(machine.joints)
            for name in machine.wearing_joints:
                contact = equal_contact(machine, joints[name], form)
                joints[name] = joints[name].model_copy(update={"contact": contact})
            yield "contact", f"{{law: {form}}}, as stiff at 40 um", machine.model_copy(update={"joints": joints})


def _rubbing(machine: Machine, case: Case) -> Iterator[DryFriction]:
    for name, joint in machine.joints.items():
        if name in case.fault:
            yield joint.contact
        elif isinstance(joint, SlidingJoint):
            yield joint


def _with_friction(machine: Machine, said: Mapping[str, object]) -> Machine:
    """The machine with this said of friction everywhere; what belongs to another law goes."""

    def change(part: DryFriction) -> dict[str, Any]:
        foreign = FRICTION_CHOICES if "friction_law" in said else ()
        return {k: v for k, v in part.model_dump().items() if k not in foreign and v is not None} | dict(said)

    joints: dict[str, Joint] = {}
    for name, joint in machine.joints.items():
        if isinstance(joint, SlidingJoint) and joint.friction:
            joint = SlidingJoint(**change(joint))
        if name in machine.wearing_joints:
            joint = joint.model_copy(update={"contact": Contact(**change(joint.contact))})
        joints[name] = joint
    return machine.model_copy(update={"joints": joints})


def _without_numbers_of_friction(case: Case, machine: Machine) -> Case:
    """The case without numbers that only another law of friction has."""
    laws = {f"joints.{name}.contact" for name in machine.wearing_joints}
    laws |= {f"joints.{name}" for name in machine.sliding_joints}
    places = {f"{place}.{name}" for place in laws for name in ("friction_velocity", "presliding")}
    places |= {"contact.friction_velocity", "contact.presliding"}
    return replace(case, parameters={k: v for k, v in case.parameters.items() if k not in places})
